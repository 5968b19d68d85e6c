"""The inputs of a run, and how a change of them is detected.

A file counts by its size and time until a run has read it, then by its content: a copy of it, wherever it lies, or the
same disk mounted again, has other times but is the same. A missing file or folder counts as it was when a run read
it: finished work can be reported without the images.
"""

import json
import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError
from tiegraph.project.folder import names_run
from tiegraph.project.settings import Settings, sections, shortened
from tiegraph.project.stages import PLACE as SOURCE_PLACE
from tiegraph.project.stages import digests, write_atomic
from tiegraph.scene.atomic import names_file, regular
from tiegraph.scene.bags import is_bag, source_of, split_topics
from tiegraph.scene.images import find_videos, searched
from tiegraph.scene.namedposes import find_start

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
        """Whether an input is missing, and all missing ones existed once."""
        lacking = [name for name in self._asked if not _there(name)]
        return all(n in self._given for n in lacking) and any(self._given[n] is not None for n in lacking)

    def __call__(self, path: Path) -> Any:
        """Names, sizes and times of a file, or of all files below a folder; None if it was never there."""
        return self.of(path, lambda: self.now(path))

    def of(self, given: Path | str, stamp: Callable[[], Any]) -> Any:
        """The ``stamp`` of an input; if it is missing, that of when it existed."""
        found = stamp() if _there(given) else self._given.get(str(given))
        self._asked[str(given)] = found
        return found

    def now(self, path: Path) -> Any:
        """The same of the present state; None for nothing."""
        if path.is_dir():
            files = sorted(p for p in path.rglob("*") if p.is_file())
            return [[p.relative_to(path).as_posix(), *self._file(p)] for p in files]
        return self._file(path) if path.exists() else None

    def record(self) -> None:
        """Read stamped files that were not yet read in this state, and keep their digests."""
        new = [name for name, entry in self._seen.items() if not entry[3] and _is(Path(name), entry)]
        for name, found in zip(new, digests([Path(n) for n in new])):
            if _is(Path(name), self._seen[name]):  # as it was when it was stamped
                self._seen[name][3] = found
        before = {n: e for n, e in self._files.items() if n not in self._seen}  # missing files may come back
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
        """Files read by earlier runs, by name and size: a survey that was moved or copied is the same."""
        out: dict[tuple[str, int], list[_Entry]] = {}
        for name, entry in self._files.items():
            out.setdefault((Path(name).name, entry[0]), []).append(entry)
        return out


def _there(given: Path | str) -> bool:
    with suppress(OSError, ValueError):  # words that are no path
        return Path(given).exists()
    return False


def _is(path: Path, entry: _Entry) -> bool:
    with suppress(OSError):
        info = path.stat()
        return [info.st_size, info.st_mtime_ns] == [entry[0], entry[2]]
    return False


def _read(path: Path) -> tuple[dict[str, _Entry], dict[str, Any]]:
    """Nothing if there is none, or none that can be read: then times count again."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        told = json.loads(path.read_text(encoding="utf-8"))
        return dict(told["files"]), dict(told["given"])
    return {}, {}


FOLLOW = Path("auto")
"""A trajectory by odometry from the survey's own images."""

_IMAGES = "the image folder"  # its name in messages; the other inputs are options


