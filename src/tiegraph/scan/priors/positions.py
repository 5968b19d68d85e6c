"""Position of each frame from GNSS rows or EXIF: positions in the world, with notes on doubtful ones."""

import re
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin, area_note, datum_note, make_origin, middle, world_from_geodetic
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.priors.times import FrameRow, absent, frames_of_names
from tiegraph.scan.rigfiles.rigspec import AXES, RigSpec
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.exif import Exif
from tiegraph.scene.gnss.fixes import (
    VERTICAL,
    Gnss,
    at_times,
    beyond,
    far_rows,
    moved_within,
    on_clock_of,
    stuck_note,
    without_far,
)
from tiegraph.scene.rig import Rig
from tiegraph.scene.times import DAY_S, GPS_EPOCH_S
from tiegraph.text import some

_NAMED = 3  # frames without a position that are named


@dataclass(frozen=True)
class Frames:
    """The data of the frames that the priors need."""

    rows: tuple[FrameRow, ...]
    sequences: tuple[str, ...]
    names: tuple[str, ...]  # file names of the images
    exif: tuple[Exif, ...]
    rigs: tuple[Rig, ...]
    specs: tuple[RigSpec, ...]  # rig file or preset of each rig
    sensors: tuple[int, ...]  # of its rig, of each image

    def sequence(self) -> np.ndarray:
        """(F,) pass of each frame."""
        return np.array([r.sequence for r in self.rows], int)


@dataclass(frozen=True)
class Priors:
    """Columns of the Scene for time and place."""

    time_s: np.ndarray
    world_from_rig: np.ndarray
    position_sigma_m: np.ndarray
    step_s: float = 0.0  # of the times, where the cameras' clocks have whole seconds
    origin: Origin | None = None
    prior: str = "none"
    started: bool = False  # as of the Scene
    notes: tuple[str, ...] = field(default_factory=tuple)


def from_gnss(priors: Priors, frames: Frames, gnss: Gnss, settings: ScanSettings, notes: list[str]) -> Priors:
    """Priors with the positions of a GNSS file: by image name, else interpolated at the frames' times.

    Raises InputError if no row fits a frame, or the CRS of the settings does not fit the positions.
    """
    gnss, path = on_clock_of(gnss, priors.time_s), gnss.path
    if gnss.names:
        gnss = without_far(_known(gnss, frames))
    notes.extend(gnss.notes)
    near = slice(None) if gnss.names else _overlap(gnss, priors.time_s, settings)
    origin = _origin(gnss.lat_lon_height[near], settings, notes)
    cut = np.zeros((len(frames.rows), 3))
    world = world_from_geodetic(gnss.lat_lon_height, origin)
    if gnss.names:
        position, sigma, heading = _by_image(frames, gnss, world, notes)
    else:
        position, sigma, heading = at_times(gnss, world, priors.time_s, settings.max_gap_s)
        moved = replace(gnss, sigma_m=moved_within(gnss.time_s, world, priors.step_s))
        cut = at_times(moved, world, priors.time_s, settings.max_gap_s)[1]
    there = np.isfinite(position[:, 0])
    if not there.any():
        raise InputError(
            f"{path}: no frame lies within {settings.max_gap_s:g} s of its rows: raise scan.max_gap_s?"
            f"{_clock(gnss, priors.time_s)}"
        )
    if not there.all():
        hint = _clock(gnss, priors.time_s) if there.mean() < 0.5 else ""
        why = "" if gnss.names else f" (gaps over {settings.max_gap_s:g} s, or outside the file)"
        notes.append(
            f"{path.name}: {(~there).sum()} of {len(there)} frames have no position{why}: "
            f"{_without(frames, ~there)}{hint}"
        )
    default = settings.gnss_sigma_m * np.array([1.0, 1.0, VERTICAL])
    if np.isnan(sigma[there]).any():
        notes.append(
            f"{path.name}: accuracy not given; {default[0]:g} m horizontal and {default[2]:g} m vertical assumed"
        )
    sigma = np.where(there[:, None], np.where(np.isnan(sigma), default, sigma), np.nan)
    if np.any(cut[there] > sigma[there]):
        notes.append(
            f"{path.name}: the frames' times have whole seconds, in which the receiver moved {np.nanmax(cut):.1f} m "
            "(root mean square) and more; their sigmas include that: --times with fractions of seconds is better"
        )
    sigma = np.hypot(sigma, cut)
    pose = rigid(_rotations(frames, heading), position)
    pose[~there] = np.nan
    return replace(priors, world_from_rig=pose, position_sigma_m=sigma, origin=origin, prior="gnss")


