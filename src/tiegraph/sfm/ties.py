"""The similarity between two models of one survey, from the verified matches between their images.

A match counts if its key point has a point in both models. Seen from the first model's camera, the second model's
point must lie in the direction of the first model's point, and vice versa. Directions are used because their errors
are those of key points, while the depth of a point is far less accurate. RANSAC over triples of points finds the
similarity, least squares over the angles refines it. Held-out data confirm it: fitted to every other pair of images,
it must explain the matches of the rest.

Where a wall repeats, most pairs of images have false matches, and those of one pair are all true or all false. So
single pairs propose similarities too, and the directions of all matches choose between the proposals. On a canal of
12 m windows (``small``, seed 1), of which a block was mapped three windows off, one RANSAC over all matches found a
similarity that 5280 of 32 197 matches agree with and that is wrong by a window; the proposals found the true one, 6823.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
import scipy

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.scene.colmapmodel import sim3d
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning import PlacementTuning
from tiegraph.sfm.tuning.placement import TieTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, image_observations

TEST_COLUMNS = [
    "matches that agree", "of", "image pairs", "independent of these", "held-out matches that agree %", "halves differ",
    "halves differ deg",
]  # fmt: skip
"""Heads of ``TieTest.cells``; lengths in the first model's units."""


@dataclass(frozen=True)
class Ties:
    """K matches between two models, in the units of each: ``images`` (K, 2) scene indices, the points ``xyz`` and the
    projection centres ``centre`` (2, K, 3), first and second model."""

    images: np.ndarray
    xyz: np.ndarray
    centre: np.ndarray

    def __len__(self) -> int:
        return len(self.images)

    def where(self, rows: np.ndarray) -> Ties:
        """A subset (boolean or index array)."""
        return Ties(self.images[rows], self.xyz[:, rows], self.centre[:, rows])

    def evenly(self, most: int) -> Ties:
        """At most so many of them, spread evenly."""
        return self.where(np.linspace(0, len(self) - 1, min(len(self), most)).astype(int))

    def moved(self, first: Similarity) -> Ties:
        """The same after the first model was moved."""
        xyz, centre = (np.stack([first(v[0]), v[1]]) for v in (self.xyz, self.centre))
        return Ties(self.images, xyz, centre)

    def angles(self, first_from_second: Similarity) -> np.ndarray:
        """(K, 6) sines of the angles between each camera's own point and the other model's point."""
        moved, back = first_from_second(self.xyz[1]), first_from_second(self.centre[1])
        a = np.cross(_unit(self.xyz[0] - self.centre[0]), _unit(moved - self.centre[0]))
        b = np.cross(_unit(moved - back), _unit(self.xyz[0] - back))
        return np.concatenate([a, b], axis=1)

    def agree(self, first_from_second: Similarity, tolerance_rad: float) -> np.ndarray:
        """(K,) bool: both cameras see the two points in the same direction and in front of them."""
        moved, back = first_from_second(self.xyz[1]), first_from_second(self.centre[1])
        ahead = np.sum((self.xyz[0] - self.centre[0]) * (moved - self.centre[0]), axis=1) > 0
        ahead &= np.sum((moved - back) * (self.xyz[0] - back), axis=1) > 0
        sines = self.angles(first_from_second)
        largest = np.maximum(np.linalg.norm(sines[:, :3], axis=1), np.linalg.norm(sines[:, 3:], axis=1))
        return ahead & (largest < tolerance_rad)


@dataclass(frozen=True)
class TieFit:
    """``first_from_second``, the ties that agree (K,), and the ``middle`` (3,) of their points in the first model."""

    first_from_second: Similarity
    agree: np.ndarray
    middle: np.ndarray


@dataclass(frozen=True)
class TieTest:
    """The evidence for a fit: ``ties`` that agree of ``total``, over ``pairs`` of images, of which ``independent``
    share no image; ``explained``: share of held-out ties that agree with a fit to the other pairs of images; ``jump``
    (first model's units) and ``turn_deg`` between the fits of the two halves, in the middle of the ties."""

    ties: int
    total: int
    pairs: int
    independent: int
    explained: float
    jump: float
    turn_deg: float

    def cells(self) -> list:
        """Its row of a table (``TEST_COLUMNS``)."""
        jump = round(self.jump, 4) if np.isfinite(self.jump) else None
        share, turn = round(100 * self.explained), round(self.turn_deg, 3)
        return [self.ties, self.total, self.pairs, self.independent, share, jump, turn]

    def holds(self, tuning: PlacementTuning) -> bool:
        """Whether it is beyond chance, in the fitted and in the held-out ties."""
        asked = tuning.ties
        enough = self.ties >= tuning.consistency.min_votes and self.independent >= asked.independent
        return enough and min(self.ties / self.total, self.explained) >= asked.share


