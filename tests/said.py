"""What the package says: refusals with their words, notes in results."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import pytest

from tiegraph.errors import InputError


@contextmanager
def refused(words: str, *names: str) -> Iterator[None]:
    """An ``InputError`` is raised whose message has the words (a regular expression) and each of the names."""
    with pytest.raises(InputError, match=words) as error:
        yield
    assert [n for n in names if n not in str(error.value)] == [], str(error.value)


def says(notes: Iterable[str], words: str) -> bool:
    """Whether one of the notes has the words (a regular expression)."""
    return any(re.search(words, note) for note in notes)
