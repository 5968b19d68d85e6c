"""Pictures of clouds by distance, section and agreement; runs side by side: the papers' tables."""

import json
from pathlib import Path

import numpy as np
import pytest
from fake_survey_run import make_run

from accuracy_marks import check, unmarked
from said import refused
from tiegraph.geometry.geodesy import Origin
from tiegraph.report import cloudview, drawing
from tiegraph.report.cloudview import (
    compass,
    distance_scales,
    render,
    section_scale,
    standard_views,
    with_scale_bar,
)
from tiegraph.report.compare import compare_runs, compared, ratio
from tiegraph.report.html import write_report
from tiegraph.report.parts import PASSES
from tiegraph.report.runfolder import RunFolder, read_run
from tiegraph.report.settings import ReportSettings
from tiegraph.scene.cloudchunks import Measured, write_measured

RED, BLUE = [200, 30, 30], [30, 30, 200]


def plate(z: float, half: float, colour: list[int], points: int = 60_000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(int(z * 10))
    xyz = np.column_stack([rng.uniform(-half, half, (points, 2)), np.full(points, z)])
    return xyz, np.tile(np.array(colour, np.uint8), (points, 1))


def test_the_upper_plate_hides_the_lower() -> None:
    (low, low_rgb), (high, high_rgb) = plate(0, 10, RED), plate(2, 4, BLUE)
    for order in (1, -1):
        parts = [(low, low_rgb), (high, high_rgb)][::order]
        picture, scale = render(np.vstack([p for p, _ in parts]), np.vstack([c for _, c in parts]), 0, 90, 300)
        middle, corner = picture[picture.shape[0] // 2, 120], picture[30, 30]
        assert middle[2] > 150 > middle[0] and corner[0] > 150 > corner[2]
        assert 11 < scale < 12


def test_north_is_up_and_east_right() -> None:
    rng = np.random.default_rng(0)
    xyz = np.column_stack([rng.uniform(0, 10, 20_000), rng.uniform(0, 10, 20_000), np.zeros(20_000)])
    rgb = np.where((xyz[:, :1] > 7) & (xyz[:, 1:2] > 7), RED, BLUE).astype(np.uint8)
    picture, _ = render(xyz, rgb, 0, 90, 300)
    red = (picture[..., 0] > 120) & (picture[..., 2] < 80)
    rows, columns = np.nonzero(red)
    assert columns.mean() > 0.7 * picture.shape[1] and rows.mean() < 0.35 * picture.shape[0]


def test_edges_are_darker_than_surfaces() -> None:
    (low, low_rgb), (high, high_rgb) = plate(0, 10, RED), plate(2, 4, RED)
    picture, _ = render(np.vstack([low, high]), np.vstack([low_rgb, high_rgb]), 0, 90, 300)
    row = picture[picture.shape[0] // 2, :, 0].astype(int)
    assert row[25:55].mean() > 180 and row[20:220].min() < 150


def test_three_views_of_a_cloud_without_colour() -> None:
    xyz, _ = plate(1, 10, RED, 5000)
    xyz[0] = 1e6  # a stray point must not shrink the rest
    views = standard_views(xyz, np.zeros((len(xyz), 3), np.uint8), xyz[:5], 400)
    assert [name.split()[0] for name, _, _ in views] == ["Top", "Oblique", "Oblique"]
    assert all(scale > 10 and picture.std() > 1 for _, picture, scale in views)
    assert standard_views(xyz[:0], xyz[:0].astype(np.uint8), xyz[:0], 400) == []


def test_helpers() -> None:
    assert compass(0) == "the east" and compass(-90) == "the south" and compass(450) == "the north"
    diagonal = cloudview.main_axis_deg(np.array([[0, 0, 0], [5.0, 5, 0], [9, 9, 1]]))
    assert abs(diagonal % 180 - 45) < 1e-6
    colours = drawing.by_height(np.linspace(0, 5, 100))
    assert colours.shape == (100, 3) and not np.array_equal(colours[0], colours[-1])
    bar = with_scale_bar(np.full((200, 400, 3), 247, np.uint8), 10.0, "m")
    assert (bar != 247).any() and bar.shape == (200, 400, 3)


COLUMNS = ["section", "core points", "median m", "spread m"]
SECTIONS = "sections: open 1 (5 frames), bridge 1 (5 frames)"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with two passes compared and a reference cloud, its sections named."""
    made = make_run(tmp_path_factory.mktemp("run") / "quay")
    metrics = json.loads((made / "metrics.json").read_text())
    rows = [["all", 900, 0.001, 0.021], ["0", 500, 0.002, 0.017], ["1", 400, -0.001, 0.033]]
    metrics["tables"][PASSES] = {"columns": COLUMNS, "rows": rows}
    (made / "metrics.json").write_text(json.dumps(metrics))
    receipt = json.loads((made / "receipts" / "network.json").read_text())
    (made / "receipts" / "network.json").write_text(json.dumps({**receipt, "notes": [SECTIONS]}))
    origin = Origin.from_dict(json.loads((made / "world.json").read_text())["origin"])
    xyz = np.stack(np.meshgrid(np.arange(0, 10, 0.1), [9.0], np.arange(0, 5, 0.1)), -1).reshape(-1, 3)
    for name in ("evaluate/distances.laz", "passes/differences.laz"):
        (made / name).parent.mkdir(exist_ok=True)
        write_measured([Measured(xyz, {"distance_m": xyz[:, 0] - 5}, (-1, 1))], made / name, origin, 0.1)
    return made


@pytest.fixture(scope="module")
def run(folder: Path) -> RunFolder:
    return read_run(folder, 1000)


@pytest.mark.slow
def test_a_point_has_the_distance_of_what_was_measured_next_to_it(run: RunFolder) -> None:
    xyz = np.array([[2.02, 9.01, 3.0], [7.5, 9.0, 1.0], [7.5, 8.0, 1.0], [-5, 9, 3.0]])
    found = distance_scales(run, xyz)
    assert [(name, s.signed) for name, s in found.items()] == [
        ("distance to the reference cloud", False),
        ("one pass against the other", True),
    ]
    for scale in found.values():
        assert np.allclose(scale.values, [-3, 2.5, np.nan, np.nan], atol=0.06, equal_nan=True)


@pytest.mark.slow
def test_a_point_lies_in_the_section_of_the_nearest_camera(run: RunFolder) -> None:
    (scale,) = section_scale(run, np.array([[2.0, -3, 2], [15.0, -3, 2]])).values()
    assert [scale.names[int(k)] for k in scale.values] == ["open\N{NO-BREAK SPACE}1", "bridge\N{NO-BREAK SPACE}1"]


@pytest.mark.slow
def test_what_cannot_be_read_is_left_out(folder: Path, tmp_path: Path, caplog) -> None:
    empty = make_run(tmp_path / "run", until="georef")
    (empty / "passes").mkdir()
    (empty / "passes" / "differences.laz").write_bytes(b"no cloud")
    assert distance_scales(read_run(empty, 100), np.zeros((1, 3))) == {}
    assert "differences.laz cannot be read and is left out" in caplog.text


@pytest.mark.slow
def test_the_page_says_how_well_the_passes_agree(folder: Path) -> None:
    page = write_report(folder, ReportSettings(viewer_points=500)).read_text(encoding="utf-8")
    sure = page[page.index('<h2 id="sure">') : page.index('<h2 id="found">')]
    assert "One pass against the other" in sure and "were not compared" not in sure
    assert "<td>bridge\N{NO-BREAK SPACE}1</td>" in sure and f'"tables.{PASSES}.2.3">0.03' in sure
    assert page.count(f"tables.{PASSES}.0.2") == 1, "once, and not among the references"
    assert unmarked(page) == [] and f"tables.{PASSES}.0.3" in check(folder, page)
    data = json.loads(page[page.index('id="viewer-data">') + 17 :].partition("</script>")[0])
    assert [s["name"] for s in data["scales"]][2:] == [
        "distance to the reference cloud", "one pass against the other", "section",
    ]  # fmt: skip
    signed = data["scales"][3]
    assert signed["signed"] and signed["low"] == -signed["high"] and signed["unknown"]


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
