"""Files that appear whole or not at all, and the note that a run folder takes of each before it appears.

A run folder is a folder with the mark ``receipts/folder.json``. Before anything is written into one, its name goes to
``receipts/made.txt``: so it is known, after a kill at any moment, which files are ours and may be removed.
"""

import json
import os
import re
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tiegraph.errors import InputError
from tiegraph.limits import explained

MARK = "receipts/folder.json"
JOURNAL = "receipts/made.txt"
_TEMPORARY = re.compile(r"^\.[0-9a-f]{8}\.\d+\.part")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well, and is removed otherwise.

    The content is on the disk before it has its name. Raises InputError when the disk is full (the libraries below
    report that in many ways).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{zlib.crc32(os.fsencode(path.name)):08x}.{os.getpid()}.part{path.suffix}")
    try:
        claim(path)
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
        temporary.unlink(missing_ok=True)


def must_be_new(out: Path, path: Path | None = None) -> None:
    """Raise InputError if what ``-o`` asks for, or a ``path`` that goes with it, is there already."""
    path = path or out
    if os.path.lexists(path):
        which = f"-o {out}" if path == out else f"-o {out}: {path}"
        raise InputError(f"{which} is there already: give another name, or remove it")


def is_temporary(name: str) -> bool:
    """Whether a file's name is one of ``replacing``'s, left behind by a kill."""
    return _TEMPORARY.match(name) is not None


def sync(path: Path) -> None:
    """Wait until a file (or the list of a folder's names) is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def claim(path: Path) -> None:
    """Note in the journal of the run folder around ``path``, if there is one, that the file, or all that is going to be
    below the folder ``path``, is ours. ``replacing`` does so by itself; what libraries write needs it said."""
    path = path.absolute()
    for folder in path.parents:
        if (folder / MARK).exists():
            with open(folder / JOURNAL, "a", encoding="ascii") as journal:
                journal.write(json.dumps(path.relative_to(folder).as_posix()) + "\n")
            return


def same_file(path: Path, other: Path) -> None:
    """Give a file a second name (a hard link, or a copy where the file system has none)."""
    with replacing(other) as temporary:
        try:
            os.link(path, temporary)
        except OSError:
            shutil.copyfile(path, temporary)
