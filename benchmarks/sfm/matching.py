"""Our search for matches beside COLMAP's: ``python -m benchmarks.sfm.matching RUN ... --pairs 50``.

For pairs of finished runs, drawn by chance from those that were compared: CPU ms a pair, matches and inliers, by
descriptors of seven bits (``features/matchers.py``), by those of eight as they are (by NumPy; the matches of COLMAP's
exact matcher, which takes seconds a pair), and by COLMAP's default, an approximate index. COLMAP verifies all three
with our rules.
"""

from __future__ import annotations

import argparse
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tiegraph.features import matchblocks, matchers
from tiegraph.features.matchblocks import Rules
from tiegraph.scene.colmapdatabase import match_counts
from tiegraph.scene.pairs import Pairs


@contextmanager
def _eight_bits() -> Iterator[None]:
    saved = matchers._nearest, matchers.rounded, matchers.NORM
    matchers._nearest, matchers.rounded, matchers.NORM = None, np.asarray, 512.0
    try:
        yield
    finally:
        matchers._nearest, matchers.rounded, matchers.NORM = saved


def _by(match: Callable[..., None], database: Path, block: np.ndarray) -> tuple[float, int, int]:
    """CPU ms a pair, matches and inliers of a block (B, 2)."""
    with tempfile.TemporaryDirectory() as folder:
        target, start = Path(folder) / "matches.db", time.process_time()
        match(database, target, block, Rules())
        spent = time.process_time() - start
        index = np.sort(block, axis=1)
        matches, inliers, _ = match_counts(target, Pairs.make(index[:, 0], index[:, 1], "file"))
    return 1000 * spent / len(block), int(matches.clip(0).sum()), int(inliers.clip(0).sum())


def main() -> None:
    """Print a row of a table for each run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--pairs", type=int, default=50)
    given = parser.parse_args()
    sys.stdout.write(
        "| run | seven bits: ms, matches, inliers | eight bits, by NumPy | COLMAP's index |\n|---|---|---|---|\n"
    )
    for run in given.runs:
        with sqlite3.connect(run / "database.db") as rows:
            ids = np.array([row[0] for row in rows.execute("SELECT pair_id FROM two_view_geometries ORDER BY pair_id")])
        pairs = np.stack(np.divmod(ids, 2147483647), axis=1) - 1  # COLMAP's number of a pair
        block = pairs[np.random.default_rng(0).permutation(len(pairs))[: given.pairs]]
        database = run / "database.db"
        cells = [_by(matchblocks._by_matcher, database, block)]
        with _eight_bits():
            cells.append(_by(matchblocks._by_matcher, database, block))
        cells.append(_by(matchblocks._by_colmap, database, block))
        said = " | ".join(f"{ms:.1f}, {m}, {i}" for ms, m, i in cells)
        sys.stdout.write(f"| {run.name} | {said} |\n")


if __name__ == "__main__":
    main()
