"""Where work runs. The seam is the standard library's ``concurrent.futures.Executor``: engines never see it."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from tiegraph.child import die_with_parent
from tiegraph.errors import EngineMissing, SettingsError, TiegraphError

_TASKS_PER_WORKER = 8  # enough to balance the load, few enough that a task takes about a second


class SerialExecutor(Executor):
    """Runs each call at once in this process: for debugging, tests and tiny jobs."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Run now; the future is done when it is returned."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)
        return future


def open_pool(spec: str, workers: int | None = None) -> tuple[Executor, int]:
    """(executor, number of workers) of ``serial``, ``local``, ``local:<n>`` or ``dask:<address>``.

    Raises SettingsError for another name, EngineMissing when Dask is asked for and not installed.
    """
    name, _, argument = spec.partition(":")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if name == "serial":
        return SerialExecutor(), 1
    if name == "local":
        count = workers or _count(argument, spec) or cores
        context = multiprocessing.get_context("spawn")
        threads = max(1, cores // count)
        return ProcessPoolExecutor(count, mp_context=context, initializer=_start_worker, initargs=(threads,)), count
    if name == "dask":
        return _dask(argument)
    raise SettingsError(f"unknown pool {spec!r}: give serial, local, local:<workers> or dask:<address>")


def _count(argument: str, spec: str) -> int | None:
    if not argument:
        return None
    if argument.isdigit() and int(argument) > 0:
        return int(argument)
    raise SettingsError(f"pool {spec!r}: the number of workers must be a positive whole number")


def _dask(address: str) -> tuple[Executor, int]:
    try:
        from distributed import Client
    except ImportError:
        raise EngineMissing("the dask pool needs Dask: pip install 'tiegraph[dask]'") from None
    client = Client(address or None)
    executor = client.get_executor(pure=False)
    executor.client_kept_alive = client
    return executor, max(1, sum(client.nthreads().values()))


def _start_worker(threads: int) -> None:
    die_with_parent()
    os.environ["OMP_NUM_THREADS"] = str(threads)
    import cv2

    cv2.setNumThreads(threads)


def map_items(
    executor: Executor,
    workers: int,
    function: Callable[..., Any],
    items: Sequence[Any],
    args: tuple = (),
    on_done: Callable[[int], None] | None = None,
) -> list[Any]:
    """``[function(item, *args) for item in items]`` in chunks over the executor, results in the order of the items.

    ``function`` must be at module level. The first error of an item is raised once the running chunks have ended; what
    other items wrote stays.
    """
    size = max(1, -(-len(items) // (workers * _TASKS_PER_WORKER)))
    chunks = [items[k : k + size] for k in range(0, len(items), size)]
    futures = {executor.submit(_run_chunk, function, chunk, args): k for k, chunk in enumerate(chunks)}
    results: list[list[Any]] = [[] for _ in chunks]
    try:
        for future in as_completed(futures):
            k = futures[future]
            results[k] = future.result()
            if on_done is not None:
                on_done(len(chunks[k]))
    except BrokenProcessPool:
        raise TiegraphError(
            "a worker process was ended from outside, most likely for lack of memory: "
            "run again with --pool serial or fewer workers (--pool local:1); finished work is kept"
        ) from None
    finally:
        for future in futures:
            future.cancel()
    return [r for chunk in results for r in chunk]


def _run_chunk(function: Callable[..., Any], chunk: Sequence[Any], args: tuple) -> list[Any]:
    return [function(item, *args) for item in chunk]
