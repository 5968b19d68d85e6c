"""`tiegraph <verb> ...`: one file a verb; a stage's name is a verb too. Exit codes: 0 done, 1 failed, 2 misuse."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Sequence

from tiegraph import __version__
from tiegraph.cli.output import complain, lost_output, prepare_streams, say
from tiegraph.cli.stopping import hear, say_stopped, stoppable
from tiegraph.errors import EngineMissing, InputError, SettingsError, TiegraphError
from tiegraph.limits import explained
from tiegraph.scene.names import check_text

DONE, FAILED, MISUSE = 0, 1, 2


def verbs() -> dict[str, tuple[Callable[[list[str]], int], str]]:
    """Every verb: the function that takes its arguments, and one line of help."""
    from tiegraph.cli import compare, demo, doctor, evaluate, export, init, masks, network, run, shots, status
    from tiegraph.pipeline import STAGES

    table: dict[str, tuple[Callable[[list[str]], int], str]] = {
        "run": (run.main, "from a folder of images to the cloud and the report (or --until a stage)"),
        "demo": (demo.main, "the example survey, from images to the report"),
        "init": (init.main, "show what is found in a folder; write tiegraph.toml and rig.toml to edit"),
        "status": (status.main, "which stages of a run folder are up to date, and why not"),
        "compare": (compare.main, "two or more run folders side by side: the papers' tables"),
        "shots": (shots.main, "a point cloud for each shot of a calibrated rig, without a sparse model"),
        "export": (export.main, "the depth maps as a dense workspace for COLMAP's stereo_fusion"),
        "doctor": (doctor.main, "versions, cores, memory, and what is missing"),
    }
    for stage in STAGES:
        table[stage.name] = (_stage_verb(stage.name), f"stage: makes {', '.join(stage.makes)}")
    table["network"] = (network.main, "stage: makes network.npz, network.csv; --coverage: is anything missing, on site")
    table["masks"] = (masks.main, "stage: makes masks, classes, masks.csv; --compare FOLDER: against true masks")
    table["evaluate"] = (evaluate.main, "stage: makes metrics.json; or a point cloud against a reference cloud")
    return table


def _stage_verb(stage: str) -> Callable[[list[str]], int]:
    from tiegraph.cli import run

    return lambda arguments: run.main_stage(stage, arguments)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb; returns the exit code."""
    prepare_streams()
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
    table = verbs()
    hear()
    verb = arguments[0]
    if verb not in table:
        import difflib

        near = difflib.get_close_matches(verb, list(table), n=1)
        hint = f" Perhaps you meant {near[0]!r}." if near else ""
        return _fail(f"unknown verb {verb!r}.{hint} `tiegraph --help` lists all", MISUSE)
    return table[verb][0](arguments[1:])


def _fail(error: object, code: int) -> int:
    complain(f"tiegraph: {error}")
    return code


def _help() -> int:
    lines = ["usage: tiegraph <verb> ...   (`tiegraph <verb> --help` for its options)", ""]
    lines += [f"  {name:<15} {text}" for name, (_, text) in verbs().items()]
    say("\n".join(lines))
    return DONE


if __name__ == "__main__":
    sys.exit(main())
