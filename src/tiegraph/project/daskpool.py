"""Items on the workers of a Dask cluster, as an ``Executor``.

Each worker is looked at before it is given items (``daskworker``): the same versions, the same folders. It makes one
item at a time, whatever its number of threads; these go to the libraries. What a worker was making that is lost (a
chunk of items) is given to another; the run ends only where none is left, or where a chunk has ended several. Workers
that come later, started again by Dask or by a queue, take part from the next stage on. Workers outlive a run, so they
stop between two items when the run has gone, and a new run begins when they have.
"""

import asyncio
import logging
import os
import pickle
import socket
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import psutil

from tiegraph.errors import EngineMissing, InputError, SettingsError, TiegraphError
from tiegraph.project import daskworker
from tiegraph.project.daskworker import FREE_S, GOES_ON, Quiet, connect, other_versions, unfit, visible
from tiegraph.project.pool import Place
from tiegraph.project.progress import Elsewhere
from tiegraph.project.receipts import software

log = logging.getLogger(__name__)

_WORKERS_S = 8.0  # until the scheduler has a worker
_END_S = 30.0  # for the items under way to end after an error
_LOOK_S = 1.0  # between two looks whether all workers are there
_ANSWER_S = 60.0  # for the scheduler to say so
_SHARED_BYTES = 2**18  # what is larger goes to each worker once


def open_dask(address: str, place: Place | None) -> tuple[Executor, int]:
    """(executor, number of workers) of the cluster whose scheduler is at ``address``. Raises as ``open_pool`` says."""
    if not address:
        raise SettingsError("pool 'dask:': give the scheduler's address too, such as dask:tcp://127.0.0.1:8786")
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise EngineMissing("the dask pool needs Dask: pip install 'tiegraph[dask]'") from None
    quiet = Quiet()
    try:
        executor = DaskExecutor(connect(address), address, quiet)
    except BaseException:
        quiet.end()
        raise
    try:
        return executor, executor.begin(place)
    except BaseException:
        executor.shutdown(cancel_futures=True)
        raise


