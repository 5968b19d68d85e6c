"""How well the adjustment knows poses, rig and lenses: points eliminated, errors of a track together, free gauge.

The final adjustment is an M-estimator, and its observations are neither normal nor independent: residuals have long
tails, and the sightings of a point err together. So the covariance is a sandwich (Huber 1967; clusters: Liang and
Zeger 1986): A^-1 B A^-1, with A the curvature of the robust cost and B the sum over the points of g g', g the point's
share of the gradient. Nothing is assumed of sigma or correlation within a track.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.geometry.transforms import skew
from tiegraph.sfm.jacobians import Layout, Tie, jacobians
from tiegraph.sfm.rig.compact import Drawing

MAX_POINTS = 200_000  # more are not looked at one by one: a random part, and the sums are scaled up
ROBUST_PX = 0.5  # Cauchy scale of the adjustment (sfm/adjust.py)
_SEED = 0
_RIDGE = 1e-9  # of the median stiffness: a frame that no point holds gets a huge sigma instead of a singular matrix
_STRONG = 0.7  # a correlation of interior orientation that is told


@dataclass(frozen=True)
class Mounting:
    """A camera in its rig: centre (3,) in the frame of the reference, model units, sigma of it, sigma of the turn."""

    centre: tuple[float, float, float]
    sigma: float  # model units, root sum of squares
    sigma_deg: float


@dataclass(frozen=True)
class PositionSigma:
    """One-sigma uncertainty of frames, model units, after the best similarity to the truth (free gauge), and of lenses.

    ``widened``: sigmas over those that independent errors of normal distribution would have (median of the frames).
    ``interior``: rows of INTERIOR, one an adjusted parameter; ``mounting``: of a camera in its rig, by camera id.
    """

    frame_ids: tuple[int, ...]  # of the model
    sigma: np.ndarray  # (F, 3) along the model's axes
    pixel_sigma: float  # a posteriori sigma of one image coordinate, pixels, robust
    widened: float = 1.0
    interior: tuple[tuple, ...] = ()
    mounting: dict[int, Mounting] = field(default_factory=dict)
    covariance: np.ndarray | None = None  # (3F, 3F) of the positions, model units squared

    @property
    def median(self) -> float:
        """Median of the frames' root sum of squares."""
        return float(np.median(np.linalg.norm(self.sigma, axis=1)))

    @property
    def p90(self) -> float:
        """90th percentile of the frames' root sum of squares."""
        return float(np.percentile(np.linalg.norm(self.sigma, axis=1), 90))

    def tables(self, names: Mapping[int, str]) -> dict[str, dict]:
        """Interior orientation and mounting as tables of the receipt; ``names`` of the cameras by id."""
        out = {}
        if self.interior:
            rows = [[names.get(row[0], row[0]), *row[1:]] for row in self.interior]
            out["interior orientation"] = {"columns": list(INTERIOR), "rows": rows}
        if self.mounting:
            named = [[names.get(k, k), *m.centre, m.sigma, m.sigma_deg] for k, m in self.mounting.items()]
            out[MOUNTING] = {"columns": ["camera", "x", "y", "z", "sigma", "sigma of the turn deg"], "rows": named}
        return out

    def open_mountings(self) -> dict[int, float]:
        """Camera id -> sigma of its place in the rig over its distance from the reference, where that is large."""
        shares = {k: m.sigma / max(float(np.linalg.norm(m.centre)), 1e-12) for k, m in self.mounting.items()}
        return {k: s for k, s in shares.items() if s > OPEN_SHARE and self.mounting[k].sigma > OPEN_TIMES * self.median}


MOUNTING = "mounting in the rig, units of the model"
OPEN_SHARE, OPEN_TIMES = 0.1, 3.0  # of the lever arm, of the sigma of the frames: beyond both, a place is hardly known
INTERIOR = ("camera", "parameter", "value", "sigma", "strongest correlation", "with")


