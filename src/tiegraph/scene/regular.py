"""What may be opened: files. A named pipe waits for ever for its writer, and ``/dev/zero`` never ends."""

import errno
import os
import stat
from pathlib import Path

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
MOST_BYTES = 1 << 32  # of a file that is read whole: image formats end there (TIFF), tables are far smaller


def real_path(path: Path | str) -> Path:
    """The absolute path without links. Of links that lead in a ring, what there is: opening it says what is wrong."""
    return Path(os.path.realpath(path))


def names_file(text: str) -> bool:
    """Whether an option that takes words or a file names a file; words may be longer than a name."""
    try:
        return Path(text).is_file()
    except (OSError, ValueError):
        return False


def regular(path: Path, most_bytes: int | None = MOST_BYTES) -> Path:
    """The path, if it is a file or leads to one: every file of the user passes here before it is opened.

    Raises OSError whose ``strerror`` says what it is instead, or that it is larger than ``most_bytes`` (None: any
    size), as well as what the system says of a path that leads nowhere.
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
