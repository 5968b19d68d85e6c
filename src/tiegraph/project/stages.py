"""A stage turns artefacts into artefacts. Knows no photogrammetry.

A stage's key is a hash over its name, its code version, its settings (files they name included) and the keys of the
stages it needs: its sources, before anything is made. The parts of the key are in the receipt one by one, so that
``status`` can name what changed.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.scene.atomic import replacing

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
    for engine in engines(stage, settings):
        parts[f"tuning.{engine}"] = settings_key(getattr(settings.tuning, engine), stamp)
    return {"version of tiegraph": digest(stage.version), **{name: digest(part) for name, part in parts.items()}}


def stage_keys(
    stages: Sequence[Stage], settings: Any, sources: Mapping[str, Any], stamp: Callable[[Path], Any]
) -> dict[str, str]:
    """The key of every stage, over its parts and the keys of what it needs.

    The place of the sources (``PLACE``) counts only for the stages that need no other: these are made again for it, and
    their results are the same.
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
