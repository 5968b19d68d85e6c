"""`tiegraph calibrate` from rendered images and real photographs to a rig file that `run --rig` reads, and refusals."""

import json
import os
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibrate.board_world import boards_of_rig, camera, render_rig, rig_pose
from tiegraph.calibrate.adjust import State
from tiegraph.calibrate.board import read_board
from tiegraph.cli.main import main
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.pipeline.calibrate import check_wide
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import Tuning as ScanTuning

pytestmark = pytest.mark.slow
WORDS = "charuco:18x13:0.018:0.0115:4X4_250"
BOARD = read_board(WORDS)
SIZE = (960, 720)
NAMES = ["cam0", "cam1", "cam2"]


def truth() -> State:
    """Three cameras in a fan of 50 degrees that see 51: the outer ones share no view of the board."""
    cameras = [
        camera("OPENCV", [1000 + k, 1002 - k, 485 - 3 * k, 358 + 4 * k, -0.2 + 0.02 * k, 0.05, 0.0005, -0.0003], SIZE)
        for k in range(3)
    ]
    sensors = [np.eye(4), rig_pose((1, 25, -2), (0.12, 0.005, 0.01)), rig_pose((-2, 50, 1), (0.23, -0.004, -0.03))]
    boards = boards_of_rig(BOARD, cameras, sensors, count=20, seed=1, depth_m=(0.3, 0.5))
    return State(tuple(cameras), np.stack(sensors), boards)


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards")
    render_rig(folder / "images", BOARD, truth(), NAMES)
    names = [{p.name for p in (folder / "images" / n).iterdir()} for n in NAMES]
    assert len(names[0] & names[1]) > 5 < len(names[1] & names[2]) and not names[0] & names[2]
    return folder


@pytest.fixture(scope="module")
def made(survey):
    arguments = ["calibrate", str(survey / "images"), "--board", WORDS, "-o", str(survey / "rig.toml")]
    assert main([*arguments, "--pool", "serial", "--quiet"]) == 0
    return survey


def test_a_rendered_rig_is_calibrated_to_the_truth(made):
    """Focal lengths to 0.05 %, turns to 0.01 degrees, places to 0.1 mm."""
    (rig,), true = read_rig_file(made / "rig.toml", ScanTuning().rig), truth()
    assert [s.name for s in rig.sensors] == NAMES and rig.synchronised and not rig.fixed
    for k, sensor in enumerate(rig.sensors):
        assert sensor.model == "OPENCV" and sensor.params is not None and sensor.body_from_sensor is not None
        assert 1e-7 < np.abs(np.array(sensor.params[:2]) / true.cameras[k].params[:2] - 1).max() < 5e-4
        assert 0 < (sensor.camera_sigma_px or 0) < 0.5
        pose = transforms.invert(true.sensor_from_rig[k])
        if k == 0:
            np.testing.assert_array_equal(sensor.body_from_sensor, pose)
            continue
        turn = float(transforms.angle_deg(sensor.body_from_sensor[:3, :3], pose[:3, :3]))
        place = float(np.linalg.norm(sensor.body_from_sensor[:3, 3] - pose[:3, 3]))
        assert 1e-5 < turn < 0.01 and 1e-7 < place < 1e-4
        assert sensor.sigma_deg is not None and 0.1 * turn < np.sqrt(3) * sensor.sigma_deg < 0.02
        assert sensor.sigma_m is not None and 0.1 * place < np.sqrt(3) * sensor.sigma_m < 2e-4


def test_the_other_files_say_the_same(made):
    folder = made / "rig_calibration"
    (rig,), (other,) = (read_rig_file(p, ScanTuning().rig) for p in (made / "rig.toml", folder / "rig_config.json"))
    (chain,) = read_rig_file(folder / "camchain.yaml", ScanTuning().rig)
    for one in (other, chain):
        for a, b in zip(rig.sensors, one.sensors):
            np.testing.assert_allclose(a.body_from_sensor, b.body_from_sensor, atol=1e-9)
            np.testing.assert_allclose(a.params, b.params)
    said = (folder / "summary.md").read_text()
    shown = re.findall(r"\]\((\S+\.png)\)", said)
    assert len(shown) == 3 and all(cv2.imread(str(folder / name)) is not None for name in shown)
    assert "cam1: no board in 1 of 16 images: cam1/007.png" in said
    assert "All lengths come from the size of the board's squares" in said


def test_scan_takes_the_rig_as_it_is_written(made, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(made / "images", tmp_path / "images")
    assert main(["run", str(tmp_path / "images"), "-o", str(out), "--rig", str(made / "rig.toml"), "--until", "scan",
                 "--pool", "serial", "--quiet"]) == 0  # fmt: skip
    sensors = json.loads((out / "scene.json").read_text())["rigs"][0]["sensors"]
    assert [s["name"] for s in sensors] == NAMES
    assert all(s["sigma_deg"] > 0 and s["sigma_m"] > 0 for s in sensors[1:])


# --- what is refused ------------------------------------------------------------------------------------------------


def pictures(folder, names, size=(320, 240)):
    """Grey images, each another."""
    for grey, name in enumerate(names, len(list(folder.rglob("*.png")))):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), np.full((size[1], size[0]), 20 + grey, np.uint8))


