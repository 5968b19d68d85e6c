"""Boxes of an MP4 or QuickTime file (ISO/IEC 14496-12, 4.2): where what they hold begins and ends."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

_MOST_BOXES = 10_000


def boxes(file: BinaryIO, kind: bytes, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """First and last byte of what each box of a kind holds, among the boxes between two places of a file; of one that
    is cut off, as far as it goes."""
    for _ in range(_MOST_BOXES):
        if end - begin < 8:
            return
        file.seek(begin)
        data = file.read(16)
        size, head = int.from_bytes(data[:4], "big"), 8
        if size == 1:  # the size is too large for 4 bytes
            size, head = int.from_bytes(data[8:16], "big"), 16
        elif size == 0:  # to the end
            size = end - begin
        if size < head:
            return
        if data[4:8] == kind:
            yield begin + head, min(begin + size, end)
        begin += size
