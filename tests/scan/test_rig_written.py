"""What a written rig.toml says of its angles and positions is what they do: one uses it by its own words alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scan_worlds import exif_of, papers_rig, picture, scan
from test_rig_files import toml

from tiegraph.cli.main import main
from tiegraph.geometry.transforms import angle_deg, invert
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import AXES, EXPLAINED, preset, rig_config, write_rig_toml
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import Rig, Sensor, rig_from_dict, rig_to_dict

RIG = RigTuning()

# Right, down and forward of the body in each of the frames that the file names.
FRAMES = {
    "camera": ([1, 0, 0], [0, 1, 0], [0, 0, 1]),
    "flu": ([0, -1, 0], [0, 0, -1], [1, 0, 0]),
    "frd": ([0, 1, 0], [0, 0, 1], [1, 0, 0]),
    "rfu": ([1, 0, 0], [0, 0, -1], [0, 1, 0]),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("init")
    images = papers_rig(folder / "in", ("up",), 2, 3)
    assert main(["init", str(images), "-o", str(folder / "out"), "--rig", "stereo:0.5", "--pool", "serial"]) == 0
    return (folder / "out" / "rig.toml").read_text()


def _pose(folder: Path, text: str, axes: str, **of_second: str) -> np.ndarray:
    """body_from_sensor of the second sensor once its values were edited by hand."""
    text = text.replace('axes = "camera"', f'axes = "{axes}"')
    head, first, second = text.split("[[sensors]]")
    for key, value in of_second.items():
        lines = [x for x in second.splitlines() if not x.startswith(("yaw", "position") if "body" in key else key)]
        second = "\n".join([*lines[:1], f"{key} = {value}", *lines[1:]])
    (folder / "rig.toml").write_text("[[sensors]]".join([head, first, second]) + "\n")
    pose = read_rig_file(folder / "rig.toml", RIG)[0].sensors[1].body_from_sensor
    return pose


def test_the_file_explains_order_sign_direction_and_frame(written: str) -> None:
    said = " ".join(line.lstrip("# ") for line in written.splitlines() if line.startswith("#"))
    order = ("in this order", "yaw to the right", "then pitch up", "then roll clockwise")
    for words in (
        *order,
        "x forward, y left, z up",
        "camera to body",
        "the projection centre in the body frame",
        "w first",
    ):
        assert words in said
    assert all(f"# {line}" in written for line in EXPLAINED.splitlines())
    assert "position_m = [0.5, 0.0, 0.0]" in written  # the right camera stands half a metre to the right


@pytest.mark.parametrize("axes", FRAMES)
def test_angles_do_what_the_words_say(tmp_path: Path, written: str, axes: str) -> None:
    assert FRAMES.keys() == AXES.keys()
    right, down, forward = (np.array(v, float) for v in FRAMES[axes])

    def turned(text: str) -> np.ndarray:
        return _pose(tmp_path, written, axes, yaw_pitch_roll_deg=text)[:3, :3]

    np.testing.assert_allclose(turned("[0, 0, 0]"), np.stack([right, down, forward], axis=1), atol=1e-12)
    np.testing.assert_allclose(turned("[90, 0, 0]")[:, 2], right, atol=1e-12)  # yaw 90 looks to the right
    np.testing.assert_allclose(turned("[0, 90, 0]")[:, 2], -down, atol=1e-12)  # pitch 90 looks straight up
    np.testing.assert_allclose(turned("[0, 0, 90]")[:, 0], down, atol=1e-12)  # roll 90: its right side points down
    half = np.sqrt(0.5)
    np.testing.assert_allclose(turned("[90, 45, 0]")[:, 2], half * (right - down), atol=1e-12)  # yaw first, then pitch
    np.testing.assert_allclose(turned("[90, 45, 30]")[:, 2], half * (right - down), atol=1e-12)  # roll about the view


@pytest.mark.parametrize("axes", FRAMES)
def test_positions_and_rotations_are_camera_to_body(tmp_path: Path, written: str, axes: str) -> None:
    right, down, forward = FRAMES[axes]
    rows = [list(map(float, r)) for r in np.stack([forward, down, np.negative(right)], axis=1)]  # looks to the left
    pose = _pose(tmp_path, written, axes, body_from_sensor=str(rows), position_m="[1.0, 2.0, 3.0]")
    # a point 10 m ahead of the camera lies 10 m to the left of where the camera stands
    np.testing.assert_allclose(pose @ [0, 0, 10, 1], [*np.array([1, 2, 3]) - 10.0 * np.array(right), 1], atol=1e-12)
    same = _pose(tmp_path, written, axes, yaw_pitch_roll_deg="[-90, 0, 0]", position_m="[1.0, 2.0, 3.0]")
    np.testing.assert_allclose(pose, same, atol=1e-12)


@pytest.mark.slow
def test_a_guessed_focal_length_does_not_become_a_statement(tmp_path: Path, written: str) -> None:
    assert "params" not in "".join(x for x in written.splitlines() if not x.startswith("#"))
    (tmp_path / "rig.toml").write_text(written)
    images = papers_rig(tmp_path / "in", ("up",), 2, 3)
    assert not any(s.camera.has_prior_focal_length for s in scan(images, rig=str(tmp_path / "rig.toml")).all_sensors)
    for camera in range(2):  # what EXIF says is known, and is written
        for k in range(3):
            picture(tmp_path / "exif" / f"cam{camera}" / f"{k}.jpg", exif=exif_of(focal_35mm=28))
    assert main(["init", str(tmp_path / "exif"), "-o", str(tmp_path / "out"), "--pool", "serial"]) == 0
    assert (tmp_path / "out" / "rig.toml").read_text().count("\nparams = ") == 2


@pytest.mark.slow
def test_init_says_what_else_may_be_given(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for k in range(3):
        picture(tmp_path / "in" / f"{k}.jpg")
    assert main(["init", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--pool", "serial"]) == 0
    said = capsys.readouterr().out
    assert "--camera: the camera's calibration" in said and "cameras.txt" in said
    assert "--gcp FILE: control points; points need the columns name, x, y, z" in said and "--marks" in said
    assert "--gnss FILE: positions; columns time or image, lat, lon, height" in said


def near(a: Rig, b: Rig) -> None:
    assert [(s.name, s.folder) for s in a.sensors] == [(s.name, s.folder) for s in b.sensors]
    for s, t in zip(a.sensors, b.sensors):
        assert angle_deg(s.sensor_from_rig[:3, :3], t.sensor_from_rig[:3, :3]) < 1e-5
        assert np.allclose(s.sensor_from_rig[:3, 3], t.sensor_from_rig[:3, 3], atol=1e-9)
        assert np.allclose(s.camera.params, t.camera.params)
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
    assert np.allclose(cameras[1].cam_from_rig.matrix(), rig.sensors[1].sensor_from_rig[:3])


def test_an_unknown_rig_is_written_without_poses(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", frames=1)
    rig = Rig("r", (Sensor("cam0", folder="cam0"), Sensor("cam1", folder="cam1")))
    write_rig_toml(rig, tmp_path / "r.toml")
    found = scan(images, rig=str(tmp_path / "r.toml")).rigs[0]
    assert np.array_equal(found.sensors[0].sensor_from_rig, np.eye(4)) and found.sensors[1].sensor_from_rig is None


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
