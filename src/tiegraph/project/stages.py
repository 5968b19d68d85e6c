"""A stage turns artefacts into artefacts, and leaves a receipt when it is done (or began). Knows no photogrammetry.

``tiegraph.project`` says what the key of a stage is; its parts are in the receipt one by one, so that ``status`` can
name what changed. In the list of the files that a stage made a file counts by its size and content; its time only saves
reading it again. A link counts by its target.
"""

import hashlib
import json
import os
import platform
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
from typing import Any

from tiegraph.__version__ import __version__
from tiegraph.errors import InputError
from tiegraph.plugins import packages
from tiegraph.scene.atomic import JOURNAL, replacing, sync

PLACE = "the place of the images"  # among the sources of a run


@dataclass(frozen=True)
class Outcome:
    """The result of a stage in words and numbers; everything a report may show."""

    counts: Mapping[str, float] = field(default_factory=dict)
    dropped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    tables: dict[str, dict] = field(default_factory=dict)  # name -> {"columns": [...], "rows": [[...]]}
    contradictions: tuple[str, ...] = ()  # sentences: what contradicts what, by how much, the likeliest culprit


@dataclass(frozen=True)
class Stage:
    """One line of the pipeline table."""

    name: str  # = CLI verb = settings section = receipt
    run: Callable[[Any], Outcome]
    needs: tuple[str, ...]
    makes: tuple[str, ...]  # artefacts below the run folder
    item: str = ""  # unit of its finished parts, "" = all or nothing
    changes: tuple[str, ...] = ()  # artefacts of other stages that it adds to
    clear: Callable[[Path], None] | None = None  # removes from those what it added
    uses: tuple[str, ...] = ()  # settings sections of other stages that it follows
    tuned: tuple[str, ...] = ()  # engines whose constants it follows (settings.tuning), beside that of its own name
    scratch: tuple[str, ...] = ()  # temporary files below the run folder until it is done
    spares: tuple[str, ...] = ()  # needed stages that it can do without, if the images gave no result for them
    alone: bool = False  # reads nothing but the run folder, whatever exists
    passing: bool = False  # its files serve later stages only and may be removed once they are done
    version: int = 1  # raise it when the stage's results change for the same settings


def needed(stages: Sequence[Stage], until: str | None) -> list[Stage]:
    """The stages a target needs, in order; all of them without a target."""
    if until is None:
        return list(stages)
    table = {s.name: s for s in stages}
    if until not in table:
        raise InputError(f"unknown stage {until!r}: the stages are {', '.join(table)}")
    want, todo = set(), [until]
    while todo:
        name = todo.pop()
        if name not in want:
            want.add(name)
            todo.extend(table[name].needs)
    return [s for s in stages if s.name in want]


def engines(stage: Stage, settings: Any) -> tuple[str, ...]:
    """The engines whose constants a stage follows; () for settings without any."""
    known = type(getattr(settings, "tuning", None))
    own = (stage.name,) if stage.name in getattr(known, "model_fields", ()) else ()
    return (*own, *(engine for engine in stage.tuned if engine not in own))


