"""How well the poses are known: of every frame with a pose, from all observations of all keyframes.

The points are eliminated from the normal equations of the keyframes, the first keyframe is held (and the first base
line's length, where nothing else has one). Corners that are followed err together along their track, which independent
errors would not show; so a pose gets the larger of the classical covariance and of the sandwich with points as clusters
(as in ``sfm.covariance``). A frame between keyframes adds its own resection to that of the keyframe it hangs on.

The derivatives of COLMAP's camera models are differences, so that every model has them.
"""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import robust_sigma, skew
from tiegraph.odometry.cameras import Cameras, Tracks
from tiegraph.odometry.worldmap import Observations, WorldMap

_BLOCK = 50  # keyframes solved for at once: bounds memory


def keyframe_covariances(world: WorldMap, numbers: Sequence[int], loss_px: float, metric: bool) -> np.ndarray:
    """(K, 6, 6) of keyframes of one world: position in it (units), turn about its axes (rad); zero of the first."""
    seen = world.observations(numbers)
    _, row, count = np.unique(seen.point, return_inverse=True, return_counts=True)
    seen = seen.where(~np.isnan(world.xyz[seen.point, 0]) & (count[row] >= 2))
    seen = seen.where(np.isfinite(world.errors_px(seen)))
    if len(numbers) < 2 or not len(seen.point):
        return np.full((len(numbers), 6, 6), np.nan)
    points, row = np.unique(seen.point, return_inverse=True)
    by_pose, by_point, residual = _jacobians(world, numbers, seen, row)
    weight = np.repeat(1 / (1 + np.sum(residual.reshape(-1, 2) ** 2, axis=1) / loss_px**2), 2)
    reduced, gradient = _eliminated(by_pose, by_point, weight, residual, row, len(points))
    rows, unknowns = len(residual), 6 * (len(numbers) - 1) + 3 * len(points)
    spread = robust_sigma(residual)
    variance = spread**2 * rows / max(rows - unknowns, 1)
    normal = (reduced + _gauge(world, numbers, reduced, metric)).tocsc()
    factor = splu(normal, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    out = np.zeros((len(numbers), 6, 6))
    for first in range(1, len(numbers), _BLOCK):
        own = range(first, min(first + _BLOCK, len(numbers)))
        sides = np.zeros((normal.shape[0], 6 * len(own)))
        sides[6 * first : 6 * (own[-1] + 1)] = np.eye(6 * len(own))
        solved = factor.solve(sides)
        pulled = gradient.T @ solved
        for k, number in enumerate(own):
            at = slice(6 * k, 6 * k + 6)
            classical = variance * solved[6 * number : 6 * number + 6, at]
            out[number] = wider(classical, pulled[:, at].T @ pulled[:, at])
    return out


def wider(classical: np.ndarray, clustered: np.ndarray) -> np.ndarray:
    """The classical covariance (6, 6), each sigma raised to that of the clustered one where that is larger."""
    ratio = np.diag(clustered) / np.maximum(np.diag(classical), 1e-300)
    root = np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(0.5 * (classical + classical.T) * np.outer(root, root))


def resection_covariance(
    cameras: Cameras, pose: np.ndarray, seen: Tracks, xyz: np.ndarray, loss_px: float
) -> np.ndarray:
    """(6, 6) as of a keyframe, of one frame's pose by points (K, 3) whose places are taken as known.

    Points that later adjustments moved behind a camera say nothing; NaN where fewer than three are left.
    """
    by_pose, _, residual = _derivatives(cameras, pose, seen.camera, seen.xy, xyz)
    known = np.isfinite(residual).all(axis=1) & np.isfinite(by_pose).all(axis=(1, 2))
    if known.sum() < 3:  # points that a pose has six unknowns from
        return np.full((6, 6), np.nan)
    by_pose, residual = by_pose[known], residual[known]
    weight = np.repeat(1 / (1 + np.sum(residual**2, axis=1) / loss_px**2), 2)
    rows = by_pose.reshape(-1, 6)
    spread = robust_sigma(residual)
    normal = rows.T @ (weight[:, None] * rows)
    return np.asarray(spread**2 * np.linalg.pinv(normal, rcond=1e-15))


def _derivatives(
    cameras: Cameras, pose: np.ndarray, camera: np.ndarray, xy: np.ndarray, xyz: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of K projections by the rig's position and turn in the world (K, 2, 6), by the point (K, 2, 3); residuals (K, 2).

    A rig that is moved by d and turned by w about the world's axes sees a point x as one at x - d - w x (x - c).
    """
    world_from_rig = transforms.invert(pose)
    by_point = np.empty((len(xy), 2, 3))
    centre = world_from_rig[:3, 3]
    step = 1e-6 * np.maximum(np.linalg.norm(xyz - centre, axis=1), 1e-9)  # of a difference, in distances of the point
    for axis in range(3):
        shift = np.zeros((len(xy), 3))
        shift[:, axis] = step
        ahead, behind = (cameras.project(camera, transforms.apply(pose, p)) for p in (xyz + shift, xyz - shift))
        by_point[:, :, axis] = (ahead - behind) / (2 * step[:, None])
    by_turn = by_point @ skew(xyz - centre)
    residual = xy - cameras.project(camera, transforms.apply(pose, xyz))
    return np.concatenate([-by_point, by_turn], axis=2), by_point, residual


def _jacobians(
    world: WorldMap, numbers: Sequence[int], seen: Observations, point: np.ndarray
) -> tuple[sparse.csr_matrix, sparse.csr_matrix, np.ndarray]:
    """Derivatives by keyframes (2M, 6K) and points (2M, 3P), their rows (M,), residuals (2M,)."""
    count = len(seen.point)
    poses, places, residual = np.empty((count, 2, 6)), np.empty((count, 2, 3)), np.empty((count, 2))
    for number in numbers:
        at = seen.keyframe == number
        pose = world.keyframes[number].rig_from_world
        poses[at], places[at], residual[at] = _derivatives(
            world.cameras, pose, seen.camera[at], seen.xy[at], world.xyz[seen.point[at]]
        )
    column = np.searchsorted(np.asarray(numbers), seen.keyframe)
    return _blocks(poses, column, len(numbers)), _blocks(places, point, int(point.max()) + 1), residual.ravel()


def _blocks(values: np.ndarray, column: np.ndarray, count: int) -> sparse.csr_matrix:
    """(2M, wK) of blocks (M, 2, w) that stand at block columns (M,)."""
    rows, width = len(values), values.shape[2]
    at = width * column[:, None, None] + np.arange(width)
    indices = np.broadcast_to(at, values.shape).ravel()
    pointer = np.arange(0, values.size + 1, width)
    return sparse.csr_matrix((values.ravel(), indices, pointer), shape=(2 * rows, width * count))


def _eliminated(
    by_pose: sparse.csr_matrix,
    by_point: sparse.csr_matrix,
    weight: np.ndarray,
    residual: np.ndarray,
    row: np.ndarray,
    points: int,
) -> tuple[sparse.spmatrix, sparse.spmatrix]:
    """Normal matrix (6K, 6K) without the points, and each point's share of its gradient (6K, P)."""
    weighted = sparse.diags(weight)
    own = (by_point.T @ weighted @ by_point).tobsr(blocksize=(3, 3))
    blocks = np.zeros((points, 3, 3))
    of = np.repeat(np.arange(points), np.diff(own.indptr))
    blocks[of] = own.data
    blocks += 1e-12 * np.trace(blocks, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse = sparse.bsr_matrix((np.linalg.inv(blocks), np.arange(points), np.arange(points + 1))).tocsr()
    cross = by_pose.T @ weighted @ by_point
    reduced = by_pose.T @ weighted @ by_pose - cross @ inverse @ cross.T
    pulls = sparse.csr_matrix(
        (weight * residual, (np.arange(len(residual)), np.repeat(row, 2))), shape=(len(residual), points)
    )
    by_own = by_point.T @ pulls
    return reduced, (by_pose.T @ pulls - cross @ inverse @ by_own).tocsr()


def _gauge(world: WorldMap, numbers: Sequence[int], normal: sparse.spmatrix, metric: bool) -> sparse.spmatrix:
    """What holds the first keyframe, and for a single camera the length of the first base line."""
    stiff = 1e12 * float(normal.diagonal().max())  # weight of what is held, over the largest of the normal matrix
    held = np.zeros(normal.shape[0])
    held[:6] = stiff
    out = sparse.diags(held).tolil()
    if not metric:
        centres = [transforms.centre(world.keyframes[n].rig_from_world) for n in numbers[:2]]
        way = centres[1] - centres[0]
        way /= max(float(np.linalg.norm(way)), 1e-12)
        out[6:9, 6:9] = stiff * 1e-6 * np.outer(way, way)
    return out.tocsr()
