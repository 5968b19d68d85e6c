"""Trajectory of a scanner by kiss-icp, the map of its scans in bounded memory, and scans adjusted together by planes.

Odometry matches points with points. Rings of a scanner on a wall then hold each other, and turns about the axis of
travel are seen too small (on `canal` by 1.7 degrees). So the points of a window of scans are gathered in voxels; where
they are flat they are a plane, and poses and planes are adjusted for the least distances between points and planes, as
Liu and Zhang (BALM, 2021) and Zhou et al. (plane adjustment, 2021) do. The points of a scan on a plane enter by their
moments, so that a step costs by planes and not by points; planes are eliminated first (Schur complement).

The world of a run is laid on that of the map by points of the run against surfaces of the map.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError, ReconstructionError, optional
from tiegraph.geometry.transforms import CAUCHY_SIGMAS, Similarity, robust_sigma
from tiegraph.lidar.scans import LEAST_POINTS, Scan
from tiegraph.lidar.tuning import AdjustTuning
from tiegraph.scene.results import Cloud
from tiegraph.scene.sorting import row_numbers


@dataclass(frozen=True)
class ThinScan:
    """What is kept of a scan: the time of its pose, which is that of its last point; the pose by odometry (4, 4);
    points (N, 3) f4 as they were measured, and how long before the pose (N,) f4 s, <= 0, None = not known."""

    time_s: float
    pose: np.ndarray
    xyz_m: np.ndarray
    before_s: np.ndarray | None


def before_pose(scan: Scan) -> tuple[float, np.ndarray | None]:
    """Time of a scan's pose, and of its points from it (N,) <= 0."""
    if scan.offset_s is None or not np.ptp(scan.offset_s) > 0:
        return scan.stamp_s, None
    last = float(scan.offset_s.max())
    return scan.stamp_s + last, scan.offset_s - last


def odometry(scans: Iterator[Scan], near_m: float, far_m: float) -> Iterator[ThinScan]:
    """Each scan with its pose in the frame of the first one.

    kiss-icp (Vizzo et al. 2023), on one thread, so that equal scans make equal poses. Raises EngineMissing without it,
    InputError for scans without points between the ranges, ReconstructionError where it loses its way.
    """
    engine = _engine(far_m)
    for scan in scans:
        reach = np.linalg.norm(scan.xyz_m, axis=1)
        seen = (reach >= near_m) & (reach <= far_m)
        if seen.sum() < LEAST_POINTS:
            raise InputError(
                f"{scan.name}: {int(seen.sum())} points between {near_m:g} and {far_m:g} m (--near-m, --far-m), "
                f"{LEAST_POINTS} are needed; the nearest is {reach.min():.3g} m away, the furthest "
                f"{reach.max():.3g} m"
            )
        time_s, before = before_pose(scan)
        xyz, before = scan.xyz_m[seen], None if before is None else before[seen]
        engine.register_frame(xyz, np.zeros(0) if before is None else before)
        pose = np.array(engine.last_pose)
        if not np.isfinite(pose).all():
            raise ReconstructionError(f"{scan.name}: kiss-icp lost its way here: are the scans of one place, in order?")
        close = np.flatnonzero(reach[seen] <= 60.0)  # points further away are sparse, and their spots wide
        kept = close[first_of_voxels(xyz[close], 0.1)] if len(close) else close
        before_s = None if before is None else before[kept].astype(np.float32)
        yield ThinScan(time_s, pose, xyz[kept].astype(np.float32), before_s=before_s)


def _engine(far_m: float) -> Any:
    kiss_icp = optional("kiss_icp.kiss_icp", "lidar", "LiDAR odometry")
    config = import_module("kiss_icp.config").KISSConfig()
    config.data.max_range, config.data.min_range, config.data.deskew = far_m, 0.0, True
    config.mapping.voxel_size = far_m / 100  # kiss-icp's own default
    config.registration.max_num_threads = 1
    return kiss_icp.KissICP(config)


_MOST_POINTS = 20_000_000  # voxels held: 1 GiB
_BATCH_POINTS = 2_000_000  # gathered before they are merged


