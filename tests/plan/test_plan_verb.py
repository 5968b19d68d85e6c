"""tiegraph plan: tables, files, planned against reached, the examples of docs/plan.md, and errors at the door."""

import csv
import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from report.fake_survey_run import make_run
from tiegraph.cli.main import main
from tiegraph.pipeline.evaluate import report
from tiegraph.plan.figures import START_S, effort
from tiegraph.plan.planner import comparison
from tiegraph.report.settings import ReportSettings

PAPER = ["--focal", "8", "--pixel", "3.45", "--size", "2448x2048", "--base", "0.075", "--match-px", "0.3"]
WALL = ["--focal-px", "900", "--size", "1200x900", "--distance", "8", "--shape", "facade", "--length", "15"]


def said(capsys, *arguments: str) -> dict:
    assert main(["plan", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_the_sweep_of_paper_004_as_json_and_as_a_table(capsys):
    rows = said(capsys, *PAPER, "--distance", "0.5,0.7,1.0,1.2")["stations"]
    assert [round(1000 * r["depth_sigma_2_rays_m"], 3) for r in rows] == [0.431, 0.845, 1.725, 2.484]
    assert [round(r["px_per_mm2"], 1) for r in rows] == [21.5, 11.0, 5.4, 3.7]
    assert main(["plan", *PAPER, "--distance", "0.5,0.7"]) == 0
    shown = capsys.readouterr().out
    assert "0.431 (2)" in shown and "0.845 (2)" in shown


@pytest.mark.slow
def test_a_sweep_over_bases_goes_through_the_distances_of_each(capsys, tmp_path):
    arguments = ["--focal-px", "2000", "--size", "2000x1500", "--distance", "1,2,4", "--base", "0.1,0.2"]
    assert main(["plan", *arguments, "-o", str(tmp_path / "out")]) == 0
    rows = list(csv.DictReader((tmp_path / "out" / "stations.csv").open()))
    assert [(float(r["distance_m"]), float(r["base_m"])) for r in rows] == [
        (d, b) for b in (0.1, 0.2) for d in (1.0, 2.0, 4.0)
    ]
    assert float(rows[0]["depth_sigma_2_rays_m"]) == pytest.approx(2 * float(rows[3]["depth_sigma_2_rays_m"]))
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"plan.json", "stations.csv"}


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planned") / "out"
    place = ["--gnss", "0.02,0.03", "--outage", "6-10", "--control", "1", "--origin", "35.7,139.77", "--heading", "0"]
    assert main(["plan", *WALL, "--height", "4", "--base", "1.5", *place, "-o", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_a_path_leaves_its_files(planned):
    path = json.loads((planned / "plan.json").read_text())["path"]
    assert path["frames"] == 22 == path["images"]
    assert 0 < path["position_shape_sigma_median_m"] < path["position_world_sigma_median_m"] < 0.05
    assert len(path["worst"]) >= 1 and all(p["world_m"] > 0 for p in path["places"])
    rows = list(csv.DictReader((planned / "waypoints.csv").open()))
    assert len(rows) == 22 and rows[0]["crs"] == "EPSG:32654"
    kml = ElementTree.fromstring((planned / "waypoints.kml").read_text())
    at = [[float(v) for v in c.text.split(",")] for c in kml.findall(".//{*}Point/{*}coordinates")]
    assert len(at) == 22 and at[10][1] > at[0][1] == pytest.approx(35.7, abs=1e-5)  # heading north
    assert at[0][2] == pytest.approx(float(rows[0]["height_m"]), abs=1e-3)
    assert len(kml.findall(".//{*}LineString")) == 2
    page = (planned / "plan.html").read_text()
    data = json.loads(page.split('id="viewer-data">')[1].split("</script>")[0])
    assert data["count"] > 100 and data["tracks"][0]["name"] == "row 1"


@pytest.mark.slow
def test_planned_stands_beside_reached(planned, tmp_path, capsys):
    run = make_run(tmp_path / "run")
    capsys.readouterr()
    assert main(["plan", "--compare", str(run), "--planned", str(planned / "plan.json"), "--json"]) == 0
    rows = {r[0]: r[1:] for r in json.loads(capsys.readouterr().out)["rows"]}
    assert rows["images"][0] == "22" and int(rows["images"][1]) > 22
    assert float(rows["frames apart, m"][0]) == 1.5 and float(rows["frames apart, m"][1]) > 0
    ratio = float(rows["images"][1]) / 22
    assert float(rows["images"][2]) == pytest.approx(ratio, abs=0.01)
    assert float(rows["error of cameras in shape (ATE), mm"][1]) > 0
    (run / "plan.json").write_text((planned / "plan.json").read_text())
    assert main(["plan", "--compare", str(run)]) == 0
    assert "planned and reached" in capsys.readouterr().out
    page = _reported(run)
    assert "planned and reached" in page and "frames apart, m" in page
    (run / "plan.json").write_text("[]")
    assert "planned and reached" not in _reported(run)


def _reported(folder: Path) -> str:
    """The page of the stage `report`."""
    run = SimpleNamespace(folder=folder, path=folder.joinpath, settings=SimpleNamespace(report=ReportSettings()))
    report(run)
    return (folder / "report.html").read_text()


def test_what_a_survey_costs_grows_with_its_images():
    one, ten = (effort([(2000, 1500)] * 2, n, 100.0, 0.5, 12288) for n in (1, 10))
    assert ten.images == 20 and ten.site_s == 200
    assert ten.image_bytes == pytest.approx(10 * one.image_bytes)
    assert ten.sparse_cpu_s - START_S == pytest.approx(10 * (one.sparse_cpu_s - START_S))
    # Herz-Jesus-P25 took 58.9 CPU s up to `georef`, benchmarks/results/large_sets.json.
    assert 40 < effort([(1536, 1024)], 25, 1.0, None, 12288).sparse_cpu_s < 90


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments, named",
    [
        ([*PAPER, "--distance", "-1"], "--distance -1"),
        ([*PAPER, "--distance", "1", "--speed", "2"], "without --rate"),
        (["--focal-px", "900", "--size", "1200x900", "--distance", "1", "--overlap", "1"], "--overlap 1"),
        ([*WALL, "--tie-px", "0"], "--tie-px Input should be greater than 0 (given: 0.0)"),
        (["--focal-px", "900", "--distance", "1"], "--size"),
        (["--size", "1200x900", "--distance", "1"], "--focal"),
        ([*WALL, "--passes", "2"], "--passes 2"),
        ([*WALL, "--outage", "3-4"], "without --gnss"),
        ([*WALL, "--gnss", "0.02", "--outage", "3"], "--outage 3"),
        ([*WALL, "--distance", "1,2"], "2 are given"),
        (["--rig", "none.toml", "--distance", "1"], "none.toml"),
        ([*WALL, "--shpe", "canal"], "shpe"),
        (["--compare", "nowhere"], "plan.json"),
        ([*PAPER, "--distance", "1", "-o", "."], "exists already"),
    ],
)
def test_misuse_is_named_before_anything_is_made(arguments, named, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["plan", *arguments, *([] if {"--compare", "-o"} & set(arguments) else ["-o", "out"])]) == 2
    assert named in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_rig_file_gives_cameras_and_their_places(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    camera = 'model = "PINHOLE"\nsize = [1200, 900]\nparams = [900, 900, 610, 440]\n'
    sensor = (
        '[[sensors]]\nname = "c{0}"\nposition_m = [{0}.0, 0, 0]\nyaw_pitch_roll_deg = [0, 0, 0]\n[sensors.camera]\n'
    )
    rig.write_text('name = "pair"\naxes = "camera"\n' + "".join(sensor.format(k) + camera for k in (0, 1)))
    found = said(capsys, "--rig", str(rig), "--distance", "9", "--base", "1")
    assert found["camera"] == {"focal_px": 900.0, "size": [1200, 900]}
    assert np.isclose(found["stations"][0]["gsd_m"], 0.01)


PLAN = {"stations": [{}], "path": {"position_shape_sigma_median_m": 0.002, "place_world_sigma_median_m": 0.03}}


def test_it_is_said_in_a_sentence():
    run = {"position_shape_sigma_median_m": 0.003, "place_world_sigma_median_m": 0.04, "ate_m": 0.01}
    table = comparison(PLAN, run)
    assert "known to 3 mm where 2 mm were planned" in table.sentence
    assert any("ATE" in row[0] for row in table.rows)


PAGE = Path(__file__).parents[2] / "docs" / "plan.md"
COMMANDS = [c for c in re.findall(r"```\n(tiegraph plan .*?)\n```", PAGE.read_text()) if "--compare" not in c]
SHAPES = [re.search(r"--shape (\w+)", c) for c in COMMANDS]


def run(command: str, folder: Path) -> dict:
    words = shlex.split(command)[1:]
    if "-o" in words:
        words[words.index("-o") + 1] = str(folder / "out")
    else:
        words += ["-o", str(folder / "out")]
    assert main(words) == 0
    return json.loads((folder / "out" / "plan.json").read_text())


def test_there_is_one_for_each_kind_of_user():
    assert [found and found[1] for found in SHAPES] == [None, "canal", "facade", "grid", "tunnel"]


@pytest.mark.slow
def test_the_table_of_the_paper(tmp_path):
    rows = run(COMMANDS[0], tmp_path)["stations"]
    for row in rows:
        assert f"{1000 * row['depth_sigma_2_rays_m']:.3f}" in PAGE.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, 5))
def test_a_path_has_the_images_and_sigmas_that_the_page_says(number, tmp_path):
    path = run(COMMANDS[number], tmp_path)["path"]
    said = PAGE.read_text().split(COMMANDS[number])[1].split("```")[1]
    counted = re.search(r"(\d+) images", said)
    assert counted is None or int(counted[1]) == path["images"]
    bounds = [(0.6, 1.1), (1.5, 2.6), (10, 25), (2, 9)][number - 1]  # mm: cameras of the boat, else points
    figure = "position" if number == 1 else "point"
    assert bounds[0] < 1000 * path[f"{figure}_shape_sigma_median_m"] < bounds[1]
    world = [(38, 46), (4, 9), (18, 32), (6, 12)][number - 1]
    assert world[0] < 1000 * path[f"{figure}_world_sigma_median_m"] < world[1]
