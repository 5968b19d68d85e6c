"""Key, length, value: the form of GoPro's telemetry (GPMF; github.com/gopro/gpmf-parser, "GPMF Deeper Dive").

An entry is four letters, a letter for the type of its numbers, the bytes of a row, the number of rows, and the rows,
big-endian, filled up to four bytes. Entries nest; a reader here asks for one level at a time, so depth costs nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

_NUMBERS = {
    "b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "j": ">i8", "J": ">u8", "f": ">f4",
    "d": ">f8", "q": ">i4", "Q": ">i8",
}  # fmt: skip
_FIXED_POINT = {"q": 2.0**16, "Q": 2.0**32}
_REPEATED = re.compile(r"([A-Za-z])(?:\[(\d{1,3})\])?")
_HEAD = 8
_MOST_SHOWN = 40  # letters
_MOST_ROW = 255  # one byte says the length of a row


class BrokenEntry(ValueError):
    """An entry whose length or type cannot be; the text names it."""


@dataclass(frozen=True)
class Entry:
    """An entry: its key, the letter of its type (zero: it holds entries), bytes a row, rows, and their bytes."""

    key: str
    kind: str
    size: int
    count: int
    data: bytes

    def text(self) -> str:
        """Its bytes as characters, without those that fill it up."""
        return self.data.decode("latin-1").rstrip("\0 ")

    def rows(self, types: str = "") -> np.ndarray:
        """(rows, numbers a row) f8; ``types``: the letters of an entry of type "?" (TYPE). Raises BrokenEntry."""
        letters = _letters(types) if self.kind == "?" else self.kind * self._numbers()
        if not letters or any(c not in _NUMBERS for c in letters):
            kind = types[:_MOST_SHOWN] if self.kind == "?" else self.kind
            raise BrokenEntry(f"{self.key}: numbers of type {kind!r} are not known")
        row = np.dtype([(f"n{k}", _NUMBERS[c]) for k, c in enumerate(letters)])
        if row.itemsize != self.size:
            raise BrokenEntry(f"{self.key}: rows of type {letters} have {row.itemsize} bytes, not {self.size}")
        table = np.frombuffer(self.data, row)
        columns = [table[f"n{k}"].astype(float) / _FIXED_POINT.get(c, 1.0) for k, c in enumerate(letters)]
        return np.stack(columns, axis=1)

    def _numbers(self) -> int:
        return self.size // np.dtype(_NUMBERS.get(self.kind, ">u1")).itemsize


def entries(data: bytes) -> Iterator[Entry]:
    """The entries that stand one behind the other. Raises BrokenEntry where one is longer than what is left."""
    at = 0
    while len(data) - at >= _HEAD and any(data[at : at + 4]):  # a key of zeros fills up the rest
        key = data[at : at + 4].decode("latin-1")
        size, count = data[at + 5], int.from_bytes(data[at + 6 : at + 8], "big")
        begin, length = at + _HEAD, size * count
        if begin + length > len(data):
            raise BrokenEntry(f"{key!r} says {count} rows of {size} bytes, and {len(data) - begin} bytes are left")
        yield Entry(key, chr(data[at + 4]), size=size, count=count, data=data[begin : begin + length])
        at = begin + length + -length % 4


def _letters(types: str) -> str:
    """The letters of a row, those with a number in brackets as often as it says."""
    found = [(c, int(n or 1)) for c, n in _REPEATED.findall(types)]
    if _REPEATED.sub("", types) or sum(n for _, n in found) > _MOST_ROW:
        return ""
    return "".join(c * n for c, n in found)
