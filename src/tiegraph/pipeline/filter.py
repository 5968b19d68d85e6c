"""Glue of filter: matched pairs that contradict the rig or loops of frames are refused before the mapping."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tiegraph.filter.filter import filter_pairs
from tiegraph.filter.prior import Prior
from tiegraph.pipeline.files import checked, load_npz, pairs_of, reading, save_npz
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome


def filter(run: Run) -> Outcome:
    """Pairs whose matches agree with one motion of the rig and with loops; the database stays as `match` left it."""
    done = [0]

    def run_map(function: Callable[..., Any], items: Sequence[Any], *args: Any) -> list[Any]:
        run.reporter.total(done[0] + len(items), done[0])
        done[0] += len(items)
        return run.map(function, items, *args)

    scene, pairs, settings = checked(run), pairs_of(run, "match.npz"), run.settings.filter
    tuning = run.settings.tuning.filter
    found = filter_pairs(run.path("database.db"), scene, pairs, settings, tuning, run_map, _prior(run))
    save_npz(run.path("filter.npz"), **found.pairs.to_npz(), undecided=found.undecided, **found.motions.to_npz())
    return Outcome(found.counts, notes=found.notes, tables=found.tables)


def _prior(run: Run) -> Prior | None:
    """The coarse model, where it is trusted."""
    path = run.path("coarse", "model.npz")
    if not path.exists():
        return None
    with reading(path):
        data = load_npz(path)
        poses = np.where(data["trusted"][:, None, None], data["cam_from_world"], np.nan)
        return Prior(poses, data["reach"])
