"""The errors tiegraph raises: one root, and each text names the value at fault and the remedy."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from tiegraph.text import meant


class TiegraphError(Exception):
    """Root of all errors raised on purpose."""


class InputError(TiegraphError, ValueError):
    """A file or value given by the user cannot be used."""


class UnreadableArtefact(InputError):
    """A file that a stage made cannot be read any more; ``path`` says which, so that its stage can make it again."""

    def __init__(self, path: object, why: object) -> None:
        super().__init__(str(path), str(why))  # as they are, so that the error survives the way from another process
        self.path = Path(str(path))

    def __str__(self) -> str:
        return f"{self.path} cannot be read any more ({self.args[1]})"


class SettingsError(TiegraphError, ValueError):
    """A setting is unknown, misspelt or out of range."""


class ReconstructionError(TiegraphError, RuntimeError):
    """The images were readable, but what was to be made of them could not be: no model, no depth, no cloud."""


class ChildDied(ReconstructionError):
    """A child process ended by itself, by a fault of a library or of ours; below the first line: how its log ends."""


class ProcessLost(ChildDied):
    """A process of the run was ended from outside, by a person or by the system, or had not enough memory."""


class EngineMissing(TiegraphError, ImportError):
    """A chosen engine is not installed or has no such name."""


def optional(module: str, extra: str, use: str, instead: str = "") -> Any:
    """A module of a package that comes with an ``extra`` of tiegraph.

    Raises EngineMissing if it is not installed: what needs it (``use``), how to install it, what to do ``instead``.
    """
    try:
        return import_module(module)
    except ImportError:
        package, remedy = module.partition(".")[0].replace("_", "-"), f"pip install 'tiegraph[{extra}]'{instead}"
        raise EngineMissing(f"{use} needs {package}, which is not installed: {remedy}") from None


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Whatever a library raises of a damaged file or folder becomes an InputError: it is no readable ``kind``."""
    try:
        yield
    except TiegraphError:
        raise
    except Exception as error:  # each library has classes of its own, also of damage
        why = str(error).partition("\n")[0] or type(error).__name__  # libE57 writes a page
        raise InputError(f"{path}: not a readable {kind}: {why}; is it cut off? Copy or export it again") from error


def choose(kind: str, name: str, table: dict) -> object:
    """Return ``table[name]``; an unknown name raises SettingsError listing the valid ones."""
    if name in table:
        return table[name]
    raise SettingsError(f"unknown {kind} {name!r}: valid are {', '.join(sorted(table))}{meant(name, table)}")
