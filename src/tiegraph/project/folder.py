"""The run folder as a whole: made and marked by us, used by one run at a time, and separate from the inputs.

Output of native libraries during a run belongs to its log: the terminal is the user's.
"""

import itertools
import json
import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from tiegraph.errors import InputError
from tiegraph.project.progress import LogFormatter
from tiegraph.project.stages import covered, digest, read_object, write_atomic
from tiegraph.scene.atomic import MARK, TEMPORARIES, is_temporary, real_path, sweep
from tiegraph.text import some

log = logging.getLogger("tiegraph")

SETTINGS = "tiegraph.toml"
LOCK, LOG = ".lock", "log.txt"
_FORMAT = 3  # of the run folder: names of its files, and of their contents
_HARMLESS = (SETTINGS, LOCK, ".ds_store", "thumbs.db", "desktop.ini")


def is_marked(folder: Path) -> bool:
    """Whether a folder was made by a run of tiegraph. One lost file of the receipts does not undo that."""
    return (folder / MARK).is_file() or any((folder / "receipts" / "files").glob("*.json"))


def names_run(text: str) -> bool:
    """Whether an option that takes words, a file or a run folder names a run folder."""
    try:
        return Path(text).is_dir() and is_marked(Path(text))
    except (OSError, ValueError):
        return False


def check_folder(folder: Path) -> None:
    """Raise InputError for a run folder that is not ours alone: it must be new, empty, or made by a run."""
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise InputError(f"-o {folder} is not a folder: give a new or empty folder for the results")
    try:
        there = sorted(p.name for p in folder.iterdir() if p.name.lower() not in _HARMLESS)
        receipts = folder / "receipts"  # of a run that was killed before it had marked its folder
        if receipts.is_dir() and all(is_temporary(p.name) for p in receipts.iterdir()):
            there.remove(receipts.name)
    except OSError as error:
        raise InputError(f"cannot read {folder}: {error.strerror}; give another -o folder") from error
    if not there or is_marked(folder):
        check_format(folder)
        return
    if (folder / "receipts" / "scan.json").is_file():
        raise _other_version(folder, "an earlier")
    raise InputError(
        f"-o {folder} contains files that tiegraph did not make ({some(there, 3)}): give a new or empty folder for the "
        f"results, such as {folder / 'tiegraph_out'}"
    )


def must_be_empty(folder: Path, option: str = "") -> None:
    """Raise InputError for a folder of results, given by an ``option``, that holds something or is no folder."""
    if os.path.lexists(folder) and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{option} {folder} exists already and is not empty: give a new folder".strip())


def check_format(folder: Path) -> None:
    """Raise InputError for the run folder of a version with other names of files or contents."""
    made = _mark(folder)["format"]
    if made != _FORMAT:
        raise _other_version(folder, "a later" if isinstance(made, int) and made > _FORMAT else "an earlier")


def _other_version(folder: Path, which: str) -> InputError:
    return InputError(
        f"{folder} is the run folder of {which} version of tiegraph, which this one cannot read: give another folder, "
        "or remove this one; nothing in it was touched"
    )


def check_inputs(folder: Path, inputs: Mapping[str, Path], artefacts: Iterable[str]) -> None:
    """Raise InputError, naming both, for an input in the place of an artefact, or a folder of inputs that contains the
    run folder. ``inputs``: the user's name of it -> where it is."""
    places = (*artefacts, "receipts", SETTINGS, LOCK, LOG)
    for what, path in inputs.items():
        for out, given in ((folder.absolute(), path.absolute()), (real_path(folder), real_path(path))):
            if given == out or given in out.parents and given.is_dir():
                raise InputError(
                    f"-o {folder} lies in {what} {path}: results would be read as inputs; give a folder beside it"
                )
            inside = given.relative_to(out).as_posix() if out in given.parents else ""
            if inside and covered(inside, places):
                raise InputError(
                    f"{what} {path} lies in the place of the results {folder / inside.split('/')[0]}: move it, or give "
                    "another -o folder"
                )