class MapCloud:
    """Points are added scan by scan, and merged from time to time; the voxel grows where they become too many."""

    def __init__(self, voxel_m: float) -> None:
        self.voxel_m = voxel_m
        self._sums: np.ndarray = np.zeros((0, 4))  # x, y, z, number
        self._waiting: list[np.ndarray] = []
        self._count = 0

    def add(self, xyz: np.ndarray) -> None:
        """Points (N, 3) in the world."""
        self._waiting.append(np.column_stack([xyz, np.ones(len(xyz))]))
        self._count += len(xyz)
        if self._count > _BATCH_POINTS:
            self._merge()

    def cloud(self) -> Cloud:
        """The map, sorted by voxel; ``views``: points behind each, 255 at most."""
        self._merge()
        number = self._sums[:, 3:]
        missing = np.full((len(number), 3), np.nan, np.float32)
        return Cloud(
            xyz_m=self._sums[:, :3] / np.maximum(number, 1),
            rgb=np.full((len(number), 3), 128, np.uint8),
            normal=missing,
            sigma_m=missing[:, 0],
            views=np.minimum(number[:, 0], 255).astype(np.uint8),
        )

    def _merge(self) -> None:
        rows = np.concatenate([self._sums, *self._waiting])
        self._waiting, self._count = [], 0
        self._gather(rows)
        while len(self._sums) > _MOST_POINTS:
            self.voxel_m *= 1.5
            self._gather(self._sums)

    def _gather(self, rows: np.ndarray) -> None:
        group = np.unique(voxel_keys(rows[:, :3] / np.maximum(rows[:, 3:], 1), self.voxel_m), return_inverse=True)[1]
        self._sums = np.stack([np.bincount(group, rows[:, k]) for k in range(4)], axis=1)


_DAMPING = 1e-6  # of the normal equations, relative


def adjusted(scans: Iterable[ThinScan], tuning: AdjustTuning) -> Iterator[np.ndarray]:
    """Pose (4, 4) of each scan in turn, in windows over each other; the memory is that of a window."""
    window: list[ThinScan] = []
    poses: list[np.ndarray] = []
    held = 0
    for scan in scans:
        before = window[-1].pose if window else scan.pose
        poses.append(poses[-1] @ np.linalg.inv(before) @ scan.pose if poses else scan.pose)
        window.append(scan)
        if len(window) == tuning.window:
            poses = list(adjust(window, np.array(poses), held or 1, tuning))
            held = len(window) - len(window) // 2
            done = len(window) - held
            yield from poses[:done]
            window, poses = window[done:], poses[done:]
    if len(window) > max(held, 1):
        poses = list(adjust(window, np.array(poses), held or 1, tuning))
    yield from poses


def adjust(scans: list[ThinScan], poses: np.ndarray, held: int, tuning: AdjustTuning) -> np.ndarray:
    """Poses (T, 4, 4) of T scans after adjustment; the first ``held`` stay as they are."""
    time_s = np.array([s.time_s for s in scans])
    for side_m, thick_m in tuning.stages:
        rate = velocities(time_s, poses)
        seen = [deskew(s.xyz_m.astype(float), s.before_s, v) for s, v in zip(scans, rate)]
        for _ in range(2):  # the voxels of the next stage tell more than a third step
            before, poses = poses, _step(seen, poses, held, (side_m, thick_m), tuning.sigma_m)
            if np.abs(poses - before).max() < 1e-4:  # m or rad
                break
    return poses


_Four = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _step(
    seen: list[np.ndarray], poses: np.ndarray, held: int, stage: tuple[float, float], sigma_m: float
) -> np.ndarray:
    """One step of Gauss-Newton; poses as they were where no plane is seen twice."""
    scan = np.repeat(np.arange(len(seen)), [len(x) for x in seen])
    xyz = np.concatenate(seen)
    world = np.einsum("nij,nj->ni", poses[scan, :3, :3], xyz) + poses[scan, :3, 3]
    middle, axes, plane, row = _find_planes(world, scan, stage, sigma_m)
    if not len(middle):
        return poses
    step = _solve(_moments(xyz[row], scan[row], plane), (middle, axes), poses, held, sigma_m)
    out = poses.copy()
    out[held:, :3, :3] = Rotation.from_rotvec(step[:, :3]).as_matrix() @ poses[held:, :3, :3]
    out[held:, :3, 3] += step[:, 3:]
    return out


