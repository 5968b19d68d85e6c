"""True overlap of every two images, and which of them exhaustive matching at full resolution verified.

Overlap of (i, j) is the larger of two shares: of the surface that i sees, what j sees too, and the other way round.
Rendered sets bring it; elsewhere reference points (LiDAR, or points intersected from true poses) are projected into
every image with a depth buffer.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from benchmarks.datasets import Dataset
from tiegraph.errors import InputError
from tiegraph.geometry import transforms

DENSE_COLUMNS, DENSE_TOLERANCE = 160, 0.05  # of the depth buffer of a LiDAR cloud; share of the depth
SPARSE_COLUMNS, SPARSE_TOLERANCE = 40, 0.25  # the same for points of matched features
SAMPLES = 1500  # surface points an image is represented by
VERIFIED = 15  # COLMAP's own least number of inliers
_MAX_IMAGES = 2147483647  # COLMAP: pair_id = this * smaller image_id + larger image_id
_MAX_POINTS = 400_000
_MIN_ANGLE_DEG, _MAX_ERROR_PX = 1.5, 2.0  # of intersected points


def true_overlap(dataset: Dataset, names: Sequence[str], database: Path | None) -> np.ndarray:
    """(N, N) f4 overlap of images by name, 0 on the diagonal. ``database``: COLMAP's, for sets without surface.

    Raises InputError for a set whose poses or surface nobody knows.
    """
    table = dataset.images.parent / "gt" / "covisibility.npz"
    if table.exists():
        return _of_table(table, names)
    poses = np.stack([dataset.cam_from_world[n] for n in names])
    if np.isnan(poses).any() or not dataset.cameras:
        raise InputError(f"data set {dataset.name!r}: the overlap cannot be known without true poses and calibration")
    cameras = [dataset.cameras[n.rpartition("/")[0]] for n in names]
    if dataset.reference_cloud is not None:
        points = reference_points(dataset.reference_cloud)
        return surface_overlap(poses, cameras, points, DENSE_COLUMNS, DENSE_TOLERANCE)
    if database is None:
        raise InputError(
            f"data set {dataset.name!r} has no reference surface: give the database of exhaustive matching"
        )
    points = intersected_points(database, dict(zip(names, zip(poses, cameras))))
    return surface_overlap(poses, cameras, points, SPARSE_COLUMNS, SPARSE_TOLERANCE)


def _of_table(path: Path, names: Sequence[str]) -> np.ndarray:
    with np.load(path) as data:
        place = {str(n): k for k, n in enumerate(data["names"])}
        rows = np.array([place[n] for n in names])
        share = np.nan_to_num(data["overlap"].astype(np.float32))[np.ix_(rows, rows)]
    share = np.maximum(share, share.T)
    np.fill_diagonal(share, 0)
    return share


def reference_points(path: Path) -> np.ndarray:
    """Points (P, 3) metres of a reference cloud: LAS/LAZ, or PandaSet's npz of whole centimetres."""
    if path.suffix == ".npz":
        with np.load(path) as data:
            key = next(k for k in data if k.startswith("xyz"))
            points = data[key].astype(np.float64) * (0.01 if key.endswith("cm") else 1.0)
    else:
        import laspy

        points = np.asarray(laspy.read(path).xyz)
    return _thinned(points)


def _thinned(points: np.ndarray) -> np.ndarray:
    rows = np.random.default_rng(0).permutation(len(points))[:_MAX_POINTS]
    return points[np.sort(rows)]


# ---------------------------------------------------------------------------------------------- depth buffers


@dataclass(frozen=True)
class _Buffer:
    """Nearest depth of each cell (R, C), inf = none, and the points seen: one a cell, at most SAMPLES of them."""

    depth: np.ndarray
    points: np.ndarray  # (K, 3) world


