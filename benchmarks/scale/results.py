"""The files of results of this folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from benchmarks import run
from tiegraph.__version__ import __version__


def save(path: Path, rows: list[dict[str, Any]], note: str) -> None:
    """Write the rows, with the machine and the version."""
    head = {"format": 1, "machine": run._machine(), "tiegraph": __version__, "note": note}
    path.write_text(json.dumps(run._rounded({**head, "runs": rows}), indent=1) + "\n")
