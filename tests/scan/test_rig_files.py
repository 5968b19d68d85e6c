"""Rigs as rig.toml, COLMAP's rig_config and presets; what makes no sense is refused with file, line, key and value."""

import json
import re
from contextlib import nullcontext
from itertools import product
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_worlds import Survey, data, papers_rig, picture, scan

from near import baselines_m
from said import refused, says
from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, from_quaternion_wxyz, invert
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import (
    AXES,
    orient,
    preset,
    preset_sizes,
    yaw_pitch_roll_deg,
)
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import RigTuning

RIG = RigTuning()
TOML = """
name = "boat"
axes = "flu"
antenna_m = [0.9, 0.6, 0.3]
[camera]
hfov_deg = 90
[[sensors]]
name = "cam0"
position_m = [0.06, 0, 0]
yaw_pitch_roll_deg = [0, 0, 0]
[[sensors]]
name = "cam1"
position_m = [0, -0.06, 0]
yaw_pitch_roll_deg = [90, 0, 0]
[[sensors]]
name = "cam2"
role = "up"
position_m = [0, 0, 0.07]
yaw_pitch_roll_deg = [0, 90, 0]
"""


def toml(folder: Path, text: str = TOML) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


@pytest.mark.slow
@settings(deadline=None)
@given(st.floats(-179, 179), st.floats(-90, 90), st.floats(-179, 179), st.sampled_from(sorted(AXES)))
def test_angles_and_rotation_are_inverse(yaw: float, pitch: float, roll: float, axes: str) -> None:
    rotation = orient(yaw, pitch, roll, axes)
    assert np.allclose(orient(*yaw_pitch_roll_deg(AXES[axes] @ rotation), axes), rotation, atol=1e-6)


def test_rig_frame_is_the_first_sensor_and_the_antenna_moves_along(three_cameras: Survey, tmp_path: Path) -> None:
    rig = three_cameras.scan(rig=str(toml(tmp_path))).rigs[0]
    assert (rig.name, rig.fixed, rig.nominal, len(rig.sensors)) == ("boat", False, False, 3)
    assert np.array_equal(rig.sensors[0].sensor_from_rig, np.eye(4))
    # Body: x forward, y left, z up, camera 0 at 6 cm ahead; rig: x right, y down, z forward.
    assert rig.antenna_m == pytest.approx((-0.6, -0.3, 0.84))
    assert rig.sensors[1].optical_axis() == pytest.approx([1, 0, 0])
    assert rig.sensors[2].optical_axis() == pytest.approx([0, -1, 0]) and rig.sensors[2].role == "up"
    assert invert(rig.sensors[1].sensor_from_rig)[:3, 3] == pytest.approx([0.06, 0, -0.06])
    assert baselines_m(rig)[0, 1] == pytest.approx(0.06 * np.sqrt(2))


def test_a_fisheye_sees_more_than_a_half_circle_and_a_perspective_image_does_not(
    three_cameras: Survey, tmp_path: Path
) -> None:
    fisheye = TOML.replace("hfov_deg = 90", 'model = "OPENCV_FISHEYE"\nhfov_deg = 200')
    camera = three_cameras.scan(rig=str(toml(tmp_path, fisheye))).sensor_of(0).camera
    assert camera.focal_length_x == pytest.approx(camera.width / np.radians(200), rel=1e-6)
    with refused(r"line 6.*hfov_deg = 200.*1 to 170 degrees; give a fisheye model"):
        three_cameras.scan(rig=str(toml(tmp_path, TOML.replace("hfov_deg = 90", "hfov_deg = 200"))))


def test_all_ways_to_write_an_orientation_agree(tmp_path: Path) -> None:
    q = [0.5**0.5, 0.0, 0.5**0.5, 0.0]  # 90 degrees about y: forward goes to the right
    rotation = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    pose = [[*r, t] for r, t in zip(rotation, (1.0, 2.0, 3.0))]
    ways = [
        "yaw_pitch_roll_deg = [90, 0, 0]\nposition_m = [1, 2, 3]",
        f"body_from_sensor_wxyz = {q}\nposition_m = [1, 2, 3]",
        f"body_from_sensor = {rotation}\nposition_m = [1, 2, 3]",
        f"body_from_sensor = {pose}",
        f"body_from_sensor = {[*pose, [0.0, 0.0, 0.0, 1.0]]}",
    ]
    for way in ways:
        spec = read_rig_file(toml(tmp_path, f"[[sensors]]\nname = 'a'\n{way}\n"), RIG)[0]
        assert np.allclose(spec.sensors[0].body_from_sensor, [*pose, [0, 0, 0, 1]]), way


