"""A cloud laid on another: point-to-plane ICP of a rigid motion or a similarity, with the sigma of what it found.

Chen, Medioni 1992, with Tukey's weights. The points of a patch err together, so the sigma is that of a jackknife over
parts of the survey: what the fit becomes without each of them. A fit that the surfaces leave open is refused.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiegraph.evaluate.tuning import RegistrationTuning
from tiegraph.geometry.coarse import Start, normals, start_of
from tiegraph.geometry.transforms import PlacementError, Similarity, robust_sigma
from tiegraph.scene.cloudchunks import PointSource

_PARTS, _CELLS = 10, 20  # of the jackknife: each a tenth of the cells, of which the survey's length has so many
_NAMES = ("turn about x", "turn about y", "turn about z", "x", "y", "z", "scale")
_REACHES = (40.0, 20.0, 10.0, 5.0)  # to the nearest point at most, in spacings, one after another
# Smallest to largest eigenvalue of the equations, all unknowns in metres of motion, below which surfaces slide: noise
# of the normals alone makes 0.0005 of a plane and 0.0024 of a corridor, a corner has 0.08.
_OPEN_SHARE = 0.005
_TUKEY = 4.685  # residuals beyond so many sigmas do not count (Tukey's function, 95 % efficient)


@dataclass(frozen=True)
class Registration:
    """``fit`` takes the cloud to the reference; ``error`` its covariance; ``residual_m`` robust sigma of a point's
    distance from the surface; ``used`` the share of the points that has a partner; ``start`` by shapes, if any."""

    fit: Similarity
    error: PlacementError
    residual_m: float
    used: float
    start: Start | None = None

    def sigma_along(self, xyz: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N,) what the fit leaves uncertain at points (N, 3) along normals (N, 3), metres."""
        return np.sqrt(np.sum((self.error.sigma(xyz) * normal) ** 2, axis=1))

    def table(self) -> dict:
        """A table for metrics.json: value and sigma of each part of the transform."""
        sd = np.sqrt(np.clip(np.diag(self.error.covariance), 0, None))
        turn = Rotation.from_matrix(self.fit.rotation).as_rotvec(degrees=True)
        shift = self.fit(self.error.middle[None])[0] - self.error.middle
        rows: list[list] = [
            *([f"turn about {a}, deg", float(v), float(np.degrees(s))] for a, v, s in zip("xyz", turn, sd)),
            *([f"shift in {a} at the middle, m", float(v), float(s)] for a, v, s in zip("xyz", shift, sd[3:])),
            ["scale", self.fit.scale, float(sd[6])],
            ["residual (robust sigma), m", self.residual_m, None],
            ["points with a partner, %", 100 * self.used, None],
        ]
        if self.start is not None:
            rows.append(["coarse start: consistent matches", self.start.matches, None])
            rows.append(["coarse start: points near the reference, %", 100 * self.start.share, None])
            rows.append(["coarse start: the same in the next best place, %", 100 * self.start.rival, None])
        return {"columns": ["of the registration", "value", "sigma"], "rows": rows}


def registered(
    cloud: PointSource, reference: PointSource, tuning: RegistrationTuning, with_scale: bool, coarse: bool
) -> Registration:
    """Lay a cloud of any size on a reference by a sample of both; ``coarse``: from a start by their shapes.

    Raises ValueError as ``register`` does, and if no shapes agree.
    """
    own, truth = (source.sample(tuning.points) for source in (cloud, reference))
    start = start_of(own, truth, tuning.coarse) if coarse else None
    return register(own, truth, tuning, with_scale, start)