def surface_overlap(
    cam_from_world: np.ndarray, cameras: Sequence[pycolmap.Camera], points: np.ndarray, columns: int, tolerance: float
) -> np.ndarray:
    """(N, N) f4 overlap of images with poses (N, 4, 4) from surface points (P, 3).

    Each image is a grid of ``columns`` cells across with the depth of its nearest point; its surface is the nearest
    point of each cell (so that shares are shares of pixels). Image j sees a point of i that falls into it at a depth no
    more than ``tolerance`` (share) behind that of its own cell.
    """
    buffers = [_buffer(pose, camera, points, columns, tolerance) for pose, camera in zip(cam_from_world, cameras)]
    owner = np.repeat(np.arange(len(buffers)), [len(b.points) for b in buffers])
    everything = np.concatenate([np.zeros((0, 3)), *(b.points for b in buffers)])
    total = np.maximum(np.bincount(owner, minlength=len(buffers)), 1)
    share = np.zeros((len(buffers), len(buffers)), np.float32)
    for j, buffer in enumerate(buffers):
        rows, row, column, depth = _cells(cam_from_world[j], cameras[j], everything, columns)
        seen = rows[depth <= (1 + tolerance) * buffer.depth[row, column]]
        share[:, j] = np.bincount(owner[seen], minlength=len(buffers)) / total
    share = np.maximum(share, share.T)
    np.fill_diagonal(share, 0)
    return share


