"""The errors of positions by their residuals: normalised errors of what is fitted to them, and an upward direction."""

from dataclasses import replace

import numpy as np
import pytest

from tiegraph.geometry.gravity import Up
from tiegraph.geometry.transforms import skew
from tiegraph.sfm.tuning.world import NoiseTuning, WorldTuning
from tiegraph.sfm.world.antenna import up_to_use
from tiegraph.sfm.world.fit import Evidence, by_errors, fit_similarity
from tiegraph.sfm.world.positionerrors import Linear, PositionErrors, Stated
from tiegraph.sfm.world.unknowns import Bend, LeverArm

_THERE = np.stack([np.arange(60.0), np.sin(np.arange(60) / 7), 0.2 * np.cos(np.arange(60) / 5)], axis=1)
PATH = np.concatenate([_THERE, _THERE[::-1] + [0, 6, 0]])  # there and back, metres; a position a second
COUNT = len(PATH)


def _errors(white: float, slow: float, lasts_s: float, rng: np.random.Generator) -> np.ndarray:
    """(K, 3) in stated sigmas."""
    z, keeps = rng.standard_normal((COUNT, 3)), np.exp(-1 / lasts_s)
    for k in range(1, COUNT):
        z[k] = keeps * z[k - 1] + np.sqrt(1 - keeps**2) * z[k]
    return white * rng.standard_normal((COUNT, 3)) + slow * z


def _linear(residual: np.ndarray, sigma: float, level: np.ndarray) -> Linear:
    rows, here = np.zeros((COUNT, 3, 8)), PATH - PATH.mean(axis=0)
    rows[:, :, :3], rows[:, :, 3:6], rows[:, :, 6], rows[:, :, 7] = -skew(here), np.eye(3), here, sigma * residual
    known = np.diag([1e-6] * 3 + [0.0] * 5)
    return Linear(
        rows=rows,
        stated=Stated(
            sigma=np.full((COUNT, 3), sigma), level=level, time_s=np.arange(float(COUNT)), common=np.full(3, np.nan)
        ),
        known=known,
    )


@pytest.mark.parametrize(
    ("white", "slow", "lasts_s", "bounds"),
    [(0.7, 0.7, 60.0, (0.8, 1.3)), (0.05, 0.05, 60.0, (0.8, 1.3)), (0.3, 2, 20, (0.7, 1.3)), (1, 0.02, 60, (0.4, 1))],
)  # fmt: skip
@pytest.mark.slow
def test_errors_over_their_sigmas(white, slow, lasts_s, bounds) -> None:
    """Of turn, shift and scale, over surveys of one kind; errors that are all white may be thought to last a little."""
    rng, level, ratios, sizes = np.random.default_rng(1), np.zeros(COUNT, int), [], []
    for _ in range(25):
        errors = PositionErrors(_linear(_errors(white, slow, lasts_s, rng), 2.0, level), NoiseTuning())
        moved, covariance = errors.step({})
        ratios.append(moved / np.sqrt(np.diag(covariance)))
        sizes.append([errors.sizes.white[0], errors.sizes.slow[0]])
    assert bounds[0] < np.sqrt(np.mean(np.square(ratios))) < bounds[1]
    assert np.median(sizes, axis=0) == pytest.approx([white, slow], rel=0.15, abs=0.35 * white)


def test_each_level_of_the_stated_sigma_has_its_own_size() -> None:
    level = (np.arange(COUNT) < 60).astype(int)
    off = _errors(1.0, 1e-3, 60.0, np.random.default_rng(2)) * np.where(level, 4.0, 0.5)[:, None]
    level[:3] = 7  # too few to tell by themselves
    sizes = PositionErrors(_linear(off, 1.0, level), NoiseTuning()).sizes
    assert sizes.white[0] == pytest.approx(0.5, rel=0.2) and sizes.white[1] == pytest.approx(4.0, rel=0.2)
    assert len(sizes.white) == 3


@pytest.mark.parametrize(("turned_deg", "wide", "used"), [(80.0, 3.0, False), (8.0, 0.0, True), (80.0, 0.0, True)])
def test_an_upward_direction_that_the_positions_refute_is_not_used(turned_deg, wide, used) -> None:
    """Photographs straight down have tops that point anywhere; a straight track cannot refute them."""
    place = np.stack([np.arange(20.0), wide * (np.arange(20) % 4 > 1), np.zeros(20)], axis=1)
    pose = np.tile(np.eye(4), (20, 1, 1))
    pose[:, :3, 3] = place
    evidence = Evidence(
        frame=np.arange(20),
        pose=pose,
        position=place + 0.01 * np.random.default_rng(3).standard_normal(place.shape),
        sigma=np.full((20, 3), 0.1),
        orientation=np.full((20, 3, 3), np.nan),
        arm=LeverArm(np.zeros(3)),
        log_scale=None,
    )
    turn = np.radians(turned_deg)
    up = Up(np.array([0.0, np.sin(turn), np.cos(turn)]), 10.0, ring=False, tilt=False, cameras="the images")
    notes: list[str] = []
    found = up_to_use(evidence, up, notes, WorldTuning())
    assert (found is up) == used
    assert ("not used" in notes[0]) == (not used)


