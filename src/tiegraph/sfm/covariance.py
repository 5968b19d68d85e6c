"""Covariances of poses, rig, lenses and points: points eliminated, correlated errors considered, free gauge.

The final adjustment is an M-estimator, and its observations are neither normal nor independent: residuals have long
tails, and the observations of one point have correlated errors. So the covariance is a sandwich (Huber 1967;
clusters: Liang and Zeger 1986): A^-1 B A^-1, with A the curvature of the robust cost and B the sum of g g' over the
points, where g is the point's share of the gradient. No sigma and no correlation within a track is assumed. Errors
that all points of a lens or of an image share are added (``systematic``), as far as the residuals show them. The same
holds for parameters that are held: where the images contradict the cameras of a rig, their deviation from the file is
propagated (``confront``).

Long tails and correlated errors within a track increase the sigmas. All points, rig and lenses are unknowns, and the
gauge is free (``normal``: sparse, up to 3000 frames; derivatives in ``jacobians``). The table ``interior
orientation`` of the receipt has the sigma and the strongest correlation of each parameter; another table has the
lever arms with their sigmas, in metres in the receipt of ``georef``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.geometry.align import robust_sigma
from tiegraph.scene.sorting import evenly
from tiegraph.sfm.adjustment.jacobians import Layout, jacobians, sampled
from tiegraph.sfm.adjustment.leverarmprior import NominalGeometry
from tiegraph.sfm.adjustment.normal import by_blocks, point_inverse
from tiegraph.sfm.motion import Motion
from tiegraph.sfm.systematic import (
    AssumedErrors,
    Effect,
    EffectWeights,
    LensError,
    lens_errors,
    misplaced,
    unrest,
    untimed,
)
from tiegraph.sfm.tuning import SigmaTuning, Tuning

_SEED = 0


@dataclass(frozen=True)
class Mounting:
    """A camera in its rig: centre (3,) in the frame of the reference, model units, its sigma, and the sigma of its
    rotation."""

    centre: tuple[float, float, float]
    sigma: float  # model units, root sum of squares
    sigma_deg: float


@dataclass(frozen=True)
class PointSigma:
    """One-sigma uncertainty of points of the model."""

    ids: tuple[int, ...]
    sigma: np.ndarray  # (P, 3) along the model's axes, model units


@dataclass(frozen=True)
class SharedErrors:
    """Errors beyond independent normal ones: of lenses, and of cameras that are not at their places in the rig.

    ``widened``: sigmas divided by those of independent normal errors (median of the frames).
    """

    widened: float
    lenses: tuple[LensError, ...]


@dataclass(frozen=True)
class PositionSigma:
    """One-sigma uncertainty of frames, points, scale and lenses after the best similarity of the positions to the
    truth.

    ``interior``: rows of INTERIOR, one for each adjusted parameter; ``mounting``: cameras in their rig, by camera id.
    For a large model the frames are a sample, evenly over the pass; the points are always a random sample.
    """

    frame_ids: tuple[int, ...]  # of the model
    sigma: np.ndarray  # (F, 3) along the model's axes, model units
    pixel_sigma: float  # a posteriori sigma of one image coordinate, pixels, robust
    points: PointSigma
    shared: SharedErrors
    interior: tuple[tuple, ...] = ()
    mounting: dict[int, Mounting] = field(default_factory=dict)
    covariance: np.ndarray | None = None  # (3F, 3F) of the positions, model units squared
    turns: np.ndarray | None = None  # (F, 3, 3) rad squared, of the frames' turns about the model's axes
    scale: float | None = None  # relative, of all lengths together; None: nothing in the adjustment knows it

    @property
    def turn(self) -> np.ndarray:
        """(F, 3) sigmas of the frames' rotations about the model's axes, rad."""
        return np.zeros((0, 3)) if self.turns is None else _root(np.einsum("kii->ki", self.turns))

    @property
    def median(self) -> float:
        """Median of the frames' root sum of squares."""
        return float(np.median(np.linalg.norm(self.sigma, axis=1)))

    @property
    def p90(self) -> float:
        """90th percentile of the frames' root sum of squares."""
        return float(np.percentile(np.linalg.norm(self.sigma, axis=1), 90))

    def covering(self, steps: Iterable[Mapping[int, np.ndarray]]) -> PositionSigma:
        """The same with sigmas that also cover the alternative places of frames (ids of the model), each a step (3,)
        away; those of one mapping stand there all or none."""
        out = self
        for group in steps:
            away = np.array([group.get(k, np.zeros(3)) for k in self.frame_ids]).reshape(-1, 3)
            full = None if out.covariance is None else out.covariance + np.outer(away, away)
            out = replace(out, sigma=np.hypot(out.sigma, away), covariance=full)
        return out

    def tables(self, names: Mapping[int, str]) -> dict[str, dict]:
        """Interior orientation, mounting and lens errors as tables of the receipt; ``names`` of the cameras by id."""
        out = {}
        if self.interior:
            rows = [[names.get(row[0], row[0]), *row[1:]] for row in self.interior]
            out[INTERIOR_TABLE] = {"columns": list(INTERIOR), "rows": rows}
        if self.mounting:
            named = [[names.get(k, k), *m.centre, m.sigma, m.sigma_deg] for k, m in self.mounting.items()]
            out[MOUNTING] = {"columns": ["camera", "x", "y", "z", "sigma", "sigma of the rotation deg"], "rows": named}
        lenses = self.shared.lenses
        bins = [[names.get(f.camera, f.camera), *(round(v, 2) for v in row)] for f in lenses for row in f.worst]
        if bins:
            out[LENS] = {"columns": ["camera", "x px", "y px", "dx px", "dy px", "times its sigma"], "rows": bins}
        return out

    def open_mountings(self, tuning: SigmaTuning) -> dict[int, float]:
        """Camera id -> sigma of its place in the rig divided by its distance from the reference,
        where that is large."""
        shares = {k: m.sigma / max(float(np.linalg.norm(m.centre)), 1e-12) for k, m in self.mounting.items()}
        most = tuning.open_times * self.median
        return {k: s for k, s in shares.items() if s > tuning.open_share and self.mounting[k].sigma > most}


