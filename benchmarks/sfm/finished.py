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


def each_run(description: str | None, measure: Callable[[str, Path, Path], dict[str, Any]]) -> None:
    """``measure(set, folder, scratch)`` of every SET=FOLDER that is given; the rows are printed, and written by -o."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("runs", nargs="+", help="SET=FOLDER: data set and its run folder")
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    rows = []
    for item in arguments.runs:
        name, folder = item.split("=", 1)
        with tempfile.TemporaryDirectory() as scratch:
            rows.append(measure(name, Path(folder), Path(scratch)))
        sys.stdout.write(json.dumps(rows[-1], indent=1) + "\n")
        sys.stdout.flush()
    if arguments.output:
        machine = {"machine": platform.machine(), "cpus": os.cpu_count(), "load": os.getloadavg()[0]}
        arguments.output.write_text(json.dumps({**machine, "rows": rows}, indent=1) + "\n")
