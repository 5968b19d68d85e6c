"""The texts of a report in the reader's language: every text of the page is English in the code, and translated here.

``ja.toml`` is the one table of Japanese: ``[page]`` texts of this package, ``[said]`` texts that other stages write
into receipts and ``metrics.json``, where ``#`` is a number and ``{}`` a part that is looked up in its turn. Other
texts stay English: names, remarks and warnings of receipts.
"""

import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.resources import files
from typing import Any

from markupsafe import Markup

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_CURRENT: ContextVar[str] = ContextVar("language", default="en")


@contextmanager
def language(name: str) -> Iterator[None]:
    """Texts are in this language ("en" or "ja") inside the block."""
    before = _CURRENT.set(name)
    try:
        yield
    finally:
        _CURRENT.reset(before)


@cache
def table(name: str) -> Mapping[str, Mapping[str, str]]:
    """The translations {"page": {English: text}, "said": ...} of a language; empty for English."""
    if name == "en":
        return {"page": {}, "said": {}}
    return tomllib.loads(files("tiegraph.report.texts").joinpath(f"{name}.toml").read_text(encoding="utf-8"))


def t(text: str, *values: Any) -> str:
    """A text of this package in the current language; with ``values`` in its ``{}``, escaped, as Markup."""
    found = table(_CURRENT.get())["page"].get(text, text)
    return Markup(found).format(*values) if values else found


def many(amount: int, one: str, several: str, *values: Any) -> str:
    """A text for one thing or for several; ``{}`` is filled with ``values``."""
    return t(one if amount == 1 else several, *values)


def capital(text: str) -> str:
    """A text that begins with a capital."""
    return text[:1].upper() + text[1:]


def said(text: str) -> str:
    """A text of another stage in the current language; unchanged if the table does not have it."""
    for pattern, form in _patterns(_CURRENT.get()):
        match = pattern.fullmatch(text)
        if match:
            return form.format(*map(said, match.groups()))
    return text


@cache
def _patterns(name: str) -> list[tuple[re.Pattern[str], str]]:
    """The table ``said`` as patterns, the longest text first: the most specific one decides."""
    rows = sorted(table(name)["said"].items(), key=lambda row: -len(row[0].replace("{}", "")))
    forms = (
        (re.escape(english).replace(r"\#", r"(\d[\d.,]*)").replace(r"\{\}", "(.+?)"), form) for english, form in rows
    )
    return [(re.compile(pattern), form) for pattern, form in forms]