INTERIOR_TABLE = "interior orientation"
MOUNTING = "mounting in the rig, model units"
LENS = "remaining lens errors: mean residuals beyond noise"
INTERIOR = ("camera", "parameter", "value", "sigma", "strongest correlation", "with")


def position_sigma(
    model: pycolmap.Reconstruction,
    free_intrinsics: bool | Collection[int] = True,
    free_rig: bool | Collection[int] = True,
    nominal: Mapping[int, NominalGeometry] | None = None,
    off: Mapping[int, np.ndarray] | None = None,
    times: tuple[Motion, Mapping[int, float]] | None = None,
    *,
    tuning: Tuning,
) -> PositionSigma:
    """Sigmas of registered frames, points, scale, rig and interior orientation, from the gradient of every point.

    Intrinsics and rig extrinsics are unknowns unless stated otherwise (ids of cameras, of rigs). ``nominal``:
    geometry of rigs by rig id; ``off``: how far the cameras of contradicted rigs may be off (``misplaced``);
    ``times``: the paths of the images, and sigmas of the firing times of cameras (ids), s (``untimed``). The gauge is
    removed by the S-transformation over all positions, so a sigma is that of a position after the best alignment to
    the truth. (pycolmap's estimate_ba_covariance refuses rigs.) Raises ValueError for a model without redundancy.
    """
    layout = Layout(model, free_intrinsics, free_rig)
    seen = Linearised(model, layout, nominal or {}, tuning, tuning.sigma.most_points)
    fixed = () if free_rig is True else set(model.rigs) - set(free_rig or ())
    mounted, explained = misplaced(model, seen.weighed, fixed, off or {})
    weighed = seen.weighed.without(explained)
    lenses, explained = lens_errors(model, weighed)
    strays = [*mounted, *unrest(model, weighed.without(explained))]
    strays += [] if times is None else untimed(weighed, *times)
    told = _Told(seen, tuning.sigma)
    told.add([*(effect for _, effect in lenses), *strays])
    return told.of(model, tuple(f for f, _ in lenses))


def planned_sigma(
    model: pycolmap.Reconstruction,
    free_intrinsics: Collection[int],
    free_rig: bool,
    assumed: AssumedErrors,
    *,
    tuning: Tuning,
) -> PositionSigma:
    """The same for a simulated network: shared errors are not estimated but have the assumed size.

    Raises ValueError for a model without redundancy.
    """
    seen = Linearised(model, Layout(model, free_intrinsics, free_rig), {}, tuning, tuning.sigma.most_points)
    told = _Told(seen, tuning.sigma)
    told.full *= assumed.tracks**2
    told.add(assumed.effects(model, seen.weighed))
    return told.of(model, ())


