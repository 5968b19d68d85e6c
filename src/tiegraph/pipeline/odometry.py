"""Glue of the odometry: from a scanned survey to trajectories with sigmas, a file a pass."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.errors import ReconstructionError
from tiegraph.geometry.transforms import quaternion_xyzw
from tiegraph.odometry.cameras import Cameras, cameras_of
from tiegraph.odometry.odometry import Odometry, OdometryPath, path_of
from tiegraph.pipeline.files import scanned
from tiegraph.pipeline.foundrig import rig_of_run
from tiegraph.project.run import Run
from tiegraph.project.stages import write_atomic
from tiegraph.scan.priors.priors import Followed
from tiegraph.scan.rigfiles.rigfile import parse_rig_file, read_rig_file
from tiegraph.scene.atomic import must_be_new, names_file
from tiegraph.scene.decoding import read_pixels
from tiegraph.scene.posefile import FREE_UNIT
from tiegraph.scene.scene import Scene
from tiegraph.text import csv_text

_COLUMNS = (
    "image", "time", "segment", "keyframe", "x", "y", "z", "qx", "qy", "qz", "qw",
    "sigma_x", "sigma_y", "sigma_z", "sigma_turn_x_deg", "sigma_turn_y_deg", "sigma_turn_z_deg",
)  # fmt: skip


_NO_POSE = (
    "no pose was found: frames must share textured surface, seen from different positions if cameras have no common "
    "view, and the focal lengths must be right"
)


@dataclass(frozen=True)
class Made:
    """The result of the odometry of one pass: the trajectory's file, notes, frames a second."""

    tum: Path
    said: tuple[str, ...]
    frames_per_s: float


def odometry(run: Run, out: Path) -> tuple[Made, ...]:
    """Follow the rig through every pass of a scanned survey; write ``out`` (TUM) and beside it a CSV of the same name
    with segments and sigmas, or of several passes a folder named as ``out`` without suffix, with a pair a pass.

    Raises InputError for an uncalibrated rig and existing outputs; ReconstructionError if nothing can be followed.
    """
    scene = scanned(run)
    cameras, rig_from_body = cameras_of(scene.rigs), _rig_from_body(run)
    passes, made = _passes(scene), []
    targets = _files(out, list(passes))
    for path in (p for target in targets for p in (target, target.with_suffix(".csv"))):
        must_be_new(out, path)
    for (name, frames), target in zip(passes.items(), targets):
        started = time.perf_counter()
        with run.reporter.stage("odometry"):
            found, said = _follow(run, scene, cameras, frames)
        if found.main() < 0:
            raise ReconstructionError(f"{name or 'the images'}: {_NO_POSE}. {'; '.join(said)}")
        rate = len(frames) / (time.perf_counter() - started)
        _write(target, scene, frames, found, rig_from_body)
        first, *more = _told(name, scene, frames, found)
        lost = (f"left out: {d.name}: {d.reason}" for d in scene.dropped)
        made.append(Made(target, (f"{first}, {rate:.1f} frames/s", *more, *lost, *said), rate))
    return tuple(made)


def followed(run: Run, scene: Scene) -> tuple[Followed, tuple[str, ...]]:
    """The poses by odometry for a survey that is being scanned, and notes; its files go to ``odometry/``.

    Of each pass the longest segment counts; one that cannot be followed has no poses. Raises as ``odometry``.
    """
    cameras = cameras_of(scene.rigs)
    body, poses, notes, metric = _rig_from_body(run), {}, [], True
    passes = _passes(scene)
    for (name, frames), target in zip(passes.items(), _files(run.path("odometry", "path"), list(passes))):
        path, said = _follow(run, scene, cameras, frames)
        main = path.main()
        if main < 0:
            notes.append(f"odometry: {name or 'the images'}: {_NO_POSE}")
            continue
        metric &= path.metric
        _write(target, scene, frames, path, body)
        own = path.segment == main
        pose_of = dict(zip(frames[own].tolist(), path.world_from_rig[own]))
        for k in np.flatnonzero(np.isin(scene.frame, frames[own])).tolist():
            poses[scene.source_name(k)] = pose_of[int(scene.frame[k])]
        notes += [f"odometry: {text}" for text in (*_told(name, scene, frames, path), *said)]
    return Followed(poses, metric), tuple(notes)


def _files(out: Path, names: Sequence[str]) -> list[Path]:
    if len(names) == 1:
        return [out if out.suffix else out.with_suffix(".tum")]
    slugs = (name.lower().replace("/", "_").replace(" ", "_") for name in names)
    return [out.with_suffix("") / f"{slug}.tum" for slug in slugs]


def _passes(scene: Scene) -> dict[str, np.ndarray]:
    """Frames of each pass in order; loose photographs in the order of their names."""
    if not scene.sequences:
        return {"": np.arange(scene.frames)}
    frames = {name: scene.in_order(scene.sequence == k) for k, name in enumerate(scene.sequences)}
    return {name: own for name, own in frames.items() if len(own)}


