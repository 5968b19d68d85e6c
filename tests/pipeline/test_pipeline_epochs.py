"""Two epochs of one place, as run folders: what moved is found, what stayed is not, what does not fit is said."""

import csv
import json
import shutil
from pathlib import Path

import laspy
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from clouds_world import ground
from said import refused
from tiegraph.cli.main import main
from tiegraph.geometry.geodesy import Origin
from tiegraph.pipeline.clouds import compare_epochs, compare_passes
from tiegraph.pipeline.evaluate import evaluate
from tiegraph.project.run import Run
from tiegraph.project.settings import merged
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud

ORIGIN = Origin(lat_deg=35.7, lon_deg=139.7, height_m=37.0, crs="EPSG:32654", shift_m=(382300.0, 3951500.0, 30.0))


def survey(folder: Path, xyz: np.ndarray, shift=(0.0, 0, 0), placed_m: float | None = 0.004, crs="EPSG:32654") -> Path:
    """A run folder of a cloud; its world has its own shift and a placement good to ``placed_m``."""
    at = tuple(a + b for a, b in zip(ORIGIN.shift_m, shift))
    origin = Origin(**{**ORIGIN.__dict__, "shift_m": at, "crs": crs})
    world = {"scale_source": "positions", "origin": None, "placement_error": None}
    if placed_m is not None:
        covariance = np.diag([0, 0, 0, placed_m**2, placed_m**2, placed_m**2, 0.0])
        error = {"middle": [0, 0, 0], "covariance": covariance.tolist()}
        world |= {"origin": origin.to_dict(), "placement_error": error}
    model = pycolmap.synthesize_dataset(pycolmap.SyntheticDatasetOptions())
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array([0, 0, 30.0])))
    (folder / "sparse" / "world").mkdir(parents=True)
    model.write(folder / "sparse" / "world")
    (folder / "world.json").write_text(json.dumps(world))
    cloud = Cloud(
        xyz_m=xyz - shift,
        rgb=np.zeros((len(xyz), 3), np.uint8),
        normal=np.zeros((len(xyz), 3), np.float32),
        sigma_m=np.full(len(xyz), 0.003, np.float32),
        views=np.zeros(len(xyz), np.uint8),
        origin=None if placed_m is None else origin,
    )
    write_cloud(cloud, folder / "cloud.laz", 0.01)
    return folder


@pytest.mark.slow
def test_a_box_that_grew_by_5_cm(tmp_path: Path, capsys) -> None:
    first = survey(tmp_path / "a", ground(30_000, 0))
    second = survey(tmp_path / "b", ground(30_000, 1, box_m=0.05), shift=(100.0, -200, 10))
    assert main(["compare", "--epochs", str(first), str(second), "-o", str(tmp_path / "out")]) == 0
    assert "changes" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "changes.json").read_text())
    (row,) = list(csv.reader((tmp_path / "out" / "changes.csv").open()))[1:]
    assert float(row[1]) == pytest.approx(382300, abs=0.5) and float(row[2]) == pytest.approx(3951500, abs=0.5)
    assert float(row[6]) == pytest.approx(0.05, abs=0.01) and 12 < float(row[5]) < 20
    assert result["areas_and_volumes"]["gain_m3"] == pytest.approx(0.8, abs=0.25)
    # of 400 m2 16 changed; both placements (4 mm) and points (3 mm) are in the level of detection
    lod = result["differences"]["level of detection m"]
    assert 1.96 * np.sqrt(2 * 0.004**2 + 2 * 0.003**2) < lod < 0.02
    las = laspy.read(tmp_path / "out" / "changes.laz")
    assert set(las.point_format.extra_dimension_names) == {"distance_m", "lod_m", "significant"}
    away = np.abs(np.asarray(las.xyz)[:, :2] - [382300, 3951500]).max(axis=1)
    assert np.nanmean(np.asarray(las["significant"])[away > 3.5]) < 0.08
    assert np.nanmean(np.asarray(las["significant"])[away < 1.3]) > 0.9
    assert las.header.parse_crs().to_epsg() == 32654
    assert (tmp_path / "out" / "changes.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        f"changes.{e}" for e in ("csv", "json", "laz", "png")
    ]
    with refused("exists already"):
        compare_epochs((first, second), tmp_path / "out")