PAIR = '[[pairs]]\nsensors = ["cam0", "cam1"]\n'
ANTENNA, PLACE, TURN = "antenna_m = [0.9, 0.6, 0.3]", "position_m = [0, -0.06, 0]", "yaw_pitch_roll_deg = [90, 0, 0]"
LENS, FIRST, SECOND, ROLE = "hfov_deg = 90", 'name = "cam0"', 'name = "cam1"', 'role = "up"'
NAN_MATRIX = "body_from_sensor = [[1, 0, 0, nan], [0, 1, 0, 0], [0, 0, 1, 0]]"
BOTTOM = "body_from_sensor = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]"
HUGE = "1" + "0" * 400  # no float holds it
MISTAKES = [
    ("antena_m = [0, 0, 0]", ANTENNA, "line 4: unknown key 'antena_m'.*'antenna_m'"),
    ('nmae = "cam1"', SECOND, "line 12: unknown key 'nmae' in sensor.*perhaps you meant 'name'"),
    ('role = "upp"', ROLE, "line 17: role = 'upp': valid are side, up, wide; perhaps you meant 'up'"),
    ('role = "front"', ROLE, "line 17: role = 'front': valid are side, up, wide"),
    ("position_m = [0, 0]", "position_m = [0, 0, 0.07]", "line 18: position_m = .*list of 3 finite numbers"),
    ("position_m = [0, 10000, 0]", PLACE, "line 13: sensor 'cam1' is 10000 m from 'cam0', more than 100 m"),
    ("position_m = [0, 1e308, 0]", PLACE, "line 13: sensor 'cam1' is .* more than 100 m"),
    (f"position_m = [0, {HUGE}, 0]", PLACE, "line 13: position_m = .* finite"),
    ("antenna_m = [900, 600, 300]", ANTENNA, r"line 4: antenna_m: 1122\.\d* m from the nearest camera"),
    ("yaw_pitch_roll_deg = [nan, 0, 0]", TURN, "line 14: yaw_pitch_roll_deg"),
    ("yaw_pitch_roll_deg = [9e9, 0, 0]", TURN, "line 14: yaw_pitch_roll_deg = .* degrees"),
    ("body_from_sensor_wxyz = [1, 1, 0, 0]", TURN, "line 14: .*length 1.414, not 1"),
    ("body_from_sensor_wxyz = [0, 0, 0, 0]", TURN, "line 14: .* length 0, not 1"),
    ("body_from_sensor = [[1,0,0],[0,1,0],[0,0,-1]]", TURN, "line 14:.*a rotation"),
    ("body_from_sensor = [[1, 0], [0, 1]]", TURN, "line 14: .*3 rows"),
    (NAN_MATRIX, f"{PLACE}\n{TURN}", "line 13: body_from_sensor: .* finite"),
    (BOTTOM, f"{PLACE}\n{TURN}", "line 13: body_from_sensor: the fourth row"),
    (f"{TURN}\nsigma_m = 1e300", TURN, "line 15: sigma_m = 1e.300: 100 at most"),
    (f"{TURN}\nsigma_deg = inf", TURN, "line 15: sigma_deg = inf: expected a finite number"),
    ("hfov = 90", LENS, "line 6: unknown key 'hfov' in the camera.*'hfov_deg'"),
    ("hfov_deg = 400", LENS, "line 6: hfov_deg = 400: expected a number above 0"),
    ("hfov_deg = nan", LENS, "line 6: hfov_deg = nan"),
    ("focal_px = 'x'", LENS, "line 6: focal_px = 'x'"),
    ("focal_px = 0", LENS, "line 6: focal_px = 0: expected a number above 0"),
    (f"focal_px = {HUGE}", LENS, "line 6: focal_px = 1000.*above 0"),
    ("size = [96.5, 64]\nhfov_deg = 90", LENS, "line 6: size = .* whole pixels"),
    ("size = [1e9, 1e9]\nhfov_deg = 90", LENS, "line 6: size = .* whole pixels"),
    ("params = [1, 2]", LENS, "line 6: .*params need a model"),
    ('model = "OPENCVV"', LENS, "line 6: unknown camera model 'OPENCVV'; perhaps you meant 'OPENCV'"),
    ('model = "EQUIRECTANGULAR"', LENS, "line 6: unknown camera model 'EQUIRECTANGULAR'"),
    ('model = "PINHOLE"\nparams = [1, 2, 3]', LENS, "PINHOLE has 4 parameters"),
    ("hfov_deg = 90\nfocal_px = 3", LENS, "give one of focal_px, hfov_deg"),
    ('axes = "fly"', 'axes = "flu"', "line 3: axes = 'fly'.*perhaps you meant 'flu'"),
    ("fixed = 1", 'name = "boat"', "fixed = 1: valid are false, true"),
    (FIRST, SECOND, "line 12: two sensors have the name 'cam0'"),
    ("", SECOND, "sensor 2 needs a name"),
    (SECOND[:-1], SECOND, "not a valid TOML file.*line 12"),
    ("crop_px = [0, -1, 0, 0]", ROLE, "line 17: crop_px"),
    ("", TURN, "line 13: position_m needs an orientation"),
]  # fmt: skip


