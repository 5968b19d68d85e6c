"""A Dask cluster before it works for a run: the connection, what its processes have and see, and its messages."""

import asyncio
import logging
import shutil
import threading
import uuid
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from tiegraph.errors import InputError
from tiegraph.project.daskworker import Seen
from tiegraph.project.pool import Place
from tiegraph.project.receipts import software

FREE_S = 60.0  # for a worker to become free of what it does and to load tiegraph

_CONNECT_S = 8.0
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application", "asyncio")


def connect(address: str) -> Any:
    """The client of a scheduler. Raises InputError if none answers within ``_CONNECT_S``.

    A client that is of no use is closed where it was made: left to the garbage collector it is closed by whatever
    thread that runs in, and Dask waits for itself without end if this is the one that starts another client's loop
    (``LoopRunner`` of distributed holds one lock for all).
    """
    from distributed import Client

    found: list[Any] = []
    given_up, deciding = threading.Event(), threading.Lock()

    def connect() -> None:
        client: Any = Client.__new__(Client)
        result: Any = client
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of versions: those that matter are compared in ``begin``
                client.__init__(address, timeout=_CONNECT_S, set_as_default=False)
        except Exception as error:
            result = error
        with deciding:
            found.append(result)
            wanted = result is client and not given_up.is_set()
        if not wanted:
            with suppress(Exception):
                client.close(timeout=5)

    # Dask waits without end for something that takes the connection and says nothing.
    thread = threading.Thread(target=connect, daemon=True, name="dask-connect")
    thread.start()
    thread.join(_CONNECT_S + 1)
    with deciding:
        given_up.set()
    if found and isinstance(found[0], Client):
        return found[0]
    why = f"{type(found[0]).__name__}: {found[0]}" if found else "silent"
    raise InputError(
        f"pool dask:{address}: no Dask scheduler answers there ({why}); "
        "give the address that `dask scheduler` prints, such as tcp://127.0.0.1:8786"
    )


@contextmanager
def visible(place: Place | None) -> Iterator[tuple[str, list[str]] | None]:
    """A folder that workers must be able to write into, new so that no other of the same name serves, and what they
    must be able to read."""
    if place is None:
        yield None
        return
    probe = place.folder / f".dask-{uuid.uuid4().hex}"
    probe.mkdir(parents=True)
    try:
        yield str(probe), [str(p.absolute()) for p in place.reads]
    finally:
        shutil.rmtree(probe, ignore_errors=True)


def other_versions(versions: Any) -> str | None:
    """What a process of the cluster lacks, None if nothing. ``versions``: its ``software`` or the error it answered."""
    if not isinstance(versions, dict):
        return (
            f"cannot run tiegraph ({type(versions).__name__}: {versions}): "
            f"install tiegraph {software()['tiegraph']} in its environment and start it again"
        )
    for name, own in software().items():
        theirs = versions.get(name, "none")
        if _series(name, own) != _series(name, theirs):
            return f"has {name} {theirs}, this process {own}: install the same there and start it again"
    return None


def unfit(seen: Any) -> str | None:
    """Why a worker cannot serve, None if it can. ``seen``: a ``Seen`` or the error it answered with."""
    if isinstance(seen, (TimeoutError, asyncio.TimeoutError)):
        return f"did not begin within {FREE_S:.0f} s: it is busy with something else or hangs; wait, or start it again"
    if not isinstance(seen, Seen):
        return f"could not begin ({type(seen).__name__}: {seen}): look at what it says, and start it again"
    if seen.problem:
        return f"{seen.problem}: workers need the run folder and the images under the same paths (a shared file system)"
    return None


def _series(name: str, version: str) -> Sequence[str]:
    return version.split(".")[:2] if name == "python" else version


class Quiet:
    """Dask's messages go to the run's log, not to the terminal, until ``end``."""

    def __init__(self) -> None:
        handlers: list[logging.Handler] = [_ToRunLog(logging.WARNING)]
        self._before = []
        for name in _LOGGERS:
            logger = logging.getLogger(name)
            self._before.append((logger, logger.handlers, logger.propagate))
            logger.handlers, logger.propagate = list(handlers), False

    def end(self) -> None:
        """Put the handlers back."""
        for logger, handlers, propagate in self._before:
            logger.handlers, logger.propagate = handlers, propagate
        self._before = []


class _ToRunLog(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        for handler in logging.getLogger("tiegraph").handlers:
            handler.handle(record)
