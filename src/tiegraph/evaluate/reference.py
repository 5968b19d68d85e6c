"""Reference data: poses from a COLMAP model or TUM files, brought into the run's world."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.evaluate.trajectory import PoseMatch
from tiegraph.geometry import geodesy, transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import umeyama
from tiegraph.scene.colmapmodel import image_poses, is_model, matrix, registered_images
from tiegraph.scene.namedposes import read_named_poses
from tiegraph.scene.posefile import read_poses
from tiegraph.scene.scene import Scene
from tiegraph.text import some

_NAMED = 3  # frames without a reference that are named


@dataclass(frozen=True)
class ModelPoses:
    """Poses of a sparse model in scene order: world_from_camera (N, 4, 4), world_from_rig (F, 4, 4); NaN = not in."""

    world_from_camera: np.ndarray
    world_from_rig: np.ndarray

    @property
    def placed(self) -> np.ndarray:
        """(N,) bool: has a pose, registered or placed by its rig (``scene.colmapmodel``)."""
        return np.isfinite(self.world_from_camera[:, 0, 0])

    def centres(self) -> np.ndarray:
        """(R, 3) projection centres of the images that have a pose."""
        return self.world_from_camera[self.placed, :3, 3]


@dataclass(frozen=True)
class ReferencePoses:
    """Reference poses of images by name, or of rigs in time order by pass ("" = one file for all)."""

    by_image: dict[str, np.ndarray]  # name -> world_from_camera (4, 4)
    by_sequence: dict[str, tuple[np.ndarray, np.ndarray]]  # pass -> time_s (T,), world_from_rig (T, 4, 4)
    path: Path


def model_poses(reconstruction: Any, scene: Scene) -> ModelPoses:
    """Poses of a ``pycolmap.Reconstruction`` in the scene's order.

    The rig pose of a frame is the pose of the rig's first camera (its frame is the rig frame); where that image is
    missing, it is the model's own ``rig_from_world`` if the model has this rig, else NaN.
    """
    cameras = transforms.invert(image_poses(reconstruction, scene))
    rigs = np.full((scene.frames, 4, 4), np.nan)
    second = np.full((scene.frames, 4, 4), np.nan)
    for k, image in registered_images(reconstruction, scene):
        frame, placed = scene.frame[k], reconstruction.frame(image.frame_id)
        if scene.sensor[k] == 0:
            rigs[frame] = cameras[k]
        elif reconstruction.rig(placed.rig_id).num_sensors() > 1:
            second[frame] = transforms.invert(matrix(placed.rig_from_world))
    return ModelPoses(cameras, np.where(np.isnan(rigs), second, rigs))


def read_reference_poses(path: Path) -> ReferencePoses:
    """Read a COLMAP model folder, a TUM file or a folder of TUM files. Raises InputError naming the file."""
    if path.is_dir() and is_model(path):
        return ReferencePoses(read_named_poses(path), {}, path)
    if path.is_dir():
        files = sorted(p for p in path.iterdir() if p.suffix in (".tum", ".txt"))
        if not files:
            raise InputError(f"{path}: neither a COLMAP model (images.bin or images.txt) nor TUM files (*.tum) in it")
        return ReferencePoses({}, {p.stem: read_tum(p) for p in files}, path)
    if not path.exists():
        raise InputError(f"{path}: no such reference; give a COLMAP model folder, a TUM file or a folder of TUM files")
    return ReferencePoses({}, {"": read_tum(path)}, path)


def check_reference(path: Path) -> None:
    """Raise InputError for reference poses that cannot be used, without reading a COLMAP model."""
    if not (path.is_dir() and is_model(path)):
        read_reference_poses(path)


def read_tum(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """time_s (T,) and world_from_body (T, 4, 4) of a TUM or EuRoC file (time tx ty tz qx qy qz qw), sorted by time.

    Raises InputError, naming file and line.
    """
    found = read_poses(path)
    if np.isnan(found.time_s).any():
        raise InputError(f"{path}: poses without times; expected lines 'time tx ty tz qx qy qz qw'")
    return found.time_s, found.poses


def match_poses(reference: ReferencePoses, model: ModelPoses, scene: Scene, max_gap_s: float) -> tuple[PoseMatch, str]:
    """The model's poses beside the reference's, interpolated over ``max_gap_s`` at most, and what was matched in words.

    Raises InputError when fewer than three poses have a reference.
    """
    if reference.by_image:
        match, said = _match_images(reference, model, scene)
    else:
        match, said = _match_frames(reference, model, scene, max_gap_s)
    if len(match) < 3:
        raise InputError(
            f"{reference.path}: only {len(match)} poses of the model have a reference ({said}); 3 are needed"
        )
    return match, said


def _match_images(reference: ReferencePoses, model: ModelPoses, scene: Scene) -> tuple[PoseMatch, str]:
    known = np.array([name in reference.by_image for name in scene.names], bool)
    rows = np.flatnonzero(known & model.placed)
    frame, labels = scene.frame[rows], scene.image_label()
    names = np.array([" ".join(labels[k]).strip() for k in rows], str)
    number = np.unique(names, return_inverse=True)[1]
    match = PoseMatch(
        estimate=model.world_from_camera[rows],
        reference=np.array([reference.by_image[scene.names[k]] for k in rows]).reshape(-1, 4, 4),
        group=np.where(scene.sequence[frame] >= 0, number, -1),
        order=scene.sequence_index[frame],
        parts={**frame_parts(scene, frame), "pass and camera": names},
    )
    return match, f"images by name: {len(rows)} placed of {known.sum()} with a reference ({len(scene)} in all)"


def _match_frames(
    reference: ReferencePoses, model: ModelPoses, scene: Scene, max_gap_s: float
) -> tuple[PoseMatch, str]:
    truth, how = _frame_poses(reference, scene, max_gap_s)
    known = np.isfinite(truth[:, 0, 0])
    rows = np.flatnonzero(known & np.isfinite(model.world_from_rig[:, 0, 0]))
    match = PoseMatch(
        estimate=_with_mount(model.world_from_rig[rows], truth[rows]),
        reference=truth[rows],
        group=scene.sequence[rows],
        order=scene.sequence_index[rows],
        parts=frame_parts(scene, rows),
    )
    none = f"no file of {', '.join(reference.by_sequence)} is named after a pass {', '.join(scene.sequences)}"
    names = [scene.names[int(np.argmax(scene.frame == f))] for f in np.flatnonzero(~known)[:_NAMED]]
    without = f"; none for {some(names, _NAMED, int(np.sum(~known)))}" if names else ""
    counts = f"{len(rows)} placed of {known.sum()} with a reference ({scene.frames} frames in all{without})"
    return match, f"rig poses, {'; '.join(how) or none}: {counts}, one constant turn of the axes removed"


def frame_parts(scene: Scene, frames: np.ndarray) -> dict[str, np.ndarray]:
    """What frames (K,) lie in: their passes, and their sections where the survey was cut into some."""
    out = {"pass": np.array([scene.sequences[s] if s >= 0 else "(loose)" for s in scene.sequence[frames]])}
    if len(np.unique(scene.section)) > 1:
        out["section"] = np.array([f"{s}" if s >= 0 else "(none)" for s in scene.section[frames]])
    return out


def _frame_poses(reference: ReferencePoses, scene: Scene, max_gap_s: float) -> tuple[np.ndarray, list[str]]:
    """(F, 4, 4) reference poses of the frames by the files of their passes, NaN = none, and how each was found: by time
    if the frames have times that the file covers, else one by one."""
    truth = np.full((scene.frames, 4, 4), np.nan)
    how: list[str] = []
    one = reference.by_sequence.get("")
    timed = one is not None and _covers(one, scene.time_s, max_gap_s)  # then poses are of their times, not of an order
    for number, name in [*enumerate(scene.sequences), (-1, "")]:
        frames = scene.in_order(scene.sequence == number)
        files = ("", name, f"rig_{name}", Path(name).name)
        found = next((reference.by_sequence[file] for file in files if file in reference.by_sequence), None)
        if found is None or not len(frames):
            continue
        stamps, poses = found
        if _covers(found, scene.time_s[frames], max_gap_s):
            truth[frames] = transforms.interpolate(stamps, poses, scene.time_s[frames], max_gap_s)
            how.append(f"{name or 'frames'} by time")
        elif timed:
            how.append(f"{name or 'frames'} at none of its times")
        elif len(poses) == len(frames):
            truth[frames] = poses
            how.append(f"{name or 'frames'} in order")
        else:
            raise InputError(
                f"{reference.path}: {len(poses)} poses for {len(frames)} frames of {name or 'the frames'}, and no "
                "common times: give a COLMAP model, or as many poses as frames, or the frames' times by --times"
            )
    return truth, how


def _covers(found: tuple[np.ndarray, np.ndarray], time_s: np.ndarray, max_gap_s: float) -> bool:
    """Whether stamped poses tell a pose at any of some times (NaN = not known)."""
    known = bool(np.isfinite(time_s).any())
    return known and bool(np.isfinite(transforms.interpolate(*found, time_s, max_gap_s)[:, 0, 0]).any())


def reference_places(reference: ReferencePoses, scene: Scene, max_gap_s: float) -> np.ndarray:
    """(N, 3) where the reference has the cameras, NaN = nowhere; one that follows the rig tells of its first camera.

    Raises InputError as ``match_poses`` does.
    """
    nowhere = np.full((4, 4), np.nan)
    if reference.by_image:
        return np.array([reference.by_image.get(name, nowhere)[:3, 3] for name in scene.names]).reshape(-1, 3)
    truth, _ = _frame_poses(reference, scene, max_gap_s)
    return np.where(scene.sensor[:, None] == 0, truth[scene.frame, :3, 3], np.nan)


def _with_mount(estimate: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The estimated poses with the body axes turned by the one rotation that fits the reference's best.

    A reference may follow a vehicle whose axes are not the rig's: R_ref ~ R_align R_est M. The relative turns between
    frames fix M; a lever arm is not removed.
    """
    if len(estimate) < 3:
        return estimate
    fit = umeyama(estimate[:, :3, 3], reference[:, :3, 3])
    turned = fit.rotation @ estimate[:, :3, :3]
    mount = Rotation.from_matrix(np.swapaxes(turned, 1, 2) @ reference[:, :3, :3]).mean()  # of (R_align R_est)^T R_ref
    return transforms.rigid(estimate[:, :3, :3] @ mount.as_matrix(), estimate[:, :3, 3])


def to_world(points: np.ndarray, source: Origin, world: Origin) -> np.ndarray:
    """Points (N, 3) of one world in another, through geodetic coordinates (exact, no alignment)."""
    out = np.empty((len(points), 3))
    for start in range(0, len(points), 500_000):
        part = slice(start, start + 500_000)
        out[part] = geodesy.world_from_geodetic(geodesy.geodetic_from_world(points[part], source), world)
    return out


def poses_to_world(match: PoseMatch, source: Origin, world: Origin) -> PoseMatch:
    """The reference poses of a match in the run's world: positions exact, axes turned as the two frames differ."""
    positions = match.reference[:, :3, 3]
    corner = positions.mean(axis=0) + np.vstack([np.zeros(3), np.eye(3)])
    turned = umeyama(corner, to_world(corner, source, world)).rotation @ match.reference[:, :3, :3]
    return replace(match, reference=transforms.rigid(turned, to_world(positions, source, world)))
