"""Processes of a run, and pycolmap calls in one: an abort of the native library becomes an error message.

COLMAP's worker threads end the interpreter when they meet an error (std::terminate); nothing in Python can catch that.
A run's processes (``Helper``: pool workers and children) leave the decision to stop to the process that started them:
they hear no signal of a terminal, end with it whatever ends it, and are ended by SIGKILL, for pycolmap's own handler of
SIGTERM can hang. They write every file whole or not at all, so that nothing is lost by it.
"""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any

from tiegraph import forking
from tiegraph.errors import ChildDied, ProcessLost, TiegraphError
from tiegraph.limits import explained, explained_text

_STACK_TRACE = ("@ ", "PC: @", "***")
_PATIENCE_S = 10.0  # for a process to end that has nothing left to do
STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP", "SIGXCPU")  # no library ends its own process by these
_NO_WARNING = "ignore:resource_tracker"
_LOOKING = threading.Lock()  # two threads at once: one of them would not learn how a process ended


class Helper(SpawnProcess):
    """A process of a run; see the module."""

    ended = False  # by us
    _forked = False

    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        """What starts it: the server where one runs, else a new interpreter."""
        if not forking.running():
            return SpawnProcess._Popen(process_obj)
        from multiprocessing.popen_forkserver import Popen  # not on every system

        return Popen(process_obj)

    @property
    def exitcode(self) -> int | None:
        """None while it runs."""
        with _LOOKING:
            code = super().exitcode
            # What multiprocessing says where the server was ended from outside, and its helpers with it.
            lost = code == 255 and self._forked and not forking.running()
            return -signal.SIGKILL if lost else code

    def start(self) -> None:
        """Start it deaf to the signals that stop a run: a terminal sends them to every process at once."""
        with _deaf(), _main_kept_out():
            self._forked = forking.running()
            super().start()

    def run(self) -> None:
        """What the process does (in itself)."""
        die_with_parent()
        super().run()

    def kill(self) -> None:
        """End it at once."""
        # A process closes its end of the sentinel before its exit code can be had.
        self.ended = self.ended or not wait([self.sentinel], 0)
        super().kill()

    terminate = kill

    def wait(self) -> None:
        """Wait until it has ended, and end it if it does not."""
        self.join(_PATIENCE_S)
        if self.exitcode is None:
            self.kill()
            self.join(_PATIENCE_S)  # not for ever: a process within a dead network drive does not even die


class Helpers(SpawnContext):
    """A multiprocessing context whose processes are helpers; it remembers those it made."""

    def __init__(self) -> None:
        super().__init__()
        self.made: list[Helper] = []
        with _deaf():  # multiprocessing's own helper too, which its queues and locks start
            pass

    def Process(self, *args: Any, **kwargs: Any) -> Helper:  # type: ignore[override]
        """A helper, not started."""
        self.made.append(Helper(*args, **kwargs))
        return self.made[-1]

    def end(self) -> None:
        """End them all at once."""
        for process in self.made:
            if process.pid is not None:
                process.kill()
        for process in self.made:
            if process.pid is not None:
                process.wait()

    def lost(self) -> list[int]:
        """Exit codes (negative: signals) of those that ended without being asked to."""
        codes = [p.exitcode for p in self.made if p.pid is not None and not p.ended]
        return [code for code in codes if code]


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """A process started meanwhile inherits that the stopping signals are blocked; here they come afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        # It would warn of "leaked semaphores" after a run that was ended at once
        sys.warnoptions.append(_NO_WARNING)
        try:
            resource_tracker.ensure_running()
        finally:
            sys.warnoptions.remove(_NO_WARNING)
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)  # again: Python before 3.12 unblocks in there
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _main_kept_out() -> Iterator[None]:
    """A process started meanwhile does not run the script of the program again, unless that is made for it: one that
    never asks for its ``__name__`` would start the whole run anew in every helper."""
    main = sys.modules["__main__"]
    try:
        kept = "__name__" in Path(getattr(main, "__file__", None) or "").read_text(errors="replace")
    except OSError:  # no script: a notebook, a prompt
        kept = True
    before = {} if kept else {"__file__": main.__file__, "__spec__": main.__spec__}
    vars(main).update(dict.fromkeys(before))
    try:
        yield
    finally:
        vars(main).update(before)


def start_server() -> bool:
    """From now on helpers are forked where that is allowed and safe; whether a server was started (``forking``)."""
    with _deaf():
        return forking.start()


def end_helpers() -> None:
    """End every helper of this process at once."""
    for process in multiprocessing.active_children():
        if isinstance(process, Helper):
            process.kill()


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def die_with_parent() -> None:
    """End this process when the one that started it has gone (also after its SIGKILL): no orphan keeps writing."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="die-with-parent").start()
    # Also while native code keeps the thread above from running. It is sent when the thread that started this process
    # ends: that waits for its helpers, so it ends with its process.
    forking.end_with(forking.server_pid() or parent.pid or 0)


