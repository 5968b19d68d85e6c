"""The studies of many runs: what is varied, kept and printed, a found rig on the other half, surveys without pixels."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from benchmarks.scale import stages
from benchmarks.variants import Book, Variant, median, spread

from benchmarks import ablate, sweep
from tiegraph.project.settings import Tunings, merged
from tiegraph.targets.tuning import Tuning as TargetsTuning


def test_every_number_of_the_constants_is_found_by_its_place():
    found = dict(sweep.numbers(Tunings()))
    assert found["targets.looked_at"] == 60 and found["network.coarse.course.margin"] == 2.0
    assert not any("ladder" in place for place in found)  # a table of numbers
    assert len(found) > 400


@pytest.mark.parametrize(
    "place, value, factor, new",
    [
        ("targets.looked_at", 60, 4 / 3, 80),
        ("network.coarse.near_steps", 1, 4 / 3, 2),  # rounding would leave it as it is
        ("network.coarse.course.margin", 2.0, 2 / 3, 4 / 3),
        ("network.coarse.course.margin", 1.2, 2 / 3, None),  # not below 1: the Tuning refuses it
        ("targets.refine_share", 0.9, 4 / 3, None),  # no share above 1
    ],
)
def test_a_constant_is_moved_by_a_third_and_stays_what_it_is(place, value, factor, new):
    variant = sweep.varied(place, value, factor)
    if new is None:
        assert variant is None
        return
    settings = merged(variant.settings).tuning
    for name in place.split("."):
        settings = getattr(settings, name)
    assert settings == pytest.approx(new) and type(settings) is type(new)


def test_a_group_moves_what_its_tuning_lets_move_together():
    asked = [(p, v) for p, v in sweep.numbers(Tunings()) if p.startswith(("network.counts.", "targets.looked"))]
    groups = {v.name: merged(v.settings).tuning for v in sweep.grouped(asked, 2 / 3)}
    assert len(groups) == 2
    (name, counts), (_, own) = sorted(groups.items(), key=lambda g: "counts" not in g[0])
    default = Tunings()
    now = dict(sweep.numbers(counts.network.counts))
    moved = [n for n, v in sweep.numbers(default.network.counts) if now[n] != v]
    assert len(moved) == int(name.split()[1]) >= 4 and counts.targets == default.targets
    assert own.targets.looked_at == 40 and own.network == default.network


def test_every_subsystem_that_is_switched_off_is_a_valid_setting():
    names = [v.name for v in ablate.VARIANTS]
    assert len(set(names)) == len(names)
    for variant in ablate.VARIANTS:
        assert merged(variant.settings) != merged({}), f"{variant.name} changes nothing"
    assert merged({"tuning": {"targets": {"looked_at": 60}}}).tuning.targets == TargetsTuning()


def row(registered, ate, cpu=10.0):
    return {"status": "done", "registered": registered, "ate_m": ate, "cpu_s": cpu, "predicted_over_actual": 1.0}


def test_rows_are_kept_and_the_tables_say_what_a_part_buys(tmp_path):
    book = Book(tmp_path / "rows.json")
    for repeat, ate in enumerate((0.010, 0.012, 0.011)):
        book.add("boat", ablate.BASE, repeat, row(32, ate))
    book.add("boat", ablate.VARIANTS[0], 0, row(30, 0.022, 5.0))
    book.add("boat", ablate.VARIANTS[1], 0, {"status": "no pair verified"})
    again = Book(tmp_path / "rows.json")
    assert again.has("boat", "base", 2) and not again.has("boat", "base", 3)
    base = again.of("boat", "base")
    assert median(base, "ate_m") == 0.011 and spread(base, "ate_m") == pytest.approx(0.002)
    said = ablate.table(again, ["boat"])
    assert "| rig check off | 30 | 22.0 mm (+100 %) | 5 s (-50 %) | 1.00 |" in said and "no pair verified" in said
    kept = Book(tmp_path / "sweep.json")
    kept.add("boat", sweep.BASE, 0, row(32, 0.010))
    for name, ate in (("filter.min_agree 12 -> 16", 0.011), ("filter.as_good 0.65 -> 0.87", 0.030)):
        kept.add("boat", Variant(name), 0, row(32, ate))
    lines = sweep.table(kept, ["boat"], most=1).splitlines()
    assert lines[2:] == ["| `filter.as_good 0.65 -> 0.87` | boat: 32 images, ATE +200 % |"]


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
