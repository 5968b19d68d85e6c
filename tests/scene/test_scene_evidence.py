"""Statements against each other, and residuals against what noise looks like: false alarms and power, by simulation."""

from __future__ import annotations

import numpy as np
import pytest

from tiegraph.scene.evidence import LIMIT, Statement, contradictions, fits_better, mostly_more, table, trend
from tiegraph.scene.tuning import TrendTuning

TUNING = TrendTuning()


def process(rng: np.random.Generator, count: int, r: float) -> np.ndarray:
    """First-order noise (count,) of sigma 1 and correlation r."""
    out = rng.standard_normal(count)
    for k in range(1, count):
        out[k] = r * out[k - 1] + np.sqrt(1 - r * r) * out[k]
    return out


@pytest.mark.parametrize(("count", "r"), [(12, 0.0), (12, 0.6), (30, 0.0), (30, 0.6), (100, 0.8)])
def test_noise_is_no_trend(count: int, r: float) -> None:
    rng = np.random.default_rng(count)
    alarms = sum(trend(process(rng, count, r), TUNING) is not None for _ in range(120))
    assert alarms <= 1  # 0.1 % by construction, where the correlation is known


@pytest.mark.parametrize("form", ["line", "curve", "step"])
def test_what_is_larger_than_the_noise_is_found_by_its_form(form: str) -> None:
    rng, x = np.random.default_rng(3), np.linspace(-1, 1, 40)
    shape = {"line": x, "curve": 1.5 * (x**2 - 1 / 3), "step": np.sign(x - 0.2)}[form]
    found = [trend(0.7 * shape + 0.05 * process(rng, 40, 0.5), TUNING) for _ in range(20)]
    assert sum(f is not None and f.form == form for f in found) >= 18
    assert not any(trend(0.3 * shape + process(rng, 40, 0.5), TUNING) for _ in range(20))  # below the noise: nothing
    size = {"line": 1.4, "curve": 1.05, "step": 1.4}[form]
    assert all(f.size == pytest.approx(size, rel=0.2) for f in found if f is not None and f.form == form)


def test_a_step_that_the_fit_has_followed_by_turning_is_found() -> None:
    """Residuals of a line fitted to a step are a saw-tooth: no step, no line, no curve by itself."""
    rng, x = np.random.default_rng(6), np.linspace(-1, 1, 20)
    found = []
    for _ in range(20):
        y = np.where(x > 0, 0.4, 0.0) + 0.02 * rng.standard_normal(20)
        found.append(trend(y - np.polyval(np.polyfit(x, y, 1), x), TUNING, 3))
    assert all(f is not None and f.form == "step" for f in found)
    assert all(f.size == pytest.approx(0.4, abs=0.1) and 0.4 < f.at < 0.6 for f in found if f is not None)


def test_one_bad_value_is_no_trend_and_the_words_hold_the_figures() -> None:
    rng, x = np.random.default_rng(4), np.linspace(-1, 1, 30)
    bad = 0.02 * rng.standard_normal(30)
    bad[4] = 5.0
    assert trend(bad, TUNING) is None and trend(np.zeros(30), TUNING) is None and trend(x[:5], TUNING) is None
    line = trend(0.7 * x + 0.02 * rng.standard_normal(30), TUNING)
    assert line.text().startswith("run in a line from -0.") and " m to +0." in line.text()
    assert line.start == pytest.approx(-0.7, abs=0.05) and line.end == pytest.approx(0.7, abs=0.05)
    step = trend(np.where(x > 0, 0.5, 0.0) + 0.02 * rng.standard_normal(30), TUNING)
    assert step.text().startswith("jump by +0.") and step.at == 0.5
    off = trend(0.5 + 0.02 * rng.standard_normal(30), TUNING, offset=True)
    assert off.text() == "stand off by +0.5 m all the time"
    assert trend(0.5 + 0.02 * rng.standard_normal(30), TUNING) is None


def test_values_that_are_not_equally_good_count_by_their_sigmas() -> None:
    """A receiver that loses its fix below a bridge: positions of 2 cm before and after, of metres in between, whose
    errors go together. That is no jump; one of 0.3 m between the good ones is."""
    rng, count, alarms, found = np.random.default_rng(8), 50, 0, []
    sigma = np.where((np.arange(count) % 25 >= 10) & (np.arange(count) % 25 < 19), 1.0, 0.02)
    jump = np.where(np.arange(count) >= 25, 0.3, 0.0)
    for _ in range(60):
        noise = sigma * np.where(sigma > 0.1, process(rng, count, 0.9), rng.standard_normal(count))
        alarms += trend(noise, TUNING, 4, sigma=sigma) is not None
        found.append(trend(noise + jump, TUNING, 4, sigma=sigma))
    assert alarms <= 1
    steps = [f for f in found if f is not None]
    assert len(steps) >= 54 and all(f.form == "step" and f.size == pytest.approx(0.3, abs=0.05) for f in steps)
    assert all(f.sigmas == pytest.approx(0.3 / 2 / 0.02, rel=0.3) for f in steps)


def test_statements_that_cannot_both_be_right() -> None:
    rig = Statement("scale", "rig as given", 1.115, 0.0016, "")
    gnss = Statement("scale", "GNSS positions", 1.0, 0.01, "", used=True)
    points = Statement("scale", "control points", 1.01, 0.01, "")
    height = Statement("height", "EXIF", 64.0, float("nan"), "m")
    found = contradictions([rig, gnss, points, height])
    pairs = [{c.first.source, c.second.source} for c in found]
    assert pairs == [{"rig as given", "GNSS positions"}, {"rig as given", "control points"}]
    assert found[0].sigmas == pytest.approx(0.115 / np.hypot(0.0016, 0.01)) and found[0].sigmas > LIMIT
    rows = table([rig, gnss, points, height])["rows"]
    assert [r[6] for r in rows] == ["GNSS positions", "rig as given", "rig as given", ""]


def test_readings_that_are_no_better_are_called_so_once_in_a_thousand() -> None:
    """Of 4000 surveys in which both readings are as good, and of as many in which one is clearly better."""
    rng, free, pairs = np.random.default_rng(0), 8, 12
    before, after = np.sqrt(np.mean(rng.standard_normal((2, 4000, free)) ** 2, axis=2))
    assert sum(fits_better(b, a, free) for b, a in zip(before, after)) < 12
    assert sum(fits_better(8 * b, a, free) for b, a in zip(before, after)) > 3900
    assert not fits_better(5.0, 0.0, 0) and not fits_better(0.0, 0.0, 8) and fits_better(5.0, 0.0, 8)
    off = rng.standard_normal((4000, pairs))
    assert sum(mostly_more(d, 1) for d in off) < 12 and sum(mostly_more(d, 7) for d in off) < 3
    assert sum(mostly_more(d + 3, 7) for d in off) > 3900
    assert not mostly_more(np.array([5.0]), 1) and not mostly_more(np.zeros(9), 1) and mostly_more(np.ones(9), 1)
