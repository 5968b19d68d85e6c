"""What the verbs print: standard output and error that may be closed, full, or unable to show a letter."""

import math
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress

from tiegraph.text import one_line, printable


def prepare_streams() -> None:
    """Standard streams that take any text, and are there.

    A closed one would give its number to the next file that is opened, which then holds what libraries print; letters
    that the terminal's encoding lacks become escapes.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number: this one
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def lost_output() -> OSError | None:
    """Why standard output cannot be written (full disk, closed pipe), None if it can; later writes to it go nowhere."""
    try:
        sys.stdout.flush()
    except OSError as error:
        with suppress(OSError):  # else the interpreter tries again when it ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error
    return None


def say(text: str) -> None:
    """Text on standard output; what would act on the terminal is escaped."""
    sys.stdout.write(printable(text) + "\n")


def complain(text: str) -> None:
    """Text on standard error; further lines are indented, so that none looks like one of ours."""
    with suppress(OSError):  # the exit code says it too
        sys.stderr.write(printable(text).replace("\n", "\n  ") + "\n")
        sys.stderr.flush()


def show_table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], title: str | None = None, form: str = ""
) -> None:
    """A table on standard output; numbers with a fraction by ``form``, nothing for None and what is not finite."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*map(one_line, columns), title=title and one_line(title), box=None, title_justify="left")
    for row in rows:
        table.add_row(*(one_line(_cell(value, form)) for value in row))
    Console(markup=False, highlight=False, emoji=False).print(table)


def _cell(value: object, form: str) -> str:
    if isinstance(value, float):
        return format(value, form) if math.isfinite(value) else ""
    return "" if value is None else str(value)
