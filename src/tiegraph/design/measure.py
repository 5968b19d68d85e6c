"""What a pair is worth and how far a choice is from all: by the net of resistances, or by the bundle adjustment."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from tiegraph.design.bundle import Bundle
from tiegraph.design.predict import joined
from tiegraph.design.resistance import Net, laplacian
from tiegraph.design.tracks import Candidates, Tracks

KNOWN = 0.05  # worth of a match whose track is joined already: another observation against outliers
_AGAIN = 0.20  # growth of the network after which the bundle's information is made anew from its tracks
_ALL = 0.5  # growth after which the gains of all pairs are computed anew; between, of those that were best
_SEED = 0
_FREE = 0.1  # sigma of a frame that nothing holds, in sizes of the survey
_LEAST_HELD = 0.5  # of the frames, for a loss to mean anything
_TOP = (6.0, 400)  # times the number of pairs wanted, and more, whose gains are computed anew each round


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

    def __init__(self, candidates: Candidates, by_tracks: bool, judge: Loss | None) -> None:
        self._c, self._by_tracks, self._judge = candidates, by_tracks, judge
        self._weight = np.zeros(len(candidates))

    def gains(self, chosen: np.ndarray, tracks: Tracks, new: np.ndarray, wanted: int) -> np.ndarray:
        """log(1 + R (new + 0.05 n)) with the effective resistance R; by matches alone log(1 + R n)."""
        c = self._c
        worth = new + KNOWN * c.expected if self._by_tracks else c.expected
        resistance = Net(laplacian(c.i, c.j, self._weight, c.images)).resistance(c.i, c.j)
        resistance = np.where(np.isfinite(resistance), resistance, 0.0)
        return np.where(chosen, -1.0, np.log1p(resistance * worth))

    def chose(self, places: np.ndarray, new: np.ndarray) -> None:
        """Their links in the net."""
        own = self._c.expected[places]
        self._weight[places] = np.maximum(new[places], KNOWN * own) if self._by_tracks else own

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """As the judge says."""
        return np.nan if self._judge is None else self._judge.loss(chosen, tracks)


class Judge:
    """The loss by the exact covariance of the bundle adjustment, over tracks drawn anew and without the pairs that are
    not verified: by the very tracks it was made by, a choice looks too good."""

    def __init__(self, again: Bundle, chance: np.ndarray) -> None:
        """``again``: the candidates with another draw of ties; ``chance`` (E,) of each to be verified."""
        self._again = again
        self._comes = np.random.default_rng(_SEED).random(len(chance)) < chance
        self._all = self._variances(np.ones(len(chance), bool))

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """Frames that all pairs leave as good as free do not count; where most are, nothing less than all will do."""
        held = self._all < _FREE**2
        if held.mean() < _LEAST_HELD:
            return 0.0 if chosen.all() else np.inf
        ratio = self._variances(chosen)[held].mean() / self._all[held].mean()
        return max(float(np.sqrt(ratio)) - 1.0, 0.0)

    def _variances(self, chosen: np.ndarray) -> np.ndarray:
        tracks = joined(self._again.candidates, chosen & self._comes)
        return self._again.variances(self._again.covariance(self._again.normal(tracks)))


class ByBundle:
    """The bundle adjustment itself, with what the images share. Gains only shrink as pairs are chosen, so the last one
    computed is a bound, and only the best by it are computed anew (Minoux 1978)."""

    def __init__(self, bundle: Bundle, chance: np.ndarray, judge: Loss | None) -> None:
        """``chance`` (E,) of each candidate to be verified."""
        self._c, self._bundle, self._chance, self._judge = bundle.candidates, bundle, chance, judge
        self._normal: np.ndarray | None = None
        self._made = self._complete = 0  # number of pairs chosen when the information, and all gains, were made anew
        self._bound = np.full(len(chance), np.inf)

    def gains(self, chosen: np.ndarray, tracks: Tracks, new: np.ndarray, wanted: int) -> np.ndarray:
        """Fall of the mean variance by each pair; a pair of an image without pose gains what others do a match."""
        count = int(chosen.sum())
        if self._normal is None or count >= (1 + _AGAIN) * self._made:
            self._normal, self._made = self._bundle.normal(tracks), count
        covariance = self._bundle.covariance(self._normal)
        worth = self._chance * (new + KNOWN * self._c.expected)
        free = np.flatnonzero(~chosen & self._bundle.usable)
        if count >= (1 + _ALL) * self._complete:
            self._complete = count
        else:
            free = free[np.argsort(-self._bound[free], kind="stable")[: int(_TOP[0] * wanted) + _TOP[1]]]
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
            worth = self._chance[own] * (new[own] + KNOWN * self._c.expected[own])
            self._normal = self._bundle.add(self._normal, own, worth)

    def loss(self, chosen: np.ndarray, tracks: Tracks | None = None) -> float:
        """As the judge says."""
        return np.nan if self._judge is None else self._judge.loss(chosen, tracks)
