"""Which cameras of a rig share a view, against what its axes say: cameras in another order. Needs no focal length."""

from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.network.tuning.rig import OrderTuning
from tiegraph.scene.rig import Rig


@dataclass(frozen=True)
class Order:
    """Sensor ``k`` seems to have the pose of sensor ``place[k]``; correlations of this and of the nominal order."""

    place: tuple[int, ...]
    fit: float
    nominal_fit: float


def orders(rig: Rig, evidence: np.ndarray, tuning: OrderTuning) -> list[Order]:
    """Orders of the side cameras that explain evidence (2, S, S), one a half of the frames, better than the rig does.

    Of equal fits those that move fewest cameras come first; empty = the rig's own order is as good as any. Evidence is
    how often two cameras match, NaN = not known; only its ranking against the cosine of the axes counts.
    """
    side = np.array([k for k, s in enumerate(rig.sensors) if s.role != "up"])
    if len(side) < 3:
        return []  # two cameras match in either order
    cosine = np.cos(np.radians(rig.axis_angles_deg()))[np.ix_(side, side)]
    parts = [e[np.ix_(side, side)] for e in evidence]
    whole = _mean(np.stack(parts))
    tried = (
        np.array(list(permutations(range(len(side))))) if len(side) <= tuning.all_orders else _by_swaps(whole, cosine)
    )
    fit = _fits(whole, cosine, tried)
    nominal = fit[0]
    if fit.max() < tuning.fit or fit.max() < nominal + tuning.better:
        return []
    halves = [_fits(e, cosine, tried) for e in parts]
    good = (fit >= fit.max() - tuning.alike) & np.all([h >= h[0] + tuning.better_half for h in halves], axis=0)
    moved = np.sum(tried != np.arange(len(side)), axis=1)
    best = np.flatnonzero(good)[np.argsort(moved[good], kind="stable")][: tuning.candidates]
    return [Order(_whole_order(len(rig.sensors), side, tried[k]), float(fit[k]), float(nominal)) for k in best]


def reordered(rig: Rig, place: tuple[int, ...]) -> tuple[Rig, np.ndarray]:
    """The rig with sensor k at the pose of sensor ``place[k]``, and the (4, 4) old rig frame from its new one."""
    old = [s.sensor_from_rig for s in rig.sensors]
    first = old[place[0]]
    assert first is not None
    back = transforms.invert(first)
    sensors = []
    for sensor, k in zip(rig.sensors, place):
        pose = old[k]
        assert pose is not None
        sensors.append(replace(sensor, sensor_from_rig=pose @ back))
    antenna = None if rig.antenna_m is None else transforms.apply(first, np.array([rig.antenna_m]))[0]
    arm = None if antenna is None else (float(antenna[0]), float(antenna[1]), float(antenna[2]))
    return replace(rig, sensors=tuple(sensors), antenna_m=arm), back


def in_words(rig: Rig, order: Order, evidence: np.ndarray) -> str:
    """Which cameras seem to have changed places, with the figures."""
    names = [s.name for s in rig.sensors]
    moved = [k for k, p in enumerate(order.place) if p != k]
    if len(moved) == 2:
        said = f"{names[moved[0]]} and {names[moved[1]]} tie as if they were swapped"
    else:
        said = "its cameras tie as if they were in another order: " + ", ".join(
            f"{names[k]} where it says {names[order.place[k]]}" for k in moved
        )
    found = _strongest(rig, evidence)
    angle = rig.axis_angles_deg()
    pairs = ", ".join(f"{names[c]}-{names[d]} ({angle[c, d]:.0f} deg by the rig)" for c, d in found)
    fits = f"correlation of matches and axes {order.fit:.2f} instead of {order.nominal_fit:.2f}"
    return f"{said} ({fits}); cameras that share a view: {pairs}"


def _strongest(rig: Rig, evidence: np.ndarray) -> list[tuple[int, int]]:
    """Camera pairs with at least half the evidence of the typical best partner."""
    mean = np.nan_to_num(_mean(evidence))
    np.fill_diagonal(mean, 0)
    least = float(np.median(mean.max(axis=1))) / 2
    return [(c, d) for c, d in combinations(range(len(rig.sensors)), 2) if mean[c, d] >= least > 0]


def _mean(evidence: np.ndarray) -> np.ndarray:
    """(S, S) of (2, S, S): mean of what is known."""
    known = np.isfinite(evidence).sum(axis=0)
    return np.where(known > 0, np.nansum(evidence, axis=0) / np.maximum(known, 1), np.nan)


def _by_swaps(evidence: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """The nominal order, and those met when swapping the two cameras that help most, again and again."""
    met = [np.arange(len(evidence))]
    for _ in range(len(evidence)):
        swaps = []
        for c, d in combinations(range(len(evidence)), 2):
            swapped = met[-1].copy()
            swapped[[c, d]] = swapped[[d, c]]
            swaps.append(swapped)
        fit = _fits(evidence, cosine, np.array([met[-1], *swaps]))
        if fit.argmax() == 0:
            break
        met.append(swaps[int(fit.argmax()) - 1])
    return np.array(met)


def _fits(evidence: np.ndarray, cosine: np.ndarray, tried: np.ndarray) -> np.ndarray:
    """(P,) correlation between the evidence (S, S) of camera pairs and the cosines their orders (P, S) give them."""
    c, d = np.triu_indices(len(evidence), 1)
    known = np.isfinite(evidence[c, d])
    c, d = c[known], d[known]
    x, y = evidence[c, d], cosine[tried[:, c], tried[:, d]]
    if len(x) < 3 or np.ptp(x) < 1e-9 or np.ptp(y) < 1e-6:
        return np.zeros(len(tried))
    x, y = x - x.mean(), y - y.mean(axis=1, keepdims=True)
    return y @ x / np.maximum(np.linalg.norm(y, axis=1) * np.linalg.norm(x), 1e-12)


def _whole_order(count: int, side: np.ndarray, order: np.ndarray) -> tuple[int, ...]:
    place = np.arange(count)
    place[side] = side[order]
    return tuple(int(k) for k in place)
