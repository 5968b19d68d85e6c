"""`tiegraph <verb> ...`, a file each; stages are verbs too. Exit codes: 0 done, 1 failed, 2 misuse, 3 by `--strict`."""

import gc
import logging
import os
import sys
from collections.abc import Sequence

from tiegraph.__version__ import __version__
from tiegraph.cli.output import complain, lost_output, prepare_streams, say
from tiegraph.cli.stopping import hear, say_stopped, stoppable
from tiegraph.cli.verbs import VERBS, wants_page
from tiegraph.errors import EngineMissing, InputError, SettingsError, TiegraphError
from tiegraph.forking import allow
from tiegraph.limits import explained
from tiegraph.scene.names import check_text

DONE, FAILED, MISUSE = 0, 1, 2


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
        logging.getLogger("tiegraph").debug("unexpected", exc_info=True)
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            raise  # standard output: what is written to files is worded where it is written
        if (told := explained(error)) is not None:
            return _fail(told, FAILED)
        if isinstance(error, OSError):
            return _fail(_os_text(error), FAILED)
        return _fail(f"unexpected {type(error).__name__}: {error} (details in log.txt of the run folder)", FAILED)


def _lost(error: OSError) -> int:
    """The exit code when standard output is gone: fine for `tiegraph ... | head`."""
    if isinstance(error, BrokenPipeError):
        return DONE
    return _fail(f"standard output cannot be written ({error.strerror}): give it another place", FAILED)


def _os_text(error: OSError) -> str:
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}; check the path and its permissions, then run again"


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        return _help()
    if arguments[0] in ("-V", "--version", "version"):
        say(f"tiegraph {__version__}")
        return DONE
    name, rest = arguments[0], arguments[1:]
    if name not in VERBS:
        import difflib

        near = difflib.get_close_matches(name, list(VERBS), n=1)
        hint = f" Perhaps you meant {near[0]!r}." if near else ""
        return _fail(f"unknown verb {name!r}.{hint} `tiegraph --help` lists all", MISUSE)
    verb = VERBS[name]
    if verb.page and wants_page(rest):
        say(verb.page)
        return DONE
    run = verb.load()
    gc.enable()
    hear()
    return run(rest)


def _fail(error: object, code: int) -> int:
    complain(f"tiegraph: {error}")
    return code


def _help() -> int:
    lines = ["usage: tiegraph <verb> ...   (`tiegraph <verb> --help` for its options)", ""]
    lines += [f"  {name:<15} {verb.about}" for name, verb in VERBS.items()]
    say("\n".join(lines))
    return DONE


if __name__ == "__main__":
    sys.exit(main())
