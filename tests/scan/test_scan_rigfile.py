import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_worlds import data, papers_rig, picture, scan

from near import baselines_m
from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, from_quaternion_wxyz, invert
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import AXES, orient, preset, rig_config, write_rig_toml, yaw_pitch_roll_deg
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import Rig, Sensor, rig_from_dict, rig_to_dict

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


@pytest.mark.parametrize("axes", AXES)
def test_yaw_turns_right_pitch_up_and_roll_clockwise(axes: str) -> None:
    right, down, forward = AXES[axes]
    assert np.allclose(orient(0, 0, 0, axes), np.stack([right, down, forward], axis=1))
    assert np.allclose(orient(90, 0, 0, axes)[:, 2], right)
    assert np.allclose(orient(0, 90, 0, axes)[:, 2], -down)
    assert np.allclose(orient(0, 0, 90, axes)[:, 0], down)
    assert np.linalg.det(orient(10, 20, 30, axes)) == pytest.approx(1)


@settings(deadline=None)
@given(st.floats(-179, 179), st.floats(-90, 90), st.floats(-179, 179), st.sampled_from(sorted(AXES)))
def test_angles_and_rotation_are_inverse(yaw: float, pitch: float, roll: float, axes: str) -> None:
    rotation = orient(yaw, pitch, roll, axes)
    assert np.allclose(orient(*yaw_pitch_roll_deg(AXES[axes] @ rotation), axes), rotation, atol=1e-6)


def test_rig_frame_is_the_first_sensor_and_the_antenna_moves_along(tmp_path: Path) -> None:
    scene = scan(papers_rig(tmp_path / "in"), rig=str(toml(tmp_path)))
    rig = scene.rigs[0]
    assert (rig.name, rig.fixed, rig.nominal, len(rig.sensors)) == ("boat", False, False, 3)
    assert np.array_equal(rig.sensors[0].sensor_from_rig, np.eye(4))
    # Body: x forward, y left, z up, camera 0 at 6 cm ahead; rig: x right, y down, z forward.
    assert rig.antenna_m == pytest.approx((-0.6, -0.3, 0.84))
    assert rig.sensors[1].optical_axis() == pytest.approx([1, 0, 0])
    assert rig.sensors[2].optical_axis() == pytest.approx([0, -1, 0]) and rig.sensors[2].role == "up"
    assert invert(rig.sensors[1].sensor_from_rig)[:3, 3] == pytest.approx([0.06, 0, -0.06])
    assert baselines_m(rig)[0, 1] == pytest.approx(0.06 * np.sqrt(2))


