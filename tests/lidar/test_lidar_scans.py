"""Scans from every format, and a LiDAR on a rig: place and clock from two trajectories, what they leave open."""

from __future__ import annotations

import json
import os
from pathlib import Path

import laspy
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bag_world import Row, bag
from lidar.lidar_world import START_S, turns, world_from_lidar, write_bins
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.lidar.handeye import Poses, hand_eye, rig_in_lidar_world, settled
from tiegraph.lidar.odometry import tie_by_points
from tiegraph.lidar.scans import READERS, Scan, open_scans
from tiegraph.lidar.settings import LidarSettings
from tiegraph.pipeline.lidar import SurveyRun, calibrated, compared
from tiegraph.project.settings import VerbTunings
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

_XYZT = ("x", "y", "z", "intensity", "t")


def _read(path: Path, **how: object) -> list[Scan]:
    return list(open_scans(path, LidarSettings(**how)).read())  # type: ignore[arg-type]


def _points(count: int = 200, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(1, 9, (count, 3)), np.sort(rng.uniform(0, 0.1, count))


def _write_pcd(path: Path, xyz: np.ndarray, t: np.ndarray, encoding: str) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    kinds = (np.float32,) * 3 + (np.float64,)
    made = pypcd4.PointCloud.from_points(np.column_stack([xyz, t]), ("x", "y", "z", "time"), kinds)
    made.save(path, encoding=pypcd4.Encoding(encoding))


def _write(path: Path, xyz: np.ndarray, t: np.ndarray, form: str) -> bool:
    """A scan in a form; whether it can hold the points' times."""
    if form.startswith("pcd"):
        _write_pcd(path.with_suffix(".pcd"), xyz, t, form[4:])
    elif form == "npz":
        np.savez(path.with_suffix(".npz"), xyz_cm=np.round(xyz * 100).astype(np.int16), time_s=t)
    elif form == "ply":
        missing = np.full((len(xyz), 3), np.nan, np.float32)
        grey, none = np.zeros((len(xyz), 3), np.uint8), np.zeros(len(xyz), np.uint8)
        write_cloud(Cloud(xyz, grey, missing, missing[:, 0], none), path.with_suffix(".ply"))
        return False
    else:
        las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
        las.header.scales = [0.001] * 3
        las.x, las.y, las.z = xyz.T
        las.gps_time = t
        las.write(path.with_suffix(f".{form}"))
    return True


@pytest.mark.parametrize("form", ["pcd ascii", "pcd binary", "pcd binary_compressed", "npz", "ply", "las", "laz"])
def test_a_scan_a_file(tmp_path: Path, form: str) -> None:
    made = [_points(seed=k) for k in range(3)]
    timed = [_write(tmp_path / f"{k}", *points, form) for k, points in enumerate(made)]
    found = _read(tmp_path, rate_hz=10.0)
    assert len(found) == 3
    for k, (scan, (xyz, t)) in enumerate(zip(found, made)):
        assert scan.stamp_s == pytest.approx(k / 10)
        np.testing.assert_allclose(scan.xyz_m, xyz, atol=0.0051 if form == "npz" else 6e-4)
        if timed[k]:
            assert scan.offset_s is not None
            np.testing.assert_allclose(scan.offset_s, t, atol=1e-6)
        else:
            assert scan.offset_s is None


@pytest.mark.slow
@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_point_clouds_of_bags(tmp_path: Path, form: str) -> None:
    """PointCloud2 with padding, with times in nanoseconds from the stamp (Ouster), and NaN points."""
    made = [_points(seed=k) for k in range(3)]

    def row(k: int) -> Row:
        xyz, t = made[k]
        kind = np.dtype({"names": ["x", "y", "z", "t"], "formats": ["<f4"] * 3 + ["<u4"], "offsets": [0, 4, 8, 16],
                         "itemsize": 24})  # fmt: skip
        table = np.zeros(len(xyz) + 1, kind)
        for c, name in enumerate("xyz"):
            table[name][:-1], table[name][-1] = xyz[:, c], np.nan
        table["t"][:-1] = np.round(t * 1e9)

        def built(make, header):
            fields = [
                make("sensor_msgs/PointField", {"name": n, "offset": o, "datatype": d, "count": 1})
                for n, o, d in (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("t", 16, 6))
            ]
            return make(
                "sensor_msgs/PointCloud2",
                {
                    "header": header(500 + k / 10, "os"), "height": 1, "width": len(table), "fields": fields,
                    "is_bigendian": False, "point_step": 24, "row_step": table.nbytes,
                    "data": table.view(np.uint8).reshape(-1), "is_dense": False,
                },
            )  # fmt: skip

        return Row("/points", "sensor_msgs/PointCloud2", 500 + k / 10 + 0.05, built)

    found = _read(bag(tmp_path, form, [row(k) for k in range(3)]))
    assert [s.lost for s in found] == [1, 1, 1]
    for k, (scan, (xyz, t)) in enumerate(zip(found, made)):
        assert scan.stamp_s == pytest.approx(500 + k / 10)
        np.testing.assert_allclose(scan.xyz_m, xyz, atol=1e-5)
        assert scan.offset_s is not None
        np.testing.assert_allclose(scan.offset_s, t, atol=1e-8)


def test_kitti_layouts_and_times(tmp_path: Path) -> None:
    """velodyne/ below the folder, dates a line, other files left out and said."""
    folder = write_bins(tmp_path / "velodyne", turns(3, rings=4), with_times=False)
    (folder / "times.txt").unlink()
    (tmp_path / "timestamps.txt").write_text("".join(f"2011-09-26 13:02:25.{k}00000000\n" for k in (1, 2, 3)))
    np.zeros(4, "<f4").tofile(folder / "static_map.bin")
    recording = open_scans(tmp_path, LidarSettings())
    assert any("static_map.bin" in n for n in recording.notes)
    np.testing.assert_allclose(np.diff([s.stamp_s for s in recording.read()]), 0.1, atol=1e-6)


def test_scans_in_a_world_are_brought_back(tmp_path: Path) -> None:
    """PandaSet: more poses and times than scans, which have the numbers of their names."""
    xyz, _ = _points()
    turn = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])
    matrix = np.array([[np.cos(0.6), -np.sin(0.6), 0], [np.sin(0.6), np.cos(0.6), 0], [0, 0, 1]])
    poses = [{"position": {"x": 5.0 * k, "y": 1.0, "z": 0.0}, "heading": dict(zip("wxyz", turn))} for k in range(6)]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    (tmp_path / "timestamps.json").write_text(json.dumps([100.0 + k for k in range(6)]))
    for k in (2, 3):
        np.savez(tmp_path / f"{k:02d}.npz", xyz=xyz @ matrix.T + [5.0 * k, 1.0, 0.0])
    found = _read(tmp_path, poses=tmp_path / "poses.json")
    assert [s.stamp_s for s in found] == [102.0, 103.0]
    for scan in found:
        np.testing.assert_allclose(scan.xyz_m, xyz, atol=1e-9)


