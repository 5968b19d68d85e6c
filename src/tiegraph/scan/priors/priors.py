"""Priors of the frames' positions: GNSS, EXIF and trajectories in one world."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import ENU, parse_crs
from tiegraph.geometry.transforms import interpolate, level_umeyama, rigid, rms_length, robust_umeyama
from tiegraph.scan.priors.positions import Frames, Priors, body_of, from_exif, from_gnss
from tiegraph.scan.priors.startmodel import StartModel
from tiegraph.scan.priors.times import exif_times, name_times, read_times
from tiegraph.scan.priors.trajectory import of_images, poses_by_image, read_trajectory, same_start, trajectory_files
from tiegraph.scan.rigfiles.rigspec import AXES
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.bags import source_of
from tiegraph.scene.cells import date_text
from tiegraph.scene.exif import Exif
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.gnss.fixes import step_of
from tiegraph.scene.posefile import Trajectory
from tiegraph.scene.times import laid_on

# Positions for fitting a trajectory: their least number, and their least spread in median sigmas
_LEAST, _LEAST_SIGMAS = 3, 3.0
_SCALE_ROUNDS = 10  # convergence is linear, by the ratio of the lever arm to the length of the trajectory


@dataclass(frozen=True)
class _Paths:
    """Trajectories by pass (-1 = all) and the frames' poses in them."""

    poses: np.ndarray  # (F, 4, 4) odometry_from_rig
    group: np.ndarray  # (F,) i4: frames of one number share an odometry frame; -1 = no pose
    own_worlds: bool
    started: bool = False  # from a start model


@dataclass(frozen=True)
class Followed:
    """The odometry of a survey's images: poses (4, 4) of their rigs, each pass in its own world, by the name of the
    image; whether lengths are metres."""

    world_from_rig: Mapping[str, np.ndarray]
    metric: bool


def estimate_priors(
    frames: Frames, gnss: Path | None, trajectory: Path | StartModel | Followed | None, times: Path | None,
    settings: ScanSettings,
) -> Priors:  # fmt: skip
    """Times, positions and poses of the frames from the user's files; ``trajectory`` may be a start model, or
    odometry.

    Position priors from GNSS are those of the antenna (``Rig.antenna_m`` is applied when the model is georeferenced).
    With a trajectory too, each of its worlds is fitted to the GNSS positions, kept level, so that the frames get
    rotations and the gaps get positions (those with NaN sigma: for choosing pairs, not for georeferencing). Raises
    InputError for impossible files or an impossible CRS; doubts are in the notes.
    """
    notes: list[str] = []
    if settings.crs.lower() not in ("auto", ENU.lower()):
        parse_crs(settings.crs)
    files: dict[int, tuple[Path, Trajectory]] = {}  # of each pass, -1 = of all
    if isinstance(trajectory, Path):
        found = trajectory_files(trajectory, frames.sequences)
        files = {k: (source_of(f), read_trajectory(f)) for k, f in found.items()}
    start = trajectory if isinstance(trajectory, StartModel) else None
    time_s = _times(frames, times, files, notes)
    notes += [note for _, found in files.values() for note in found.notes]
    if start is not None:
        paths: _Paths | None = _of_start(frames, start, notes)
    elif isinstance(trajectory, Followed):
        paths = _of_odometry(frames, trajectory)
    else:
        paths = _paths(frames, files, time_s, settings, notes)
    count = len(frames.rows)
    step = 0.0 if times is not None else step_of(time_s)
    priors = Priors(time_s, np.full((count, 4, 4), np.nan), np.full((count, 3), np.nan), step_s=step)
    if gnss is not None:
        rows = read_gnss(gnss, settings.heights_m)
        priors = from_gnss(priors, frames, rows, settings, notes)
    else:
        priors = from_exif(priors, frames, settings, notes)
    if priors.origin is None and settings.crs.lower() != "auto":
        notes.append(
            f"--scan.crs {settings.crs}: nothing here has positions (no GNSS file, no EXIF): only control points "
            "(--gcp) can georeference the survey in it"
        )
    if paths is not None:
        priors = _with_paths(priors, frames, paths, notes)
    return replace(priors, notes=tuple(notes))


