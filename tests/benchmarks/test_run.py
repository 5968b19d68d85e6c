"""The runner: time limits, what is said of a run that ended badly, and the results file."""

import json
import sys
import time
from pathlib import Path

import pytest

from benchmarks import run


@pytest.mark.slow
def test_time_limit_ends_the_process_and_its_children(tmp_path: Path) -> None:
    marker = tmp_path / "alive"
    child = f"import time, pathlib; time.sleep(2); pathlib.Path({str(marker)!r}).touch()"
    parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    start = time.monotonic()
    row = run._run_process([sys.executable, "-c", parent], tmp_path / "log.txt", 0.7)
    assert row["returncode"] is None and 0.6 < time.monotonic() - start < 1.9
    time.sleep(2.2)
    assert not marker.exists()


@pytest.mark.slow
def test_cpu_time_counts_children(tmp_path: Path) -> None:
    busy = "import time\nt = time.process_time()\nwhile time.process_time() - t < 0.4: pass"
    parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {busy!r}], check=True)"
    row = run._run_process([sys.executable, "-c", parent], tmp_path / "log.txt", 60)
    assert row["returncode"] == 0 and 0.4 <= row["cpu_s"] < 5


@pytest.mark.parametrize(
    ("returncode", "said", "status", "reason"),
    [
        (None, {"running": "match"}, "timeout", "match"),
        (-6, {"running": "sparse"}, "failed", "-6 in stage sparse"),
        (0, {"status": "failed", "reason": "no model"}, "failed", "no model"),
        (0, {}, "failed", ""),
        (0, {"status": "done"}, "done", ""),
    ],
)
def test_outcome_names_the_stage_that_ended_a_run(returncode: int, said: dict, status: str, reason: str) -> None:
    outcome = run._outcome(returncode, said)
    assert outcome["status"] == status and reason in outcome.get("reason", "")


def test_a_run_replaces_its_own_row_and_figures_of_two_machines_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    results = run._load(path, "note")
    key = {"set": "s", "competitor": "c", "repeat": 0, "calibration": "estimated"}
    for cpu_s in (1.23456789, 2.0):
        run._add(results, {**key, "cpu_s": cpu_s}, path)
    run._add(results, {**key, "repeat": 1, "cpu_s": 3.0}, path)
    again = run._load(path, "")
    assert [row["cpu_s"] for row in again["runs"]] == [2.0, 3.0] and again["note"] == "note"
    path.write_text(json.dumps({**again, "machine": {"cpu": "another"}}))
    with pytest.raises(SystemExit, match="another machine"):
        run._load(path, "")


def test_unknown_competitor_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run.main(["--sets", "canal_demo", "--competitors", "colmpa", "-o", "x.json"])
    assert "colmap_exhaustive" in capsys.readouterr().err


def test_results_hold_no_paths_of_the_machine(tmp_path: Path) -> None:
    said = [{"stage": "scan", "notes": [f"camera from {tmp_path}/inputs/rig.toml"], "cpu_s": 1.5}]
    cleaned = run._without_paths(said, tmp_path)
    assert cleaned == [{"stage": "scan", "notes": ["camera from inputs/rig.toml"], "cpu_s": 1.5}]
