"""A stage turns artefacts into artefacts; its receipt says what it was made from, so that a run resumes.

Knows no photogrammetry. The receipt's key is a hash over the stage, its code version, its settings (files they name
included) and the keys of what it needs. Same key and artefacts there: up to date. Interrupted with the same key:
finished items stay. Another key: its artefacts are removed first.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.scene.atomic import replacing


@dataclass(frozen=True)
class Outcome:
    """What a stage says of itself; everything a report may want to show."""

    counts: Mapping[str, float] = field(default_factory=dict)
    dropped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    tables: dict[str, dict] = field(default_factory=dict)  # name -> {"columns": [...], "rows": [[...]]}


@dataclass(frozen=True)
class Stage:
    """One line of the pipeline table."""

    name: str  # = CLI verb = settings section = receipt
    run: Callable[[Any], Outcome]
    needs: tuple[str, ...]
    makes: tuple[str, ...]  # artefacts below the run folder
    item: str = ""  # what finished pieces are counted in, "" = all or nothing
    clear: Callable[[Path], None] | None = None  # removes its part of an artefact it shares with other stages
    version: int = 1  # raise it when the stage's results change for the same settings


def digest(data: Any) -> str:
    """16 hex digits over JSON-like data."""
    text = json.dumps(data, sort_keys=True, default=str)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def stamp(path: Path) -> Any:
    """Names, sizes and modification times of a file or of all files below a folder; None if it is not there."""
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        return [[p.relative_to(path).as_posix(), *stamp(p)] for p in files]
    if not path.exists():
        return None
    info = path.stat()
    return [info.st_size, info.st_mtime_ns]


def settings_key(section: Any) -> Any:
    """A settings section as data; the files and folders it names count with their stamps."""
    values = section.model_dump(mode="json")
    files = {n: stamp(v) for n in type(section).model_fields if isinstance(v := getattr(section, n), Path)}
    return {"values": values, "files": files}


def write_atomic(path: Path, data: bytes | str) -> None:
    """Write a whole file or none of it. Raises InputError for a full disk or a folder that cannot be made."""
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(data.encode() if isinstance(data, str) else data)
    except OSError as error:
        raise InputError(
            f"cannot write {path}: {error.strerror or error}; choose another output folder, then run again: "
            "what is finished is kept"
        ) from error


def remove(path: Path) -> None:
    """Remove a file or folder, whether it is there or not."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


class Receipts:
    """The receipts of a run folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, stage: str) -> Path:
        """Where a stage's receipt is."""
        return self.folder / "receipts" / f"{stage}.json"

    def read(self, stage: str) -> dict:
        """A stage's receipt, {} if there is none or it is damaged."""
        try:
            return json.loads(self.path(stage).read_text())
        except (OSError, ValueError):
            return {}

    def begin(self, stage: Stage, key: str) -> None:
        """Keep what an interrupted run with the same key has finished, remove what was made from something else."""
        old = self.read(stage.name)
        if old.get("key", old.get("began")) != key:
            if stage.clear is not None:
                stage.clear(self.folder)
            for made in stage.makes:
                remove(self.folder / made)
        write_atomic(self.path(stage.name), json.dumps({"stage": stage.name, "began": key}))

    def finish(self, stage: Stage, key: str, outcome: Outcome, more: dict) -> dict:
        """Write the full receipt."""
        receipt = {"stage": stage.name, "key": key, "version": stage.version, **more, **dataclasses.asdict(outcome)}
        write_atomic(self.path(stage.name), json.dumps(receipt, indent=1, default=_plain))
        return receipt

    def current(self, stage: Stage, key: str) -> bool:
        """Whether a stage is up to date."""
        return self.read(stage.name).get("key") == key and all((self.folder / m).exists() for m in stage.makes)

    def why(self, stage: Stage, key: str) -> str:
        """Why a stage is not up to date, in words; "" if it is."""
        receipt = self.read(stage.name)
        if not receipt:
            return "not run yet"
        if receipt.get("key", receipt.get("began")) != key:
            return "its inputs or settings changed"
        if "key" not in receipt:
            return "was interrupted"
        missing = [m for m in stage.makes if not (self.folder / m).exists()]
        return f"{missing[0]} is missing" if missing else ""


def stage_keys(stages: Iterable[Stage], settings: Any, source_key: str) -> dict[str, str]:
    """The key of every stage."""
    keys = {"source": source_key}
    for stage in stages:
        section = settings_key(getattr(settings, stage.name))
        keys[stage.name] = digest([stage.name, stage.version, section, [keys[n] for n in ("source", *stage.needs)]])
    return keys


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"not JSON: {type(value)}")