def _times(frames: Frames, file: Path | None, files: dict, notes: list[str]) -> np.ndarray:
    if file is not None:
        out, said = read_times(file, frames.rows, frames.sequences, frames.names)
        notes.extend(said)
        if np.isnan(out).any():
            notes.append(f"{Path(file).name}: {np.isnan(out).sum()} of {len(out)} frames have no time in it")
        return out
    exif = _in_utc(frames.exif, notes)
    out = _unless_one(exif_times(frames.rows, exif), "EXIF", notes)
    if np.isfinite(out).all():
        if not all(e.utc for e in exif):
            notes.append("times of the frames from EXIF, in the camera's own clock (without a time zone)")
        return out
    if np.isfinite(out).any():
        notes.append(f"{np.isnan(out).sum()} of {len(out)} frames have no EXIF time")
        return out
    named = _unless_one(name_times(frames.rows, frames.names), "file names", notes)
    if np.isfinite(named).any():
        notes.append("times of the frames read from the file names")
        return named
    of, one = frames.sequence(), len(frames.sequences) == 1
    for sequence, (path, trajectory) in files.items():
        # One file for all fits in order only if all frames have one order.
        rows = np.flatnonzero(of == sequence) if sequence >= 0 or not (one and (of >= 0).all()) else np.arange(len(of))
        if len(rows) == len(trajectory) and np.isfinite(trajectory.time_s).all():
            out[rows] = trajectory.time_s
            notes.append(f"{path.name}: as many poses as frames ({len(rows)}): the frames take its times in order")
    return out


def _in_utc(exif: Sequence[Exif], notes: list[str]) -> Sequence[Exif]:
    """EXIF with the times of cameras without a zone in UTC, if the receiver's times give one zone for all."""
    zones = {e.zone_s for e in exif if np.isfinite(e.zone_s)}
    if len(zones) != 1:
        return exif
    (ahead,) = zones
    notes.append(f"the cameras' clock is UTC{ahead / 3600:+g} h by the receiver's time in EXIF: subtracted")
    return [e if e.utc else replace(e, time_s=e.time_s - ahead, utc=True) for e in exif]


def _unless_one(time_s: np.ndarray, where: str, notes: list[str]) -> np.ndarray:
    """Times (F,), or NaN for all with a note if several frames have the same time."""
    known = time_s[np.isfinite(time_s)]
    if len(known) < 2 or np.ptp(known) > 0:
        return time_s
    same = f"all {len(known)} frames with a time have the same, {date_text(known[0])}"
    notes.append(f"{where}: {same}: not used; give --times if times matter")
    return np.full(len(time_s), np.nan)


def _paths(
    frames: Frames, files: dict[int, tuple[Path, Trajectory]], time_s: np.ndarray, settings: ScanSettings,
    notes: list[str],
) -> _Paths | None:  # fmt: skip
    if not files:
        return None
    by_image = next(((path, t) for path, t in files.values() if t.names), None)
    if by_image is not None:
        notes.append(f"{by_image[0].name}: its unit is taken as metres; give it by --start if that is not certain")
        return _by_image(by_image[1], by_image[0], frames, notes)
    own_worlds = len(files) > 1 and same_start([t for _, t in files.values()])
    poses, group = np.full((len(frames.rows), 4, 4), np.nan), np.full(len(frames.rows), -1)
    for sequence, (path, trajectory) in files.items():
        rows = np.arange(len(group)) if sequence < 0 else np.flatnonzero(frames.sequence() == sequence)
        moved, note = laid_on(trajectory.time_s, trajectory.period_s, time_s[rows])
        notes += [f"{path.name}: {note}"] if note else []
        poses[rows] = _frame_poses(replace(trajectory, time_s=moved), path, rows, frames, time_s, settings)
        group[rows] = max(sequence, 0) if own_worlds else 0
        missing = int(np.isnan(poses[rows, 0, 0]).sum())
        if missing:
            notes.append(f"{path.name}: {missing} of {len(rows)} frames have no pose in it")
    without = [name for k, name in enumerate(frames.sequences) if -1 not in files and k not in files]
    if without:
        used = ", ".join(path.name for path, _ in files.values())
        notes.append(f"no trajectory of pass {', '.join(without)}: no file besides {used} has its name")
    for k, row in enumerate(frames.rows):  # the file's poses are those of the body
        poses[k] = poses[k] @ np.linalg.inv(body_of(frames.specs[row.rig])[0])
    group[np.isnan(poses[:, 0, 0])] = -1
    named = next((s for s in frames.specs if s.rig_from_body() is not None and not s.body_is_reference), None)
    camera = f"the camera {frames.rigs[0].sensors[0].name!r} (x right, y down, z forward)"
    other = f"{camera}; if they are those of another body, give its axes in a rig.toml"
    what = f"the body frame of {Path(named.file).name}" if named else other
    notes.append(f"the trajectory is read as poses of {what}")
    if len(files) > 1:
        each = "each pass in its own world (they all start at the same pose)" if own_worlds else "all in one world"
        notes.append(f"{len(files)} trajectory files, {each}")
    free = [path.name for path, t in files.values() if not t.metric]
    if free:
        notes.append(f"{', '.join(free)}: without scale by its own statement: its poses are only used to choose pairs")
    return _Paths(poses, group, own_worlds, started=bool(free))


