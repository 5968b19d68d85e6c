"""The pool of Dask: items on its workers, what they use, and everything that can be wrong with a cluster."""

import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

import dask_world
from said import refused
from tiegraph.errors import SettingsError, TiegraphError
from tiegraph.project import daskpool
from tiegraph.project.pool import Place, map_items, open_pool
from tiegraph.project.progress import Elsewhere, Meter

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="without Dask"),
]


def local_cluster(workers, threads=1, **more):
    import distributed  # half a second, and every process of the suite imports this file

    return distributed.LocalCluster(workers, threads_per_worker=threads, dashboard_address="127.0.0.1:0", **more)


@pytest.fixture(scope="module")
def cluster():
    with local_cluster(2, processes=True) as made:
        yield made


@pytest.fixture(scope="module")
def one_worker():
    """Of three threads."""
    with local_cluster(1, threads=3, processes=True) as made:
        yield made


@pytest.fixture
def pool(cluster):
    executor, workers = open_pool(f"dask:{cluster.scheduler_address}")
    yield lambda function, items, *args: map_items(executor, workers, function, items, args)
    executor.shutdown(cancel_futures=True)


@pytest.fixture
def commands(server, tmp_path_factory):
    return dask_world.Commands(server, tmp_path_factory.mktemp("dask"))


def on_workers(cluster, function, *args):
    import distributed

    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        return client.run(function, *args)


def test_items_run_on_all_workers_and_come_back_in_order(cluster, capfd):
    executor, workers = open_pool(f"dask:{cluster.scheduler_address}")
    found = map_items(executor, workers, dask_world.where, range(40), (0.5,))
    executor.shutdown(cancel_futures=True)
    assert workers == 2
    assert [value for value, _ in found] == [k / 2 for k in range(40)]
    assert len({pid for _, pid in found} - {os.getpid()}) == 2
    assert capfd.readouterr() == ("", "")


def test_child_processes_run_in_a_worker_whose_threads_the_libraries_have(pool, tmp_path):
    assert pool(dask_world.in_child, [1, 2], tmp_path / "log.txt") == [2, 3]
    assert pool(dask_world.threads, [1, 2]) == [(1, "1"), (1, "1")]


def test_large_arguments_go_once_and_without_a_warning(pool, recwarn):
    data = np.arange(2_000_000.0)
    assert pool(dask_world.total, [0, 1, 2], data) == [data.sum() + k for k in range(3)]
    big = [np.full(1_000_000, float(k)) for k in range(4)]
    assert [value.sum() for value, _ in pool(dask_world.where, big)] == [k * 1e6 for k in range(4)]
    assert not list(recwarn)


def test_error_of_an_item_keeps_its_type_and_relative_paths_hold(pool, tmp_path, monkeypatch):
    with pytest.raises(KeyError, match="three"):
        pool(dask_world.refuse, range(6))
    (tmp_path / "beside.txt").write_text("found")
    monkeypatch.chdir(tmp_path)
    assert pool(dask_world.relative, [1]) == ["found"]


def test_a_file_changed_between_two_runs_is_read_again(cluster, tmp_path):
    path = tmp_path / "scene.json"
    for text in ("old", "new"):
        (tmp_path / "written").write_text(text)
        os.replace(tmp_path / "written", path)
        executor, workers = open_pool(f"dask:{cluster.scheduler_address}")
        assert set(map_items(executor, workers, dask_world.read_kept, range(8), (path,))) == {text}
        executor.shutdown()


@pytest.mark.parametrize("below", [True, False], ids=["below this process", "elsewhere"])
def test_use_of_the_workers_is_counted_once(cluster, tmp_path, monkeypatch, below):
    if not below:
        monkeypatch.setattr(psutil.Process, "children", lambda self, recursive=False: [])
    elsewhere = Elsewhere()
    executor, workers = open_pool(f"dask:{cluster.scheduler_address}", place=Place(tmp_path, (), elsewhere))
    meter = Meter(elsewhere=elsewhere)
    map_items(executor, workers, dask_world.burn, range(4), (0.5,))
    used = meter.stop()
    executor.shutdown()
    assert 2.0 <= used["cpu_s"] < 3.9
    assert used["peak_mib"] > 400


