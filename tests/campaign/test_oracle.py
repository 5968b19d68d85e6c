"""The judge of the campaigns: every verdict is reached by a fake command, and none by chance."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

from campaign import case as case_module
from campaign import compare, mutate, oracle, process
from campaign.case import Case, finish_again
from campaign.process import Ended, Server
from campaign.world import World, fingerprint

# A tiegraph whose command line is a few lines of Python.
_FAKE = """
import os, signal, subprocess, sys, time, types

def main(argv):
    try:
        types.FunctionType(compile(argv[0], 'fake', 'exec'), globals())()  # exec would note the interrupt
        return 0
    except KeyboardInterrupt:
        sys.stderr.write("tiegraph: stopped; finished work is kept\\n")
        return 1

def fail(text, code=2):
    sys.stderr.write(text + "\\n")
    sys.stderr.flush()
    sys.exit(code)

def say(text):
    sys.stderr.write(text + "\\n")
    sys.stderr.flush()
"""
_CLEAN = "     scan      0.1 s     244 MiB  12 found\n           . rig file rig.toml: 2 sensor(s)\n"
_WORDS = ("gnss.csv", "position")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory):
    source = tmp_path_factory.mktemp("fake")
    (source / "tiegraph" / "cli").mkdir(parents=True)
    for name in ("tiegraph/__init__.py", "tiegraph/cli/__init__.py"):
        (source / name).write_text("")
    (source / "tiegraph" / "forking.py").write_text("def allow():\n    pass\n")
    (source / "tiegraph" / "cli" / "main.py").write_text(_FAKE)
    (source / "tiegraph" / "cli" / "run.py").write_text("def preparsed(words):\n    pass\n")
    made = Server(source)
    yield made
    made.close()


@pytest.fixture
def run(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(process, "_LEFT_S", 0.3)
    monkeypatch.setattr(process, "_STALL_S", 0.3)
    return lambda script, limit_s=20.0, **limits: server.run([script], tmp_path / "fake", limit_s, **limits)


REFUSALS = {
    "fail('tiegraph: gnss.csv, line 3: nan is no latitude')": oracle.CLEAR,
    "say('     scan 0.1 s'); fail('tiegraph: stage dense: 3 positions are wrong', 1)": oracle.CLEAR,
    "fail('tiegraph: something is wrong')": oracle.UNCLEAR,
    "fail('tiegraph: the composition is wrong')": oracle.UNCLEAR,  # not the word "position"
    "fail('')": oracle.UNCLEAR,
    "fail('tiegraph: gnss.csv\\ntiegraph: position')": oracle.UNCLEAR,
    "fail('tiegraph: gnss.csv is wrong', 3)": oracle.UNCLEAR,
    "fail('tiegraph: gnss.csv \\x07 is wrong')": oracle.UNCLEAR,
    "fail('tiegraph: unexpected KeyError: gnss.csv')": oracle.UNEXPECTED,
    "raise ValueError('gnss.csv')": oracle.UNEXPECTED,
    "os.abort()": oracle.CRASH,
    "os.kill(os.getpid(), signal.SIGSEGV)": oracle.CRASH,
    "fail('tiegraph: gnss.csv: the native library ended its process (signal SIGABRT)', 1)": oracle.CRASH,
    "subprocess.Popen(['sleep', '60']); fail('tiegraph: gnss.csv is wrong')": oracle.LEFTOVER,
    "time.sleep(60)": oracle.HANG,
}


@pytest.mark.slow
@pytest.mark.parametrize("script, verdict", REFUSALS.items(), ids=range(len(REFUSALS)))
def test_refusals(run, script: str, verdict: str) -> None:
    assert oracle.refusal(run(script, 1.0 if verdict == oracle.HANG else 20.0), _WORDS).name == verdict


PASSES = [
    ("say('           . gnss.csv, line 3 was left out')", ["the poses differ"], oracle.SAID),
    ("say('           . rig file rig.toml: 3 sensor(s)')", ["the poses differ"], oracle.SILENT),  # the clean run's note
    ("say('     scan      0.1 s   2 MiB  11 positions')", ["the poses differ"], oracle.SILENT),  # a count is no note
    ("say('           . the rig is odd')", ["the poses differ"], oracle.SILENT),  # names something else
    ("pass", ["the poses differ"], oracle.SILENT),
    ("pass", [], oracle.HARMLESS),
    ("say('Traceback (most recent call last):')", [], oracle.UNEXPECTED),
    ("say('terminate called without an active exception')", [], oracle.CRASH),
    ("subprocess.Popen(['sleep', '60'], start_new_session=False)", [], oracle.LEFTOVER),
]


@pytest.mark.parametrize("script, different, verdict", PASSES, ids=range(len(PASSES)))
def test_passes(run, script: str, different: list[str], verdict: str) -> None:
    ended = run(script)
    assert ended.code == 0
    assert oracle.passed(ended, _CLEAN, _WORDS, different).name == verdict


SIGNALS = [
    ("time.sleep(60)", signal.SIGINT, oracle.CLEAR),
    ("time.sleep(60)", signal.SIGTERM, oracle.CLEAR),
    ("time.sleep(60)", signal.SIGKILL, oracle.CLEAR),
    ("time.sleep(60)", signal.SIGABRT, oracle.CRASH),
    ("signal.signal(signal.SIGINT, signal.SIG_IGN); time.sleep(60)", signal.SIGINT, oracle.HANG),
    ("subprocess.Popen(['sleep', '60']); time.sleep(60)", signal.SIGKILL, oracle.LEFTOVER),
    ("try:\n  time.sleep(60)\nexcept KeyboardInterrupt:\n  raise ValueError", signal.SIGINT, oracle.UNEXPECTED),
    ("try:\n  time.sleep(60)\nexcept KeyboardInterrupt:\n  fail('', 1)", signal.SIGINT, oracle.UNCLEAR),
]


@pytest.mark.slow
@pytest.mark.parametrize("script, number, verdict", SIGNALS, ids=range(len(SIGNALS)))
def test_signals(server: Server, tmp_path: Path, monkeypatch, script: str, number: int, verdict: str) -> None:
    monkeypatch.setattr(process, "_LEFT_S", 0.3)
    monkeypatch.setattr(process, "_STALL_S", 0.3)
    running = server.start([f"say('up')\n{script}"], tmp_path / "fake")
    end = time.monotonic() + 20
    while "up" not in running.log.read_text():
        assert time.monotonic() < end, running.log.read_text()
        time.sleep(0.01)
    time.sleep(0.05)
    process.os.kill(running.pid, number)
    assert oracle.after_signal(running.wait(2.0), number, main=True).name == verdict


@pytest.fixture
def case(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Case:
    """A case over a survey of one image, whose results are equal if the file "result" says so."""
    (tmp_path / "inputs").mkdir()
    (tmp_path / "inputs" / "a.jpg").write_bytes(b"picture")
    clean = {"report": tmp_path / "clean"}
    (tmp_path / "clean").mkdir()
    (tmp_path / "clean" / "result").touch()
    world = World(tmp_path, tmp_path / "inputs", clean, {}, fingerprint(tmp_path / "inputs"))
    monkeypatch.setattr(case_module, "differences", lambda a, b, own: [] if (b / "result").exists() else ["all"])
    made = Case("fake", 1, 0, world, server, tmp_path / "case")
    (made.folder / "out").mkdir()
    (made.folder / "out" / "notes.txt").write_bytes(b"mine")
    return made


ENDINGS = {
    "open('out/result', 'w')": None,
    "pass": oracle.SILENT,
    "open('out/result', 'w'); os.remove('out/notes.txt')": oracle.LOSS,
    "open('out/result', 'w'); open('out/notes.txt', 'a').write('x')": oracle.LOSS,
    "open('out/result', 'w'); os.remove('../inputs/a.jpg')": oracle.LOSS,
    "fail('tiegraph: the database is locked')": oracle.STUCK,
    "fail('tiegraph: unexpected BadZipFile: no zip file')": oracle.UNEXPECTED,
    # Refusing a folder that holds a file of the user is right, if it is named and the next try goes on without it.
    "if os.path.exists('out/notes.txt'): fail('tiegraph: notes.txt is not ours')\nopen('out/result', 'w')": None,
    "if os.path.exists('out/notes.txt'): fail('tiegraph: a file is not ours')\nopen('out/result', 'w')": oracle.STUCK,
}


@pytest.mark.parametrize("script, verdict", ENDINGS.items(), ids=range(len(ENDINGS)))
def test_the_same_command_again(case: Case, script: str, verdict: str | None) -> None:
    found, _ = finish_again(case, [script], case.folder / "out", {"notes.txt": b"mine"})
    assert (found.name if found else None) == verdict


def test_a_limit_to_the_size_of_files_is_one(run) -> None:
    ended = run("open('big', 'wb').write(bytes(100000))", file_bytes=1000)
    assert "File too large" in ended.text and ended.code == 1


def test_summaries_differ_by_images_places_length_and_points() -> None:
    places = {f"{k}.jpg": np.array([1.0 * k, 0, 0]) for k in range(4)}
    clean = {"centres": places, "span": 3.0, "points": 1000}
    assert not compare.outcome_differences(clean, clean, 1e-4, 0.02)
    fewer = {**clean, "centres": {n: p for n, p in places.items() if n != "0.jpg"}}
    assert "3 images" in compare.outcome_differences(clean, fewer, 1e-4, 0.02)[0]
    assert not compare.outcome_differences(clean, fewer, 1e-4, 0.02, without=("0.jpg",))
    moved = {**clean, "centres": {n: p + 0.001 for n, p in places.items()}}
    assert "poses" in compare.outcome_differences(clean, moved, 1e-4, 0.02)[0]
    assert not compare.outcome_differences(clean, moved, 1e-2, 0.02)
    lost = {**clean, "centres": {n: p * np.nan for n, p in places.items()}}
    assert compare.outcome_differences(clean, lost, 1e-2, 0.02)
    assert "long" in compare.outcome_differences(clean, {**clean, "span": 3.7}, 0.1, 0.02)[0]
    assert "points" in compare.outcome_differences(clean, {**clean, "points": 970}, 1e-4, 0.02)[0]


@pytest.mark.slow
def test_every_rule_changes_the_file_or_says_that_it_does_not_fit(tmp_path: Path) -> None:
    import random

    text = "time,lat,lon\n1.0,35.5,139.5\n2.0,35.6,139.6\n3.0,35.7,139.7\n"
    for rule in {*mutate.BYTES, *mutate.TABLES, *mutate.STRUCTURED, *mutate.PLACES, mutate.renamed}:
        changed = 0
        for seed in range(6):
            path = tmp_path / f"{rule.__name__}-{seed}" / "gnss.csv"
            path.parent.mkdir()
            path.write_text(text)
            before = fingerprint(path.parent)
            try:
                assert rule(path, random.Random(seed))
            except mutate.Unfit:
                continue
            changed += fingerprint(path.parent) != before
        assert changed >= 3 or rule is mutate.unreadable or rule is mutate.structure, rule.__name__


@pytest.mark.slow
def test_what_was_said_needs_a_word_of_its_own() -> None:
    ended = Ended(0, None, "           . position 3 is far off\n           . 5 compositions", False)
    assert oracle.said(ended.text, "", ("position",)) == [". position 3 is far off"]
    assert oracle.said("  ! a contradicts b by 3 m", "  ! a contradicts b by 4 m", ("c",)) == []
    assert oracle.said("  ! a contradicts b by 3 m", "", ("c",)) == ["! a contradicts b by 3 m"]
