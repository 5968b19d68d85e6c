"""Surveys and results in object stores: ``s3://``, ``gs://``, ``https://``, ``sftp://`` and all else that fsspec opens.

A run works on files of its own machines. So what lies below a URL is copied into a folder beside the run folder, and a
later run copies what has changed since by size, ETag or time. ``fetched.jsonl`` beside the copy says line by line which
state of an object each file is, so that a killed run goes on where it was. The copy is ours, what is in the store is
not: nothing there is removed or written over. Results go to a place that is empty. fsspec's thread stays, so helpers
of such a run are spawned and not forked (``tiegraph.forking``).
"""

import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from tiegraph.errors import EngineMissing, InputError, optional
from tiegraph.limits import no_room
from tiegraph.project.progress import Reporter
from tiegraph.project.stages import digest, take_away
from tiegraph.scene.atomic import replacing
from tiegraph.scene.names import check_name
from tiegraph.text import one_line, some

_CACHE, _LIST = "tiegraph_cache", "fetched.jsonl"
_URL = re.compile(r"([a-z][a-z0-9+]+):/{1,2}(?=[^/])")
_SHOWN = 3
_LACKING = -1  # in the list, as the size of a file: it could not be fetched
# What tells whether an object has changed, by the names that fsspec's file systems give it
_STATE = ("size", "ETag", "etag", "Last-Modified", "LastModified", "last_modified", "mtime", "updated", "created")


def url_of(given: object) -> str:
    """The URL that an option names, "" for a path or words. A ``Path`` of a URL has lost one of its slashes."""
    text = str(given)
    found = _URL.match(text)
    # A folder of that name: topics of a bag (``run:/gps/fix``)
    return f"{found[1]}://{text[found.end() :]}" if found and not os.path.lexists(found[1]) else ""


def place_of(url: str, folder: Path) -> Path:
    """Where the copy of what lies at a URL is, in a folder: of the same name, whatever the place in the store."""
    url = url.rstrip("/")
    parts = urlsplit(url)
    name = PurePosixPath(unquote(parts.path)).name or parts.netloc
    check_name(name)
    return folder / _CACHE / digest(url) / name


def fetch(url: str, target: Path, reporter: Reporter) -> None:
    """Make ``target`` (of ``place_of``) the copy of the file or folder at a URL.

    Objects that cannot be read are named and left out. Raises EngineMissing without the package for this kind of store,
    InputError where nothing can be listed or none of its files be read, and for a full disk.
    """
    store, root = _opened(url)
    with _worded(url, f"; the copy of an earlier run is in {target}" if target.exists() else ""):
        store.invalidate_cache()
        if not (listed := store.find(root, detail=True)) and url.startswith("http"):
            store.ls(root)  # says what was wrong, which the walk passes over
    named = {_name(path, root): (path, info) for path, info in listed.items() if _is_file(path, info)}
    if not named:
        raise InputError(f"{url}: nothing lies there, or nothing that may be listed: is it written correctly?")
    copy = _Copy(store=store, target=target, named=named, known=_read(target.parent / _LIST))
    new = [name for name, (_, info) in named.items() if not copy.has(name, _state(info))]
    size = sum(named[name][1].get("size") or 0 for name in new)
    target.parent.mkdir(parents=True, exist_ok=True)
    if size > shutil.disk_usage(target.parent).free:
        raise no_room(target.parent, f"{len(new)} files of {url} have {size / 1e9:.3g} GB")
    reporter.say(f"{url}: {len(named)} files, {len(new)} to compare or copy ({size / 1e6:.3g} MB) to {target}")
    began, gone, copied = time.perf_counter(), sorted(copy.known.keys() - named.keys()), 0
    take_away(target, [name for name in gone if copy.known[name][1] != _LACKING])
    with open(target.parent / _LIST, "a", encoding="utf-8") as ledger, reporter.stage("fetch"):
        ledger.writelines(json.dumps([name, None]) + "\n" for name in gone)
        reporter.total(len(new))
        for name, entry in _together(copy.bring, new):
            ledger.write(json.dumps([name, entry]) + "\n")
            ledger.flush()
            copied += entry[1] != _LACKING and entry != copy.known.get(name)
            reporter.advance()
    lacking = not_fetched(target)
    if lacking and not any(entry[1] != _LACKING for entry in _read(target.parent / _LIST).values()):
        raise InputError(f"{url}: {lacking[0]}")
    took = time.perf_counter() - began
    reporter.say(f"{'fetch':>9}  {took:7.1f} s  {copied} files copied, {len(gone)} removed that are gone there")
    reporter.event("fetched", url=url, folder=target, copied=copied, removed=len(gone), lacking=lacking)
    for text in lacking:
        reporter.say(f"{'':>9}  ! {text}")


def not_fetched(target: Path) -> tuple[str, ...]:
    """What the copy of a URL lacks, in a sentence; () for a whole copy and for a folder that is none."""
    lacking = {n: e[0] for n, e in _read(target.parent / _LIST).items() if e[1] == _LACKING}
    told = some((f"{one_line(n)} ({why})" for n, why in sorted(lacking.items())), _SHOWN, joint="; ")
    return (f"{len(lacking)} files of the store could not be fetched: {told}",) if lacking else ()


