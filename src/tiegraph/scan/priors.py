"""Where each frame was taken, before any image is matched: GNSS, EXIF and trajectories brought into one world."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin, make_origin, world_from_geodetic
from tiegraph.geometry.transforms import interpolate, rigid
from tiegraph.scan.rigspec import AXES, RigSpec
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.times import FrameRow, exif_times, frame_by_image, name_times, read_times
from tiegraph.scan.trajectory import read_trajectory, same_start, trajectory_files
from tiegraph.scene.exif import Exif
from tiegraph.scene.gnss import VERTICAL_FACTOR, Gnss, at_times, read_gnss
from tiegraph.scene.results import Trajectory
from tiegraph.scene.rig import Rig

_SCALE_ROUNDS = 10  # the scale converges linearly, by the ratio of the lever arm to the length of the track
_UNKNOWN_HEIGHT_SIGMA_M = 100.0  # a photograph with latitude and longitude but no height


@dataclass(frozen=True)
class Frames:
    """What the priors need to know of the frames found."""

    rows: tuple[FrameRow, ...]
    tracks: tuple[str, ...]
    names: tuple[str, ...]  # file names of the images
    exif: tuple[Exif, ...]
    rigs: tuple[Rig, ...]
    specs: tuple[RigSpec | None, ...]  # rig file or preset of each rig

    def track(self) -> np.ndarray:
        """(F,) pass of each frame."""
        return np.array([r.track for r in self.rows], int)


@dataclass(frozen=True)
class Priors:
    """Columns of the Scene that say when and where."""

    time_s: np.ndarray
    world_from_rig: np.ndarray
    position_sigma_m: np.ndarray
    origin: Origin | None = None
    prior: str = "none"
    notes: tuple[str, ...] = field(default_factory=tuple)


@dataclass(frozen=True)
class _Paths:
    """Trajectories by pass (-1 = all) and the frames' poses in them."""

    poses: np.ndarray  # (F, 4, 4) odometry_from_rig
    group: np.ndarray  # (F,) i4: frames of one number share an odometry frame; -1 = no pose
    own_worlds: bool


def estimate_priors(
    frames: Frames, gnss: Path | None, trajectory: Path | None, times: Path | None, settings: ScanSettings
) -> Priors:
    """Times, positions and poses of the frames from what the user has.

    Position priors from GNSS are those of the antenna (``Rig.antenna_m`` is applied when the model is georeferenced).
    With a trajectory too, each of its worlds is laid on the GNSS positions level, so that the frames get rotations and
    the gaps get positions (those with NaN sigma: for choosing pairs, not for georeferencing).
    """
    notes: list[str] = []
    files = {} if trajectory is None else {k: (f, read_trajectory(f)) for k, f in
                                           trajectory_files(trajectory, frames.tracks).items()}  # fmt: skip
    time_s = _times(frames, times, files, notes)
    notes += [note for _, found in files.values() for note in found.notes]
    paths = _paths(frames, files, time_s, settings, notes)
    count = len(frames.rows)
    priors = Priors(time_s, np.full((count, 4, 4), np.nan), np.full((count, 3), np.nan))
    if gnss is not None:
        priors = _from_gnss(priors, frames, read_gnss(gnss), Path(gnss), settings, notes)
    else:
        priors = _from_exif(priors, frames, settings, notes)
    if paths is not None:
        priors = _with_paths(priors, frames, paths, notes)
    return replace(priors, notes=tuple(notes))


# --- times ----------------------------------------------------------------------------------------------------------


def _times(frames: Frames, file: Path | None, files: dict, notes: list[str]) -> np.ndarray:
    if file is not None:
        out = read_times(file, frames.rows, frames.tracks, frames.names)
        if np.isnan(out).any():
            notes.append(f"{Path(file).name}: {np.isnan(out).sum()} of {len(out)} frames have no time in it")
        return out
    out = exif_times(frames.rows, frames.exif)
    if np.isfinite(out).all():
        if not all(e.time_utc for e in frames.exif):
            notes.append("times of the frames from EXIF, in the camera's own clock (no time zone written)")
        return out
    if np.isfinite(out).any():
        notes.append(f"{np.isnan(out).sum()} of {len(out)} frames have no EXIF time")
        return out
    named = name_times(frames.rows, frames.names)
    if np.isfinite(named).any():
        notes.append("times of the frames read from the file names")
        return named
    for track, (path, trajectory) in files.items():
        rows = _rows_of(frames, track)
        if len(rows) == len(trajectory) and np.isfinite(trajectory.time_s).all():
            out[rows] = trajectory.time_s
            notes.append(f"{path.name}: as many poses as frames ({len(rows)}): the frames take its times in order")
    return out


