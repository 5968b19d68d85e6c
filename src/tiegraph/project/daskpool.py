"""Items on the workers of a Dask cluster, as an ``Executor``.

The workers that are there at the start do the run. Each is looked at first: the same versions, the same folders. Each
makes one item at a time, whatever its number of threads; these go to the libraries. One that is lost ends the run with
an error, as in the local pool, for the next run continues. Workers outlive a run, so they stop between two items when
the run has gone, and a new run begins when they have.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import shutil
import socket
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import psutil

from tiegraph.errors import EngineMissing, InputError, SettingsError, TiegraphError
from tiegraph.project import daskworker
from tiegraph.project.daskworker import GOES_ON, Seen
from tiegraph.project.pool import Place
from tiegraph.project.progress import Elsewhere
from tiegraph.project.software import software

log = logging.getLogger(__name__)

_CONNECT_S = 8.0
_WORKERS_S = 8.0  # until the scheduler has a worker
_FREE_S = 60.0  # for a worker to become free of what it does and to load tiegraph
_END_S = 30.0  # for the items under way to end after an error
_LOOK_S = 1.0  # between two looks whether all workers are there
_ANSWER_S = 60.0  # for the scheduler to say so
_SHARED_BYTES = 2**18  # what is larger goes to each worker once
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application", "asyncio")


def open_dask(address: str, place: Place | None) -> tuple[Executor, int]:
    """(executor, number of workers) of the cluster whose scheduler is at ``address``. Raises as ``open_pool`` says."""
    if not address:
        raise SettingsError("pool 'dask:': give the scheduler's address too, such as dask:tcp://127.0.0.1:8786")
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise EngineMissing("the dask pool needs Dask: pip install 'tiegraph[dask]'") from None
    quiet = _Quiet()
    try:
        executor = DaskExecutor(_connect(address), address, quiet)
    except BaseException:
        quiet.end()
        raise
    try:
        return executor, executor.begin(place)
    except BaseException:
        executor.shutdown(cancel_futures=True)
        raise


def _connect(address: str) -> Any:
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


class DaskExecutor(Executor):
    """Runs calls on the workers that ``begin`` found. Made by ``open_dask``."""

    def __init__(self, client: Any, address: str, quiet: _Quiet) -> None:
        self._client, self._address, self._quiet = client, address, quiet
        self._run = uuid.uuid4().hex
        self._workers: list[str] = []
        self._below: set[str] = set()  # workers whose processes are below this one: their use is counted already
        self._elsewhere = Elsewhere()
        self._unfinished = False
        self._lost: asyncio.Future[str] | None = None
        self._watcher: Future | None = None

    def begin(self, place: Place | None) -> int:
        """Look at every worker and prepare it; their number. Raises InputError naming the worker that cannot serve."""
        threads = self._threads()
        self._compare_versions()
        self._elsewhere = place.elsewhere if place is not None and place.elsewhere is not None else Elsewhere()
        with _visible(place) as probe:
            calls: dict[str, Callable[..., Any]] = {
                a: partial(daskworker.prepare, self._run, n, probe) for a, n in threads.items()
            }
            seen = self._on_each(calls, _FREE_S)
        for worker in threads:
            if (wrong := _wrong(seen[worker])) is not None:
                raise InputError(f"pool dask:{self._address}: the worker {worker} {wrong}")
            if threads[worker] > 1:
                log.warning("dask worker %s: %d threads for one item at a time; better: more workers with "
                            "--nthreads 1", worker, threads[worker])  # fmt: skip
        own = {p.pid for p in (psutil.Process(), *psutil.Process().children(recursive=True))}
        self._below = {w for w in threads if seen[w].host == socket.gethostname() and seen[w].pid in own}
        self._workers = list(threads)
        self._watcher = asyncio.run_coroutine_threadsafe(self._watch(), self._loop)
        log.info("pool dask:%s: %d workers: %s", self._address, len(threads), ", ".join(threads))
        return len(threads)

    def share(self, data: Any) -> Any:
        """Stands for ``data`` as an argument of ``submit``; what is large goes to each worker once.

        ``data`` = (function, args) of items: the function ends its chunk when the run has gone.
        """
        function, args = data
        call = (partial(daskworker.while_wanted, function), args)
        pickled = pickle.dumps(call)
        if len(pickled) <= _SHARED_BYTES:
            return call
        with _as_errors(self._gone):
            return _Shared(self._client.scatter([pickled], broadcast=True, hash=False, workers=self._workers)[0])

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Run ``fn(*args)`` on a worker; ``fn`` must be at module level."""
        shared = [k for k, a in enumerate(args) if isinstance(a, _Shared)]
        plain = [None if k in shared else a for k, a in enumerate(args)]
        packed = pickle.dumps((self._run, os.getcwd(), partial(fn, **kwargs), plain, shared))
        handles = [args[k].future for k in shared]
        with _as_errors(self._gone):
            task = self._client.submit(daskworker.on_worker, packed, *handles, workers=self._workers, pure=False)
        future = asyncio.run_coroutine_threadsafe(self._follow(task), self._loop)
        future.add_done_callback(self._note)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster. After an error or an interrupt, once the items under way have ended (30 s at most)."""
        if self._client.status == "closed":
            return
        try:
            if self._unfinished and wait and self._client.status == "running":
                there = set(self._client.nthreads())
                self._on_each({w: daskworker.idle for w in self._workers if w in there}, _END_S)
        finally:
            if self._watcher is not None:
                self._watcher.cancel()
            with suppress(Exception):
                self._client.close(timeout=5)
            self._quiet.end()

    @property
    def _loop(self) -> asyncio.AbstractEventLoop:
        return self._client.loop.asyncio_loop

    def _compare_versions(self) -> None:
        # Not as a task: a worker or scheduler that cannot import what it is sent as one breaks.
        async def ask() -> dict[str, Any]:
            out = dict(await self._client.run(daskworker.versions, on_error="return"))
            try:
                return {"scheduler": await self._client.run_on_scheduler(daskworker.versions), **out}
            except Exception as error:
                return {"scheduler": error, **out}

        try:
            found = asyncio.run_coroutine_threadsafe(ask(), self._loop).result(_FREE_S)
        except Exception as error:
            raise InputError(self._gone(error)) from None
        for name, versions in found.items():
            if (wrong := _other_versions(versions)) is not None:
                who = name if name == "scheduler" else f"worker {name}"
                raise InputError(f"pool dask:{self._address}: the {who} {wrong}")

    def _threads(self) -> dict[str, int]:
        try:
            self._client.wait_for_workers(1, timeout=_WORKERS_S)
            return dict(sorted(self._client.nthreads().items()))
        except Exception:
            raise InputError(
                f"pool dask:{self._address}: the scheduler has no workers; "
                f"start some with `dask worker {self._address} --nworkers N --nthreads 1`"
            ) from None

    def _on_each(self, calls: dict[str, Callable[..., Any]], seconds: float) -> dict[str, Any]:
        """What each worker's call returns, or the error it raised, before what else waits there."""
        tasks = {
            w: self._client.submit(daskworker.unpacked, pickle.dumps(call), workers=[w], pure=False, priority=100)
            for w, call in calls.items()
        }
        end, out = time.monotonic() + seconds, {}
        for worker, task in tasks.items():
            try:
                out[worker] = task.result(timeout=max(0.1, end - time.monotonic()))
            except (Exception, CancelledError) as error:
                out[worker] = error
        return out

    async def _follow(self, task: Any) -> Any:
        """The result of a task, or the error of the item, or that the worker was lost."""
        lost = self._lost_future()
        waiting = asyncio.ensure_future(_outcome(task))
        both: set[asyncio.Future[Any]] = {waiting, lost}
        try:
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        finally:
            if not waiting.done():
                waiting.cancel()
                with suppress(Exception, CancelledError):
                    await self._client.cancel([task], asynchronous=True)
        if lost.done():
            raise TiegraphError(lost.result())
        value, error = waiting.result()
        if error is not None:
            raise error if isinstance(error, Exception) and not _of_dask(error) else TiegraphError(self._gone(error))
        result, worker, used = value
        if worker not in self._below:
            self._elsewhere.add(worker, used)
        return result

    def _lost_future(self) -> asyncio.Future[str]:
        if self._lost is None:
            self._lost = asyncio.get_running_loop().create_future()
        return self._lost

    async def _watch(self) -> None:
        lost = self._lost_future()
        while not lost.done():
            await asyncio.sleep(_LOOK_S)
            if (text := await self._look()) is not None:
                lost.set_result(text)

    async def _look(self) -> str | None:
        try:
            there = await asyncio.wait_for(self._client.nthreads(), _ANSWER_S)
        except Exception as error:
            return self._gone(error)
        gone = [w for w in self._workers if w not in there]
        if not gone:
            return None
        return (
            f"pool dask:{self._address}: the worker {gone[0]} was lost, stopped from outside or for lack of memory: "
            f"start it again, or fewer workers on a machine; {GOES_ON}"
        )

    def _gone(self, error: BaseException) -> str:
        if type(error).__name__ == "KilledWorker":
            return f"pool dask:{self._address}: workers ended at the same item, most likely for lack of memory: {error}"
        why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return f"pool dask:{self._address}: the connection to the scheduler was lost ({why}); {GOES_ON}"

    def _note(self, future: Future) -> None:
        if future.cancelled() or future.exception() is not None:
            self._unfinished = True