def _milliseconds(folder: Path) -> None:
    rows = np.fromfile(folder / "000000.bin", "<f4").reshape(-1, 5)
    rows[:, 4] *= 1000
    rows.tofile(folder / "000000.bin")


def _few_times(folder: Path) -> dict:
    """Names without numbers, so that rows cannot go by these."""
    for k, f in enumerate(sorted(folder.glob("*.bin"))):
        f.rename(folder / f"s{k}.bin")
    (folder / "times.txt").write_text("1\n2\n")
    return {"times": folder / "times.txt"}


SPOILT = {
    "no scans": lambda folder: [f.unlink() for f in folder.iterdir()],
    "000001.bin: .*are not points of 5 columns": lambda folder: os.truncate(
        one := folder / "000001.bin", one.stat().st_size - 7
    ),
    "only scan": lambda folder: [(folder / f"00000{k}.bin").unlink() for k in (1, 2)],
    "000001.bin: 0 of 500 points": lambda folder: np.full((500, 5), np.nan, "<f4").tofile(folder / "000001.bin"),
    "does not come after": lambda folder: (folder / "times.txt").write_text("3\n2\n1\n"),
    "2 rows for 3 scans|one each": _few_times,
    "--times": lambda folder: (folder / "times.txt").unlink(),
    "another unit": _milliseconds,
    "5 .*columns would fit.*--columns": lambda folder: {"columns": ("x", "y", "z", "intensity")},
}


