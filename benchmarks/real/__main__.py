"""Runs of tiegraph and of others over the ladder: ``python -m benchmarks.real --root FOLDER --work FOLDER``.

``--table`` prints what ``results/real.json`` holds, ``--write`` puts it into README.md too. Each run has one core and
is a row of its own as soon as it ends.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import sys
from pathlib import Path
from typing import Any

from benchmarks import run
from benchmarks.datasets import Dataset
from benchmarks.real.sets import Survey, load, surveys
from benchmarks.real.table import table, write
from tiegraph.errors import InputError

RESULTS = Path(__file__).resolve().parents[1] / "results" / "real.json"
_FEW = 60  # up to so many images COLMAP's user matches every pair
_KEY = ("set", "competitor", "repeat")
_COMPETITORS = ("tiegraph", "colmap", "openmvg")


def main(argv: list[str] | None = None) -> int:
    """Run what the command line asks; 0 if every set was there."""
    args = _arguments(argv)
    if args.table or args.write:
        text = table(json.loads(args.output.read_text()), list(surveys().values()))
        sys.stdout.write(text + "\n")
        if args.write:
            write(text, list(surveys().values()))
        return 0
    os.sched_setaffinity(0, {args.core})
    missing = 0
    for name in args.sets:
        survey = surveys()[name]
        try:
            dataset = load(survey, args.root, args.work / "inputs")
        except InputError as error:
            sys.stderr.write(f"{error}\n")
            missing += 1
            continue
        first: dict[str, dict[str, Any]] = {}
        for seed, competitor in itertools.product(args.seeds, args.competitors):
            row = _row(survey, dataset, competitor, seed, args, first.get(competitor))
            first.setdefault(competitor, row)
            run.add_row(run.load_results(args.output, ""), row, args.output, _KEY)  # others add too
            sys.stderr.write(f"{name} {competitor} {seed}: {row['status']}, {row['wall_s']:.0f} s\n")
    return int(missing > 0)


def _row(
    survey: Survey,
    dataset: Dataset,
    competitor: str,
    seed: int,
    args: argparse.Namespace,
    first: dict[str, Any] | None,
) -> dict[str, Any]:
    if competitor == "colmap":
        pairs = "exhaustive" if survey.count <= _FEW else "spatial" if survey.truth == "exif" else "sequential"
        competitor = f"colmap_{pairs}{'_mixed' if survey.mixed else ''}"
    row = run.run_one(dataset, competitor, seed, args.work, args, first)
    peaks = [stage["peak_mib"] for stage in row.get("stages", [])]
    return {**row, "images": survey.count, "peak_mib": max(peaks, default=None), "note": args.note}


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = list(surveys())
    parser.add_argument("--root", type=Path, help="folder that the repositories were cloned in")
    parser.add_argument("--work", type=Path, help="folder for runs")
    parser.add_argument("--sets", nargs="+", default=names, choices=names, metavar="SET")
    parser.add_argument("--competitors", nargs="+", default=list(_COMPETITORS), help=", ".join(_COMPETITORS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the mappers, as in benchmarks.run")
    parser.add_argument("--until", default="georef", help="last stage of tiegraph")
    parser.add_argument("--timeout", type=float, default=14400.0, help="seconds a run may take")
    parser.add_argument("--core", type=int, default=max(os.sched_getaffinity(0)), help="the core that runs have")
    parser.add_argument("--keep", type=Path, help="keep the run folders below this folder")
    parser.add_argument("--note", default="", help="said in the rows, for instance what else the machine was doing")
    parser.add_argument("--table", action="store_true", help="print the table and run nothing")
    parser.add_argument("--write", action="store_true", help="the tables into README.md; run nothing")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS)
    parser.set_defaults(calibrated=False)
    args = parser.parse_args(argv)
    if not (args.table or args.write) and (args.root is None or args.work is None):
        parser.error("--root and --work are needed")
    return args


if __name__ == "__main__":
    sys.exit(main())
