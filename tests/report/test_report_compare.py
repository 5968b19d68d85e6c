"""Runs side by side: the papers' tables."""

import json
from pathlib import Path

import numpy as np
import pytest
from fake_survey_run import make_run

from said import refused
from tiegraph.report.compare import compare_runs, compared, ratio


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    base = tmp_path_factory.mktemp("runs")
    return [make_run(base / "conventional", seed=2), make_run(base / "meguro2024")]


def test_the_papers_tables(runs: list[Path], tmp_path: Path) -> None:
    text = compare_runs(runs, tmp_path / "deep" / "compare.html")
    times = ("Mask image creation", "Matching list creation", "Feature matching", "MVS", "Total time")
    figures = ("Registered images", "Dense points", "Candidates", "Verified", "Back-projection RMSE", "ATE after SE3")
    for name in (*times, *figures, "conventional", "1.6 x", "round trip"):
        assert name in text, name
    page = (tmp_path / "deep" / "compare.html").read_text()
    assert "meguro2024" in page and "Total time" in page and "https://" not in page


def test_sums_are_of_the_right_stages(runs: list[Path]) -> None:
    wall = {name: values for name, values in compared(runs).blocks[0].rows}
    parts = ("Mask image creation", "SfM, all of it", "MVS (dense and cloud)", "Scan, evaluation, report")
    total = np.sum([wall[p] for p in parts], axis=0)
    assert np.allclose(total, wall["Total time"])
    sfm = ("Matching search", "Matching list creation", "Feature extraction", "Feature matching")
    inside = np.sum([wall[p] for p in (*sfm, "Reconstruction and georeferencing")], axis=0)
    assert np.allclose(inside, wall["SfM, all of it"])
    assert wall["Total time"][0] > wall["Total time"][1]


def test_unequal_runs_are_called_so(runs: list[Path], tmp_path: Path) -> None:
    stopped = make_run(tmp_path / "stopped", "design")
    scene = (stopped / "scene.json").read_text().replace("up/cam0/000000.jpg", "up/cam0/000000x.jpg")
    (stopped / "scene.json").write_text(scene)
    three = compared([*runs, stopped])
    assert "The runs are on different images." in three.notes
    points = {n: v for b in three.blocks for n, v in b.rows}["Dense points"]
    assert points[0] == 40_000 and np.isnan(points[2])
    assert "–" in compare_runs([*runs, stopped])


def test_lengths_of_a_model_without_scale_are_not_called_metres(runs: list[Path], tmp_path: Path) -> None:
    free = make_run(tmp_path / "free")
    world = json.loads((free / "world.json").read_text())
    bare = {"placed": False, "scale_from": "none", "crs": None, "origin": None}
    (free / "world.json").write_text(json.dumps(world | bare))

    def label(*folders: Path) -> str:
        return next(n for b in compared(folders).blocks for n, _ in b.rows if n.startswith("Back-projection"))

    assert label(*runs).endswith(", m")
    assert label(free, free).endswith("units of the models")
    assert "units" in label(runs[0], free) and "m, or" in label(runs[0], free)


def test_names_are_told_apart_and_printed_letter_by_letter(tmp_path: Path) -> None:
    folders = [make_run(tmp_path / a / "out", "scan") for a in ("a", "b")]
    assert compared(folders).names == ("a/out", "b/out")
    names = ("day [red]", "b:smile:")  # what colours text elsewhere
    text = compare_runs([make_run(tmp_path / name, "scan") for name in names])
    assert all(name in text for name in names)


def test_misuse_and_pages_of_others(runs: list[Path], tmp_path: Path) -> None:
    page = tmp_path / "compare.html"
    for _ in range(2):  # its own page is overwritten
        compare_runs(runs, page)
    page.write_text("<html>notes of mine</html>")
    (tmp_path / "file").write_text("x")
    for folders, target, words in (
        (runs[:1], None, "at least two"),
        ([runs[0], tmp_path / "none"], None, "no such run folder"),
        (runs, tmp_path / "file" / "x.html", "cannot write"),
        (runs, page, "compare.html exists"),
    ):
        with refused(words):
            compare_runs(folders, target)
    assert page.read_text() == "<html>notes of mine</html>"


def test_ratio() -> None:
    assert ratio((30.0, 10.0)) == "3.0 x" and ratio((1.0, 0.0)) == "–" and ratio((1.0, 2.0, 3.0)) == ""