def digest(data: Any) -> str:
    """16 hex digits over JSON-like data."""
    text = json.dumps(data, sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def settings_key(section: Any, stamp: Callable[[Path], Any]) -> Any:
    """A settings section as data; the files and folders it names count by their stamps, wherever they lie."""
    files = {n: v for n in type(section).model_fields if isinstance(v := getattr(section, n), Path)}
    return section.model_dump(mode="json") | {n: [v.suffix, stamp(v)] for n, v in files.items()}


def key_parts(stage: Stage, settings: Any, sources: Mapping[str, Any], stamp: Callable[[Path], Any]) -> dict[str, str]:
    """The parts of a stage's key besides the keys of the stages it needs: name -> digest. ``sources``: the stamp of
    each input of the run, by the user's name for it; it counts for the stages that need no other."""
    parts: dict[str, Any] = {} if stage.needs else dict(sources)
    for name in (stage.name, *stage.uses):
        key = settings_key(getattr(settings, name), stamp)
        parts.update({f"{name}.{n}": value for n, value in key.items()})
        parts.update({f"the plug-in of {name}.{n}": p for n, p in packages(getattr(settings, name)).items()})
    for engine in engines(stage, settings):
        parts[f"tuning.{engine}"] = settings_key(getattr(settings.tuning, engine), stamp)
    return {"version of tiegraph": digest(stage.version), **{name: digest(part) for name, part in parts.items()}}


def stage_keys(
    stages: Sequence[Stage], settings: Any, sources: Mapping[str, Any], stamp: Callable[[Path], Any]
) -> dict[str, str]:
    """The key of every stage, over its parts and the keys of what it needs.

    The place of the sources (``PLACE``) counts only for stages that need no other, whose results it does not change.
    """
    keys: dict[str, str] = {}
    for stage in stages:
        parts = key_parts(stage, settings, {n: v for n, v in sources.items() if n != PLACE}, stamp)
        keys[stage.name] = digest([stage.name, parts, [keys[n] for n in stage.needs]])
    return keys | {s.name: digest([keys[s.name], sources.get(PLACE)]) for s in stages if not s.needs}


def write_atomic(path: Path, data: bytes | str) -> None:
    """Write a whole file or none of it. Raises InputError for a full disk or a folder that cannot be made."""
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(data.encode() if isinstance(data, str) else data)
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror or error}; choose another output folder, then run again: "
            "finished work is kept"
        ) from error


def save_json(path: Path, data: Any) -> None:
    """Write JSON atomically."""
    write_atomic(path, json.dumps(data, indent=1, default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v)))


def read_object(path: Path) -> dict | None:
    """The JSON object in a file; None if there is none, or none that can be read."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


Ledger = dict[str, list]
"""Name below the run folder -> [size, time in ns, digest], ["link", target], or [] if not read yet."""

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
        ledger = dict(zip(names, threads.map(_entry, (folder / name for name in names))))
    for parent in {(folder / name).parent for name in names}:
        sync(parent)
    return ledger


def digests(paths: Sequence[Path]) -> list[str]:
    """Digest of each file's content; "" if it cannot be read."""
    with ThreadPoolExecutor(_THREADS) as threads:
        return list(threads.map(_digest_if_readable, paths))


def _digest_if_readable(path: Path) -> str:
    with suppress(OSError):
        return _digest(path)
    return ""


def _entry(path: Path) -> list:
    info = path.lstat()
    if stat.S_ISLNK(info.st_mode):
        return ["link", os.readlink(path)]
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
    """16 hex digits over names and contents of the files at or below ``tops``, not over times and targets of links."""
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
        with suppress(OSError):  # not empty, or gone
            (folder / parent).rmdir()


def put_aside(folder: Path, names: Sequence[str]) -> str:
    """Move files or folders to ``set_aside/<time>/``; the new place, "" if there are none."""
    if not names:
        return ""
    place = f"set_aside/{datetime.now(timezone.utc):%Y%m%dT%H%M%S%f}"
    for name in names:
        target = folder / place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        os.replace(folder / name, target)
    return place


def read_journal(folder: Path) -> list[str]:
    """Names that were claimed since the journal was begun; a line cut off by a power failure is ignored."""
    names = []
    with suppress(OSError):
        for line in (folder / JOURNAL).read_text(encoding="ascii", errors="replace").splitlines():
            with suppress(ValueError):
                names.append(json.loads(line))
    return [name for name in names if isinstance(name, str)]


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


_PACKAGES = "pycolmap pycolmap-cuda12 numpy opencv-python-headless scipy laspy pyproj rasterio onnxruntime".split()


def software() -> dict[str, str]:
    """Versions of tiegraph, Python and the installed packages that a result depends on."""
    found = {package: known for package in _PACKAGES if (known := _version(package))}
    return {"tiegraph": __version__, "python": platform.python_version(), **found}


@cache  # every receipt has it, and reading a package's description takes milliseconds
def _version(package: str) -> str:
    with suppress(PackageNotFoundError):
        return version(package)
    return ""