@pytest.mark.parametrize("named", SPOILT)
def test_bad_scans(tmp_path: Path, named: str) -> None:
    folder = write_bins(tmp_path / "scans", turns(3, rings=5, step_deg=3.8))
    how = SPOILT[named](folder)
    with pytest.raises(InputError, match=named):
        _read(folder, **{"columns": _XYZT} | (how if isinstance(how, dict) else {}))


def test_every_reader_names_a_damaged_file(tmp_path: Path) -> None:
    for ending, reader in READERS.items():
        path = tmp_path / f"scan{ending}"
        path.write_bytes(b"no scan at all")
        with pytest.raises(InputError, match=f"scan{ending}"):
            reader(path, ("x", "y", "z", "intensity"))


_TURN, _MOUNT = (Rotation.from_euler("xyz", a, degrees=True).as_matrix() for a in ([40, 20, -60], [5, -88, 12]))
_PLACE = transforms.rigid(_MOUNT, np.array([0.3, -0.7, 0.1]))
_CLOCK_S, _SCALE = 0.37, 0.8


def _noisy(poses: np.ndarray, sigma_m: float, sigma_deg: float, rng: np.random.Generator) -> np.ndarray:
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(sigma_deg), (len(poses), 3))).as_matrix()
    return transforms.rigid(turn @ poses[:, :3, :3], poses[:, :3, 3] + rng.normal(0, sigma_m, (len(poses), 3)))


def _both(seconds: float = 12, wobble: float = 1.0, noise: float = 1.0, seed: int = 0) -> tuple[Poses, Poses]:
    """A rig at 2 frames a second in a world of its own scale, and the LiDAR at 10 Hz with another clock."""
    rng = np.random.default_rng(seed)
    frames, scans = START_S + np.arange(1, seconds, 0.5), START_S + np.arange(0, seconds, 0.1)
    rig = world_from_lidar(frames, wobble) @ transforms.invert(_PLACE)
    lidar = _noisy(world_from_lidar(scans, wobble), 0.001 * noise, 0.01 * noise, rng)
    rig = _noisy(rig, 0.001 * noise, 0.01 * noise, rng)
    rig[:, :3, 3] /= _SCALE
    turned = transforms.rigid(_TURN, np.array([3.0, 4, 5]))
    alone = (np.zeros(len(t), int) for t in (frames, scans))
    return Poses(frames, turned @ rig, next(alone)), Poses(scans + _CLOCK_S, lidar, next(alone))


@pytest.mark.slow
def test_place_clock_and_scale_of_a_wobbling_path() -> None:
    rig, lidar = _both()
    found = hand_eye(rig, lidar)
    off = found.rig_from_lidar[:3, 3] - _PLACE[:3, 3]
    assert 0 < abs(found.clock_s - _CLOCK_S) < 0.005 and found.clock_sigma_s < 0.005
    assert np.abs(off).max() < 0.02
    assert np.all(np.abs(off) < 4 * found.place_sigma_m) and found.place_sigma_m.max() < 0.03
    assert transforms.angle_deg(found.rig_from_lidar[:3, :3], _PLACE[:3, :3]) < 0.1
    assert found.scale == pytest.approx(_SCALE, abs=0.002) and found.left_open == ()


