"""Frames whose verified matches contradict their place are left out of a model, each with its reason."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.registered import LEFT_OUT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.placement.consistency import consistency_votes, suspect_frames
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
    model: pycolmap.Reconstruction, scene: Scene, source: MatchSource, tuning: PlacementTuning
) -> PlacementCheck:
    """Test the place of every frame and take the doubtful ones out of ``model``.

    Where more than ``tuning.max_left_out`` of the frames stand in doubt the model fell apart: none is taken out, and it
    is said.
    """
    why = _doubts(model, scene, read_verified(source.database, scene, source.refused), tuning)
    if not why:
        return PlacementCheck()
    notes: list[str] = []
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
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> list[int]:
    """COLMAP's ids of the frames whose place is doubtful."""
    doubted = _doubts(model, scene, verified, tuning)
    return [frame_id for frame in sorted(doubted) for frame_id in _ids(model, scene, frame)]


def _ids(model: pycolmap.Reconstruction, scene: Scene, frame: int) -> list[int]:
    """Of a frame of the scene those of COLMAP that are in the model: without a rig one an image."""
    names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
    there = [image for name in names if (image := model.find_image_with_name(name)) is not None]
    return sorted({image.frame_id for image in there if image.has_pose})


def _doubts(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> dict[int, str]:
    """Why frames stand in doubt."""
    seen = image_observations(model, scene, tuning.agreement)
    votes = consistency_votes(verified, agreement(verified, seen), scene, tuning.consistency)
    suspects = suspect_frames({int(scene.frame[k]) for k in seen.cameras}, scene, votes)
    return {frame: suspect.why for suspect in suspects for frame in suspect.frames}


def _named(frames: Iterable[int], scene: Scene) -> str:
    return some([scene.frame_names[f] for f in sorted(frames)], _NAMED)
