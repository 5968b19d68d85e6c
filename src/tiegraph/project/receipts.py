"""The receipt of each stage when it is done (or began), the versions that its result depends on, and the files that
it made: only these may be removed, and changed ones are recognised.

A file counts by its size and content; its time only saves reading it again. A link counts by its target.
"""

import hashlib
import json
import os
import platform
import stat
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
from typing import Any

from tiegraph.__version__ import __version__
from tiegraph.project.stages import read_object, save_json, write_atomic
from tiegraph.scene.atomic import JOURNAL, sync

Ledger = dict[str, list]
"""Name below the run folder -> [size, time in ns, digest], ["link", target], or [] if not read yet."""

SET_ASIDE = "set_aside"
_THREADS = 4  # reading and hashing release the interpreter's lock


def files_below(folder: Path, tops: Iterable[str], apart: Sequence[str] = ()) -> list[str]:
    """Names of the files and links that are, or are below, ``tops``, sorted; without those at or below ``apart``."""
    return sorted(n for top in tops for n in _walk(folder, top) if not covered(n, apart))


def covered(name: str, tops: Iterable[str]) -> bool:
    """Whether a name is one of ``tops`` or below one."""
    return any(name == top or name.startswith(f"{top}/") for top in tops)


def _walk(folder: Path, name: str) -> Iterator[str]:
    path = folder / name
    try:
        info = path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return
    if not stat.S_ISDIR(info.st_mode):
        yield name
        return
    for inside in os.listdir(path):
        yield from _walk(folder, f"{name}/{inside}")


def recorded(folder: Path, names: Sequence[str]) -> Ledger:
    """The records of files, once they are on the disk."""
    with ThreadPoolExecutor(_THREADS) as threads:
        entries = threads.map(lambda name: _entry(folder / name, safe=True), names)
        ledger = dict(zip(names, entries))
    for parent in {(folder / name).parent for name in names}:
        sync(parent)
    return ledger


def digests(paths: Sequence[Path]) -> list[str]:
    """Digest of each file's content; "" if it cannot be read."""
    with ThreadPoolExecutor(_THREADS) as threads:
        return list(threads.map(_digest_if_readable, paths))


def _digest_if_readable(path: Path) -> str:
    try:
        return _digest(path)
    except OSError:
        return ""


def _entry(path: Path, safe: bool = False) -> list:
    info = path.lstat()
    if stat.S_ISLNK(info.st_mode):
        return ["link", os.readlink(path)]
    if safe:
        sync(path)
    return [info.st_size, info.st_mtime_ns, _digest(path)]


def _digest(path: Path) -> str:
    found = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as file:
        while chunk := file.read(1 << 20):
            found.update(chunk)
    return found.hexdigest()


def trouble(path: Path, entry: list, thorough: bool = False) -> str:
    """ "missing", "changed since" or "" for a file as recorded; ``thorough`` also reads apparently unchanged files."""
    try:
        info = path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return "is missing"
    if not entry:
        same = not stat.S_ISDIR(info.st_mode)
    elif entry[0] == "link":
        same = stat.S_ISLNK(info.st_mode) and os.readlink(path) == entry[1]
    elif not stat.S_ISREG(info.st_mode) or info.st_size != entry[0]:
        same = False
    else:
        same = (info.st_mtime_ns == entry[1] and not thorough) or _digest_if_readable(path) == entry[2]
    return "" if same else "was changed since it was made"


def digest_of(ledger: Ledger, tops: Iterable[str]) -> str:
    """16 hex digits over names and contents of the files at or below ``tops``, not over times and places: the target of
    a link counts in the key of its stage."""
    tops = tuple(tops)
    rows = [[n, *(e[:1] if e[:1] == ["link"] else e[-1:])] for n, e in sorted(ledger.items()) if covered(n, tops)]
    return hashlib.blake2b(json.dumps(rows).encode(), digest_size=8).hexdigest()


def take_away(folder: Path, names: Iterable[str]) -> None:
    """Remove files, and the folders below the run folder that are then empty."""
    parents: set[PurePosixPath] = set()
    for name in names:
        (folder / name).unlink(missing_ok=True)
        parents |= set(PurePosixPath(name).parents)
    for parent in sorted(parents - {PurePosixPath(".")}, key=lambda p: -len(p.parts)):
        try:
            (folder / parent).rmdir()
        except OSError:  # not empty, or gone
            pass


def put_aside(folder: Path, names: Sequence[str]) -> str:
    """Move files or folders to ``set_aside/<time>/``; the new place, "" if there are none."""
    if not names:
        return ""
    place = f"{SET_ASIDE}/{datetime.now(timezone.utc):%Y%m%dT%H%M%S%f}"
    for name in names:
        target = folder / place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(folder / name, target)
    return place


def read_journal(folder: Path) -> list[str]:
    """Names that were claimed since the journal was begun; a line cut off by a power failure is ignored."""
    try:
        lines = (folder / JOURNAL).read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return []
    return [name for line in lines if isinstance(name := _parsed(line), str)]


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None


class Receipts:
    """The receipts of a run folder: ``receipts/<stage>.json``, the lists ``receipts/files/<stage>.json``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, stage: str) -> Path:
        """Where a stage's receipt is."""
        return self.folder / "receipts" / f"{stage}.json"

    def list_path(self, stage: str) -> Path:
        """Where the list of a stage's files is."""
        return self.folder / "receipts" / "files" / f"{stage}.json"

    def read(self, stage: str) -> dict:
        """A stage's receipt, {} if there is none or it is damaged."""
        return read_object(self.path(stage)) or {}

    def damaged(self, stage: str) -> bool:
        """Whether there is a receipt that cannot be read."""
        return self.path(stage).exists() and not self.read(stage)

    def write(self, stage: str, receipt: dict) -> None:
        """Write a stage's receipt."""
        save_json(self.path(stage), receipt)

    def files(self, stage: str) -> Ledger | None:
        """The files a stage made, {} if it never ran, None if the list is damaged."""
        if not self.list_path(stage).exists():
            return {} if not self.path(stage).exists() else None
        found = read_object(self.list_path(stage))
        return found if found is not None and all(isinstance(v, list) for v in found.values()) else None

    def write_files(self, stage: str, files: Ledger) -> None:
        """Write the list of a stage's files."""
        write_atomic(self.list_path(stage), json.dumps(files, separators=(",", ":")))


_PACKAGES = ("pycolmap", "pycolmap-cuda12", "numpy", "opencv-python-headless", "scipy", "laspy", "pyproj", "rasterio")


def software() -> dict[str, str]:
    """Versions of tiegraph, Python and the installed packages that a result depends on."""
    found = {package: known for package in _PACKAGES if (known := _version(package))}
    return {"tiegraph": __version__, "python": platform.python_version(), **found}


@cache  # every receipt has it, and reading a package's description takes milliseconds
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
