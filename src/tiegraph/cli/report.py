"""`tiegraph report OUT` (the stage), in another language, and printed to a PDF."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from tiegraph.cli import run
from tiegraph.cli.output import say
from tiegraph.report.pdf import find_browser, print_pdf


@dataclass(frozen=True)
class _Options(run.Common):
    pdf: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False  # main takes it
    """Print report.html to report.pdf beside it, by a browser of the Chromium family."""
    language: str | None = None  # main takes it
    """Language of the report: en or ja (sets report.language)."""


def main(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--pdf`` also printed."""
    rest = [_setting(a) for a in arguments if a != "--pdf"]
    folder, _ = run.preparsed(rest)
    if len(rest) == len(arguments) or folder is None:
        return run.main_stage("report", rest, _Options)
    find_browser()  # what is missing is said before the work
    code = run.main_stage("report", rest, _Options)
    target = folder / "report.pdf"
    print_pdf(folder / "report.html", target)
    if "--quiet" not in rest and "--json" not in rest:
        say(f"printed: {target}")
    return code


def _setting(argument: str) -> str:
    """``--language`` is the setting of the stage."""
    name, equals, value = argument.partition("=")
    return f"--report.language{equals}{value}" if name == "--language" else argument
