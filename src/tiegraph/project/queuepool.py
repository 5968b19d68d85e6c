"""Workers that SLURM starts as jobs, by dask-jobqueue: what a job is (cores, memory, queue, walltime) stands in its own
file, ``~/.config/dask/jobqueue.yaml``.
"""

import signal
import time
from concurrent.futures import Executor
from contextlib import suppress
from importlib import import_module

from tiegraph.errors import InputError, SettingsError, optional
from tiegraph.project.daskpool import Quiet, open_dask
from tiegraph.project.pool import Place


def open_slurm(jobs: int, place: Place | None) -> tuple[Executor, int]:
    """(executor, number of workers at first) of a scheduler in this process, once a job has begun, which may take the
    queue hours. Raises EngineMissing without dask-jobqueue, SettingsError if its file does not say what a job is,
    InputError if `sbatch` takes none, and as ``open_dask``."""
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