def register(
    cloud: np.ndarray,
    reference: np.ndarray,
    tuning: RegistrationTuning,
    with_scale: bool = False,
    start: Start | None = None,
) -> Registration:
    """Lay a cloud (N, 3) on a reference (M, 3) from a start by their shapes (None: as they are).

    Raises ValueError if too few points meet, or their surfaces leave a direction open (a plane slides in itself).
    """
    placed = np.eye(4) if start is None else start.target_from_source
    fit = Similarity(1.0, placed[:3, :3], placed[:3, 3])
    tree = cKDTree(reference)
    normal = normals(reference, 20)
    spacing = float(np.median(tree.query(reference[:: max(1, len(reference) // 5000)], k=2)[0][:, 1]))
    middle = np.median(fit(cloud), axis=0)
    extent = float(np.median(np.linalg.norm(fit(cloud) - middle, axis=1)))
    unknowns = 7 if with_scale else 6
    unit = np.r_[np.full(3, 1 / extent), np.ones(3), 1 / extent][:unknowns]  # all unknowns move points by metres

    def met(reach: float) -> _Equations:
        return _equations(fit(cloud), (tree, normal), reach * spacing, tuning, middle, unit)

    for reach in _REACHES:
        for _ in range(20):
            found = met(reach)
            step = np.linalg.solve(found.matrix.sum(axis=0), found.vector.sum(axis=0))
            fit = fit.stepped(np.r_[step * unit, np.zeros(7 - unknowns)], middle)
            if np.abs(step).max() < 1e-3 * spacing:
                break
    found = met(_REACHES[-1])
    covariance = np.zeros((7, 7))
    covariance[:unknowns, :unknowns] = found.covariance() * np.outer(unit, unit)
    return Registration(fit, PlacementError(middle, covariance), found.sigma, used=found.share, start=start)


@dataclass(frozen=True)
class _Equations:
    """Normal equations of the points that met, of each part of the survey (P, U, U), (P, U); and their residuals."""

    matrix: np.ndarray
    vector: np.ndarray
    sigma: float
    share: float

    def covariance(self) -> np.ndarray:
        """Of the unknowns: what the fit becomes without each part, and the formal one if that is larger."""
        whole, right = self.matrix.sum(axis=0), self.vector.sum(axis=0)
        left = np.linalg.solve(whole - self.matrix, (right - self.vector)[:, :, None])[:, :, 0]
        off = left - left.mean(axis=0)
        return np.asarray(np.linalg.inv(whole) * self.sigma**2 + (len(left) - 1) / len(left) * off.T @ off)


def _equations(
    xyz: np.ndarray,
    planes: tuple[cKDTree, np.ndarray],
    reach: float,
    tuning: RegistrationTuning,
    middle: np.ndarray,
    unit: np.ndarray,
) -> _Equations:
    """Pair points (N, 3) with the nearest planes (points, normals) of the reference; the equations of the next step."""
    tree, normal = planes
    away, at = tree.query(xyz, distance_upper_bound=reach, workers=-1)
    met = np.isfinite(away)
    if met.sum() < tuning.least_points:
        raise ValueError(
            f"only {met.sum()} of {len(xyz)} points lie within {reach:.3g} m of the other cloud: they do not overlap, "
            "or stand too far apart for a fine registration"
        )
    n, from_middle = normal[at[met]], xyz[met] - middle
    residual = np.einsum("ij,ij->i", n, np.asarray(tree.data)[at[met]] - xyz[met])
    sigma = robust_sigma(residual - np.median(residual)) + 1e-12
    weight = np.square(np.clip(1 - np.square(residual / (_TUKEY * sigma)), 0, None))
    growth = np.einsum("ij,ij->i", n, from_middle)
    design = np.column_stack([np.cross(from_middle, n), n, growth])[:, : len(unit)] * unit
    cell = np.floor(from_middle * (_CELLS / np.ptp(from_middle, axis=0).max())).astype(int)
    part = cell @ (1, 3, 7) % _PARTS
    rows = [(weight[:, None] * design)[part == k] for k in range(_PARTS)]
    matrix = np.array([rows[k].T @ design[part == k] for k in range(_PARTS)])
    vector = np.array([rows[k].T @ residual[part == k] for k in range(_PARTS)])
    values, axes = np.linalg.eigh(matrix.sum(axis=0))
    if values[0] < _OPEN_SHARE * values[-1]:
        loose = _NAMES[int(np.argmax(np.abs(axes[:, 0])))]
        raise ValueError(f"the surfaces do not tell {loose}: they slide along each other; compare without registration")
    return _Equations(matrix=matrix, vector=vector, sigma=sigma, share=float(met.mean()))
