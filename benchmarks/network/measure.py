"""What a process and its children cost: CPU seconds, wall seconds, peak memory of all of them together."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

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
