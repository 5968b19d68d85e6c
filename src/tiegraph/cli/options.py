"""The options of a verb, read from the command line; what is wrong with them is one line, as all our errors are."""

import contextlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import tyro
from pydantic import ValidationError

from tiegraph.cli.verbs import HELP, HELP_ALL
from tiegraph.errors import SettingsError
from tiegraph.project.progress import Reporter


@dataclass(frozen=True, kw_only=True)
class Talk:
    """Options of every verb that says how far it is."""

    json: bool = False
    """One JSON object a line on standard output instead of text."""
    quiet: bool = False
    """Say nothing but errors."""

    def reporter(self) -> Reporter:
        """The progress these options ask for."""
        return Reporter("json" if self.json else "quiet" if self.quiet else "auto")


_FRAME = "│╭╮╰╯─ \t"  # of the box that tyro prints
_SHOWN = 300
_SAID: tuple[tuple[str, Any], ...] = (  # what pydantic and tyro say, and what is shown
    (r" For further information visit \S+", ""),
    (r"Error parsing request\.\w+: \d+ validation errors? for \w+ (\w+)", lambda m: "--" + m[1].replace("_", "-")),
    (r"Error parsing (?:settings\.)?([\w.]+): \d+ validation errors? for \w+ ", r"\1."),
    (r" \[type=\w+, input_value=(.*?), input_type=\w+\]", r" (given: \1)"),
    (r"Value error, ", ""),
    (r"Unrecognized options: (?=[^-])", "one argument too many, or the name of its option is missing: "),
)


def options_of(
    function: Callable[..., Any], program: str, arguments: list[str], page: str = HELP[-1], **how: Any
) -> Any:
    """What ``function``, or a class of options, makes of the arguments, by tyro. Raises SettingsError for wrong ones.

    ``page``: the argument that shows all options of the verb.
    """
    said = io.StringIO()
    arguments = [HELP[-1] if a == HELP_ALL else a for a in arguments]
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(function, prog=program, args=arguments, **how)
    except SystemExit as stop:
        if not stop.code:  # --help
            raise
        text = _one_line(said.getvalue())
    except ValidationError as error:  # of settings that stand among the options
        text = "; ".join(map(_wrong, error.errors()))
    raise SettingsError(f"{text} (`{program} {page}` lists all options)")


def _wrong(error: Any) -> str:
    name = "-".join(str(part) for part in error["loc"]).replace("_", "-")
    return f"--{name} {error['input']}: {error['msg'].removeprefix('Value error, ')}"


def _one_line(box: str) -> str:
    """The first part of a box, and what the second proposes."""
    parts: list[list[str]] = [[]]
    for line in box.splitlines()[1:]:
        text = line.strip(_FRAME)
        if text:
            parts[-1].append(text)
        elif "─" in line:
            parts.append([])
    text = " ".join(parts[0])
    for noise, rest in _SAID:
        text = re.sub(noise, rest, text)
    near = parts[1] if len(parts) > 1 and parts[1][:1] == ["Perhaps you meant:"] else []
    near_text = f"; perhaps you meant {near[1].split()[0]}?" if len(near) > 1 else ""
    return (text if len(text) <= _SHOWN else text[:_SHOWN] + " ...").rstrip(".") + near_text
