"""What a cell of a table says: a number, a length, an angle, a time."""

import re
from collections.abc import Sequence
from datetime import datetime, timezone
from functools import lru_cache

import numpy as np

from tiegraph.errors import InputError

UNIT_M = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048,
    "feet": 0.3048, "foot": 0.3048, "ftus": 1200 / 3937, "us-ft": 1200 / 3937, "us ft": 1200 / 3937,
    "us survey feet": 1200 / 3937,
}  # fmt: skip
UNIT_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}

# A half of the Earth, degrees, minutes, seconds, a half: "N35.5", "35 deg 41' 22.2\" N", "35°41'22.2\"".
_ANGLE = re.compile(
    r"\s*([NSEW])?\s*([+-]?\d+(?:\.\d*)?)\s*(?:°|DEG|D)?\s*(?:(\d+(?:\.\d*)?)\s*['′M])?\s*(?:(\d+(?:\.\d*)?)\s*(?:\"|″|''|S(?=\s)))?"
    r"\s*([NSEW])?\s*"
)
_LENGTH = re.compile(r"([+-]?\d+(?:\.\d*)?)\s*([a-z]+)\.?(?: (above|below) .*)?")  # exiftool: 40.2 m Above Sea Level
# Of numbers as people group and mark them: 494 399,21 or 494.399,21, and 494,399.21 or 494'399.21.
_COMMA_MARKS = re.compile(r"[+-]?(?:\d{1,3}(?:[. \u00a0\u202f'’]\d{3})+|\d*),\d+(?:[eE][+-]?\d+)?")
_COMMA_GROUPS = re.compile(r"[+-]?\d{1,3}(?:[, \u00a0\u202f'’]\d{3})+(?:\.\d*)?")
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_GROUPS = re.compile(r"[ \u00a0\u202f'’]")


def number(text: str) -> float:
    """The number that a cell is, NaN if it is none."""
    try:
        return float("nan") if "_" in text else float(text)
    except ValueError:
        return float("nan")


def length_m(text: str, unit_m: float) -> float:
    """Metres of a cell that is a number of units, or has one of its own; NaN if it is none."""
    value = number(text)
    if value == value or not (found := _LENGTH.fullmatch(text.lower())):
        return value * unit_m
    return float(found[1]) * UNIT_M.get(found[2], float("nan")) * (-1 if found[3] == "below" else 1)


def degrees(text: str) -> tuple[float, str]:
    """Degrees of a cell, which may have minutes and seconds, NaN if it is none, and the letter of its half or ""."""
    value = number(text)
    if value == value or not (found := _ANGLE.fullmatch(text.upper().replace(",", "."))):
        return value, ""
    whole, minutes, seconds = (float(found[n] or 0) for n in (2, 3, 4))
    size = abs(whole) + minutes / 60 + seconds / 3600
    return -size if found[2].startswith("-") else size, found[1] or found[5] or ""


def says_value(text: str) -> bool:
    """Whether a cell is a number, an angle or a time, and no name."""
    values = (degrees(text)[0], parse_time(text))
    return bool(_COMMA_MARKS.fullmatch(text)) or any(v == v for v in values)


def comma_marks(cells: Sequence[str]) -> bool | None:
    """Whether the numbers among cells have commas for points; None where nothing tells: 1,234 may be either."""
    marks, groups, either = (sum(bool(p.fullmatch(c)) for c in cells) for p in (_COMMA_MARKS, _COMMA_GROUPS, _EITHER))
    if either and (marks > either) == (groups > either):
        return None
    return marks > either


def plain(cell: str, comma: bool | None, where: str) -> str:
    """A number as Python writes it; what is none stays. Raises InputError, with ``where``, for one that may be two."""
    mark = "." if comma else ","
    if comma is not False and mark in cell and _EITHER.fullmatch(cell.replace(mark, ",")):
        raise InputError(
            f"{where}: {cell!r} may be {cell.replace(mark, '.')} or {cell.replace(mark, '')}: write numbers with a "
            "point and without separators of thousands"
        )
    if comma and (_COMMA_MARKS.fullmatch(cell) or _COMMA_GROUPS.fullmatch(cell.replace(".", ","))):
        return _GROUPS.sub("", cell).replace(".", "").replace(",", ".")
    return _GROUPS.sub("", cell).replace(",", "") if _COMMA_GROUPS.fullmatch(cell) else cell


def parse_time(text: str) -> float:
    """Seconds of a number, an ISO 8601 time (without zone: taken as UTC) or hh:mm:ss; NaN if it is none of them."""
    seconds = number(text)
    if seconds == seconds:
        return seconds
    text = text.strip().replace(",", ".")
    clock = re.fullmatch(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:\.\d+)?)Z?", text)
    if clock:
        return int(clock[1]) * 3600 + int(clock[2]) * 60 + float(clock[3])
    text = re.sub(r"^(\d{4})[:/](\d\d)[:/](\d\d)", r"\1-\2-\3", text)  # as EXIF and RTKLIB write dates
    text = re.sub(r"^(\d\d)\.(\d\d)\.(\d{4})", r"\3-\2-\1", text)  # as they are written in German and Russian
    whole, _, fraction = text.replace("/", "-").replace("Z", "+00:00").partition(".")
    digits = re.match(r"\d+", fraction)
    try:
        stamp = datetime.fromisoformat(re.sub(r"\s+", " ", whole) + (fraction[digits.end() :] if digits else ""))
    except ValueError:
        return float("nan")
    stamp = stamp if stamp.tzinfo else stamp.replace(tzinfo=timezone.utc)
    return stamp.timestamp() + (float(f"0.{digits[0]}") if digits else 0.0)


@lru_cache(maxsize=64)
def seconds_of(text: str, form: str) -> float:
    """Seconds since 1970 of a date, UTC, in a form of ``strptime``; NaN if it is none."""
    try:
        return datetime.strptime(text, form).replace(tzinfo=timezone.utc).timestamp()
    except ValueError:
        return float("nan")


def date_text(time_s: float) -> str:
    """A time (seconds since 1970, UTC) as people read it."""
    return f"{datetime.fromtimestamp(time_s, timezone.utc):%Y-%m-%d %H:%M:%S}"


def in_seconds(times: np.ndarray) -> np.ndarray:
    """Times since 1970 in milli-, micro- or nanoseconds as seconds; other times unchanged."""
    known = times[np.isfinite(times)]
    size = float(np.median(np.abs(known))) if len(known) else 0.0
    for limit, factor in ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3)):
        if size > limit:
            return times * factor
    return times
