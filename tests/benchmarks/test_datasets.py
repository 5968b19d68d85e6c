"""The benchmark adapters: truth is complete and consistent, and never reaches the files handed to a method."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import accuracy, datasets, table
from tiegraph.errors import InputError, SettingsError
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import world_from_geodetic
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import RigTuning

RIG = RigTuning()
SIZES = {
    "canal_demo": (120, 6),
    "canal": (300, 6),
    "pandaset": (300, 6),
    "kitti_stereo": (102, 2),
    "fountain-P11": (11, 1),
    "Herz-Jesus-P8": (8, 1),
    "Herz-Jesus-P25": (25, 1),
}


@pytest.fixture
def data(data_root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TIEGRAPH_DATA", str(data_root))
    return data_root


@pytest.mark.parametrize("name", SIZES)
def test_every_image_has_a_true_pose_and_the_rig_file_reads(name: str, data: Path, tmp_path: Path) -> None:
    dataset = datasets.load(name, tmp_path)
    images, sensors = SIZES[name]
    on_disk = {p.relative_to(dataset.images).as_posix() for p in dataset.images.rglob("*.jpg")}
    assert set(dataset.cam_from_world) == on_disk and len(on_disk) == images
    for pose in dataset.cam_from_world.values():
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-6)
    assert isinstance(dataset.rig, Path)
    (spec,) = read_rig_file(dataset.rig, RIG)
    assert len(spec.sensors) == sensors
    for path in (dataset.gnss, dataset.times, dataset.reference_cloud):
        assert path is None or path.is_file()


def test_oppaiyama_has_positions_only(data: Path, tmp_path: Path) -> None:
    dataset = datasets.load("oppaiyama", tmp_path)
    centres = np.stack(list(dataset.centres_m().values()))
    assert len(centres) > 70 and np.isfinite(centres).all()
    assert 5 < np.ptp(centres, axis=0).max() < 500
    assert len({m.surveyed_m for m in dataset.marks}) == 4 and len(dataset.marks) == 149


def test_marks_meet_in_a_model_whose_poses_are_right() -> None:
    import pycolmap

    options = pycolmap.SyntheticDatasetOptions(num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=6)
    model = pycolmap.synthesize_dataset(options)
    points = [p.xyz for p in list(model.points3D.values())[:4]]
    marks = []
    for point in points:
        for image in model.images.values():
            x, y = image.project_point(point)
            east, north, height = 3 * point
            marks.append(datasets.Mark(image.name, (east, north, height), (x + 1.0, y)))
    error = accuracy.mark_error(model, tuple(marks))
    assert error["points"] == 4 and error["marks"] == 24
    assert 0.01 < error["median_px"] < 1.5
    assert error["scale"] == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("name", ["canal", "canal_demo"])
def test_canal_gives_the_method_sensors_and_no_truth(name: str, data: Path, tmp_path: Path) -> None:
    dataset = datasets.load(name, tmp_path)
    assert dataset.gnss is not None and dataset.gnss.parent.name == "sensors"
    (spec,) = read_rig_file(Path(str(dataset.rig)), RIG)
    assert all(s.params is None and s.focal_px is None for s in spec.sensors), "the true calibration got out"
    assert spec.antenna_m is None, "the true lever arm got out"
    true = _relative(dataset, "up/cam0/000000.jpg", "up/cam1/000000.jpg")
    body = [s.body_from_sensor for s in spec.sensors]
    assert body[0] is not None and body[1] is not None
    nominal = transforms.invert(body[1]) @ body[0]
    difference_deg = transforms.angle_deg(true[:3, :3], nominal[:3, :3])
    assert 0.01 < difference_deg < 3, "nominal is near the truth, and is not the truth"


@pytest.mark.slow
def test_the_shipped_example_stands_for_canal_demo(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the papers' tables are made by one command without any other data."""
    wanted = datasets.load("canal_demo", tmp_path / "data")
    monkeypatch.setenv("TIEGRAPH_DATA", str(tmp_path / "nothing"))
    shipped = datasets.load("canal_demo", tmp_path / "shipped")
    assert shipped.cam_from_world.keys() == wanted.cam_from_world.keys()
    for name, pose in wanted.cam_from_world.items():
        np.testing.assert_allclose(shipped.cam_from_world[name], pose, atol=1e-9)
        assert (shipped.images / name).read_bytes() == (wanted.images / name).read_bytes()
    assert shipped.gnss and wanted.gnss and shipped.gnss.read_bytes() == wanted.gnss.read_bytes()
    (ours,), (theirs,) = (read_rig_file(Path(str(d.rig)), RIG) for d in (shipped, wanted))
    assert ours.antenna_m is None, "the true lever arm got out"
    for a, b in zip(ours.sensors, theirs.sensors, strict=True):
        assert (a.name, a.role, a.folder, a.params) == (b.name, b.role, b.folder, None)
        assert a.body_from_sensor is not None
        np.testing.assert_allclose(a.body_from_sensor, b.body_from_sensor, atol=1e-4)