def test_only_one_item_at_a_time_in_a_worker_of_many_threads(one_worker):
    executor, workers = open_pool(f"dask:{one_worker.scheduler_address}")
    spans = sorted(map_items(executor, workers, dask_world.span, range(6), (0.1,)))
    threads = map_items(executor, workers, dask_world.threads, [0])
    executor.shutdown()
    assert workers == 1
    assert all(end <= start for (_, end), (start, _) in zip(spans, spans[1:]))
    assert threads == [(3, "3")]


@pytest.mark.parametrize("answers", [True, False], ids=["silent", "refused"])
def test_an_address_that_does_not_answer_is_named_soon(answers, capfd, monkeypatch):
    assert daskpool._CONNECT_S <= 10
    monkeypatch.setattr(daskpool, "_CONNECT_S", 2.0)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        if answers:
            listener.listen()
        start = time.monotonic()
        with refused(address):
            open_pool(f"dask:{address}")
        assert time.monotonic() - start < 6
    assert capfd.readouterr() == ("", "")


def test_a_client_that_comes_too_late_is_closed_by_its_own_thread(cluster, monkeypatch):
    """The collector would close it in any thread: if in one that starts the next client's loop, Dask stood still."""
    import distributed

    made, may_end = [], threading.Event()

    class Late(distributed.Client):
        def __init__(self, *args, **more):
            super().__init__(*args, **more)
            made.append(self)
            may_end.wait(60)

    monkeypatch.setattr(distributed, "Client", Late)
    monkeypatch.setattr(daskpool, "_CONNECT_S", 3.0)
    with refused("silent"):
        open_pool(f"dask:{cluster.scheduler_address}")
    assert made[0].status == "running"
    may_end.set()
    next(t for t in threading.enumerate() if t.name == "dask-connect").join(30)
    assert made[0].status == "closed"


def test_what_is_no_address_is_named():
    for spec in ("dask", "dask:"):
        with pytest.raises(SettingsError, match="address"):
            open_pool(spec)
    for spec in ("dask:nonsense", "dask:tcp://127.0.0.1", "dask:ftp://a:1"):
        with refused(spec):
            open_pool(spec)


def test_a_scheduler_without_workers_is_said(commands, monkeypatch):
    monkeypatch.setattr(daskpool, "_CONNECT_S", 60.0)  # on a busy machine
    monkeypatch.setattr(daskpool, "_WORKERS_S", 1.0)
    with commands.cluster(0) as (address, _):
        with refused("no workers"):
            open_pool(f"dask:{address}")


def set_version(number):
    from tiegraph.project import stages as receipts

    receipts.__version__ = number


def test_a_worker_with_another_version_is_named(cluster):
    import tiegraph

    on_workers(cluster, set_version, "0.0.1")
    try:
        with refused(r"worker tcp://.* has tiegraph 0\.0\.1, this process"):
            open_pool(f"dask:{cluster.scheduler_address}")
    finally:
        on_workers(cluster, set_version, tiegraph.__version__)


def test_only_the_series_of_python_must_be_the_same(monkeypatch):
    here = {"tiegraph": "1", "python": "3.11.7", "numpy": "2.0.1"}
    monkeypatch.setattr(daskpool, "software", lambda: here)
    assert daskpool.other_versions({**here, "python": "3.11.9"}) is None
    assert "has python 3.12.7" in daskpool.other_versions({**here, "python": "3.12.7"})
    assert "has numpy 2.0.2" in daskpool.other_versions({**here, "numpy": "2.0.2"})


def hide_tiegraph(hidden):
    import sys

    for module in ("tiegraph.project.daskworker", "tiegraph.project.stages"):
        if hidden:
            sys.modules[module] = None
        else:
            del sys.modules[module]


def test_a_worker_without_tiegraph_is_named(cluster):
    on_workers(cluster, hide_tiegraph, True)
    try:
        with refused(r"worker tcp://.* cannot run tiegraph .*install tiegraph"):
            open_pool(f"dask:{cluster.scheduler_address}")
    finally:
        on_workers(cluster, hide_tiegraph, False)


def test_a_worker_that_does_not_see_the_folders_is_named(cluster, tmp_path, monkeypatch):
    spec = f"dask:{cluster.scheduler_address}"
    with refused(r"worker tcp://.* cannot read .*photographs.*shared"):
        open_pool(spec, place=Place(tmp_path, (tmp_path / "photographs",)))
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(Path, "mkdir", lambda self, **more: None)  # what is made here is not there
    with refused(rf"worker tcp://.* cannot write into {tmp_path}"):
        open_pool(spec, place=Place(tmp_path))


