"""A LiDAR on a rig: place and clock from two trajectories with noise, and what a straight path leaves open."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidar.lidar_world import START_S, world_from_lidar
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.lidar.handeye import Given, Poses, hand_eye, rig_in_lidar_world, settled
from tiegraph.lidar.pointtie import tie_by_points

_PLACE = transforms.rigid(
    Rotation.from_euler("xyz", [5, -88, 12], degrees=True).as_matrix(), np.array([0.3, -0.7, 0.1])
)
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
    turned = transforms.rigid(
        Rotation.from_euler("xyz", [40, 20, -60], degrees=True).as_matrix(), np.array([3.0, 4, 5])
    )
    one = np.zeros(len(frames), int)
    return Poses(frames, turned @ rig, one), Poses(scans + _CLOCK_S, lidar, np.zeros(len(scans), int))


@pytest.mark.slow
def test_place_clock_and_scale_of_a_wobbling_path() -> None:
    rig, lidar = _both()
    found = hand_eye(rig, lidar, Given())
    off = found.rig_from_lidar[:3, 3] - _PLACE[:3, 3]
    assert 0 < abs(found.clock_s - _CLOCK_S) < 0.005
    assert found.clock_sigma_s < 0.005
    assert np.abs(off).max() < 0.02
    assert np.all(np.abs(off) < 4 * found.place_sigma_m) and found.place_sigma_m.max() < 0.03
    assert transforms.angle_deg(found.rig_from_lidar[:3, :3], _PLACE[:3, :3]) < 0.1
    assert found.scale == pytest.approx(_SCALE, abs=0.002)
    assert found.left_open == ()


@pytest.mark.slow
def test_a_straight_path_says_what_it_leaves_open() -> None:
    rig, lidar = _both(wobble=0.0)
    found = hand_eye(rig, lidar, Given(clock_s=_CLOCK_S))
    assert found.clock_s == _CLOCK_S and np.isnan(found.clock_sigma_s)
    assert sum("lever arm" in what for what in found.left_open) == 3
    assert any("turn about" in what for what in found.left_open)
    assert np.linalg.norm(found.rig_from_lidar[:3, 3]) < 4  # held near zero, not guessed


def test_given_place_and_times_apart() -> None:
    rig, lidar = _both(seconds=6)
    found = hand_eye(rig, lidar, Given(_PLACE, _CLOCK_S))
    np.testing.assert_allclose(found.rig_from_lidar, _PLACE, atol=1e-12)
    assert np.isnan(found.place_sigma_m).all() and found.left_open == ()
    there = rig_in_lidar_world(lidar, rig.time_s, found)
    assert np.isfinite(there).any()
    far = Poses(rig.time_s + 100, rig.poses, rig.group)
    with pytest.raises(InputError, match="frames in common.*--clock-s"):
        hand_eye(far, lidar, Given())


@pytest.mark.slow
def test_points_tell_the_lever_arm_where_the_motion_does_not() -> None:
    """Six frames: by the motion decimetres, by points of the run on the surfaces of the map a centimetre."""
    rig, lidar = _both(seconds=4, wobble=0.3, noise=2)
    found = hand_eye(rig, lidar, Given())
    assert found.place_sigma_m.max() > 0.02
    rng = np.random.default_rng(5)
    sides = np.concatenate([_plane(rng, axis, at) for axis in range(3) for at in (-6.0, 6.0)])
    # the run's world is that of _both: scaled, turned, shifted
    turn = Rotation.from_euler("xyz", [40, 20, -60], degrees=True).as_matrix()
    in_run = Similarity(1 / _SCALE, turn, np.array([3.0, 4, 5]))
    other = in_run(np.concatenate([_plane(rng, axis, at) for axis in range(3) for at in (-6.0, 6.0)]))
    true = Similarity(_SCALE, turn.T, -_SCALE * turn.T @ np.array([3.0, 4, 5]))
    start = Similarity(1.01 * _SCALE, true.rotation, true.translation + [0.1, -0.1, 0.1])
    tie = tie_by_points(other, sides, start)
    assert tie is not None and 0 < tie.place_sigma_m < 0.01
    better = settled(rig, lidar, found, tie)
    assert better.tie is tie
    assert np.abs(better.rig_from_lidar[:3, 3] - _PLACE[:3, 3]).max() < 0.02
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
