"""A process that a run's helpers are forked from (Linux): they start in milliseconds, with all modules loaded.

A helper that is spawned imports what its work needs, a second of CPU each, and a small survey needs six of them. So the
command line, before it has threads that work or files that matter, forks one process that does nothing but fork: the
server. What a helper inherits of the command line is what it has loaded; its files, handlers and log are taken away in
the server, and what a helper works on comes through a pipe, as to one that is spawned (``multiprocessing.spawn``).

A run of the Python API spawns: the program that called it may have threads, devices and patches of its own.
"""

import ctypes
import gc
import logging
import os
import selectors
import signal
import socket
import struct
import sys
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from multiprocessing import popen_fork, reduction, resource_tracker, spawn, util
from multiprocessing.connection import wait
from multiprocessing.context import set_spawning_popen
from typing import Any

HARMLESS = "stopping"  # name of the thread that the command line has: it holds no lock, and waits for one byte
_STATUS = struct.Struct("q")  # the pid of a helper, then its exit code
_MOST_FILES = 250  # in one message of the kernel's (SCM_MAX_FD is 253)
_KEEP = ((-4, 0), (-1, 2**31 - 1))  # malloc.h: M_MMAP_MAX, M_TRIM_THRESHOLD
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_INSIDE = ((spawn, "_main"), (resource_tracker, "_resource_tracker"), (popen_fork.Popen, "_launch"))
"""What is taken from the inside of multiprocessing: a Python that lacks it spawns."""


class _Server:
    """Where the server is, as this process knows it."""

    allowed = False
    load: Callable[[], None] | None = None
    pid = 0
    owner = 0
    requests: socket.socket | None = None
    lock = threading.Lock()


_server = _Server()
_inherited: list[int] = []  # files that a forked helper was given
_served_by = 0  # in a forked helper: pid of the server


def allow() -> None:
    """This process is tiegraph's own, and may be forked."""
    _server.allowed = True


def prepare(load: Callable[[], None]) -> None:
    """Let ``start`` call ``load`` first, which imports what the helpers of this process will need."""
    _server.load = load


def start() -> bool:
    """Start the server where that is allowed and safe, if none runs; whether it did. Else helpers are spawned.

    To be called with the signals blocked that helpers must not hear.
    """
    if not _server.allowed or running() or not sys.platform.startswith("linux") or not _alone():
        return False
    if not all(hasattr(owner, name) for owner, name in _INSIDE):
        return False
    if _server.load is not None:
        gc.disable()
        try:
            _server.load()
        finally:
            gc.enable()
    gc.freeze()  # what is loaded stays: no collection goes through it, or copies its pages in a helper
    if not _alone():  # a library has started threads
        return False
    resource_tracker.ensure_running()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    parent = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns where there is any thread
        pid = os.fork()
    if not pid:
        try:
            end_with(parent)
            _prepare(theirs)
            _serve(theirs)
        finally:
            os._exit(0)
    theirs.close()
    _server.pid, _server.owner, _server.requests = pid, parent, ours
    return True


def stop() -> None:
    """End the server, and so what is left of its helpers."""
    if not _server.pid or _server.owner != os.getpid():
        return
    with suppress(ProcessLookupError):
        os.kill(_server.pid, signal.SIGKILL)
    with suppress(ChildProcessError):
        os.waitpid(_server.pid, 0)  # what its helpers used counts as used by this process
    _forget()


def running() -> bool:
    """Whether this process has a server."""
    if not _server.pid or _server.owner != os.getpid():
        return False
    with suppress(ChildProcessError):
        if os.waitpid(_server.pid, os.WNOHANG) == (0, 0):
            return True
    _forget()
    return False


def server_pid() -> int:
    """The server's pid, in this process and in helpers forked from it; 0 = there is none."""
    return _served_by or (_server.pid if _server.owner == os.getpid() else 0)


def keep_memory() -> None:
    """Let a forked helper keep what it frees, for the next piece of work: a pyramid of SIFT is 100 bytes a pixel and
    more, and to take it from the kernel for each image anew costs half of what the features themselves do.

    Not for a process that lives long: what it freed would be lacking elsewhere.
    """
    if _served_by:
        library = ctypes.CDLL(None)
        for parameter, value in _KEEP:
            library.mallopt(parameter, value)  # of glibc; of another C library it may do nothing


def _forget() -> None:
    if _server.requests is not None:
        _server.requests.close()
    _server.pid, _server.requests = 0, None


def _alone() -> bool:
    """Whether no thread of this process could hold a lock that a fork would leave locked for ever."""
    if threading.current_thread() is not threading.main_thread():
        return False
    others = [t for t in threading.enumerate() if t is not threading.main_thread()]
    return all(t.name == HARMLESS for t in others) and len(os.listdir("/proc/self/task")) == 1 + len(others)


