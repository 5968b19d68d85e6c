"""Doubtful frames are placed again, missing ones placed, and the points made anew where something moved.

A place off the course of a pass is asked of the ties once more, and what they say decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, image_poses, matrix, model_rigs, rigid3d
from tiegraph.sfm.placement.consistency import (
    ConsistencyCheck,
    SuspectFrames,
    check_consistency,
    consistency_score,
    consistency_votes,
    neighbours,
)
from tiegraph.sfm.placement.continuity import MotionContinuity, motion_continuity
from tiegraph.sfm.placement.resection import Resection, correspondences, resect
from tiegraph.sfm.solver import THREADS
from tiegraph.sfm.tuning.placement import PlacementTuning, RepairTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, agreement, image_observations


@dataclass
class Repair:
    """A model in work: its poses, what was done and why."""

    model: pycolmap.Reconstruction
    scene: Scene
    verified: VerifiedMatches
    preview: np.ndarray | None  # (F, 4, 4) world_from_rig of the coarse model, units of its own
    tuning: PlacementTuning
    moved: list[tuple[int, float, str]] = field(default_factory=list)  # frame, how far, why
    left_out: list[tuple[int, str]] = field(default_factory=list)
    beyond: tuple[int, ...] = ()  # frames that only their ties hold where they are: the course of their pass jumps
    notes: list[str] = field(default_factory=list)

    def poses(self) -> np.ndarray:
        """world_from_rig (F, 4, 4), model units."""
        scene = self.scene.with_(rigs=model_rigs(self.model, self.scene))
        return frame_poses(image_poses(self.model, self.scene), scene)

    def seen(self) -> ImageObservations:
        """What the images of the model see."""
        return image_observations(self.model, self.scene, self.tuning.agreement)

    def continuity(self) -> MotionContinuity:
        """The course of the passes."""
        preview = None if self.preview is None else self.preview[:, :3, 3]
        return motion_continuity(self.poses()[:, :3, 3], self.scene, preview, self.tuning.continuity)

    def judged(self) -> ConsistencyCheck:
        """Which frames stand where they should."""
        scores = consistency_votes(
            self.verified, agreement(self.verified, self.seen()), self.scene, self.tuning.consistency
        )
        return check_consistency(self.poses()[:, :3, 3], self.scene, self.continuity(), scores)


def repair(work: Repair) -> bool:
    """Place doubtful frames again or leave them out; whether anything changed. Points are left to the caller."""
    changed = False
    for _ in range(work.tuning.repair.rounds):
        judged = work.judged()
        work.beyond = judged.beyond
        if not judged.suspects:
            break
        lost = sum(len(d.frames) for d in judged.suspects)
        if lost > work.tuning.repair.max_doubted * work.scene.frames:
            work.notes.append(f"{lost} of {work.scene.frames} frames stand in doubt: nothing is moved; see the map")
            break
        before = len(work.moved) + len(work.left_out)
        for doubt in judged.suspects:
            _settle(work, doubt, judged)
        if len(work.moved) + len(work.left_out) == before:
            break
        changed = True
    return changed


def _settle(work: Repair, doubt: SuspectFrames, judged: ConsistencyCheck) -> None:
    main = set(judged.main)
    seen = only_frames(work.seen(), work.scene, main)
    here = around(work, seen)
    if len(doubt.frames) >= work.tuning.repair.block_frames:
        motion = _block_motion(work, doubt, seen)
        if motion is not None and _ends_fit(doubt.frames, motion, here, work.scene):
            for frame in doubt.frames:
                _set(work, frame, here.poses[frame], motion @ here.poses[frame], doubt.why)
            return
    for frame in doubt.frames:
        images = np.flatnonzero(work.scene.frame == frame).tolist()
        found = place_images(work, images, seen)
        if found and found.holds(work.tuning.resection) and fits(work, images, found.pose, here):
            _set(work, frame, here.poses[frame], found.pose, doubt.why)
            here = around(work, seen, here.frames | {frame})
        elif len(work.left_out) < work.tuning.repair.max_lost * work.scene.frames:
            work.model.deregister_frame(_frame_ids(work, frame)[0])
            work.left_out.append((frame, f"{doubt.why}; its ties to the others give no other place"))
        else:
            work.notes.append(f"frame {label(work.scene, frame)} stands in doubt and was kept: {doubt.why}")


@dataclass(frozen=True)
class Around:
    """What a place is tested by: believed frames, what their images see, all poses (F, 4, 4), the course of passes."""

    frames: set[int]
    seen: ImageObservations
    poses: np.ndarray
    continuity: MotionContinuity


def around(work: Repair, seen: ImageObservations, frames: set[int] | None = None) -> Around:
    """The model as it stands; ``frames``: those believed, None = those of the images in ``seen``."""
    own = {int(work.scene.frame[k]) for k in seen.point}
    return Around(frames=own if frames is None else frames, seen=seen, poses=work.poses(), continuity=work.continuity())


def only_frames(seen: ImageObservations, scene: Scene, frames: set[int]) -> ImageObservations:
    """What the images of some frames see."""
    inside = {k for k in seen.point if int(scene.frame[k]) in frames}
    return replace(
        seen,
        cameras={k: v for k, v in seen.cameras.items() if k in inside},
        cam_from_world={k: v for k, v in seen.cam_from_world.items() if k in inside},
        point={k: v for k, v in seen.point.items() if k in inside},
    )


def place_images(work: Repair, images: Sequence[int], seen: ImageObservations) -> Resection | None:
    """Images of one frame, bolted together, from their matches with points of the images in ``seen``.

    A lone image is its own rig, whatever the scene's rig says.
    """
    rows = correspondences(images, work.verified, seen)
    if len(rows.image) < work.tuning.resection.min_inliers:
        return None
    return resect(rows, *mounts(work, images), work.tuning)


def mounts(work: Repair, images: Sequence[int]) -> tuple[dict[int, pycolmap.Camera], dict[int, np.ndarray]]:
    """Cameras and cam_from_rig (4, 4), model units, of images of a frame, where known; a lone image is its own rig."""
    sensors = model_rigs(work.model, work.scene)[work.scene.rig[work.scene.frame[images[0]]]].sensors
    cam_from_rig = {}
    for k in images:
        extrinsics = sensors[work.scene.sensor[k]].sensor_from_rig
        if len(images) == 1 or work.scene.sensor[k] == 0:
            extrinsics = np.eye(4)
        if extrinsics is not None:
            cam_from_rig[int(k)] = extrinsics
    cameras = {int(k): c for k in cam_from_rig if (c := sensors[work.scene.sensor[k]].camera) is not None}
    return cameras, cam_from_rig


def fits(work: Repair, images: Sequence[int], pose: np.ndarray, here: Around) -> bool:
    """Whether images of one frame may stand at a pose (4, 4), world_from_rig: it suits the course of the pass, or else
    their verified ties hold it there all the same."""
    frame = int(work.scene.frame[images[0]])
    if near_path(frame, pose[:3, 3], here, work.scene):
        return True
    cameras, cam_from_rig = mounts(work, images)
    there = {k: cam_from_rig[k] @ transforms.invert(pose) for k in cameras}
    beside = replace(
        here.seen,
        cameras={**here.seen.cameras, **cameras},
        cam_from_world={**here.seen.cam_from_world, **there},
    )
    own = work.verified.where(np.isin(work.verified.pairs, sorted(there)).sum(axis=1) == 1)
    scores = consistency_votes(own, agreement(own, beside), work.scene, work.tuning.consistency)
    near = neighbours(work.scene, work.tuning.consistency.near_steps)
    return consistency_score([frame], here.frames - {frame}, scores, near).holds()


def near_path(frame: int, position: np.ndarray, here: Around, scene: Scene) -> bool:
    """Whether a position suits the nearest frames before and after on the pass; frames of no pass always do."""
    sequence = int(scene.sequence[frame])
    if sequence not in here.continuity.usual:
        return True
    moved = here.poses[:, :3, 3].copy()
    moved[frame] = position
    others = [f for f in here.frames if scene.sequence[f] == sequence and f != frame and np.isfinite(moved[f]).all()]
    before = max(
        (f for f in others if scene.sequence_index[f] < scene.sequence_index[frame]),
        key=lambda f: scene.sequence_index[f],
        default=None,
    )
    after = min(
        (f for f in others if scene.sequence_index[f] > scene.sequence_index[frame]),
        key=lambda f: scene.sequence_index[f],
        default=None,
    )
    return all(not here.continuity.jumps(f, frame, moved, sequence) for f in (before, after) if f is not None)


def _ends_fit(frames: Sequence[int], motion: np.ndarray, here: Around, scene: Scene) -> bool:
    """Whether a moved block suits the main part where it meets it."""
    moved = {f: (motion @ here.poses[f])[:3, 3] for f in frames}
    return any(near_path(f, moved[f], here, scene) for f in (min(frames), max(frames)))


def _block_motion(work: Repair, doubt: SuspectFrames, seen: ImageObservations) -> np.ndarray | None:
    """main_from_block (4, 4): points of the block on points of the main part that verified ties say are the same."""
    whole, tuning = work.seen(), work.tuning.repair
    inside = set(doubt.frames)
    a, b = [], []
    ends = work.scene.frame[work.verified.pairs]
    for row, (i, j) in enumerate(work.verified.pairs.tolist()):
        sides = [int(f) in inside for f in ends[row]]
        if sum(sides) != 1:
            continue
        own, other = (i, j) if sides[0] else (j, i)
        if own not in whole.point or other not in seen.point:
            continue
        matches = work.verified.matches[row] if sides[0] else work.verified.matches[row][:, ::-1]
        p, q = whole.point[own][matches[:, 0]], whole.point[other][matches[:, 1]]
        both = (p >= 0) & (q >= 0) & (p != q)
        a += [whole.xyz[int(x)] for x in p[both]]
        b += [whole.xyz[int(x)] for x in q[both]]
    if len(a) < work.tuning.resection.min_inliers:
        return None
    source, target = np.array(a), np.array(b)
    size = float(np.median([r[0] for r in whole.reach.values()])) if whole.reach else 1.0
    bound = tuning.block_error * size
    options = pycolmap.RANSACOptions(max_error=bound, random_seed=0, max_num_trials=tuning.block_trials)
    found: Any = pycolmap.estimate_sim3d_robust(source, target, options)
    if found is None or not tuning.block_scale[0] < found["tgt_from_src"].scale < tuning.block_scale[1]:
        return None
    mapped = transforms.apply(matrix(found["tgt_from_src"]), source)
    close = np.linalg.norm(mapped - target, axis=1) < bound
    if close.sum() < work.tuning.resection.min_inliers:
        return None
    rigid = umeyama(source[close], target[close], with_scale=False)
    return transforms.rigid(rigid.rotation, rigid.translation)


def _frame_ids(work: Repair, frame: int) -> list[int]:
    """COLMAP frames of a scene's frame: one, or one an image without a rig."""
    images = [work.scene.names[k] for k in np.flatnonzero(work.scene.frame == frame)]
    found = [work.model.find_image_with_name(n) for n in images]
    return sorted({i.frame_id for i in found if i is not None})


