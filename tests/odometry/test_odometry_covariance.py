"""Covariances by simulated observations, whose noise is known: errors over sigmas are as they should be."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry.odometry_world import single, stereo, truth
from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Tracks
from tiegraph.odometry.covariance import keyframe_covariances, resection_covariance, wider
from tiegraph.odometry.tuning import Tuning
from tiegraph.odometry.worldmap import Keyframe, WorldMap, adjust

KEYFRAMES, POINTS, NOISE_PX, LOSS_PX = 7, 300, 0.4, 1.0


def world_of(cameras, seed, noise_px=NOISE_PX):
    """A map at the truth with noisy observations."""
    rng = np.random.default_rng(seed)
    world = WorldMap(cameras)
    first = transforms.invert(truth(0))
    poses = [transforms.invert(first @ truth(4 * k)) for k in range(KEYFRAMES)]
    points = np.column_stack([rng.uniform(-4, 4, POINTS), rng.uniform(-2, 1.5, POINTS), rng.uniform(3, 14, POINTS)])
    world.new_points(POINTS)
    world.xyz[:] = points
    for number, pose in enumerate(poses):
        seen = Tracks.none()
        for camera in range(len(cameras)):
            where = np.full(POINTS, camera)
            xy = cameras.project(where, transforms.apply(pose, points))
            noisy = xy + rng.normal(0, noise_px, xy.shape)
            seen = seen.plus(Tracks(np.arange(POINTS), where, noisy).where(cameras.inside(camera, xy)))
        world.keyframes.append(Keyframe(frame=number, segment=0, rig_from_world=pose, seen=seen))
    return world, poses


def errors(world, poses):
    """(K, 6) of position and turn about the world's axes."""
    out = []
    for frame, true in zip(world.keyframes, poses):
        found, there = transforms.invert(frame.rig_from_world), transforms.invert(true)
        turn = Rotation.from_matrix(found[:3, :3] @ there[:3, :3].T).as_rotvec()
        out.append([*(found - there)[:3, 3], *turn])
    return np.array(out)


def normalised(cameras, seeds, held, **noise):
    """(S, 6) errors of the last keyframe over its sigmas."""
    out = []
    for seed in seeds:
        world, poses = world_of(cameras, seed, **noise)
        numbers = list(range(KEYFRAMES))
        adjust(world, numbers, held, Tuning().map, LOSS_PX, 30)
        sigma = np.sqrt(np.diag(keyframe_covariances(world, numbers, LOSS_PX, len(cameras) > 1)[-1]))
        out.append(errors(world, poses)[-1] / sigma)
    return np.array(out)


@pytest.mark.slow
def test_errors_are_as_large_as_the_sigmas_say():
    """60 values, of which half are nearly independent: the ratio is known to about 10 %."""
    ratio = np.sqrt(np.mean(normalised(stereo(), range(10), [0]) ** 2))
    assert 0.7 < ratio < 1.35


def test_the_first_keyframe_and_the_first_base_line_are_held():
    world, _ = world_of(single(), 0)
    numbers = list(range(KEYFRAMES))
    found = keyframe_covariances(world, numbers, LOSS_PX, metric=False)
    assert (found[0] == 0).all() and np.isfinite(found).all()
    places = [transforms.centre(world.keyframes[k].rig_from_world) for k in (0, 1)]
    way = (places[1] - places[0]) / np.linalg.norm(places[1] - places[0])
    along, all_of_it = np.sqrt(way @ found[1][:3, :3] @ way), np.sqrt(np.trace(found[1][:3, :3]))
    assert along < 0.01 * all_of_it


def test_more_noise_gives_sigmas_as_much_larger():
    sigmas = []
    for noise in (0.2, 0.4):
        world, _ = world_of(stereo(), 3, noise_px=noise)
        sigmas.append(np.sqrt(np.diag(keyframe_covariances(world, list(range(KEYFRAMES)), 100.0, True)[-1])))
    assert np.allclose(sigmas[1] / sigmas[0], 2, rtol=0.05)


def test_a_sigma_is_raised_and_correlations_stay():
    classical = np.diag([1.0, 4.0]) + 0.5 * (1 - np.eye(2))
    raised = wider(classical, np.diag([9.0, 1.0]))
    assert np.allclose(np.diag(raised), [9, 4]) and np.isclose(raised[0, 1], 1.5)


def test_a_point_behind_a_camera_says_nothing_of_a_frame():
    """Later keyframes may move a point there; a frame that has lost nearly all of them is not known."""
    world, poses = world_of(single(), 1)
    seen = world.keyframes[2].seen
    xyz = world.xyz[seen.point].copy()
    whole = resection_covariance(world.cameras, poses[2], seen, xyz, LOSS_PX)
    back = transforms.apply(transforms.invert(poses[2]), np.array([[0.0, 0, -2]]))
    xyz[:20] = back
    less = resection_covariance(world.cameras, poses[2], seen, xyz, LOSS_PX)
    others = seen.where(np.arange(len(seen)) >= 20)
    assert np.allclose(less, resection_covariance(world.cameras, poses[2], others, xyz[20:], LOSS_PX))
    assert 1 < np.trace(less[:3, :3]) / np.trace(whole[:3, :3]) < 2
    xyz[2:] = back
    assert np.isnan(resection_covariance(world.cameras, poses[2], seen, xyz, LOSS_PX)).all()