@dataclass(frozen=True)
class Inputs:
    """The inputs of a run."""

    images: Path
    rig: str | None = None
    gnss: Path | None = None
    trajectory: Path | None = None  # FOLLOW: by odometry
    times: Path | None = None
    camera: str | None = None  # a calibration in words, or its file
    start: Path | None = None  # a start model

    @property
    def poses(self) -> Path | None:
        """The trajectory's file or folder, if it is not to be made from the images."""
        return None if self.trajectory == FOLLOW else self.trajectory

    def parts(self, stamps: Stamps) -> dict[str, Any]:
        """The stamp of each input, by the user's name for it: for files the names below the given path, sizes and
        times; None for inputs not given."""
        (images, topics), rig, camera, start = split_topics(self.images), self.rig or "", self.camera or "", self.start
        files: dict[str, Any] = {n: None for n in self._files()}
        for name, path in self._files().items():
            if path is not None:
                source, of_bag = split_topics(path)
                files[name] = [list(of_bag), stamps(source)] if of_bag else stamps(source)

        def words() -> Any:
            return stamps.now(Path(camera)) if names_file(camera) else None

        if start is not None:
            files["--start"] = stamps.of(start, lambda: files["--start"])
        return {
            _IMAGES: [list(topics), stamps.of(images, lambda: stamps.now(searched(images)))],
            "--rig": (stamps.of(rig, lambda: _rig_stamp(Path(rig), stamps)) or rig) if rig else None,
            "--camera": (stamps.of(camera, words) or camera) if camera else None,
            **files,
            **({"--trajectory": str(FOLLOW)} if self.trajectory == FOLLOW else {}),
            SOURCE_PLACE: str(source_of(self.images).absolute()),  # links of the run folder point there
        }

    def given(self) -> dict[str, Path]:
        """The user's name of each input -> where it is."""
        rig = Path(self.rig) if self.rig and Path(self.rig).exists() else None
        camera = Path(self.camera) if self.camera and names_file(self.camera) else None
        files = {"--rig": rig, "--camera": camera, **self._files()}
        images = searched(source_of(self.images))
        return {_IMAGES: images, **{n: source_of(p) for n, p in files.items() if p is not None}}

    def check(self) -> None:
        """Raise InputError for an input that is not there."""
        images = source_of(self.images)
        if not images.exists():
            raise InputError(f"{images}: no such folder; give the folder with the survey's images")
        if not images.is_dir() and not is_bag(images) and not find_videos(images):
            raise InputError(f"{images} is a file, and no video or bag; give the folder with the survey's images")
        if self.start is not None and self.trajectory is not None:
            raise InputError(
                f"--start {self.start} and --trajectory {self.trajectory}: both give poses: omit one (if it is "
                "stored, by --unset start or --unset trajectory)"
            )

    def _files(self) -> dict[str, Path | None]:
        files = {"--gnss": self.gnss, "--trajectory": self.poses, "--times": self.times, "--start": self.start}
        with suppress(InputError, OSError):  # of a project folder only the model is read; reading reports a missing one
            files["--start"] = None if self.start is None else find_start(self.start)[1]
        return files


def _rig_stamp(rig: Path, stamps: Stamps) -> Any:
    """Stamps of a rig file and the files it names, or of the receipts of another run that its rig comes from."""
    if names_run(str(rig)):
        return [stamps.now(rig / "receipts" / f"{stage}.json") for stage in ("sparse", "georef")]
    try:
        named = re.findall(r"\bfile\s*=\s*[\"']([^\"']+)", regular(rig).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        named = []
    return [stamps.now(rig), *(stamps.now(rig.parent / n) for n in named)] if named else stamps.now(rig)


_SHORT = {"--georef.gcp": "--gcp", "--georef.marks": "--marks"}  # their short names on the command line


def check_files(settings: Settings) -> None:
    """Raise InputError for the first setting whose file or folder is missing, of another kind or not readable."""
    for section, fields in sections():
        for name, field in fields.items():
            kind = field.json_schema_extra.get("kind") if isinstance(field.json_schema_extra, dict) else None
            path = getattr(getattr(settings, section), name) if kind else None
            option = f"--{section}.{name}".replace("_", "-")
            if path is not None:
                check_path(_SHORT.get(option, option), path, str(kind))


def check_path(option: str, path: Path, kind: str) -> None:
    """Raise InputError, naming option and path, unless it is a readable ``kind``: file, folder, file or folder."""
    try:
        there, folder, file = path.exists(), path.is_dir(), path.is_file()
    except (OSError, ValueError) as error:  # a name too long, a zero byte
        raise InputError(f"{option} {shortened(str(path))}: not a path ({error})") from None
    if not there:
        raise InputError(f"{option} {path}: no such {kind}; correct the path, or omit the option")
    if not (folder and "folder" in kind) and not (file and "file" in kind):
        what = "a folder" if folder else "a file" if file else "no file now"
        try:
            regular(path, None)
        except OSError as error:  # a pipe, a device
            what = what if folder or file else str(error.strerror)
        raise InputError(f"{option} {path} is {what}; give a {kind}")
    if not os.access(path, os.R_OK | (os.X_OK if folder else 0)):
        raise InputError(f"{option} {path}: no permission to read it")
