"""Helpers forked from a server: as those that are spawned, and nothing of the command line's but what it has loaded."""

import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tiegraph import forking
from tiegraph.child import run_in_child, start_server
from tiegraph.errors import ProcessLost, ReconstructionError
from tiegraph.project.pool import map_items, open_pool

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="helpers are spawned elsewhere")
KNOWN_AFTERWARDS = []  # what this process has in memory, and a spawned helper has not


def about(send):
    """What a helper is and has."""
    send("at work")
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    sys.stdout.write("said to the log")
    sys.stdout.flush()
    return {
        "parent": os.getppid(),
        "known": KNOWN_AFTERWARDS,
        "files": sorted(_files("self") - {"/dev/null"}),
        "handlers": len(logging.getLogger("tiegraph").handlers),
        "deaf": {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} <= blocked,
        "term": signal.getsignal(signal.SIGTERM) == signal.SIG_DFL,
    }


def burn(send):
    began = time.process_time()
    while time.process_time() - began < 0.5:
        pass


def end_server(send):
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60)


def abort(send):
    os.abort()


def wait_long(send):
    send(os.getpid())
    time.sleep(60)


def square(value, number):
    return value * value + number, os.getppid()


def _files(process):
    found = set()
    for name in os.listdir(f"/proc/{process}/fd"):
        try:
            found.add(os.readlink(f"/proc/{process}/fd/{name}"))
        except OSError:
            pass
    return found


def program(folder: Path) -> None:
    """A command line: files, a log, handlers; then a server, helpers, a pool, and how all of it ends."""
    log = folder / "log.txt"
    logging.getLogger("tiegraph").addHandler(logging.FileHandler(folder / "other.txt"))
    signal.signal(signal.SIGTERM, lambda number, frame: None)
    told: dict = {"before": start_server()}
    KNOWN_AFTERWARDS.append(7)
    forking.prepare(lambda: KNOWN_AFTERWARDS.append(8))
    forking.allow()
    with open(folder / "mine.txt", "w") as mine:
        mine.write("not flushed yet")
        told["started"], told["again"] = start_server(), start_server()
        messages: list = []
        told["server"], told["helper"] = forking.server_pid(), run_in_child(about, log=log, on_message=messages.append)
        told["messages"], told["log"] = messages, log.read_text()
        told["server_files"] = sorted(_files(forking.server_pid()) - {"/dev/null"})
        for name, work in (("aborted", abort), ("lost", end_server)):
            try:
                run_in_child(work, log=log)
            except (ReconstructionError, ProcessLost) as error:
                told[name] = str(error)
        told["gone"] = not forking.running()
    told["mine"] = (folder / "mine.txt").read_text()
    told["anew"] = start_server()
    executor, workers = open_pool("local:2")
    with executor:
        told["squares"] = map_items(executor, workers, square, list(range(6)), (1,))
    told["second_server"], before = forking.server_pid(), sum(os.times()[2:4])
    run_in_child(burn, log=log)
    forking.stop()
    told["counted_s"] = sum(os.times()[2:4]) - before
    told["spawned"] = run_in_child(about, log=log)["known"]
    sys.stdout.write(json.dumps(told))


def left_alone(folder: Path) -> None:
    """A command line that is ended while a helper works."""
    forking.allow()
    start_server()

    def say(pid: int) -> None:
        sys.stdout.write(f"{forking.server_pid()} {pid}\n")
        sys.stdout.flush()

    run_in_child(wait_long, log=folder / "log.txt", on_message=say)


SCRIPT = (
    "import sys; sys.path.insert(0, {here!r}); import test_forking; test_forking.{name}(test_forking.Path({folder!r}))"
)


def command(name, folder):
    script = folder / "program.py"
    text = SCRIPT.format(here=str(Path(__file__).parent), name=name, folder=str(folder))
    script.write_text(text.replace("; ", "\n", 2).replace("; ", "\nif __name__ == '__main__':\n    ", 1))
    return [sys.executable, str(script)]


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    done = subprocess.run(command("program", tmp_path_factory.mktemp("forking")), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_a_server_is_started_once_where_it_is_allowed(told):
    assert (told["before"], told["started"], told["again"], told["anew"]) == (False, True, False, True)


@pytest.mark.slow
def test_helpers_are_forked_with_what_was_loaded_and_send_and_print_as_others(told):
    assert told["helper"]["parent"] == told["server"]
    assert told["helper"]["known"] == [7, 8]
    assert told["messages"] == ["at work"] and "said to the log" in told["log"]
    assert told["spawned"] == []  # without a server: a new interpreter


@pytest.mark.slow
def test_nothing_else_of_the_command_line_is_left_in_server_and_helper(told):
    for files in (told["server_files"], told["helper"]["files"]):
        assert files and not any(name.endswith(("mine.txt", "other.txt")) for name in files)
    assert told["mine"] == "not flushed yet"  # once
    assert told["helper"]["handlers"] == 0 and told["helper"]["deaf"] and told["helper"]["term"]


@pytest.mark.slow
def test_how_a_helper_ends_is_told(told):
    assert "SIGABRT" in told["aborted"]
    assert "ended from outside (signal SIGKILL)" in told["lost"] and told["gone"]


@pytest.mark.slow
def test_workers_are_forked_too_and_their_time_counts(told):
    assert told["squares"] == [[k * k + 1, told["second_server"]] for k in range(6)]
    assert 0.5 <= told["counted_s"] < 5


@pytest.mark.slow
def test_server_and_helper_end_with_the_command_line(tmp_path):
    with subprocess.Popen(command("left_alone", tmp_path), stdout=subprocess.PIPE, text=True) as process:
        pids = [int(word) for word in process.stdout.readline().split()]
        process.kill()
    end = time.monotonic() + 20
    while any(_runs(pid) for pid in pids):
        assert time.monotonic() < end, "processes are left"
        time.sleep(0.05)
    assert len(pids) == 2


def test_a_process_with_threads_is_not_forked():
    thread = threading.Thread(target=time.sleep, args=(1,), daemon=True)
    thread.start()
    assert not forking._alone()
    thread.join()


def _runs(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize(("lacking", "forks"), [("", True), ("no_such_name", False)])
def test_a_python_that_lacks_what_is_taken_from_inside_it_spawns(lacking, forks):
    inside = f"forking._INSIDE = ((forking.util, {lacking!r}),)" if lacking else ""
    code = f"from tiegraph import forking\nforking.allow()\n{inside}\nprint(forking.start())\nforking.stop()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(forks)]