def position_sigma(
    model: pycolmap.Reconstruction,
    free_intrinsics: bool | Collection[int] = True,
    free_rig: bool | Collection[int] = True,
    ties: Collection[Tie] = (),
    drawings: Mapping[int, Drawing] | None = None,
) -> PositionSigma:
    """Position sigmas of the registered frames, and interior orientation, from the gradient of every point.

    Intrinsics and rig extrinsics are unknowns unless told otherwise (ids of cameras, of rigs); ``ties`` hold
    the frames of relaxed rigs; ``drawings`` of nominal rigs by rig id. The gauge is taken out
    by the S-transformation over all positions, so a sigma is that of a position after the best alignment to the truth.
    What all points share (a lens unlike its model, a rig that moves, a false place) is not in it. (pycolmap's
    estimate_ba_covariance refuses rigs.) Raises ValueError for a model without redundancy.
    """
    layout = Layout(model, free_intrinsics, free_rig, drawings)
    if len(layout.frame_ids) < 3:
        raise ValueError("needs at least 3 frames")
    points, share = _sample(model)
    jc, jp, residual = jacobians(model, layout, points)
    redundancy = len(residual) - (layout.size - 7) - 3 * len(points)
    if redundancy <= 0:
        raise ValueError("no redundancy")
    variance = max((1.4826 * float(np.median(np.abs(residual)))) ** 2 * len(residual) / redundancy, 1e-12)
    prior = variance * (layout.prior() + layout.tied(ties))
    first, second = _robust_weights(residual)
    curvature = reduced(_scaled(jc, np.sqrt(second)), _scaled(jp, np.sqrt(second))) / share + prior
    of_point = _gradients(jc, jp, first * residual)
    spread = (of_point.T @ of_point).toarray() / share + variance * prior
    inverse = _inverse(curvature, layout)
    full = inverse @ spread @ inverse
    covariance = without_gauge(full, layout)
    # What independent normal errors of this sigma would give: the curvature had no robust weights then.
    formal = without_gauge(variance * float(np.mean(second)) * inverse, layout)
    sigma, plain = (np.sqrt(np.clip(np.diag(c), 0, None)).reshape(-1, 3) for c in (covariance, formal))
    wider = np.linalg.norm(sigma, axis=1) / np.maximum(np.linalg.norm(plain, axis=1), 1e-300)
    return PositionSigma(
        layout.frame_ids, sigma, float(np.sqrt(variance)), float(np.median(wider)), _interior(model, layout, full),
        _mounting(layout, full), covariance,
    )  # fmt: skip


def _sample(model: pycolmap.Reconstruction) -> tuple[list[int], float]:
    ids = np.array(sorted(model.point3D_ids()))
    share = min(1.0, MAX_POINTS / max(len(ids), 1))
    if share < 1:
        ids = np.sort(np.random.default_rng(_SEED).choice(ids, MAX_POINTS, replace=False))
    return ids.tolist(), share


def _robust_weights(residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2O,) weights of the Cauchy cost's gradient, and of its curvature along the residual (never negative)."""
    weight = 1 / (1 + np.sum(residual.reshape(-1, 2) ** 2, axis=1) / ROBUST_PX**2)
    return np.repeat(weight, 2), np.repeat(weight**2, 2)


def _scaled(matrix: sparse.csr_matrix, rows: np.ndarray) -> sparse.csr_matrix:
    return (sparse.diags(rows) @ matrix).tocsr()