@pytest.mark.slow
def test_a_straight_path_says_what_it_leaves_open() -> None:
    rig, lidar = _both(seconds=6, wobble=0.0)
    found = hand_eye(rig, lidar, clock_s=_CLOCK_S)
    assert found.clock_s == _CLOCK_S and np.isnan(found.clock_sigma_s)
    assert sum("lever arm" in what for what in found.left_open) == 3
    assert any("turn about" in what for what in found.left_open)
    assert np.linalg.norm(found.rig_from_lidar[:3, 3]) < 4  # held near zero, not guessed


@pytest.mark.slow
def test_given_place_and_times_apart() -> None:
    rig, lidar = _both(seconds=6)
    found = hand_eye(rig, lidar, _PLACE, _CLOCK_S)
    np.testing.assert_allclose(found.rig_from_lidar, _PLACE, atol=1e-12)
    assert np.isnan(found.place_sigma_m).all() and found.left_open == ()
    there = rig_in_lidar_world(lidar, rig.time_s, found)
    assert np.isfinite(there).any()
    far = Poses(rig.time_s + 100, rig.poses, rig.group)
    with pytest.raises(InputError, match="frames in common.*--clock-s"):
        hand_eye(far, lidar)


@pytest.mark.slow
def test_points_tell_the_lever_arm_where_the_motion_does_not() -> None:
    """Six frames: by the motion decimetres, by points of the run on the surfaces of the map a centimetre."""
    rig, lidar = _both(seconds=4, wobble=0.3, noise=2)
    found = hand_eye(rig, lidar)
    assert found.place_sigma_m.max() > 0.02
    rng = np.random.default_rng(5)
    sides = np.concatenate([_plane(rng, axis, at) for axis in range(3) for at in (-6.0, 6.0)])
    in_run = Similarity(1 / _SCALE, _TURN, np.array([3.0, 4, 5]))  # the world of _both: scaled, turned, shifted
    other = in_run(np.concatenate([_plane(rng, axis, at) for axis in range(3) for at in (-6.0, 6.0)]))
    true = Similarity(_SCALE, _TURN.T, -_SCALE * _TURN.T @ np.array([3.0, 4, 5]))
    start = Similarity(1.01 * _SCALE, true.rotation, true.translation + [0.1, -0.1, 0.1])
    tie = tie_by_points(other, sides, start)
    assert tie is not None and 0 < tie.place_sigma_m < 0.01
    better = settled(rig, lidar, found, tie)
    assert better.tie is tie and np.abs(better.rig_from_lidar[:3, 3] - _PLACE[:3, 3]).max() < 0.02
    assert better.place_sigma_m.max() < found.place_sigma_m.max()


@pytest.mark.slow
def test_no_tie_along_a_bare_tunnel() -> None:
    rng = np.random.default_rng(1)
    tunnel = np.concatenate([_plane(rng, axis, at) for axis in (1, 2) for at in (-6.0, 6.0)])
    one = Similarity(1.0, np.eye(3), np.zeros(3))
    assert tie_by_points(tunnel + rng.normal(0, 0.01, tunnel.shape), tunnel, one) is None


def _plane(rng: np.random.Generator, axis: int, at: float) -> np.ndarray:
    points = rng.uniform(-6, 6, (4000, 3))
    points[:, axis] = at + rng.normal(0, 0.005, len(points))
    return points


_BESIDE = transforms.rigid(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.1, 0.4, -0.6]))


