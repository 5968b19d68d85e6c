"""A LiDAR on a rig: place and clock from two trajectories, what they leave open; a run beside the LiDAR, by section."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidar.lidar_world import START_S, turns, world_from_lidar
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.lidar.handeye import Poses, hand_eye, rig_in_lidar_world, settled
from tiegraph.lidar.pointtie import tie_by_points
from tiegraph.pipeline.lidar import SurveyRun, calibrated, compared
from tiegraph.project.settings import VerbTunings
from tiegraph.scene.results import Cloud
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

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
    rig, lidar = _both(wobble=0.0)
    found = hand_eye(rig, lidar, clock_s=_CLOCK_S)
    assert found.clock_s == _CLOCK_S and np.isnan(found.clock_sigma_s)
    assert sum("lever arm" in what for what in found.left_open) == 3
    assert any("turn about" in what for what in found.left_open)
    assert np.linalg.norm(found.rig_from_lidar[:3, 3]) < 4  # held near zero, not guessed


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
