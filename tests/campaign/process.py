"""The harness's side of the fork server: start a command line, watch it, end it, find what outlives it."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

TESTS = Path(__file__).parents[1]
MEMORY_BYTES = 12 << 30  # of data a process may have, so that an input cannot take the machine down
_STALL_S, _STALLED_CPU_S = 20.0, 0.6  # less computed in that time: it waits (the meter of a run takes a hundredth)
_LEFT_S = 15.0  # how long what a command started may outlive it


@dataclass(frozen=True)
class Ended:
    """How a command line ended: exit code (None = by ``signal``, or by us after the time limit), what it said."""

    code: int | None
    signal: int | None
    text: str
    hung: bool = False
    left: tuple[str, ...] = ()  # processes that outlived it

    @property
    def good(self) -> bool:
        """Exit code 0 and nothing left behind."""
        return self.code == 0 and not self.hung and not self.left


class Server:
    """One fork server; runs one command at a time."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._open()

    def _open(self) -> None:
        path = os.pathsep.join([str(self._source), str(TESTS), str(TESTS / "campaign" / "site")])
        environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "200", "PYTHONHASHSEED": "random"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "campaign.server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
        )
        self._buffer = b""
        if "ready" not in (self.answer(300) or {}):
            raise RuntimeError("the fork server did not start")

    def start(
        self, argv: list[str], folder: Path, *, file_bytes: int | None = None, copies: Path | None = None
    ) -> Running:
        """Start `tiegraph argv`; ``folder`` (made) takes its output. ``file_bytes``: a limit to the size of a file;
        ``copies``: where the run folder is copied to, by the name of the stage, when the next one is to begin."""
        more = {"file_bytes": file_bytes, "copies": copies and str(copies)}
        pid = self._ask(argv, folder, memory_bytes=MEMORY_BYTES, **more)
        return Running(self, pid, folder / "said.txt")

    def start_module(self, module: str, argv: list[str], folder: Path) -> psutil.Process:
        """Start `python -m module argv` beside what else runs; ``folder`` (made) takes its output."""
        return psutil.Process(self._ask(argv, folder, module=module))

    def _ask(self, argv: list[str], folder: Path, **more: int | str | None) -> int:
        """The process id of what was asked for."""
        if self._process.poll() is not None:
            self._open()
        folder.mkdir(parents=True, exist_ok=True)
        log = folder / "said.txt"
        log.write_bytes(b"")
        request = {
            "argv": [os.fsencode(a).hex() for a in map(str, argv)],
            "cwd": str(folder),
            "log": str(log),
            "mark": folder.name,
            **more,
        }
        assert self._process.stdin is not None
        self._process.stdin.write((json.dumps(request) + "\n").encode())
        self._process.stdin.flush()
        answer = self.answer(60)
        if answer is None:
            raise RuntimeError("the fork server did not start a command")
        return answer["pid"]

    def answer(self, limit_s: float) -> dict | None:
        """The next answer, None if there is none in time."""
        assert self._process.stdout is not None
        end = time.monotonic() + limit_s
        while b"\n" not in self._buffer:
            ready, _, _ = select.select([self._process.stdout], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                return None
            more = os.read(self._process.stdout.fileno(), 65536)
            if not more:
                raise RuntimeError("the fork server has ended")
            self._buffer += more
        line, self._buffer = self._buffer.split(b"\n", 1)
        return json.loads(line)

    def run(self, argv: list[str], folder: Path, limit_s: float, **more: Any) -> Ended:
        """Run `tiegraph argv` to its end; ``more`` as ``start`` has it."""
        return self.start(argv, folder, **more).wait(limit_s)

    def recover(self) -> None:
        """Start anew after an error."""
        self.close()
        self._open()

    def close(self) -> None:
        """End the server."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.kill()
        self._process.wait()


class Running:
    """A command line at work, in a session of its own."""

    def __init__(self, server: Server, pid: int, log: Path) -> None:
        self.pid = pid
        self.log = log
        self._server = server
        self._status: int | None = None

    def poll(self, limit_s: float = 0.0) -> bool:
        """Has it ended (within ``limit_s``)?"""
        if self._status is None:
            answer = self._server.answer(limit_s)
            self._status = None if answer is None else answer["status"]
        return self._status is not None

    def family(self) -> list[psutil.Process]:
        """Every process of the session, the main one included."""
        found = []
        for process in psutil.process_iter():
            try:
                if os.getsid(process.pid) == self.pid and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
            except (OSError, psutil.Error):
                continue
        return found

    def children(self) -> list[psutil.Process]:
        """What the main process started to work for it: workers of the pool and children of the native library. They
        are forked by a server of its own (``tiegraph.forking``), or spawned."""
        found, family = [], self.family()
        servers = {p.pid for p in family if p.pid != self.pid and _forked_by(p, {self.pid})}
        for process in family:
            try:
                if _forked_by(process, servers) or any("spawn_main" in word for word in process.cmdline()):
                    found.append(process)
            except psutil.Error:
                continue
        return found

    def wait(self, limit_s: float) -> Ended:
        """Wait for its end, and for the end of what it started; what stays is ended here."""
        hung = not self._ends(limit_s)
        if hung:
            self._end()
            self.poll(30)
        end = time.monotonic() + _LEFT_S
        left = self.family()
        while left and not hung and time.monotonic() < end:
            time.sleep(0.02)
            left = self.family()
        names = () if hung else tuple(_describe(p) for p in left)
        self._end()
        text = self.log.read_text(errors="replace") if self.log.exists() else ""
        status = self._status
        if hung or status is None:
            return Ended(None, None, text, True, names)
        if os.WIFSIGNALED(status):
            return Ended(None, os.WTERMSIG(status), text, False, names)
        return Ended(os.WEXITSTATUS(status), None, text, False, names)

    def _ends(self, limit_s: float) -> bool:
        """Does it end? After ``limit_s`` it hangs if it has computed for so long, or computes no more: on a machine
        with other work it may take its time."""
        if self.poll(limit_s):
            return True
        before = -np.inf
        while before + _STALLED_CPU_S <= (now := self._cpu_s()) < limit_s:
            before = now
            if self.poll(_STALL_S):
                return True
        return self.poll()

    def _cpu_s(self) -> float:
        total = 0.0
        for process in self.family():
            try:
                total += sum(process.cpu_times()[:4])
            except psutil.Error:
                continue
        return total

    def _end(self) -> None:
        for process in self.family():
            try:
                process.send_signal(signal.SIGKILL)
            except psutil.Error:
                continue


def _forked_by(process: psutil.Process, parents: set[int]) -> bool:
    try:
        return process.ppid() in parents and "-c" not in process.cmdline()  # nor a tracker of multiprocessing's
    except psutil.Error:
        return False


def _describe(process: psutil.Process) -> str:
    try:
        return f"{process.pid} {' '.join(process.cmdline())[:120]}"
    except psutil.Error:
        return str(process.pid)
