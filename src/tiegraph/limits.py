"""When a machine is at its limits: full disks, size limits and little memory, in whichever words a library says so.

COLMAP, SQLite, numpy, OpenCV and laspy each have their own ("No registered database factory succeeded", "disk I/O
error", "383208 requested and 256528 written", "std::bad_alloc"), and some only abort. So an error is judged by its
number, its text, and by what the machine looks like at that moment.
"""

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tiegraph.errors import EngineMissing, InputError, ProcessLost, SettingsError, TiegraphError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_ROOM_BYTES = 1 << 20
_SHOWN = 200  # characters of a library's words
_STARVED = (errno.ENOMEM, errno.EAGAIN)
_FULL_WORDS = re.compile(
    r"no space left|disk (is )?full|quota exceeded|file too large|File size limit|SIGXFSZ"
    r"|\d+ requested and \d+ written",
    re.IGNORECASE,
)
_WRITE_WORDS = re.compile(  # said of a disk that is full, among other things
    r"disk I/O error|database factory|unable to open database|Could not open|Cannot open|SIGBUS|readonly database",
    re.IGNORECASE,
)
_MEMORY_WORDS = re.compile(
    r"bad_alloc|insufficient memory|cannot allocate|can't start new thread|failed to map segment|out of memory"
    r"|std::system_error|Resource temporarily unavailable|pthread_create failed",
    re.IGNORECASE,
)


def explained(error: BaseException, folder: Path | None = None) -> TiegraphError | None:
    """The error that says a machine's limit was met while ``folder`` was written; None if ``error`` is of another kind.

    InputError for a full disk or a size limit, ProcessLost for too little memory. Errors that are worded for the user
    already give None.
    """
    if isinstance(error, (InputError, SettingsError, EngineMissing, ProcessLost)):
        return None
    for each in _chain(error):
        number = each.errno if isinstance(each, OSError) else None
        if isinstance(each, MemoryError) or number in _STARVED:
            return no_memory(each)
        if number in _FULL:
            return no_room(folder, each)
        if number is not None:  # a permission, a name, ...: the disk has no part in it
            return None
    return explained_text("\n".join(map(str, _chain(error))), folder)


def explained_text(text: str, folder: Path | None = None) -> TiegraphError | None:
    """As ``explained``, for what a library printed before it ended its process."""
    if _FULL_WORDS.search(text) or (folder is not None and _WRITE_WORDS.search(text) and _tight(folder)):
        return no_room(folder, text)
    if _MEMORY_WORDS.search(text):
        return no_memory(text)
    return no_room(folder, text) if folder is not None and _full(folder) else None


def no_room(folder: Path | None, why: object = "") -> InputError:
    """A disk that is full, or a limit on the size of files: which folder, how much is free, what to do."""
    limit, free = size_limit(), "" if folder is None else f" in {folder} ({_free(folder) / 2**20:.0f} MiB free)"
    if limit is not None and (folder is None or _free(folder) > _NO_ROOM_BYTES):
        what = f"a file{free} may not grow beyond {limit / 2**20:.3g} MiB (ulimit -f): raise that limit"
    else:
        what = f"No space left on device: no room{free}: free some space or choose another output folder"
    return InputError(f"{what}, then run again: what is finished is kept{_because(why)}")


def need_room(path: Path, size: int) -> None:
    """Raise InputError unless a file of ``size`` bytes can be written at ``path``, in a folder that is there.

    For libraries that end the process when they cannot write. The room is not held: another program may take it.
    """
    limit = size_limit()
    if limit is not None and limit < size:
        raise no_room(path.parent, f"{path} needs about {size / 2**20:.1f} MiB")
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
    except OSError as error:
        raise explained(error, path.parent) or error from error


def no_memory(why: object = "") -> ProcessLost:
    """Too little memory, or too few threads or processes allowed."""
    bound = _limit("RLIMIT_AS")
    said = "" if bound is None else f"; the process may have {bound / 2**20:.0f} MiB at most (ulimit -v): raise it"
    return ProcessLost(
        f"not enough memory{said}; close other programs, or run again with --pool serial or fewer workers (--pool "
        f"local:1), or with smaller images: what is finished is kept{_because(why)}"
    )


def size_limit() -> int | None:
    """The largest size of a file that this process may write in bytes, None = any."""
    return _limit("RLIMIT_FSIZE")


def _because(why: object) -> str:
    """The line of a library's words that says it, without those of a process that was aborted; "" if there are none."""
    lines = [line for raw in str(why).splitlines() if (line := " ".join(raw.split()).removeprefix("what(): "))]
    words = (_FULL_WORDS, _WRITE_WORDS, _MEMORY_WORDS)
    text = ([k for k in lines if any(w.search(k) for w in words)] or lines or [""])[-1]
    if isinstance(why, BaseException):
        text = f"{type(why).__name__}: {text}"
    return f" ({text if len(text) <= _SHOWN else '... ' + text[-_SHOWN:]})" if text else ""  # the end says it


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def _limit(name: str) -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    value = resource.getrlimit(getattr(resource, name))[0]
    return None if value == resource.RLIM_INFINITY else value


def _free(folder: Path) -> int:
    there = next((p for p in (folder, *folder.absolute().parents) if p.exists()), Path("/"))
    return shutil.disk_usage(there).free


def _full(folder: Path) -> bool:
    """Whether nothing can be written now: no bytes, or no names left."""
    try:
        names = os.statvfs(folder) if hasattr(os, "statvfs") else None
        if shutil.disk_usage(folder).total == 0:  # of the kernel's own file systems
            return False
        return _free(folder) < _NO_ROOM_BYTES or (names is not None and names.f_files > 0 and names.f_favail == 0)
    except OSError:
        return False


def _tight(folder: Path) -> bool:
    """Whether room may have been short: what filled the disk can be gone again."""
    try:
        size, limit = sum(p.stat().st_size for p in folder.glob("*") if p.is_file()), size_limit()
        low = limit is not None and limit < max(1 << 28, 4 * size)
        return low or _full(folder) or _free(folder) < 2 * size
    except OSError:
        return True
