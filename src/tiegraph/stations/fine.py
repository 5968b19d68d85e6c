"""A start refined by small_gicp, coarse to fine, and what can be said of the result."""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.align import rms_length
from tiegraph.stations.station import Level, engine
from tiegraph.stations.tuning import PairTuning

_TURN, _SHIFT = 1e-6, 1e-5  # rad and voxels: GICP has converged


@dataclass(frozen=True)
class Met:
    """Points of one level that lie on the surface of another: rows of the source and the target (M,), residuals (M,)
    along the target's normals, metres; and the share of either cloud, the larger."""

    source: np.ndarray
    target: np.ndarray
    residual_m: np.ndarray
    overlap: float

    @property
    def sigma_m(self) -> float:
        """Robust sigma of the residuals."""
        return 1.4826 * float(np.median(np.abs(self.residual_m))) if len(self.residual_m) else np.inf

    def agree(self, limit_m: float) -> float:
        """The overlap that agrees to within a limit."""
        return self.overlap * float(np.mean(np.abs(self.residual_m) < limit_m)) if len(self.residual_m) else 0.0


def refined(target: Level, source: Level, start: np.ndarray, tuning: PairTuning) -> np.ndarray:
    """target_from_source (4, 4) after GICP from a start."""
    scaled = start.copy()
    scaled[:3, 3] /= target.side
    found = engine().align(
        target.gicp,
        source.gicp,
        target.gicp_tree,
        scaled,
        registration_type="GICP",
        max_correspondence_distance=tuning.reach,
        num_threads=1,
        max_iterations=tuning.iterations,
        rotation_epsilon=_TURN,
        translation_epsilon=_SHIFT,
    )
    fit = np.array(found.T_target_source)
    fit[:3, 3] *= target.side
    return fit


def met(target: Level, source: Level, fit: np.ndarray, tuning: PairTuning) -> Met:
    """Which points of the source lie on the target."""
    moved = transforms.apply(fit, source.xyz)
    reach = tuning.meet * target.side
    away, at = target.tree.query(moved, distance_upper_bound=reach)
    near = np.flatnonzero(np.isfinite(away))
    turned = source.normal[near] @ fit[:3, :3].T
    alike = np.abs(np.einsum("ij,ij->i", turned, target.normal[at[near]])) > np.cos(np.radians(tuning.normal_deg))
    rows, planes = near[alike], at[near[alike]]
    residual = np.einsum("ij,ij->i", target.normal[planes], target.xyz[planes] - moved[rows])
    back = transforms.apply(transforms.invert(fit), target.xyz)
    other = float(np.isfinite(source.tree.query(back, distance_upper_bound=reach)[0]).mean()) if len(rows) else 0.0
    share = len(rows) / len(source.xyz)
    overlap = max(share, min(other, share * len(source.xyz) / len(target.xyz)))
    return Met(source=rows, target=planes, residual_m=residual, overlap=overlap)


@dataclass(frozen=True)
class Held:
    """How well the surfaces hold a fit: ``information`` (6, 6) of turn (rad) and shift (m) about ``middle`` (3,) in the
    target's frame, and smallest over largest eigenvalue of the equations, all unknowns in metres of motion."""

    middle: np.ndarray
    information: np.ndarray
    open_share: float


def held(target: Level, source: Level, fit: np.ndarray, found: Met, tuning: PairTuning) -> Held:
    """By the equations of points against planes; points of a cell err together (a sandwich of clusters)."""
    xyz = transforms.apply(fit, source.xyz[found.source])
    normal = target.normal[found.target]
    middle = xyz.mean(axis=0)
    from_middle = xyz - middle
    extent = rms_length(from_middle)
    design = np.column_stack([np.cross(from_middle, normal) / extent, normal])
    keep = np.abs(found.residual_m) < 3 * found.sigma_m
    design, residual, from_middle = design[keep], found.residual_m[keep], from_middle[keep]
    matrix = design.T @ design
    values = np.linalg.eigvalsh(matrix)
    side = np.ptp(from_middle, axis=0).max() / tuning.cells
    _, cell = np.unique(np.floor(from_middle / side).astype(int), axis=0, return_inverse=True)
    pull = np.zeros((cell.max() + 1, 6))
    np.add.at(pull, cell.ravel(), design * (residual - residual.mean())[:, None])
    inverse = np.linalg.pinv(matrix)
    formal = inverse * found.sigma_m**2
    unit = np.r_[np.full(3, 1 / extent), np.ones(3)]
    covariance = (inverse @ (pull.T @ pull) @ inverse + formal) * np.outer(unit, unit)
    return Held(middle, np.linalg.inv(covariance), float(values[0] / values[-1]))
