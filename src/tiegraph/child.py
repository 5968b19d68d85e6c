"""pycolmap calls in a child process: an abort of the native library becomes an error message, not the end of the run.

COLMAP's worker threads end the interpreter when they meet an error (std::terminate); nothing in Python can catch that.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tiegraph.errors import ReconstructionError, TiegraphError
from tiegraph.limits import explained, explained_text

_TAIL_LINES = 12
_STACK_TRACE = ("@ ", "PC: @", "***")


def die_with_parent() -> None:
    """End this process when the one that started it has gone (also after its SIGKILL): no orphan keeps writing."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="die-with-parent").start()


def run_in_child(
    function: Callable[..., Any],
    *args: Any,
    log: Path,
    on_message: Callable[[Any], None] | None = None,
    task: str = "",
) -> Any:
    """Run ``function(*args, send=...)`` in a child process and return its result.

    ``function`` must be importable (module level); it may call ``send(message)`` for progress, handed to ``on_message``
    in this process. What the child prints goes to the end of ``log``. Raises ReconstructionError with the last lines
    of the log if the child aborts, and re-raises what ``function`` raised.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    log.parent.mkdir(parents=True, exist_ok=True)
    process = context.Process(target=_child_main, args=(sender, str(log), function, args), daemon=False)
    process.start()
    sender.close()
    try:
        outcome = _receive(receiver, on_message)
    except BaseException:
        process.terminate()
        raise
    finally:
        receiver.close()
        process.join()
    if outcome is None:
        text = _abort_text(task or function.__name__, process.exitcode, log)
        raise explained_text(text, log.parent) or ReconstructionError(text)
    kind, value = outcome
    if kind == "error":
        raise value
    return value


def _receive(receiver: Any, on_message: Callable[[Any], None] | None) -> tuple[str, Any] | None:
    while True:
        try:
            kind, value = receiver.recv()
        except EOFError:
            return None
        if kind != "message":
            return kind, value
        if on_message is not None:
            on_message(value)


def _child_main(sender: Any, log: str, function: Callable[..., Any], args: tuple) -> None:
    die_with_parent()
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
        sender.send(
            ("error", ReconstructionError(f"{function.__name__}: {type(error).__name__}: {error} (log: {log})"))
        )


def _abort_text(task: str, exitcode: int | None, log: Path) -> str:
    how = f"exit code {exitcode}"
    if exitcode is not None and exitcode < 0:
        how = f"signal {signal.Signals(-exitcode).name}"
    text = log.read_text(errors="replace") if log.exists() else ""
    # glog ends with a stack trace of the library, which would push the message out of the tail.
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(_STACK_TRACE)][-_TAIL_LINES:]
    return f"{task}: the native library ended its process ({how}). Last lines of {log}:\n  " + "\n  ".join(lines)
