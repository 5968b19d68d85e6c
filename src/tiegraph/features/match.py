"""Matching and geometric verification of exactly the listed pairs, by COLMAP in child processes, block by block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError, ReconstructionError
from tiegraph.features.matchblocks import Rules, Side, cut, run_blocks
from tiegraph.features.settings import MatchSettings
from tiegraph.scene.colmapdatabase import Rows, feature_counts, keep_finished, match_counts, strike, write_anew
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

BLOCK_PAIRS = 256  # largest loss of a process in a killed run, and the step of the progress
# Most matches lie in the image border and move alike: a caption or a part of the platform. COLMAP's mappers would
# still use the pair.
_WATERMARK = int(pycolmap.TwoViewGeometryConfiguration.WATERMARK)
_ALONE = Side()

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class MatchReport:
    """Request and result of the matcher."""

    asked: int
    matched: int  # pairs compared, now or in an earlier run
    verified: int
    lost: tuple[tuple[str, str], ...]  # ("image1 image2", reason) of the asked pairs that were not compared
    configurations: dict[str, int]  # matched pairs by COLMAP's kind of two-view geometry
    matches: int  # feature matches before verification, over all pairs
    inliers: int  # verified matches, over all pairs


def match_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    rules: Rules,
    log: Path,
    on_progress: Progress = lambda done, total: None,
    side: Side = _ALONE,
) -> tuple[Pairs, MatchReport]:
    """Match and verify the kept pairs. Pairs finished in the database are not done again, others in it are deleted.

    Returns the table with ``inliers`` of the kept pairs (0 = compared and not verified, -1 = could not be compared;
    both are dropped for "match") and the report. ``on_progress`` gets the numbers of finished and of all pairs. Raises
    InputError for a database of another scene, ReconstructionError if no pair at all is verified.
    """
    with Rows(database) as rows:
        names = rows.image_names()
    if names != dict(enumerate(scene.names, 1)):
        raise InputError(f"{database} contains other images than the scene: delete it and run the features stage again")
    kept = pairs.kept()
    features = feature_counts(database)
    some = np.array([features.get(k, 0) > 0 for k in range(len(scene))], bool)
    comparable = some[kept.i] & some[kept.j]
    finished = keep_finished(database, kept) & comparable
    todo = kept.where(comparable & ~finished)
    before, total = int(finished.sum()), int(comparable.sum())
    on_progress(before, total)
    blocks = cut(todo, max(1, min(BLOCK_PAIRS, -(-len(todo) // side.processes))))  # one at least for each process
    run_blocks(database, blocks, rules, side, log, lambda more: on_progress(before + more, total))
    strike(database, _WATERMARK)
    write_anew(database)
    matches, inliers, config = match_counts(database, kept)
    report = _report(scene, kept, matches, inliers, config, features)
    _check_verified(report, rules.settings)
    of_all, asked = pairs.inliers.copy(), pairs.dropped == 0
    of_all[asked] = inliers
    return pairs.with_(inliers=of_all).drop(asked & (of_all <= 0), "match"), report


def _report(
    scene: Scene, kept: Pairs, matches: np.ndarray, inliers: np.ndarray, config: np.ndarray, features: dict[int, int]
) -> MatchReport:
    """``matches``, ``inliers``, ``config`` (K,) of the kept pairs as of ``match_counts``."""
    matched = inliers >= 0
    lost = []
    for k in np.flatnonzero(~matched):
        empty = [scene.names[m] for m in (kept.i[k], kept.j[k]) if features.get(int(m), 0) == 0]
        reason = f"no features in {' and '.join(empty)}" if empty else "COLMAP gave no result: see the log"
        lost.append((f"{scene.names[kept.i[k]]} {scene.names[kept.j[k]]}", reason))
    kinds = pycolmap.TwoViewGeometryConfiguration.__members__
    codes = {int(value): name.lower() for name, value in kinds.items()}
    found, number = np.unique(config[matched], return_counts=True)
    return MatchReport(
        asked=len(kept),
        matched=int(matched.sum()),
        verified=int((inliers > 0).sum()),
        lost=tuple(lost),
        configurations={codes.get(int(c), str(c)): int(n) for c, n in zip(found, number)},
        matches=int(matches[matched].clip(0).sum()),
        inliers=int(inliers[matched].sum()),
    )


def _check_verified(report: MatchReport, settings: MatchSettings) -> None:
    if report.verified:
        return
    if report.asked == 0:
        raise ReconstructionError(
            "no pair verified: the pair list is empty. Loosen the network or design settings, or give a pair file"
        )
    why = f"; {report.lost[0][0]}: {report.lost[0][1]}" if report.lost else ""
    raise ReconstructionError(
        f"no pair verified: {report.asked} asked, {report.matched} compared, {report.matches} feature matches, and no "
        f"pair has {settings.min_inliers} of them that agree on one geometry{why}. Check that the images overlap and "
        "are not masked away, then try a lower match.min_inliers or other pair sources"
    )
