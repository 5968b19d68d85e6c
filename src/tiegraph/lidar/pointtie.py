"""The run's world laid on the LiDAR's by points: those of the run against surfaces of the map."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import CAUCHY_SIGMAS, Similarity, robust_sigma
from tiegraph.lidar.odometry import first_of_voxels, voxel_keys


@dataclass(frozen=True)
class PointTie:
    """``lidar_from_run``; sigmas of a place in the middle of the map (m) and of a turn (degrees), the largest of any
    direction, and of the scale; points that agree, and their RMS distance (m)."""

    lidar_from_run: Similarity
    place_sigma_m: float
    turn_sigma_deg: float
    scale_sigma: float
    points: int
    rms_m: float


def tie_by_points(points: np.ndarray, surface: np.ndarray, start: Similarity) -> PointTie | None:
    """Points (M, 3) of a run against the map (G, 3), point to plane, with scale, from a start; None where fewer than
    200 agree or a direction stays open."""
    middle, normal = _surfaces(surface)
    if not len(middle):
        return None
    tree = cKDTree(middle)
    fit, centre = start, np.median(middle, axis=0)
    rows = np.zeros(0, int)
    for reach in (1.0, 0.5, 0.3, 0.15, 0.1):  # m; at last within four sigmas of both sides' points
        for _ in range(10):
            at = fit(points)
            distance, near = tree.query(at, distance_upper_bound=reach)
            rows = np.flatnonzero(np.isfinite(distance))
            if len(rows) < 200:
                return None
            away, axis = at[rows] - centre, normal[near[rows]]
            residual = np.einsum("ni,ni->n", at[rows] - middle[near[rows]], axis)
            sigma = max(robust_sigma(residual), 0.005)
            weight = 1 / (1 + (residual / (CAUCHY_SIGMAS * sigma)) ** 2)
            slope = np.column_stack([np.cross(away, axis), axis, np.einsum("ni,ni->n", away, axis)])
            matrix = slope.T @ (slope * weight[:, None])
            if np.linalg.eigvalsh(matrix[3:6, 3:6]).min() < 0.002 * weight.sum():  # normals face it by their noise only
                return None
            step = -np.linalg.solve(matrix, slope.T @ (weight * residual))
            turn, grow = Rotation.from_rotvec(step[:3]).as_matrix(), 1 + step[6]
            shift = grow * turn @ (fit.translation - centre) + centre + step[3:6]
            fit = Similarity(fit.scale * grow, turn @ fit.rotation, shift)
            if np.abs(step).max() < 1e-5:  # m or rad
                break
    # A sandwich: points within a metre err together, as edges and texture make them.
    _, cluster = np.unique(voxel_keys(fit(points[rows]), 1.0), return_inverse=True)
    sums = np.stack([np.bincount(cluster, column) for column in (slope * (weight * residual)[:, None]).T], axis=1)
    inverse = np.linalg.inv(matrix)
    covariance = inverse @ (sums.T @ sums) @ inverse
    return PointTie(
        lidar_from_run=fit,
        place_sigma_m=float(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6]).max())),
        turn_sigma_deg=float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]).max()))),
        scale_sigma=float(fit.scale * np.sqrt(covariance[6, 6])),
        points=len(rows),
        rms_m=float(np.sqrt(np.average(residual**2, weights=weight))),
    )


def _surfaces(surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles and normals (K, 3) of the map where it is flat about a point."""
    picked, neighbours = surface[first_of_voxels(surface, 0.2)] if len(surface) else surface, 24
    if len(picked) < neighbours:
        return np.zeros((0, 3)), np.zeros((0, 3))
    distance, near = cKDTree(surface).query(picked, k=neighbours)
    around = surface[near]
    middle = around.mean(axis=1)
    away = around - middle[:, None]
    values, axes = np.linalg.eigh(np.swapaxes(away, 1, 2) @ away / neighbours)
    flat = (values[:, 0] < 0.1 * values[:, 1]) & (values[:, 1] > 0.05 * values[:, 2])
    flat &= (distance[:, -1] < 0.8) & (values[:, 0] < 0.05**2)
    return middle[flat], axes[flat, :, 0]