def _rows_of(frames: Frames, track: int) -> np.ndarray:
    track_of = frames.track()
    if track >= 0:
        return np.flatnonzero(track_of == track)
    # One file in order fits only if there is one order of all frames.
    return np.arange(len(track_of)) if len(frames.tracks) == 1 and (track_of >= 0).all() else np.zeros(0, int)


# --- GNSS and EXIF --------------------------------------------------------------------------------------------------


def _from_gnss(
    priors: Priors, frames: Frames, gnss: Gnss, path: Path, settings: ScanSettings, notes: list[str]
) -> Priors:
    notes.extend(gnss.notes)
    near = np.ones(len(gnss.time_s), bool)
    if not gnss.names:
        near = _overlap(gnss, priors.time_s, path, settings)
    origin = _origin(gnss.lat_lon_height[near], settings)
    world = world_from_geodetic(gnss.lat_lon_height, origin)
    if gnss.names:
        position, sigma, heading = _by_image(frames, gnss, world, path, notes)
    else:
        position, sigma, heading = at_times(gnss, world, priors.time_s, settings.max_gap_s)
    there = np.isfinite(position[:, 0])
    if not there.any():
        raise InputError(f"{path}: no frame lies within {settings.max_gap_s:g} s of its rows: raise scan.max_gap_s?")
    if not there.all():
        notes.append(
            f"{path.name}: {(~there).sum()} of {len(there)} frames have no position (gaps over {settings.max_gap_s:g} "
            "s, or outside the file)"
        )
    default = settings.gnss_sigma_m * np.array([1.0, 1.0, VERTICAL_FACTOR])
    if np.isnan(sigma[there]).any():
        notes.append(
            f"{path.name}: accuracy not given; {default[0]:g} m horizontal and {default[2]:g} m vertical assumed"
        )
    sigma = np.where(there[:, None], np.where(np.isnan(sigma), default, sigma), np.nan)
    pose = rigid(_rotations(frames, heading), position)
    pose[~there] = np.nan
    return replace(priors, world_from_rig=pose, position_sigma_m=sigma, origin=origin, prior="gnss")


def _origin(lat_lon_height: np.ndarray, settings: ScanSettings) -> Origin:
    lat, lon, height = (float(v) for v in np.median(lat_lon_height, axis=0))
    return make_origin(lat, lon, height, settings.crs)


def _overlap(gnss: Gnss, time_s: np.ndarray, path: Path, settings: ScanSettings) -> np.ndarray:
    if np.isnan(time_s).all():
        raise InputError(
            f"{path}: its rows have times, but the frames have none (no EXIF, no times in the names). Give --times "
            "with a table image,time, or a GNSS table with a column image"
        )
    first, last = np.nanmin(time_s) - settings.max_gap_s, np.nanmax(time_s) + settings.max_gap_s
    near = (gnss.time_s >= first) & (gnss.time_s <= last)
    if not near.any():
        raise InputError(
            f"{path}: times {gnss.time_s[0]:.2f} ... {gnss.time_s[-1]:.2f} s do not overlap the frames' "
            f"{np.nanmin(time_s):.2f} ... {np.nanmax(time_s):.2f} s: other epoch, other time zone, or another survey? "
            "Give --times in the clock of the GNSS file"
        )
    return near