@pytest.mark.slow
def test_a_shift_of_the_whole_survey_is_within_its_sigma_or_registered(tmp_path: Path) -> None:
    flat, bumpy = ground(20_000, 0), ground(20_000, 1)
    for cloud in (flat, bumpy):
        cloud[:, 2] += np.sin(cloud[:, 0]) + np.cos(cloud[:, 1])  # else it slides
    first = survey(tmp_path / "a", flat, placed_m=0.05)
    second = survey(tmp_path / "b", bumpy + [0, 0, 0.06], placed_m=0.05)
    found = compare_epochs((first, second), tmp_path / "placed")
    assert found["changes"]["rows"] == [] and found["differences"]["median m"] == pytest.approx(0.05, abs=0.02)
    loose = [survey(tmp_path / n, xyz, placed_m=None) for n, xyz in (("c", flat), ("d", bumpy + [0, 0, 0.06]))]
    with refused("c: its place on the Earth is not known.*--register rigid"):
        compare_epochs((loose[0], loose[1]), tmp_path / "loose")
    found = compare_epochs((loose[0], loose[1]), tmp_path / "registered", register="rigid")
    rows = {name: (value, sigma) for name, value, sigma in found["registration"]["rows"]}
    value, sigma = rows["shift in z at the middle, m"]
    assert value == pytest.approx(-0.06, abs=0.005) and 0 < sigma < 0.005
    assert abs(found["differences"]["median m"]) < 0.005 and found["changes"]["rows"] == []


@pytest.mark.slow
def test_a_survey_in_another_frame_is_laid_on_the_first_by_its_shape(tmp_path: Path) -> None:
    hills = np.random.default_rng(3).uniform(-9, 9, (25, 2))
    clouds = [ground(40_000, seed) for seed in (0, 1)]
    for cloud in clouds:
        away = np.linalg.norm(cloud[:, None, :2] - hills, axis=2)
        cloud[:, 2] += np.sum(1.5 * np.exp(-(away**2) / 2), axis=1)
    turn = Rotation.from_euler("zyx", [70, 20, 10], degrees=True).as_matrix()
    first = survey(tmp_path / "a", clouds[0], placed_m=None)
    second = survey(tmp_path / "b", clouds[1] @ turn.T + [300.0, -80, 12], placed_m=None)
    with refused("--coarse starts a registration: add --register rigid"):
        compare_epochs((first, second), tmp_path / "out", coarse=True)
    with refused("do not overlap"):
        compare_epochs((first, second), tmp_path / "out", register="rigid")
    found = compare_epochs((first, second), tmp_path / "out", register="rigid", coarse=True)
    assert abs(found["differences"]["median m"]) < 0.005 and 0 < found["differences"]["significant %"] < 12
    rows = {row[0]: row[1] for row in found["registration"]["rows"]}
    assert rows["coarse start: points near the reference, %"] > 80 and "start by their shapes" in found["notes"][0]


@pytest.mark.slow
def test_what_cannot_be_compared_is_said_and_nothing_written(tmp_path: Path) -> None:
    first = survey(tmp_path / "a", ground(500, 0))
    (tmp_path / "none").mkdir()
    with refused("none: it has no cloud.laz: run it to the stage cloud"):
        compare_epochs((first, tmp_path / "none"), tmp_path / "out")
    elsewhere = survey(tmp_path / "b", ground(500, 0), shift=(5000.0, 0, 0))
    moved = survey(tmp_path / "c", ground(500, 0) + [5000.0, 0, 0])
    with refused(r"c/cloud.laz \(EPSG:32654 by its header\): the cloud .* do not meet"):
        compare_epochs((first, moved), tmp_path / "out")
    with refused("a depth of -1 m does not fit: give .* to .* m"):
        compare_epochs((first, elsewhere), tmp_path / "out", depth_m=-1.0)
    assert not (tmp_path / "out").exists()
    found = compare_epochs((first, elsewhere), tmp_path / "out", depth_m=9.5)
    assert found["cylinders"]["depth_m"] == 9.5
    (first / "tiegraph.toml").write_text(f'[run]\nimages = "{tmp_path}"\n[tuning.evaluate.m3c2]\nleast_points = 1000\n')
    other = compare_epochs((first, elsewhere), tmp_path / "tuned", depth_m=9.5)
    assert found["differences"]["compared %"] > 50 and other["differences"]["compared %"] == 0


