"""The command line of the programs that look at finished runs."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks import datasets


def arguments(description: str | None, output: Path | None = None) -> argparse.ArgumentParser:
    """The runs, those to be made first, and the file of the rows."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", help="SET=FOLDER: data set and its run folder")
    parser.add_argument("--run", nargs="+", default=[], metavar="SET=FOLDER", help="make the run first")
    parser.add_argument("-o", "--output", type=Path, default=output)
    return parser


def each_run(
    args: argparse.Namespace, measure: Callable[[str, Path, Path], dict[str, Any]], until: str = "sparse"
) -> list[dict[str, Any]]:
    """The rows: ``measure(set, folder, scratch)`` of every run, printed and written by -o as soon as it is there.

    A set measured again replaces its row in the file, the others stay.
    """
    there = args.output is not None and args.output.exists()
    rows = json.loads(args.output.read_text())["rows"] if there else []
    machine = {"machine": platform.machine(), "cpus": os.cpu_count(), "load": os.getloadavg()[0]}
    for item in [*args.run, *args.runs]:
        name, folder = item.split("=", 1)
        with tempfile.TemporaryDirectory() as scratch:
            if item in args.run:
                datasets.load(name, Path(scratch) / "inputs").run(Path(folder), until)
            row = measure(name, Path(folder), Path(scratch))
        rows = [*(r for r in rows if r["set"] != row["set"]), row]
        sys.stdout.write(json.dumps(row, indent=1) + "\n")
        sys.stdout.flush()
        if args.output:
            args.output.write_text(json.dumps({**machine, "rows": rows}, indent=1) + "\n")
    return rows
