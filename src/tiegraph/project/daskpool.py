"""Items on the workers of a Dask cluster, as an ``Executor``.

If a worker is lost, its chunk of items is given to another; the run ends only if none is left, or if a chunk has ended
several workers. Workers that come later, restarted by Dask or by a queue, take part from the next stage on.
"""

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
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future, InvalidStateError
from contextlib import suppress
from functools import partial
from typing import Any

import psutil

from tiegraph.errors import InputError, SettingsError, TiegraphError, optional
from tiegraph.project import daskworker
from tiegraph.project.pool import Place
from tiegraph.project.progress import Elsewhere
from tiegraph.project.stages import software

log = logging.getLogger(__name__)

_GOES_ON = "finished work is kept, run the same command again"
_CONNECT_S = 8.0
_WORKERS_S = 8.0  # until the scheduler has a worker
_FREE_S = 60.0  # for a worker to finish its present task and to load tiegraph
_END_S = 30.0  # for the items under way to end after an error
_SHARED_BYTES = 2**18  # larger data goes to each worker once
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application", "asyncio")


def open_dask(address: str, place: Place | None, end: Callable[[], Any] | None = None) -> tuple[Executor, int]:
    """(executor, number of workers) of the cluster whose scheduler is at ``address``; ``end`` is called when the
    executor has left it. Raises as ``open_pool``."""
    if not address:
        raise SettingsError("pool 'dask:': give the scheduler's address too, such as dask:tcp://127.0.0.1:8786")
    optional("distributed", "dask", "the pool dask")
    quiet = Quiet()
    try:
        executor = DaskExecutor(connect(address), address, quiet, end)
    except BaseException:
        quiet.end()
        raise
    try:
        return executor, executor.begin(place)
    except BaseException:
        executor.shutdown(cancel_futures=True)
        raise