def end_with(parent: int) -> None:
    """The kernel ends this process, at once, when the one that forked it has gone; ends it if it has gone already."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


# --- in the server ---------------------------------------------------------------------------------------------------


def _prepare(requests: socket.socket) -> None:
    """Leave of the process that was forked only what it has loaded."""
    null = os.open(os.devnull, os.O_RDWR)
    for name in os.listdir("/proc/self/fd"):
        # Not closed: the objects that own these files would one day close what has their numbers then.
        if int(name) not in (1, 2, requests.fileno(), null):
            with suppress(OSError):
                os.dup2(null, int(name), inheritable=False)
    sys.stdout, sys.stderr = (open(k, "w", buffering=1, closefd=False, errors="backslashreplace") for k in (1, 2))
    for logger in (logging.getLogger(), logging.getLogger("tiegraph")):
        logger.handlers.clear()
        logger.setLevel(logging.NOTSET if logger.parent else logging.WARNING)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def _serve(requests: socket.socket) -> None:
    """Fork at each request, and tell how helpers end; until nobody can ask any more."""
    global _served_by
    _served_by = os.getpid()
    awake, wake = os.pipe()
    for end in (awake, wake):
        os.set_blocking(end, False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    ends: dict[int, int] = {}  # pid -> where its exit code is told
    with selectors.DefaultSelector() as waiting:
        waiting.register(requests, selectors.EVENT_READ)
        waiting.register(awake, selectors.EVENT_READ)
        while True:
            ready = [key.fd for key, _ in waiting.select()]
            if awake in ready:
                os.read(awake, 4096)
                _tell_ends(ends)
            if requests.fileno() in ready:
                asked, files, _, _ = socket.recv_fds(requests, 1, _MOST_FILES)
                if not asked:
                    return
                data, status, *given = files
                pid = os.fork()
                if not pid:
                    waiting.close()
                    for file in (requests.detach(), awake, wake, status, *ends.values()):
                        os.close(file)
                    os._exit(_become(data, given))
                _tell(status, pid)
                ends[pid] = status
                for file in (data, *given):
                    os.close(file)


def _tell_ends(ends: dict[int, int]) -> None:
    with suppress(ChildProcessError):
        while (found := os.waitpid(-1, os.WNOHANG))[0]:
            status = ends.pop(found[0])
            _tell(status, os.waitstatus_to_exitcode(found[1]))
            os.close(status)


def _tell(status: int, number: int) -> None:
    with suppress(BrokenPipeError):  # nobody wants to know any more
        os.write(status, _STATUS.pack(number))


def _become(data: int, given: list[int]) -> int:
    """Turn the forked process into a helper, whose work comes through ``data``; its exit code."""
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        resource_tracker._resource_tracker._fd = given[0]  # type: ignore[attr-defined]
        _inherited[:] = given[1:]
        return spawn._main(data, os.dup(data))  # type: ignore[attr-defined, no-any-return]
    except BaseException:
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        return 1
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()


# --- a helper, as the process sees it that asked for it --------------------------------------------------------------


class _Given:
    """A file of a helper, by its place among those it was given."""

    def __init__(self, place: int) -> None:
        self.place = place

    def detach(self) -> int:
        return _inherited[self.place]


class Popen(popen_fork.Popen):
    """A process forked by the server, in the form multiprocessing wants it (its ``popen_forkserver`` has a server of
    another kind: an interpreter that starts anew and so imports all again)."""

    DupFd = _Given

    def __init__(self, process: Any) -> None:
        self._files: list[int] = []
        super().__init__(process)

    def duplicate_for_child(self, fd: int) -> int:
        """The place of a file among those that the helper will be given."""
        self._files.append(fd)
        return len(self._files) - 1

    def _launch(self, process_obj: Any) -> None:
        said = BytesIO()
        set_spawning_popen(self)  # type: ignore[arg-type]  # typeshed knows those of its own
        try:
            reduction.dump(spawn.get_preparation_data(process_obj._name), said)
            reduction.dump(process_obj, said)
        finally:
            set_spawning_popen(None)
        self.sentinel, data = _ask(self._files)
        # A helper sees by this that the process which asked for it has gone.
        self.finalizer = util.Finalize(self, _close, (os.dup(data), self.sentinel))
        with open(data, "wb") as stream:
            stream.write(said.getbuffer())
        told = os.read(self.sentinel, _STATUS.size)
        if not told:
            raise BrokenPipeError("the process that starts helpers was ended from outside")
        self.pid = _STATUS.unpack(told)[0]

    def poll(self, flag: int = os.WNOHANG) -> int | None:
        """The exit code; None while it runs."""
        if self.returncode is None and wait([self.sentinel], 0 if flag == os.WNOHANG else None):
            told = os.read(self.sentinel, _STATUS.size)
            # Nothing: the server was ended from outside, and its helpers with it.
            self.returncode = _STATUS.unpack(told)[0] if told else -signal.SIGKILL
        return self.returncode


def _close(*files: int) -> None:
    for file in files:
        os.close(file)


def _ask(files: list[int]) -> tuple[int, int]:
    """(where pid and exit code come from, where the work goes to) of a new helper."""
    data_r, data_w = os.pipe()
    status_r, status_w = os.pipe()
    try:
        with _server.lock:
            assert _server.requests is not None
            tracker = resource_tracker.getfd()
            assert tracker is not None
            socket.send_fds(_server.requests, [b"1"], [data_r, status_w, tracker, *files])
    except OSError:
        os.close(data_w)
        os.close(status_r)
        raise
    finally:
        os.close(data_r)
        os.close(status_w)
    return status_r, data_w
