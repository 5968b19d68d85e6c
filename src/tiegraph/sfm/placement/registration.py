"""Placement and completeness of a mapped model, before its final adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.colmapdatabase import image_ids
from tiegraph.scene.registered import LEFT_OUT
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.database import write_working_copy
from tiegraph.sfm.placement.guidedmatching import Descriptors
from tiegraph.sfm.placement.guidedregistration import GuidedResult, guided_registration
from tiegraph.sfm.placement.missing import register_missing
from tiegraph.sfm.placement.repair import Repair, label, points_anew, repair
from tiegraph.sfm.tuning.placement import PlacementTuning
from tiegraph.sfm.verified import read_verified


@dataclass(frozen=True)
class RegistrationResult:
    """The model, and what became of frames: notes, table of what was moved, images left out with their reason."""

    model: pycolmap.Reconstruction
    notes: list[str] = field(default_factory=list)
    table: dict | None = None
    dropped: list[tuple[str, str]] = field(default_factory=list)


@dataclass(frozen=True)
class MatchSource:
    """Where the verified matches are: database, folder of the images, refused pairs; and a folder to work in."""

    database: Path
    images: Path
    refused: Sequence[tuple[int, int]]
    scratch: Path


def repair_registration(
    model: pycolmap.Reconstruction,
    scene: Scene,
    source: MatchSource,
    rigs: dict[int, Rig],
    preview: np.ndarray | None,
    tuning: PlacementTuning,
    skip: frozenset[int] = frozenset(),
) -> RegistrationResult:
    """Test the place of every frame, place the doubtful again or leave them out, place what is missing.

    ``preview``: (F, 4, 4) world_from_rig in a rough model that is believed; ``skip``: keys of sensors that the rig
    alone places.
    """
    database, scratch = source.database, source.scratch
    work = Repair(
        model=model,
        scene=scene,
        verified=read_verified(database, scene, source.refused),
        preview=preview,
        tuning=tuning,
    )
    registered = model.num_reg_images()
    scratch.mkdir(parents=True, exist_ok=True)
    working = scratch / "placement.db"

    def anew() -> None:
        if not working.exists():
            write_working_copy(database, working, scene, rigs, None, source.refused)
        work.model = points_anew(work.model, working, source.images, scratch, tuning.repair)

    if repair(work):
        anew()
    ids = image_ids(database, scene)
    adopted: dict[int, int] = {}
    for _ in range(tuning.missing_rounds):
        found = register_missing(work, ids)
        if not found:
            break
        adopted.update(found)
        anew()
    working.unlink(missing_ok=True)
    done = guided_registration(work, ids, Descriptors(database, ids), skip)
    notes = [*_notes(work, registered, adopted), *_guided_notes(done)]
    return RegistrationResult(
        model=work.model, notes=notes, table=_table(work, adopted, done), dropped=_dropped(work, done)
    )


def _guided_notes(done: GuidedResult) -> list[str]:
    notes = []
    if done.placed:
        notes.append(f"{len(done.placed)} images were placed by guided matching where their neighbours predict them")
    if done.tied:
        notes.append(f"{len(done.tied)} images that hung on the rig were tied by guided matching")
    return notes


def _notes(work: Repair, registered: int, adopted: dict[int, int]) -> list[str]:
    notes = list(work.notes)
    if work.beyond:
        shown = ", ".join(label(work.scene, f) for f in work.beyond[:4]) + (" ..." if len(work.beyond) > 4 else "")
        notes.append(
            f"{len(work.beyond)} frames stand where the course of their pass jumps, and their ties hold them there: "
            f"they stay ({shown})"
        )
    if work.moved:
        far = max(distance for _, distance, _ in work.moved)
        frames = ", ".join(label(work.scene, f) for f, _, _ in work.moved[:4]) + (" ..." if len(work.moved) > 4 else "")
        notes.append(
            f"{len(work.moved)} frames stood at a wrong place and were placed again, up to {far:.2f} units: {frames}"
        )
    if work.left_out:
        notes.append(
            f"{len(work.left_out)} frames stood at a doubtful place and were left out; see the table of placement"
        )
    if adopted:
        notes.append(
            f"{len(adopted)} images that the mapper left out were placed by their matches ({registered} before)"
        )
    return notes


def _table(work: Repair, adopted: dict[int, int], done: GuidedResult) -> dict | None:
    rows = [[label(work.scene, f), "placed again", round(d, 3), why] for f, d, why in work.moved]
    rows += [[label(work.scene, f), "left out", None, why] for f, why in work.left_out]
    rows += [
        [work.scene.names[k], "placed", None, f"{n} points of its frame agree"] for k, n in sorted(adopted.items())
    ]
    for what, table in (("placed, guided", done.placed), ("tied, guided", done.tied)):
        rows += [[work.scene.names[k], what, None, f"sees {n} points"] for k, n in sorted(table.items())]
    return {"columns": ["frame or image", "what", "by (units)", "why"], "rows": rows} if rows else None


def _dropped(work: Repair, done: GuidedResult) -> list[tuple[str, str]]:
    out = [(work.scene.names[k], why) for k, why in sorted(done.why.items())]
    for frame, why in work.left_out:
        out += [(work.scene.names[k], f"{LEFT_OUT}{why}") for k in np.flatnonzero(work.scene.frame == frame)]
    return out
