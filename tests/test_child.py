"""The child process runner: results, messages, errors, aborts, and no orphans."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import types
from multiprocessing import spawn
from pathlib import Path

import pytest

from tiegraph.child import _main_kept_out, run_in_child
from tiegraph.errors import InputError, ProcessLost, ReconstructionError, TiegraphError

pytestmark = pytest.mark.slow


def add_loudly(a, b, send):
    send(a)
    send(b)
    sys.stdout.write("adding\n")
    sys.stdout.flush()
    return a + b


def abort(send):
    os.write(2, b"E20260101 reason of the abort\n*** SIGABRT received; stack trace: ***\n    @ 0x7f01 frame\n")
    os.abort()


def raise_input_error(send):
    raise InputError("mask a.png is missing")


def raise_something(send):
    raise KeyError("no such key")


def exit_quietly(send):
    os._exit(3)


def sleep_long(pid_file, send):
    Path(pid_file).write_text(str(os.getpid()))
    send("up")
    time.sleep(60)


def kill_itself(send):
    os.kill(os.getpid(), signal.SIGKILL)


def sleep_deaf(pid_file, send):
    """Neither Python's threads nor SIGTERM reach it."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    Path(pid_file).write_text(str(os.getpid()))
    send("up")
    ctypes.PyDLL(None).sleep(60)  # holds the interpreter's lock


def test_a_child_ended_from_outside_is_told_from_one_whose_library_gave_up(tmp_path):
    with pytest.raises(ProcessLost, match="mapping: its process was ended from outside .signal SIGKILL.*memory"):
        run_in_child(kill_itself, log=tmp_path / "log.txt", task="mapping")


def test_ctrl_c_ends_a_child_that_hears_nothing(tmp_path):
    pid_file = tmp_path / "pid"

    def stop(message):
        raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_in_child(sleep_deaf, str(pid_file), log=tmp_path / "log.txt", on_message=stop)
    assert _gone(int(pid_file.read_text())) and time.monotonic() - began < 30


def test_result_messages_and_log_come_back(tmp_path):
    messages = []
    log = tmp_path / "logs" / "log.txt"
    assert run_in_child(add_loudly, 2, 3, log=log, on_message=messages.append) == 5
    assert messages == [2, 3]
    assert "adding" in log.read_text()


def in_child(log, result):
    result.send(run_in_child(add_loudly, 2, 3, log=log))


def test_a_daemonic_process_may_run_a_child(tmp_path):
    """Dask's workers are daemonic."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=in_child, args=(tmp_path / "log.txt", sender), daemon=True)
    process.start()
    sender.close()
    assert receiver.recv() == 5
    process.join(20)


def test_abort_becomes_an_error_with_signal_and_log_tail_without_the_stack_trace(tmp_path):
    with pytest.raises(ReconstructionError) as error:
        run_in_child(abort, log=tmp_path / "log.txt", task="match")
    text = str(error.value)
    assert "match" in text and "SIGABRT" in text and "reason of the abort" in text
    assert "0x7f01" not in text


def test_quiet_exit_names_its_code(tmp_path):
    with pytest.raises(ReconstructionError, match="exit code 3"):
        run_in_child(exit_quietly, log=tmp_path / "log.txt")


def test_own_errors_keep_their_type_and_foreign_ones_are_named(tmp_path):
    with pytest.raises(InputError, match="a.png"):
        run_in_child(raise_input_error, log=tmp_path / "log.txt")
    with pytest.raises(TiegraphError, match="KeyError.*no such key"):
        run_in_child(raise_something, log=tmp_path / "log.txt")


def test_error_in_the_message_handler_ends_the_child(tmp_path):
    pid_file = tmp_path / "pid"

    def refuse(message):
        raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        run_in_child(sleep_long, str(pid_file), log=tmp_path / "log.txt", on_message=refuse)
    assert _gone(int(pid_file.read_text()))


@pytest.mark.parametrize("work", ["sleep_long", "sleep_deaf"])
def test_child_dies_with_its_parent(tmp_path, work):
    pid_file = tmp_path / "pid"
    script = tmp_path / "parent.py"
    script.write_text(
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from pathlib import Path\n"
        f"from test_child import run_in_child, {work}\n"
        "if __name__ == '__main__':\n"
        f"    run_in_child({work}, {str(pid_file)!r}, log=Path({str(tmp_path / 'log.txt')!r}),\n"
        "                 on_message=lambda m: print(m, flush=True))\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline().strip() == "up"
        parent.kill()
    assert _gone(int(pid_file.read_text()))


def _gone(pid: int) -> bool:
    for _ in range(100):
        try:
            # A killed child of a killed parent may stay as a zombie until its reaper looks.
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                return True
            os.kill(pid, 0)
        except (OSError, FileNotFoundError):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize(("text", "kept"), [("x.run()\n", False), ("if __name__ == '__main__':\n    x.run()\n", True)])
def test_a_script_that_would_run_itself_again_is_kept_out_of_helpers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, kept: bool
) -> None:
    script = tmp_path / "script.py"
    script.write_text(text)
    main = types.ModuleType("__main__")
    main.__file__ = str(script)
    monkeypatch.setitem(sys.modules, "__main__", main)
    with _main_kept_out():
        assert ("init_main_from_path" in spawn.get_preparation_data("helper")) == kept
    assert main.__file__ == str(script) and main.__spec__ is None