def write_settings(folder: Path, text: str) -> Callable[[], None]:
    """Write the run folder's tiegraph.toml; a function that undoes it. A file that differs from the one we wrote last
    is kept as ``tiegraph.before-<n>.toml``."""
    path, mark = folder / SETTINGS, _mark(folder)
    before = path.read_bytes() if path.exists() else None
    if before is not None and digest(before.hex()) != mark.get("settings"):
        names = (path.with_name(f"{path.stem}.before-{n}.toml") for n in itertools.count(1))
        write_atomic(next(name for name in names if not os.path.lexists(name)), before)
    write_atomic(path, text)
    write_atomic(folder / MARK, json.dumps({**mark, "settings": digest(text.encode().hex())}))

    def take_back() -> None:
        if before is None:
            path.unlink(missing_ok=True)
        else:
            write_atomic(path, before)
        write_atomic(folder / MARK, json.dumps(mark))

    return take_back


def _mark(folder: Path) -> dict:
    return {"made by": "tiegraph run", "format": _FORMAT, **(read_object(folder / MARK) or {})}


@contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """The folder exists, marked as ours, locked against other runs, without temporary files of killed processes, and
    log records of tiegraph and output of native libraries go to its log.txt.

    Raises InputError if that is impossible.
    """
    handle = _locked(folder)
    try:
        sweep(folder.rglob(TEMPORARIES))
        if not (folder / MARK).exists():
            write_atomic(folder / MARK, json.dumps(_mark(folder)))
        with _logged(folder / LOG):
            yield
    finally:
        os.close(handle)


def _locked(folder: Path) -> int:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | _NO_LINK, 0o644)
    except OSError as error:
        raise _unusable(folder, LOCK, error) from error
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:  # Windows: no lock
        pass
    except OSError:
        os.close(handle)
        raise InputError(f"{folder}: another tiegraph run is working here; wait for it or stop it") from None
    return handle


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    try:
        stream = open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | _NO_LINK, 0o644), "a", encoding="utf-8",
                      errors="backslashreplace")  # fmt: skip
    except OSError as error:
        raise _unusable(path.parent, path.name, error) from error
    handler = logging.StreamHandler(stream)
    handler.setFormatter(LogFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.handleError = lambda record: None  # type: ignore[method-assign]  # a full disk; the stage says so
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        with libraries_to(stream.fileno()):
            yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        with suppress(OSError):  # the disk is full: the missing records were lost before
            stream.close()


_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def _unusable(folder: Path, name: str, error: OSError) -> InputError:
    if (folder / name).is_symlink() or (folder / name).is_dir():
        kind = "a link" if (folder / name).is_symlink() else "a folder"
        return InputError(f"{folder / name} is {kind}, where tiegraph writes a file of its own: move it elsewhere")
    return InputError(f"cannot write into {folder}: {error.strerror}; choose another -o folder")


_STDERR = 2


@contextmanager
def libraries_to(descriptor: int) -> Iterator[None]:
    """Output of libtiff, OpenCV or COLMAP to standard error goes to an open file; Python's own ``sys.stderr`` keeps its
    target. Processes that begin meanwhile (the workers) inherit it."""
    try:
        saved = os.dup(_STDERR)
    except OSError:  # there is no standard error
        yield
        return
    before = sys.stderr
    own = None
    if _is_on(before):
        encoding = before.encoding or "utf-8"
        own = open(saved, "w", buffering=1, encoding=encoding, errors="backslashreplace", closefd=False)
        sys.stderr = own
    os.dup2(descriptor, _STDERR)
    try:
        yield
    finally:
        if own is not None:
            if sys.stderr is own:
                sys.stderr = before
            with suppress(OSError, ValueError):  # the terminal has gone
                own.flush()
        os.dup2(saved, _STDERR)
        os.close(saved)


def _is_on(stream: TextIO | None) -> bool:
    """Whether a stream writes to standard error itself, and not to a substitute (a notebook, a test)."""
    try:
        if stream is None or stream.fileno() != _STDERR:
            return False
        stream.flush()
        return True
    except (OSError, ValueError):
        return False
