"""Ctrl-C, SIGTERM and SIGHUP: the run ends within seconds, in one line, and leaves no process behind."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

from tiegraph.child import STOPPING, end_helpers
from tiegraph.forking import HARMLESS

_STOPPED = "stopped; finished work is kept: run the same command again to go on"
_GRACE_S = 6.0  # for what is under way to give up; then the process ends without it, as after a SIGKILL
_FAILED = 1


@contextlib.contextmanager
def stoppable(for_good: bool = False) -> Iterator[None]:
    """The stopping signals raise KeyboardInterrupt in the main thread; those ignored from outside (nohup) stay so.

    A second one ends the process at once. If the first has not ended it in a few seconds, because it is deep in native
    code or something caught the exception, it ends all the same. Elsewhere than in the main thread: nothing.
    ``for_good``: the interpreter ends after this; a signal from then on ends it without a stack trace.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = tuple(s for s in STOPPING if signal.getsignal(s) != signal.SIG_IGN)
    before = {s: signal.getsignal(s) for s in heard}
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    wakeup = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    over = threading.Event()
    watch = threading.Thread(target=_watch, args=(reader, heard, over), daemon=True, name=HARMLESS)
    watch.start()
    try:
        hear(heard)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if for_good or handler is None else handler)
        signal.set_wakeup_fd(wakeup)
        over.set()
        os.close(writer)


def hear(signals: tuple[signal.Signals, ...] = ()) -> None:
    """Take the signals over (again: pycolmap, once imported, has a handler of its own that prints stack traces)."""
    for number in signals or STOPPING:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)


def say_stopped() -> None:
    """End what is still at work, and say that the run was stopped."""
    end_helpers()
    # CPython remembers that a KeyboardInterrupt went through the exec() of a string (a library imported, a dataclass
    # made), though it was caught, and ends the process by SIGINT instead of its exit code. The next exec() forgets it.
    exec("")
    with contextlib.suppress(OSError, ValueError):  # the terminal may have gone
        sys.stderr.write(f"tiegraph: {_STOPPED}\n")
        sys.stderr.flush()


def _stop(number: int, frame: Any) -> None:
    for heard in STOPPING:  # a second one ends the process by itself, whatever it is at
        if signal.getsignal(heard) != signal.SIG_IGN:
            signal.signal(heard, signal.SIG_DFL)
    raise KeyboardInterrupt


def _watch(reader: int, heard: tuple[int, ...], over: threading.Event) -> None:
    with open(reader, "rb", buffering=0) as pipe:
        while True:
            byte = pipe.read(1)
            if not byte:
                return
            if byte[0] in heard:
                break
    if not over.wait(_GRACE_S):
        say_stopped()
        os._exit(_FAILED)