def how_ended(code: int | None) -> str:
    """An exit code in words."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def from_outside(code: int | None) -> bool:
    """Whether an exit code says that the process was ended by somebody else: a person, or the system."""
    return how_ended(code).removeprefix("signal ") in _OUTSIDE


def run_in_child(
    function: Callable[..., Any],
    *args: Any,
    log: Path,
    on_message: Callable[[Any], None] | None = None,
    task: str = "",
) -> Any:
    """Run ``function(*args, send=...)`` in a child process and return its result.

    ``function`` must be importable (module level); it may call ``send(message)`` for progress, handed to ``on_message``
    in this process. What the child prints goes to the end of ``log``. Raises ChildDied with the last lines of the log
    if the child aborts, or for an error that is none of ours, ProcessLost if it was ended from outside, and re-raises
    what else ``function`` raised. Whatever ends the call ends the child.
    """
    return run_in_children(function, [args], log=log, on_message=on_message, task=task)[0]


def run_in_children(
    function: Callable[..., Any],
    calls: Sequence[tuple],
    *,
    log: Path,
    on_message: Callable[[Any], None] | None = None,
    task: str = "",
) -> list[Any]:
    """``run_in_child`` for several calls side by side, one process each; their results. The first error ends all."""
    context = Helpers()
    log.parent.mkdir(parents=True, exist_ok=True)
    # Dask's workers are daemonic, and multiprocessing lets no such process have children, which could outlive it; ours
    # ends with it by itself (``die_with_parent``).
    multiprocessing.current_process().daemon = False
    results: list[Any] = [None] * len(calls)
    running: dict[Any, tuple[int, Helper]] = {}
    value: Any
    pipes: list[Any] = []
    try:
        for k, args in enumerate(calls):
            receiver, sender = context.Pipe(duplex=False)
            process = context.Process(target=_child_main, args=(sender, str(log), function, args), daemon=False)
            pipes.append(receiver)
            running[receiver] = (k, process)
            process.start()
            sender.close()
        while running:
            for ready in wait(list(running)):
                try:
                    kind, value = ready.recv()  # type: ignore[union-attr]
                except (EOFError, OSError):  # it has ended and said nothing, or within a message
                    kind, value = "", None
                if kind == "message":
                    if on_message is not None:
                        on_message(value)
                    continue
                k, process = running.pop(ready)
                process.wait()
                if kind == "":
                    _explain_end(task or function.__name__, process.exitcode, log)
                if kind == "error":
                    raise value
                results[k] = value
    except BaseException:
        context.end()
        raise
    finally:
        for receiver in pipes:
            receiver.close()
    return results


def _child_main(sender: Any, log: str, function: Callable[..., Any], args: tuple) -> None:
    descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    try:
        sender.send(("result", function(*args, send=lambda message: sender.send(("message", message)))))
    except Exception as error:
        told = explained(error, Path(log).parent)  # here, before what filled the disk is gone
        if told is not None or isinstance(error, TiegraphError):
            sender.send(("error", told or error))
            return
        sender.send(("error", ChildDied(f"{function.__name__}: {type(error).__name__}: {error}\nlog: {log}")))


def _explain_end(task: str, exitcode: int | None, log: Path) -> None:
    how = how_ended(exitcode)
    if from_outside(exitcode):
        raise ProcessLost(
            f"{task}: its process was ended from outside ({how}): if not by you, most likely by the system for lack of "
            "memory; finished work is kept, run the same command again"
        )
    text = log.read_text(errors="replace") if log.exists() else ""
    # glog ends with a stack trace of the library, which would push the message out of the tail.
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(_STACK_TRACE)][-12:]
    said = f"{task}: the native library ended its process ({how})\nLast lines of {log}:\n  " + "\n  ".join(lines)
    raise explained_text(said, log.parent) or ChildDied(said)
