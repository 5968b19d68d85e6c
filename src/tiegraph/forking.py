"""A process that a run's helpers are forked from (Linux): they start in milliseconds, with all modules loaded.

A helper that is spawned imports what its work needs, a second of CPU each, and a small survey needs six of them. The
server that multiprocessing has for this (``multiprocessing.forkserver``) is a new interpreter and imports all again. So
the command line, before it has threads that work or files that matter, forks the process that then becomes that server.
What a helper inherits of the command line is what it has loaded; its files, handlers and log are taken away in the
server, and what a helper works on comes through a pipe, as to one that is spawned.

A run of the Python API spawns: the program that called it may have threads, devices and patches of its own.
"""

import ctypes
import gc
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing import forkserver, resource_tracker, util
from typing import Any

HARMLESS = "stopping"  # name of the thread that the command line has: it holds no lock, and waits for one byte
_KEEP = ((-4, 0), (-1, 2**31 - 1))  # malloc.h: M_MMAP_MAX, M_TRIM_THRESHOLD
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_INSIDE = ((util, "spawnv_passfds"), (forkserver, "_forkserver"))
"""What is taken from the inside of multiprocessing: a Python that lacks it spawns."""


class _Server:
    """What this process knows of the server."""

    allowed = False
    load: Callable[[], None] | None = None
    owner = 0  # the process that started it
    pid = 0  # in the owner, and in the helpers forked from the server


def allow() -> None:
    """This process is tiegraph's own, and may be forked."""
    _Server.allowed = True


def prepare(load: Callable[[], None]) -> None:
    """Let ``start`` call ``load`` first, which imports what the helpers of this process will need."""
    _Server.load = load


def start() -> bool:
    """Start the server where that is allowed and safe, if none runs; whether it did. Else helpers are spawned.

    To be called with the signals blocked that helpers must not hear.
    """
    if not _Server.allowed or running() or not sys.platform.startswith("linux") or not _alone():
        return False
    if not all(hasattr(owner, name) for owner, name in _INSIDE):
        return False
    if _Server.load is not None:
        gc.disable()
        try:
            _Server.load()
        finally:
            gc.enable()
    gc.freeze()  # what is loaded stays: no collection goes through it, or copies its pages in a helper
    if not _alone():  # a library has started threads
        return False
    stop()  # what is left of a server that was ended from outside
    resource_tracker.ensure_running()
    forkserver.set_forkserver_preload([])  # all is loaded
    new_interpreter = util.spawnv_passfds
    util.spawnv_passfds = _forked  # type: ignore[assignment]
    try:
        forkserver.ensure_running()
    finally:
        util.spawnv_passfds = new_interpreter
    _Server.owner, _Server.pid = os.getpid(), _known()._forkserver_pid
    return True


def stop() -> None:
    """End the server, and so what is left of its helpers."""
    if _Server.pid and _Server.owner == os.getpid():
        with suppress(ProcessLookupError):
            os.kill(_Server.pid, signal.SIGKILL)
        _known()._stop()  # waits for it: what its helpers used counts as used by this process
        _Server.pid = 0


def running() -> bool:
    """Whether this process has a server."""
    if not _Server.pid or _Server.owner != os.getpid():
        return False
    return os.waitid(os.P_PID, _Server.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


def server_pid() -> int:
    """The server's pid, in this process and in helpers forked from it; 0 = there is none."""
    return _Server.pid


def keep_memory() -> None:
    """Let a forked helper keep what it frees, for the next piece of work: a pyramid of SIFT is 100 bytes a pixel and
    more, and to take it from the kernel for each image anew costs half of what the features themselves do.

    Not for a process that lives long: what it freed would be lacking elsewhere.
    """
    if _Server.pid and _Server.owner != os.getpid():
        library = ctypes.CDLL(None)
        for parameter, value in _KEEP:
            library.mallopt(parameter, value)  # of glibc; of another C library it may do nothing


def end_with(parent: int) -> None:
    """The kernel ends this process, at once, when the one that forked it has gone; ends it if it has gone already."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def _known() -> Any:
    """The server as multiprocessing knows it."""
    return forkserver._forkserver  # type: ignore[attr-defined]


def _alone() -> bool:
    """Whether no thread of this process could hold a lock that a fork would leave locked for ever."""
    if threading.current_thread() is not threading.main_thread():
        return False
    others = [t for t in threading.enumerate() if t is not threading.main_thread()]
    return all(t.name == HARMLESS for t in others) and len(os.listdir("/proc/self/task")) == 1 + len(others)


def _forked(program: str, arguments: Sequence[str], files: Sequence[int]) -> int:
    """Instead of a new interpreter that runs a command: this process, forked, runs it; its pid."""
    parent = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns where there is any thread
        pid = os.fork()
    if pid:
        return pid
    try:
        end_with(parent)
        _leave_what_is_loaded(files)
        _Server.owner, _Server.pid = parent, os.getpid()
        exec(arguments[-1], {})
    finally:
        os._exit(0)


def _leave_what_is_loaded(files: Sequence[int]) -> None:
    """Leave of the process that was forked nothing else but some files."""
    null = os.open(os.devnull, os.O_RDWR)
    for name in os.listdir("/proc/self/fd"):
        # Not closed: the objects that own these files would one day close what has their numbers then.
        if int(name) not in (1, 2, *files, null):
            with suppress(OSError):
                os.dup2(null, int(name), inheritable=False)
    sys.stdout, sys.stderr = (open(k, "w", buffering=1, closefd=False, errors="backslashreplace") for k in (1, 2))
    for logger in (logging.getLogger(), logging.getLogger("tiegraph")):
        logger.handlers.clear()
        logger.setLevel(logging.NOTSET if logger.parent else logging.WARNING)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