def _find_planes(world: np.ndarray, scan: np.ndarray, stage: tuple[float, float], sigma_m: float) -> _Four:
    """Flat voxels that two scans at least have points in: middle (L, 3) of their points and axes (L, 3, 3), columns:
    normal, then two along the plane; of the P points on one: its plane and its row."""
    side_m, thick_m = stage
    _, voxel = np.unique(voxel_keys(world, side_m), return_inverse=True)
    _, middle, spread, axes = _scatter(world, voxel, np.ones(len(world), bool))
    off = np.abs(np.einsum("ni,ni->n", world - middle[voxel], axes[voxel, :, 0]))
    near = off < 3 * np.sqrt(np.maximum(spread[:, 0], sigma_m**2))[voxel]
    count, middle, spread, axes = _scatter(world, voxel, near)
    several = np.bincount(np.unique(voxel[near] * (scan[-1] + 1) + scan[near]) // (scan[-1] + 1), minlength=len(count))
    good = (
        (count >= 12)
        & (several >= 2)
        & (spread[:, 0] < thick_m**2)
        & (spread[:, 0] < 0.04 * spread[:, 1])
        & (spread[:, 1] > (0.08 * side_m) ** 2)  # a single ring is a line
    )
    number = np.cumsum(good) - 1
    row = np.flatnonzero(near & good[voxel])
    return middle[good], axes[good], number[voxel[row]], row


def _scatter(world: np.ndarray, voxel: np.ndarray, taken: np.ndarray) -> _Four:
    """Of V voxels, by the points (N, 3) taken (N,) bool and their voxels (N,): number of points (V,), mean (V, 3),
    eigenvalues of the scatter (V, 3), growing, and its axes (V, 3, 3), columns."""
    cells, voxel, world = int(voxel.max()) + 1, voxel[taken], world[taken]
    count = np.bincount(voxel, minlength=cells)
    some = np.maximum(count, 1)[:, None]
    middle = np.stack([np.bincount(voxel, world[:, k], cells) for k in range(3)], axis=1) / some
    away = world - middle[voxel]
    spread = _second_moments(away, voxel, cells) / some[:, None]
    values, axes = np.linalg.eigh(spread)
    return count, middle, values, axes


def _second_moments(rows: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """(groups, D, D) sums of outer products of rows (N, D)."""
    width = rows.shape[1]
    out = np.empty((groups, width, width))
    for a in range(width):
        for b in range(a, width):
            out[:, a, b] = out[:, b, a] = np.bincount(group, rows[:, a] * rows[:, b], groups)
    return out


def _moments(xyz: np.ndarray, scan: np.ndarray, plane: np.ndarray) -> _Four:
    """G scans on planes: plane (G,), scan (G,), number of points (G,), and four rows (G, 4, 4) whose squared distances
    from any plane add up to those of the points (the root of their moments), in the scan's frame."""
    scans = int(scan.max()) + 1
    both, group = np.unique(plane * scans + scan, return_inverse=True)
    moments = _second_moments(np.column_stack([xyz, np.ones(len(xyz))]), group, len(both))
    values, vectors = np.linalg.eigh(moments)
    rows = np.sqrt(np.maximum(values, 0))[:, :, None] * np.swapaxes(vectors, 1, 2)
    return both // scans, both % scans, np.bincount(group), rows


def _solve(
    moments: _Four, planes: tuple[np.ndarray, np.ndarray], poses: np.ndarray, held: int, sigma_m: float
) -> np.ndarray:
    """(T - held, 6) turn about the world's axes and shift of each free pose."""
    plane, scan, number, rows = moments
    middle, axes = (of[plane] for of in planes)
    normal, weight = axes[:, :, 0], rows[:, :, 3:]
    turned = rows[:, :, :3] @ np.swapaxes(poses[scan, :3, :3], 1, 2)
    placed = turned + weight * (poses[scan, :3, 3] - middle)[:, None]
    residual = np.einsum("gki,gi->gk", placed, normal)
    rms = np.sqrt(np.sum(residual**2, axis=1) / number)
    scale = 1 / np.sqrt(1 + (rms / (2 * sigma_m)) ** 2)  # Cauchy's weight: voxels that are two surfaces
    by_pose = np.concatenate([np.cross(turned, normal[:, None]), weight * normal[:, None]], axis=2)
    by_plane = np.concatenate([placed @ axes[:, :, 1:], weight], axis=2)
    by_pose, by_plane, residual = (scale[:, None, None] * m for m in (by_pose, by_plane, residual[:, :, None]))
    free = scan >= held
    pose = (scan - held)[free]
    size, count = len(poses) - held, len(planes[0])
    of_plane = _summed(np.swapaxes(by_plane, 1, 2) @ by_plane, plane, count)
    trace = np.trace(of_plane, axis1=1, axis2=2)[:, None, None]
    inverse = np.linalg.inv(of_plane + (_DAMPING * trace + _DAMPING) * np.eye(3))
    pull = _summed(np.swapaxes(by_plane, 1, 2) @ residual, plane, count)[:, :, 0]
    cross, met = np.swapaxes(by_pose[free], 1, 2) @ by_plane[free], plane[free]
    tied = _blocks(cross, pose, met, (size, count))
    solved = _blocks(cross @ inverse[met], pose, met, (size, count))
    matrix = -solved @ tied.T
    own = _summed(np.swapaxes(by_pose[free], 1, 2) @ by_pose[free], pose, size)
    for k in range(size):
        matrix[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += own[k]
    right = _summed(np.swapaxes(by_pose[free], 1, 2) @ residual[free], pose, size).ravel() - solved @ pull.ravel()
    matrix += np.diag(_DAMPING * (1 + np.diag(matrix)))
    return -np.linalg.solve(matrix, right).reshape(size, 6)


def _summed(blocks: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """(groups, ...) sums of blocks (G, ...) by group."""
    flat = blocks.reshape(len(blocks), -1)
    sums = [np.bincount(group, flat[:, k], groups) for k in range(flat.shape[1])]
    return np.stack(sums, axis=1).reshape(groups, *blocks.shape[1:])


def _blocks(blocks: np.ndarray, row: np.ndarray, column: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A matrix of blocks (G, H, W) at rows and columns of blocks; dense, which is multiplied faster."""
    _, height, width = blocks.shape
    out = np.zeros((shape[0], height, shape[1], width))
    out[row, :, column, :] = blocks
    return out.reshape(shape[0] * height, shape[1] * width)


def deskew(xyz: np.ndarray, before_s: np.ndarray | None, velocity: np.ndarray) -> np.ndarray:
    """Points (N, 3) as the scanner sees them at the instant of the pose; ``before_s`` (N,) <= 0 from it, None: as they
    are. ``velocity`` (6,) in the scanner's axes: turn (rad/s), then m/s, constant over the scan."""
    if before_s is None:
        return xyz
    turned = Rotation.from_rotvec(before_s[:, None] * velocity[:3]).apply(xyz)
    return turned + before_s[:, None] * velocity[3:]


def velocities(time_s: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """(T, 6) of poses (T, 4, 4) at growing times, from the one before; of the first from the one behind."""
    step = np.linalg.inv(poses[:-1]) @ poses[1:]
    rate = np.hstack([Rotation.from_matrix(step[:, :3, :3]).as_rotvec(), step[:, :3, 3]])
    rate /= np.diff(time_s)[:, None]
    return np.vstack([rate[:1], rate])


def first_of_voxels(xyz: np.ndarray, size: float) -> np.ndarray:
    """Rows of the first point in each voxel, in order."""
    return np.sort(np.unique(voxel_keys(xyz, size), return_index=True)[1])


def voxel_keys(xyz: np.ndarray, size: float) -> np.ndarray:
    """(N,) i8: equal for points (N, 3) in one voxel of this side."""
    return row_numbers(np.floor(xyz / size).astype(np.int64).T)


# ---------------------------------------------------------------- its world and that of a run


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
            fit = fit.stepped(step, centre)
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
