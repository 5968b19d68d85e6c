"""Frames whose verified matches contradict their place are left out of a model, each with its reason."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.registered import LEFT_OUT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.placement.consistency import ConsistencyVotes, consistency_votes, suspect_frames
from tiegraph.sfm.tuning.placement import ConsistencyTuning, PlacementTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, agreement, image_observations, read_verified
from tiegraph.text import some

_NAMED = 4  # frames that a remark names; the table has all
_LEAST = 5  # frames that a table shows


@dataclass(frozen=True)
class MatchSource:
    """Where the verified matches are: the database, and pairs (scene indices) that do not count."""

    database: Path
    refused: Sequence[tuple[int, int]] = ()

    def read(self, scene: Scene) -> VerifiedMatches:
        """These matches."""
        return read_verified(self.database, scene, self.refused)


@dataclass(frozen=True)
class Explained:
    """Which verified matches a model explains, by pair of images (``agreement``), and why frames stand in doubt:
    single ones, and ``parts`` that stand wrong together."""

    scene: Scene
    verified: VerifiedMatches
    seen: ImageObservations
    agreed: np.ndarray
    votes: ConsistencyVotes
    parts: Mapping[tuple[int, ...], str]
    tuning: ConsistencyTuning

    @property
    def doubts(self) -> dict[int, str]:
        """By frame."""
        return {f: why for frames, why in self.parts.items() for f in frames}

    def percent(self) -> float:
        """Of the matches that have an opinion."""
        return float(50 * self.agreed[:, :2].sum() / max(self.agreed[:, 2].sum(), 1.0))

    def of_frames(self) -> np.ndarray:
        """(F, 2): matches of each frame with others that are explained, and all."""
        agree, against = (np.asarray(table.sum(axis=1)) for table in (self.votes.agree, self.votes.against))
        return np.column_stack([agree, agree + against])

    def table(self) -> dict:
        """The frames of whose matches with other frames the model explains least."""
        matches = self.of_frames()
        share = matches[:, 0] / np.maximum(matches[:, 1], 1)
        least = [f for f in np.argsort(share, kind="stable").tolist() if matches[f, 1] > 0][:_LEAST]
        rows = [[self.scene.frame_names[f], int(matches[f, 1]), round(100 * float(share[f]), 1)] for f in least]
        return {"columns": ["frame", "matches", "explained %"], "rows": rows}


def explained(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> Explained:
    """Ask a model for all its verified matches."""
    seen = image_observations(model, scene, tuning.agreement)
    agreed = agreement(verified, seen)
    votes = consistency_votes(verified, agreed, scene)
    parts = suspect_frames({int(scene.frame[k]) for k in seen.cameras}, votes, tuning.consistency)
    return Explained(
        scene=scene, verified=verified, seen=seen, agreed=agreed, votes=votes, parts=parts, tuning=tuning.consistency
    )


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
    why = explained(model, scene, source.read(scene), tuning).doubts
    if not why:
        return PlacementCheck()
    notes: list[str] = []
    if len(why) > tuning.max_left_out * scene.frames:
        notes.append(f"{len(why)} of {scene.frames} frames stand in doubt: none is left out ({named(why, scene)})")
        return PlacementCheck(notes)
    notes.append(
        f"{len(why)} of {scene.frames} frames stood at a doubtful place and were left out; see the table of placement"
    )
    rows: list[list[str]] = []
    dropped: list[tuple[str, str]] = []
    for frame, reason in sorted(why.items()):
        names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
        for frame_id in frame_ids(model, scene, frame):
            model.deregister_frame(frame_id)
        rows.append([names[0], reason])
        dropped += [(name, f"{LEFT_OUT}{reason}") for name in names]
    return PlacementCheck(notes, {"columns": ["frame", "left out because"], "rows": rows}, dropped)


def frame_ids(model: pycolmap.Reconstruction, scene: Scene, frame: int) -> list[int]:
    """Of a frame of the scene those of COLMAP that are in the model: without a rig one an image."""
    names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
    there = [image for name in names if (image := model.find_image_with_name(name)) is not None]
    return sorted({image.frame_id for image in there if image.has_pose})


def named(frames: Iterable[int], scene: Scene) -> str:
    """The first of some frames."""
    return some([scene.frame_names[f] for f in sorted(frames)], _NAMED)
