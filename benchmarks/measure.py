"""What a process and its children cost: CPU seconds, wall seconds, peak memory of all of them together."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.datasets import Dataset
from tiegraph.pipeline import STAGES

_POLL_S = 0.5


def measured(command: list[str], log: Path, timeout_s: float = 7200.0) -> dict[str, Any]:
    """Run a command to its end: ``returncode`` (None: killed after ``timeout_s``), ``wall_s``, ``cpu_s`` (children
    included) and ``peak_mib`` (largest sum of the proportional set sizes of the tree, looked at twice a second)."""
    start, before = time.monotonic(), _children_cpu_s()
    peak = 0.0
    with log.open("ab") as stream:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, start_new_session=True
        )
        try:
            while process.poll() is None and time.monotonic() - start < timeout_s:
                peak = max(peak, tree_mib(process.pid))
                try:
                    process.wait(_POLL_S)
                except subprocess.TimeoutExpired:
                    continue
        finally:
            returncode = process.poll()
            if returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    wall_s = time.monotonic() - start
    return {
        "returncode": returncode, "wall_s": wall_s, "cpu_s": _children_cpu_s() - before, "peak_mib": peak
    }  # fmt: skip


def run_tiegraph(dataset: Dataset, folder: Path, options: list[str], timeout_s: float = 7200.0) -> dict[str, Any]:
    """``tiegraph run`` with the files a user has; CPU and memory of all stages so far, by their receipts (a run that
    continues another then costs what both cost) and not less than the process tree itself needed."""
    folder.mkdir(parents=True, exist_ok=True)
    command = [str(Path(sys.executable).with_name("tiegraph")), "run", str(dataset.images), "-o", str(folder / "out")]
    for name, value in dataset.files().items():
        # Copied: a temporary path that changes from run to run would make the folder start anew.
        if isinstance(value, Path) and value.is_file():
            kept = folder / value.name
            if not kept.exists():
                shutil.copy(value, kept)
            value = kept
        command += [f"--{name}", str(value)]
    said = measured([*command, *options], folder / "log.txt", timeout_s)
    spent = _spent(folder / "out")
    said["stages"] = spent
    said["cpu_s"] = max(said["cpu_s"], sum(r["cpu_s"] for r in spent))
    said["peak_mib"] = max([said["peak_mib"], *(r["peak_mib"] for r in spent)])
    return said


def finished_tiegraph(kept: Path, folder: Path, until: str) -> dict[str, Any]:
    """A finished run folder ``kept`` in the place of a new run in ``folder``: what its stages up to ``until`` cost, by
    their receipts. A link leads to it; nothing in it is changed."""
    folder.mkdir(parents=True, exist_ok=True)
    link = folder / "out"
    if not link.exists():
        link.symlink_to(kept.resolve())
    names = [stage.name for stage in STAGES]
    names = names[: names.index(until) + 1]
    spent = [r for r in _spent(kept) if r["stage"] in names]
    return {
        "returncode": 0, "wall_s": sum(r["seconds"] for r in spent), "cpu_s": sum(r["cpu_s"] for r in spent),
        "peak_mib": max(r["peak_mib"] for r in spent), "stages": spent,
    }  # fmt: skip


def _spent(out: Path) -> list[dict[str, Any]]:
    """Name, cost and counts of the finished stages of a run folder, by their receipts."""
    receipts = [json.loads(p.read_text()) for p in sorted((out / "receipts").glob("*.json"))]
    return [{k: r[k] for k in ("stage", "seconds", "cpu_s", "peak_mib", "counts")} for r in receipts if "finished" in r]


def _children_cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def tree_mib(pid: int) -> float:
    """Proportional set size of a process and all its descendants, MiB; 0 where /proc does not tell."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            continue
        children.setdefault(parent, []).append(int(entry.name))
    todo, total = [pid], 0.0
    while todo:
        one = todo.pop()
        total += _pss_mib(one)
        todo += children.get(one, [])
    return total


def _pss_mib(pid: int) -> float:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024
