"""Frames whose verified matches contradict their place are left out of a model, each with its reason."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import image_poses, model_rigs
from tiegraph.scene.registered import LEFT_OUT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.placement.consistency import ConsistencyCheck, check_consistency, consistency_votes
from tiegraph.sfm.placement.continuity import motion_continuity
from tiegraph.sfm.tuning.placement import PlacementTuning
from tiegraph.sfm.verified import VerifiedMatches, agreement, image_observations, read_verified
from tiegraph.text import some

_NAMED = 4  # frames that a remark names; the table has all


@dataclass(frozen=True)
class MatchSource:
    """Where the verified matches are: the database, and pairs (scene indices) that do not count."""

    database: Path
    refused: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True)
class PlacementCheck:
    """What people should know, a table {"columns", "rows"} of the frames left out, and (image, reason) of each."""

    notes: list[str] = field(default_factory=list)
    table: dict | None = None
    dropped: list[tuple[str, str]] = field(default_factory=list)


def leave_out_doubtful(
    model: pycolmap.Reconstruction,
    scene: Scene,
    source: MatchSource,
    preview: np.ndarray | None,
    tuning: PlacementTuning,
) -> PlacementCheck:
    """Test the place of every frame and take the doubtful ones out of ``model``.

    ``preview``: (F, 4, 4) world_from_rig in a rough model that is believed. Where more than ``tuning.max_left_out`` of
    the frames stand in doubt the model fell apart: none is taken out, and it is said.
    """
    verified = read_verified(source.database, scene, source.refused)
    check = _judged(model, scene, verified, preview, tuning)
    notes, why = _beyond_notes(check, scene), _reasons(check)
    if not why:
        return PlacementCheck(notes)
    if len(why) > tuning.max_left_out * scene.frames:
        notes.append(f"{len(why)} of {scene.frames} frames stand in doubt: none is left out ({_named(why, scene)})")
        return PlacementCheck(notes)
    notes.append(
        f"{len(why)} of {scene.frames} frames stood at a doubtful place and were left out; see the table of placement"
    )
    rows: list[list[str]] = []
    dropped: list[tuple[str, str]] = []
    for frame, reason in sorted(why.items()):
        names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
        for frame_id in _ids(model, scene, frame):
            model.deregister_frame(frame_id)
        rows.append([names[0], reason])
        dropped += [(name, f"{LEFT_OUT}{reason}") for name in names]
    return PlacementCheck(notes, {"columns": ["frame", "left out because"], "rows": rows}, dropped)


def doubted_frames(
    model: pycolmap.Reconstruction,
    scene: Scene,
    verified: VerifiedMatches,
    preview: np.ndarray | None,
    tuning: PlacementTuning,
) -> list[int]:
    """COLMAP's ids of the frames whose place is doubtful; ``preview``: see ``leave_out_doubtful``."""
    doubted = _reasons(_judged(model, scene, verified, preview, tuning))
    return [frame_id for frame in sorted(doubted) for frame_id in _ids(model, scene, frame)]


def _ids(model: pycolmap.Reconstruction, scene: Scene, frame: int) -> list[int]:
    """Of a frame of the scene those of COLMAP that are in the model: without a rig one an image."""
    names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
    there = [image for name in names if (image := model.find_image_with_name(name)) is not None]
    return sorted({image.frame_id for image in there if image.has_pose})


def _reasons(check: ConsistencyCheck) -> dict[int, str]:
    return {frame: suspect.why for suspect in check.suspects for frame in suspect.frames}


def _judged(
    model: pycolmap.Reconstruction,
    scene: Scene,
    verified: VerifiedMatches,
    preview: np.ndarray | None,
    tuning: PlacementTuning,
) -> ConsistencyCheck:
    poses = frame_poses(image_poses(model, scene), scene.with_(rigs=model_rigs(model, scene)))
    centres = poses[:, :3, 3]
    rough = None if preview is None else preview[:, :3, 3]
    course = motion_continuity(centres, scene, rough, tuning.consistency)
    agreed = agreement(verified, image_observations(model, scene, tuning.agreement))
    return check_consistency(centres, scene, course, consistency_votes(verified, agreed, scene, tuning.consistency))


def _beyond_notes(check: ConsistencyCheck, scene: Scene) -> list[str]:
    if not check.beyond:
        return []
    return [
        f"{len(check.beyond)} frames stand where the course of their pass jumps, and their ties hold them there: they "
        f"stay ({_named(check.beyond, scene)})"
    ]


def _named(frames: Iterable[int], scene: Scene) -> str:
    return some([scene.frame_names[f] for f in sorted(frames)], _NAMED)