def _set(work: Repair, frame: int, old: np.ndarray, pose: np.ndarray, why: str) -> None:
    """Put a frame somewhere else; its sightings go, to be made anew."""
    step = pose @ transforms.invert(old)
    for frame_id in _frame_ids(work, frame):
        held = work.model.frame(frame_id)
        assert held.rig_from_world is not None
        now = matrix(held.rig_from_world)
        work.model.deregister_frame(frame_id)
        work.model.frame(frame_id).rig_from_world = rigid3d(now @ transforms.invert(step))
        work.model.register_frame(frame_id)
    work.moved.append((frame, float(np.linalg.norm(pose[:3, 3] - old[:3, 3])), why))


def label(scene: Scene, frame: int) -> str:
    """A frame by its first image."""
    return scene.names[int(np.flatnonzero(scene.frame == frame)[0])]


def points_anew(
    model: pycolmap.Reconstruction, database: Path, images: Path, scratch: Path, tuning: RepairTuning
) -> pycolmap.Reconstruction:
    """All points of a model from its poses and the verified matches of the mapper's database."""
    scratch.mkdir(parents=True, exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions(
        random_seed=0,
        num_threads=THREADS,
        extract_colors=False,
        ba_global_max_refinements=tuning.refinements,
        ba_global_max_num_iterations=tuning.refine_iterations,
    )
    return pycolmap.triangulate_points(model, database, images, scratch, clear_points=True, options=options)