def _gradients(jc: sparse.csr_matrix, jp: sparse.csr_matrix, weighted: np.ndarray) -> sparse.csr_matrix:
    """(P, C) gradient of each point's share of the cost; its own three unknowns are at their minimum."""
    number = jp.indices[jp.indptr[:-1]] // 3  # an observation touches one point
    rows = np.arange(len(weighted))
    gather = sparse.csr_matrix((weighted, (number, rows)), shape=(jp.shape[1] // 3, len(weighted)))
    return (gather @ jc).tocsr()


def _interior(model: pycolmap.Reconstruction, layout: Layout, full: np.ndarray) -> tuple[tuple, ...]:
    """Each adjusted parameter with its sigma and what it is most correlated with: the lens, the mounting."""
    sigma = np.sqrt(np.clip(np.diag(full), 1e-300, None))
    rows = []
    for key, column in layout.camera.items():
        camera = model.camera(key)
        names = [n.strip() for n in camera.params_info.split(",")]
        own = [column + k for k in range(len(names))]
        labels = dict(zip(own, names))
        if key in layout.sensor:
            labels |= {layout.sensor[key] + k: n for k, n in enumerate(_MOUNTING)}
        for at, name, value in zip(own, names, camera.params):
            others = {o: full[at, o] / sigma[at] / sigma[o] for o in labels if o != at}
            most = max(others, key=lambda o: abs(others[o]))
            told = abs(others[most]) >= _STRONG
            last = (round(float(others[most]), 2), labels[most]) if told else (None, "")
            rows.append((key, name, float(f"{value:.6g}"), float(f"{sigma[at]:.2g}"), *last))
    return tuple(rows)


_MOUNTING = ("place x", "place y", "place z", "turn x", "turn y", "turn z")


def _mounting(layout: Layout, full: np.ndarray) -> dict[int, Mounting]:
    out = {}
    for key, column in layout.sensor.items():
        place, turn = np.sqrt(np.clip(np.diag(full)[column : column + 6], 0, None).reshape(2, 3).sum(axis=1))
        x, y, z = layout.sensor_centre[key].tolist()
        out[key] = Mounting((x, y, z), float(place), float(np.degrees(turn)))
    return out


def reduced(jc: sparse.csr_matrix, jp: sparse.csr_matrix) -> np.ndarray:
    """Reduced camera system: Jc'Jc - Jc'Jp (Jp'Jp)^-1 Jp'Jc, dense."""
    points = jp.shape[1] // 3
    blocks = (jp.T @ jp).tobsr(blocksize=(3, 3))
    dense = np.zeros((points, 3, 3))
    dense[blocks.indices] = blocks.data  # block diagonal: an observation touches one point
    inverse = np.linalg.pinv(dense, hermitian=True)
    h_inv = sparse.bsr_matrix((inverse, np.arange(points), np.arange(points + 1)), shape=(3 * points, 3 * points))
    cross = (jc.T @ jp).tocsr()
    return (jc.T @ jc - cross @ h_inv @ cross.T).toarray()


def positions_free_gauge(normal: np.ndarray, layout: Layout) -> np.ndarray:
    """Covariance (3F, 3F) of the positions by the normal matrix (C, C), with similarities of the whole taken out."""
    return without_gauge(_inverse(normal, layout), layout)


def _gauge(layout: Layout) -> np.ndarray:
    """(C, 7) motions of everything: shift, turn, scale."""
    frames = len(layout.centres)
    local = layout.centres - layout.centres.mean(axis=0)
    size = max(float(np.sqrt(np.mean(np.sum(local**2, axis=1)))), 1e-12)
    at = np.arange(6 * frames).reshape(frames, 6)
    gauge = np.zeros((layout.size, 7))
    gauge[at[:, :3].ravel()] = np.concatenate(
        [np.tile(np.eye(3), (frames, 1)), -skew(local / size).reshape(-1, 3), (local / size).reshape(-1, 1)], axis=1
    )
    gauge[at[:, 3:].ravel(), 3:6] = np.tile(np.eye(3), (frames, 1)) / size
    for sensor, column in layout.sensor.items():
        gauge[column : column + 3, 6] = layout.sensor_centre[sensor] / size
    return gauge


def _inverse(normal: np.ndarray, layout: Layout) -> np.ndarray:
    """A generalised inverse: the seven directions of the gauge, which the normal matrix does not know (six where a
    fixed rig holds the scale), get unit stiffness; ``without_gauge`` removes what that adds."""
    gauge = _gauge(layout)
    stiff = np.sqrt(np.maximum(np.diag(normal), np.max(np.diag(normal)) * 1e-18))
    scaled = normal / stiff[:, None] / stiff[None, :]  # unit diagonal: numbers of like size whatever the unit
    basis = np.linalg.qr(gauge * stiff[:, None])[0]
    inverse = np.linalg.inv(scaled + basis @ basis.T + _RIDGE * np.eye(layout.size))
    return np.asarray(inverse / stiff[:, None] / stiff[None, :])


def without_gauge(full: np.ndarray, layout: Layout) -> np.ndarray:
    """(3F, 3F) of the positions by a covariance (C, C) in any gauge, similarities taken out (S-transform)."""
    positions = np.arange(6 * len(layout.centres)).reshape(-1, 6)[:, :3].ravel()
    covariance = full[np.ix_(positions, positions)]
    q = np.linalg.qr(_gauge(layout)[positions])[0]
    covariance = covariance - q @ (q.T @ covariance)
    return np.asarray(covariance - (covariance @ q) @ q.T)
