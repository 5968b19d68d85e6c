"""The simulation of surveys of many images: the stages without pixels."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from benchmarks.scale import stages


@pytest.mark.slow
def test_every_stage_runs_without_pixels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    start = subprocess.run

    def run(command: list[str], **how: Any) -> subprocess.CompletedProcess:
        """The last stage in a process of its own, as all are for their memory; the others here, where all is loaded."""
        if stages.__name__ not in command or "plan" in command:
            return start(command, **how)
        return subprocess.CompletedProcess(command, stages.main(command[3:]))

    monkeypatch.setattr(subprocess, "run", run)
    assert stages.main(["--images", "48", "--folder", str(tmp_path), "-o", str(tmp_path / "found.json")]) == 0
    rows = {row["stage"]: row for row in json.loads((tmp_path / "found.json").read_text())["runs"]}
    assert list(rows) == list(stages.STAGES) and rows["scan"]["counts"]["images"] == 48
    assert rows["coarse"]["counts"]["images"] == 48 and rows["candidates"]["apart"]["previews"]["calls"] > 500
    assert 0 < rows["plan"]["counts"]["pairs"] == rows["design"]["counts"]["pairs"]
    assert rows["plan"]["judged"]["precision"] > 0.5
    assert "| coarse |" in capsys.readouterr().out