class DaskExecutor(Executor):
    """Runs calls on the workers that ``begin`` found and those that came since. Made by ``open_dask``."""

    def __init__(self, client: Any, address: str, quiet: Quiet) -> None:
        self._client, self._address, self._quiet = client, address, quiet
        self._run = uuid.uuid4().hex
        self._place: Place | None = None
        self._workers: list[str] = []
        self._refused: set[str] = set()  # workers that came later and cannot serve
        self._missing: set[str] = set()  # workers that have gone
        self._below: set[str] = set()  # workers whose processes are below this one: their use is counted already
        self._elsewhere = Elsewhere()
        self._doing = "items"
        self._unfinished = False
        self._lost: asyncio.Future[str] | None = None
        self._watcher: Future | None = None

    def begin(self, place: Place | None) -> int:
        """Look at every worker and prepare it; their number. Raises InputError naming the worker that cannot serve."""
        self._place = place
        self._elsewhere = place.elsewhere if place is not None and place.elsewhere is not None else Elsewhere()
        if wrong := self._take_on(self._threads()):
            raise InputError(next(iter(wrong.values())))
        self._watcher = asyncio.run_coroutine_threadsafe(self._watch(), self._loop)
        log.info("pool dask:%s: %d workers: %s", self._address, len(self._workers), ", ".join(self._workers))
        return len(self._workers)

    def share(self, data: Any) -> Any:
        """Stands for ``data`` as an argument of ``submit``; what is large goes to each worker once.

        ``data`` = (function, args) of items: the function ends its chunk when the run has gone, and its name is what
        Dask's dashboard shows.
        """
        function, args = data
        self._doing = _name(function)
        self._look_for_more()
        call = (partial(daskworker.while_wanted, function), args)
        pickled = pickle.dumps(call)
        if len(pickled) <= _SHARED_BYTES:
            return call
        with _as_errors(self._gone):
            there = [w for w in self._workers if w not in self._missing]
            return _Shared(self._client.scatter([pickled], broadcast=True, hash=False, workers=there)[0])

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Run ``fn(*args)`` on a worker; ``fn`` must be at module level."""
        shared = [k for k, a in enumerate(args) if isinstance(a, _Shared)]
        plain = [None if k in shared else a for k, a in enumerate(args)]
        packed = pickle.dumps((self._run, os.getcwd(), partial(fn, **kwargs), plain, shared))
        handles = [args[k].future for k in shared]
        with _as_errors(self._gone):
            key = f"{self._doing}-{uuid.uuid4().hex}"
            task = self._client.submit(daskworker.on_worker, packed, *handles, workers=self._workers, key=key)
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

    def _take_on(self, threads: dict[str, int]) -> dict[str, str]:
        """Prepare workers (address -> threads) for the run; those that cannot serve, and why."""
        wrong = self._other_versions(list(threads))
        with visible(self._place) as probe:
            calls: dict[str, Callable[..., Any]] = {
                a: partial(daskworker.prepare, self._run, n, probe) for a, n in threads.items() if a not in wrong
            }
            seen = self._on_each(calls, FREE_S)
        for worker, answer in seen.items():
            if (why := unfit(answer)) is not None:
                wrong[worker] = f"pool dask:{self._address}: the worker {worker} {why}"
        own = {p.pid for p in (psutil.Process(), *psutil.Process().children(recursive=True))}
        for worker in (w for w in threads if w not in wrong):
            if threads[worker] > 1:
                log.warning("dask worker %s: %d threads for one item at a time; better: more workers with "
                            "--nthreads 1", worker, threads[worker])  # fmt: skip
            if seen[worker].host == socket.gethostname() and seen[worker].pid in own:
                self._below.add(worker)
            self._workers.append(worker)
        return wrong

    def _look_for_more(self) -> None:
        """Prepare workers that have come since; one that cannot serve is named and left alone."""
        try:
            known = {*self._workers, *self._refused}
            new = {w: n for w, n in sorted(self._client.nthreads().items()) if w not in known}
            wrong = self._take_on(new) if new else {}
        except Exception as error:
            log.warning("%s", self._gone(error))  # if the cluster has gone, what is asked of it next will say so
            return
        self._refused |= set(wrong)
        for why in wrong.values():
            log.warning("%s", why)

    def _other_versions(self, workers: list[str]) -> dict[str, str]:
        """Those of the workers, and the scheduler, that have other software, and what is wrong."""

        # Not as a task: a worker or scheduler that cannot import what it is sent as one breaks.
        async def ask() -> dict[str, Any]:
            out = dict(await self._client.run(software, workers=workers, on_error="return"))
            try:
                return {"scheduler": await self._client.run_on_scheduler(software), **out}
            except Exception as error:
                return {"scheduler": error, **out}

        try:
            found = asyncio.run_coroutine_threadsafe(ask(), self._loop).result(FREE_S)
        except Exception as error:
            raise InputError(self._gone(error)) from None
        who = {name: name if name == "scheduler" else f"worker {name}" for name in found}
        wrong = {name: other_versions(versions) for name, versions in found.items()}
        return {n: f"pool dask:{self._address}: the {who[n]} {why}" for n, why in wrong.items() if why is not None}

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
        """Why the run cannot go on, None while it can. A worker that has gone is named once."""
        try:
            there = await asyncio.wait_for(self._client.nthreads(), _ANSWER_S)
        except Exception as error:
            return self._gone(error)
        gone = [w for w in self._workers if w not in there]
        for worker in set(gone) - self._missing:
            log.warning("pool dask:%s: the worker %s was lost, stopped from outside or for lack of memory; "
                        "the others do its work", self._address, worker)  # fmt: skip
        self._missing = set(gone)
        if len(gone) < len(self._workers):
            return None
        return (
            f"pool dask:{self._address}: the worker {gone[-1]} was lost, stopped from outside or for lack of memory, "
            f"and no other is left: start it again, or fewer workers on a machine; {GOES_ON}"
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


def _name(function: Callable[..., Any]) -> str:
    """What a function of items does, in a word."""
    while isinstance(function, partial):
        function = function.func
    return getattr(function, "__name__", type(function).__name__).strip("_").removesuffix("_item")


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