def test_pandaset_rig_agrees_with_the_poses_while_the_car_stands(data: Path, tmp_path: Path) -> None:
    dataset = datasets.load("pandaset", tmp_path)
    (spec,) = read_rig_file(Path(str(dataset.rig)), RIG)
    front = spec.sensors[0].body_from_sensor
    assert front is not None
    for sensor in spec.sensors[1:]:
        true = _relative(dataset, "front_camera/01.jpg", f"{sensor.name}/01.jpg")
        assert sensor.body_from_sensor is not None
        filed = transforms.invert(sensor.body_from_sensor) @ front
        assert np.linalg.norm(transforms.centre(true) - transforms.centre(filed)) < 0.02
        assert transforms.angle_deg(true[:3, :3], filed[:3, :3]) < 0.1


def test_kitti_baseline_is_that_of_the_calibration(data: Path, tmp_path: Path) -> None:
    dataset = datasets.load("kitti_stereo", tmp_path)
    pose = _relative(dataset, "image_l/000010.jpg", "image_r/000010.jpg")
    np.testing.assert_allclose(transforms.centre(pose), [379.8145 / 707.0912, 0, 0], atol=1e-5)


def test_strecha_calibration_is_halved_with_the_photographs(data: Path, tmp_path: Path) -> None:
    camera = datasets.load("fountain-P11", tmp_path).cameras[""]
    assert (camera.width, camera.height) == (1536, 1024)
    np.testing.assert_allclose(camera.params, [1379.74, 1382.08, 760.345, 503.405])


def test_unknown_set_and_absent_folder_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingsError, match="kitti_stereo"):
        datasets.load("kitty_stereo", tmp_path)
    monkeypatch.setenv("TIEGRAPH_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="TIEGRAPH_DATA"):
        datasets.load("canal", tmp_path)


def _relative(dataset: datasets.Dataset, a: str, b: str) -> np.ndarray:
    """b_from_a of two images."""
    return dataset.cam_from_world[b] @ transforms.invert(dataset.cam_from_world[a])


# --------------------------------------------------------------------------------------------------------- accuracy


def _circle(count: int) -> dict[str, np.ndarray]:
    angle = np.linspace(0, 5, count)
    centres = np.stack([10 * np.cos(angle), 10 * np.sin(angle), 0.3 * angle], axis=1)
    return {f"{k:03d}.jpg": transforms.rigid(np.eye(3), -c) for k, c in enumerate(centres)}


def _moved(truth: dict[str, np.ndarray], scale: float, noise_m: float) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    out = {}
    for name, pose in truth.items():
        centre = scale * turn @ (transforms.centre(pose) + rng.normal(0, noise_m, 3)) + [5, 6, 7]
        rotation = pose[:3, :3] @ turn.T
        out[name] = transforms.rigid(rotation, -rotation @ centre)
    return out


def test_trajectory_error_finds_noise_scale_and_missing_images() -> None:
    truth = _circle(40)
    model = _moved(truth, 0.25, 0.02)
    kept = dict(list(model.items())[:30])
    error = accuracy.trajectory_error(kept, truth)
    assert 0.02 < error["ate_m"] < 0.05  # 0.02 m an axis is 0.035 m in space
    assert abs(error["scale"] - 4) < 0.05
    assert error["ate_rigid_m"] > 3
    assert error["rotation_median_deg"] < 0.2
    assert error["robust"]["within_m"]["0.3"] == pytest.approx(30 / 40)
    assert error["robust"]["within_m"]["0.01"] < 0.2


def test_trajectory_error_of_a_part_is_infinite_for_most_images() -> None:
    truth = _circle(40)
    error = accuracy.trajectory_error(dict(list(truth.items())[:10]), truth)
    assert error["ate_m"] < 1e-6 and error["robust"]["median_of_all_m"] is None
    assert accuracy.trajectory_error({}, truth)["ate_m"] is None


def test_positions_without_rotation_keep_their_centre() -> None:
    pose = datasets._position_only(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(datasets.pose_centre(pose), [1, 2, 3])


def test_canal_truth_origin_is_where_the_gnss_is(data: Path, tmp_path: Path) -> None:
    dataset = datasets.load("canal_demo", tmp_path)
    assert dataset.gnss is not None and dataset.truth_origin is not None
    fixes = np.loadtxt(dataset.gnss, delimiter=",", skiprows=1)[:, 1:4]
    enu_m = world_from_geodetic(fixes, dataset.truth_origin)
    centres = np.stack(list(dataset.centres_m().values()))
    assert np.linalg.norm(np.median(enu_m, axis=0) - np.median(centres, axis=0)) < 10


# ------------------------------------------------------------------------------------------------------------ table


def test_table_shows_ratios_against_the_named_competitor_and_failures() -> None:
    def row(competitor: str, cpu_s: float, **more: object) -> dict:
        base = {"set": "x", "competitor": competitor, "repeat": 0, "calibration": "estimated", "status": "done"}
        return {**base, "cpu_s": cpu_s, "wall_s": 2.0, "images": 4, "registered": 4, "stages": [], **more}

    failed = row("c", 9.0, status="timeout", registered=0)
    results = {"machine": {"cores": 2}, "runs": [row("a", 10.0, ate_m=0.5), row("b", 40.0, ate_m=0.25), failed]}
    lines = table.markdown(results, "b").splitlines()
    ours = next(line for line in lines if line.startswith("| a |")).split("|")[1:]
    assert ours[table.COLUMNS.index("CPU s") + 1].strip() == "0.25"
    assert ours[table.COLUMNS.index("ATE m") + 1].strip() == "2.00"
    assert any("timeout" in line and "0/4" in line for line in lines)
