"""The pool: workers that are lost, at work or idle, and what may be asked for."""

import contextlib
import gc
import os
import signal
import struct
import sys
import threading
import time
from multiprocessing.queues import SimpleQueue

import pytest

from tiegraph.child import Helper
from tiegraph.errors import ProcessLost, SettingsError
from tiegraph.project import pool
from tiegraph.project.pool import SerialExecutor, check_pool, map_items, open_pool

pytestmark = pytest.mark.timeout(240)


def pid_of(item):
    return os.getpid()


def die(item, number):
    if item == 3:
        os.kill(os.getpid(), number)
    return item


def interrupt(item, done):
    done.append(item)
    if item == 1:
        raise KeyboardInterrupt


@pytest.mark.slow
@pytest.mark.parametrize("number, said", [(signal.SIGKILL, "outside.*memory"), (signal.SIGABRT, "fault in a native")])
def test_a_worker_lost_at_work_is_named_by_its_signal(number, said):
    executor, workers = open_pool("local:2")
    with executor, pytest.raises(ProcessLost, match=said) as error:
        map_items(executor, workers, die, list(range(8)), (number,))
    assert signal.Signals(number).name in str(error.value) and "finished work is kept" in str(error.value)


@pytest.mark.slow
def test_a_worker_lost_while_idle_is_named_too():
    executor, workers = open_pool("local:1")
    with executor:
        (worker,) = map_items(executor, workers, pid_of, [0])
        os.kill(worker, signal.SIGKILL)
        time.sleep(1)
        with pytest.raises(ProcessLost, match="SIGKILL"):
            map_items(executor, workers, pid_of, [0])


closes_its_queue = pytest.mark.skipif(
    sys.version_info < (3, 11, 5), reason="the executor of older Pythons does not close its queue while a worker starts"
)


@pytest.mark.slow
@closes_its_queue
def test_a_worker_lost_while_the_next_one_starts_is_named_too(monkeypatch):
    executor, workers = open_pool("local:2")
    spawn = executor._spawn_process

    def late():
        if executor._processes:  # the second starts when the executor's thread has closed what it would be given
            while not executor._call_queue._reader.closed:
                time.sleep(0.01)
        spawn()

    monkeypatch.setattr(executor, "_spawn_process", late)
    with executor, pytest.raises(ProcessLost, match="SIGKILL"):
        map_items(executor, workers, die, [3, 4, 5, 6], (signal.SIGKILL,))


@closes_its_queue
def test_a_worker_that_starts_while_another_is_lost_is_not_waited_for(monkeypatch):
    executor, workers = open_pool("local:2")
    start = Helper.start

    def slowly(process):
        start(process)
        first = executor.helpers.made[0]
        if process is not first:
            with contextlib.suppress(ProcessLookupError):  # it has died of its own item
                os.kill(first.pid, signal.SIGKILL)
            while not executor._call_queue._closed:  # the executor's thread has told all it knows of to end
                time.sleep(0.01)

    monkeypatch.setattr(Helper, "start", slowly)
    with pytest.raises(ProcessLost, match="SIGKILL"):
        map_items(executor, workers, die, [3, 4, 5, 6], (signal.SIGKILL,))
    left = threading.Thread(target=executor.shutdown, kwargs={"cancel_futures": True}, daemon=True)
    left.start()
    left.join(20)
    hung = left.is_alive()
    executor.helpers.end()
    assert not hung


@pytest.mark.slow
def test_workers_do_not_hear_what_a_terminal_sends_to_all():
    executor, workers = open_pool("local:1")
    with executor:
        (worker,) = map_items(executor, workers, pid_of, [0])
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(worker, number)
        assert map_items(executor, workers, pid_of, [0]) == [worker]


def test_ctrl_c_in_the_serial_pool_stops_at_the_item():
    done: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        map_items(SerialExecutor(), 1, interrupt, [0, 1, *range(2, 50)], (done,))
    assert len(done) < 20


def test_as_many_workers_as_a_machine_bears(monkeypatch):
    monkeypatch.setattr(pool, "cores", lambda: 40)
    assert check_pool("local:160") == ("local", "160")
    with pytest.raises(SettingsError, match="40 cores; give local, or at most local:160"):
        check_pool("local:161")


def cut_short(item: int) -> int:
    """Begins to send a result, and is ended."""
    queue = next(o for o in gc.get_objects() if isinstance(o, SimpleQueue))
    os.write(queue._writer.fileno(), struct.pack("!i", 100_000) + b"half")
    os.kill(os.getpid(), signal.SIGKILL)
    return item


@pytest.mark.slow
def test_a_worker_ended_while_it_sends_a_result_is_reported_and_the_pool_can_be_left():
    executor, workers = open_pool("local:2")
    with pytest.raises(ProcessLost, match="SIGKILL"):
        map_items(executor, workers, cut_short, [1])
    left = threading.Thread(target=executor.shutdown, kwargs={"cancel_futures": True}, daemon=True)
    left.start()
    left.join(20)
    assert not left.is_alive()


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0, 1])
def test_a_worker_killed_while_the_pool_ends_keeps_nobody_waiting(lost):
    """One of two idle workers holds the lock of the queue: the other would wait for it for ever."""
    local = pool.LocalPool(2, 1)
    for done in [local.submit(time.sleep, 0.3) for _ in range(2)]:
        done.result()
    time.sleep(0.3)
    workers = list(local._processes)
    for worker in workers:
        os.kill(worker, signal.SIGSTOP)
    ending = threading.Thread(target=local.shutdown, daemon=True)
    ending.start()
    time.sleep(0.5)
    os.kill(workers[lost], signal.SIGKILL)
    os.kill(workers[1 - lost], signal.SIGCONT)
    ending.join(20)
    assert not ending.is_alive()