def find_ties(
    first: ImageObservations, second: ImageObservations, verified: VerifiedMatches, tuning: PlacementTuning
) -> Ties:
    """The matches between images of two models that have a point in both."""
    images, points = [], []
    for (i, j), matches in zip(verified.pairs.tolist(), verified.matches):
        if i in first.point and j in second.point:
            a, b, matched = i, j, matches
        elif j in first.point and i in second.point:
            a, b, matched = j, i, matches[:, ::-1]
        else:
            continue
        both = np.stack([first.point[a][matched[:, 0]], second.point[b][matched[:, 1]]], axis=1)
        both = both[(both >= 0).all(axis=1)]
        few = np.linspace(0, len(both) - 1, min(len(both), tuning.agreement.matches_a_pair)).astype(int)
        points.append(both[few])
        images.append(np.tile([a, b], (len(few), 1)))
    at = np.concatenate(images) if images else np.zeros((0, 2), int)
    ids = np.concatenate(points) if points else np.zeros((0, 2), int)
    xyz = [m.xyz[ids[:, n]] for n, m in enumerate((first, second))]
    centre = [
        np.array([transforms.centre(m.cam_from_world[k]) for k in at[:, n].tolist()]).reshape(-1, 3)
        for n, m in enumerate((first, second))
    ]
    return Ties(at, np.stack(xyz), np.stack(centre))


def fit_ties(ties: Ties, tuning: PlacementTuning) -> TieFit | None:
    """The similarity with most agreeing ties; None if there are too few ties or no solution."""
    return next(iter(fits(ties, tuning)), None)


def fits(ties: Ties, tuning: PlacementTuning) -> list[TieFit]:
    """Similarities whose agreeing ties are different ones, most ties first."""
    asked, tolerance_rad, least = tuning.ties, tuning.agreement.tolerance_rad, tuning.consistency.min_votes
    if not asked.trials or len(ties) < least:
        return []
    few = ties.evenly(asked.most)
    proposed = [s for group in _groups(ties, few, tuning) if (s := _by_points(group, asked)) is not None]
    agree = [few.agree(s, tolerance_rad) for s in proposed]
    found = []
    for k in _distinct(agree, asked.fits):
        fit = _by_directions(few, proposed[k], tuning)
        right = None if fit is None else ties.agree(fit, tolerance_rad)
        if fit is not None and right is not None and right.sum() >= least:
            found.append(TieFit(fit, right, np.median(ties.xyz[0][right], axis=0)))
    found.sort(key=lambda one: -int(one.agree.sum()))
    return [found[k] for k in _distinct([one.agree for one in found], asked.fits)]


def _distinct(agree: Sequence[np.ndarray], most: int) -> list[int]:
    """At most so many of some proposals, by the ties (K,) bool that agree with each: most ties first, none that shares
    half of its ties with one before."""
    out: list[int] = []
    for k in sorted(range(len(agree)), key=lambda k: -int(agree[k].sum())):
        if len(out) < most and all(2 * (agree[k] & agree[n]).sum() < max(agree[k].sum(), 1) for n in out):
            out.append(k)
    return out


def _by_directions(ties: Ties, start: Similarity, tuning: PlacementTuning) -> Similarity | None:
    """The similarity refined on the ties that agree.

    The search tolerates errors of depth, which are large; agreement in depth alone is weak, so it begins with wide
    limits.
    """
    fit, tolerance_rad = start, tuning.agreement.tolerance_rad
    for tolerance in tolerance_rad * 2.0 ** np.arange(tuning.ties.rounds)[::-1]:
        agree = ties.agree(fit, tolerance)
        if agree.sum() < tuning.consistency.min_votes:
            return None
        fit = _refined(ties.where(agree), fit, tolerance_rad)
    return fit


def _groups(ties: Ties, few: Ties, tuning: PlacementTuning) -> list[Ties]:
    """The ties that propose a similarity together: ``few`` of all, and those of single pairs of images."""
    _, pair, count = np.unique(ties.images, axis=0, return_inverse=True, return_counts=True)
    order, start = np.argsort(pair.ravel(), kind="stable"), np.cumsum(count) - count
    strong = np.flatnonzero(count >= tuning.consistency.min_votes)
    strong = strong[np.linspace(0, len(strong) - 1, min(len(strong), tuning.ties.proposals)).astype(int)]
    return [few, *(ties.where(order[start[k] : start[k] + count[k]]) for k in strong)]


def _by_points(ties: Ties, tuning: TieTuning) -> Similarity | None:
    """The similarity of most pairs of points."""
    reach = float(np.median(np.linalg.norm(ties.xyz[0] - ties.centre[0], axis=1)))
    options = pycolmap.RANSACOptions(
        max_error=tuning.error * reach,
        random_seed=0,
        min_num_trials=min(tuning.trials, 100),
        max_num_trials=tuning.trials,
    )
    found: Any = pycolmap.estimate_sim3d_robust(ties.xyz[1], ties.xyz[0], options)
    if found is None:
        return None
    start = found["tgt_from_src"]
    return Similarity(float(start.scale), np.asarray(start.rotation.matrix()), np.asarray(start.translation, float))