def _by_image(trajectory: Trajectory, path: Path, frames: Frames, notes: list[str], started: bool = False) -> _Paths:
    poses = poses_by_image(trajectory, path, frames, notes, metric=not started)
    return _Paths(poses, np.where(np.isnan(poses[:, 0, 0]), -1, 0), own_worlds=False, started=started)


def _of_start(frames: Frames, start: StartModel, notes: list[str]) -> _Paths:
    without = f", {start.unposed} of its images have no pose" if start.unposed else ""
    named = f"{start.path.parent.name}/{start.path.name}"  # sparse/0
    notes.append(
        f"start model of {start.program}, {named}{without}: its poses choose pairs and are tested against the "
        "images; its unit and its georeference are not used"
    )
    notes += start.notes
    return _by_image(of_images(start.poses), start.path, frames, notes, started=True)


def _of_odometry(frames: Frames, followed: Followed) -> _Paths:
    poses = np.full((len(frames.rows), 4, 4), np.nan)
    for k, row in enumerate(frames.rows):
        found = (followed.world_from_rig.get(frames.names[i]) for i in row.images)
        poses[k] = next((pose for pose in found if pose is not None), poses[k])
    group = np.where(np.isnan(poses[:, 0, 0]), -1, np.maximum(frames.sequence(), 0))
    return _Paths(poses, group, own_worlds=len(np.unique(group[group >= 0])) > 1, started=not followed.metric)


def _frame_poses(
    trajectory: Trajectory, path: Path, rows: np.ndarray, frames: Frames, time_s: np.ndarray, settings: ScanSettings
) -> np.ndarray:
    timed = np.isfinite(trajectory.time_s).all()
    if timed and np.isfinite(time_s[rows]).any():
        poses = interpolate(trajectory.time_s, trajectory.poses, time_s[rows], settings.max_gap_s)
        if np.isnan(poses[:, 0, 0]).all():
            raise InputError(
                f"{path}: times {trajectory.time_s[0]:.2f} ... {trajectory.time_s[-1]:.2f} s do not overlap the "
                f"frames' {np.nanmin(time_s[rows]):.2f} ... {np.nanmax(time_s[rows]):.2f} s: give --times in its clock"
            )
        return poses
    in_order = len(np.unique(frames.sequence()[rows])) == 1
    if in_order and len(rows) == len(trajectory):
        return trajectory.poses
    remedy = "give --times with a table image,time" if timed else "give one line a frame, or a TUM file and --times"
    raise InputError(
        f"{path}: {len(trajectory)} poses for {len(rows)} frames, and no times or names assign them: {remedy}"
    )


def _with_paths(priors: Priors, frames: Frames, paths: _Paths, notes: list[str]) -> Priors:
    if priors.prior == "none":
        known = np.isfinite(paths.poses[:, 0, 0])
        pose = np.where(known[:, None, None], paths.poses, priors.world_from_rig)
        prior = "odometry" if paths.own_worlds else "trajectory"
        return replace(priors, world_from_rig=pose, prior=prior, started=paths.started)
    pose, sigma = priors.world_from_rig.copy(), priors.position_sigma_m
    if paths.started and np.isfinite(pose[:, :3, :3]).any():
        notes.append("start model: not fitted to the positions, which have headings of their own")
        return priors
    for group in np.unique(paths.group[paths.group >= 0]):
        rows = np.flatnonzero(paths.group == group)
        laid = _laid(paths, pose[:, :3, 3], sigma, frames, rows)
        where = frames.sequences[group] if paths.own_worlds else "all passes"
        if laid is None:
            few = f"fewer than {_LEAST}, or too close together"
            notes.append(f"trajectory of {where}: not fitted to the positions ({few})")
            continue
        measured = np.isfinite(pose[rows, 0, 3])
        pose[rows] = rigid(laid.rotation, np.where(measured[:, None], pose[rows, :3, 3], laid.antenna))
        notes.append(
            f"trajectory of {where} fitted {laid.how} to {measured.sum()} positions: scale {laid.scale:.4f}, "
            f"rms {laid.rms_m:.2f} m; {(~measured).sum()} frames without one take it from the trajectory, for choosing "
            "pairs only"
        )
    return replace(priors, world_from_rig=pose, started=paths.started)


@dataclass(frozen=True)
class _Laid:
    """Odometry in the world: world_from_rig rotations (R, 3, 3), antenna positions (R, 3), scale and rms."""

    rotation: np.ndarray
    antenna: np.ndarray
    scale: float
    rms_m: float
    how: str = "level"


def _laid(paths: _Paths, target: np.ndarray, sigma: np.ndarray, frames: Frames, rows: np.ndarray) -> _Laid | None:
    """Poses of some frames in the world; a start model by a similarity if its positions determine its tilt, else level:
    the cameras of a drone have no common up direction."""
    poses, target, sigma = paths.poses[rows], target[rows], sigma[rows]
    good = np.isfinite(target[:, 0])
    if paths.started and good.sum() > _LEAST:
        off = target[good] - target[good].mean(axis=0)
        across = float(np.linalg.svd(off, compute_uv=False)[1]) / np.sqrt(good.sum())
        if across > _LEAST_SIGMAS * np.median(sigma[good, 0]):
            fit, _ = robust_umeyama(poses[good, :3, 3], target[good], sigma[good, 0])
            antenna = fit(poses[:, :3, 3])
            rms = rms_length(antenna[good] - target[good])
            turned = fit.rotation @ poses[:, :3, :3]
            return _Laid(rotation=turned, antenna=antenna, scale=fit.scale, rms_m=rms, how="by a similarity")
    return _lay_on_gnss(poses, target, sigma, frames, rows)


def _lay_on_gnss(
    poses: np.ndarray, target: np.ndarray, sigma: np.ndarray, frames: Frames, rows: np.ndarray
) -> _Laid | None:
    """Rotation about the vertical, scale and shift that take the antenna's path in odometry to GNSS positions."""
    rig, spec = frames.rigs[frames.rows[rows[0]].rig], frames.specs[frames.rows[rows[0]].rig]
    rig_from_body, axes = body_of(spec)
    body = poses @ rig_from_body  # odometry that is not metric scales the body's path, but not the rig on the body
    up = np.mean(body[:, :3, :3], axis=0) @ -AXES[axes][1]
    level = Rotation.align_vectors([0.0, 0.0, 1.0], up)[0].as_matrix()
    arm = np.zeros(3)
    if rig.antenna_m is not None:
        arm = (np.linalg.inv(rig_from_body) @ [*rig.antenna_m, 1.0])[:3]
    arm, centre = body[:, :3, :3] @ arm @ level.T, body[:, :3, 3] @ level.T
    good = np.isfinite(target[:, 0])
    if good.sum() < _LEAST:
        return None
    if np.ptp(target[good, :2], axis=0).max() < _LEAST_SIGMAS * np.median(sigma[good, 0]):
        return None
    scale = 1.0
    for _ in range(_SCALE_ROUNDS):  # the lever arm is in metres, the odometry perhaps not
        fit, rms_m = level_umeyama((centre + arm / scale)[good], target[good], sigma[good])
        scale = fit.scale
    antenna = (scale * centre + arm) @ fit.rotation.T + fit.translation
    return _Laid(rotation=fit.rotation @ level @ poses[:, :3, :3], antenna=antenna, scale=scale, rms_m=rms_m)
