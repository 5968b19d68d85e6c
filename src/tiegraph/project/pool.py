"""Where work runs. The interface is the standard library's ``concurrent.futures.Executor``: engines never see it."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from tiegraph.child import Helpers, cores, from_outside, how_ended
from tiegraph.errors import InputError, ProcessLost, SettingsError, optional
from tiegraph.forking import keep_memory
from tiegraph.project.progress import Elsewhere

_LOOK_S = 2.0  # between two checks whether the workers live
_MOST_PER_CORE, _MOST = 4, 64  # workers: more is a typing error; on a small machine this many are allowed


class SerialExecutor(Executor):
    """Runs each call at once in this process: for debugging, tests and tiny jobs."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """Run now; the future is done when it is returned."""
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # Ctrl-C ends the call itself
            future.set_exception(error)
        return future


class LocalPool(ProcessPoolExecutor):
    """Processes of this machine that only this process stops."""

    def __init__(self, workers: int, threads: int) -> None:
        self.helpers = Helpers()
        super().__init__(workers, mp_context=self.helpers, initializer=_begin, initargs=(threads,))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        """As the base class. Raises BrokenProcessPool too where a worker is lost while the next one starts."""
        try:
            return super().submit(fn, *args, **kwargs)
        except OSError as error:  # the executor's thread has closed the queue for the new worker
            if self._broken:
                raise BrokenProcessPool(f"a worker was lost while another started: {error}") from error
            raise

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As the base class. A worker that is killed meanwhile may have held the lock of the queue, which is never
        released then: the others, which would wait for it forever, are ended too."""
        manager: Any = self._executor_manager_thread  # typeshed has another type
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        while wait and manager is not None and manager.is_alive():
            manager.join(_LOOK_S)
            if manager.is_alive() and self.helpers.lost():
                self.helpers.end()

    def end(self) -> None:
        """End the workers at once, in the middle of their tasks."""
        self.helpers.end()
        # After a partial result the executor's thread waits for the rest while any process could write: ours can.
        results = self._result_queue
        if results is not None:
            results._writer.close()  # type: ignore[attr-defined]


def check_pool(spec: str) -> tuple[str, str]:
    """(name, argument) of ``serial``, ``local``, ``local:<n>``, ``dask:<address>``, ``slurm:<jobs>``; starts nothing.

    Raises SettingsError for another name, an invalid number, or far more workers than the machine has cores.
    """
    name, colon, argument = spec.partition(":")
    if name not in ("serial", "local", "dask", "slurm"):
        raise SettingsError(
            f"unknown pool {spec!r}: give serial, local, local:<workers>, dask:<address> or slurm:<jobs>"
        )
    if name == "serial" and colon:
        raise SettingsError(f"pool {spec!r}: serial takes no number; give serial, or local:<workers>")
    if (name == "local" and argument) or name == "slurm":
        if not (argument.isascii() and argument.isdigit() and argument.strip("0")):
            what = "jobs" if name == "slurm" else "workers"
            raise SettingsError(f"pool {spec!r}: the number of {what} must be a positive whole number")
    if name == "local" and argument:
        most = max(_MOST, _MOST_PER_CORE * cores())
        if len(argument) > 9 or int(argument) > most:
            raise SettingsError(f"pool {spec!r}: this machine has {cores()} cores; give local, or at most local:{most}")
    return name, argument


@dataclass(frozen=True)
class Place:
    """Folders that workers on other machines must reach, the counter of their resource use, and who hears of waits."""

    folder: Path  # they write here
    reads: tuple[Path, ...] = ()  # and read these
    elsewhere: Elsewhere | None = None
    say: Callable[[str], None] | None = None