@dataclass(frozen=True)
class _Shared:
    """An argument that the workers have already, pickled."""

    future: Any


async def _outcome(task: Any) -> tuple[Any, BaseException | None]:
    try:
        return await task, None
    except (Exception, CancelledError) as error:
        return None, error


def _of_dask(error: BaseException) -> bool:
    return isinstance(error, CancelledError) or type(error).__module__.partition(".")[0] in ("distributed", "tornado")


@contextmanager
def _as_errors(text: Callable[[BaseException], str]) -> Iterator[None]:
    """What Dask raises when the scheduler has gone, as a TiegraphError."""
    try:
        yield
    except TiegraphError:
        raise
    except (pickle.PicklingError, AttributeError, TypeError):
        raise
    except Exception as error:
        raise TiegraphError(text(error)) from None


@contextmanager
def _visible(place: Place | None) -> Iterator[tuple[str, list[str]] | None]:
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


def _other_versions(versions: Any) -> str | None:
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


def _wrong(seen: Any) -> str | None:
    """Why a worker cannot serve, None if it can. ``seen``: a ``Seen`` or the error it answered with."""
    if isinstance(seen, (TimeoutError, asyncio.TimeoutError)):
        return f"did not begin within {_FREE_S:.0f} s: it is busy with something else or hangs; wait, or start it again"
    if not isinstance(seen, Seen):
        return f"could not begin ({type(seen).__name__}: {seen}): look at what it says, and start it again"
    if seen.problem:
        return f"{seen.problem}: workers need the run folder and the images under the same paths (a shared file system)"
    return None


def _series(name: str, version: str) -> Sequence[str]:
    return version.split(".")[:2] if name == "python" else version


class _Quiet:
    """Dask's messages go to the run's log, not to the terminal, until ``end``."""

    def __init__(self) -> None:
        handler = _ToRunLog(logging.WARNING)
        self._before = []
        for name in _LOGGERS:
            logger = logging.getLogger(name)
            self._before.append((logger, logger.handlers, logger.propagate))
            logger.handlers, logger.propagate = [handler], False

    def end(self) -> None:
        """Put the handlers back."""
        for logger, handlers, propagate in self._before:
            logger.handlers, logger.propagate = handlers, propagate
        self._before = []


class _ToRunLog(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        for handler in logging.getLogger("tiegraph").handlers:
            handler.handle(record)
