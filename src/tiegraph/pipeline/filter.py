"""Glue of filter: matched pairs that contradict the coarse model or loops are refused before the mapping."""

from collections.abc import Callable, Sequence
from typing import Any

from tiegraph.filter.filter import Prior, filter_pairs
from tiegraph.pipeline.files import checked, pairs_of, save_npz, trusted_poses
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome


def filter(run: Run) -> Outcome:
    """Pairs whose matches agree with the coarse model or with loops; the database of `match` stays unchanged."""
    done = [0]

    def run_map(function: Callable[..., Any], items: Sequence[Any], *args: Any) -> list[Any]:
        run.reporter.total(done[0] + len(items), done[0])
        done[0] += len(items)
        return run.map(function, items, *args)

    scene, pairs, settings = checked(run), pairs_of(run, "match.npz"), run.settings.filter
    tuning = run.settings.tuning.filter
    known = trusted_poses(run.folder)
    prior = None if known is None else Prior(*known)
    found = filter_pairs(run.path("database.db"), scene, pairs, settings, tuning, run_map, prior)
    save_npz(run.path("filter.npz"), **found.pairs.to_npz(), undecided=found.undecided)
    return Outcome(found.counts, notes=found.notes, tables=found.tables)
