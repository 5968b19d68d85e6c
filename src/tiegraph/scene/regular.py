"""Only regular files may be opened: a named pipe waits forever for its writer, and ``/dev/zero`` never ends.

Also a cache of file contents that is valid as long as the file stays the same: a cache by path alone gives old data
if a process outlives a run, in the workers of Dask, in a notebook.
"""

import errno
import functools
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
MOST_BYTES = 1 << 32  # of a file that is read whole: image formats end there (TIFF), tables are far smaller


def real_path(path: Path | str) -> Path:
    """The absolute path without links. For links in a ring, the path so far: opening it raises the error."""
    return Path(os.path.realpath(path))


def names_file(text: str) -> bool:
    """Whether an option for words or a file names a file; words may be longer than a name."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def regular(path: Path, most_bytes: int | None = MOST_BYTES) -> Path:
    """The path, if it is a file or leads to one: every file of the user passes here before it is opened.

    Raises OSError whose ``strerror`` names its kind, or that it is larger than ``most_bytes`` (None: any
    size), as well as the system's error for a path that leads nowhere.
    """
    path = Path(path)
    info = path.stat()
    if not stat.S_ISREG(info.st_mode):
        kind = next((word for test, word in _KINDS if test(info.st_mode)), "something else")
        raise OSError(errno.EINVAL, f"{kind}, not a file", str(path))
    if most_bytes is not None and info.st_size > most_bytes:
        size, most = (f"{n / 2**30:.3g} GiB" for n in (info.st_size, most_bytes))
        raise OSError(errno.EFBIG, f"{size}, more than the {most} that such a file may have", str(path))
    return path


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
        return None  # the function reports the error
    return info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns
