"""Own Ceres residuals: values and Jacobians against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.sfm.adjustment.leverarmprior import _CentresCost, centres_of

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


def test_centres_are_those_of_the_poses() -> None:
    poses = np.array([_pose(1), _pose(2)])
    rotation = Rotation.from_quat(poses[:, :4])
    np.testing.assert_allclose(centres_of(poses)[0], -rotation.inv().apply(poses[:, 4:]), atol=1e-12)


def test_values_and_jacobians() -> None:
    poses, root = [_pose(k) for k in range(3)], np.random.default_rng(0).standard_normal((5, 9))
    np.testing.assert_allclose(_value(_CentresCost(root), poses, 5), root @ centres_of(np.array(poses))[0].ravel())
    _check(_CentresCost(root), poses, 5)


def test_a_residual_of_constant_blocks_does_not_end_the_process() -> None:
    """Ceres asks it once, and for no Jacobians; beside it there is something to solve."""
    pyceres = pytest.importorskip("pyceres")
    problem, summary = pyceres.Problem(), pyceres.SolverSummary()
    blocks, free, cost = [_pose(k) for k in range(2)], np.zeros(1), _CentresCost(np.ones((1, 6)))
    before, prior = [b.copy() for b in blocks], pyceres.factors.NormalPrior(np.full(1, 3.0), np.eye(1))
    problem.add_residual_block(cost, None, blocks)
    for block in blocks:
        problem.set_parameter_block_constant(block)
    problem.add_residual_block(prior, None, [free])
    pyceres.solve(pyceres.SolverOptions(), problem, summary)
    assert free[0] == pytest.approx(3, abs=1e-4) and all((a == b).all() for a, b in zip(before, blocks))
