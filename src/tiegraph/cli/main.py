"""`tiegraph <verb> ...`, a file each; stages are verbs too. Exit codes: 0 done, 1 failed, 2 misuse, 3 by `--strict`.

Ctrl-C, SIGTERM and SIGHUP end a run within seconds, in one line, and leave no process behind.
"""

import contextlib
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from typing import Any

from tiegraph.__version__ import __version__
from tiegraph.child import STOPPING, end_helpers
from tiegraph.cli.output import complain, lost_output, prepare_streams, say
from tiegraph.cli.verbs import VERBS, wants_page
from tiegraph.errors import EngineMissing, InputError, SettingsError, TiegraphError
from tiegraph.forking import HARMLESS, allow
from tiegraph.limits import explained
from tiegraph.scene.names import check_text
from tiegraph.text import meant

DONE, FAILED, MISUSE = 0, 1, 2
_STOPPED = "stopped; finished work is kept: run the same command again to go on"
_ASKED = threading.Event()  # to stop, by a signal
_GRACE_S = 6.0  # for what is under way to give up; then the process ends without it, as after a SIGKILL


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb; returns the exit code."""
    prepare_streams()
    if argv is None:  # the process is ours
        allow()
        gc.disable()  # until all is loaded: nothing of that is garbage, and to look for some takes a tenth of the time
    with stoppable(for_good=argv is None):
        return _answered(list(sys.argv[1:] if argv is None else argv), argv is None)


def _answered(arguments: list[str], for_good: bool) -> int:
    try:
        code = _guarded(arguments)
    except OSError as error:
        code = _lost(error)
    except KeyboardInterrupt:
        say_stopped()
        if for_good:  # nothing is left that could keep the process, or print
            os._exit(FAILED)
        return FAILED
    lost = lost_output()
    return code if lost is None or code == FAILED else _lost(lost)


def _guarded(arguments: list[str]) -> int:
    """A verb's exit code; every error but those of files and of the output is worded here."""
    try:
        for argument in arguments:
            check_text(argument, "argument")
        return _dispatch(arguments)
    except (InputError, SettingsError, EngineMissing) as error:
        return _fail(error, MISUSE)
    except TiegraphError as error:
        return _fail(error, FAILED)
    except SystemExit as stop:  # the argument parser: 0 after --help, 2 after a wrong option
        return stop.code if isinstance(stop.code, int) else MISUSE
    except Exception as error:
        if _ASKED.is_set():  # some libraries word a KeyboardInterrupt as an error of theirs
            raise KeyboardInterrupt from error
        logging.getLogger("tiegraph").debug("unexpected", exc_info=True)
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            raise  # standard output: what is written to files is worded where it is written
        if (told := explained(error)) is not None:
            return _fail(told, FAILED)
        if isinstance(error, OSError):
            where = f"{error.filename}: " if error.filename else ""
            text = f"{where}{error.strerror or error}; check the path and its permissions, then run again"
            return _fail(text, FAILED)
        return _fail(f"unexpected {type(error).__name__}: {error} (details in log.txt of the run folder)", FAILED)


def _lost(error: OSError) -> int:
    """The exit code when standard output is gone: fine for `tiegraph ... | head`."""
    if isinstance(error, BrokenPipeError):
        return DONE
    return _fail(f"standard output cannot be written ({error.strerror}): give it another place", FAILED)


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        lines = ["usage: tiegraph <verb> ...   (`tiegraph <verb> --help` for its options)", ""]
        lines += [f"  {name:<15} {verb.about}" for name, verb in VERBS.items()]
        say("\n".join(lines))
        return DONE
    if arguments[0] in ("-V", "--version", "version"):
        say(f"tiegraph {__version__}")
        return DONE
    name, rest = arguments[0], arguments[1:]
    if name not in VERBS:
        return _fail(f"unknown verb {name!r}{meant(name, VERBS)} (`tiegraph --help` lists all)", MISUSE)
    verb = VERBS[name]
    if verb.page and wants_page(rest):
        say(verb.page)
        return DONE
    run = verb.load(name)
    gc.enable()
    hear()
    return run(rest)


def _fail(error: object, code: int) -> int:
    complain(f"tiegraph: {error}")
    return code


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
    _ASKED.clear()
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
    _ASKED.set()
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
        os._exit(FAILED)


if __name__ == "__main__":
    sys.exit(main())