def open_pool(spec: str, place: Place | None = None) -> tuple[Executor, int]:
    """(executor, number of workers) of a pool as ``check_pool`` takes it.

    Raises SettingsError as ``check_pool``; of Dask: EngineMissing when it is not installed, InputError when the cluster
    does not answer, has no workers, or one without the same versions or folders (``place``); and as ``open_slurm``.
    """
    name, argument = check_pool(spec)
    if name == "serial":
        return SerialExecutor(), 1
    if name == "local":
        count = int(argument or cores())
        return LocalPool(count, threads=max(1, cores() // count)), count
    if name == "slurm":
        return open_slurm(int(argument), place)
    from tiegraph.project.daskpool import open_dask

    return open_dask(argument, place)


def _begin(threads: int) -> None:
    limit_threads(threads)
    keep_memory()


def limit_threads(threads: int) -> None:
    """Number of threads of the libraries in this process, because several share the machine. OpenMP obeys only if it is
    not loaded yet; linear algebra has one anyway (``tiegraph.blas``)."""
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

    ``function`` must be at module level. The first error of an item is raised once the running chunks have ended;
    results written by other items stay. Raises ProcessLost for a lost worker. Ctrl-C ends them at once.
    """
    # Common data of all chunks may be large; an executor over a network sends it once (``share``).
    call = getattr(executor, "share", lambda data: data)((function, args))
    # Enough to balance the load, few enough that a task takes about a second
    size = max(1, -(-len(items) // (workers * 8)))
    chunks = [items[k : k + size] for k in range(0, len(items), size)]
    futures: dict[Future, int] = {}
    results: list[list[Any]] = [[] for _ in chunks]
    try:
        for k, chunk in enumerate(chunks):
            futures[executor.submit(_run_chunk, call, chunk)] = k
        for future in _finished(executor, futures):
            k = futures[future]
            results[k] = future.result()
            if on_done is not None:
                on_done(len(chunks[k]))
    except BrokenProcessPool as error:
        why = _why_lost(executor, error)
        if isinstance(executor, LocalPool):
            executor.end()  # a worker that was starting meanwhile gets no notice, and the executor would wait for it
        raise ProcessLost(why) from None
    except BaseException as error:
        if isinstance(executor, LocalPool) and not isinstance(error, Exception):  # Ctrl-C
            executor.end()
            raise
        for future in futures:
            future.cancel()
        raise
    return [r for chunk in results for r in chunk]


def _finished(executor: Executor, futures: dict[Future, int]) -> Iterator[Future]:
    """The futures as they end. Raises BrokenProcessPool for workers that were lost unnoticed.

    The executor itself waits forever for a worker that was ended while it sent its result.
    """
    waiting, seen = set(futures), False
    while waiting:
        done, waiting = wait(waiting, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
        yield from done
        lost = not done and isinstance(executor, LocalPool) and executor.helpers.lost()
        if lost and seen:
            assert isinstance(executor, LocalPool)
            executor.end()
            raise BrokenProcessPool("a worker has gone")
        seen = bool(lost)


def _why_lost(executor: Executor, error: BrokenProcessPool) -> str:
    codes: list[int] = []
    for _ in range(20):  # the executor's own thread may be about to notice it
        codes = executor.helpers.lost() if isinstance(executor, LocalPool) else []
        if codes:
            break
        time.sleep(0.1)
    else:
        return (
            f"the worker processes can no longer be used ({error}); finished work is kept, run the same command again"
        )
    how = " and ".join(sorted({how_ended(code) for code in codes}))
    if any(from_outside(code) for code in codes):
        return (
            f"a worker process was ended from outside ({how}): if not by you, most likely by the system for lack of "
            "memory; run again with --pool serial or fewer workers (--pool local:1); finished work is kept"
        )
    return (
        f"a worker process ended by itself ({how}), most likely a fault in a native library: run the same command "
        "again, finished work is kept; --pool serial shows which item causes it"
    )


def _run_chunk(call: tuple[Callable[..., Any], tuple], chunk: Sequence[Any]) -> list[Any]:
    function, args = call
    return [function(item, *args) for item in chunk]


def open_slurm(jobs: int, place: Place | None) -> tuple[Executor, int]:
    """(executor, number of workers at first) of a scheduler in this process, once a job has begun, which may take the
    queue hours. SLURM starts the workers as jobs, by dask-jobqueue, whose own file ``~/.config/dask/jobqueue.yaml``
    describes a job (cores, memory, queue, walltime).

    Raises EngineMissing without dask-jobqueue, SettingsError if its file does not say what a job is, InputError if
    `sbatch` takes none, and as ``open_dask``.
    """
    from tiegraph.project.daskpool import Quiet, open_dask

    stopping = signal.getsignal(signal.SIGINT)
    jobqueue, config = optional("dask_jobqueue", "slurm", "the pool slurm"), import_module("dask").config
    signal.signal(signal.SIGINT, stopping)  # dask-jobqueue's own handler would end the run without a word
    try:
        # A worker makes one item at a time: as many as there are cores
        cluster = jobqueue.SLURMCluster(processes=config.get("jobqueue.slurm.cores", None) or 1)
    except ValueError as error:
        raise SettingsError(
            f"pool slurm: {error} Say so in ~/.config/dask/jobqueue.yaml, below jobqueue, slurm: cores, memory, "
            "queue, walltime"
        ) from None

    async def submit() -> None:
        cluster.scale(jobs=jobs)
        await cluster

    quiet = Quiet()
    try:
        cluster.sync(submit)
        if place is not None and place.say is not None:
            what = "1 job" if jobs == 1 else f"{jobs} jobs"
            place.say(f"pool slurm: {what} submitted; the run begins when the queue starts the first (squeue shows it)")
        while not cluster.scheduler_info["workers"]:
            time.sleep(1.0)  # between two looks whether the queue has started a job
    except BaseException as error:
        with suppress(AssertionError):  # that every job was begun
            cluster.close()
        if isinstance(error, (OSError, RuntimeError)):
            said = " ".join(str(error).split())
            raise InputError(f"pool slurm: no job could be submitted, is sbatch here? ({said})") from None
        raise
    finally:
        quiet.end()
    try:
        return open_dask(cluster.scheduler_address, place, cluster.close)
    except BaseException:
        cluster.close()
        raise
