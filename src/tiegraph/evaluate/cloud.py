"""Cloud against reference cloud: accuracy, completeness, F-score, ghosts (ETH3D and Tanks-and-Temples measures)."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.geometry.align import Similarity
from tiegraph.scene.results import Cloud, Metric

log = logging.getLogger(__name__)

_CHUNK = 500_000
MEANING = (
    "Both clouds are first thinned to one point a voxel ({voxel_m:g} m), so that dense patches do not outweigh thin "
    "ones. Accuracy: share of the cloud's points nearer than the distance to the reference, among the points inside "
    "the reference's outline (convex hull in plan) and height range. Completeness: share of the reference's points "
    "nearer than the distance to the cloud, among {counted}; whether a camera could see a point is not "
    "looked at. F = 2AC/(A+C). Ghosts: points inside the outline further than {ghost_m:g} m from the reference."
)


@dataclass(frozen=True)
class Criteria:
    """What a cloud was judged by, metres."""

    distances_m: tuple[float, ...]  # nearer is accurate, and complete
    ghost_m: float  # what is further from the reference is a ghost
    voxel_m: float  # one point of each
    range_m: float | None  # from a camera, that the reference counts in; None: all of it

    @property
    def meaning(self) -> str:
        """The definitions in words."""
        near = f"reference points within {self.range_m:g} m of a registered camera" if self.range_m else "all of them"
        return MEANING.format(voxel_m=self.voxel_m, counted=near, ghost_m=self.ghost_m)


@dataclass(frozen=True)
class JudgedPoints:
    """What was judged of the thinned clouds."""

    points: int  # of the cloud
    reference_points: int
    outside: float  # share of the cloud's points outside the reference's outline: not judged


@dataclass(frozen=True)
class CloudComparison:
    """Result of ``cloud_to_cloud``; shares are 0..1, one per distance; distances are cloud to reference, metres."""

    criteria: Criteria
    judged: JudgedPoints
    accuracy: tuple[float, ...]
    completeness: tuple[float, ...]
    fscore: tuple[float, ...]
    median_m: float
    p90_m: float
    ghosts: float

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        out = [
            Metric(name="cloud_to_cloud_median", value=self.median_m, unit="m", better="low"),
            Metric(name="cloud_to_cloud_90", value=self.p90_m, unit="m", better="low"),
            Metric(name="ghosts", value=100 * self.ghosts, unit="%", better="low", target=0.0),
        ]
        for d, f in zip(self.criteria.distances_m, self.fscore):
            out.append(Metric(name=f"fscore_{d:g}m", value=100 * f, unit="%", better="high", target=100.0))
        return out

    def tables(self) -> dict[str, dict]:
        """Tables for metrics.json."""
        columns = ["distance m", "accuracy %", "completeness %", "F %"]
        shares = zip(self.criteria.distances_m, self.accuracy, self.completeness, self.fscore)
        rows = [[d, 100 * a, 100 * c, 100 * f] for d, a, c, f in shares]
        return {"cloud against reference": {"columns": columns, "rows": rows}}


def cloud_to_cloud(
    cloud: np.ndarray | Cloud,
    reference: np.ndarray | Cloud,
    tuning: CloudTuning,
    distances_m: tuple[float, ...] = (0.02, 0.05, 0.10, 0.20),
    alignment: Similarity | None = None,
    cameras: np.ndarray | None = None,
    range_m: float = 50.0,
) -> CloudComparison:
    """Compare a cloud (M, 3) with a reference (G, 3), in the reference's frame and metres.

    ``alignment`` takes the cloud (and ``cameras`` (K, 3), projection centres in the cloud's frame) to the reference;
    it is not refined here. With cameras, completeness counts the reference within ``range_m`` of one of them.
    Definitions: MEANING. Raises ValueError when either side is empty or none of the reference is in range.
    """
    distances = tuple(sorted(distances_m))
    xyz, ref = _points(cloud, "cloud"), _points(reference, "reference")
    if alignment is not None:
        xyz = alignment(xyz)
        cameras = None if cameras is None else alignment(cameras)
    voxel = distances[0] / 2
    xyz, voxel_a = thin(xyz, voxel, tuning)
    ref, voxel_b = thin(ref, voxel, tuning)
    judged = inside_outline(xyz, ref, tuning.ghost_m)
    to_reference = nearest(xyz[judged], ref)
    counted = ref
    if cameras is not None:
        counted = ref[nearest(ref, cameras, range_m) <= range_m]
        if not len(counted):
            raise ValueError(f"no reference point lies within {range_m:g} m of a camera: do both share a frame?")
    to_cloud = nearest(counted, xyz, 1.01 * distances[-1])
    accuracy = tuple(_share(to_reference, d) for d in distances)
    completeness = tuple(_share(to_cloud, d) for d in distances)
    median, p90 = (float(q) for q in np.quantile(to_reference, [0.5, 0.9])) if judged.any() else (np.nan, np.nan)
    return CloudComparison(
        criteria=Criteria(
            distances_m=distances,
            ghost_m=tuning.ghost_m,
            voxel_m=max(voxel_a, voxel_b),
            range_m=None if cameras is None else range_m,
        ),
        judged=JudgedPoints(points=int(judged.sum()), reference_points=len(counted), outside=float(1 - judged.mean())),
        accuracy=accuracy,
        completeness=completeness,
        fscore=tuple(2 * a * c / (a + c) if a + c > 0 else 0.0 for a, c in zip(accuracy, completeness)),
        median_m=median,
        p90_m=p90,
        ghosts=1 - _share(to_reference, tuning.ghost_m) if judged.any() else 0.0,
    )


def thin(points: np.ndarray, voxel_m: float, tuning: CloudTuning) -> tuple[np.ndarray, float]:
    """The first point of each voxel, in order; the voxel grows until at most ``max_points`` are left."""
    while True:
        cell = np.floor((points - points.min(axis=0)) / voxel_m).astype(np.int64)
        extent = cell.max(axis=0) + 1
        key = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
        _, first = np.unique(key, return_index=True)
        if len(first) <= tuning.max_points:
            return points[np.sort(first)], voxel_m
        voxel_m *= tuning.voxel_growth
        log.info("cloud comparison: voxel enlarged to %.3f m to stay within %d points", voxel_m, tuning.max_points)


def nearest(points: np.ndarray, target: np.ndarray, limit: float = np.inf) -> np.ndarray:
    """(N,) distances from points (N, 3) to the nearest target; inf beyond ``limit``. Works in chunks."""
    tree = cKDTree(target)
    out = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        out[part] = tree.query(points[part], distance_upper_bound=limit)[0]
    return out


def inside_outline(points: np.ndarray, reference: np.ndarray, margin_m: float) -> np.ndarray:
    """(N,) bool: inside the reference's convex hull in plan and its height range, both widened by a margin."""
    low, high = reference.min(axis=0) - margin_m, reference.max(axis=0) + margin_m
    inside = np.all((points >= low) & (points <= high), axis=1)
    try:
        planes = ConvexHull(reference[:, :2]).equations
    except (QhullError, ValueError):  # a line or fewer than three points has no outline: its box is all there is
        return inside
    for a, b, c in planes:
        inside &= points[:, 0] * a + points[:, 1] * b + c <= margin_m
    return inside


def _share(distances: np.ndarray, limit: float) -> float:
    return float(np.mean(distances < limit)) if len(distances) else 0.0


def _points(data: np.ndarray | Cloud, what: str) -> np.ndarray:
    xyz = np.asarray(data.xyz_m if isinstance(data, Cloud) else data, float).reshape(-1, 3)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    if not len(xyz):
        raise ValueError(f"the {what} has no points to compare")
    return xyz
