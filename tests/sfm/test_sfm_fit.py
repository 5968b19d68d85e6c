"""The similarity from a model to the world and the errors of the positions it is fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from sfm_worlds import evidence_of

from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import Up
from tiegraph.geometry.transforms import Similarity, skew
from tiegraph.sfm.tuning.world import FitTuning, NoiseTuning, WorldTuning
from tiegraph.sfm.world.fit import ANTENNA, CLOCK, Evidence, _Problem, by_errors, fit_similarity
from tiegraph.sfm.world.positionerrors import PositionErrors, Stated
from tiegraph.sfm.world.upright import up_to_use

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
        sigma=np.tile([0.05, 0.05, 0.1], (40, 1)), orientation=orientation, modes=np.zeros((40, 3, 0)),
        antenna=GIVEN, free=frozenset([ANTENNA, CLOCK]), log_scale=(np.log(2.6), 0.1), speed=speed,
    )  # fmt: skip


WITHOUT = {
    "all": {},
    "no lever arm": {"free": frozenset([CLOCK])},
    "no clock": {"free": frozenset([ANTENNA])},
    "clock without speeds": {"speed": np.zeros((40, 4, 4))},
    "positions alone": {"free": frozenset(), "log_scale": None, "orientation": np.full((40, 3, 3), np.nan)},
}


@pytest.mark.parametrize("less", WITHOUT.values(), ids=WITHOUT)
@pytest.mark.parametrize("up", [UP, replace(UP, ring=False, tilt=False), None], ids=["ring", "one side", "no upward"])
@pytest.mark.parametrize("turn_deg", [0.0, 40.0, 150.0])
def test_derivatives_are_those_of_the_residuals(less, up, turn_deg) -> None:
    evidence = replace(_winding(0.05), **less)
    start = Similarity(2.2, TRUE.rotation @ Rotation.from_rotvec([0.1, -0.2, 0.15]).as_matrix(), TRUE.translation + 1)
    problem, weight = _Problem(evidence, up, start, TUNING), np.random.default_rng(1).random(40)
    x = np.full(problem.size, 0.1)
    x[:3] = np.radians(turn_deg) * np.array([0.6, -0.64, 0.48])

    def residuals(y: np.ndarray) -> np.ndarray:
        return np.concatenate([(problem.residuals(y) * weight[:, None]).ravel(), problem.others(y)[0]])

    places = problem.positions(x)[1] * (weight[:, None] / evidence.sigma)[:, :, None]
    own = np.concatenate([places.reshape(-1, problem.size), problem.others(x)[1]])
    numeric = np.mean([approx_fprime(x, residuals, sign * 1e-6) for sign in (1, -1)], axis=0)
    assert own.shape == numeric.shape
    np.testing.assert_allclose(own, numeric, atol=1e-6 * np.abs(numeric).max(), rtol=1e-5)


def test_scale_that_is_held_back_has_no_derivative() -> None:
    evidence = _winding(0.05)
    problem = _Problem(evidence, UP, TRUE, TUNING)
    x = np.zeros(problem.size)
    x[6] = 6.0  # beyond what a step may change it by
    for rows in (problem.positions(x)[1], problem.others(x)[1]):
        np.testing.assert_array_equal(rows[..., 6], 0.0)


@pytest.mark.slow
def test_truth_is_found_with_lever_arm_and_clock() -> None:
    found = fit_similarity(replace(_winding(0.0), log_scale=None), UP, TUNING)
    assert found.similarity.scale == pytest.approx(TRUE.scale, rel=5e-4)
    np.testing.assert_allclose(found.similarity.rotation, TRUE.rotation, atol=2e-3)
    np.testing.assert_allclose(found.antenna[:2], LEVER[:2], atol=0.02)
    assert found.offset_s == pytest.approx(LATE_S, abs=0.01) and found.inlier.all()


@pytest.mark.slow
def test_straight_track_needs_the_upward_direction() -> None:
    """Thirty upright poses on a straight level line; the model is turned, scaled and moved."""
    s = np.linspace(0, 100, 30)
    world = np.stack([s, 0.3 * s, 0 * s], axis=1)
    pose = transforms.rigid(
        TRUE.rotation.T @ np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
        (world - TRUE.translation) @ TRUE.rotation / TRUE.scale,
    )
    noise = 0.3 * np.random.default_rng(0).standard_normal((30, 3))
    evidence = evidence_of(pose[:, :3, 3], world + noise, 0.3, pose=pose)
    up = Up(TRUE.rotation.T @ np.array([0.0, 0.0, 1.0]), 3.0, True, True, "the ring")
    alone, held, lone = (
        fit_similarity(evidence, u, TUNING) for u in (None, up, replace(up, ring=False, tilt=False, sigma_deg=10.0))
    )
    tilt = [np.degrees(np.arccos((fit.similarity.rotation @ up.direction)[2])) for fit in (held, lone)]
    assert alone.roll_sigma_deg > 20 and 0.1 < held.roll_sigma_deg < 5 and max(tilt) < 1.0
    assert held.similarity.scale == pytest.approx(TRUE.scale, rel=0.02)


_THERE = np.stack([np.arange(60.0), np.sin(np.arange(60) / 7), 0.2 * np.cos(np.arange(60) / 5)], axis=1)
PATH = np.concatenate([_THERE, _THERE[::-1] + [0, 6, 0]])  # there and back, metres; a position a second
COUNT = len(PATH)


def _errors(white: float, slow: float, lasts_s: float, rng: np.random.Generator) -> np.ndarray:
    """(K, 3) in stated sigmas."""
    z, keeps = rng.standard_normal((COUNT, 3)), np.exp(-1 / lasts_s)
    for k in range(1, COUNT):
        z[k] = keeps * z[k - 1] + np.sqrt(1 - keeps**2) * z[k]
    return white * rng.standard_normal((COUNT, 3)) + slow * z


def _errors_in(residual: np.ndarray, sigma: float, level: np.ndarray) -> PositionErrors:
    rows, here = np.zeros((COUNT, 3, 8)), PATH - PATH.mean(axis=0)
    rows[:, :, :3], rows[:, :, 3:6], rows[:, :, 6], rows[:, :, 7] = -skew(here), np.eye(3), here, sigma * residual
    known = np.diag([1e-6] * 3 + [0.0] * 5)
    return PositionErrors(rows, stated(COUNT, sigma, np.nan, level=level), known, NoiseTuning())


def stated(count: int, sigma: float, common: float, **more: np.ndarray) -> Stated:
    """What positions of one level say of themselves, one a second."""
    given = {"level": np.zeros(count, int), "time_s": np.arange(float(count))} | more
    return Stated(sigma=np.full((count, 3), sigma), common=np.full(3, common), **given)


@pytest.mark.parametrize(
    ("white", "slow", "lasts_s", "bounds"),
    [(0.7, 0.7, 60.0, (0.8, 1.3)), (0.05, 0.05, 60.0, (0.8, 1.3)), (0.3, 2, 20, (0.7, 1.3)), (1, 0.02, 60, (0.4, 1))],
)  # fmt: skip
@pytest.mark.slow
def test_errors_over_their_sigmas(white, slow, lasts_s, bounds) -> None:
    """Of turn, shift and scale, over surveys of one kind; errors that are all white may be thought to last a little."""
    rng, level, ratios, sizes = np.random.default_rng(1), np.zeros(COUNT, int), [], []
    for _ in range(25):
        errors = _errors_in(_errors(white, slow, lasts_s, rng), 2.0, level)
        moved, covariance = errors.step({})
        ratios.append(moved / np.sqrt(np.diag(covariance)))
        sizes.append([errors.sizes.white[0], errors.sizes.slow[0]])
    assert bounds[0] < np.sqrt(np.mean(np.square(ratios))) < bounds[1]
    assert np.median(sizes, axis=0) == pytest.approx([white, slow], rel=0.15, abs=0.35 * white)


@pytest.mark.slow
def test_each_level_of_the_stated_sigma_has_its_own_size() -> None:
    level = (np.arange(COUNT) < 60).astype(int)
    off = _errors(1.0, 1e-3, 60.0, np.random.default_rng(2)) * np.where(level, 4.0, 0.5)[:, None]
    level[:3] = 7  # too few to tell by themselves
    sizes = _errors_in(off, 1.0, level).sizes
    assert sizes.white[0] == pytest.approx(0.5, rel=0.2) and sizes.white[1] == pytest.approx(4.0, rel=0.2)
    assert len(sizes.white) == 3


@pytest.mark.parametrize(("turned_deg", "wide", "used"), [(80.0, 3.0, False), (8.0, 0.0, True), (80.0, 0.0, True)])
def test_an_upward_direction_that_the_positions_refute_is_not_used(turned_deg, wide, used) -> None:
    """Photographs straight down have tops that point anywhere; a straight track cannot refute them."""
    place = np.stack([np.arange(20.0), wide * (np.arange(20) % 4 > 1), np.zeros(20)], axis=1)
    evidence = evidence_of(place, place + 0.01 * np.random.default_rng(3).standard_normal(place.shape), 0.1)
    turn = np.radians(turned_deg)
    up = Up(np.array([0.0, np.sin(turn), np.cos(turn)]), 10.0, ring=False, tilt=False, cameras="the images")
    found, note = up_to_use(evidence, up, WorldTuning())
    assert (found is up) == used and ("not used" in note) == (not used)


@pytest.mark.slow
@pytest.mark.parametrize(("stated_m", "held"), [(2.0, True), (0.05, False)])
def test_passes_that_errors_turn_over_each_other_are_held_upright_where_these_may_be_so_large(stated_m, held) -> None:
    """Of two passes 3 m apart one is 2.3 m too high: alone they lean by 50 degrees, and know it to a few."""
    back, lean = np.arange(40) >= 20, np.radians(50)
    place = np.stack([2.0 * (np.arange(40) % 20), 3.0 * back, np.zeros(40)], axis=1)
    noise, tuning = 0.05 * np.random.default_rng(5).standard_normal(place.shape), WorldTuning()
    turned = np.outer(back, [0, 3 * (np.cos(lean) - 1), 3 * np.sin(lean)])
    evidence = evidence_of(place, place + noise + turned, stated_m)
    rows = stated(40, stated_m, np.nan, time_s=np.arange(40.0) + 300 * back)
    up = Up(np.array([0.0, 0, 1]), 3.0, ring=True, tilt=True, cameras="the ring")
    alone, upright = (by_errors(evidence, u, fit_similarity(evidence, u, tuning.fit), rows, tuning) for u in (None, up))
    found, note = up_to_use(evidence, up, tuning, replace(alone, error=_known(alone, 3.0)), upright)
    assert (found is up) == held and ("is used" in note) == held
    assert held == (np.degrees(np.arccos((upright.similarity.rotation @ up.direction)[2])) < 6 and found is up)


def _known(fit, tilt_deg: float):
    """Its error, the tilt stated to so many degrees."""
    turn = np.radians(tilt_deg) ** 2 / 2
    return replace(fit.error, covariance=np.diag([turn, turn, 1e-4, 0.1, 0.1, 0.1, 1e-4]))


def test_where_no_position_is_believed_the_control_points_alone_tell() -> None:
    place = np.random.default_rng(4).uniform(-20, 20, (12, 3))
    evidence = evidence_of(place, place, 0.1, frame=np.where(np.arange(12) < 6, np.arange(12), -1))
    fit = replace(fit_similarity(evidence, None, WorldTuning().fit), inlier=np.arange(12) >= 6)
    found = by_errors(evidence, None, fit, stated(6, 0.1, 0.1), WorldTuning())
    assert found.levels == [] and np.abs(found.similarity(place) - place).max() < 1e-6
    assert found.sigma["position_m"] == pytest.approx(0.1 * np.sqrt(2 / 6), rel=0.3)


@pytest.mark.slow
def test_what_the_model_bends_is_no_error_of_the_positions() -> None:
    """A way of 600 m bent by half a metre, without positions in its middle third: the errors of the similarity of all
    its frames over their sigmas, and what is left of the bend."""
    rng, count = np.random.default_rng(5), 120
    s = np.linspace(-1, 1, count)
    true = np.stack([300 * s, 10 * np.sin(9 * s), np.zeros(count)], axis=1)
    form = np.stack([s**2 - np.mean(s**2), s**3 - np.polyval(np.polyfit(s, s**3, 1), s)])
    bend = 0.5 * np.einsum("mk,ij->kimj", form, np.eye(3)).reshape(count, 3, 6)
    known, ratios, left = np.flatnonzero(np.abs(s) > 1 / 3), [], []
    rows = stated(len(known), 0.02, 0.01, time_s=known * 2.0)
    for _ in range(8):
        place = true - bend @ rng.standard_normal(6)
        noise = 0.02 * (0.7 * rng.standard_normal((count, 3)) + 0.5 * rng.standard_normal(3))
        evidence = evidence_of(place, true + noise, 0.02, modes=bend).where(known)
        rough = fit_similarity(replace(evidence, sigma=np.full((len(known), 3), 0.5)), None, WorldTuning().fit)
        fit = by_errors(evidence, None, rough, rows, WorldTuning())
        off = fit.similarity.matrix[:3, 3]
        ratios.append(np.append(off, np.log(fit.similarity.scale)) / np.sqrt(np.diag(fit.error.covariance)[3:7]))
        left.append(np.sqrt(np.diag(fit.bent[1])))
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4 and 0.003 < np.median(left) < 0.1
