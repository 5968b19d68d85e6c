"""What was read of a file is kept in memory for as long as the file stays the same.

A cache by path alone gives old data where a process outlives a run: in the workers of Dask, in a notebook.
"""

import functools
import os
from collections.abc import Callable
from typing import Any


def cached_by_file(maxsize: int, file: Callable[..., Any] | None = None) -> Callable[[Callable], Any]:
    """``functools.lru_cache`` for functions that read a file.

    ``file`` gives the file's path from the arguments (default: it is the first of them). A file that was replaced or
    changed (number, size or time) is read again. ``cache_clear()`` of the function forgets all.
    """

    def decorate(function: Callable) -> Any:
        @functools.lru_cache(maxsize)
        def kept(_stamp: tuple[int, ...] | None, *args: Any) -> Any:
            return function(*args)

        @functools.wraps(function)
        def call(*args: Any) -> Any:
            return kept(_stamp_of(args[0] if file is None else file(*args)), *args)

        call.cache_clear = kept.cache_clear  # type: ignore[attr-defined]
        return call

    return decorate


def _stamp_of(path: Any) -> tuple[int, ...] | None:
    try:
        info = os.stat(path)
    except OSError:
        return None  # the function says what is wrong
    return info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns
