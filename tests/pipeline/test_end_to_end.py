"""The whole way on a small survey with exact truth: images to cloud and report, through the public API and the CLI."""

import base64
import csv
import importlib
import json
import re
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest

import tiegraph
import worlds
from accuracy_marks import check, unmarked
from campaign.world import FRAMES, SIZE
from said import refused
from tiegraph.cli.main import main
from tiegraph.errors import InputError, ReconstructionError, SettingsError
from tiegraph.evaluate.reference import model_poses
from tiegraph.geometry.geodesy import geodetic_from_world, world_from_geodetic
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline import STAGES
from tiegraph.pipeline.baseline import lay_out
from tiegraph.project.run import Run
from tiegraph.project.stages import needed
from tiegraph.report.accuracy import terminal_lines
from tiegraph.scene.results import LAYERS, Accuracy

pytestmark = pytest.mark.slow
_PATIENCE_S = 400


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """The truth of the survey of all whole runs."""
    return worlds.make_survey(tmp_path_factory.mktemp("survey") / "images", frames=FRAMES, size=SIZE)


@pytest.fixture(scope="module")
def project(finished, tmp_path_factory):
    """The finished survey, with a tolerance asked afterwards."""
    folder = finished.after(STAGES[-1].name, tmp_path_factory.mktemp("project") / "out")
    return tiegraph.open(out=folder, pool="serial", tolerance=5.0).run()


def test_every_image_is_in_one_model_and_in_its_place(project, survey):
    scene = project.scene()
    poses = model_poses(project.model(), scene)
    assert poses.placed.all() and len(scene) == 12
    truth = survey.centres_m(list(scene.names))
    fit = umeyama(poses.centres(), truth)
    error = np.linalg.norm(fit(poses.centres()) - truth, axis=1)
    assert 1e-5 < np.sqrt(np.mean(error**2)) < 0.02
    world = world_from_geodetic(geodetic_from_world(truth, worlds.ORIGIN), scene.origin)
    absolute = np.linalg.norm(poses.centres() - world, axis=1)
    assert 0.001 < np.median(absolute) < 0.1, "2 cm GNSS noise over 6 frames"


def test_cloud_lies_on_the_walls_and_in_the_crs(project, survey):
    cloud = project.cloud()
    assert 4000 < len(cloud) < 16_000 and np.median(cloud.views) >= 3
    geodetic = geodetic_from_world(cloud.xyz_m, project.scene().origin)
    local = world_from_geodetic(geodetic, worlds.ORIGIN)
    gap = np.min([outside(local, box) for box in survey.world.boxes_m], axis=0)
    assert 0.002 < np.median(gap) < 0.06 and np.quantile(gap, 0.9) < 0.15
    with laspy.open(project.folder / "cloud.laz") as las:
        assert las.header.parse_crs().to_epsg() == 32654
        assert {"sigma_m", "views"} <= set(las.header.point_format.extra_dimension_names)
        assert abs(las.header.mins[0] - project.scene().origin.shift_m[0]) < 500


def test_depth_maps_and_figures_are_objects(project):
    name = project.scene().names[5]
    depth, (accuracy, metrics) = project.depth(name), project.accuracy()
    assert depth.image == name and np.isfinite(depth.depth_m).mean() > 0.3
    assert metrics["registered_images"].value == 100 and metrics["registered_images"].unit == "%"
    assert accuracy.unit == "m" and 0.1 < accuracy.head("world").predicted < 5  # metres, GNSS of a short drive
    with pytest.raises(InputError, match=r"depth/nothing.png.npz"):
        project.depth("nothing.png")


def outside(points, box):
    """Distance (N,) of points to the surface of an axis-aligned box (2, 3)."""
    away = np.maximum(np.maximum(box[0] - points, points - box[1]), 0)
    inside = np.min(np.minimum(points - box[0], box[1] - points), axis=1)
    return np.where(inside > 0, inside, np.linalg.norm(away, axis=1))


def test_report_is_one_offline_page(project):
    text = project.report().read_text()
    assert "12 of 12 images" in text
    assert not re.search(r'(?:src|href)="(?!data:|#)', text), "everything is inside the page"
    heads = re.findall(r"<h2[^>]*>([^<]*)", text)
    assert heads[0].startswith("The survey is")
    for head in ("What was found", "Masks", "Which images tie to which", "Camera positions and model", "Point cloud"):
        assert head in heads
    pictures = re.findall(r'src="data:image/(?:png|jpeg);base64,([^"]+)"', text)
    assert len(pictures) >= 4 and all(len(base64.b64decode(p)) > 1000 for p in pictures)
    assert text.count('id="viewer-data"') == 1


def test_every_accuracy_has_one_source(project):
    page, folder = project.report().read_text(), project.folder
    said = Accuracy.from_dict(json.loads((folder / "metrics.json").read_text())["accuracy"])
    assert set(said.values()) <= check(folder, page)
    (about_rig,) = unmarked(page)  # a note on the times of the cameras, which are no accuracy of the survey
    assert "whether cam1 fires at the same time as cam0 (sigma" in about_rig
    assert 0.005 < said.figure("world").predicted < 5 and 0.001 < said.figure("point").predicted < 0.5
    assert said.held_by == "GNSS positions of RTK quality of 6 of 6 frames" and 0 < said.placement["tilt_deg"] < 10
    assert said.answer.said == "cannot be told" and "check points" in said.answer.remedy
    lines = terminal_lines(folder / "metrics.json")
    assert len(lines) == 4 and lines[0].startswith("Tolerance of 5.00 m in the world: cannot be told.")
    stated = [f"{name} {said.head(layer).predicted:.3g} m" for layer, name in LAYERS.items()]
    stated.append(f"held in the world by {said.held_by}")
    for name in ("cloud.laz", "cloud.copc.laz"):
        text = laspy.open(folder / name).header.vlrs.get_by_id("LASF_Spec", [3])[0].record_data_bytes().decode()
        assert all(part in text for part in stated), text
    assert all(part.encode() in (folder / "cloud.ply").read_bytes()[:2000] for part in stated)


def test_the_report_names_no_folder_of_this_machine(project):
    for name in ("report.html", "report.json", "metrics.json", "accuracy.csv"):
        text = (project.folder / name).read_text()
        assert str(project.folder.parent) not in text and str(Path.home()) not in text, name
    assert "rig.toml" in project.report().read_text()


def test_accuracies_are_a_table_too(project):
    with (project.folder / "accuracy.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    said = {row["quantity"]: float(row["value"]) for row in rows if row["about"] == "survey" and row["value"]}
    measured = json.loads((project.folder / "metrics.json").read_text())["metrics"]
    assert said == pytest.approx({m["name"]: m["value"] for m in measured if m["value"] is not None}, rel=1e-4)
    assert sum(row["about"] == "residual of a frame, m" for row in rows) >= 3 * 6


def test_receipts_account_for_everything(project):
    for stage, why, receipt in project.status():
        assert why == "", f"{stage}: {why}"
        assert receipt["seconds"] >= 0 and receipt["cpu_s"] >= 0 and receipt["software"]["pycolmap"]
    asked = project.receipt("match")["counts"]["asked"]
    assert (
        asked
        == project.receipt("design")["counts"]["pairs"]
        == len((project.folder / "pairs.txt").read_text().splitlines())
    )
    dense = project.receipt("dense")
    matched, kept, two, few, through = (row[1] for row in dense["tables"]["comparison of depth maps"]["rows"])
    assert matched == kept + few + through and 0 <= two < kept and few > 0 and through > 0
    assert kept == dense["counts"]["pixels"]
    world = json.loads((project.folder / "world.json").read_text())
    assert world["placed"] and world["crs"] == "EPSG:32654"


def test_reasons_of_dense_survive_the_loss_of_a_depth_map(finished, tmp_path):
    """Its first maps are made again anyway; the others' reasons with them, and every byte is what it was."""
    folder = finished.after("dense", tmp_path / "out")
    again = tiegraph.open(out=folder, pool="serial")
    told = again.receipt("dense")["tables"]
    before = {p: p.read_bytes() for p in (folder / "depth").rglob("*.npz")}
    next(iter(before)).unlink()
    again.run(until="dense")
    assert again.receipt("dense")["tables"] == told
    assert {p: p.read_bytes() for p in (folder / "depth").rglob("*.npz")} == before


def test_a_survey_without_a_cloud_and_a_reference_of_elsewhere_leave_the_model_and_the_report(
    project, tmp_path, monkeypatch
):
    folder = tmp_path / "out"
    shutil.copytree(project.folder, folder, symlinks=True)

    def nothing(*arguments):
        raise ReconstructionError("no depth map has a point that enough images agree on")

    monkeypatch.setattr(importlib.import_module("tiegraph.pipeline.dense"), "fuse", nothing)
    (tmp_path / "elsewhere.tum").write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(5)))
    reference = {"reference": tmp_path / "elsewhere.tum"}
    again = tiegraph.open(out=folder, pool="serial", settings={"cloud": {"voxel_size": 0.2}, "evaluate": reference})
    again.run()
    assert not (folder / "cloud.laz").exists() and again.doubtful() and not again.doubtful("dense")
    said = json.loads((folder / "report.json").read_text())
    assert said["verdict"]["level"] == "doubtful" and said["accuracy"] and len(said["contradictions"]) == 2
    assert "enough images agree" in said["contradictions"][0] and "no reference is" in said["contradictions"][1]
    assert again.receipt("evaluate")["counts"]["figures"] > 0


@pytest.mark.parametrize("preset", ["conventional", "meguro2024", "meguro2025"])
def test_presets_run_to_a_model(preset, finished, server, tmp_path):
    out = tmp_path / preset
    asked = ["run", finished.inputs / "images", "-o", out, "--pool", "serial", "--preset", preset, "--until", "sparse"]
    more = ["--masks.source", "none", "--rig", finished.inputs / "rig.toml", "--quiet"]
    ended = server.run([*asked, *more], tmp_path / "said", _PATIENCE_S)
    assert ended.good, ended
    names = [s.name for s in STAGES]
    later = [n for n in names[names.index("sparse") + 1 :] if (out / "receipts" / f"{n}.json").exists()]
    assert not later, "a run ends with the stage that it is to end with"
    project, ours = tiegraph.open(out=out), tiegraph.open(out=finished.clean["report"])
    if preset == "conventional":  # first claim of paper 000: it looks at every pair, the network at a part
        every = len(project.scene()) * (len(project.scene()) - 1) // 2
        pairs, fewer = (p.receipt("design")["counts"]["pairs"] for p in (project, ours))
        assert pairs == every and 0 < fewer < 0.8 * every
    assert project.preset == preset and 6 <= project.receipt("sparse")["counts"]["registered"] <= 12


def test_another_method_on_the_same_images(project, tmp_path, capsys):
    out = tmp_path / "block"
    asked = ["compare", "--baseline", "colmap", "--sample", "99", str(project.folder), "-o", str(out), "--quiet"]
    assert main(asked) == 0
    said = capsys.readouterr().out
    assert "registered, in the largest model" in said and "all of it" in said and "no reference poses" in said
    result = json.loads((out / "colmap.json").read_text())
    rows = {row[0]: row[1:] for row in result["figures"]["rows"]}
    registered, cpu_s = rows["registered, in the largest model"], rows["CPU s"]
    to_georef = [s.name for s in needed(STAGES, "georef")]
    own = sum(project.receipt(stage)["cpu_s"] for stage in to_georef)
    assert registered[0] == len(project.registered()) and cpu_s[0] == pytest.approx(own, rel=1e-3)
    assert 0 <= registered[1] <= 12 and cpu_s[1] > 0 and rows["images"][:2] == [12, 12]
    assert rows["ATE, m"][0] == pytest.approx(0, abs=1e-6)  # its own poses
    # finished work is taken over, and another block has no place there
    before = (out / "colmap" / "stages.json").read_bytes()
    project.baseline("colmap", 99, out)
    assert (out / "colmap" / "stages.json").read_bytes() == before
    with refused("contains other files"):
        project.baseline("colmap", 8, out)


def test_a_block_is_a_folder_of_links(project, finished, tmp_path):
    run = Run(project.folder, project.inputs, project.settings)
    block = lay_out(run, 8, tmp_path / "block")
    files = sorted(p for p in block.images.rglob("*") if p.is_symlink())
    assert len(files) == len(block.scene) == 8 and not block.whole
    assert {p.relative_to(block.images).as_posix() for p in files} == set(block.scene.names)
    assert all(p.samefile(finished.inputs / "images" / p.relative_to(block.images)) for p in files)
    with refused("--sample 5: give at least 6"):
        lay_out(run, 5, tmp_path / "other")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.txt").write_text("")
    with refused("contains other files"):
        lay_out(run, 8, tmp_path / "mine")
    with pytest.raises(SettingsError, match="unknown baseline 'colmp'"):
        project.baseline("colmp", 12)


def test_another_language_and_client_make_only_the_report_anew(project):
    """Last, for the report of the project is another one then."""
    before = (project.folder / "receipts" / "evaluate.json").read_text()
    asked = ["report", str(project.folder), "--pool", "serial", "--quiet", "--language", "ja"]
    assert main([*asked, "--report.about.client", "Port & Co"]) == 0
    page = project.report().read_text()
    assert "測量報告書" in page and "Port &amp; Co" in page
    assert (project.folder / "receipts" / "evaluate.json").read_text() == before
    assert tiegraph.open(out=project.folder).settings.report.about.client == "Port & Co"