def _without(frames: Frames, rows: np.ndarray) -> str:
    """The first frames of (F,) rows without a position by name."""
    lacking = np.flatnonzero(rows).tolist()
    return some((frames.names[frames.rows[k].images[0]] for k in lacking), _NAMED)


def _origin(lat_lon_height: np.ndarray, settings: ScanSettings, notes: list[str]) -> Origin:
    origin = make_origin(*middle(lat_lon_height), settings.crs)
    if settings.crs.lower() != "auto":
        datum = datum_note(origin.crs)
        notes += filter(None, [area_note(origin.crs, lat_lon_height), datum and f"--scan.crs {origin.crs}: {datum}"])
    return origin


def _overlap(gnss: Gnss, time_s: np.ndarray, settings: ScanSettings) -> np.ndarray:
    path = gnss.path
    if np.isnan(time_s).all():
        raise InputError(
            f"{path}: its rows have times, but the frames have none (no EXIF, no times in the names). Give --times "
            "with a table image,time, or a GNSS table with a column image"
        )
    first, last = np.nanmin(time_s), np.nanmax(time_s)
    near = (gnss.time_s >= first - settings.max_gap_s) & (gnss.time_s <= last + settings.max_gap_s)
    if not near.any():
        what = "seconds of the GPS week" if gnss.period_s > DAY_S else "times of day (UTC)"
        undated = f"; it has {what} without a date: give the frames' times as dates (UTC), or likewise"
        raise InputError(
            f"{path}: times {gnss.time_s[0]:.2f} ... {gnss.time_s[-1]:.2f} s do not overlap the frames' "
            f"{first:.2f} ... {last:.2f} s: other epoch, other time zone, or another survey? "
            f"Give --times in the clock of the GNSS file{_clock(gnss, time_s)}{undated if gnss.period_s else ''}"
        )
    return near


