"""Own Ceres residuals: values and Jacobians against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.sfm.adjustment.costs import PriorCost
from tiegraph.sfm.world.costs import LengthCost, PositionCost, UpCost, ZeroCost, back_rotated

_STEP = 1e-6


def _pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.append(Rotation.random(random_state=seed).as_quat(), 5 * rng.standard_normal(3))


def _value(cost, blocks: list[np.ndarray], size: int) -> np.ndarray:
    out = np.zeros(size)
    assert cost.Evaluate(blocks, out, None)
    return out


def _check(cost, blocks: list[np.ndarray], size: int) -> None:
    jacobians = [np.zeros(size * len(b)) for b in blocks]
    cost.Evaluate(blocks, np.zeros(size), jacobians)
    for k, block in enumerate(blocks):
        for j in range(len(block)):
            ends = []
            for sign in (1, -1):
                moved = [b.copy() for b in blocks]
                moved[k][j] += sign * _STEP
                ends.append(_value(cost, moved, size))
            numeric = (ends[0] - ends[1]) / (2 * _STEP)
            np.testing.assert_allclose(jacobians[k].reshape(size, -1)[:, j], numeric, atol=1e-6)


def test_back_rotation_is_that_of_the_pose() -> None:
    pose, point = _pose(1), np.array([1.0, -2.0, 0.5])
    place, inverse = back_rotated(pose, point)
    rotation = Rotation.from_quat(pose[:4]).as_matrix()
    np.testing.assert_allclose(place, rotation.T @ (point - pose[4:]), atol=1e-12)
    np.testing.assert_allclose(inverse, rotation.T, atol=1e-12)


def test_position_between_four_frames() -> None:
    rng = np.random.default_rng(0)
    frame_from_rig = np.tile(np.eye(4), (4, 1, 1))
    for k in range(4):
        frame_from_rig[k, :3, :3] = Rotation.random(random_state=k).as_matrix()
        frame_from_rig[k, :3, 3] = rng.standard_normal(3)
    cost = PositionCost(
        rng.standard_normal(4),
        rng.standard_normal(4),
        frame_from_rig,
        rng.standard_normal(3),
        np.array([0.1, 0.2, 0.3]),
    )
    blocks = [*(_pose(k) for k in range(4)), rng.standard_normal(3), rng.standard_normal(1)]
    _check(cost, blocks, 3)


def test_position_at_a_frame_is_centre_plus_turned_arm() -> None:
    pose, arm = _pose(3), np.array([0.9, -0.2, 0.4])
    rotation = Rotation.from_quat(pose[:4]).as_matrix()
    antenna = rotation.T @ (arm - pose[4:])
    cost = PositionCost(np.ones(1), np.zeros(1), np.eye(4)[None], antenna - [0.1, 0, 0], np.full(3, 0.05))
    np.testing.assert_allclose(_value(cost, [pose, arm, np.zeros(1)], 3), [2, 0, 0], atol=1e-9)


def test_prior_and_upward_direction() -> None:
    _check(PriorCost(np.array([1.0, 2.0, 3.0]), 0.1), [np.array([1.1, 2.0, 2.5])], 3)
    pose = _pose(5)
    up = Rotation.from_quat(pose[:4]).as_matrix() @ np.array([0.0, 0.0, 1.0])
    cost = UpCost(up, np.eye(3)[:2], np.radians(3))
    np.testing.assert_allclose(_value(cost, [pose], 2), 0, atol=1e-9)
    leaning = pose.copy()
    leaning[:4] = (Rotation.from_quat(pose[:4]) * Rotation.from_rotvec([np.radians(3), 0, 0])).as_quat()
    assert np.linalg.norm(_value(cost, [leaning], 2)) == pytest.approx(1, rel=0.01)
    _check(cost, [leaning], 2)


def test_a_length_is_the_distance_of_its_ends() -> None:
    a, b = np.array([1.0, 2.0, 3.0]), np.array([1.3, 2.0, 3.4])
    np.testing.assert_allclose(_value(LengthCost(0.4, 0.05), [a, b], 1), [2.0], atol=1e-9)
    _check(LengthCost(0.4, 0.05), [a, b], 1)


def test_a_cost_of_nothing_clears_what_the_solver_left_in_its_memory() -> None:
    cost, blocks = ZeroCost([3, 1]), [np.ones(3), np.ones(1)]
    residuals, jacobians = np.full(2, 7.0), [np.full(6, 7.0), None]
    assert cost.Evaluate(blocks, residuals, jacobians)
    np.testing.assert_array_equal([*residuals, *jacobians[0]], np.zeros(8))


@pytest.mark.parametrize(
    ("cost", "sizes"),
    [
        (PositionCost(np.ones(1), np.zeros(1), np.eye(4)[None], np.ones(3), np.ones(3)), (7, 3, 1)),
        (PriorCost(np.ones(2), 1.0), (2,)),
        (ZeroCost([3, 1]), (3, 1)),
        (LengthCost(1.0, 0.1), (3, 3)),
        (UpCost(np.array([0, 0, 1.0]), np.eye(3)[:2], 0.1), (7,)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_residual_of_constant_blocks_does_not_end_the_process(cost, sizes) -> None:
    """Ceres asks it once, and for no Jacobians; beside it there is something to solve."""
    pyceres = pytest.importorskip("pyceres")
    problem, summary = pyceres.Problem(), pyceres.SolverSummary()
    blocks, free, prior = [0.5 + np.zeros(n) for n in sizes], np.zeros(1), PriorCost(np.full(1, 3.0), 1.0)
    problem.add_residual_block(cost, None, blocks)
    for block in blocks:
        problem.set_parameter_block_constant(block)
    problem.add_residual_block(prior, None, [free])
    pyceres.solve(pyceres.SolverOptions(), problem, summary)
    assert free[0] == pytest.approx(3, abs=1e-4) and all((b == 0.5).all() for b in blocks)