def client_script(folder: Path, address: str, work: str) -> list[str]:
    script = folder / "client.py"
    script.write_text(
        "import sys, pathlib\n"
        f"sys.path[:0] = {[str(Path(dask_world.__file__).parent)]!r}\n"
        "import dask_world\n"
        "from tiegraph.project.pool import map_items, open_pool\n"
        f"executor, workers = open_pool('dask:{address}')\n"
        f"map_items(executor, workers, dask_world.leave_file, range(400), (pathlib.Path({work!r}), 0.2))\n"
    )
    return [sys.executable, str(script)]


def test_workers_stop_when_the_run_is_killed(cluster, tmp_path):
    work = tmp_path / "work"
    work.mkdir()
    client = subprocess.Popen(client_script(tmp_path, cluster.scheduler_address, str(work)))
    end = time.monotonic() + 60
    while not list(work.iterdir()) and time.monotonic() < end:
        time.sleep(0.05)
    client.send_signal(signal.SIGKILL)
    client.wait()
    executor, _ = open_pool(f"dask:{cluster.scheduler_address}")  # returns when what was under way has ended
    count = len(list(work.iterdir()))
    time.sleep(1.5)
    executor.shutdown()
    assert 0 < count == len(list(work.iterdir())) < 40  # a chunk has 25


def test_a_lost_worker_costs_its_chunk_and_one_that_comes_later_takes_part(commands, tmp_path, caplog):
    with commands.cluster(2) as (address, (_, first, _)):
        executor, workers = open_pool(f"dask:{address}")
        lost = threading.Timer(2.0, first.kill)
        lost.start()
        made = map_items(executor, workers, dask_world.write_down, range(32), (tmp_path, 0.25))
        assert [number for number, _ in made] == list(range(32))
        lines = [path.read_text().splitlines() for path in sorted(tmp_path.iterdir(), key=lambda p: int(p.name))]
        chunk = 2
        assert 1 <= sum(len(writers) - 1 for writers in lines) <= chunk, "made twice: what the lost one was at"
        assert "was lost" in caplog.text and caplog.text.count("the others do its work") == 1
        before = {pid for _, pid in made} - {first.pid}
        with commands.worker(address):
            more = map_items(executor, workers, dask_world.write_down, range(100, 132), (tmp_path, 0.1))
        assert len(before) == 1 and before < {pid for _, pid in more}, "and the new one"
        executor.shutdown()


@pytest.mark.parametrize("lost", ["worker", "scheduler"])
def test_the_loss_of_the_last_worker_or_of_the_scheduler_ends_the_run(lost, commands, capfd):
    with commands.cluster(1) as (address, (scheduler, worker)):
        executor, workers = open_pool(f"dask:{address}")
        futures = [executor.submit(dask_world.span, k, 60.0) for k in range(4)]
        time.sleep(0.5)
        (worker if lost == "worker" else scheduler).kill()
        start = time.monotonic()
        with pytest.raises(TiegraphError, match=rf"pool dask:{address}: the .*{lost}.* was lost"):
            futures[-1].result(timeout=40)
        assert time.monotonic() - start < 20
        daskpool._END_S, before = 1.0, daskpool._END_S
        executor.shutdown(cancel_futures=True)
        daskpool._END_S = before
        worker.kill()  # busy with an item of a minute
    assert "Traceback" not in capfd.readouterr().err


def test_an_item_that_ends_its_worker_is_not_tried_again_and_again(one_worker):
    executor, workers = open_pool(f"dask:{one_worker.scheduler_address}")
    with pytest.raises(TiegraphError, match="worker .* was lost"):
        map_items(executor, workers, dask_world.end_process, [0])
    executor.shutdown(cancel_futures=True)


def test_counts_elsewhere_are_sums_of_cpu_and_of_peaks():
    one = Elsewhere()
    for worker, cpu_s, peak_mib in (("a", 1.0, 50.0), ("a", 2.0, 40.0), ("b", 4.0, 7.0)):
        one.add(worker, {"cpu_s": cpu_s, "peak_mib": peak_mib})
    assert json.dumps(one.take()) == '{"cpu_s": 7.0, "peak_mib": 57.0}'
    assert one.take() == {"cpu_s": 0.0, "peak_mib": 0}
