"""Surveys that go on from poses, of a start model or of odometry, good ones and wrong ones, end in the same place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

import tiegraph
import worlds
from said import refused
from scan.start_models import colmap_model
from tiegraph.api import Project
from tiegraph.cli.run import main
from tiegraph.evaluate.reference import model_poses
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import invert, umeyama
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.posefile import write_tum

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("children_are_functions")]  # slow: the world they share

_UNIT = 0.13  # of the start model, in metres


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> worlds.Survey:
    folder = tmp_path_factory.mktemp("survey")
    made = worlds.make_survey(folder / "images", frames=3)
    bare = replace(made.rig, sensors=tuple(replace(s, camera=None) for s in made.rig.sensors), fixed=False)
    write_rig_toml(bare, folder / "rig.toml")
    worlds.write_times(made, folder / "times.csv")
    return made


def start_of(made: worlds.Survey, folder: Path, turned_deg: float = 0.0) -> Path:
    """The truth as a COLMAP model in another unit; if a pass of it is turned about its first image, its focal length is
    a tenth too long, too."""
    camera = made.rig.sensors[0].camera
    params = np.array(camera.params) * ([1.1, 1.1, 1, 1] if turned_deg else 1.0)
    turn = Rotation.from_euler("z", turned_deg, degrees=True).as_matrix()
    pivot = invert(made.cam_from_world["up/cam0/000000.jpg"])[:3, 3]
    poses = {}
    for name in sorted(made.cam_from_world):
        pose = invert(made.cam_from_world[name])
        if name.startswith("up/"):
            pose[:3, 3] = turn @ (pose[:3, 3] - pivot) + pivot
            pose[:3, :3] = turn @ pose[:3, :3]
        pose[:3, 3] /= _UNIT
        poses[name] = invert(pose)
    lens = " ".join(map(repr, params.tolist()))
    return colmap_model(folder, poses, lens=f"1 PINHOLE {camera.width} {camera.height} {lens}")


def opened(made: worlds.Survey, out: Path, **inputs: Path) -> Project:
    root = made.images.parent
    settings = {"masks": {"source": "none"}}
    more = {"rig": root / "rig.toml", "times": root / "times.csv", **inputs}
    return tiegraph.open(made.images, out, pool="serial", settings=settings, **more)


def check_model(project: Project, made: worlds.Survey) -> float:
    """All images in one model, in their places (a rig that is adjusted, three frames a pass); its scale."""
    scene = project.scene()
    poses = model_poses(project.model(), scene)
    assert poses.placed.all() and len(scene) == 12
    truth = made.centres_m(list(scene.names))
    fit = umeyama(poses.centres(), truth)
    assert 1e-5 < np.sqrt(np.mean(np.sum((fit(poses.centres()) - truth) ** 2, axis=1))) < 0.03
    return fit.scale


def test_a_survey_goes_on_from_a_model(survey: worlds.Survey, tmp_path: Path) -> None:
    """The unit of the model is not taken over: the rig's baseline tells metres. What is turned in it is named; of a
    right model test_sfm_start."""
    start = start_of(survey, tmp_path / "start", 20.0)
    project = opened(survey, tmp_path / "out", start=start).run("georef")
    assert check_model(project, survey) == pytest.approx(1, abs=0.1), "of the rig, 0.5 m long; the start's are 7.7"
    scanned, sparse = project.receipt("scan"), project.receipt("sparse")
    assert any(f"its unit is {_UNIT:.4g} m by the distances" in n for n in scanned["notes"])
    assert any("camera from" in n and "start, camera 1" in n for n in scanned["notes"])
    assert any("sources chosen: sequence, offsets, poses" in n for n in project.receipt("candidates")["notes"])
    assert sparse["counts"]["start_images"] == 12
    focal = [c.mean_focal_length() / 211.2 for c in project.model().cameras.values()]
    assert focal == pytest.approx([1, 1], abs=0.01)
    assert sparse["counts"]["start_disagrees"] == 6
    (said,) = [c for c in sparse["contradictions"] if c.startswith("start model and images")]
    assert "6 of 12 images agree" in said and "rotated relative to the others by 20 deg" in said


def test_a_start_and_a_trajectory_are_refused_together(survey: worlds.Survey, tmp_path: Path) -> None:
    start = start_of(survey, tmp_path / "start")
    both = opened(survey, tmp_path / "out", start=start, trajectory=start)
    with refused(r"--start .*start and --trajectory .*start: both give poses: omit one"):
        both.run("scan")
    assert not (tmp_path / "out" / "tiegraph.toml").exists()


def test_a_wrong_start_is_refused_before_anything_is_stored(survey: worlds.Survey, tmp_path: Path) -> None:
    (tmp_path / "notes.json").write_text("{}")
    with refused("notes.json: no model of a known kind; give a COLMAP model"):
        opened(survey, tmp_path / "out", start=tmp_path / "notes.json").run("scan")
    assert not (tmp_path / "out" / "tiegraph.toml").exists()
    start = start_of(survey, tmp_path / "start")
    (start / "cameras.txt").write_text("1 PINHOLE 320 320 211 211 160 160\n")
    with refused(r"start, camera 1: .*'cam0' have 320 x 320, those here 320 x 240"):
        opened(survey, tmp_path / "out", start=start).run("scan")


def test_a_start_is_stored_and_only_its_model_is_watched(survey: worlds.Survey, tmp_path: Path) -> None:
    start_of(survey, tmp_path / "work").rename(tmp_path / "0")
    (tmp_path / "work" / "sparse").mkdir(parents=True)
    (tmp_path / "0").rename(tmp_path / "work" / "sparse" / "0")
    words = [str(survey.images), "-o", str(tmp_path / "out"), "--start", str(tmp_path / "work"), "--until", "scan"]
    assert main([*words, "--quiet", "--pool", "serial"]) == 0
    again = tiegraph.open(out=tmp_path / "out")
    assert again.inputs.start == tmp_path / "work" and again.status()[0][1] == ""
    (tmp_path / "work" / "database.db").write_bytes(b"x")
    assert again.status()[0][1] == ""
    model = pycolmap.Reconstruction(str(tmp_path / "work" / "sparse" / "0"))
    model.write_binary(str(tmp_path / "work" / "sparse" / "0"))
    assert again.status()[0][1] == f"changed: --start {tmp_path / 'work' / 'sparse' / '0'}"


_MOVED = transforms.rigid(Rotation.from_rotvec([0.1, -0.2, 2.1]).as_matrix(), np.array([400.0, -90.0, 12.0]))


def odometry_of(made: worlds.Survey, folder: Path) -> Path:
    """A TUM file of each pass, the second in a frame that nothing tells."""
    folder.mkdir()
    for name in ("up", "down"):
        keys = sorted(key for key in made.world_from_rig if key.startswith(f"{name}/"))
        poses = np.array([made.world_from_rig[key] for key in keys])
        moved = {"up": np.eye(4), "down": _MOVED}[name] @ poses
        write_tum(folder / f"vo_{name}.tum", np.array([made.times_s[key] for key in keys]), moved)
    return folder


def test_two_passes_with_odometry_of_their_own_end_in_one_model(tmp_path: Path) -> None:
    made = worlds.make_survey(tmp_path / "images", frames=4)
    write_rig_toml(made.rig, tmp_path / "rig.toml")
    given = {
        "rig": tmp_path / "rig.toml",
        "times": worlds.write_times(made, tmp_path / "times.csv"),
        "trajectory": odometry_of(made, tmp_path / "vo"),
    }
    settings = {"masks": {"source": "none"}, "candidates": {"sources": ["poses"]}}
    project = tiegraph.open(made.images, tmp_path / "out", pool="serial", settings=settings, **given).run("georef")
    scene = project.scene()
    assert scene.prior == "odometry", "no pass is placed by what holds for another"
    notes = " ".join(dict((name, receipt) for name, _, receipt in project.status())["candidates"]["notes"])
    assert "2 passes have poses in separate worlds" in notes
    assert "are not in one world" in notes
    poses = model_poses(project.model(), scene)
    assert poses.placed.all() and len(scene) == 16
    truth = made.centres_m(list(scene.names))
    fit = umeyama(poses.centres(), truth)
    assert 1e-5 < np.sqrt(np.mean(np.sum((fit(poses.centres()) - truth) ** 2, axis=1))) < 0.03
