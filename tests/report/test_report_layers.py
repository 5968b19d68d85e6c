"""Page one, languages, accuracies, what a report never shows; pictures of clouds; runs side by side."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from fake_survey_run import make_accuracy, make_run, tell
from jinja2 import nodes
from markupsafe import escape

from accuracy_marks import check, unmarked
from said import refused, says
from tiegraph.errors import EngineMissing
from tiegraph.report import accuracy, cloudview, drawing, formatting, html, maps, texts
from tiegraph.report.cloudview import (
    compass,
    render,
    standard_views,
    with_scale_bar,
)
from tiegraph.report.formatting import shown
from tiegraph.report.html import environment, write_report
from tiegraph.report.parts import PASSES, about
from tiegraph.report.runfolder import read_run
from tiegraph.report.settings import ReportSettings
from tiegraph.report.summary import ABSENT, HANGING, LEFT_OUT, REGISTERED, image_rows
from tiegraph.scene.composed import WIDE, carrying
from tiegraph.scene.results import Accuracy, Figure
from tiegraph.scene.scene import Scene

ABOUT = {"client": "Port & <script>alert(1)</script>", "project": "Quay 7", "surveyor": "A. Surveyor"}
JAPANESE = ReportSettings(viewer_points=500, language="ja", title="岸壁", about=ABOUT)
REASON = "no verified pair"


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_run(tmp_path_factory.mktemp("run") / "quay")
    scene = json.loads((folder / "scene.json").read_text())
    missing = [[n, REASON] for n, f in zip(scene["names"], scene["frame"]) if f == 4]
    tell(folder, "sparse", dropped=missing, notes=["read /home/somebody/survey/rig.toml"])
    return folder


@pytest.fixture(scope="module")
def page(full: Path) -> str:
    return write_report(full, ReportSettings(viewer_points=500, about=ABOUT)).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def japanese(full: Path) -> str:
    return write_report(full, JAPANESE).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_measured_figure_stands_beside_the_prediction_of_the_same_thing(page: str) -> None:
    table = page[page.index('<div class="cards layers">') :].split("</table>")[0]
    keys = [re.findall(r'data-accuracy="([\w.]+)\.(?:predicted|measured)"', row) for row in table.split("<tr>")[2:]]
    assert len(keys) >= 4 and all(len(set(row)) == 1 for row in keys if row)
    assert max(len(row) for row in keys) == 2  # one has both


def test_a_headline_does_not_end_in_the_name_of_a_camera() -> None:
    known = "focal length of 1: SONY DSC-H300: the images make it 4118 px, 2366 px are given, one of the two is wrong"
    assert about((known,)) == "focal length of 1: SONY DSC-H300"
    assert about(("height: GNSS and control points differ by 3 m",)) == "height"


@pytest.mark.slow
def test_page_one_says_what_a_client_asks(page: str) -> None:
    one = page[page.index('<div class="client">') : page.index('<div class="engineer">')]
    order = ["Quay 7", "usable with care", 'class="answer no"', "in the world", "in shape", "of a point"]
    order += ["Where and when", "35.69", "Worst problems", "cloud.laz", "Surveyor, signature"]
    places = [one.index(text) for text in order]
    assert places == sorted(places)
    assert one.count('class="chart"') == 1, "the map, with north and scale bar"
    assert ">N</text>" in one and re.search(r">\d+ m</text>", one)
    assert 1 <= len(re.findall(r"<li>", one[one.index('class="problems"') : one.index("</ol>")])) <= 3
    assert "A. Surveyor" in one and "60 images of 20 frames in 2 passes" in one


@pytest.mark.slow
def test_names_are_text_and_folders_are_nobodys(page: str, full: Path) -> None:
    assert "<script>alert" not in page and "&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert page.count("<script") == 2, "the viewer and its data"
    data = (full / "report.json").read_text(encoding="utf-8")
    assert "rig.toml" in page and "somebody" not in page and "somebody" not in data
    assert shown("from /a/b/c.toml, C:\\d\\e.csv and up/cam0/1.jpg at 3 m/s") == (
        "from c.toml, e.csv and up/cam0/1.jpg at 3 m/s"
    )


@pytest.mark.slow
def test_the_contents_lead_to_every_section(page: str) -> None:
    links = re.findall(r'<a href="#(\w+)">([^<]+)</a>', page)
    assert links == re.findall(r'<h2 id="(\w+)">([^<]+)</h2>', page)
    assert {"sure", "images", "model", "cloud", "glossary"} <= {key for key, _ in links}
    for word in ("registered", "lever arm", "M3C2"):
        assert f"<dt>{word}</dt>" in page


@pytest.mark.slow
def test_every_image_has_a_state_and_what_is_not_used_a_reason(full: Path, page: str) -> None:
    rows = image_rows(read_run(full, 1000))
    assert len(rows) == 61 and rows[0].state == LEFT_OUT
    assert all(bool(row.reason) == (row.state != REGISTERED) for row in rows)
    absent = [row for row in rows if row.state == ABSENT]
    assert len(absent) == 6 and sum(row.reason == REASON for row in absent) == 3
    gsd = np.array([row.gsd for row in rows if row.state == REGISTERED])
    assert np.all((gsd > 0.01) & (gsd < 0.2)), "walls 3 to 40 m away, focal length 200 px"
    assert page.count(f"<td>{REASON}</td>") == 3 and "<details" in page


@pytest.mark.slow
def test_images_that_hang_on_a_wide_camera_are_listed_as_such(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", "georef")
    for file in folder.glob("*.npz"):  # its pairs are of the whole survey
        file.unlink()
    ring = Scene.from_json((folder / "scene.json").read_text())
    sensors = tuple(replace(s, role=WIDE if s.name == "cam0" else "side") for s in ring.rigs[0].sensors)
    for sensor in sensors:
        sensor.camera.has_prior_focal_length = True
    whole = ring.with_(rigs=(replace(ring.rigs[0], sensors=sensors),))
    (folder / "whole.json").write_text(whole.to_json())
    (folder / "scene.json").write_text(carrying(whole).to_json())
    for counts, states in (({"hanging": 36}, {HANGING: 36, ABSENT: 4}), ({}, {ABSENT: 40})):
        receipt = {"key": "1", "counts": counts}
        (folder / "receipts/georef.json").write_text(json.dumps(receipt))
        rows = [row for row in image_rows(read_run(folder, 1000)) if "/cam0/" not in row.name]
        assert {s: sum(r.state == s for r in rows if not r.points) for s in states} == states
        reason = "no wide image of its frame" if counts else "nothing tells the scale"
        assert all((reason in row.reason) == (row.state == ABSENT) for row in rows if row.state in (ABSENT, HANGING))


@pytest.mark.slow
def test_the_file_for_programs_is_as_its_schema_says(full: Path, page: str, tmp_path: Path) -> None:
    schema = json.loads(files("tiegraph.report").joinpath("report.schema.json").read_text(encoding="utf-8"))
    validator = jsonschema.Draft202012Validator(schema)
    validator.check_schema(schema)
    data = json.loads((full / "report.json").read_text(encoding="utf-8"))
    validator.validate(data)
    assert data["accuracy"] == json.loads((full / "metrics.json").read_text())["accuracy"]
    assert data["counts"]["registered"] == 49 and data["verdict"]["level"] == "check"
    assert data["about"]["client"] == ABOUT["client"] and abs(data["where"]["middle"]["lat_deg"] - 35.6965) < 0.001
    assert "<data" not in json.dumps(data) and "&lt;" not in json.dumps(data)
    for until in ("scan", "sparse"):
        folder = make_run(tmp_path / until, until)
        write_report(folder, ReportSettings(viewer_points=0))
        validator.validate(json.loads((folder / "report.json").read_text(encoding="utf-8")))
    with pytest.raises(jsonschema.ValidationError):
        validator.validate({**data, "counts": {}})


@pytest.mark.slow
def test_the_japanese_page_has_the_same_figures(japanese: str, page: str, full: Path) -> None:
    assert check(full, japanese) == check(full, page) and unmarked(japanese) == []
    assert (
        '<html lang="ja">' in japanese and "測量報告書" in japanese and "絶対精度" in japanese and "いいえ" in japanese
    )
    one = japanese[japanese.index("<main>") : japanese.index('<div class="engineer">')]
    words = re.sub(r"<[^>]+>|&\w+;|alert|script", " ", one)
    left = set(re.findall(r"[A-Za-z]{4,}", words))
    names = {"Port", "Quay", "Surveyor", "zone", "EPSG", "down", "cloud", "copc", "COPC", "sparse", "world", "COLMAP"}
    names |= {"metrics", "json", "accuracy", "tiegraph", "GNSS", "tolerance"}
    assert left <= names, "page one is Japanese but for names"
    headings = re.findall(r"<h2 id=[^>]*>([^<]+)", japanese)
    assert headings and not any(h.isascii() for h in headings)


@pytest.mark.slow
def test_every_text_of_the_page_is_in_the_table(japanese: str, monkeypatch: pytest.MonkeyPatch, full: Path) -> None:
    known = texts.table("ja")["page"]
    template = environment().loader.get_source(environment(), "template.html.jinja")[0]  # type: ignore[union-attr]
    calls = environment().parse(template).find_all(nodes.Call)
    asked = {c.args[0].value for c in calls if getattr(c.node, "name", "") == "t" and hasattr(c.args[0], "value")}
    assert len(asked) > 60 and asked <= set(known)
    assert {text for row in html._WORDS.items() for text in row} <= set(known)
    for english, form in known.items():
        assert english.count("{}") == len(set(re.findall(r"\{\d?\}", form))) or english.count("{}") == form.count("{}")
    with texts.language("ja"):
        assert texts.said("GNSS positions of 10 of 20 frames and 3 control points").endswith("標定点 3 点")
        assert texts.said("a name that no table holds") == "a name that no table holds"
        assert texts.t("{} usable", "<b>") == "使用可 &lt;b&gt;"
        named = {"columns": ["camera", "reason"], "rows": [["camera", "not verified"], ["all", "scale"]]}
        table = formatting.table(named)
        assert table.rows == (("camera", "幾何検証で不採用"), ("全体", "縮尺")), "a name stays"
    assert texts.t("Glossary") == "Glossary"


@pytest.mark.slow
def test_maps_and_overlap_are_drawn_where_the_data_are(full: Path) -> None:
    seen = maps.scenery(read_run(full, 5000))
    assert seen.north
    place = seen.place
    at = place.at(np.array([[place.low[0], place.high[1]], [place.high[0], place.low[1]]]))
    assert np.allclose(at, [[0, 0], [420, place.height]])
    inside = np.all((seen.xyz[:, :2] >= place.low) & (seen.xyz[:, :2] <= place.high), axis=1)
    assert inside.mean() > 0.9, "the surface that was surveyed is on the map, not only the way"
    far = replace(seen, xyz=seen.xyz + [10_000, 0, 0])
    assert np.ptp([far.place.low[0], far.place.high[0]]) < 4 * np.ptp([place.low[0], place.high[0]])
    assert maps.overlap_map(far) is not None, "an empty one"
    overlap = maps.overlap_map(seen)
    assert overlap is not None and "4–5 images" in overlap
    assert maps.ellipse_map(read_run(full, 5000), seen) is None, "the run says nothing of its placement's covariance"


def test_without_a_browser_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    page, target, browser = (tmp_path / name for name in ("report.html", "report.pdf", "chromium"))
    with pytest.raises(EngineMissing, match="chromium.*open report.html in any browser and print it"):
        html.print_pdf(page, target)
    browser.write_text("#!/bin/sh\nexit 3\n")
    browser.chmod(0o755)
    with pytest.raises(EngineMissing, match=r"did not print report.html \(exit code 3\)"):
        html.print_pdf(page, target)
    target.write_text("my own")
    with refused("is no PDF"):
        html.print_pdf(page, target)
    assert target.read_text() == "my own"


@pytest.mark.slow
def test_the_page_prints(page: str, full: Path, tmp_path: Path) -> None:
    try:
        html.find_browser()
    except EngineMissing:
        pytest.skip("no browser")
    html.print_pdf(full / "report.html", tmp_path / "report.pdf")
    data = (tmp_path / "report.pdf").read_bytes()
    assert data[:4] == b"%PDF" and 20_000 < len(data) < 10e6


@pytest.mark.slow
def test_every_accuracy_on_the_page_is_the_one_of_the_source(full: Path, page: str) -> None:
    keys = check(full, page)
    layers = set(make_accuracy().values())
    assert layers <= keys, "each figure of the source stands on the page"
    assert {"metrics.ate_se3_rmse", "tables.cloud against reference.0.1"} <= keys
    assert unmarked(page) == []
    top = page[page.index('<div class="verdict') : page.index('<div class="tiles">')]
    order = [top.index(text) for text in ("Tolerance of", "In the world:", "In shape", "Of a point")]
    assert order == sorted(order) and order[0] < top.index("are registered")


@pytest.mark.slow
def test_the_check_finds_what_it_is_for(full: Path, page: str) -> None:
    with pytest.raises(AssertionError):
        check(full, page.replace(">2.58 m<", ">2.50 m<"))
    assert unmarked(page.replace("</h1>", "</h1><p>A point has a standard deviation of 3.6 cm.</p>"))
    assert unmarked(page.replace("</main>", "<table><tr><th>rmse m</th></tr><tr><td>0.02</td></tr></table></main>"))


def test_the_terminal_says_what_the_page_says(full: Path) -> None:
    lines = accuracy.terminal_lines(full / "metrics.json")
    assert [line.split()[0] for line in lines] == ["Tolerance", "In", "In", "Of"]
    assert lines[0].startswith("Tolerance of 5.0 cm in the world: no. Reason: 3 check points measured more. Remedy: ")
    assert (
        "predicted 2.58 m for a point of the cloud" in lines[1]
        and "Measured 6.2 cm (a check point) by 3 check points" in lines[1]
    )
    assert "10.0 cm for a camera, over the whole; 4.0 mm for what lies between two cameras 10 m apart" in lines[2]
    assert "Measured 12.1 cm (a camera, over the whole) by 54 reference poses" in lines[2]
    assert "predicted 3.6 cm" in lines[3] and "Nothing independent measured it" in lines[3]
    assert not says(lines, "<")
    assert accuracy.terminal_lines(full / "none.json") == []


def test_what_is_not_known_is_said_to_be_so() -> None:
    said = Accuracy("units", "nothing", (Figure("shape.whole", "a camera", 0.3), Figure("point", "a point")))
    world, shape, point = (str(escape(s).striptags()) for s in accuracy.sentences(said))
    assert "not known" in world and "0.300 units" in shape and "Nothing independent" in shape and "\u2013" in point
    assert accuracy.placement(said) == ""
    held = Accuracy(
        "m", "positions", (Figure("world", "a", 0.1), Figure("world.held_out", "a", measured=0.2, by="4 b"))
    )
    assert "4 b are met within 20.0 cm" in escape(accuracy.sentences(held)[0]).striptags()


RED, BLUE = [200, 30, 30], [30, 30, 200]


def plate(z: float, half: float, colour: list[int], points: int = 60_000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(int(z * 10))
    xyz = np.column_stack([rng.uniform(-half, half, (points, 2)), np.full(points, z)])
    return xyz, np.tile(np.array(colour, np.uint8), (points, 1))


@pytest.mark.slow
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
    """A run with two passes compared, its sections named."""
    made = make_run(tmp_path_factory.mktemp("run") / "quay")
    metrics = json.loads((made / "metrics.json").read_text())
    rows = [["all", 900, 0.001, 0.021], ["0", 500, 0.002, 0.017], ["1", 400, -0.001, 0.033]]
    metrics["tables"][PASSES] = {"columns": COLUMNS, "rows": rows}
    (made / "metrics.json").write_text(json.dumps(metrics))
    receipt = json.loads((made / "receipts" / "network.json").read_text())
    (made / "receipts" / "network.json").write_text(json.dumps({**receipt, "notes": [SECTIONS]}))
    return made


@pytest.mark.slow
def test_the_page_says_how_well_the_passes_agree(folder: Path) -> None:
    page = write_report(folder, ReportSettings(viewer_points=500)).read_text(encoding="utf-8")
    sure = page[page.index('<h2 id="sure">') : page.index('<h2 id="found">')]
    assert "One pass against the other" in sure and "were not compared" not in sure
    assert "<td>bridge\N{NO-BREAK SPACE}1</td>" in sure and f'"tables.{PASSES}.2.3">0.03' in sure
    assert page.count(f"tables.{PASSES}.0.2") == 1, "once, and not among the references"
    assert unmarked(page) == [] and f"tables.{PASSES}.0.3" in check(folder, page)