class _Told:
    """The information from the observations of points, to which shared errors are added."""

    def __init__(self, seen: Linearised, tuning: SigmaTuning) -> None:
        weighed, variance = seen.weighed, seen.variance
        self.seen, self.tuning, normal = seen, tuning, weighed.normal
        self.asked = _Asked(seen.layout, weighed, tuning)
        self.sides = np.hstack([normal.asked(self.asked.functions), normal.scale()])
        self.solved = normal.solve(self.sides)
        self.full = self.solved.T @ (weighed.scatter @ self.solved) / seen.share
        self.full += variance**2 * self.solved.T @ (seen.pull @ self.solved)

    def add(self, effects: Collection[Effect]) -> None:
        """Add the covariance of the effects of shared errors."""
        for effect in effects:
            self.full += effect.covariance(self.solved)

    def of(self, model: pycolmap.Reconstruction, lenses: tuple[LensError, ...]) -> PositionSigma:
        """All sigmas together."""
        seen, asked, full, (first, second) = self.seen, self.asked, self.full, self.seen.weights
        mean = float(np.mean(second))
        # What independent normal errors of this sigma would give: the curvature is then without robust weights.
        formal = seen.variance * mean * np.einsum("ij,ij->j", self.sides, self.solved)
        noise = float(np.mean((first * seen.weighed.seen.residual) ** 2)) * seen.inflated / mean
        # (C, C) covariance with non-zero entries only for rig and lenses, which follow the frames
        start = 6 * len(asked.frame_ids)
        own = slice(start, start + len(asked.rest))
        rest = _Rest(seen.layout, full[own, own], self.tuning.strong_correlation)
        return PositionSigma(
            **asked.of_frames(full), pixel_sigma=float(np.sqrt(seen.variance)),
            points=PointSigma(tuple(seen.points[k] for k in asked.points), asked.of_points(full, noise)),
            shared=SharedErrors(asked.widened(full, formal), lenses),
            interior=rest.interior(model), mounting=rest.mounting(),
            scale=float(np.sqrt(full[-1, -1])) if seen.weighed.normal.scale_known else None,
        )  # fmt: skip


class Linearised:
    """The linearised observations of at most ``most_points`` of a model's points, with the priors.

    ``inflated``: observations over redundancy. ``variance`` of one coordinate, px2. ``weights`` (2O,) of the robust
    cost's gradient and of its curvature. ``pull`` (C, C): scatter of the gradient of the priors. Raises ValueError
    for a model without redundancy.
    """

    def __init__(
        self,
        model: pycolmap.Reconstruction,
        layout: Layout,
        nominal: Mapping[int, NominalGeometry],
        tuning: Tuning,
        most_points: int,
    ) -> None:
        if len(layout.frame_ids) < 3:
            raise ValueError("needs at least 3 frames")
        self.layout = layout
        self.points, self.share = sampled(model.point3D_ids(), most_points)
        seen = jacobians(model, layout, self.points)
        redundancy = len(seen.residual) - (layout.size - 7) - 3 * len(self.points)
        if redundancy <= 0:
            raise ValueError("no redundancy")
        self.inflated = len(seen.residual) / redundancy
        self.variance = max(robust_sigma(seen.residual) ** 2 * self.inflated, 1e-12)
        known = layout.prior(model, tuning.adjust, nominal)
        # (2O,) weights of the Cauchy cost's gradient, and of its curvature along the residual (never negative)
        weight = 1 / (1 + np.sum(seen.residual.reshape(-1, 2) ** 2, axis=1) / tuning.adjust.robust_px**2)
        self.weights = np.repeat(weight, 2), np.repeat(weight**2, 2)
        prior = (self.variance * known).tocsr()
        self.weighed, self.pull = EffectWeights(seen, self.weights, self.share, prior, layout), known