def _clock(gnss: Gnss, time_s: np.ndarray) -> str:
    """A hint if the times of the file match those of the frames in another unit; else ""."""
    if gnss.names:
        return ""
    first, last = np.nanmin(time_s), np.nanmax(time_s)
    if last < DAY_S and gnss.time_s[0] > GPS_EPOCH_S:
        return (
            "; the frames' count from the start of a video, or of another clock without a date: for videos "
            f"--scan.video-offset {gnss.time_s[0]:.0f} if they began with the file"
        )
    for factor, unit in ((1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")):
        if gnss.time_s[0] * factor <= last and gnss.time_s[-1] * factor >= first and gnss.time_s[-1] > last:
            return f"; its times look like {unit}: give seconds, or name the column time ({unit})"
    if gnss.time_s[0] + GPS_EPOCH_S <= last and gnss.time_s[-1] + GPS_EPOCH_S >= first:
        return "; its times look like seconds since 1980 (GPS): name the column gps_seconds"
    hours = round(4 * (np.median(gnss.time_s) - (first + last) / 2) / 3600) / 4  # zones are quarters of an hour apart
    there = gnss.time_s[0] - 3600 * hours <= last and gnss.time_s[-1] - 3600 * hours >= first
    if there and 0 < abs(hours) <= 14:  # the farthest time zone from UTC
        remedy = f" (videos: --scan.video-offset {3600 * hours:g})"
        return f"; {hours:+g} h would match the frames' times: were the cameras' clocks in local time?{remedy}"
    return ""


def _known(gnss: Gnss, frames: Frames) -> Gnss:
    """The rows of a file by image whose images are here. Raises InputError if there are none."""
    gnss = _by_number(gnss, frames)
    keep = np.array([k is not None for k in frames_of_names(gnss.names, frames.rows, frames.names)], bool)
    if keep.all():
        return gnss
    first = int(np.flatnonzero(~keep)[0])
    why = absent(gnss.names[first], frames.names)
    if not keep.any():
        raise InputError(
            f"{gnss.path}: none of its images is here: {gnss.names[first]} (line {gnss.line[first]}) ...; {why}"
        )
    note = (
        f"{gnss.path.name}: {(~keep).sum()} rows name images that are not here, such as {gnss.names[first]} "
        f"(line {gnss.line[first]}); {why}"
    )
    return gnss.only(np.flatnonzero(keep), note)


def _by_number(gnss: Gnss, frames: Frames) -> Gnss:
    """Rows named "#12" by the image of that number. Raises InputError where images of several frames have it."""
    if not gnss.names[0].startswith("#"):
        return gnss
    found: dict[str, dict[int, str]] = {}
    for k, row in enumerate(frames.rows):
        for name in (frames.names[i] for i in row.images):
            if digits := re.findall(r"\d+", PurePosixPath(name).stem):
                found.setdefault(f"#{int(digits[-1])}", {}).setdefault(k, name)
    for name, line in zip(gnss.names, gnss.line):
        if len(found.get(name, ())) > 1:
            one, other = list(found[name].values())[:2]
            raise InputError(
                f"{gnss.path}, line {line}: image {name[1:]} can be {one} or {other}: give the images of one flight, "
                "or a table with columns image, lat, lon, height"
            )
    return replace(gnss, names=tuple(next(iter(found.get(n, {0: n}).values())) for n in gnss.names))


def _by_image(
    frames: Frames, gnss: Gnss, world: np.ndarray, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows: dict[int, list[int]] = {}
    for k, frame in enumerate(frames_of_names(gnss.names, frames.rows, frames.names)):
        if frame is not None:
            rows.setdefault(frame, []).append(k)
    count = len(frames.rows)
    position, sigma, heading = np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan)
    apart = []
    for frame, mine in rows.items():
        position[frame] = np.median(world[mine], axis=0)
        sigma[frame], heading[frame] = gnss.sigma_m[mine[0]], gnss.heading_deg[mine[0]]
        wide = float(np.ptp(world[mine], axis=0).max())
        if wide > 1.0:  # a rig is smaller, or its images share a row
            apart.append((wide, mine))
    if apart:
        wide, mine = max(apart)
        off = np.linalg.norm(world[mine] - np.median(world[mine], axis=0), axis=1)
        odd, other = mine[-1 - int(np.argmax(np.round(off[::-1], 6)))], mine[int(np.argmin(np.round(off, 6)))]
        notes.append(
            f"{gnss.path.name}, line {gnss.line[odd]}: {gnss.names[odd]} lies {wide:.1f} m from "
            f"{gnss.names[other]} of the same frame, as in {len(apart)} frames; their median is taken: do these "
            "images belong together?"
        )
    return position, sigma, heading


def _rotations(frames: Frames, heading_deg: np.ndarray) -> np.ndarray:
    """(F, 3, 3) world_from_rig of a level body with a heading; NaN without one."""
    out = np.full((len(heading_deg), 3, 3), np.nan)
    for k in np.flatnonzero(np.isfinite(heading_deg)):
        sin, cos = np.sin(np.radians(heading_deg[k])), np.cos(np.radians(heading_deg[k]))
        right_down_forward = np.array([[cos, 0, sin], [-sin, 0, cos], [0, -1, 0]])
        rig_from_body, axes = body_of(frames.specs[frames.rows[k].rig])
        out[k] = right_down_forward @ AXES[axes] @ rig_from_body[:3, :3].T
    return out


def body_of(spec: RigSpec) -> tuple[np.ndarray, str]:
    """rig_from_body (4, 4) and the axes of a rig's body; those of its first camera if the rig names no body."""
    pose = spec.rig_from_body()
    return (np.eye(4), "camera") if pose is None else (pose, spec.axes)


def from_exif(priors: Priors, frames: Frames, settings: ScanSettings, notes: list[str]) -> Priors:
    """Priors with the positions that cameras wrote into their files; outliers far from all others are not used.

    Raises InputError if the CRS of the settings does not fit the positions.
    """
    _say_doubts(frames, notes)
    llh, given = _exif_positions(frames, notes, settings.heights_m)
    found = [[i for i in row.images if np.isfinite(llh[i, 0])] for row in frames.rows]
    there = np.array([bool(f) for f in found])
    if there.sum() < 2:
        if there.any():
            notes.append(f"EXIF: 1 of {len(there)} frames has a position, which is not enough: not used")
        return priors
    places = np.full((len(found), 3), np.nan)
    sigma = np.full((len(found), 3), np.nan)
    for k in np.flatnonzero(there):
        places[k] = np.mean(llh[found[k]], axis=0)
        flat, up = given[found[k][0]]
        flat = flat if np.isfinite(flat) else settings.gnss_sigma_m
        sigma[k] = flat, flat, up if np.isfinite(up) else VERTICAL * flat
    nought = there & (places[:, 2] == 0)  # some cameras write it while they have no height
    others = np.abs(places[there & ~nought, 2])
    if nought.sum() < len(others) and np.nanmin(others, initial=np.inf) > 5:  # with another so near 0, it can be one
        places[nought, 2] = np.nan
    low = there & np.isnan(places[:, 2])
    if low.any():
        places[low, 2] = np.nanmedian(places[:, 2]) if (there & ~low).any() else 0.0
        sigma[low, 2] = 100.0
        notes.append(f"EXIF: {low.sum()} positions have no height")
    if stuck := stuck_note(places[there], "EXIF"):
        notes.append(f"{stuck} Not used")
        return priors
    places_of = {(frames.rows[k].rig, *places[k, :2]) for k in np.flatnonzero(there)}
    if len(places_of) < there.sum():
        notes.append(
            f"EXIF: {there.sum() - len(places_of)} of {there.sum()} positions are identical to those of other "
            "frames: taken from one place, or without a new fix of the receiver"
        )
    origin = _origin(places[there], settings, notes)
    pose = np.full((len(found), 4, 4), np.nan)
    pose[there, :3, 3] = world_from_geodetic(places[there], origin)
    pose[there, 3] = 0.0, 0.0, 0.0, 1.0
    lacking = "" if there.all() else f" (none in {_without(frames, ~there)})"
    notes.append(
        f"positions of {there.sum()} of {len(there)} frames from EXIF{lacking}; its heights are usually above sea "
        "level and are used unchanged"
    )
    return replace(priors, world_from_rig=pose, position_sigma_m=sigma, origin=origin, prior="exif")


def _say_doubts(frames: Frames, notes: list[str]) -> None:
    """One note on images whose EXIF positions are left out, and one on those that are used though doubtful."""
    for used in (False, True):
        rows = [k for k, e in enumerate(frames.exif) if e.doubt and np.isfinite(e.lat_deg) == used]
        if rows:
            what = "used nevertheless" if used else "not used"
            notes.append(
                f"EXIF of {frames.names[rows[0]]}: {frames.exif[rows[0]].doubt}: {what}, as in {len(rows)} of "
                f"{len(frames.exif)} images; correct the files (exiftool), or give --gnss with a column image"
            )


def _exif_positions(frames: Frames, notes: list[str], heights_m: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Lat, lon, height (N, 3) of the images and their sigmas (N, 2), horizontal and up, in metres."""
    llh = np.array([[e.lat_deg, e.lon_deg, e.height_m] for e in frames.exif], float).reshape(-1, 3)
    none = np.flatnonzero((llh[:, 2] < heights_m[0]) | (llh[:, 2] > heights_m[1]))
    if len(none):
        notes.append(
            f"EXIF of {frames.names[none[0]]}: height {llh[none[0], 2]:g} m, {beyond(heights_m)}; "
            f"{len(none)} positions are used without their heights"
        )
    llh[none, 2] = np.nan
    known = np.flatnonzero(np.isfinite(llh[:, 0]))
    level = np.nan_to_num(llh[known])  # an unknown height serves as zero here: a mountain is no gap of kilometres
    far, note = far_rows(level, [f"EXIF of {frames.names[k]}" for k in known])
    if note:
        notes.append(note)
    llh[known[far]] = np.nan
    return llh, np.array([[e.sigma_m, e.sigma_up_m] for e in frames.exif], float)