def send(url: str, folder: Path, names: Sequence[str], reporter: Reporter) -> None:
    """Copy files below a folder to a URL where nothing lies yet. Raises EngineMissing as ``fetch``, InputError if
    something lies there, and for what cannot be written; what was sent stays there."""
    store, root = _opened(url)
    root = root.rstrip("/")
    with _worded(url):
        store.invalidate_cache()
        try:
            there = [one["name"] for one in store.ls(root, detail=True)]
        except FileNotFoundError:
            there = []
    if there:
        raise InputError(f"{url} is not empty ({some(map(str, there), _SHOWN)}): give a new place in the store")
    with _worded(url, "; what was sent is there: remove it, or give another place"), reporter.stage("send"):
        reporter.total(len(names))
        for _ in _together(lambda name: store.put_file(str(folder / name), f"{root}/{name}"), names):
            reporter.advance()


def _opened(url: str) -> tuple[Any, str]:
    """fsspec's file system of a URL, and the path in it."""
    remedy = "pip install 'tiegraph[stores]' (s3, gs, http)"
    fsspec = optional("fsspec.core", "stores", f"{url}: a store")
    try:
        return fsspec.url_to_fs(url)  # type: ignore[no-any-return]
    except ImportError as error:
        raise EngineMissing(f"{url}: a package is missing: {remedy}, or for other stores: {error}") from None
    except ValueError as error:  # a protocol that it does not know
        raise InputError(f"{url}: {error}") from None


@contextmanager
def _worded(url: str, more: str = "") -> Iterator[None]:
    """Errors of a store in words of ours."""
    try:
        yield
    except (InputError, EngineMissing):
        raise
    except FileNotFoundError as error:
        raise InputError(f"{url}: no such bucket, folder or file ({_told(error)}){more}") from None
    except Exception as error:
        if isinstance(error, PermissionError) or re.search("credential|forbidden|denied|40[13]", str(error), re.I):
            raise InputError(
                f"{url}: no access ({_told(error)}): give the credentials where the store's own tools look for them "
                f"(`aws configure` or AWS_PROFILE, `gcloud auth application-default login`), for public data "
                f"FSSPEC_S3_ANON=true{more}"
            ) from None
        raise InputError(f"{url}: the store cannot be used now ({_told(error)}){more}") from None


def _told(error: BaseException) -> str:
    return one_line(f"{type(error).__name__}: {error}".rstrip(": "))


def _name(path: str, root: str) -> str:
    """The name of an object below the root, "" for the root itself."""
    name = path[len(root.rstrip("/")) :].lstrip("/")
    return unquote(name) if path.startswith("http") else name


def _is_file(path: str, info: dict[str, Any]) -> bool:
    """Not a folder, its mark, or a link of a web server's list that sorts it."""
    return info.get("type") != "directory" and not path.endswith("/") and "/?" not in path


def _state(info: dict[str, Any]) -> str:
    """The state of an object as far as a list or a look at it tells; "" if nothing does."""
    told = [str(value) for key in _STATE if (value := info.get(key)) is not None]
    return digest(told) if told else ""


@dataclass(frozen=True)
class _Copy:
    """The copy of a folder, or of a single file of the name "", and what its list knows of it."""

    store: Any
    target: Path
    named: dict[str, tuple[str, dict[str, Any]]]  # the objects: their paths, and what was listed of them
    known: dict[str, list[Any]]

    def path(self, name: str) -> Path:
        return self.target / name if name else self.target

    def has(self, name: str, state: str) -> bool:
        """Whether the file is the copy of that state, as it was written."""
        try:
            info = self.path(name).stat()
        except (OSError, ValueError):
            return False
        return bool(state) and self.known.get(name) == [state, info.st_size, info.st_mtime_ns]

    def bring(self, name: str) -> list[Any]:
        """The entry of the list for a file that is the copy of its object now, or cannot be."""
        try:
            check_name(name or self.target.name)
        except InputError as error:
            return [str(error), _LACKING, 0]
        local, (path, listed) = self.path(name), self.named[name]
        try:
            state = _state(listed) or _state(self.store.info(path))
            if self.has(name, state):
                return self.known[name]
            with replacing(local) as temporary:
                self.store.get_file(path, str(temporary))
                size, came = listed.get("size"), temporary.stat().st_size
                if size not in (None, came):
                    raise OSError(f"{came} of {size} bytes came")
            return [state, local.stat().st_size, local.stat().st_mtime_ns]
        except InputError:  # the disk is full
            raise
        except Exception as error:
            with suppress(OSError):
                local.unlink(missing_ok=True)  # of another state
            return [_told(error), _LACKING, 0]


def _together(function: Callable[[str], Any], names: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """(name, ``function(name)``) as they come, several at once. After an error those that wait are not begun."""
    threads = ThreadPoolExecutor(8)  # files under way
    try:
        futures = {threads.submit(function, name): name for name in names}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        threads.shutdown(cancel_futures=True)


def _read(path: Path) -> dict[str, list[Any]]:
    """The last entry of each file in a list; a line that a kill has cut off is none."""
    found: dict[str, Any] = {}
    with suppress(OSError):
        for line in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):
                name, entry = json.loads(line)
                found[name] = entry
    return {name: entry for name, entry in found.items() if entry is not None}
