"""The similarity from a model to the world: derivatives against differences, and the truth found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import Similarity
from tiegraph.geometry.gravity import Up
from tiegraph.sfm.tuning.world import FitTuning
from tiegraph.sfm.world.fit import Evidence, _Problem, _sigma, fit_similarity
from tiegraph.sfm.world.unknowns import LeverArm, LogScale

TUNING = FitTuning()
TRUE = Similarity(2.5, Rotation.from_euler("xyz", [0.6, 0.3, -1.0]).as_matrix(), np.array([10.0, 20.0, 3.0]))
UP = Up(TRUE.rotation.T @ np.array([0.02, -0.01, 0.99975]), 3.0, True, True, "the ring")
LEVER, LATE_S = np.array([0.3, -0.2, 1.1]), 0.15
GIVEN = np.array([0.1, 0.0, 1.0])  # of the lever arm


def _winding(noise_m: float) -> Evidence:
    """Forty poses on a winding way with three control points, lever arm, late clock and a third of the headings."""
    rng = np.random.default_rng(0)
    time = np.linspace(0, 40, 40)
    world = np.stack([30 * np.sin(time / 6), 2 * time, 2 * np.sin(time / 3)], axis=1)
    pose, speed = np.tile(np.eye(4), (40, 1, 1)), np.zeros((40, 4, 4))
    turned = Rotation.from_rotvec(np.stack([0.1 * np.sin(time), 0 * time, np.sin(time / 6)], axis=1)).as_matrix()
    pose[:, :3, 3] = (world - TRUE.translation) @ TRUE.rotation / TRUE.scale
    pose[:, :3, :3] = TRUE.rotation.T @ turned
    speed[:, :3, 3] = np.gradient(pose[:, :3, 3], time, axis=0)
    speed[:, :3, :3] = np.gradient(pose[:, :3, :3], time, axis=0)
    frame = np.arange(40)
    frame[-3:] = -1
    pose[-3:, :3, :3], speed[-3:] = 0.0, 0.0
    there = pose + LATE_S * speed
    position = TRUE(there[:, :3, 3]) + there[:, :3, :3] @ LEVER @ TRUE.rotation.T
    orientation = np.where(np.arange(40)[:, None, None] % 3 == 0, turned, np.nan)
    orientation[-3:] = np.nan
    return Evidence(
        frame=frame, pose=pose, position=position + noise_m * rng.standard_normal((40, 3)),
        sigma=np.tile([0.05, 0.05, 0.1], (40, 1)), orientation=orientation,
        arm=LeverArm(GIVEN, True),
        log_scale=LogScale(np.log(2.6), 0.1), speed=speed, estimate_offset=True,
    )  # fmt: skip


WITHOUT = {
    "all": {},
    "no lever arm": {"arm": LeverArm(GIVEN)},
    "no clock": {"estimate_offset": False, "speed": None},
    "clock without speeds": {"speed": None},
    "positions alone": {
        "arm": LeverArm(GIVEN), "estimate_offset": False, "speed": None, "log_scale": None,
        "orientation": np.full((40, 3, 3), np.nan),
    },
}  # fmt: skip


@pytest.mark.parametrize("less", WITHOUT.values(), ids=WITHOUT)
@pytest.mark.parametrize("up", [UP, replace(UP, ring=False, tilt=False), None], ids=["ring", "one side", "no upward"])
@pytest.mark.parametrize("turn_deg", [0.0, 40.0, 150.0])
def test_derivatives_are_those_of_the_residuals(less, up, turn_deg) -> None:
    evidence = replace(_winding(0.05), **less)
    start = Similarity(2.2, TRUE.rotation @ Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix(), TRUE.translation + 1)
    problem, weight = _Problem(evidence, up, start, TUNING), np.random.default_rng(1).random(40)
    x = np.full(problem.size, 0.1)
    x[:3] = np.radians(turn_deg) * np.array([0.6, -0.64, 0.48])

    for with_scale in (True, False):

        def residuals(y: np.ndarray, with_scale: bool = with_scale) -> np.ndarray:
            return np.concatenate([(problem.positions(y) * weight[:, None]).ravel(), problem.others(y, with_scale)])

        own = problem.derivatives(x, weight, with_scale)
        ends = [approx_fprime(x, residuals, sign * 1e-6) for sign in (1, -1)]
        numeric = np.mean(ends, axis=0)
        assert own.shape == numeric.shape
        np.testing.assert_allclose(own, numeric, atol=1e-6 * np.abs(numeric).max(), rtol=1e-5)


def test_scale_that_is_held_back_has_no_derivative() -> None:
    evidence = _winding(0.05)
    problem = _Problem(evidence, UP, TRUE, TUNING)
    x = np.zeros(problem.size)
    x[6] = 6.0  # beyond what a step may change it by
    own = problem.derivatives(x, np.ones(40))
    np.testing.assert_array_equal(own[:, 6], 0.0)


def test_truth_is_found_with_lever_arm_and_clock() -> None:
    found = fit_similarity(replace(_winding(0.0), log_scale=None), UP, TUNING)
    assert found.similarity.scale == pytest.approx(TRUE.scale, rel=5e-4)
    np.testing.assert_allclose(found.similarity.rotation, TRUE.rotation, atol=2e-3)
    np.testing.assert_allclose(found.arm.place[:2], LEVER[:2], atol=0.02)
    assert found.clock.offset_s == pytest.approx(LATE_S, abs=0.01)
    assert found.inlier.all()


def test_the_sigma_of_what_residuals_leave_open_is_infinite():
    """Three unknowns: the first is measured, the second only in a sum with the third."""
    rows = np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 3.0, 3.0]])
    assert [_sigma(rows, k) for k in (0, 1, 2)] == pytest.approx([0.5, np.inf, np.inf])
    assert _sigma(rows[:1], 1) == np.inf, "fewer residuals than unknowns"
    full = np.random.default_rng(0).normal(size=(9, 4))
    expected = np.sqrt(np.diag(np.linalg.inv(full.T @ full)))
    assert [_sigma(full, k) for k in range(4)] == pytest.approx(expected, rel=1e-9)
