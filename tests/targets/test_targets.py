"""Coded targets: their names, their middles in rendered images, and as control and scale bars through georef's glue."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from calibrate.board_world import OVERSAMPLING, Renderer, Texture, camera
from targets.targets_world import EAST, NORTH, PLACES, Table, picture, printed, survey, table
from tiegraph.cli.main import main
from tiegraph.geometry import transforms
from tiegraph.pipeline.georef import georef
from tiegraph.project.stages import Outcome
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.scene import Scene
from tiegraph.scene.targets import Target, count_of, target_of
from tiegraph.targets.marks import centre_of, find_targets, likely_family, marks_of
from tiegraph.targets.tuning import Tuning

TUNING = Tuning()
FAMILY = "apriltag_36h11"


def test_names_of_targets_and_of_none():
    assert target_of("tag36h11:12") == target_of("DICT_APRILTAG_36h11: 12") == Target(FAMILY, 12)
    assert target_of("AprilTag 36h11:012") == Target(FAMILY, 12) and Target(FAMILY, 12).name == "tag36h11:12"
    assert target_of("4x4_50:7") == target_of("aruco_4X4_50:7") == Target("4x4_50", 7)
    assert target_of("mip_36h12:1") == Target("aruco_mip_36h12", 1) and target_of("original:1") is not None
    for name in ("P1", "GCP:3", "tag36h12:4", "tag36h11", "36:12", "tag36h11:-1"):
        assert target_of(name) is None, name
    assert count_of("4x4_50") == 50 and count_of(FAMILY) == 587


def test_middles_are_found_to_hundredths_of_a_pixel_and_their_sigma_says_so():
    world, off, sigmas = table(4), [], []
    for k in range(4):
        seen = find_targets(picture(world, k, world.places), [FAMILY], TUNING)
        assert [s.target.name for s in seen] == sorted(PLACES, key=lambda n: int(n[9:]))
        for one in seen:
            there = np.ravel(world.camera.img_from_cam(transforms.apply(world.poses[k], world.places[one.target.name])))
            off.append(centre_of(one.corners, world.camera) - there)
            sigmas.append(one.sigma_px / np.sqrt(2))
    rms = float(np.sqrt(np.mean(np.square(off))))
    assert 0.005 < rms < 0.06
    assert 0.5 < rms / np.median(sigmas) < 2, "the sigma is that of the errors"
    assert np.abs(np.mean(off, axis=0)).max() < 0.03


def test_the_middle_of_a_large_target_is_free_of_the_lens():
    lens = camera("OPENCV", [500, 500, 320, 240, -0.3, 0.08, 0, 0], (640, 480))
    tag = printed("tag36h11:5")
    per_metre = len(tag) / 0.2
    place = np.array([[per_metre, 0, (len(tag) - 1) / 2], [0, per_metre, (len(tag) - 1) / 2], [0, 0, 1]])
    render, known, crossing = Renderer(lens, Texture(tag, place)), [], []
    assert OVERSAMPLING >= 2
    for x, y in ((-0.22, -0.13), (0.23, -0.12), (0.22, 0.14)):
        pose = transforms.rigid(np.eye(3), np.array([x, y, 0.5]))
        (one,) = find_targets(render(pose, 1.0, np.random.default_rng(0)), [FAMILY], TUNING)
        true = np.ravel(lens.img_from_cam(pose[:3, 3]))
        known.append(np.linalg.norm(centre_of(one.corners, lens) - true))
        crossing.append(np.linalg.norm(centre_of(one.corners, None) - true))
    assert 0.005 < max(known) < 0.15 < 0.3 < min(crossing)


def test_a_target_printed_twice_is_not_used_and_what_is_missing_is_said():
    world = table(3)
    twice = {**world.places, "tag36h11:3#2": np.array([0.0, -0.25, 0.0])}
    pictures = [picture(world, 0, twice), picture(world, 1, world.places), picture(world, 2, {})]
    seen = {k: find_targets(p, [FAMILY], TUNING) for k, p in enumerate(pictures)}
    named = {n: target_of(n) for n in ("tag36h11:3", "tag36h11:7", "tag36h11:99")}
    marks, notes = marks_of(seen, named, lambda k: world.camera, world.names)
    assert {(m.name, m.image) for m in marks} == {("tag36h11:7", 0), ("tag36h11:7", 1)}
    said = "; ".join(notes)
    assert "target tag36h11:3 is seen at two places of 000.png: printed twice? It is not used" in said
    assert "target tag36h11:99 is seen in none of 3 images" in said
    assert "not named in the file: tag36h11:12 (2 images), tag36h11:20 (2 images), tag36h11:31 (2 images)" in said
    seven = {"tag36h11:7": named["tag36h11:7"]}
    alone = marks_of({0: seen[1]}, seven, lambda k: None, world.names)[1][0]
    assert alone == "target tag36h11:7 is seen in one image only, 000.png: two are needed for a place"


def test_the_family_that_is_there_is_told():
    world = table(1)
    seen = find_targets(picture(world, 0, world.places), [FAMILY, "apriltag_25h9"], TUNING)
    assert likely_family(seen) == "tag36h11 (seen 5 times)"
    small = find_targets(picture(world, 0, {f"4x4_50:{k}": p for k, p in enumerate(world.places.values())}),
                         ["4x4_1000"], TUNING)  # fmt: skip
    assert likely_family(small).startswith("4x4_50 ") and likely_family([]) == ""


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("children_are_functions")]
NAMES = list(PLACES)
HEAD = "# crs: EPSG:32654\nname,x,y,z,sigma_xy,sigma_z,role\n"
BARS = "from,to,length (mm),sigma (mm),role\n"


def surveyed(names: list[str], check: str = "", off: dict[str, float] | None = None) -> str:
    """Rows of points at their true places, some ``off`` in height."""
    rows = []
    for name in names:
        x, y, z = PLACES[name]
        z += (off or {}).get(name, 0.0)
        role = "check" if name == check else "gcp"
        rows.append(f"{name},{EAST + x:.6f},{NORTH + y:.6f},{z:.6f},0.001,0.001,{role}\n")
    return HEAD + "".join(rows)


def bar(a: str, b: str, factor: float = 1.0, sigma_mm: float = 0.1, role: str = "bar") -> str:
    length = 1000 * float(np.linalg.norm(np.subtract(PLACES[a], PLACES[b]))) * factor
    return f"{a},{b},{length:.4f},{sigma_mm},{role}\n"


def made(folder: Path, control: str) -> tuple[Outcome, dict, Table]:
    run, world = survey(folder, control)
    outcome = georef(run)
    return outcome, json.loads((folder / "world.json").read_text()), world


def camera_error_m(folder: Path, world: Table) -> np.ndarray:
    """(N, 3) centres of the cameras in the world minus the truth, metres."""
    model = pycolmap.Reconstruction(str(folder / "sparse/world"))
    scene = Scene.from_json((folder / "network/scene.json").read_text())
    told = json.loads((folder / "world.json").read_text())
    shift = np.zeros(3) if told["origin"] is None else np.array(told["origin"]["shift_m"]) - (EAST, NORTH, 0)
    out = []
    for here, true in zip(image_poses(model, scene), world.poses):
        out.append(-here[:3, :3].T @ here[:3, 3] + shift + true[:3, :3].T @ true[:3, 3])
    return np.array(out)


def test_targets_place_a_model_that_nobody_marked(tmp_path: Path) -> None:
    outcome, told, world = made(tmp_path, surveyed(NAMES, check=NAMES[4]))
    assert told["placed"] and told["scale_source"] == "control points"
    rows = {row["name"]: row for row in told["control"]}
    assert [rows[n]["marks"] for n in NAMES] == [8] * 5 and rows[NAMES[4]]["role"] == "check"
    assert all(0.001 < row["rms_px"] < 0.4 for row in rows.values())
    assert 1e-5 < np.linalg.norm(rows[NAMES[4]]["off_m"]) < 0.002
    assert 1e-5 < np.sqrt(np.mean(camera_error_m(tmp_path, world) ** 2)) < 0.002
    assert outcome.contradictions == ()


def test_scale_bars_hold_the_scale_where_nothing_else_does(tmp_path: Path) -> None:
    bars = BARS + bar(NAMES[0], NAMES[2]) + bar(NAMES[1], NAMES[3]) + bar(NAMES[0], NAMES[1], role="check")
    outcome, told, world = made(tmp_path, bars)
    assert not told["placed"] and told["scale_source"] == "scale bars" and told["origin"] is None
    assert told["scale"] == pytest.approx(1 / 0.3, rel=5e-4) and told["scale"] != pytest.approx(1 / 0.3, rel=1e-8)
    off, sigma = (np.array([row[n] for row in told["scale_bars"]]) for n in ("off_mm", "sigma_mm"))
    assert (0.05 < sigma).all() and (sigma < 0.5).all() and (np.abs(off) < 3 * sigma).all() and (off != 0).any()
    assert outcome.tables["scale bars"]["rows"][2][:3] == [NAMES[0], NAMES[1], "check"]
    assert outcome.contradictions == ()


def test_bars_that_contradict_each_other_or_the_points_are_told(tmp_path: Path) -> None:
    folders = [tmp_path / n for n in ("two", "three", "points")]
    for folder in folders:
        folder.mkdir()
    wrong = bar(NAMES[1], NAMES[3], 1.02)
    outcome, told, _ = made(folders[0], BARS + bar(NAMES[0], NAMES[2]) + wrong)
    (said,) = outcome.contradictions
    assert re.search(r"contradict each other by (1\.9|2\.0)", said) and "it is unknown which is wrong" in said
    assert told["scale"] * 0.3 == pytest.approx(1.01, abs=0.003)

    outcome, told, _ = made(folders[1], BARS + bar(NAMES[0], NAMES[2]) + wrong + bar(NAMES[0], NAMES[1]))
    (said,) = outcome.contradictions
    assert f"scale bar '{NAMES[1]}' to '{NAMES[3]}' is not used" in said and re.search(r"\+(1\.9|2\.0)", said)
    assert told["scale"] * 0.3 == pytest.approx(1, abs=5e-4) and told["scale_bars"][1]["why_not"]

    grown = bar(NAMES[0], NAMES[2], 1.02) + bar(NAMES[1], NAMES[3], 1.02)
    outcome, told, world = made(folders[2], surveyed(NAMES) + BARS + grown)
    assert any("scale" in c and "scale bars" in c and "control points" in c for c in outcome.contradictions)
    assert told["placed"] and told["sigma"]["scale"] > 0.005


def test_bars_and_points_together_and_a_target_that_is_not_there(tmp_path: Path) -> None:
    text = surveyed(NAMES[:3]) + f"tag36h11:77,{EAST},{NORTH},0,0.01,0.01,gcp\n" + BARS + bar(NAMES[3], NAMES[4])
    outcome, told, world = made(tmp_path, text)
    assert told["placed"] and told["scale_bars"][0]["off_mm"] == pytest.approx(0, abs=0.5)
    assert 1e-5 < np.sqrt(np.mean(camera_error_m(tmp_path, world) ** 2)) < 0.003
    assert "target tag36h11:77 is seen in none of 8 images" in outcome.notes
    assert next(r for r in told["control"] if r["name"] == "tag36h11:77")["why_not"]


def test_a_bar_holds_its_length_in_the_adjustment_against_poorer_points(tmp_path: Path) -> None:
    """Points of 2 mm whose survey is 0.3 % too large: that would make the bar 2.6 mm too long."""
    rows = [f"{n},{EAST + 1.003 * x:.6f},{NORTH + 1.003 * y:.6f},{1.003 * z:.6f},0.002,0.002,gcp\n"
            for n, (x, y, z) in PLACES.items()]  # fmt: skip
    outcome, told, _ = made(tmp_path, HEAD + "".join(rows) + BARS + bar(NAMES[0], NAMES[2]))
    assert 0 < abs(told["scale_bars"][0]["off_mm"]) < 0.6 and outcome.contradictions == ()


def test_the_wrong_family_is_named(tmp_path: Path) -> None:
    text = surveyed(NAMES).replace("tag36h11:", "tag25h9:")
    run, _ = survey(tmp_path, text)
    (said,) = (c for c in georef(run).contradictions if c.startswith("no control point is used"))
    assert re.search(r"none of its 5 coded targets, such as tag25h9:3, .* but of tag36h11 \(seen", said)


def test_scan_says_before_hours_of_work_which_targets_are_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey(tmp_path, surveyed(NAMES).replace("tag36h11:", "tag25h9:"))
    run = ["run", str(tmp_path / "images"), "-o", str(tmp_path / "out"), "--pool", "serial", "--until", "scan"]
    assert main([*run, "--gcp", str(tmp_path / "control.csv")]) == 2
    said = "".join(capsys.readouterr())
    assert "such as tag25h9:3" in said and "but of tag36h11" in said
    assert not (tmp_path / "out/scene.json").exists() and not (tmp_path / "out/tiegraph.toml").exists()
    (tmp_path / "bars.csv").write_text(BARS + bar(NAMES[0], NAMES[1]) + "tag36h11:3,tag36h11:99,100,1,bar\n")
    assert main([*run, "--gcp", str(tmp_path / "bars.csv")]) == 0
    assert "target tag36h11:99 is seen in none of 8 images" in "".join(capsys.readouterr())
