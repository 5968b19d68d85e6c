"""``python -m benchmarks.papers 000``: a paper's tables; with --run it measures what the results lack."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.papers import measure
from benchmarks.papers.printed import PRINTED
from benchmarks.papers.tables import colmap_rows, tables


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The rows of a results file, none if it is not there, and those that COLMAP has in the table of figures."""
    return [*(json.loads(path.read_text())["runs"] if path.exists() else []), *colmap_rows()]


def main(argv: list[str] | None = None) -> int:
    """Print the tables of the papers that are named (all of them by default)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("papers", nargs="*", metavar="PAPER", help=f"of {', '.join(PRINTED)} (default: all)")
    parser.add_argument("--run", action="store_true", help="measure the rows that are not there (needs TIEGRAPH_DATA)")
    parser.add_argument("--work", type=Path, help="folder of the runs; what was begun goes on there")
    parser.add_argument("--note", default="", help="said in the JSON, for instance what else the machine was doing")
    args = parser.parse_args(argv)
    if args.run and args.work is None:
        parser.error("--run needs --work DIR")
    if unknown := sorted(set(args.papers) - set(PRINTED)):
        parser.error(f"no paper {', '.join(unknown)}: there are {', '.join(PRINTED)}")
    for paper in args.papers or PRINTED:
        if args.run:
            measure.measure(paper, args.work, args.note)
        sys.stdout.write(tables(paper, rows_of(measure.RESULTS)) + "\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
