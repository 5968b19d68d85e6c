"""Matching and geometric verification of exactly the listed pairs, by COLMAP in child processes, block by block."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError, ReconstructionError
from tiegraph.features.matchblocks import Side, cut, run_blocks
from tiegraph.features.settings import MatchSettings
from tiegraph.scene.colmapdatabase import Rows, feature_counts, keep_finished, match_counts, strike, write_anew
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

BLOCK_PAIRS = 256  # what a process of a killed run loses at most, and the step of the progress
_WATERMARK = int(pycolmap.TwoViewGeometryConfiguration.WATERMARK)

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class MatchTable:
    """What the database holds of P pairs: feature matches, verified matches, COLMAP's configuration; -1 = nothing."""

    matches: np.ndarray
    inliers: np.ndarray
    config: np.ndarray


@dataclass(frozen=True)
class MatchReport:
    """What was asked of the matcher and what came back."""

    asked: int
    matched: int  # pairs compared, now or in an earlier run
    verified: int
    resumed: int  # of the matched, found finished in the database
    lost: tuple[tuple[str, str], ...]  # ("image1 image2", reason) of the asked pairs that were not compared
    configurations: dict[str, int]  # matched pairs by COLMAP's kind of two-view geometry
    matches: int  # feature matches before verification, over all pairs
    inliers: int  # verified matches, over all pairs
    seconds: float


def match_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    settings: MatchSettings,
    log: Path,
    on_progress: Progress | None = None,
    side: Side | None = None,
) -> tuple[Pairs, MatchReport]:
    """Match and verify the kept pairs. Pairs finished in the database are not done again, others in it are deleted.

    Returns the table with ``inliers`` of the kept pairs (0 = compared and not verified, -1 = could not be compared;
    both are dropped for "match") and the report. Raises InputError for a database of another scene or a full disk,
    ReconstructionError if COLMAP's process ends or no pair at all is verified.
    """
    started, side = time.perf_counter(), side or Side()
    _check(database, scene)
    kept = pairs.kept()
    counts = feature_counts(database)
    usable = np.array([counts.get(k, 0) > 0 for k in range(len(scene))], bool)
    possible = usable[kept.i] & usable[kept.j]
    finished = keep_finished(database, kept) & possible
    done, total = int(finished.sum()), int(possible.sum())
    tell = on_progress or (lambda done, total: None)
    tell(done, total)
    todo = kept.where(possible & ~finished)
    size = min(BLOCK_PAIRS, -(-len(todo) // side.processes))
    blocks = cut(todo, max(1, size))
    run_blocks(database, blocks, settings, side, log, lambda more: tell(done + more, total))
    # Most matches lie in the image border and moved alike: a caption or a part of the platform. COLMAP's mappers would
    # still take the pair.
    strike(database, _WATERMARK)
    write_anew(database)
    table = read_matches(database, kept)
    report = _report(scene, kept, table, counts, done, time.perf_counter() - started)
    if report.verified == 0:
        raise ReconstructionError(_nothing_verified(report, settings, log))
    return _filled(pairs, table), report


def _check(database: Path, scene: Scene) -> None:
    with Rows(database) as rows:
        names = rows.image_names()
    if names != dict(enumerate(scene.names, 1)):
        raise InputError(f"{database} holds other images than the scene: delete it and run the features stage again")


def read_matches(database: Path, pairs: Pairs) -> MatchTable:
    """What the database holds of the pairs."""
    return MatchTable(*match_counts(database, pairs))


def _filled(pairs: Pairs, table: MatchTable) -> Pairs:
    inliers = pairs.inliers.copy()
    kept = pairs.dropped == 0
    inliers[kept] = table.inliers
    filled = pairs.with_(inliers=inliers)
    return filled.drop(kept & (inliers <= 0), "match")


def _report(
    scene: Scene, kept: Pairs, table: MatchTable, counts: dict[int, int], resumed: int, seconds: float
) -> MatchReport:
    matched = table.inliers >= 0
    lost = []
    for k in np.flatnonzero(~matched):
        empty = [scene.names[m] for m in (kept.i[k], kept.j[k]) if counts.get(int(m), 0) == 0]
        reason = f"no features in {' and '.join(empty)}" if empty else "COLMAP gave no result: see the log"
        lost.append((f"{scene.names[kept.i[k]]} {scene.names[kept.j[k]]}", reason))
    kinds = pycolmap.TwoViewGeometryConfiguration.__members__
    codes = {int(value): name.lower() for name, value in kinds.items()}
    found, number = np.unique(table.config[matched], return_counts=True)
    return MatchReport(
        asked=len(kept),
        matched=int(matched.sum()),
        verified=int((table.inliers > 0).sum()),
        resumed=resumed,
        lost=tuple(lost),
        configurations={codes.get(int(c), str(c)): int(n) for c, n in zip(found, number)},
        matches=int(table.matches[matched].clip(0).sum()),
        inliers=int(table.inliers[matched].sum()),
        seconds=seconds,
    )


def _nothing_verified(report: MatchReport, settings: MatchSettings, log: Path) -> str:
    if report.asked == 0:
        return "no pair verified: the pair list is empty. Loosen the network or design settings, or give a pair file"
    why = f"; {report.lost[0][0]}: {report.lost[0][1]}" if report.lost else ""
    return (
        f"no pair verified: {report.asked} asked, {report.matched} compared, {report.matches} feature matches, and no "
        f"pair has {settings.min_inliers} of them that agree on one geometry{why}. Check that the images overlap and "
        f"are not masked away, then try a lower match.min_inliers or other pair sources (log: {log})"
    )