def _scene(frames: int) -> Scene:
    """Two images a frame, two sections."""
    rig, order = Rig("pair", (Sensor("a"), Sensor("b"))), np.repeat(np.arange(frames), 2)
    names, half = [f"{k}.jpg" for k in range(2 * frames)], (np.arange(frames) >= frames // 2).astype(int)
    track = np.zeros(frames, int)
    return simple_scene(rig, names, order, np.tile([0, 1], frames), track, sequences=("up",), section=half)


def _cloud(xyz: np.ndarray) -> Cloud:
    grey, missing = np.zeros((len(xyz), 3), np.uint8), np.full((len(xyz), 3), np.nan, np.float32)
    return Cloud(xyz, grey, missing, missing[:, 0], grey[:, 0])


@pytest.mark.slow
def test_a_run_beside_the_lidar() -> None:
    count, off_m = 12, 0.02
    time_s = START_S + 0.2 * np.arange(1, count + 1)
    rng = np.random.default_rng(3)
    rig = world_from_lidar(time_s) @ transforms.invert(_BESIDE)
    rig[:, :3, 3] += rng.normal(0, 0.001, (count, 3))
    scans = START_S + np.arange(0, 3, 0.1)
    lidar = Poses(scans, world_from_lidar(scans), np.zeros(len(scans), int))
    hall = np.concatenate([_seen(t.xyz_m, t.offset_s, t.start_s) for t in turns(10, noise_m=0.005)])
    run = SurveyRun(
        scene=_scene(count),
        rig=Poses(time_s, rig, np.zeros(count, int)),
        frame=np.arange(count),
        used=np.arange(2 * count) != 3,
        points=hall[::7] + rng.normal(0, 0.005, hall[::7].shape),
        cloud=_cloud(hall[::5] + [0, 0, off_m]),
        seconds={"SfM": 60.0, "Overall processing": 90.0},
    )
    found = calibrated(run, lidar, _cloud(hall))
    assert np.abs(found.rig_from_lidar[:3, 3] - _BESIDE[:3, 3]).max() < 0.01
    assert abs(found.clock_s) < 0.005
    told = compared(run, lidar, _cloud(hall), found, VerbTunings())
    assert not any("one survey" in note for note in told["run_notes"])
    table = {row[0]: row[1:] for row in told["tables"]["survey"]["rows"]}
    assert told["tables"]["survey"]["columns"] == ["", "all", "section 0", "section 1"]
    assert table["The number of input images"] == [24, 12, 12]
    assert table["The number of used images"] == [23, 11, 12]
    assert table["SfM [s]"][0] == 60.0 and np.isnan(table["SfM [s]"][1])
    assert table["The number of points after MVS"][0] == sum(table["The number of points after MVS"][1:])
    assert all(0 < v < 0.01 for v in table["RMSE of positions against the LiDAR [m]"])
    assert all(abs(v - 1) < 0.01 for v in table["scale against the LiDAR"])
    assert 0 < table["cloud to the LiDAR's nearest point, median [m]"][0] < 3 * off_m
    assert all(abs(v) < off_m / 4 for v in table["cloud along the LiDAR's surfaces (M3C2), median [m]"])  # walls stay
    assert all(off_m / 4 < v < off_m for v in table["cloud along the LiDAR's surfaces (M3C2), spread [m]"])
    assert [row[:2] for row in told["tables"]["trajectory by section"]["rows"]] == [["0", 6], ["1", 6]]


@pytest.mark.slow
def test_another_survey_is_noticed() -> None:
    """The run's frames go another way than the LiDAR."""
    time_s, scans = START_S + 0.2 * np.arange(1, 13), START_S + np.arange(0, 3, 0.1)
    rig = Poses(time_s, world_from_lidar(START_S + 3 * (time_s[::-1] - START_S)), np.zeros(12, int))
    run = SurveyRun(_scene(12), rig, np.arange(12), np.ones(24, bool), points=np.zeros((0, 3)), cloud=None, seconds={})
    lidar, reference = Poses(scans, world_from_lidar(scans), np.zeros(len(scans), int)), _cloud(np.ones((3, 3)))
    found = calibrated(run, lidar, reference)
    assert found.tie is None
    notes = compared(run, lidar, reference, found, VerbTunings())["run_notes"]
    assert any("are these one survey" in note for note in notes)


def _seen(xyz: np.ndarray, offset_s: np.ndarray, start_s: float) -> np.ndarray:
    poses = world_from_lidar(start_s + offset_s)
    return np.einsum("nij,nj->ni", poses[:, :3, :3], xyz) + poses[:, :3, 3]
