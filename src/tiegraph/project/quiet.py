"""What native libraries print while a run goes on belongs to its log: the terminal is the user's."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

_STDERR = 2


@contextmanager
def libraries_to(descriptor: int) -> Iterator[None]:
    """What libtiff, OpenCV or COLMAP write to standard error goes to an open file; Python's own ``sys.stderr`` goes on
    to where it went. Processes that begin meanwhile (the workers) inherit it."""
    try:
        saved = os.dup(_STDERR)
    except OSError:  # there is no standard error
        yield
        return
    before = sys.stderr
    own = _over(saved) if _is_on(before) else None
    if own is not None:
        sys.stderr = own
    os.dup2(descriptor, _STDERR)
    try:
        yield
    finally:
        if own is not None:
            if sys.stderr is own:
                sys.stderr = before
            with suppress(OSError, ValueError):  # the terminal has gone
                own.flush()
        os.dup2(saved, _STDERR)
        os.close(saved)


def _is_on(stream: TextIO | None) -> bool:
    """Whether a stream writes to standard error itself, and not to what stands in for it (a notebook, a test)."""
    try:
        if stream is None or stream.fileno() != _STDERR:
            return False
        stream.flush()
        return True
    except (OSError, ValueError):
        return False


def _over(descriptor: int) -> TextIO:
    encoding = sys.stderr.encoding or "utf-8"
    return open(descriptor, "w", buffering=1, encoding=encoding, errors="backslashreplace", closefd=False)
