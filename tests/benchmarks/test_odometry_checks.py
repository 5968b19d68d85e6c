"""Errors over sigmas: 1 where sigmas are true, and of the odometry's own on a rendered drive begun thrice."""

import numpy as np
import pytest
from benchmarks.odometrychecks import agreement, by_length, errors_over_sigmas
from scipy.spatial.transform import Rotation

from odometry.odometry_world import FRAMES, drive, single, stereo, true_path, truth
from tiegraph.geometry import transforms
from tiegraph.odometry.odometry import OdometryPath

COUNT, PLACE_M, TURN = 400, 0.03, 0.002


def noisy(metric, scale=1.0, seed=0):
    """A path with errors of known sigmas about a line, and the line; ``scale``: of the path's unit."""
    rng = np.random.default_rng(seed)
    true = transforms.rigid(np.tile(np.eye(3), (COUNT, 1, 1)), np.outer(np.arange(COUNT), [0.0, 0, 0.5]))
    poses = true.copy()
    poses[1:, :3, 3] += rng.normal(0, PLACE_M, (COUNT - 1, 3))
    poses[1:, :3, :3] = Rotation.from_rotvec(rng.normal(0, TURN, (COUNT - 1, 3))).as_matrix()
    poses[:, :3, 3] *= scale
    sigma = np.diag([(PLACE_M * scale) ** 2] * 3 + [TURN**2] * 3)
    covariance = np.tile(sigma, (COUNT, 1, 1))
    covariance[0] = 0
    segment, key = np.zeros(COUNT, int), np.ones(COUNT, bool)
    return OdometryPath(poses, segment, key, covariance, metric, 0), true


@pytest.mark.parametrize(("metric", "scale"), [(True, 1.0), (False, 3.0)])
def test_true_sigmas_give_one_and_sigmas_too_wide_by_three_a_third(metric, scale):
    path, true = noisy(metric, scale)
    for factor in (1.0, 3.0):
        wide = OdometryPath(
            path.world_from_rig, path.segment, path.keyframe, factor**2 * path.covariance, metric, loops=0
        )
        for part in by_length(np.array(errors_over_sigmas(wide, true))):
            assert 0.88 < factor * part["position"] < 1.12 and 0.88 < factor * part["turn"] < 1.12
            assert part["poses"] == pytest.approx((COUNT - 1) / 3, abs=1)


def test_a_path_in_another_unit_and_world_agrees_and_one_that_bends_does_not():
    path, true = noisy(metric=True)
    moved = transforms.rigid(Rotation.from_euler("xyz", [0.3, 0.2, 1.0]).as_matrix(), [5.0, 0, 1]) @ path.world_from_rig
    moved[:, :3, 3] *= 2.0
    same = agreement(path, moved, np.arange(COUNT))
    assert same["scale"] == 0.5 and same["rms_percent_of_way"] < 1e-3 and same["turn_median_deg"] < 1e-3
    bent = path.world_from_rig.copy()
    bent[:, 0, 3] += np.linspace(-1, 1, COUNT) ** 2 * 10  # metres, of 200
    bent[: COUNT // 2] = np.nan
    part = agreement(path, bent, np.arange(COUNT))
    assert part["frames"] == COUNT // 2 and 0.2 < part["rms_percent_of_way"] < 2


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [stereo, single])
def test_the_sigmas_of_a_drive_are_neither_too_small_nor_too_wide(cameras):
    """Of drives begun at three places and backwards: medians of some sixty relative poses, few of them independent."""
    rows = []
    for frames in (list(range(FRAMES)), list(range(6, FRAMES)), list(range(FRAMES))[::-1]):
        path = drive(cameras(), frames)
        assert (path.segment == 0).all()
        rows += errors_over_sigmas(path, true_path(frames) if frames[0] == 0 else np.stack([truth(f) for f in frames]))
    assert len(rows) > 50
    place, turn = np.median(np.array(rows)[:, 1:], axis=0)
    assert 0.4 < place < 2.5 and 0.5 < turn < 2