def _cells(
    cam_from_world: np.ndarray, camera: pycolmap.Camera, points: np.ndarray, columns: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points inside an image: their rows (K,), grid rows (K,), grid columns (K,), depths (K,)."""
    local = points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    front = np.flatnonzero(local[:, 2] > 1e-3 * np.abs(local).max(axis=1))
    k = camera.calibration_matrix()
    xy = local[front, :2] / local[front, 2:] * (k[0, 0], k[1, 1]) + (k[0, 2], k[1, 2])
    inside = (xy >= 0).all(axis=1) & (xy < (camera.width, camera.height)).all(axis=1)
    front, cell = front[inside], (xy[inside] * columns / camera.width).astype(int)
    return front, cell[:, 1], cell[:, 0], local[front, 2]


def _buffer(
    cam_from_world: np.ndarray, camera: pycolmap.Camera, points: np.ndarray, columns: int, tolerance: float
) -> _Buffer:
    rows, row, column, depth = _cells(cam_from_world, camera, points, columns)
    shape = (-(-camera.height * columns // camera.width) + 1, columns + 1)
    nearest = np.full(shape, np.inf)
    np.minimum.at(nearest, (row, column), depth)
    # Points scatter: a hole between near points must not show what lies behind them.
    closed = nearest.copy()
    for axis in (0, 1):
        closed = np.minimum(closed, _narrowest(closed, axis))
    order = np.argsort(depth, kind="stable")
    order = order[depth[order] <= (1 + tolerance) * closed[row[order], column[order]]]
    first = np.unique(row[order] * shape[1] + column[order], return_index=True)[1]
    own = rows[order[first]]
    keep = np.random.default_rng(0).permutation(len(own))[:SAMPLES]
    return _Buffer(closed, points[own[np.sort(keep)]])


def _narrowest(depth: np.ndarray, axis: int) -> np.ndarray:
    """The larger of the two neighbours along an axis: what a cell between two near ones is closed with."""
    before, after = np.roll(depth, 1, axis), np.roll(depth, -1, axis)
    return np.maximum(before, after)


# ---------------------------------------------------------------------------------------------- COLMAP's database


def verified_pairs(database: Path, names: Sequence[str], least: int = VERIFIED) -> np.ndarray:
    """(N, N) bool: image pairs with at least ``least`` inliers in a database, symmetric. Raises InputError for one
    that lacks images of ``names``."""
    place = {n: k for k, n in enumerate(names)}
    with _opened(database) as rows:
        ids = dict(rows.execute("SELECT image_id, name FROM images"))
        found = rows.execute("SELECT pair_id FROM two_view_geometries WHERE rows >= ?", (least,)).fetchall()
    lost = set(names) - set(ids.values())
    if lost:
        raise InputError(f"{database}: {len(lost)} images are not in it, for instance {min(lost)}")
    out = np.zeros((len(names), len(names)), bool)
    for (key,) in found:
        a, b = ids[key // _MAX_IMAGES], ids[key % _MAX_IMAGES]
        if a in place and b in place:
            out[place[a], place[b]] = out[place[b], place[a]] = True
    return out


def _opened(database: Path) -> sqlite3.Connection:
    if not database.exists():
        raise InputError(f"no database {database}")
    return sqlite3.connect(f"file:{database.resolve()}?mode=ro", uri=True)


def intersected_points(database: Path, posed: Mapping[str, tuple[np.ndarray, pycolmap.Camera]]) -> np.ndarray:
    """Points (P, 3) intersected from the verified matches of a database with true poses and cameras by image name:
    those seen under 1.5 degrees or more that meet both images within 2 pixels, in front of both."""
    with _opened(database) as rows:
        ids = dict(rows.execute("SELECT image_id, name FROM images"))
        keypoints = {
            ids[k]: np.frombuffer(data, np.float32).reshape(n, c)[:, :2].astype(np.float64)
            for k, n, c, data in rows.execute("SELECT image_id, rows, cols, data FROM keypoints")
        }
        parts = [np.zeros((0, 3))]
        for key, data in rows.execute("SELECT pair_id, data FROM two_view_geometries WHERE rows >= ?", (VERIFIED,)):
            a, b = ids[key // _MAX_IMAGES], ids[key % _MAX_IMAGES]
            if a in posed and b in posed:
                matches = np.frombuffer(data, np.uint32).reshape(-1, 2)
                parts.append(_intersected(posed[a], posed[b], keypoints[a][matches[:, 0]], keypoints[b][matches[:, 1]]))
    return _thinned(np.concatenate(parts))


def _intersected(
    a: tuple[np.ndarray, pycolmap.Camera], b: tuple[np.ndarray, pycolmap.Camera], xy_a: np.ndarray, xy_b: np.ndarray
) -> np.ndarray:
    """Midpoints (K, 3) of the rays through pixels (M, 2), (M, 2) that pass the tests."""
    centre, ray = zip(*(_rays(pose, camera, xy) for (pose, camera), xy in ((a, xy_a), (b, xy_b))))
    cosine = np.sum(ray[0] * ray[1], axis=1)
    sine2 = 1 - cosine**2
    wide = sine2 > np.sin(np.radians(_MIN_ANGLE_DEG)) ** 2
    base = centre[1] - centre[0]
    along = [ray[0] @ base, ray[1] @ base]
    far_a = (along[0] - cosine * along[1])[wide] / sine2[wide]
    far_b = (cosine * along[0] - along[1])[wide] / sine2[wide]
    points = 0.5 * (centre[0] + far_a[:, None] * ray[0][wide] + centre[1] + far_b[:, None] * ray[1][wide])
    good = (far_a > 0) & (far_b > 0)
    for (pose, camera), xy in ((a, xy_a), (b, xy_b)):
        local = points @ pose[:3, :3].T + pose[:3, 3]
        k = camera.calibration_matrix()
        with np.errstate(all="ignore"):
            error = local[:, :2] / local[:, 2:] * (k[0, 0], k[1, 1]) + (k[0, 2], k[1, 2]) - xy[wide]
            good &= np.linalg.norm(error, axis=1) < _MAX_ERROR_PX
    return points[good]


def _rays(pose: np.ndarray, camera: pycolmap.Camera, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k = camera.calibration_matrix()
    local = np.concatenate([(xy - (k[0, 2], k[1, 2])) / (k[0, 0], k[1, 1]), np.ones((len(xy), 1))], axis=1)
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    return transforms.centre(pose), local @ pose[:3, :3]
