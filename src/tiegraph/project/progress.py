"""The user's view of a run: one line a stage, live on a terminal, plain elsewhere."""

import json
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil
from rich import progress as bars
from rich.console import Console

from tiegraph.forking import server_pid
from tiegraph.text import printable


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Continue (rich would end the process): `tiegraph run ... 2>&1 | head` reads only some lines."""


class Reporter:
    """Reports the progress of a run. ``style``: "auto" (rich on a terminal, else plain lines), "json" (one object a
    line on standard output), "quiet"."""

    def __init__(self, style: str = "auto") -> None:
        self.style = style
        self.console = _Console(stderr=True, highlight=False, emoji=False, soft_wrap=True)
        self._progress: bars.Progress | None = None
        self._task: bars.TaskID | None = None

    def say(self, text: str) -> None:
        """One line for people."""
        if self.style == "auto":
            with suppress(OSError):  # standard error is full or closed: the results matter more, and the log has it
                self.console.print(printable(text), markup=False)

    def event(self, kind: str, **data: object) -> None:
        """One event for programs (``--json``)."""
        if self.style == "json":
            sys.stdout.write(json.dumps({"event": kind, **data}, default=str) + "\n")
            sys.stdout.flush()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A live line while a stage runs (terminal only)."""
        if self.style != "auto" or not self.console.is_terminal:
            yield
            return
        name_of, memory_of = (bars.TextColumn(text) for text in ("{task.description:>9}", "{task.fields[memory]}"))
        counts = bars.BarColumn(), bars.MofNCompleteColumn(), bars.TimeElapsedColumn()
        columns = (name_of, *counts, bars.TextColumn("ETA"), bars.TimeRemainingColumn(), memory_of)
        with bars.Progress(*columns, console=self.console, transient=True) as self._progress:
            self._task = self._progress.add_task(name, total=None, memory="")
            yield
        self._progress = None

    def total(self, total: int, done: int = 0) -> None:
        """The number of items of the running stage, and how many existed already."""
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, total=total, completed=done)

    def advance(self, count: int = 1) -> None:
        """Count more finished items."""
        if self._progress is not None and self._task is not None:
            memory = f"{psutil.Process().memory_info().rss / 2**20:.0f} MiB"
            self._progress.update(self._task, advance=count, memory=memory)


class LogFormatter(logging.Formatter):
    """Lines of the log; no text from outside can control the terminal that shows it."""

    def format(self, record: logging.LogRecord) -> str:
        """One record, tracebacks included."""
        return printable(super().format(record))


class Elsewhere:
    """Resource use of workers outside this process (of Dask, on other machines) since the last query."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cpu_s = 0.0
        self._peak_mib: dict[str, float] = {}

    def add(self, worker: str, used: dict[str, float]) -> None:
        """Add the values of a worker's own ``Meter`` for a task."""
        with self._lock:
            self._cpu_s += used["cpu_s"]
            self._peak_mib[worker] = max(used["peak_mib"], self._peak_mib.get(worker, 0.0))

    def take(self) -> dict[str, float]:
        """{"cpu_s", "peak_mib": the sum of the workers' peaks}; resets both."""
        with self._lock:
            used = {"cpu_s": self._cpu_s, "peak_mib": sum(self._peak_mib.values())}
            self._cpu_s, self._peak_mib = 0.0, {}
        return used


class Meter:
    """CPU seconds and peak memory of this process and all its children, also ended ones, and of ``elsewhere``.

    The peaks of workers elsewhere are added up, even if they were not simultaneous.
    """

    def __init__(self, interval_s: float = 0.5, elsewhere: Elsewhere | None = None) -> None:
        self._process = psutil.Process()
        self._elsewhere = elsewhere or Elsewhere()
        self._elsewhere.take()
        self._interval = interval_s
        self._stop = threading.Event()
        self.peak_mib = 0.0
        self._start = self._cpu()
        self._thread = threading.Thread(target=self._watch, daemon=True, name="meter")
        self._thread.start()

    def _cpu(self) -> float:
        total = 0.0
        for process in self._family():
            with suppress(psutil.Error):
                times = process.cpu_times()
                total += times.user + times.system + times.children_user + times.children_system
        return total

    def _family(self) -> list[psutil.Process]:
        """This process and its children; one that ends meanwhile raises psutil.Error."""
        with suppress(psutil.Error):
            return [self._process, *self._process.children(recursive=True)]
        return [self._process]

    def _watch(self) -> None:
        self._look()
        while not self._stop.wait(self._interval):
            self._look()
        self._look()

    def _look(self) -> None:
        rss = 0
        for process in self._family():
            with suppress(psutil.Error):
                # The server of helpers shares all its memory with this process.
                rss += 0 if process.pid == server_pid() else process.memory_info().rss
        self.peak_mib = max(self.peak_mib, rss / 2**20)

    def stop(self) -> dict[str, float]:
        """{"cpu_s", "peak_mib"} since the start."""
        self._stop.set()
        self._thread.join()
        there = self._elsewhere.take()
        cpu_s = max(0.0, self._cpu() - self._start) + there["cpu_s"]
        return {"cpu_s": round(cpu_s, 2), "peak_mib": round(self.peak_mib + there["peak_mib"], 1)}
