"""The report is one file, is complete, works for runs that stopped early, and escapes what it prints."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from fake_survey_run import FRAMES, make_run, tell
from scipy.spatial.transform import Rotation

from said import refused, says
from tiegraph.geometry import transforms
from tiegraph.report import cloudview, formatting, network, summary
from tiegraph.report.html import environment, write_report
from tiegraph.report.maps import frame_positions, scenery, tracks
from tiegraph.report.network import network_part
from tiegraph.report.parts import metric_text
from tiegraph.report.runfolder import read_run
from tiegraph.report.settings import ReportSettings
from tiegraph.scene.colmapmodel import Registration

SMALL = ReportSettings(viewer_points=2000)


@pytest.mark.slow
def test_the_whole_report(page: str) -> None:
    """In one offline file, nothing unescaped or unfilled."""
    for text in (
        "<h1>quay survey</h1>",
        "49 of 60 images (82 %) are registered in one connected model; the pose of 5 more comes from the rig",
        "images placed by the rig",
        "EPSG:32654 (WGS 84 / UTM zone 54N)",
        "Held in the world by 3 control points",
        "How sure are we",
        "truncated &amp; unreadable &lt;JPEG&gt;",
        "no GNSS under the bridge",
        "9 of 10",
        "cam2",
        "back-projection RMSE (round trip",
        "Oblique view from",
        "a note of network",
        "Settings of every stage",
        "39 % usable",
        "The files of the cloud are in its coordinates; those of the model, to keep numbers short, in these minus (",
    ):
        assert text in page, text
    assert not re.search(r'(?:src|href)\s*=\s*"(?!data:|#)', page)
    assert "http://" not in page and "https://" not in page
    assert page.count("data:image/") > 10 and len(page) < 6e6
    assert "<of>" not in page and "ring &lt;of&gt; 3" in page
    visible = page.split("<script")[0]
    assert "nan" not in re.sub(r'"data:[^"]*"', "", visible).lower().replace("finance", "")
    assert "None" not in visible and "{{" not in visible


@pytest.mark.slow
def test_the_viewer_gets_the_points_it_can_unpack(full: Path, page: str) -> None:
    data = json.loads(re.search(r'id="viewer-data">(.*?)</script>', page, re.S)[1])  # type: ignore[index]
    shift = json.loads((full / "world.json").read_text())["shift_m"]
    steps = np.frombuffer(base64.b64decode(data["xyz"]), "<u2").reshape(-1, 3)
    points = steps * data["step"] + data["low"]
    assert len(points) == data["count"] == 2000
    assert points[:, 1].min() < -6.5 and points[:, 1].max() > 7.5 and np.abs(points).max() < 30
    assert [t["name"] for t in data["tracks"]] == ["up", "down"] and len(data["tracks"][0]["xyz"]) == 3 * (FRAMES - 1)
    height, sigma = data["scales"]
    assert data["axes"] == ["E", "N", "H"] and data["north"] and data["offset"] == shift
    assert height["name"] == "height" and abs(height["low"] - data["offset"][2]) < 1, "heights are the CRS's"
    shown = np.frombuffer(base64.b64decode(sigma["values"]), np.uint8)
    assert sigma["name"] == "sigma of a point" and 0.002 < sigma["low"] < sigma["high"] < 0.1 and len(shown) == 2000
    assert len(data["images"]) == 54 and data["images"][0]["picture"].startswith("data:image/jpeg")
    assert "webgl" in cloudview.viewer_script()


SLOW = [pytest.param(s, marks=pytest.mark.slow) for s in ("masks", "network", "match", "georef", "cloud")]


@pytest.mark.slow
@pytest.mark.parametrize("until", ["scan", "design", "sparse", *SLOW])
def test_a_run_that_stopped_early(tmp_path: Path, until: str) -> None:
    text = write_report(make_run(tmp_path / "run", until), SMALL).read_text(encoding="utf-8")
    assert ("No model yet" in text) == (until in ("scan", "masks", "network", "design", "match"))
    assert ("Point cloud" in text) == (until in ("sparse", "georef", "cloud"))
    if until == "sparse":
        assert "not georeferenced" in text and "These are the sparse points" in text
    if until == "design":
        assert "The run has finished the stage design." in text and "pairs to match" in text


@pytest.mark.slow
def test_missing_and_damaged_pieces_are_left_out(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    for name in ("cloud.laz", "network.npz", "metrics.json", "receipts/masks.json"):
        (run / name).write_bytes(b"damaged")
    (run / "sparse" / "world" / "points3D.bin").write_bytes(b"")
    (run / "images" / "up" / "cam0" / "000000.jpg").unlink()
    (run / "receipts" / "sparse.json").write_text('{"stage": "sparse", "began": "x"}')
    (run / "receipts" / "georef.json").write_text('{"key": "x", "tables": {"odd": 3}, "counts": null, "notes": null}')
    text = write_report(run, SMALL).read_text(encoding="utf-8")
    assert "The stage sparse was interrupted" in text


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    for folder, words in ((tmp_path / "none", "no such run folder"), (tmp_path, "no run in it")):
        with refused(words):
            write_report(folder, SMALL)


@pytest.mark.slow
def test_verdict_levels(full: Path) -> None:
    run = read_run(full)
    assert run.model is not None and summary.verdict(run).level == "check"
    layers = {**run.metrics["accuracy"], "tolerance": None}  # type: ignore[index]
    everything = Registration(np.ones(60, bool), np.full(60, 10), 10)

    def judged(images: Registration = everything, *, said: dict = layers, **changed: object) -> summary.Verdict:
        model = replace(run.model, images=images, others=changed.pop("others", run.model.others))
        return summary.verdict(replace(run, model=model, metrics={"accuracy": said}, **changed))

    assert judged(said=run.metrics["accuracy"]).level == "check", "the tolerance is not held"
    assert judged().level == "good" and not any("far worse" in w for w in judged().warnings)
    by_rig = judged(replace(everything, points=np.r_[np.full(10, 9), everything.points[10:]]))
    assert by_rig.level == "check" and any("50 of 60 images (83 %)" in s for s in by_rig.sentences)
    poor = judged(replace(everything, placed=np.arange(60) < 20), others=(12, 8))
    assert poor.level == "poor" and any("the largest of 3; the others have 12, 8" in s for s in poor.sentences)
    assert any("3 separate models" in w for w in poor.warnings)
    free = judged(world=None)
    assert free.level == "check" and any("not georeferenced" in w for w in free.warnings)
    bad = [{**f, "measured": 3.0} if f["key"] == "world.held_out" else f for f in layers["figures"]]
    assert any("far worse" in w for w in judged(said={**layers, "figures": bad}).warnings)
    weak = judged(said={**layers, "placement": {"tilt_deg": 1.4}})
    assert weak.level == "check" and any("tilt" in w and "1.4°" in w for w in weak.warnings)


@pytest.mark.slow
def test_settings_name_files_without_their_folders(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", "scan")
    tell(folder, "scan", settings={"reference": "/home/somebody/truth/poses.tum", "ratio": 0.8})
    text = write_report(folder, SMALL).read_text(encoding="utf-8")
    assert "poses.tum" in text and "0.800" in text and "somebody" not in text


def test_a_model_without_a_world_is_drawn_upright(full: Path) -> None:
    """However its frame lies: as high as where it is placed, and the way along x."""
    run = read_run(full)
    placed = scenery(run)
    anyhow = transforms.rigid(Rotation.random(random_state=2).as_matrix(), np.array([5.0, 2, -9]))
    turned = replace(run.model, world_from_camera=anyhow @ run.model.world_from_camera)
    free = scenery(replace(run, model=turned, world=None, cloud=None))
    assert not free.north
    assert np.ptp(free.path[:, 2]) == pytest.approx(np.ptp(placed.path[:, 2]), abs=0.05)
    assert np.ptp(free.path[:, 0]) > 2 * np.ptp(free.path[:, 1]) > 0.5


def test_missing_frames_are_put_between_their_neighbours(full: Path) -> None:
    run = read_run(full)
    positions = frame_positions(run.scene, run.model.centres)
    assert np.isnan(positions[:, 0]).sum() == 2
    up, down = tracks(run.scene, positions)
    assert len(up.missing) == len(down.missing) == 1
    assert np.allclose(up.missing[0, 0], 8.0, atol=0.2) and -2.2 < up.missing[0, 1] < -0.5


def test_the_cloud_comes_back_into_the_world(full: Path) -> None:
    run = read_run(full, 5000)
    assert run.cloud.count == 40_000 and 4000 <= len(run.cloud.xyz) <= 5000
    assert np.abs(run.cloud.xyz).max() < 30 and run.cloud.rgb.max() > 150
    assert 0.01 < np.median(run.cloud.sigma_m) < 0.05 and run.cloud.views.min() >= 3


def test_funnel_rows_add_up(full: Path) -> None:
    run = read_run(full)
    rows = network.funnel_rows(run.pairs, run.network)
    counts = {name: n for name, n, _ in rows}
    names = [name for name, _, _ in rows]
    before = names.index("matched at full resolution")
    gone = sum(n for name, n, _ in rows[:before] if name.startswith("dropped"))
    assert counts["candidates"] - gone == counts["matched at full resolution"] > counts["verified"] > 0
    drawn = network.funnel(rows)
    assert f"\N{RIGHTWARDS ARROW} {formatting.count(counts['matched at full resolution'])}<" in drawn
    assert f"\N{RIGHTWARDS ARROW} {formatting.count(counts['verified'])}<" in drawn


@pytest.mark.slow
def test_the_network_says_whether_it_holds(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", "design")
    weak = {"columns": ["kind", "where"], "rows": [["joint", "up/cam0/000003.jpg"]]}
    tell(run, "coarse", notes=["coarse model: 60 of 60 images"])
    tell(run, "network", notes=["odd light"], tables={})
    tell(run, "design", tables={"weak links": weak})
    for name in ("map", "sections"):
        cv2.imwrite(str(run / "network" / f"{name}.png"), np.zeros((40, 60, 3), np.uint8))
    part = network_part(read_run(run))
    assert part["model"] == ["Coarse model: 60 of 60 images."] and ("Network", ["odd light"]) in part["notes"]
    assert [c.split()[0] for _, c in part["pictures"]] == ["The", "View"]
    assert [t.rows[0][1] for t in part["links"]] == ["up/cam0/000003.jpg"] and part["sound"] is None
    assert "Weak links: places where" in write_report(run, SMALL).read_text(encoding="utf-8")
    tell(run, "design", tables={"weak links": {"columns": ["kind"], "rows": []}})
    assert network_part(read_run(run))["sound"].startswith("No weak links")


def test_words() -> None:
    assert formatting.count(1698971) == "1\u202f698\u202f971" and formatting.count(None) == formatting.NONE
    numbers = [formatting.number(v) for v in (0.02341, 2.345, 23.45, 1234.5, 0, float("nan"))]
    assert numbers == ["0.0234", "2.35", "23.4", "1\u202f234", "0", formatting.NONE]
    assert [formatting.length(v) for v in (0.0042, 0.034, 0.55, 12.3)] == ["4.2 mm", "3.4 cm", "0.550 m", "12.3 m"]
    assert formatting.length(2.0, "units") == "2.00 units"
    assert [formatting.seconds(v) for v in (3.21, 75, 245, 7500)] == ["3.2 s", "75 s", "4 min 05 s", "2 h 05 min"]
    assert [formatting.percent(v) for v in (1.0, 0.9999, 0.5, 0.054)] == ["100 %", "99.9 %", "50 %", "5.4 %"]
    assert formatting.size(3.2e9) == "3.20 GB" and formatting.size(4.2e6) == "4.2 MB"
    table = formatting.table({"columns": ["camera_name", "iou"], "rows": [["a", 0.5], ["b", None], ["c", 0.1234]]})
    assert table.numeric == (False, True) and table.columns[0] == "camera name"
    assert [row[1] for row in table.rows] == ["0.500", formatting.NONE, "0.123"]
    assert formatting.table({"columns": ["a"], "rows": []}) is None and formatting.table(3) is None
    assert formatting.table({"columns": ["a", "b"], "rows": [[1]]}).rows == (("1", formatting.NONE),)  # type: ignore[union-attr]
    assert metric_text("rpe_10m_translation") == "relative pose error over 10 m, translation"
    assert metric_text("fscore_0.05m") == "F-score at 0.05 m"
    page = environment().from_string("{{ name }}|{{ ours|safe }}")  # what acts without being seen is escaped
    assert page.render(name="<script>\x1b\u202e\udc8e", ours="<b>") == "&lt;script&gt;\\x1b\\u202e\\x8e|<b>"


@pytest.mark.slow
def test_a_contradiction_is_a_level_of_its_own_and_the_evidence_a_section(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", "georef")
    text = "scale: GNSS positions 1.000 +- 0.014 and rig as given 1.1128 +- 0.0022 contradict each other by 7.9 sigmas"
    columns = ["quantity", "source", "value", "sigma", "unit", "used", "contradicted by"]
    rows = [["scale", "GNSS positions", 1.0, 0.014, "", "yes", "rig as given"]]
    rows += [["heading", "GNSS positions", 0.0001, 0.3, "deg", "yes", ""]]
    rows += [["scale", "rig as given", 1.1128, 0.0022, "", "", "GNSS positions"]]
    assert summary.verdict(read_run(folder)).level != "doubtful"
    tell(folder, "georef", contradictions=[text], tables={"evidence": {"columns": columns, "rows": rows}})
    found = summary.verdict(read_run(folder))
    assert found.level == "doubtful" and found.headline == "The survey contradicts itself: scale"
    page = write_report(folder, SMALL).read_text(encoding="utf-8")
    assert "usable with care" not in page
    assert page.count(f"S{text[1:]}") == 2, "on the first page, and where the engineer reads"
    assert page.count("<td>rig as given</td>") == 2 and "Statements of the sources" in page
    shown = page[page.index("Statements of the sources") :]
    assert shown.index(">1.1128<") < shown.index("<td>heading<")  # statements of one quantity stand together


@pytest.mark.slow
def test_registered_is_what_the_run_called_so(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run")
    before = read_run(folder).model
    tell(folder, "sparse", tuning={"scene": {"registered": {"min_points": 1000}}})
    after = read_run(folder).model
    assert before.images.registered.any() and before.images.min_points == 10
    assert not after.images.registered.any() and after.images.min_points == 1000
    tell(folder, "sparse", tuning={"scene": {"of another version": 1}})
    again = read_run(folder).model
    assert again.images.min_points == 10


def test_heights_lever_arm_and_adjustment_are_told() -> None:
    world = {
        "placed": True, "vertical": "heights are above the ellipsoid", "adjusted": True, "antenna_m": [0.1, 0.2, 0.3],
    }  # fmt: skip
    text = summary.georeference_sentences(world)
    assert text[0] == "Heights are above the ellipsoid."
    assert any("0.10, 0.20, 0.30 m" in t for t in text) and says(text, "adjusted together")
    assert summary.georeference_sentences({}) == []