class _Asked:
    """The functions (C, K) of the unknowns whose sigmas are wanted: first positions and rotations of frames, then all
    unknowns that follow the frames, then points."""

    def __init__(self, layout: Layout, weighed: EffectWeights, tuning: SigmaTuning) -> None:
        frames = evenly(len(layout.frame_ids), tuning.frames)
        self.frame_ids = tuple(layout.frame_ids[k] for k in frames)
        at = 6 * frames[:, None] + np.arange(3)
        self.rest = np.arange(6 * len(layout.frame_ids), layout.size)
        columns = np.concatenate([at.ravel(), at.ravel() + 3, self.rest])
        identity = sparse.csc_matrix(
            (np.ones(len(columns)), (columns, np.arange(len(columns)))), shape=(layout.size, len(columns))
        )
        count = weighed.jp.shape[1] // 3
        self.points = np.sort(np.random.default_rng(_SEED).permutation(count)[: tuning.points])
        columns = (3 * self.points[:, None] + np.arange(3)).ravel()
        self.own = point_inverse(weighed.jp[:, columns].tocsr())  # (P, 3, 3)
        of_points = weighed.cross[:, columns] @ by_blocks(self.own)
        self.functions = sparse.hstack([identity, -of_points]).tocsc()

    def of_frames(self, full: np.ndarray) -> dict[str, Any]:
        """Fields of PositionSigma from the covariance (K + 1, K + 1) of functions and scale."""
        sigma, m = _root(np.diag(full)), 3 * len(self.frame_ids)
        turns = np.array([full[k : k + 3, k : k + 3] for k in range(m, 2 * m, 3)])
        return {
            "frame_ids": self.frame_ids,
            "sigma": sigma[:m].reshape(-1, 3),
            "turns": turns,
            "covariance": full[:m, :m],
        }

    def widened(self, full: np.ndarray, formal: np.ndarray) -> float:
        """Median of the positions' sigmas over those of independent errors, whose variances (K + 1,) are given."""
        m = 3 * len(self.frame_ids)
        place, simple = (np.linalg.norm(_root(v[:m]).reshape(-1, 3), axis=1) for v in (np.diag(full), formal))
        return float(np.median(place / np.maximum(simple, 1e-300)))

    def of_points(self, full: np.ndarray, noise: float) -> np.ndarray:
        """(P, 3) sigmas of points; ``noise``: variance of an observation of one."""
        start = 6 * len(self.frame_ids) + len(self.rest)
        shared = _root(np.diag(full))[start:-1].reshape(-1, 3) ** 2
        return np.asarray(np.sqrt(shared + noise * np.einsum("kii->ki", self.own)))


def _root(variance: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.clip(variance, 0, None)))


@dataclass(frozen=True)
class _Rest:
    """The unknowns that follow the frames, rig and lenses, with their covariance (R, R)."""

    layout: Layout
    covariance: np.ndarray
    strong: float  # a correlation from which it is listed

    def _at(self, column: int, count: int) -> list[int]:
        start = column - 6 * len(self.layout.frame_ids)
        return list(range(start, start + count))

    def interior(self, model: pycolmap.Reconstruction) -> tuple[tuple, ...]:
        """Each adjusted parameter with its sigma and the parameter of lens or mounting with which
        it correlates most."""
        full = self.covariance
        sigma = np.sqrt(np.clip(np.diag(full), 1e-300, None))
        rows = []
        for key, column in self.layout.camera.items():
            camera = model.camera(key)
            names = [n.strip() for n in camera.params_info.split(",")]
            own = self._at(column, len(names))
            labels = dict(zip(own, names))
            if key in self.layout.sensor:
                labels |= dict(zip(self._at(self.layout.sensor[key], 6), _MOUNTING))
            for at, name, value in zip(own, names, camera.params):
                others = {o: full[at, o] / sigma[at] / sigma[o] for o in labels if o != at}
                most = max(others, key=lambda o: abs(others[o]))
                told = abs(others[most]) >= self.strong
                last = (round(float(others[most]), 2), labels[most]) if told else (None, "")
                rows.append((key, name, float(f"{value:.6g}"), float(f"{sigma[at]:.2g}"), *last))
        return tuple(rows)

    def mounting(self) -> dict[int, Mounting]:
        """The cameras in their rig, by id."""
        out = {}
        for key, column in self.layout.sensor.items():
            own = np.clip(np.diag(self.covariance)[self._at(column, 6)], 0, None)
            place, turn = np.sqrt(own.reshape(2, 3).sum(axis=1))
            x, y, z = self.layout.sensor_centre[key].tolist()
            out[key] = Mounting((x, y, z), float(place), float(np.degrees(turn)))
        return out


_MOUNTING = ("place x", "place y", "place z", "turn x", "turn y", "turn z")
