"""What a pair is worth and how far a choice is from all: by the net of resistances, or by the bundle adjustment."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tiegraph.design.bundle import Bundle
from tiegraph.design.predict import joined
from tiegraph.design.resistance import Net, laplacian
from tiegraph.design.tracks import Candidates, Tracks
from tiegraph.design.tuning import MeasureTuning, Tuning

_SEED = 0


class Loss(Protocol):
    """Predicts what a choice loses."""

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Predicted increase of the position sigma over all candidates, a share, for chosen (E,) bool; ``tracks``:
        theirs, joined already."""


class Measure(Loss, Protocol):
    """Tells ``hybrid.choose`` what it chooses by and when it may stop."""

    def gains(self, chosen: np.ndarray, tracks: Tracks, new: np.ndarray, wanted: int) -> np.ndarray:
        """(E,) gain of each candidate that would join ``new`` tracks; -1 for the chosen ones and for such as cannot be
        among the ``wanted`` best."""

    def chose(self, places: np.ndarray, new: np.ndarray) -> None:
        """Take note that candidates at places (K,) were chosen, which were to join ``new`` (E,)."""


class ByNet:
    """Effective resistances: every image one unknown. For large surveys, and where images share no unknowns."""

    def __init__(self, candidates: Candidates, by_tracks: bool, judge: Loss | None, tuning: Tuning) -> None:
        self._c, self._by_tracks, self._judge, self._tuning = candidates, by_tracks, judge, tuning
        self._weight = np.zeros(len(candidates))

    def gains(self, chosen: np.ndarray, tracks: Tracks, new: np.ndarray, wanted: int) -> np.ndarray:
        """log(1 + R (new + known n)) with the effective resistance R; by matches alone log(1 + R n)."""
        c = self._c
        worth = new + self._tuning.measure.known * c.expected if self._by_tracks else c.expected
        resistance = Net(laplacian(c.i, c.j, self._weight, c.images), self._tuning.net).resistance(c.i, c.j)
        resistance = np.where(np.isfinite(resistance), resistance, 0.0)
        return np.where(chosen, -1.0, np.log1p(resistance * worth))

    def chose(self, places: np.ndarray, new: np.ndarray) -> None:
        """Their links in the net."""
        own = self._c.expected[places]
        least = self._tuning.measure.known * own
        self._weight[places] = np.maximum(new[places], least) if self._by_tracks else own

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """As the judge says."""
        return np.nan if self._judge is None else self._judge.loss(chosen, tracks)


class Judge:
    """The loss by the exact covariance of the bundle adjustment, over tracks drawn anew and without the pairs that are
    not verified: by the very tracks it was made by, a choice looks too good."""

    def __init__(self, again: Bundle, chance: np.ndarray, tuning: Tuning) -> None:
        """``again``: the candidates with another draw of ties; ``chance`` (E,) of each to be verified."""
        self._again, self._tuning = again, tuning
        self._comes = np.random.default_rng(_SEED).random(len(chance)) < chance
        self._all = self._variances(np.ones(len(chance), bool))

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Frames that all pairs leave as good as free do not count; where most are, nothing less than all will do."""
        held = self._all < self._tuning.measure.free**2
        if held.mean() < self._tuning.measure.min_held:
            return 0.0 if chosen.all() else np.inf
        ratio = self._variances(chosen)[held].mean() / self._all[held].mean()
        return max(float(np.sqrt(ratio)) - 1.0, 0.0)

    def _variances(self, chosen: np.ndarray) -> np.ndarray:
        tracks = joined(self._again.candidates, chosen & self._comes, self._tuning.net)
        return self._again.variances(self._again.covariance(self._again.normal(tracks)))


class ByBundle:
    """The bundle adjustment itself, with what the images share. Gains only shrink as pairs are chosen, so the last one
    computed is a bound, and only the best by it are computed anew (Minoux 1978)."""

    def __init__(self, bundle: Bundle, chance: np.ndarray, judge: Loss | None, tuning: MeasureTuning) -> None:
        """``chance`` (E,) of each candidate to be verified."""
        self._c, self._bundle, self._chance, self._judge = bundle.candidates, bundle, chance, judge
        self._tuning = tuning
        self._normal: np.ndarray | None = None
        self._made = self._complete = 0  # number of pairs chosen when the information, and all gains, were made anew
        self._bound = np.full(len(chance), np.inf)

    def gains(self, chosen: np.ndarray, tracks: Tracks, new: np.ndarray, wanted: int) -> np.ndarray:
        """Fall of the mean variance by each pair; a pair of an image without pose gains what others do a match."""
        count, tuning = int(chosen.sum()), self._tuning
        if self._normal is None or count >= (1 + tuning.again) * self._made:
            self._normal, self._made = self._bundle.normal(tracks), count
        covariance = self._bundle.covariance(self._normal)
        worth = self._chance * (new + tuning.known * self._c.expected)
        free = np.flatnonzero(~chosen & self._bundle.usable)
        if count >= (1 + tuning.all_again) * self._complete:
            self._complete = count
        else:
            most = int(tuning.top_times * wanted) + tuning.top_more
            free = free[np.argsort(-self._bound[free], kind="stable")[:most]]
        found = self._bundle.gains(covariance, free, worth[free])
        self._bound[free] = found
        out = np.full(len(chosen), -1.0)
        out[free] = found
        other = ~chosen & ~self._bundle.usable
        a_match = float(np.median(found / np.maximum(worth[free], 1e-9))) if len(free) else 1.0
        out[other] = worth[other] * max(a_match, 0.0)
        return out

    def chose(self, places: np.ndarray, new: np.ndarray) -> None:
        """Their equations, until the tracks tell better."""
        if self._normal is not None:
            own = places[self._bundle.usable[places]]
            worth = self._chance[own] * (new[own] + self._tuning.known * self._c.expected[own])
            self._normal = self._bundle.add(self._normal, own, worth)

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """As the judge says."""
        return np.nan if self._judge is None else self._judge.loss(chosen, tracks)