def test_a_fisheye_sees_more_than_a_half_circle_and_a_perspective_image_does_not(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in")
    fisheye = TOML.replace("hfov_deg = 90", 'model = "OPENCV_FISHEYE"\nhfov_deg = 200')
    scene = scan(images, rig=str(toml(tmp_path, fisheye)))
    camera = scene.sensor_of(0).camera
    assert camera.focal_length_x == pytest.approx(camera.width / np.radians(200), rel=1e-6)
    with pytest.raises(InputError, match=r"line 6.*hfov_deg = 200.*1 to 170 degrees; give a fisheye model"):
        scan(images, rig=str(toml(tmp_path, TOML.replace("hfov_deg = 90", "hfov_deg = 200"))))


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


@pytest.mark.parametrize(
    "wrong, right, message",
    [
        ("antena_m = [0, 0, 0]", "antenna_m = [0.9, 0.6, 0.3]", "line 4: unknown key 'antena_m'.*'antenna_m'"),
        ('nmae = "cam1"', 'name = "cam1"', "line 12: unknown key 'nmae' in sensor.*perhaps you meant 'name'"),
        ('role = "upp"', 'role = "up"', "line 17: role = 'upp': valid are side, up, wide; perhaps you meant 'up'"),
        ('role = "front"', 'role = "up"', "line 17: role = 'front': valid are side, up, wide"),
        ("position_m = [0, 0]", "position_m = [0, 0, 0.07]", "line 18: position_m = .*list of 3 finite numbers"),
        ("yaw_pitch_roll_deg = [nan, 0, 0]", "yaw_pitch_roll_deg = [90, 0, 0]", "line 14: yaw_pitch_roll_deg"),
        ("body_from_sensor_wxyz = [1, 1, 0, 0]", "yaw_pitch_roll_deg = [90, 0, 0]", "line 14: .*length 1.414, not 1"),
        ("body_from_sensor = [[1,0,0],[0,1,0],[0,0,-1]]", "yaw_pitch_roll_deg = [90, 0, 0]", "line 14:.*a rotation"),
        ("body_from_sensor = [[1, 0], [0, 1]]", "yaw_pitch_roll_deg = [90, 0, 0]", "line 14: .*3 rows"),
        ("hfov = 90", "hfov_deg = 90", "line 6: unknown key 'hfov' in the camera.*'hfov_deg'"),
        ("hfov_deg = 400", "hfov_deg = 90", "line 6: hfov_deg = 400: expected a number above 0"),
        ("focal_px = 'x'", "hfov_deg = 90", "line 6: focal_px = 'x'"),
        ("params = [1, 2]", "hfov_deg = 90", "line 6: .*params need a model"),
        ('model = "OPENCVV"', "hfov_deg = 90", "line 6: unknown camera model 'OPENCVV'; perhaps you meant 'OPENCV'"),
        ('model = "PINHOLE"\nparams = [1, 2, 3]', "hfov_deg = 90", "PINHOLE has 4 parameters"),
        ("hfov_deg = 90\nfocal_px = 3", "hfov_deg = 90", "give one of focal_px, hfov_deg"),
        ('axes = "fly"', 'axes = "flu"', "line 3: axes = 'fly'.*perhaps you meant 'flu'"),
        ("fixed = 1", 'name = "boat"', "fixed = 1: valid are false, true"),
        ('name = "cam0"', 'name = "cam1"', "line 12: two sensors have the name 'cam0'"),
        ("", 'name = "cam1"', "sensor 2 needs a name"),
        ('name = "cam1', 'name = "cam1"', "not a valid TOML file.*line 12"),
        ("crop_px = [0, -1, 0, 0]", 'role = "up"', "line 17: crop_px"),
        ("", "yaw_pitch_roll_deg = [90, 0, 0]", "line 13: position_m needs an orientation"),
    ],
)  # fmt: skip
def test_mistakes_in_a_rig_toml_name_file_line_and_remedy(tmp_path: Path, wrong: str, right: str, message: str) -> None:
    assert right in TOML
    path = toml(tmp_path, TOML.replace(right, wrong, 1))
    with pytest.raises(InputError, match=message) as error:
        read_rig_file(path, RIG)
    assert str(path) in str(error.value)


def test_a_rig_needs_sensors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one"):
        read_rig_file(toml(tmp_path, "name = 'x'"), RIG)


def test_a_missing_file_lists_the_presets(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="ladybug5, ring:N, stereo"):
        scan(papers_rig(tmp_path / "in"), rig="ladybug6")


def test_a_sensor_without_images_is_an_error_with_a_hint(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in")
    with pytest.raises(InputError, match=r"'came2'.*folders here: cam0, cam1, cam2.*meant 'cam2'"):
        scan(images, rig=str(toml(tmp_path, TOML.replace('name = "cam2"', 'name = "came2"'))))


def test_images_below_no_sensor_folder_are_listed(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", cameras=4, frames=2)
    scene = scan(images, rig=str(toml(tmp_path)))
    assert len(scene) == 12 and len(scene.dropped) == 4
    assert all("cam3" in d.name and "no sensor folder" in d.reason for d in scene.dropped)


def test_the_reference_sensor_needs_an_orientation_if_others_have_one(tmp_path: Path) -> None:
    text = TOML.replace("yaw_pitch_roll_deg = [0, 0, 0]\n", "").replace("position_m = [0.06, 0, 0]\n", "")
    with pytest.raises(InputError, match="'cam0', is the reference"):
        scan(papers_rig(tmp_path / "in"), rig=str(toml(tmp_path, text)))


def test_a_camera_of_another_size_is_rescaled_and_of_another_shape_refused(tmp_path: Path) -> None:
    images = tmp_path / "in"
    for k in range(3):
        picture(images / f"{k}.jpg", (96, 64))
    text = (
        "[camera]\nmodel = 'PINHOLE'\nsize = [3072, 2048]\nparams = [2759, 2764, 1520, 1006]\n[[sensors]]\nname = 'c'\n"
    )
    scene = scan(images, rig=str(toml(tmp_path, text)))
    camera = scene.sensor_of(0).camera
    assert camera is not None and (camera.width, camera.height) == (96, 64)
    assert list(camera.params) == pytest.approx([86.22, 86.375, 47.5, 31.44], abs=0.01)
    assert any("rescaled by 0.03125" in note for note in scene.notes)
    with pytest.raises(InputError, match="3072 x 2000.*96 x 64.*another shape"):
        scan(images, rig=str(toml(tmp_path, text.replace("2048", "2000"))))
    with pytest.raises(InputError, match="principal point"):
        scan(images, rig=str(toml(tmp_path, text.replace("size = [3072, 2048]\n", ""))))


@pytest.mark.parametrize("name, cameras, up", [("ladybug5", 6, True), ("ladybug5", 5, False), ("ring:4", 4, False)])
def test_ring_presets_are_nominal_common_centre_and_equally_spaced(
    tmp_path: Path, name: str, cameras: int, up: bool
) -> None:
    rig = scan(papers_rig(tmp_path / "in", cameras=cameras, frames=1), rig=name).rigs[0]
    sides = 5 if name == "ladybug5" else 4
    assert rig.nominal and not rig.fixed and rig.known() and len(rig.sensors) == cameras
    assert np.allclose(baselines_m(rig), 0)
    angles = rig.axis_angles_deg()
    for k in range(sides):
        assert angles[k, (k + 1) % sides] == pytest.approx(360 / sides)
    assert [s.role for s in rig.sensors] == ["side"] * sides + ["up"] * (cameras - sides)
    if up:
        assert rig.sensors[5].optical_axis() == pytest.approx([0, -1, 0])
    camera = rig.sensors[0].camera
    assert camera is not None and not camera.has_prior_focal_length


def test_stereo_presets(tmp_path: Path) -> None:
    for side in ("right", "left"):
        for k in range(2):
            picture(tmp_path / "in" / side / f"{k}.jpg")
    rig = scan(tmp_path / "in", rig="stereo:0.5").rigs[0]
    assert [s.name for s in rig.sensors] == ["left", "right"]
    assert invert(rig.sensors[1].sensor_from_rig)[:3, 3] == pytest.approx([0.5, 0, 0])
    assert np.allclose(baselines_m(scan(tmp_path / "in", rig="stereo").rigs[0]), 0)


def test_a_preset_finds_its_cameras_in_folders_of_any_name(tmp_path: Path) -> None:
    for name in ("aft", "bow", "stern", "alpha"):
        for k in range(2):
            picture(tmp_path / "in" / "monday" / name / f"x{k}.jpg")
    assert [s.name for s in scan(tmp_path / "in", rig="ring:4").all_sensors] == ["aft", "alpha", "bow", "stern"]


@pytest.mark.parametrize(
    "name, message",
    [("ladybug5", "6 or 5 camera.*cam0, cam1, cam2"), ("ring:x", "number after the colon"), ("ring:1", "2 or more")],
)
def test_presets_that_do_not_fit(tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        scan(papers_rig(tmp_path / "in", frames=1), rig=name)


def test_preset_of_one_camera() -> None:
    assert preset("single", ("",), RIG).sensors[0].name == "camera"


def colmap(folder: Path, *cameras: dict) -> str:
    path = folder / "rig_config.json"
    path.write_text(json.dumps([{"cameras": list(cameras)}], indent=1))
    return str(path)


LEFT = {"image_prefix": "cam1/", "cam_from_rig_rotation": [0, 0, 1, 0], "cam_from_rig_translation": [0, 0, -0.03]}
REF = {"image_prefix": "cam0/", "ref_sensor": True}
FREE = {"image_prefix": "cam2/", "camera_model_name": "PINHOLE", "camera_params": [50, 50, 32, 24]}


def test_colmap_rig_config_puts_the_reference_first(tmp_path: Path) -> None:
    scene = scan(papers_rig(tmp_path / "in"), rig=colmap(tmp_path, LEFT, REF, FREE))
    rig = scene.rigs[0]
    assert [s.name for s in rig.sensors] == ["cam0", "cam1", "cam2"]
    assert np.allclose(
        rig.sensors[1].sensor_from_rig, from_quaternion_wxyz(np.array([0, 0, 1.0, 0]), np.array([0, 0, -0.03]))
    )
    assert rig.sensors[2].sensor_from_rig is None and not rig.known() and not rig.nominal
    camera = rig.sensors[2].camera
    assert camera is not None and camera.has_prior_focal_length and camera.model.name == "PINHOLE"


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


@pytest.mark.parametrize(
    "camera, message",
    [
        ({**LEFT, "image_prefx": 1}, r"unknown key 'image_prefx'.*'image_prefix'"),
        ({**LEFT, "ref_sensor": True}, "exactly one camera must have ref_sensor, got 2"),
        ({"image_prefix": "cam1/", "cam_from_rig_rotation": [1, 0, 0, 0]}, "belong together"),
        ({**LEFT, "cam_from_rig_rotation": [1, 0, 0]}, "list of 4"),
        ({**LEFT, "camera_model_name": "PINHOL", "camera_params": [1, 1, 1, 1]}, "perhaps you meant 'PINHOLE'"),
        ({**LEFT, "camera_model_name": "PINHOLE"}, "belong together"),
        ({"ref_sensor": False}, "needs an image_prefix"),
        ({**LEFT, "image_prefix": "cam0/"}, "same folder"),
    ],
)
def test_mistakes_in_a_rig_config(tmp_path: Path, camera: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        scan(papers_rig(tmp_path / "in", frames=1), rig=colmap(tmp_path, REF, camera))


@pytest.mark.parametrize(
    "text, message",
    [("{", "line 1: not valid JSON"), ("{}", "a list of rigs"), ('[{"cameras": []}]', "a list of cameras")],
)
def test_broken_rig_configs(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "rig_config.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_rig_file(path, RIG)


def near(a: Rig, b: Rig) -> None:
    assert [(s.name, s.folder) for s in a.sensors] == [(s.name, s.folder) for s in b.sensors]
    for s, t in zip(a.sensors, b.sensors):
        assert s.sensor_from_rig is not None and t.sensor_from_rig is not None
        assert angle_deg(s.sensor_from_rig[:3, :3], t.sensor_from_rig[:3, :3]) < 1e-5
        assert np.allclose(s.sensor_from_rig[:3, 3], t.sensor_from_rig[:3, 3], atol=1e-9)
        assert s.camera is not None and t.camera is not None and np.allclose(s.camera.params, t.camera.params)
        assert s.camera.model == t.camera.model


def test_written_rigs_are_read_back(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", frames=1)
    rig = scan(images, rig=str(toml(tmp_path))).rigs[0]
    write_rig_toml(rig, tmp_path / "again.toml", "a comment")
    again = scan(images, rig=str(tmp_path / "again.toml")).rigs[0]
    near(rig, again)
    assert again.antenna_m == pytest.approx(rig.antenna_m) and [s.role for s in again.sensors] == ["side", "side", "up"]
    (tmp_path / "again.json").write_text(rig_config([rig]), encoding="utf-8")
    near(rig, scan(images, rig=str(tmp_path / "again.json")).rigs[0])


def test_a_written_rig_takes_a_vehicles_axes_by_one_word(tmp_path: Path) -> None:
    spec = preset("ring:5", ("a", "b", "c", "d", "e"), RIG)
    cameras = [Sensor(s.name, None, invert(s.body_from_sensor)) for s in spec.sensors]
    path = tmp_path / "rig.toml"
    write_rig_toml(Rig("ring", tuple(cameras)), path)
    (as_camera,) = read_rig_file(path, RIG)
    path.write_text(path.read_text().replace('axes = "camera"', 'axes = "flu"'))
    (as_vehicle,) = read_rig_file(path, RIG)
    for a, b in zip(as_camera.sensors, as_vehicle.sensors):
        assert np.allclose(AXES["flu"].T @ a.body_from_sensor[:3, :3], b.body_from_sensor[:3, :3], atol=1e-9)


def test_colmap_reads_what_we_write(tmp_path: Path) -> None:
    import pycolmap

    rig = scan(papers_rig(tmp_path / "in", frames=1), rig=str(toml(tmp_path))).rigs[0]
    (tmp_path / "rig_config.json").write_text(rig_config([rig]), encoding="utf-8")
    cameras = pycolmap.read_rig_config(tmp_path / "rig_config.json")[0].cameras
    assert cameras[0].ref_sensor and [c.image_prefix for c in cameras] == ["cam0/", "cam1/", "cam2/"]
    assert rig.sensors[1].sensor_from_rig is not None
    assert np.allclose(cameras[1].cam_from_rig.matrix(), rig.sensors[1].sensor_from_rig[:3])


def test_an_unknown_rig_is_written_without_poses(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", frames=1)
    rig = Rig("r", (Sensor("cam0", folder="cam0"), Sensor("cam1", folder="cam1")))
    write_rig_toml(rig, tmp_path / "r.toml")
    found = scan(images, rig=str(tmp_path / "r.toml")).rigs[0]
    assert np.array_equal(found.sensors[0].sensor_from_rig, np.eye(4)) and found.sensors[1].sensor_from_rig is None


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
        assert sensor.body_from_sensor is not None
        assert angle_deg(reference @ sensor.body_from_sensor[:3, :3], cam_from_body.T) < 1e-4


def test_sigmas_and_pairs_go_to_the_file_and_back(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        """
[[sensors]]
name = "a"
yaw_pitch_roll_deg = [0, 0, 0]
[[sensors]]
name = "b"
position_m = [0.5, 0, 0]
yaw_pitch_roll_deg = [90, 0, 0]
sigma_deg = 0.1
sigma_m = 0.002
[[pairs]]
sensors = ["a", "b"]
baseline_m = 0.5
baseline_sigma_m = 0.001
"""
    )
    (spec,) = read_rig_file(path, RIG)
    assert spec.sensors[1].sigma_deg == 0.1 and spec.sensors[0].sigma_m is None
    assert spec.pairs[0].sensors == ("a", "b") and spec.pairs[0].axis_deg is None
    poses = [s.body_from_sensor for s in spec.sensors]
    sensors = tuple(
        Sensor(s.name, None, np.linalg.inv(p), sigma_deg=s.sigma_deg, sigma_m=s.sigma_m)
        for s, p in zip(spec.sensors, poses)
    )
    rig = Rig("r", sensors, pairs=spec.pairs)
    assert rig.soft() and not Rig("r", sensors, fixed=True, pairs=spec.pairs).soft()
    assert rig_from_dict(rig_to_dict(rig)).pairs == rig.pairs
    write_rig_toml(rig, tmp_path / "again.toml")
    (again,) = read_rig_file(tmp_path / "again.toml", RIG)
    assert again.pairs == spec.pairs and again.sensors[1].sigma_m == 0.002


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('sensors = ["a", "c"]', "expected two of a, b"),
        ('sensors = ["a", "b"]\nbaseline_m = 0.5', "baseline_m and baseline_sigma_m belong together"),
        ('sensors = ["a", "b"]\naxis_deg = -3', "0 or more"),
        ('sensors = ["a", "b"]\nlength = 3', "unknown key"),
    ],
)
def test_a_pair_that_says_nothing_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f'[[sensors]]\nname = "a"\n[[sensors]]\nname = "b"\n[[pairs]]\n{text}\n')
    with pytest.raises(InputError, match=message):
        read_rig_file(path, RIG)


def test_a_key_that_is_missing_is_not_looked_for_in_the_next_sensor(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(
        '# name = "remark"\n[[sensors]]\nfolder = "a"\n\n[[sensors]]\nname = "b"\n[sensors.camera]\nhfov_deg = 0\n'
    )
    with pytest.raises(InputError, match=r"rig.toml, line 2: sensor 1 needs a name"):
        read_rig_file(tmp_path / "rig.toml", RIG)
    text = (tmp_path / "rig.toml").read_text().replace('folder = "a"', 'name = "a"')
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(InputError, match=r"rig.toml, line 8: hfov_deg = 0"):
        read_rig_file(tmp_path / "rig.toml", RIG)


def test_a_camera_of_a_rig_config_is_the_object_and_not_the_next_prefix(tmp_path: Path) -> None:
    cameras = [
        {"ref_sensor": True, "image_prefix": "a/"},
        {"cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0, 0], "image_prefix": "b/"},
        {"cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0, 0, 0], "image_prefix": "c/"},
    ]
    path = tmp_path / "rig_config.json"
    path.write_text(json.dumps([{"cameras": cameras}], indent=1))
    wrong = next(k for k, t in enumerate(path.read_text().split("\n"), 1) if "translation" in t)
    with pytest.raises(InputError, match=rf"rig_config.json, line {wrong}: cam_from_rig_translation = \[0, 0\]"):
        read_rig_file(path, RIG)
    del cameras[1]["image_prefix"]
    path.write_text(json.dumps([{"cameras": cameras}], indent=1))
    head = [k for k, t in enumerate(path.read_text().split("\n"), 1) if t.strip() == "{"][2]
    with pytest.raises(InputError, match=rf"line {head}: camera 2 needs an image_prefix"):
        read_rig_file(path, RIG)


def test_a_rig_is_not_named_after_its_file(tmp_path: Path) -> None:
    path = tmp_path / "final_v3 (2).toml"
    path.write_text('[[sensors]]\nname = "a"\n')
    assert read_rig_file(path, RIG)[0].name == "rig"
    path.write_text('name = "boat"\n[[sensors]]\nname = "a"\n')
    assert read_rig_file(path, RIG)[0].name == "boat"
    (tmp_path / "export17.json").write_text(json.dumps([{"cameras": [{"ref_sensor": True, "image_prefix": "a"}]}]))
    assert read_rig_file(tmp_path / "export17.json", RIG)[0].name == "rig"
