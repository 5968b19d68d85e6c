"""Files: ours appear whole or not at all, listed before in the journal of the run folder; the user's are regular ones.

A run folder is a folder with the mark ``receipts/folder.json``. Before anything is written into one, its name goes to
``receipts/made.txt``: after a kill at any moment it is known which files are ours and may be removed. Temporary files
have names with the process id, by which those of killed processes are found and removed: in a run folder when it
is opened, elsewhere when the same file is written again.

Of the user's files only regular ones may be opened: a named pipe waits forever for its writer, and ``/dev/zero`` never
ends. A cache of what a file contains is valid as long as the file stays the same: by path alone it would give old data
if a process outlives a run, in the workers of Dask, in a notebook.
"""

import errno
import functools
import json
import os
import re
import shutil
import stat
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.limits import explained

MARK = "receipts/folder.json"
JOURNAL = "receipts/made.txt"
TEMPORARIES = ".*.part*"
_TEMPORARY = re.compile(r"\.[0-9a-f]{8}\.(\d+)\.part")
_SCRATCH = f".{zlib.crc32(b'tiegraph'):08x}"
_CLOCKS_S = 2.0  # the system gives its start time in whole seconds


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path``, of a file or a folder, that replaces it when the block ends well, and is
    removed otherwise.

    The content is on the disk before it has its name. Raises InputError when the disk is full (the libraries below
    report that in many ways).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    own = f".{zlib.crc32(os.fsencode(path.name)):08x}"
    temporary = path.with_name(f"{own}.{os.getpid()}.part{path.suffix}")
    try:
        if not claim(path):
            sweep(path.parent.glob(f"{own}.*.part*"))
        yield temporary
        if not temporary.is_symlink():
            sync(temporary)
        os.replace(temporary, path)
    except Exception as error:
        told = explained(error, path.parent)
        if isinstance(told, InputError):
            raise InputError(f"cannot write {path}: {told}") from error
        raise
    finally:
        remove(temporary)


@contextmanager
def scratch_folder(inside: Path | None = None) -> Iterator[Path]:
    """A folder for the duration of the block, ``inside`` another one, with which it is removed after a kill, or among
    the system's temporary ones, where those of killed processes are removed when the next is made."""
    if inside is None:
        sweep(Path(tempfile.gettempdir()).glob(f"{_SCRATCH}.*"))
    with tempfile.TemporaryDirectory(prefix=f"{_SCRATCH}.{os.getpid()}.part-", dir=inside) as made:
        yield Path(made)


def remove(path: Path) -> None:
    """Remove a folder, or a file or link with SQLite's files beside a database, whether they exist or not."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
        return
    # A log left beside a replaced database would be applied to the new one.
    for suffix in ("", "-wal", "-shm", "-journal"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def sweep(paths: Iterable[Path]) -> None:
    """Remove temporary files or folders of ``replacing`` whose process has ended."""
    for path in list(paths):
        found = _TEMPORARY.match(path.name)
        with suppress(OSError):
            if found and not _is_alive(int(found[1]), path.lstat().st_mtime):
                remove(path)


def _is_alive(number: int, written_s: float) -> bool:
    """Whether the process of a number may have written a file: one that began later only has the same number, as in
    containers, where each begins at 1."""
    import psutil

    try:
        process = psutil.Process(number)
        return process.status() != psutil.STATUS_ZOMBIE and process.create_time() < written_s + _CLOCKS_S
    except psutil.AccessDenied:
        return True
    except psutil.Error:
        return False


def must_be_new(out: Path, path: Path | None = None) -> None:
    """Raise InputError if the path of ``-o``, or a ``path`` that belongs to it, exists already."""
    path = path or out
    if os.path.lexists(path):
        which = f"-o {out}" if path == out else f"-o {out}: {path}"
        raise InputError(f"{which} exists already: give another name, or remove it")


def is_temporary(name: str) -> bool:
    """Whether a path is, or lies in, a temporary one of ``replacing``, left behind by a kill."""
    return any(_TEMPORARY.match(part) for part in name.split("/"))


def sync(path: Path) -> None:
    """Wait until a file (or the list of a folder's names) is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def claim(path: Path) -> bool:
    """Note in the journal of the run folder around ``path`` that the file, or all future contents of the folder
    ``path``, are ours; whether there is one. ``replacing`` does this itself; files written by libraries need it."""
    path = path.absolute()
    for folder in path.parents:
        if (folder / MARK).exists():
            with open(folder / JOURNAL, "a", encoding="ascii") as journal:
                journal.write(json.dumps(path.relative_to(folder).as_posix()) + "\n")
            return True
    return False


def same_file(path: Path, other: Path) -> None:
    """Give a file a second name (a hard link, or a copy where the file system has none)."""
    with replacing(other) as temporary:
        try:
            os.link(path, temporary)
        except OSError:
            shutil.copyfile(path, temporary)


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
            try:
                info = os.stat(args[0] if file is None else file(*args))
            except OSError:
                return kept(None, *args)  # the function reports the error
            return kept((info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns), *args)

        call.cache_clear = kept.cache_clear  # type: ignore[attr-defined]
        return call

    return decorate