def _rig_from_body(run: Run) -> np.ndarray:
    """(4, 4) of the rig file's body, of the poses of a trajectory; the reference camera if there is none."""
    given, tuning = run.inputs.rig, run.settings.tuning.scan.rig
    known = rig_of_run(given)
    if known is not None:
        specs = parse_rig_file(Path(str(given)), known.text, tuning)
    elif given is not None and names_file(given):
        specs = read_rig_file(given, tuning)
    else:
        return np.eye(4)
    pose = specs[0].rig_from_body()
    return np.eye(4) if pose is None else pose


def _follow(run: Run, scene: Scene, cameras: Cameras, frames: np.ndarray) -> tuple[OdometryPath, list[str]]:
    tuning, unread = run.settings.tuning.odometry, []
    image_of = {(int(scene.frame[k]), int(scene.sensor[k])): scene.names[k] for k in range(len(scene))}
    masked = run.path("masks").is_dir()

    def read(frame: int, camera: int) -> np.ndarray | None:
        name = image_of.get((frame, camera))
        return None if name is None else read_pixels(run.path("images", name))

    def mask(frame: int, camera: int) -> np.ndarray | None:
        return read_pixels(run.path("masks", f"{image_of[frame, camera]}.png")) if masked else None

    engine = Odometry(cameras, read, tuning)
    run.reporter.total(len(frames))
    for frame in frames.tolist():
        images = {c: read(frame, c) for c in range(len(cameras))}
        there = {c: image for c, image in images.items() if image is not None}
        unread += [image_of[frame, c] for c, i in images.items() if i is None and (frame, c) in image_of]
        masks = {c: m for c in there if (m := mask(frame, c)) is not None}
        engine.add(frame, there, masks)
        run.reporter.advance()
    engine.finish()
    notes = [f"{len(unread)} images cannot be read, the first is {unread[0]}"] if unread else []
    return path_of(engine, frames.tolist(), tuning.map), notes


def _write(tum: Path, scene: Scene, frames: np.ndarray, path: OdometryPath, rig_from_body: np.ndarray) -> None:
    poses = path.world_from_rig @ rig_from_body
    timed = np.isfinite(scene.time_s[frames]).all()
    times = scene.time_s[frames] if timed else np.arange(len(frames), dtype=float)
    head = [
        "# visual odometry of tiegraph; poses of the rig's body, or of its first camera (x right, y down, z forward)",
        *([] if path.metric else [FREE_UNIT]),
        *([] if timed else ["# the images have no times: numbers of the frames replace them"]),
    ]
    rows: list[str] = []
    table: list[list[str]] = []
    place, turn = path.sigmas()
    for k, frame in enumerate(frames.tolist()):
        start = [scene.source_name(int(np.flatnonzero(scene.frame == frame)[0])), f"{times[k]:.6f}"]
        if path.segment[k] < 0:
            table.append([*start, "", "0", *[""] * 13])
            continue
        numbers = [f"{v:.9f}" for v in (*poses[k, :3, 3], *quaternion_xyzw(poses[k, :3, :3]))]
        sigmas = [f"{v:.3g}" for v in (*place[k], *turn[k])]
        table.append([*start, str(path.segment[k]), str(int(path.keyframe[k])), *numbers, *sigmas])
        if path.segment[k] == path.main():
            rows.append(" ".join([f"{times[k]:.6f}", *numbers]))
    tum.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(tum, "\n".join([*head, "# time x y z qx qy qz qw", *rows]) + "\n")
    write_atomic(tum.with_suffix(".csv"), csv_text(_COLUMNS, table))


def _told(name: str, scene: Scene, frames: np.ndarray, path: OdometryPath) -> list[str]:
    unit, posed = ("m" if path.metric else "units"), path.segment >= 0
    own = np.flatnonzero(path.segment == path.main())
    steps = np.linalg.norm(np.diff(path.world_from_rig[own, :3, 3], axis=0), axis=1)
    last = float(np.linalg.norm(path.sigmas()[0][own[-1]]))
    out = [
        f"{name + ': ' if name else ''}{posed.sum()} of {len(frames)} frames, {steps.sum():.4g} {unit}, sigma at the "
        f"end {last:.2g} {unit}, {path.keyframe.sum()} keyframes, {path.loops} places revisited"
    ]
    if not path.metric:
        out.append("a single camera gives no scale: the first base line has length 1, and the file says so")
    if not scene.sequences:
        out.append("loose photographs: taken in the order of their names")
    if not posed.all():
        lost = np.flatnonzero(~posed)
        out.append(f"{len(lost)} frames have no pose, the first is {scene.frame_names[frames[lost[0]]]}")
    for other in range(path.segment.max() + 1):
        if other != path.main():
            rows = np.flatnonzero(path.segment == other)
            first, end = (scene.frame_names[frames[k]] for k in (rows[0], rows[-1]))
            out.append(
                f"segment {other}, {len(rows)} frames from {first} to {end}, could not be joined: it is in the CSV "
                "only, in its own world"
            )
    return out