def tested(ties: Ties, fit: TieFit, tuning: PlacementTuning) -> TieTest:
    """The evidence for a fit, from fitted and from held-out ties."""
    pairs = sorted({(int(a), int(b)) for a, b in ties.images[fit.agree]})
    number = {pair: k for k, pair in enumerate(sorted({(int(a), int(b)) for a, b in ties.images}))}
    half = np.array([number[int(a), int(b)] % 2 for a, b in ties.images])
    explained, jump, turn = 0.0, float("inf"), 180.0
    halves = [fit_ties(ties.where(half == k), tuning) for k in (0, 1)]
    if halves[0] is not None and halves[1] is not None:
        one, two = (h.first_from_second for h in halves if h is not None)
        tolerance = tuning.agreement.tolerance_rad
        unknown = [ties.where(half == k).agree(s, tolerance) for k, s in ((1, one), (0, two))]
        explained = float(min(np.mean(a) for a in unknown))
        jump, turn = apart(one, two, fit)
    return TieTest(
        ties=int(fit.agree.sum()),
        total=len(ties),
        pairs=len(pairs),
        independent=_independent(pairs),
        explained=explained,
        jump=jump,
        turn_deg=turn,
    )


def apart(one: Similarity, two: Similarity, fit: TieFit) -> tuple[float, float]:
    """Distance between the positions that two similarities give the ties (units of the first model), and rotation in
    degrees."""
    back = np.linalg.inv(fit.first_from_second.matrix)
    there = transforms.apply(back, fit.middle[None])
    jump = float(np.linalg.norm(one(there) - two(there)))
    return jump, float(transforms.angle_deg(one.rotation, two.rotation))


def _refined(ties: Ties, start: Similarity, tolerance_rad: float) -> Similarity:
    middle = start(ties.xyz[1]).mean(axis=0)
    reach = float(np.median(np.linalg.norm(ties.xyz[0] - ties.centre[0], axis=1)))

    def moved(step: np.ndarray) -> Similarity:
        return start.stepped(np.r_[step[:3], reach * step[3:6], step[6]], middle)

    def off(step: np.ndarray) -> np.ndarray:
        return ties.angles(moved(step)).ravel()

    found = scipy.optimize.least_squares(off, np.zeros(7), loss="cauchy", f_scale=tolerance_rad / 3)
    return moved(found.x)


def _independent(pairs: list[tuple[int, int]]) -> int:
    """Number of pairs of images without a common image: greedily, in their order."""
    used: set[int] = set()
    count = 0
    for a, b in pairs:
        if a not in used and b not in used:
            used |= {a, b}
            count += 1
    return count


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-300)


class Joining:
    """The models in one frame so far (``world``, by number), and the ties of the others to them.

    ``scene``: the survey of the models; ``tests``: the test of the matches of each model, including those that
    failed.
    """

    def __init__(
        self,
        scene: Scene,
        verified: VerifiedMatches,
        tuning: PlacementTuning,
        models: Sequence[pycolmap.Reconstruction],
        world: Mapping[int, pycolmap.Reconstruction],
    ) -> None:
        self.world, self.scene, self._verified, self._tuning = dict(world), scene, verified, tuning
        self._other = {k: self._seen(m) for k, m in enumerate(models) if k not in world}
        self._ties: dict[int, list[Ties]] = {k: [] for k in self._other}
        self.tests: dict[int, TieTest] = {}
        for model in world.values():
            self._tie(model)

    def add(self, number: int, model: pycolmap.Reconstruction) -> None:
        """Add a model to the world."""
        self.world[number] = model
        del self._other[number], self._ties[number]
        self._tie(model)

    def strongest(self, numbers: Sequence[int]) -> tuple[int, TieFit, TieTest] | None:
        """The model with most matches to the world, among those whose matches pass the test."""
        found: tuple[int, TieFit, TieTest] | None = None
        for number in numbers:
            ties = together(self._ties.get(number, []))
            fit = fit_ties(ties, self._tuning)
            if fit is None:
                continue
            self.tests[number] = test = tested(ties, fit, self._tuning)
            if test.holds(self._tuning) and (found is None or test.ties > found[2].ties):
                found = number, fit, test
        return found

    def _seen(self, model: pycolmap.Reconstruction) -> ImageObservations:
        return image_observations(model, self.scene, self._tuning.agreement)

    def _tie(self, model: pycolmap.Reconstruction) -> None:
        here = self._seen(model)
        for number, seen in self._other.items():
            ties = find_ties(here, seen, self._verified, self._tuning)
            self._ties[number] += [ties] if len(ties) else []


def moved(model: pycolmap.Reconstruction, world_from_model: Similarity) -> pycolmap.Reconstruction:
    """A copy of a model in another frame; the lengths of its rigs are scaled too."""
    out = pycolmap.Reconstruction(model)
    out.transform(sim3d(world_from_model))
    return out


def together(ties: Sequence[Ties]) -> Ties:
    """The ties of several models as one."""
    none = np.zeros((2, 0, 3))
    return Ties(
        np.concatenate([np.zeros((0, 2), int), *(t.images for t in ties)]),
        np.concatenate([none, *(t.xyz for t in ties)], axis=1),
        np.concatenate([none, *(t.centre for t in ties)], axis=1),
    )
