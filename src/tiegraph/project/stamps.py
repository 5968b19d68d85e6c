"""By what a change of an input is noticed.

A file counts by its size and time until a run has read it, then by its content: a copy of it, wherever it lies, or the
same disk mounted anew, has other times and is the same. A file or folder that is gone counts as it was when a run read
it: what is finished can be reported without the images.
"""

import json
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from tiegraph.project.ledger import digests
from tiegraph.project.stages import write_atomic

PLACE = "receipts/inputs.json"
_Entry = list[Any]  # size, time (ns) when it was first read, time now, digest


class Stamps:
    """Sizes and times of the inputs of a run, as its folder knows them."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / PLACE
        self._files, self._given = _read(self._path)
        self._seen: dict[str, _Entry] = {}
        self._asked: dict[str, Any] = {}

    @property
    def gone(self) -> bool:
        """Whether something of what was asked for is gone, and all that is not there was there once."""
        lacking = [name for name in self._asked if not _there(name)]
        return all(n in self._given for n in lacking) and any(self._given[n] is not None for n in lacking)

    def __call__(self, path: Path) -> Any:
        """Names, sizes and times of a file, or of all files below a folder; None if it was never there."""
        return self.of(path, lambda: self.now(path))

    def of(self, given: Path | str, stamp: Callable[[], Any]) -> Any:
        """What ``stamp`` makes of something that is given; if that is gone, what it made of it when it was there."""
        found = stamp() if _there(given) else self._given.get(str(given))
        self._asked[str(given)] = found
        return found

    def now(self, path: Path) -> Any:
        """The same of what is there now; None for nothing."""
        if path.is_dir():
            files = sorted(p for p in path.rglob("*") if p.is_file())
            return [[p.relative_to(path).as_posix(), *self._file(p)] for p in files]
        return self._file(path) if path.exists() else None

    def record(self) -> None:
        """Read what was stamped and has not been read as it is, and keep what that says."""
        new = [name for name, entry in self._seen.items() if not entry[3] and _is(Path(name), entry)]
        for name, found in zip(new, digests([Path(n) for n in new])):
            if _is(Path(name), self._seen[name]):  # as it was when it was stamped
                self._seen[name][3] = found
        before = {n: e for n, e in self._files.items() if n not in self._seen}  # what is gone may come back
        kept = before | {n: e for n, e in self._seen.items() if e[3]}
        if (kept, self._asked) != (self._files, self._given):
            write_atomic(self._path, json.dumps({"files": kept, "given": self._asked}))
            self._files, self._given = {n: list(e) for n, e in kept.items()}, dict(self._asked)

    def _file(self, path: Path) -> list[int]:
        info = path.stat()
        known: _Entry | None = self._seen.get(str(path)) or self._files.get(str(path))
        size, now = info.st_size, info.st_mtime_ns
        entry: _Entry = [size, now, now, ""]
        if known is not None and known[0] == size and now in known[1:3]:
            entry = known
        else:
            alike = [known] if known is not None else self._elsewhere.get((path.name, size), [])
            found = digests([path])[0] if any(e[0] == size and e[3] for e in alike) else ""
            same = next((e for e in alike if found and e[3] == found), None)
            entry = entry if same is None else [size, same[1], now, found]
        self._seen[str(path)] = entry
        return entry[:2]

    @cached_property
    def _elsewhere(self) -> dict[tuple[str, int], list[_Entry]]:
        """What earlier runs have read, by name and size: a survey that was moved or copied is the same."""
        out: dict[tuple[str, int], list[_Entry]] = {}
        for name, entry in self._files.items():
            out.setdefault((Path(name).name, entry[0]), []).append(entry)
        return out


def _there(given: Path | str) -> bool:
    try:
        return Path(given).exists()
    except (OSError, ValueError):  # words that are no path
        return False


def _is(path: Path, entry: _Entry) -> bool:
    try:
        info = path.stat()
    except OSError:
        return False
    return [info.st_size, info.st_mtime_ns] == [entry[0], entry[2]]


def _read(path: Path) -> tuple[dict[str, _Entry], dict[str, Any]]:
    """Nothing where there is none, or none that can be read: then times count again."""
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        return dict(told["files"]), dict(told["given"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}, {}
