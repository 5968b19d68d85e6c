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

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.geometry.transforms import robust_sigma
from tiegraph.scene.evidence import LIMIT
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
    passing,
    unrest,
    untimed,
)
from tiegraph.sfm.tuning import SigmaTuning, Tuning


@dataclass(frozen=True)
class Mounting:
    """A camera in its rig: centre (3,) in the frame of the reference, model units, its sigma, and the sigma of its
    rotation."""

    centre: tuple[float, float, float]
    sigma: float  # model units, root sum of squares
    sigma_deg: float


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
    points: dict[int, np.ndarray]  # by the ids of points: as ``sigma``, (3,)
    lenses: tuple[LensError, ...] = ()  # what their models leave out
    interior: tuple[tuple, ...] = ()
    mounting: dict[int, Mounting] = field(default_factory=dict)
    covariance: np.ndarray | None = None  # (3F, 3F) of the positions, model units squared
    turns: np.ndarray | None = None  # (F, 3, 3) rad squared, of the frames' turns about the model's axes
    scale: float | None = None  # relative, of all lengths together; None: nothing in the adjustment knows it

    @property
    def turn(self) -> np.ndarray:
        """(F, 3) sigmas of the frames' rotations about the model's axes, rad."""
        return np.zeros((0, 3)) if self.turns is None else np.sqrt(np.clip(np.einsum("kii->ki", self.turns), 0, None))

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
        bins = [[names.get(f.camera, f.camera), *(round(v, 2) for v in row)] for f in self.lenses for row in f.worst]
        if bins:
            out[LENS] = {"columns": ["camera", "x px", "y px", "dx px", "dy px", "times its sigma"], "rows": bins}
        return out

    def open_mountings(self, tuning: SigmaTuning) -> dict[int, float]:
        """Camera id -> sigma of its place in the rig divided by its distance from the reference,
        where that is large."""
        shares = {k: m.sigma / max(float(np.linalg.norm(m.centre)), 1e-12) for k, m in self.mounting.items()}
        most = LIMIT * self.median
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
    rest = weighed.without(explained)
    strays = [*mounted, *unrest(model, rest), *passing(model, rest)]
    strays += [] if times is None else untimed(weighed, *times)
    effects = [*(effect for _, effect in lenses), *strays]
    return replace(_sigma(model, seen, effects, tuning.sigma), lenses=tuple(f for f, _ in lenses))


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
    return _sigma(model, seen, assumed.effects(model, seen.weighed), tuning.sigma, assumed.tracks)


def _sigma(
    model: pycolmap.Reconstruction,
    seen: Linearised,
    effects: Collection[Effect],
    tuning: SigmaTuning,
    tracks: float = 1.0,
) -> PositionSigma:
    """The sigmas by the observations of points, whose errors are ``tracks`` times as large as their residuals tell,
    and by the effects of shared errors."""
    layout, weighed, (first, second) = seen.layout, seen.weighed, seen.weights
    normal, unknowns = weighed.normal, 6 * len(layout.frame_ids)
    frames = evenly(len(layout.frame_ids), tuning.sampled)
    points = np.sort(np.random.default_rng(0).permutation(weighed.jp.shape[1] // 3)[: tuning.sampled])
    # First positions and rotations of the frames, then all unknowns that follow the frames, then points
    places = 6 * frames[:, None] + np.arange(3)
    asked = np.concatenate([places.ravel(), places.ravel() + 3, np.arange(unknowns, layout.size)])
    shape = (layout.size, len(asked))
    identity = sparse.csc_matrix((np.ones(len(asked)), (asked, np.arange(len(asked)))), shape=shape)
    columns = (3 * points[:, None] + np.arange(3)).ravel()
    own = point_inverse(weighed.jp[:, columns].tocsr())  # (P, 3, 3)
    functions = sparse.hstack([identity, -(weighed.cross[:, columns] @ by_blocks(own))]).tocsc()

    solved = normal.solve(np.hstack([normal.asked(functions), normal.scale()]))
    full = solved.T @ (weighed.scatter @ solved) / seen.share
    full += seen.variance**2 * solved.T @ (seen.pull @ solved)
    full *= tracks**2
    for effect in effects:
        full += effect.covariance(solved)
    sigma, count = np.sqrt(np.clip(np.diag(full), 0, None)), 3 * len(frames)
    rest = full[2 * count : len(asked), 2 * count : len(asked)]  # of rig and lenses
    noise = float(np.mean((first * weighed.seen.residual) ** 2)) * seen.inflated / float(np.mean(second))
    of_points = sigma[len(asked) : -1].reshape(-1, 3) ** 2 + noise * np.einsum("kii->ki", own)
    return PositionSigma(
        frame_ids=tuple(layout.frame_ids[k] for k in frames),
        sigma=sigma[:count].reshape(-1, 3),
        turns=np.array([full[k : k + 3, k : k + 3] for k in range(count, 2 * count, 3)]),
        covariance=full[:count, :count],
        pixel_sigma=float(np.sqrt(seen.variance)),
        points=dict(zip([seen.points[k] for k in points], np.sqrt(of_points))),
        interior=_interior(model, layout, rest),
        mounting=_mountings(layout, rest),
        scale=float(np.sqrt(full[-1, -1])) if normal.scale_known else None,
    )


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


def _interior(model: pycolmap.Reconstruction, layout: Layout, covariance: np.ndarray) -> tuple[tuple, ...]:
    """Each adjusted parameter of lenses with its sigma and the parameter of lens or mounting with which it correlates
    most. ``covariance`` (R, R) of the unknowns that follow the frames."""
    sigma, frames = np.sqrt(np.clip(np.diag(covariance), 1e-300, None)), 6 * len(layout.frame_ids)
    rows = []
    for key, column in layout.camera.items():
        camera = model.camera(key)
        own = list(enumerate((n.strip() for n in camera.params_info.split(",")), start=column - frames))
        labels = dict(own)
        if key in layout.sensor:
            labels |= dict(enumerate(_MOUNTING, start=layout.sensor[key] - frames))
        for (at, name), value in zip(own, camera.params):
            others = {o: covariance[at, o] / sigma[at] / sigma[o] for o in labels if o != at}
            most = max(others, key=lambda o: abs(others[o]))
            last = round(float(others[most]), 2), labels[most]
            rows.append((key, name, float(f"{value:.6g}"), float(f"{sigma[at]:.2g}"), *last))
    return tuple(rows)


def _mountings(layout: Layout, covariance: np.ndarray) -> dict[int, Mounting]:
    out, variance = {}, np.clip(np.diag(covariance), 0, None)
    for key, column in layout.sensor.items():
        start = column - 6 * len(layout.frame_ids)
        place, turn = np.sqrt(variance[start : start + 6].reshape(2, 3).sum(axis=1))
        x, y, z = layout.sensor_centre[key].tolist()
        out[key] = Mounting((x, y, z), float(place), float(np.degrees(turn)))
    return out


_MOUNTING = ("place x", "place y", "place z", "turn x", "turn y", "turn z")