def refused(capsys, tmp_path, *more, code=2):
    """What is said of a calibration that is refused; nothing is written."""
    before = sorted(tmp_path.rglob("*.toml"))
    arguments = ["calibrate", str(tmp_path / "images"), "-o", str(tmp_path / "rig.toml"), "--pool", "serial"]
    given = more if "--board" in more else (*more, "--board", WORDS)
    assert main([*arguments, *given]) == code and sorted(tmp_path.rglob("*.toml")) == before
    assert not (tmp_path / "rig_calibration").exists()
    return " ".join(capsys.readouterr().err.split())


def test_images_without_a_board_and_of_two_cameras_in_one_folder_are_refused(capsys, tmp_path):
    pictures(tmp_path / "images", [f"{k}.png" for k in range(3)])
    assert "camera: the board was found in none of its 3 images" in refused(capsys, tmp_path)
    shutil.rmtree(tmp_path / "images")
    pictures(tmp_path / "images", [f"{side}{k:02d}.png" for side in ("left", "right") for k in range(3)])
    said = refused(capsys, tmp_path)
    assert "3 numbers stand behind 'left' and behind 'right'" in said and "(left/, right/)" in said
    assert "found in none of its 6 images" in refused(capsys, tmp_path, "--layout", "sequence")


def test_images_of_different_sizes_are_refused_by_name(capsys, tmp_path):
    pictures(tmp_path / "images", ["cam0/1.png", "cam0/2.png", "cam1/1.png", "cam1/2.png"])
    pictures(tmp_path / "images", ["cam1/3.png"], (300, 240))
    said = refused(capsys, tmp_path)
    assert "cam1/3.png has 300 x 240 pixels, but most images of cam1 have 320 x 240" in said


def test_names_that_do_not_say_the_instant_are_refused(capsys, tmp_path):
    pictures(tmp_path / "images", ["cam0/a.png", "cam0/b.png", "cam1/c.png", "cam1/d.png"])
    assert "do not show which were taken at one instant (as cam0/a.png and cam1/c.png)" in refused(capsys, tmp_path)
    assert "cam0: the board was found in none" in refused(capsys, tmp_path, "--frames", "order")


def test_wrong_words_are_refused_before_images_are_read(capsys, tmp_path):
    assert "the side of a square is missing" in refused(capsys, tmp_path, "--board", "checker:9x6")
    assert "25 mm are 0.025" in refused(capsys, tmp_path, "--board", "checker:9x6:25")
    pictures(tmp_path / "images", ["1.png", "2.png"])
    assert "2 images, and a camera needs the board in 3 at least" in refused(capsys, tmp_path)
    pictures(tmp_path / "images", ["3.png"])
    said = refused(capsys, tmp_path, "--model", "OPENVC")
    assert "no camera model 'OPENVC'; perhaps you meant 'OPENCV'?" in said
    assert "no camera 'cam7'" in refused(capsys, tmp_path, "--model", "OPENCV", "cam7=RADIAL")


def test_a_file_that_is_there_is_kept(capsys, tmp_path):
    (tmp_path / "rig.toml").write_text("mine")
    assert "rig.toml exists already" in refused(capsys, tmp_path)
    assert (tmp_path / "rig.toml").read_text() == "mine"
    assert main(["calibrate", str(tmp_path), "--board", WORDS, "-o", str(tmp_path / "rig.yaml")]) == 2
    assert "ends in .toml" in capsys.readouterr().err


def test_wide_cameras_must_be_there_and_not_all():
    check_wide(["cam1"], NAMES)
    no_such = "--wide fish: no such camera; there are cam0, cam1, cam2"
    for wide, said in ((["fish"], no_such), (NAMES, "that is every camera")):
        with pytest.raises(InputError, match=said):
            check_wide(wide, NAMES)


SAMPLES = Path(os.environ.get("OPENCV_SAMPLES", "/usr/share/doc/opencv-doc/examples/data"))


@pytest.mark.skipif(not (SAMPLES / "left01.jpg").exists(), reason="Debian's opencv-doc is not there (OPENCV_SAMPLES)")
def test_a_real_stereo_head_is_calibrated_to_a_seventh_of_a_pixel(capsys, tmp_path):
    """Its board was trimmed: windows that reach over the edge made it a third of a pixel."""
    for side in ("left", "right"):
        (tmp_path / "images" / side).mkdir(parents=True)
        for file in sorted(SAMPLES.glob(f"{side}[01][0-9].jpg")):
            shutil.copy(file, tmp_path / "images" / side)
    arguments = ["calibrate", str(tmp_path / "images"), "--board", "checker:9x6:0.025"]
    assert main([*arguments, "-o", str(tmp_path / "rig.toml"), "--pool", "serial"]) == 0
    assert "left and right are 0.083" in " ".join(capsys.readouterr().err.split())
    (rig,) = read_rig_file(tmp_path / "rig.toml", ScanTuning().rig)
    left, right = rig.sensors
    assert left.params is not None and right.body_from_sensor is not None
    assert abs(left.params[0] - 535.9) < 3.0  # OpenCV's own left_intrinsics.yml, fewer images and another lens model
    assert 0.0829 < np.linalg.norm(right.body_from_sensor[:3, 3]) < 0.0835
    rows = [r.split("|") for r in (tmp_path / "rig_calibration/summary.md").read_text().splitlines()]
    fits = [[float(v) for v in r[4:6]] for r in rows if len(r) > 6 and r[1].strip() in ("left", "right")][:2]
    assert len(fits) == 2 and all(0.1 < rms <= held_out < 0.16 for rms, held_out in fits)
