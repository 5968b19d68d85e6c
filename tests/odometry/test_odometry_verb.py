"""`tiegraph odometry` from rendered images to a trajectory that `run --trajectory` reads, and what it refuses."""

import shutil

import cv2
import numpy as np
import pytest

from odometry.odometry_world import images, rig_of, stereo, true_path
from tiegraph.api import open_project
from tiegraph.cli.main import main
from tiegraph.errors import InputError
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.posefile import FREE_UNIT, read_poses

FRAMES, CAMERA = 8, "PINHOLE,320x240,250,250,162,117"


def written(folder, frames):
    """images/left, images/right and rig.toml."""
    for frame in range(frames):
        for camera, image in images(stereo(), frame).items():
            path = folder / "images" / stereo().names[camera] / f"{frame:06d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), image)
    write_rig_toml(rig_of(stereo()), folder / "rig.toml")
    return folder


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return written(tmp_path_factory.mktemp("drive"), FRAMES)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Its first two frames, for what is refused before any is followed."""
    return written(tmp_path_factory.mktemp("start"), 2)


def opened(survey, out, **more):
    return open_project(survey / "images", out, pool="serial", **more)


def run(folder, *arguments, images="images"):
    return main(["odometry", str(folder / images), "--pool", "serial", "--quiet", *map(str, arguments)])


@pytest.mark.slow
def test_what_the_verb_writes_is_read_by_run(survey, tmp_path):
    out = tmp_path / "vo.tum"
    assert run(survey, "--rig", survey / "rig.toml", "-o", out) == 0
    truth = true_path(list(range(FRAMES)))
    found = read_poses(out).poses
    assert 1e-6 < np.linalg.norm((found - truth)[:, :3, 3], axis=1).max() < 0.02
    table = np.genfromtxt(tmp_path / "vo.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["image"].tolist() == [f"left/{k:06d}.png" for k in range(FRAMES)]
    assert table["sigma_x"][0] == 0 < table["sigma_x"][-1] < 0.05
    for times in (None, tmp_path / "vo.csv"):
        given = {"rig": str(survey / "rig.toml"), "trajectory": out, "times": times}
        scene = opened(survey, tmp_path / f"out{times is None}", **given).run("scan").scene()
        assert scene.prior == "trajectory" and not scene.started
        assert np.allclose(scene.world_from_rig, found, atol=1e-6)


@pytest.mark.slow
def test_a_run_follows_its_own_images(survey, tmp_path):
    truth = true_path(list(range(FRAMES)))
    project = opened(survey, tmp_path / "out", rig=str(survey / "rig.toml"), trajectory="auto")
    scene = project.run("scan").scene()
    assert scene.prior == "trajectory" and not scene.started
    assert 1e-6 < np.linalg.norm((scene.world_from_rig - truth)[:, :3, 3], axis=1).max() < 0.02
    assert np.allclose(read_poses(tmp_path / "out" / "odometry" / "path.tum").poses, scene.world_from_rig, atol=1e-6)
    again = open_project(out=tmp_path / "out")
    assert str(again.inputs.trajectory) == "auto" and again.status()[0][1] == ""
    plain = open_project(out=tmp_path / "out", pool="serial", unset=("trajectory",)).run("scan")
    assert plain.scene().prior == "none" and not (tmp_path / "out" / "odometry").exists()


@pytest.mark.slow
def test_a_run_that_is_to_follow_its_images_needs_a_calibrated_rig(survey, tmp_path):
    project = opened(survey, tmp_path / "out", trajectory="auto")
    with pytest.raises(InputError, match="calibrat"):
        project.run("scan")
    assert not (tmp_path / "out" / "images").exists()  # said before any is prepared


@pytest.mark.slow
def test_a_single_camera_says_that_it_has_no_scale_and_holds_nothing(survey, tmp_path, capsys):
    arguments = ["odometry", str(survey / "images" / "left"), "--pool", "serial", "--camera", CAMERA]
    assert main([*arguments, "-o", str(tmp_path / "vo.tum")]) == 0
    assert "no scale" in "".join(capsys.readouterr()) and FREE_UNIT in (tmp_path / "vo.tum").read_text()
    given = {"camera": CAMERA, "trajectory": tmp_path / "vo.tum"}
    scene = open_project(survey / "images" / "left", tmp_path / "out", pool="serial", **given).run("scan").scene()
    assert scene.started and not scene.measured_positions().any() and scene.has_orientations()


@pytest.mark.slow
def test_an_image_that_cannot_be_read_and_one_of_another_size_are_told_and_not_fatal(survey, tmp_path, capsys):
    folder = shutil.copytree(survey / "images", tmp_path / "images")
    (folder / "left" / "000003.png").write_bytes(b"no image")
    small = cv2.imread(str(folder / "right" / "000005.png"))[:100]
    cv2.imwrite(str(folder / "right" / "000005.png"), small)
    arguments = ["odometry", str(folder), "--pool", "serial", "--rig", str(survey / "rig.toml")]
    assert main([*arguments, "-o", str(tmp_path / "vo.tum")]) == 0
    said = "".join(capsys.readouterr())
    assert "left/000003.png" in said and "320 x 100" in said
    assert len(read_poses(tmp_path / "vo.tum").poses) >= FRAMES - 1
    assert not (tmp_path / "tiegraph.toml").exists()


def test_a_stereo_head_without_its_rig_is_refused(start, tmp_path, capsys):
    assert run(start, "-o", tmp_path / "vo.tum") == 2
    assert "its place in the rig is not known" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_is_not_written_over(start, tmp_path, capsys):
    out = tmp_path / "vo.tum"
    out.with_suffix(".csv").write_text("mine")
    assert run(start, "--rig", start / "rig.toml", "-o", out) == 2
    assert "vo.csv exists already" in capsys.readouterr().err
    assert out.with_suffix(".csv").read_text() == "mine" and not out.exists()


def test_one_frame_and_images_without_texture_are_refused(start, tmp_path, capsys):
    for folder in ("one", "grey"):
        (tmp_path / folder).mkdir()
    shutil.copy(start / "images" / "left" / "000000.png", tmp_path / "one")
    for frame in range(3):
        cv2.imwrite(str(tmp_path / "grey" / f"{frame:06d}.png"), np.full((240, 320), 128 + frame, np.uint8))
    assert run(tmp_path, "-o", tmp_path / "vo.tum", images="one") == 2
    assert "usable image" in capsys.readouterr().err
    assert run(tmp_path, "--camera", CAMERA, "-o", tmp_path / "vo.tum", images="grey") != 0
    assert "no pose was found" in capsys.readouterr().err and not (tmp_path / "vo.tum").exists()
