"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tiegraph.errors import InputError
from tiegraph.limits import explained


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well, and is removed otherwise.

    Raises InputError when the disk is full (the libraries below report that in many ways).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except Exception as error:
        told = explained(error, path.parent)
        if isinstance(told, InputError):
            raise InputError(f"cannot write {path}: {told}") from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def same_file(path: Path, other: Path) -> None:
    """Give a file a second name (a hard link, or a copy where the file system has none)."""
    with replacing(other) as temporary:
        try:
            os.link(path, temporary)
        except OSError:
            shutil.copyfile(path, temporary)
