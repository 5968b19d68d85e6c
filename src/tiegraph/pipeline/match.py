"""Glue of match: the listed pairs matched and verified."""

from pathlib import Path

import numpy as np

from tiegraph.child import cores
from tiegraph.features.matchblocks import Rules, Side, match_pairs
from tiegraph.gpu import on_gpu
from tiegraph.pipeline.files import checked, pairs_of, save_npz
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene import colmapdatabase as database
from tiegraph.text import some


def forget_matches(folder: Path) -> None:
    """Clear the rows of match in the shared database."""
    if (folder / "database.db").exists():
        database.clear_matches(folder / "database.db")


def match(run: Run) -> Outcome:
    """Match and verify exactly the listed pairs."""

    def progress(done: int, total: int) -> None:
        run.reporter.total(total, done)

    scene = checked(run)
    asked = pairs_of(run, "pairs.npz")
    side = Side(run.workers, run.map_untold) if run.distributed else Side(min(run.workers, cores()))
    rules = Rules(run.settings.match, run.settings.tuning.features.verification)
    pairs, report = match_pairs(run.path("database.db"), scene, asked, rules, run.log, progress, side)
    save_npz(run.path("match.npz"), **pairs.to_npz())
    alone = np.flatnonzero(pairs.degree(len(scene)) == 0)
    lonely = (
        (f"{len(alone)} images have no verified pair: {some((scene.names[k] for k in alone), 5)}",)
        if len(alone)
        else ()
    )
    notes = (*lonely, *(("matched by COLMAP on a GPU",) if on_gpu() else ()))
    kinds = {"columns": ["two-view geometry", "pairs"], "rows": [[k, n] for k, n in report.configurations.items()]}
    counts = {n: getattr(report, n) for n in ("asked", "matched", "verified", "matches", "inliers")}
    return Outcome(counts, dropped=report.lost, notes=notes, tables={"two-view geometries": kinds})