class DaskExecutor(Executor):
    """Runs calls on the workers that ``begin`` found and those that came later. Made by ``open_dask``."""

    def __init__(self, client: Any, address: str, quiet: "Quiet", end: Callable[[], Any] | None = None) -> None:
        self._client, self._address, self._quiet, self._end = client, address, quiet, end
        self._run = uuid.uuid4().hex
        self._place: Place | None = None
        self._workers: list[str] = []
        self._refused: set[str] = set()  # workers that came later and cannot serve
        self._missing: set[str] = set()  # workers that have gone
        self._below: set[str] = set()  # workers in child processes of this one: their use is counted already
        self._elsewhere = Elsewhere()
        self._doing = "items"
        self._waiting: set[Future] = set()
        self._unfinished = self._over = False
        self._lost = ""  # why the run cannot go on

    def begin(self, place: Place | None) -> int:
        """Check and prepare every worker; their number. Raises InputError naming a worker that cannot serve."""
        self._place = place
        self._elsewhere = place.elsewhere if place is not None and place.elsewhere is not None else Elsewhere()
        try:
            self._client.wait_for_workers(1, timeout=_WORKERS_S)
            threads = dict(sorted(self._client.nthreads().items()))
        except Exception:
            raise InputError(
                f"pool dask:{self._address}: the scheduler has no workers; "
                f"start some with `dask worker {self._address} --nworkers N --nthreads 1`"
            ) from None
        if wrong := self._take_on(threads):
            raise InputError(next(iter(wrong.values())))
        self._client.loop.add_callback(self._watch)
        log.info("pool dask:%s: %d workers: %s", self._address, len(self._workers), ", ".join(self._workers))
        return len(self._workers)

    def share(self, data: Any) -> Any:
        """Stands for ``data`` as an argument of ``submit``; large data goes to each worker once.

        ``data`` = (function, args) of items: its name is shown on Dask's dashboard.
        """
        function, args = data
        named = function
        while isinstance(named, partial):
            named = named.func
        self._doing = getattr(named, "__name__", type(named).__name__).strip("_").removesuffix("_item")
        self._look_for_more()
        call = (partial(daskworker.while_wanted, function), args)
        pickled = pickle.dumps(call)
        if len(pickled) <= _SHARED_BYTES:
            return call
        there = [w for w in self._workers if w not in self._missing]
        return self._asked(self._client.scatter, [pickled], broadcast=True, hash=False, workers=there)[0]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Run ``fn(*args)`` on a worker; ``fn`` must be at module level."""
        from distributed import Future as Handle

        shared = [k for k, a in enumerate(args) if isinstance(a, Handle)]
        plain = [None if k in shared else a for k, a in enumerate(args)]
        packed = pickle.dumps((self._run, os.getcwd(), partial(fn, **kwargs), plain, shared))
        given = packed, *(args[k] for k in shared)
        key = f"{self._doing}-{uuid.uuid4().hex}"
        task = self._asked(self._client.submit, daskworker.on_worker, *given, workers=self._workers, key=key)
        future: Future = Future()
        self._waiting.add(future)
        future.add_done_callback(partial(self._ended, task))
        self._client.loop.add_callback(self._follow, task, future)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster. After an error or an interrupt, once the items under way have ended (30 s at most)."""
        if self._client.status == "closed":
            return
        self._over = True
        try:
            if self._unfinished and wait and self._client.status == "running":
                there = set(self._client.nthreads())
                self._on_each({w: daskworker.idle for w in self._workers if w in there}, _END_S)
        finally:
            with suppress(Exception):
                self._client.close(timeout=5)
            if self._end is not None:
                self._end()
            self._quiet.end()

    def _asked(self, ask: Callable[..., Any], *args: Any, **more: Any) -> Any:
        if self._lost:
            raise TiegraphError(self._lost)
        try:
            return ask(*args, **more)
        except Exception as error:
            raise TiegraphError(self._gone(error)) from None

    def _take_on(self, threads: dict[str, int]) -> dict[str, str]:
        """Prepare workers (address -> threads) for the run; those that cannot serve, and why."""
        wrong, place, probe = self._other_versions(list(threads)), self._place, None
        if place is not None:  # a folder to write into is new, so that no other of the same name serves
            folder = place.folder / f".dask-{uuid.uuid4().hex}"
            folder.mkdir(parents=True)
            probe = str(folder), [str(p.absolute()) for p in place.reads]
        try:
            prepare = partial(daskworker.prepare, self._run)
            seen = self._on_each({a: partial(prepare, n, probe) for a, n in threads.items() if a not in wrong}, _FREE_S)
        finally:
            if probe is not None:
                shutil.rmtree(probe[0], ignore_errors=True)
        for worker, answer in seen.items():
            if (why := unfit(answer)) is not None:
                wrong[worker] = f"pool dask:{self._address}: the worker {worker} {why}"
        own = {p.pid for p in (psutil.Process(), *psutil.Process().children(recursive=True))}
        for worker in (w for w in threads if w not in wrong):
            if threads[worker] > 1:
                log.warning("dask worker %s: %d threads for one item at a time; better: more workers with "
                            "--nthreads 1", worker, threads[worker])  # fmt: skip
            host, pid, _ = seen[worker]
            if host == socket.gethostname() and pid in own:
                self._below.add(worker)
            self._workers.append(worker)
        return wrong

    def _look_for_more(self) -> None:
        """Prepare workers that came later; one that cannot serve is named and not used."""
        try:
            known = {*self._workers, *self._refused}
            new = {w: n for w, n in sorted(self._client.nthreads().items()) if w not in known}
            wrong = self._take_on(new) if new else {}
        except Exception as error:
            log.warning("%s", self._gone(error))  # if the cluster has gone, the next request will report it
            return
        self._refused |= set(wrong)
        for why in wrong.values():
            log.warning("%s", why)

    def _other_versions(self, workers: list[str]) -> dict[str, str]:
        """Those of the workers, and the scheduler, that have other software, and the difference."""

        # Not as a task: a worker or scheduler that cannot import a task it receives breaks.
        async def ask() -> dict[str, Any]:
            out = dict(await self._client.run(software, workers=workers, on_error="return"))
            try:
                return {"scheduler": await self._client.run_on_scheduler(software), **out}
            except Exception as error:
                return {"scheduler": error, **out}

        try:
            found = self._client.sync(ask, callback_timeout=_FREE_S)
        except Exception as error:
            raise InputError(self._gone(error)) from None
        who = {name: name if name == "scheduler" else f"worker {name}" for name in found}
        wrong = {name: other_versions(versions) for name, versions in found.items()}
        return {n: f"pool dask:{self._address}: the {who[n]} {why}" for n, why in wrong.items() if why is not None}

    def _on_each(self, calls: dict[str, Callable[..., Any]], seconds: float) -> dict[str, Any]:
        """The result of each worker's call, or the error it raised, before other tasks waiting there."""
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

    async def _follow(self, task: Any, future: Future) -> None:
        """Forward the result of a task, or the error of the item."""
        with suppress(InvalidStateError):  # nobody waits any more, or the run cannot go on
            try:
                result, worker, used = await task
            except (Exception, CancelledError) as error:
                dask = type(error).__module__.partition(".")[0] in ("distributed", "tornado")
                lost = dask or isinstance(error, CancelledError)
                future.set_exception(TiegraphError(self._gone(error)) if lost else error)
                return
            if worker not in self._below:
                self._elsewhere.add(worker, used)
            future.set_result(result)

    def _ended(self, task: Any, future: Future) -> None:
        self._waiting.discard(future)
        self._unfinished |= future.cancelled() or future.exception() is not None
        task.release()  # the scheduler drops unused results

    async def _watch(self) -> None:
        while not (self._over or self._lost):
            await asyncio.sleep(1.0)  # between two checks whether all workers are there
            self._lost = await self._look()
        for future in list(self._waiting) if self._lost else ():
            with suppress(InvalidStateError):
                future.set_exception(TiegraphError(self._lost))

    async def _look(self) -> str:
        """Why the run cannot go on, "" while it can. A worker that has gone is named once."""
        try:
            there = await asyncio.wait_for(self._client.nthreads(), 60.0)  # for the scheduler's answer to that
        except Exception as error:
            return "" if self._over else self._gone(error)
        gone = [w for w in self._workers if w not in there]
        for worker in set(gone) - self._missing:
            log.warning("pool dask:%s: the worker %s was lost, stopped from outside or for lack of memory; "
                        "the others do its work", self._address, worker)  # fmt: skip
        self._missing = set(gone)
        if len(gone) < len(self._workers):
            return ""
        return (
            f"pool dask:{self._address}: the worker {gone[-1]} was lost, stopped from outside or for lack of memory, "
            f"and no other is left: start it again, or fewer workers on a machine; {_GOES_ON}"
        )

    def _gone(self, error: BaseException) -> str:
        if type(error).__name__ == "KilledWorker":
            return f"pool dask:{self._address}: workers ended at the same item, most likely for lack of memory: {error}"
        why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return f"pool dask:{self._address}: the connection to the scheduler was lost ({why}); {_GOES_ON}"


