"""Does COLMAP find the same matches each time? The pairs of a finished run matched again and again on so many threads.

``python benchmarks/sfm/matching_threads.py RUN --threads 2 --seconds 600``: runs, and how many differ from the first.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sqlite3
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.features.matchblocks import Rules, colmap_options

_MADE = ("matches", "two_view_geometries")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="run folder whose features and match are done")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=600.0)
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    first, runs, differ = "", 0, 0
    end = time.monotonic() + args.seconds
    with tempfile.TemporaryDirectory() as scratch:
        bare, pairs = _bare(args.run / "database.db", Path(scratch))
        while not runs or time.monotonic() < end:
            found = _matched(bare, pairs, args.threads)
            first = first or found
            runs, differ = runs + 1, differ + (found != first)
    sys.stdout.write(f"{args.threads} threads: {runs} runs, {differ} differ from the first\n")


def _bare(database: Path, scratch: Path) -> tuple[Path, Path]:
    """A copy of the database without matches, and the list of the pairs that it had."""
    bare, pairs = scratch / "bare.db", scratch / "pairs.txt"
    shutil.copyfile(database, bare)
    with closing(sqlite3.connect(bare, isolation_level=None)) as connection:
        names = dict(connection.execute("SELECT image_id, name FROM images"))
        ids = [pycolmap.pair_id_to_image_pair(k) for (k,) in connection.execute("SELECT pair_id FROM matches")]
        for table in _MADE:
            connection.execute(f"DELETE FROM {table}")
    pairs.write_text("".join(f"{names[a]} {names[b]}\n" for a, b in ids))
    return bare, pairs


def _matched(bare: Path, pairs: Path, threads: int) -> str:
    """A hash over all matches."""
    work = bare.with_name("work.db")
    shutil.copyfile(bare, work)
    matching, verification = colmap_options(Rules())
    matching.num_threads = threads
    pairing = pycolmap.ImportedPairingOptions(match_list_path=pairs, block_size=500)
    pycolmap.match_image_pairs(
        str(work), matching_options=matching, pairing_options=pairing, verification_options=verification
    )
    out = hashlib.sha256()
    with closing(sqlite3.connect(work)) as connection:
        for pair_id, data in connection.execute("SELECT pair_id, data FROM matches ORDER BY pair_id"):
            out.update(str(pair_id).encode() + (data or b""))
    work.unlink()
    return out.hexdigest()


if __name__ == "__main__":
    main()
