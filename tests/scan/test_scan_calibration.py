"""A single camera's calibration, in words or as a file arrives at the camera, or it is said why."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scan_worlds import exif_of, papers_rig, picture, scan

from said import refused, says
from tiegraph.cli.main import main
from tiegraph.scan.cameras import read_camera
from tiegraph.scan.tuning import RigTuning

RIG = RigTuning()

# One camera, as each program writes it: OpenCV and Kalibr count pixels from the centre of the first one.
PARAMS = [60.0, 61.0, 32.5, 24.5, 0.01, -0.02, 0.001, -0.002]
WORDS = "OPENCV,64x48," + ",".join(map(str, PARAMS))
COLMAP = (
    "# Camera list\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 OPENCV 64 48 " + " ".join(map(str, PARAMS)) + "\n"
)
KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [60.0, 61.0, 32.0, 24.0]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
"""
ROS = """image_width: 64
image_height: 48
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [60.0, 0.0, 32.0, 0.0, 61.0, 24.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.01, -0.02, 0.001, -0.002, 0.0]
"""
BLOCK = KALIBR.replace("intrinsics: [60.0, 61.0, 32.0, 24.0]", "intrinsics:\n  - 60.0\n  - 61.0\n  - 32.0\n  - 24.0")
TOML = f'[camera]\nmodel = "OPENCV"\nsize = [64, 48]\nparams = {PARAMS}\n'
ONE = f'[[sensors]]\nname = "a"\ncamera = {{model = "OPENCV", size = [64, 48], params = {PARAMS}}}\n'


def _opencv(path: Path) -> None:
    out = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    out.write("image_width", 64)
    out.write("image_height", 48)
    out.write("camera_matrix", np.array([[60.0, 0, 32], [0, 61, 24], [0, 0, 1]]))
    out.write("distortion_coefficients", np.array([[0.01, -0.02, 0.001, -0.002, 0.0]]))
    out.release()


def _photographs(folder: Path, size: tuple[int, int] = (64, 48), count: int = 3) -> Path:
    for k in range(count):
        picture(folder / f"IMG_{k}.jpg", size)
    return folder


@pytest.mark.parametrize(
    "name, content",
    [("", WORDS), ("cameras.txt", COLMAP), ("camchain.yaml", KALIBR), ("block.yaml", BLOCK), ("left.yaml", ROS),
     ("cv.yml", None), ("cv.xml", None), ("rig.toml", TOML), ("one.toml", ONE)],
)  # fmt: skip
def test_one_camera_in_every_form(tmp_path: Path, name: str, content: str | None) -> None:
    path = tmp_path / name
    if name and content is None:
        _opencv(path)
    elif name:
        path.write_text(str(content))
    given = str(path) if name else WORDS
    scene = scan(_photographs(tmp_path / "in"), camera=given)
    camera = scene.rigs[0].sensors[0].camera
    assert camera.model.name == "OPENCV" and (camera.width, camera.height) == (64, 48)
    np.testing.assert_allclose(camera.params, PARAMS, atol=1e-12)
    assert camera.has_prior_focal_length
    assert any("camera from" in n and (path.name if name else "--camera") in n for n in scene.notes)
    assert not any(str(tmp_path) in n for n in scene.notes), "no folder of this machine"


def test_models_of_other_programs(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(KALIBR.replace("radtan", "equidistant"))
    assert read_camera(str(path), RIG).model == "OPENCV_FISHEYE"
    path.write_text(ROS.replace("-0.002, 0.0]", "-0.002, 0.003]"))
    found = read_camera(str(path), RIG)
    assert found.model == "FULL_OPENCV" and found.params == (*PARAMS, 0.003, 0.0, 0.0, 0.0)


def test_parameters_of_another_size_are_rescaled_and_of_another_shape_refused(tmp_path: Path) -> None:
    camera = scan(_photographs(tmp_path / "in", (128, 96)), camera=WORDS).rigs[0].sensors[0].camera
    np.testing.assert_allclose(camera.params[:4], 2 * np.array(PARAMS[:4]), atol=1e-9)
    with refused(r"--camera OPENCV.* is for 64 x 48 images, but its images have 64 x 64"):
        scan(_photographs(tmp_path / "square", (64, 64)), camera=WORDS)


@pytest.mark.parametrize(
    "text, words",
    [
        ("OPENCV,60,61,32", r"--camera OPENCV,60,61,32: OPENCV has 8 parameters \(fx, fy, cx, cy, k1, .*\), got 3"),
        (
            "OPENVC,60",
            r"'OPENVC' is no camera model; perhaps you meant 'OPENCV'\?; give MODEL,.*cameras.txt",
        ),
        ("PINHOLE,60,61,32,x", "'x' is no number; give MODEL"),
        ("PINHOLE,64x48,60,61,3200,24", r"principal point \(3200, 24\) is not inside the 64 x 48 image"),
        ("nowhere/cameras.txt", "nowhere/cameras.txt: no such file; give MODEL"),
    ],
)
def test_words_that_cannot_be_meant(tmp_path: Path, text: str, words: str, capsys: pytest.CaptureFixture) -> None:
    with refused(words):
        read_camera(text, RIG)
    images = _photographs(tmp_path / "in", count=2)
    assert main(["run", str(images), "-o", str(tmp_path / "out"), "--calibration", text]) == 2
    assert not (tmp_path / "out").exists() and "--camera" in capsys.readouterr().err


@pytest.mark.parametrize(
    "content, words",
    [
        (COLMAP + "2 PINHOLE 64 48 60 60 32 24\n", r"2 cameras \(1, 2\); keep the one"),
        (COLMAP.replace("-0.002\n", "\n"), r"line 3: OPENCV has 8 parameters .*, got 7"),
        (KALIBR + KALIBR.replace("cam0", "cam1"), r"2 cameras \(cam0, cam1\); keep the one"),
        (KALIBR.replace("pinhole", "omni"), "xi = 60: k1 = 0.01, which no camera model|5 expected"),
        (KALIBR.replace(", 24.0]", "]"), r"intrinsics \(fu, fv, pu, pv\): 3 numbers, 4 expected"),
        (ROS.replace(", 0.0, 0.0, 1.0]", "]"), "camera_matrix: 6 numbers, 9 expected"),
        ("hello: world\n", "no calibration that is known; known are COLMAP"),
    ],
)
def test_files_that_cannot_be_meant(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "c.txt").write_text(content)
    with refused(words, "c.txt"):
        read_camera(str(tmp_path / "c.txt"), RIG)


def test_several_cameras_need_a_rig_file_and_photographs_of_others_keep_theirs(tmp_path: Path) -> None:
    with refused(r"images are of 3 cameras: cam0 \(64 x 48\), .* in a rig.toml"):
        scan(papers_rig(tmp_path / "rig"), camera=WORDS)
    for k in range(3):
        picture(tmp_path / "two" / f"IMG_{k}.jpg", exif=exif_of(make="A", model="B"))
        picture(tmp_path / "two" / f"P{k}.jpg", (60, 60), exif=exif_of(make="C", model="D"))
    scene = scan(tmp_path / "two", camera=WORDS)
    taken = next(s.camera for s in scene.all_sensors if s.camera.width == 64)
    np.testing.assert_allclose(taken.params, PARAMS)
    assert says(scene.notes, "1 other cameras keep what EXIF says")