@pytest.mark.parametrize("wrong, right, message", MISTAKES)
def test_mistakes_in_a_rig_toml_name_file_line_and_remedy(tmp_path: Path, wrong: str, right: str, message: str) -> None:
    assert right in TOML
    path = toml(tmp_path, TOML.replace(right, wrong, 1))
    with pytest.raises(InputError, match=message) as error:
        read_rig_file(path, RIG)
    assert str(path) in str(error.value) and len(str(error.value)) < 1000


def test_a_rig_needs_sensors_and_each_sensor_images(three_cameras: Survey, tmp_path: Path) -> None:
    for text, words in (
        ("name = 'x'", "at least one"),
        (TOML.replace('name = "cam2"', 'name = "came2"'), r"'came2'.*folders here: cam0, cam1, cam2.*meant 'cam2'"),
        (re.sub(r"yaw.*= \[0, 0, 0\]\n|pos.*0.06, 0, 0\]\n", "", TOML), "'cam0', is the reference"),
    ):
        with refused(words):
            three_cameras.scan(rig=str(toml(tmp_path, text)))


def test_images_below_no_sensor_folder_are_listed(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", cameras=4, frames=2)
    scene = scan(images, rig=str(toml(tmp_path)))
    assert len(scene) == 12 and len(scene.dropped) == 4
    assert all("cam3" in d.name and "no sensor folder" in d.reason for d in scene.dropped)


def test_a_camera_of_another_size_is_rescaled_and_of_another_shape_refused(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / "in" / f"{k}.jpg", (96, 64))
    lens = "model = 'PINHOLE'\nsize = [3072, 2048]\nparams = [2759, 2764, 1520, 1006]"
    text = f"[camera]\n{lens}\n[[sensors]]\nname = 'c'\n"
    scene = scan(tmp_path / "in", rig=str(toml(tmp_path, text)))
    camera = scene.sensor_of(0).camera
    assert (camera.width, camera.height) == (96, 64)
    assert list(camera.params) == pytest.approx([86.22, 86.375, 47.5, 31.44], abs=0.01)
    assert says(scene.notes, "rescaled by 0.03125")
    for old, new, words in (
        ("2048", "2000", "3072 x 2000.*96 x 64.*another shape"),
        ("size = [3072, 2048]\n", "", "principal point"),
    ):
        with refused(words):
            scan(tmp_path / "in", rig=str(toml(tmp_path, text.replace(old, new))))


@pytest.mark.slow
@pytest.mark.parametrize("name, cameras, up", [("ladybug5", 6, True), ("ladybug5", 5, False), ("ring:4", 4, False)])
def test_ring_presets_are_nominal_common_centre_and_equally_spaced(
    tmp_path: Path, name: str, cameras: int, up: bool
) -> None:
    rig = scan(papers_rig(tmp_path / "in", cameras=cameras, frames=1), rig=name).rigs[0]
    sides = 5 if name == "ladybug5" else 4
    assert rig.nominal and not rig.fixed and rig.known() and len(rig.sensors) == cameras
    assert np.allclose(baselines_m(rig), 0)
    first = preset(name, tuple(f"cam{k}" for k in range(cameras)), RIG).sensors[0]
    assert first.body_from_sensor == pytest.approx(np.eye(4))  # the first camera looks forward
    angles = rig.axis_angles_deg()
    for k in range(sides):
        assert angles[k, (k + 1) % sides] == pytest.approx(360 / sides)
        turn = 2 * np.pi * k / sides  # equation 3: clockwise seen from above, the first camera forward
        assert rig.sensors[k].optical_axis() == pytest.approx([np.sin(turn), 0, np.cos(turn)], abs=1e-9)
    assert [s.role for s in rig.sensors] == ["side"] * sides + ["up"] * (cameras - sides)
    if up:
        assert rig.sensors[5].optical_axis() == pytest.approx([0, -1, 0])
    camera = rig.sensors[0].camera
    assert not camera.has_prior_focal_length


def test_stereo_presets_and_folders_of_any_name(tmp_path: Path) -> None:
    for side, k in product(("right", "left"), range(2)):
        picture(tmp_path / "in" / side / f"{k}.jpg")
    rig = scan(tmp_path / "in", rig="stereo:0.5").rigs[0]
    assert [s.name for s in rig.sensors] == ["left", "right"]
    assert invert(rig.sensors[1].sensor_from_rig)[:3, 3] == pytest.approx([0.5, 0, 0])
    assert np.allclose(baselines_m(scan(tmp_path / "in", rig="stereo").rigs[0]), 0)
    for name, k in product(("aft", "bow", "stern", "alpha"), range(2)):
        picture(tmp_path / "four" / "monday" / name / f"x{k}.jpg")
    assert [s.name for s in scan(tmp_path / "four", rig="ring:4").all_sensors] == ["aft", "alpha", "bow", "stern"]


def test_presets_that_do_not_fit(three_cameras: Survey) -> None:
    for name, message in (
        ("ladybug6", "ladybug5, ring:N, stereo"),
        ("ladybug5", "6 or 5 camera.*cam0, cam1, cam2"),
        ("ring:x", "number after the colon"),
        ("ring:1", "2 or more"),
    ):
        with refused(message):
            three_cameras.scan(rig=name)
    for name in ("ring:nan", "ring:inf", "stereo:nan", "stereo:1e9", "stereo:-1", "ring:2.5"):
        with refused(name):
            preset_sizes(name, RIG)
    assert preset("single", ("",), RIG).sensors[0].name == "camera"


def colmap(folder: Path, *cameras: dict) -> str:
    path = folder / "rig_config.json"
    path.write_text(json.dumps([{"cameras": list(cameras)}], indent=1))
    return str(path)


LEFT = {"image_prefix": "cam1/", "cam_from_rig_rotation": [0, 0, 1, 0], "cam_from_rig_translation": [0, 0, -0.03]}
REF = {"image_prefix": "cam0/", "ref_sensor": True}
FREE = {"image_prefix": "cam2/", "camera_model_name": "PINHOLE", "camera_params": [50, 50, 32, 24]}


def test_colmap_rig_config_puts_the_reference_first(three_cameras: Survey, tmp_path: Path) -> None:
    rig = three_cameras.scan(rig=colmap(tmp_path, LEFT, REF, FREE)).rigs[0]
    assert [s.name for s in rig.sensors] == ["cam0", "cam1", "cam2"]
    given = from_quaternion_wxyz(np.array([0, 0, 1.0, 0]), np.array([0, 0, -0.03]))
    assert np.allclose(rig.sensors[1].sensor_from_rig, given)
    assert rig.sensors[2].sensor_from_rig is None and not rig.known() and not rig.nominal
    camera = rig.sensors[2].camera
    assert camera.has_prior_focal_length and camera.model.name == "PINHOLE"


@pytest.mark.parametrize(
    ("prefixes", "names"),
    [
        (("left_", "right_"), "{}_{:04d}.jpg"),
        (("imgs/left_", "imgs/right_"), "imgs/{}_{:04d}.jpg"),
        (("left", "right"), "left_right/{}/{:04d}.jpg"),  # folders without the slash
        (("left_", "right_"), "up/{}_{:04d}.jpg"),
        (("left_c", "right_c"), "{}_camera/{:04d}.jpg"),  # the beginnings of folders' names
    ],
)
def test_an_image_prefix_of_colmap_may_begin_names(tmp_path: Path, prefixes: tuple, names: str) -> None:
    for side, k in product(("left", "right"), range(3)):
        picture(tmp_path / "in" / names.format(side, k))
    one, other = ({**REF, "image_prefix": prefixes[0]}, {**LEFT, "image_prefix": prefixes[1]})
    scene = scan(tmp_path / "in", rig=colmap(tmp_path, one, other))
    assert scene.sensor.tolist() == [0] * 3 + [1] * 3 and scene.frame.tolist() == [0, 1, 2] * 2
    assert len(scene.sequences) == 1


FAR = {**LEFT, "cam_from_rig_translation": [0, 0, 1e4]}


@pytest.mark.parametrize(
    "cameras, message",
    [
        ([REF, {**LEFT, "image_prefx": 1}], r"unknown key 'image_prefx'.*'image_prefix'"),
        ([REF, {**LEFT, "ref_sensor": True}], "exactly one camera must have ref_sensor, got 2"),
        ([REF, {"image_prefix": "cam1/", "cam_from_rig_rotation": [1, 0, 0, 0]}], "belong together"),
        ([REF, {**LEFT, "cam_from_rig_rotation": [1, 0, 0]}], "list of 4"),
        ([REF, {**LEFT, "cam_from_rig_rotation": [0, 0, 0, 0]}], "length 0, not 1"),
        ([{**LEFT, "cam_from_rig_translation": [0, 0, float("nan")]}, REF], "cam_from_rig_translation"),
        ([REF, FAR], "sensor 'cam1' is 10000 m from 'cam0'"),
        ([REF, {**LEFT, "camera_model_name": "PINHOL", "camera_params": [1] * 4}], "perhaps you meant 'PINHOLE'"),
        ([REF, {**LEFT, "camera_model_name": "PINHOLE"}], "belong together"),
        ([REF, {**FREE, "camera_params": [float("inf"), 50, 32, 24]}], "camera_params"),
        ([REF, {"ref_sensor": False}], "needs an image_prefix"),
        ([REF, {**LEFT, "image_prefix": "cam0/"}], "same folder"),
        ("{", "line 1: not valid JSON"),
        ("{}", "a list of rigs"),
        ('[{"cameras": []}]', "a list of cameras"),
    ],
)
def test_mistakes_in_a_rig_config(tmp_path: Path, cameras: list[dict] | str, message: str) -> None:
    path = Path(colmap(tmp_path, *([] if isinstance(cameras, str) else cameras)))
    if isinstance(cameras, str):
        path.write_text(cameras)
    with refused(message, str(path)):
        read_rig_file(path, RIG)


@pytest.mark.slow
def test_a_real_fisheye_rig() -> None:
    folder = data("kerry_park_360rig")
    scene = scan(folder, ScanSettings(fisheye="whole"), rig=str(folder / "rig_config.json"))
    assert (len(scene), scene.frames, scene.dropped) == (48, 24, ())
    rig = scene.rigs[0]
    assert rig.axis_angles_deg()[0, 1] == pytest.approx(180) and baselines_m(rig)[0, 1] == pytest.approx(0.0307)
    assert all(s.camera is not None and s.camera.model.name == "OPENCV_FISHEYE" for s in rig.sensors)


def test_poses_from_a_drawing_become_a_rig_toml(tmp_path: Path) -> None:
    """The canal boat's nominal rig is given as cam-from-body quaternions: the preset must agree with it."""
    nominal = json.loads(data("canal_demo", "sensors", "rig_nominal.json").read_text())
    rig = preset("ladybug5", tuple(nominal), RIG)
    reference = orient(0, 0, 0, "flu")
    for name, sensor in zip(nominal, rig.sensors):
        cam_from_body = from_quaternion_wxyz(np.array(nominal[name]["cam_from_body_qwxyz"]), np.zeros(3))[:3, :3]
        assert angle_deg(reference @ sensor.body_from_sensor[:3, :3], cam_from_body.T) < 1e-4


def test_a_key_that_is_missing_is_not_looked_for_in_the_next_sensor(tmp_path: Path) -> None:
    text = '# name = "remark"\n[[sensors]]\nfolder = "a"\n\n[[sensors]]\nname = "b"\n[sensors.camera]\nhfov_deg = 0\n'
    for rig, words in (
        (text, r"rig.toml, line 2: sensor 1 needs a name"),
        (text.replace('folder = "a"', 'name = "a"'), r"rig.toml, line 8: hfov_deg = 0"),
    ):
        with refused(words):
            read_rig_file(toml(tmp_path, rig), RIG)


def test_the_line_of_a_rig_config_is_that_of_the_camera_and_not_of_the_next_or_the_first(tmp_path: Path) -> None:
    still = {"cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0, 0, 0]}
    first, third = {"ref_sensor": True, "image_prefix": "a/"}, {**still, "image_prefix": "c/"}
    short = {**still, "cam_from_rig_translation": [0, 0], "image_prefix": "b/"}
    nameless = {n: v for n, v in short.items() if n != "image_prefix"}
    second = [{"image_prefix": "cam9/", "ref_sensor": True}, {**FAR, "image_prefix": "cam8/"}]
    for rigs, word, number, message in (
        ([[first, short, third]], "translation", 0, r"cam_from_rig_translation = \[0, 0\]"),
        ([[first, nameless, third]], "   {", 1, "camera 2 needs an image_prefix"),
        ([[REF, LEFT], second], "translation", 1, "sensor 'cam8' is 10000 m"),
    ):
        path = tmp_path / "rig_config.json"
        path.write_text(json.dumps([{"cameras": rig} for rig in rigs], indent=1))
        line = [k for k, text in enumerate(path.read_text().split("\n"), 1) if word in text][number]
        with refused(rf"rig_config.json, line {line}: {message}"):
            read_rig_file(path, RIG)


def test_a_rig_is_not_named_after_its_file(tmp_path: Path) -> None:
    path = tmp_path / "final_v3 (2).toml"
    path.write_text('[[sensors]]\nname = "a"\n')
    assert read_rig_file(path, RIG)[0].name == "rig"
    path.write_text('name = "boat"\n[[sensors]]\nname = "a"\n')
    assert read_rig_file(path, RIG)[0].name == "boat"
    (tmp_path / "export17.json").write_text(json.dumps([{"cameras": [{"ref_sensor": True, "image_prefix": "a"}]}]))
    assert read_rig_file(tmp_path / "export17.json", RIG)[0].name == "rig"


@pytest.mark.parametrize(
    "text, message",
    [
        (PAIR + "baseline_m = 0.1\nbaseline_sigma_m = 0\n", "line 23: baseline_sigma_m = 0: expected 1e-06 to 100"),
        (PAIR + "baseline_m = 0.1\nbaseline_sigma_m = -1\n", "line 23: baseline_sigma_m = -1: .*finite number, 0"),
        (PAIR + "baseline_m = 0.1\nbaseline_sigma_m = inf\n", "line 23: baseline_sigma_m = inf: .*finite number"),
        (PAIR + "baseline_m = 1e4\nbaseline_sigma_m = 1\n", "line 22: baseline_m = 10000: expected 0 to 100"),
        (PAIR + "baseline_m = 0.5\n", "baseline_m and baseline_sigma_m belong together"),
        (PAIR + "axis_deg = -3\n", "0 or more"),
        (PAIR + "axis_deg = 190\naxis_sigma_deg = 1\n", "line 22: axis_deg = 190: expected 0 to 180"),
        (PAIR + "axis_deg = 90\naxis_sigma_deg = 0\n", "line 23: axis_sigma_deg = 0: expected"),
        (PAIR + "length = 3\n", "unknown key"),
        (PAIR, "line 21: the pair has no measurement"),
        (2 * (PAIR + "axis_deg = 90\naxis_sigma_deg = 1\n"), "line 25: pair cam0 - cam1 is given twice"),
        (PAIR.replace("cam1", "c"), "expected two of cam0, cam1, cam2"),
        (PAIR.replace('"cam0"', '["cam0"]'), r"line 21: sensors = \[\['cam0'\], 'cam1'\]: expected two of"),
    ],
)
def test_what_no_pair_can_be(tmp_path: Path, text: str, message: str) -> None:
    with refused(message):
        read_rig_file(toml(tmp_path, TOML + text), RIG)


def test_a_pair_against_the_positions_is_said(three_cameras: Survey, tmp_path: Path) -> None:
    pair = PAIR + "baseline_m = 0.5\nbaseline_sigma_m = 0.001\naxis_deg = 90\naxis_sigma_deg = 0.1\n"
    notes = three_cameras.scan(rig=str(toml(tmp_path, TOML + pair))).notes
    (said,) = (n for n in notes if "pair cam0 - cam1" in n)
    assert "0.5 m apart" in said and "0.08485" in said and "rig.toml" in said
    nominal = TOML.replace('axes = "flu"', 'axes = "flu"\nnominal = true')
    assert not says(three_cameras.scan(rig=str(toml(tmp_path, nominal + pair))).notes, "pair cam0")


@pytest.mark.parametrize(
    "model, params, message",
    [
        ("OPENCV", [500, 500, 400, 300, 1e9, 0, 0, 0], "without distortion"),
        ("OPENCV", [500, 500, 400, 300, -1e9, 0, 0, 0], "folds or tears"),
        ("OPENCV", [500, 500, 400, 300, 0, 0, 1e9, 0], "folds or tears"),
        ("RADIAL", [500, 400, 300, -0.6, 0], "folds or tears"),
        ("RADIAL", [500, 400, 300, 1e300, 0], "folds or tears"),
        ("FOV", [500, 500, 400, 300, 1e9], "folds or tears"),
        ("OPENCV_FISHEYE", [250, 250, 400, 300, -0.9, 0, 0, 0], "folds or tears"),
        ("OPENCV_FISHEYE", [250, 250, 400, 300, 1e9, 0, 0, 0], "without distortion"),
        ("PINHOLE", [0, 500, 400, 300], "focal length is 0 px"),
        ("PINHOLE", [-500, -500, 400, 300], "focal length is -500 px"),
        ("PINHOLE", [500, 5, 400, 300], "differ too much"),
        ("PINHOLE", [8.8, 8.8, 400, 300], "degrees across 800 px, not 1 to 170: is it in millimetres"),
        ("SIMPLE_PINHOLE", [1e6, 400, 300], "degrees across 800 px"),
        ("SIMPLE_PINHOLE", [500, 4000, 300], r"principal point \(4000, 300\)"),
        ("SIMPLE_PINHOLE", [500, 400, 300], ""),
        ("SIMPLE_PINHOLE", [500, 0.5, 0.5], r"principal point \(0.5, 0.5\) is in a corner"),  # shares of the sides
        ("SIMPLE_PINHOLE", [500, 12.5, 8.0], r"principal point \(12.5, 8\) is in a corner"),  # from the middle
        ("SIMPLE_PINHOLE", [500, 40, 300], ""),  # of a cropped image
        ("OPENCV", [500, 500, 400, 300, -0.28, 0.07, 1e-4, 1e-4], ""),
        ("RADIAL", [500, 400, 300, 0.5, 0.0], ""),
        ("OPENCV_FISHEYE", [129.1, 129.2, 400, 300, 0.038, -0.008, 0.0083, -0.0027], ""),
    ],
)
def test_lenses(tmp_path: Path, model: str, params: list[float], message: str) -> None:
    fault = lens_fault(pycolmap.Camera(model=model, width=800, height=600, params=params))
    assert (message in fault) if message and "(" not in message else bool(fault) == bool(message)
    text = f'[camera]\nmodel = "{model}"\nsize = [800, 600]\nparams = {params}\n[[sensors]]\nname = "a"\n'
    with refused(message, "rig.toml, line 4") if message else nullcontext():
        read_rig_file(toml(tmp_path, text), RIG)


@pytest.mark.parametrize(
    "camera, message",
    [
        ("model = 'RADIAL'\nparams = [80, 48, 32, -1, 0]", r"rig.toml, line 3: sensor 'c': RADIAL .* folds"),
        ("focal_px = 0.05", r"rig.toml, line 2: sensor 'c': a focal length of 0.05 px"),
        ("hfov_deg = 175", r"rig.toml, line 2: sensor 'c': hfov_deg = 175: a SIMPLE_RADIAL image"),
    ],
)
def test_a_lens_whose_image_size_only_the_images_tell(tmp_path: Path, camera: str, message: str) -> None:
    for k in range(3):
        picture(tmp_path / "in" / f"{k}.jpg", (96, 64))
    with refused(message):
        scan(tmp_path / "in", rig=str(toml(tmp_path, f"[camera]\n{camera}\n[[sensors]]\nname = 'c'\n")))


@pytest.mark.parametrize(
    "data, message",
    [
        (b"\xff\xfe[\0", "UTF-8"),
        (b"\x00\x01\x02", "not a valid TOML"),
        (b"[[" * 5000, "TOML"),
        (b"a = " + b"[" * 99999, "brackets"),
    ],
)
def test_no_text_at_all(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "rig.toml").write_bytes(data)
    with refused(message):
        read_rig_file(tmp_path / "rig.toml", RIG)
    with refused("a folder, not a file"):
        read_rig_file(tmp_path, RIG)