def connect(address: str) -> Any:
    """The client of a scheduler. Raises InputError if none answers within ``_CONNECT_S``.

    A client that failed is closed where it was made: otherwise the garbage collector closes it in
    any thread, and Dask waits for itself forever if this thread starts another client's loop
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
                warnings.simplefilter("ignore")  # of versions: the relevant ones are compared in ``begin``
                client.__init__(address, timeout=_CONNECT_S, set_as_default=False)
        except Exception as error:
            result = error
        with deciding:
            found.append(result)
            wanted = result is client and not given_up.is_set()
        if not wanted:
            with suppress(Exception):
                client.close(timeout=5)

    # Dask waits forever for a server that accepts the connection and never answers.
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


def other_versions(versions: Any) -> str | None:
    """What a process of the cluster lacks, None if nothing. ``versions``: its ``software`` or the error it answered."""
    if not isinstance(versions, dict):
        return (
            f"cannot run tiegraph ({type(versions).__name__}: {versions}): "
            f"install tiegraph {software()['tiegraph']} in its environment and start it again"
        )
    for name, own in software().items():
        theirs = versions.get(name, "none")
        parts = 2 if name == "python" else None  # of Python the series must be the same
        if own.split(".")[:parts] != theirs.split(".")[:parts]:
            return f"has {name} {theirs}, this process {own}: install the same there and start it again"
    return None


def unfit(seen: Any) -> str | None:
    """Why a worker cannot serve, None if it can. ``seen``: the answer of ``prepare`` or the error."""
    if isinstance(seen, (TimeoutError, asyncio.TimeoutError)):
        return f"did not begin within {_FREE_S:.0f} s: it is busy with something else or hangs; wait, or start it again"
    if not isinstance(seen, tuple):
        return f"could not begin ({type(seen).__name__}: {seen}): see its output, and start it again"
    if seen[2]:
        return f"{seen[2]}: workers need the run folder and the images under the same paths (a shared file system)"
    return None


class Quiet(logging.Handler):
    """Dask's messages go to the run's log, not to the terminal, until ``end``."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        loggers = [logging.getLogger(name) for name in _LOGGERS]
        self._before = [(logger, logger.handlers, logger.propagate) for logger in loggers]
        handlers: list[logging.Handler] = [self]
        for logger in loggers:
            logger.handlers, logger.propagate = list(handlers), False

    def end(self) -> None:
        """Restore the handlers."""
        for logger, handlers, propagate in self._before:
            logger.handlers, logger.propagate = handlers, propagate
        self._before = []

    def emit(self, record: logging.LogRecord) -> None:
        """To the log."""
        for handler in logging.getLogger("tiegraph").handlers:
            handler.handle(record)
