"""What is noted of a method while it runs, stage by stage; of the standard library alone, for who measures another
program pays for all that he loads himself."""

import json
import os
import resource
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

DONE, FAILED = "done", "failed"


class Stages:
    """Measures stages and keeps a JSON file: ``status``, ``stages`` (wall_s, cpu_s, peak_mib), ``models``."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.data: dict[str, Any] = {"status": "started", "stages": [], "models": []}
        self.save()

    def run(self, stage: str, function: Callable[[], Any]) -> Any:
        """Call ``function`` and note its wall time, CPU time (all threads) and the peak memory so far."""
        self.data["running"] = stage
        self.save()
        wall, before = time.monotonic(), _cpu_s()
        result = function()
        peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = {"stage": stage, "wall_s": time.monotonic() - wall, "cpu_s": _cpu_s() - before, "peak_mib": peak_mib}
        self.data["stages"].append(row)
        self.data.pop("running")
        self.save()
        return result

    def go_on(self, path: Path) -> None:
        """Take over the stages up to the matching of another run, whose JSON file is ``path``."""
        rows = json.loads(path.read_text())["stages"]
        self.data["stages"] = rows[: 1 + [row["stage"] for row in rows].index("match")]

    def end(self, reason: str = "") -> None:
        """The last word: done, or (``reason``) why there is nothing to show."""
        self.data |= {"status": FAILED, "reason": reason} if reason else {"status": DONE}
        self.save()

    def save(self) -> None:
        """Write the JSON file in one step."""
        temporary = self._path.with_suffix(".part")
        temporary.write_text(json.dumps(self.data))
        os.replace(temporary, self._path)


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def pairs_of(database: Path) -> dict[str, int]:
    """Pairs in COLMAP's database with raw matches, those with inliers of two-view geometry, and all these inliers."""
    count = "SELECT {} FROM {} WHERE rows > 0"
    with closing(sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True)) as opened:
        asked = {
            "matched": ("count(*)", "matches"),
            "verified": ("count(*)", "two_view_geometries"),
            "inliers": ("coalesce(sum(rows), 0)", "two_view_geometries"),
        }
        return {name: opened.execute(count.format(*words)).fetchone()[0] for name, words in asked.items()}