@pytest.mark.slow
def test_passes_of_one_run_and_its_evaluation_by_a_cloud(finished, tmp_path: Path, capsys) -> None:
    folder = finished.after("cloud", tmp_path / "run")
    assert main(["compare", "--passes", str(folder), "-o", str(tmp_path / "passes")]) == 0
    assert "common errors of both do not show" in capsys.readouterr().out
    found = json.loads((tmp_path / "passes" / "changes.json").read_text())
    assert abs(found["differences"]["median m"]) < 0.05 and found["differences"]["core points"] > 100
    shutil.copyfile(folder / "cloud.laz", tmp_path / "reference.laz")
    asked = {"reference_cloud": tmp_path / "reference.laz", "alignment": "none"}
    evaluate(Run(folder, None, merged({"evaluate": asked})))  # type: ignore[arg-type]
    figures = {m["name"]: m["value"] for m in json.loads((folder / "metrics.json").read_text())["metrics"]}
    assert abs(figures["m3c2_median"]) < 1e-6 and figures["ghosts"] == 0
    made = sorted(p.name for p in (folder / "evaluate").iterdir() if p.is_file())  # scratch goes with the whole stage
    assert made == ["distances.laz", "m3c2.laz", "m3c2.png"]
    tables = json.loads((folder / "metrics.json").read_text())["tables"]
    assert "cloud against reference, M3C2" in tables and "cloud against reference" in tables
    # the stage cloud has compared the passes for the report, at fewer core points
    agreement = json.loads((folder / "passes" / "agreement.json").read_text())
    assert tables["one pass against the other, M3C2"]["rows"][0][0] == "all"
    assert figures["passes_median"] == pytest.approx(agreement["found"]["all"]["median m"])
    assert figures["passes_median"] == pytest.approx(found["differences"]["median m"], abs=0.005)
    layers = json.loads((folder / "metrics.json").read_text())["accuracy"]["figures"]
    assert sum(f["key"] == "shape.passes" and f["measured"] > 0 and not f["independent"] for f in layers) == 1


@pytest.mark.slow
def test_the_poses_of_a_run_without_a_cloud_are_compared(finished, tmp_path: Path, capsys) -> None:
    folder = finished.after("georef", tmp_path / "run")
    there = sorted(folder.iterdir())
    shutil.copytree(folder / "sparse" / "world", tmp_path / "poses")
    assert main(["evaluate", str(folder), str(tmp_path / "poses")]) == 0
    said = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines() if line.startswith("ate_"))
    assert float(said["ate_se3_rmse"]) < 1e-6
    assert sorted(folder.iterdir()) == there
    shutil.rmtree(folder / "sparse" / "world")
    assert main(["evaluate", str(folder), str(tmp_path / "poses")]) == 2
    assert "run `tiegraph georef" in capsys.readouterr().err


@pytest.mark.slow
def test_one_pass_has_nothing_to_compare_with(finished, tmp_path: Path) -> None:
    folder = finished.after("cloud", tmp_path / "run")
    shutil.rmtree(folder / "depth")
    with refused("depth maps of 0 passes, but two are needed: run it to the stage dense"):
        compare_passes(Run(folder, None, merged({})), tmp_path / "out")  # type: ignore[arg-type]