@pytest.mark.parametrize(("stated_m", "held"), [(2.0, True), (0.05, False)])
def test_passes_that_errors_turn_over_each_other_are_held_upright_where_these_may_be_so_large(stated_m, held) -> None:
    """Of two passes 3 m apart one is 2.3 m too high: alone they lean by 50 degrees, and know it to a few."""
    back, lean = np.arange(40) >= 20, np.radians(50)
    place = np.stack([2.0 * (np.arange(40) % 20), 3.0 * back, np.zeros(40)], axis=1)
    pose = np.tile(np.eye(4), (40, 1, 1))
    pose[:, :3, 3] = place
    noise = 0.05 * np.random.default_rng(5).standard_normal(place.shape)
    sigma, tuning = np.full((40, 3), stated_m), WorldTuning()
    evidence = Evidence(
        frame=np.arange(40),
        pose=pose,
        position=place + noise + np.outer(back, [0, 3 * (np.cos(lean) - 1), 3 * np.sin(lean)]),
        sigma=sigma,
        orientation=np.full((40, 3, 3), np.nan),
        arm=LeverArm(np.zeros(3)),
        log_scale=None,
    )
    time_s = np.arange(40.0) + 300 * back
    rows = Stated(sigma=sigma, level=np.zeros(40, int), time_s=time_s, common=np.full(3, np.nan))
    up, notes = Up(np.array([0.0, 0, 1]), 3.0, ring=True, tilt=True, cameras="the ring"), []
    alone, upright = (
        by_errors(evidence, u, fit_similarity(evidence, u, tuning.fit), rows, tuning.fit, tuning.noise)
        for u in (None, up)
    )
    found = up_to_use(evidence, up, notes, tuning, replace(alone, error=_known(alone, 3.0)), upright)
    assert (found is up) == held and ("holds it" in notes[0]) == held
    assert held == (np.degrees(np.arccos((upright.similarity.rotation @ up.direction)[2])) < 6 and found is up)


def _known(fit, tilt_deg: float):
    """Its error, the tilt stated to so many degrees."""
    turn = np.radians(tilt_deg) ** 2 / 2
    return replace(fit.error, covariance=np.diag([turn, turn, 1e-4, 0.1, 0.1, 0.1, 1e-4]))


def test_where_no_position_is_believed_the_control_points_alone_tell() -> None:
    place = np.random.default_rng(4).uniform(-20, 20, (12, 3))
    pose = np.tile(np.eye(4), (12, 1, 1))
    pose[:, :3, 3] = place
    evidence = Evidence(
        frame=np.where(np.arange(12) < 6, np.arange(12), -1),
        pose=pose,
        position=place,
        sigma=np.full((12, 3), 0.1),
        orientation=np.full((12, 3, 3), np.nan),
        arm=LeverArm(np.zeros(3)),
        log_scale=None,
    )
    fit = replace(fit_similarity(evidence, None, WorldTuning().fit), inlier=np.arange(12) >= 6)
    rows = Stated(sigma=np.full((6, 3), 0.1), level=np.zeros(6, int), time_s=np.arange(6.0), common=np.full(3, 0.1))
    found = by_errors(evidence, None, fit, rows, WorldTuning().fit, NoiseTuning())
    assert found.levels == [] and np.abs(found.similarity(place) - place).max() < 1e-6
    assert found.sigma["position_m"] == pytest.approx(0.1 * np.sqrt(2 / 6), rel=0.3)


def test_what_the_model_bends_is_no_error_of_the_positions() -> None:
    """A way of 600 m bent by half a metre, without positions in its middle third: the errors of the similarity of all
    its frames over their sigmas, and what is left of the bend."""
    rng, count = np.random.default_rng(5), 120
    s = np.linspace(-1, 1, count)
    true = np.stack([300 * s, 10 * np.sin(9 * s), np.zeros(count)], axis=1)
    form = np.stack([s**2 - np.mean(s**2), s**3 - np.polyval(np.polyfit(s, s**3, 1), s)])
    bend = 0.5 * np.einsum("mk,ij->kimj", form, np.eye(3)).reshape(count, 3, 6)
    known, ratios, left = np.flatnonzero(np.abs(s) > 1 / 3), [], []
    rows = Stated(
        sigma=np.full((len(known), 3), 0.02),
        level=np.zeros(len(known), int),
        time_s=known * 2.0,
        common=np.full(3, 0.01),
    )
    for _ in range(8):
        pose = np.tile(np.eye(4), (count, 1, 1))
        pose[:, :3, 3] = true - bend @ rng.standard_normal(6)
        noise = 0.02 * (0.7 * rng.standard_normal((count, 3)) + 0.5 * rng.standard_normal(3))
        evidence = Evidence(
            frame=np.arange(count),
            pose=pose,
            position=true + noise,
            sigma=np.full((count, 3), 0.02),
            orientation=np.full((count, 3, 3), np.nan),
            arm=LeverArm(np.zeros(3)),
            log_scale=None,
            bend=Bend.of(bend),
        ).where(known)
        rough = fit_similarity(replace(evidence, sigma=np.full((len(known), 3), 0.5)), None, WorldTuning().fit)
        fit = by_errors(evidence, None, rough, rows, WorldTuning().fit, NoiseTuning())
        off = fit.similarity.matrix[:3, 3]
        ratios.append(np.append(off, np.log(fit.similarity.scale)) / np.sqrt(np.diag(fit.error.covariance)[3:7]))
        left.append(np.sqrt(np.diag(fit.bent[1])))
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4
    assert 0.003 < np.median(left) < 0.1