def _by_image(
    frames: Frames, gnss: Gnss, world: np.ndarray, path: Path, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lookup = frame_by_image(frames.rows, frames.names)
    count = len(frames.rows)
    position, sigma, heading = np.full((count, 3), np.nan), np.full((count, 3), np.nan), np.full(count, np.nan)
    unknown = []
    for k, name in enumerate(gnss.names):
        frame = lookup.get(name)
        if frame is None:
            unknown.append(name)
        else:
            position[frame], sigma[frame], heading[frame] = world[k], gnss.sigma_m[k], gnss.heading_deg[k]
    if len(unknown) == len(gnss.names):
        raise InputError(
            f"{path}: none of its images is here: {unknown[0]} ...; names are relative to the image folder"
        )
    if unknown:
        notes.append(f"{path.name}: {len(unknown)} rows name images that are not here, such as {unknown[0]}")
    return position, sigma, heading


def _rotations(frames: Frames, heading_deg: np.ndarray) -> np.ndarray:
    """(F, 3, 3) world_from_rig of a level body with a heading; NaN without one."""
    out = np.full((len(heading_deg), 3, 3), np.nan)
    for k in np.flatnonzero(np.isfinite(heading_deg)):
        h = np.radians(heading_deg[k])
        right_down_forward = np.array([[np.cos(h), 0, np.sin(h)], [-np.sin(h), 0, np.cos(h)], [0, -1, 0]])
        rig_from_body, axes = _body(frames.specs[frames.rows[k].rig])
        out[k] = right_down_forward @ AXES[axes] @ rig_from_body[:3, :3].T
    return out


def _body(spec: RigSpec | None) -> tuple[np.ndarray, str]:
    pose = None if spec is None else spec.rig_from_body()
    return (np.eye(4), "camera") if spec is None or pose is None else (pose, spec.axes)


def _from_exif(priors: Priors, frames: Frames, settings: ScanSettings, notes: list[str]) -> Priors:
    fixes = [[frames.exif[i] for i in row.images if np.isfinite(frames.exif[i].lat_deg)] for row in frames.rows]
    there = np.array([bool(f) for f in fixes])
    if there.sum() < 2:
        return priors
    llh = np.full((len(fixes), 3), np.nan)
    sigma = np.full((len(fixes), 3), np.nan)
    for k in np.flatnonzero(there):
        llh[k] = [np.mean([getattr(e, n) for e in fixes[k]]) for n in ("lat_deg", "lon_deg", "height_m")]
        given = fixes[k][0].position_sigma_m
        flat = given if np.isfinite(given) else settings.gnss_sigma_m
        sigma[k] = flat, flat, VERTICAL_FACTOR * flat
    low = there & np.isnan(llh[:, 2])
    if low.any():
        llh[low, 2] = np.nanmedian(llh[:, 2]) if (there & ~low).any() else 0.0
        sigma[low, 2] = _UNKNOWN_HEIGHT_SIGMA_M
        notes.append(f"EXIF: {low.sum()} positions have no height")
    origin = _origin(llh[there], settings)
    pose = np.full((len(fixes), 4, 4), np.nan)
    pose[there, :3, 3] = world_from_geodetic(llh[there], origin)
    pose[there, 3] = 0.0, 0.0, 0.0, 1.0
    notes.append(
        f"positions of {there.sum()} of {len(there)} frames from EXIF; its heights are usually above sea level and are "
        "taken as they are"
    )
    return replace(priors, world_from_rig=pose, position_sigma_m=sigma, origin=origin, prior="exif")


# --- trajectories ---------------------------------------------------------------------------------------------------


def _paths(
    frames: Frames,
    files: dict[int, tuple[Path, Trajectory]],
    time_s: np.ndarray,
    settings: ScanSettings,
    notes: list[str],
) -> _Paths | None:
    if not files:
        return None
    own_worlds = len(files) > 1 and same_start([t for _, t in files.values()])
    poses, group = np.full((len(frames.rows), 4, 4), np.nan), np.full(len(frames.rows), -1)
    for track, (path, trajectory) in files.items():
        rows = np.arange(len(group)) if track < 0 else np.flatnonzero(frames.track() == track)
        poses[rows] = _frame_poses(trajectory, path, rows, frames, time_s, settings)
        group[rows] = max(track, 0) if own_worlds else 0
        missing = int(np.isnan(poses[rows, 0, 0]).sum())
        if missing:
            notes.append(f"{path.name}: {missing} of {len(rows)} frames have no pose in it")
    without = [name for k, name in enumerate(frames.tracks) if -1 not in files and k not in files]
    if without:
        used = ", ".join(path.name for path, _ in files.values())
        notes.append(f"no trajectory of pass {', '.join(without)}: none of the other files than {used} has its name")
    for k, row in enumerate(frames.rows):  # the file's poses are those of the body
        poses[k] = poses[k] @ np.linalg.inv(_body(frames.specs[row.rig])[0])
    group[np.isnan(poses[:, 0, 0])] = -1
    named = next(
        (s for s in frames.specs if s is not None and s.rig_from_body() is not None and not s.body_is_reference), None
    )
    what = (
        f"the body frame of {Path(named.file).name}"
        if named
        else (
            f"the camera {frames.rigs[0].sensors[0].name!r} (x right, y down, z forward); if they are those of another "
            "body, say so by axes in a rig.toml"
        )
    )
    notes.append(f"the trajectory is taken as poses of {what}")
    if len(files) > 1:
        each = "each pass in a world of its own (they all start at the same pose)" if own_worlds else "all in one world"
        notes.append(f"{len(files)} trajectory files, {each}")
    return _Paths(poses, group, own_worlds)


def _frame_poses(
    trajectory: Trajectory, path: Path, rows: np.ndarray, frames: Frames, time_s: np.ndarray, settings: ScanSettings
) -> np.ndarray:
    timed = np.isfinite(trajectory.time_s).all()
    if timed and np.isfinite(time_s[rows]).any():
        poses = interpolate(trajectory.time_s, trajectory.world_from_rig, time_s[rows], settings.max_gap_s)
        if np.isnan(poses[:, 0, 0]).all():
            raise InputError(
                f"{path}: times {trajectory.time_s[0]:.2f} ... {trajectory.time_s[-1]:.2f} s do not overlap the "
                f"frames' {np.nanmin(time_s[rows]):.2f} ... {np.nanmax(time_s[rows]):.2f} s: give --times in its clock"
            )
        return poses
    in_order = len(np.unique(frames.track()[rows])) == 1
    if in_order and len(rows) == len(trajectory):
        return trajectory.world_from_rig
    remedy = "give --times with a table image,time" if timed else "give one line a frame, or a TUM file and --times"
    raise InputError(
        f"{path}: {len(trajectory)} poses for {len(rows)} frames, and nothing says which belongs to which: {remedy}"
    )


def _with_paths(priors: Priors, frames: Frames, paths: _Paths, notes: list[str]) -> Priors:
    if priors.prior == "none":
        known = np.isfinite(paths.poses[:, 0, 0])
        pose = np.where(known[:, None, None], paths.poses, priors.world_from_rig)
        return replace(priors, world_from_rig=pose, prior="odometry" if paths.own_worlds else "trajectory")
    pose, sigma = priors.world_from_rig.copy(), priors.position_sigma_m
    for group in np.unique(paths.group[paths.group >= 0]):
        rows = np.flatnonzero(paths.group == group)
        laid = _lay_on_gnss(paths.poses[rows], pose[rows, :3, 3], sigma[rows], frames, rows)
        where = frames.tracks[group] if paths.own_worlds else "all passes"
        if laid is None:
            notes.append(f"trajectory of {where}: not laid on the positions (fewer than 3, or too close together)")
            continue
        rotation, antenna, scale, rms = laid
        measured = np.isfinite(pose[rows, 0, 3])
        pose[rows] = rigid(rotation, np.where(measured[:, None], pose[rows, :3, 3], antenna))
        notes.append(
            f"trajectory of {where} laid level on {measured.sum()} positions: scale {scale:.4f}, rms {rms:.2f} m; "
            f"{(~measured).sum()} frames without one take it from the trajectory, for choosing pairs only"
        )
    return replace(priors, world_from_rig=pose)


def _lay_on_gnss(
    poses: np.ndarray, target: np.ndarray, sigma: np.ndarray, frames: Frames, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """Turn about the vertical, scale and shift that take the antenna's path in odometry to GNSS positions.

    Level = the mean up direction of the body; a free rotation would be undetermined about a straight track. Returns
    world_from_rig rotations (R, 3, 3), antenna positions (R, 3), scale and rms (m), or None.
    """
    rig, spec = frames.rigs[frames.rows[rows[0]].rig], frames.specs[frames.rows[rows[0]].rig]
    rig_from_body, axes = _body(spec)
    body = poses @ rig_from_body  # odometry that is not metric scales the body's path, not the rig on the body
    up = np.mean(body[:, :3, :3], axis=0) @ -AXES[axes][1]
    level = _turn_to_z(up / np.linalg.norm(up))
    arm = np.zeros(3)
    if rig.antenna_m is not None:
        arm = (np.linalg.inv(rig_from_body) @ [*rig.antenna_m, 1.0])[:3]
    arm, centre = body[:, :3, :3] @ arm @ level.T, body[:, :3, 3] @ level.T
    good = np.isfinite(target[:, 0])
    if good.sum() < 3 or np.ptp(target[good, :2], axis=0).max() < 3 * np.median(sigma[good, 0]):
        return None
    scale = 1.0
    for _ in range(_SCALE_ROUNDS):  # the lever arm is in metres, the odometry need not be
        turn, scale, shift, rms = _fit_level((centre + arm / scale)[good], target[good], sigma[good])
    return turn @ level @ poses[:, :3, :3], (scale * centre + arm) @ turn.T + shift, scale, rms


def _turn_to_z(up: np.ndarray) -> np.ndarray:
    axis = np.cross(up, [0.0, 0.0, 1.0])
    x = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    if up[2] < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    return np.eye(3) + x + x @ x / (1 + up[2])


def _fit_level(path: np.ndarray, target: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, float]:
    """Rotation about z, scale, shift and rms, by reweighted least squares (Cauchy weights, residuals over sigma)."""
    source, goal = path[:, 0] + 1j * path[:, 1], target[:, 0] + 1j * target[:, 1]
    weight = 1 / sigma[:, 0] ** 2
    for _ in range(20):
        s0, g0 = np.average(source, weights=weight), np.average(goal, weights=weight)
        a = np.sum(weight * np.conj(source - s0) * (goal - g0)) / np.sum(weight * np.abs(source - s0) ** 2)
        residual = np.abs(goal - g0 - a * (source - s0))
        weight = 1 / (sigma[:, 0] ** 2 + residual**2)
    scale, angle = float(np.abs(a)), float(np.angle(a))
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    flat = g0 - a * s0
    height = np.average(target[:, 2] - scale * path[:, 2], weights=1 / sigma[:, 2] ** 2)
    rms = float(np.sqrt(np.average(residual**2, weights=weight)))
    return turn, scale, np.array([flat.real, flat.imag, height]), rms
