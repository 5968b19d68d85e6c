"""M3C2: the difference of two clouds along the normal of the first, with its level of detection.

Lague, Brodu, Leroux 2013 (ISPRS J. 82, 10-26). At each core point a cylinder about the normal cuts both clouds; the
difference is that of the mean places of their points along the axis. The level of detection is 1.96 times the root of
the sum of the variances of both means and of the registration (there: standard error plus registration error, which
calls too few changes significant where that error is random). Points of one survey that stand together err together:
what the cloud states as sigma of its points is therefore not divided by their number (as James, Robson, Smith 2017,
"M3C2-PM"), while the spread in the cylinder is. Significant differences that stand together are a change, with area and
volume.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.evaluate.clouds.nearest import Cameras, thinned
from tiegraph.evaluate.clouds.tiles import TiledClouds
from tiegraph.evaluate.tuning import M3c2Tuning
from tiegraph.scene import graph
from tiegraph.scene.cloudchunks import Points
from tiegraph.scene.sorting import Columns

_RADIUS_SPACINGS = 5.0  # of the thinner cloud: 20 points of a random cloud lie in a cylinder
_DEPTH_RADII = 6.0  # how far a cylinder reaches to either side: larger differences are not found
_CORES = 10_000  # core points looked at together: some 10 million pairs of points at most

Sigma = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of points (N, 3) along normals (N, 3): metres (N,)
CONFIDENCE = 1.96  # sigmas at which 5 % of the differences of equal surfaces are called significant


@dataclass(frozen=True)
class Cylinders:
    """Lengths in metres: radius of the cylinders, of the neighbourhood that tells the normal, how far the cylinders
    reach to either side, and how far core points stand apart."""

    radius_m: float
    normal_m: float
    depth_m: float
    cores_m: float


def cylinders_of(clouds: TiledClouds, tuning: M3c2Tuning, depth_m: float | None = None) -> Cylinders:
    """Cylinders that fit the spacing of the thinner cloud. Raises ValueError for a depth that does not fit them, and
    for clouds without a spacing."""
    spacing = float(np.max(clouds.spacing_m))  # NaN of one point stays
    if not 0 < spacing < np.inf:
        raise ValueError("half of the points of a cloud stand in one place, or it has only one: no surface")
    radius = float(f"{_RADIUS_SPACINGS * spacing:.2g}")
    depth = _DEPTH_RADII * radius if depth_m is None else depth_m
    if not radius <= depth <= 200 * radius:
        raise ValueError(f"a depth of {depth:g} m does not fit: give {radius:g} to {200 * radius:g} m")
    return Cylinders(radius_m=radius, normal_m=tuning.normal_radii * radius, depth_m=depth, cores_m=radius)


@dataclass(frozen=True)
class Differences(Columns):
    """Of core points (N, 3) on the first cloud: ``normal`` (N, 3), ``distance_m`` (N,) of the second cloud along it
    (NaN: too few points of one in the cylinder), ``lod_m`` (N,) level of detection at 95 %."""

    xyz: np.ndarray
    normal: np.ndarray
    distance_m: np.ndarray
    lod_m: np.ndarray
    cylinders: Cylinders

    @property
    def known(self) -> np.ndarray:
        """(N,) bool: there is a difference with its level of detection."""
        return np.isfinite(self.distance_m) & np.isfinite(self.lod_m)

    @property
    def significant(self) -> np.ndarray:
        """(N,) bool: the difference is larger than its level of detection."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(self.distance_m) > self.lod_m)

    def summary(self) -> dict[str, float]:
        """Median, spread (half of 16 % to 84 %), 95 % of the absolute values, level of detection, shares in %."""
        d, known = self.distance_m[self.known], self.known
        if not len(d):
            return {"core points": len(self), "compared %": 0.0}
        low, median, high = np.percentile(d, [16, 50, 84])
        return {
            "core points": len(self),
            "compared %": 100 * float(known.mean()),
            "median m": float(median),
            "spread m": float(high - low) / 2,
            "95 % of absolute m": float(np.percentile(np.abs(d), 95)),
            "level of detection m": float(np.median(self.lod_m[known])),
            "significant %": 100 * float(self.significant[known].mean()),
        }


def m3c2_tiled(
    clouds: TiledClouds,
    cylinders: Cylinders,
    tuning: M3c2Tuning,
    cameras: Cameras | None = None,
    registration: Sigma | None = None,
    most: int | None = None,
) -> Differences:
    """Differences at core points on cloud 0, thinned to one a voxel of ``cores_m``: cloud 1 minus cloud 0.

    Normals point to the nearest camera, else up. Memory grows by some 100 bytes a core point; ``most``: about so many
    core points, spread over the tiles as the points are.
    """
    reach = float(np.hypot(cylinders.radius_m, cylinders.depth_m))
    parts = []
    for tile in range(len(clouds)):
        cores = thinned(clouds, 0, tile, cylinders.cores_m)
        if most is not None:
            share = len(clouds.own(0, tile)) / max(clouds.count(0), 1)
            cores = cores[:: max(1, int(len(cores) / max(share * most, 1)))]
        first = clouds.around(0, tile, max(reach, cylinders.normal_m))
        second = clouds.around(1, tile, reach)
        normal = _facing(normals(cores, first.xyz, cylinders.normal_m), cores, cameras)
        known = np.isfinite(normal[:, 0])
        cores, normal = cores[known], normal[known]
        reg = np.zeros(len(cores)) if registration is None else registration(cores, normal)
        distance, lod = m3c2(cores, normal, (first, second), cylinders, tuning, reg)
        parts.append((cores, normal.astype(np.float32), distance.astype(np.float32), lod.astype(np.float32)))
    joined = [np.concatenate(column) for column in zip(*parts)]
    return Differences(xyz=joined[0], normal=joined[1], distance_m=joined[2], lod_m=joined[3], cylinders=cylinders)


def m3c2(
    cores: np.ndarray,
    normal: np.ndarray,
    clouds: tuple[Points, Points],
    cylinders: Cylinders,
    tuning: M3c2Tuning,
    registration: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Difference (N,) second minus first along the normals (N, 3) at core points (N, 3), and level of detection (N,).

    ``registration`` (N,): sigma of what one cloud may be shifted against the other, along the normal.
    """
    (few, first, noise), (few_too, second, noise_too) = (
        _sections(cores, normal, points, cylinders, tuning.least_points) for points in clouds
    )
    unknown = np.where(few | few_too, np.nan, 0.0)
    return second - first + unknown, CONFIDENCE * np.sqrt(noise + noise_too + np.square(registration)) + unknown


def _sections(
    cores: np.ndarray, normal: np.ndarray, points: Points, cylinders: Cylinders, least: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of what each cylinder cuts out of a cloud: whether it has fewer points than ``least``, mean of their places along
    the axis, variance of that mean with the mean of the squared sigmas that the cloud states (0: it states none).

    A cylinder is covered by balls along its axis: one ball around it would hold all walls beside it.
    """
    sums = np.zeros((4, len(cores)))
    if len(points) and len(cores):
        tree = cKDTree(points.xyz)
        sigma2 = np.nan_to_num(np.square(points.sigma))
        steps = int(np.ceil(cylinders.depth_m / cylinders.radius_m))
        edges = np.linspace(-cylinders.depth_m, cylinders.depth_m, steps + 1)
        half = cylinders.depth_m / steps
        ball = float(np.hypot(cylinders.radius_m, half)) * (1 + 1e-9)
        for part in _batches(len(cores)):
            for low, high in zip(edges[:-1], edges[1:]):
                core, point = _pairs(cores[part] + (low + half) * normal[part], tree, ball)
                off = points.xyz[point] - cores[part][core]
                along = np.einsum("ij,ij->i", off, normal[part][core])
                away = np.sum(off**2, axis=1) - along**2
                inside = (away <= cylinders.radius_m**2) & (along >= low) & (along < high)
                core, along = core[inside], along[inside]
                for k, w in enumerate((None, along, along**2, sigma2[point[inside]])):
                    sums[k, part] += np.bincount(core, w, part.stop - part.start)
    count, total, square, stated = sums
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count
        variance = np.maximum(square - count * mean**2, 0) / (count - 1)
        return count < least, mean, variance / np.maximum(count, 1) + stated / count


def normals(cores: np.ndarray, xyz: np.ndarray, radius: float) -> np.ndarray:
    """(N, 3) normals of a cloud's surface by its points within a radius, of either sign; NaN of fewer than 3 points."""
    out = np.full((len(cores), 3), np.nan)
    tree = cKDTree(xyz) if len(xyz) else None
    for part in _batches(len(cores) if tree is not None else 0):
        core, point = _pairs(cores[part], tree, radius)
        size, off = part.stop - part.start, (xyz[point] - cores[part][core]).T
        count = np.bincount(core, minlength=size)
        mean = np.stack([np.bincount(core, axis, size) for axis in off], axis=1) / np.maximum(count, 1)[:, None]
        moment = np.stack([np.bincount(core, a * b, size) for a in off for b in off], axis=1).reshape(-1, 3, 3)
        spread = moment - count[:, None, None] * mean[:, :, None] * mean[:, None, :]
        enough = count >= 3
        out[part][enough] = np.linalg.eigh(spread[enough])[1][:, :, 0]
    return out


def _batches(count: int) -> list[slice]:
    return [slice(start, min(start + _CORES, count)) for start in range(0, count, _CORES)]


def _pairs(centres: np.ndarray, tree: cKDTree, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """(P,) numbers of centres and of the tree's points within a radius."""
    found = cKDTree(centres).sparse_distance_matrix(tree, radius, output_type="ndarray")
    return found["i"], found["j"]


def _facing(normal: np.ndarray, cores: np.ndarray, cameras: Cameras | None) -> np.ndarray:
    """Normals turned to the nearest camera, without cameras upwards, else to the north-east."""
    if cameras is None:
        towards = np.broadcast_to([0.36, 0.48, 0.8], cores.shape)
    else:
        towards = cameras.centres[cKDTree(cameras.centres).query(cores)[1]] - cores
    away = np.einsum("ij,ij->i", normal, towards) < 0
    return np.where(away[:, None], -normal, normal)


COLUMNS = ("change", "x", "y", "z", "core points", "area m2", "mean m", "largest m", "volume m3")


@dataclass(frozen=True)
class Changes:
    """Connected pieces of surface that moved one way, largest volume first, and areas of what was compared and called
    significant. ``listed``: middle (3), number of core points, area, mean and largest difference (+: towards the
    cameras, or up), and volume (area times difference) of each."""

    listed: tuple[tuple[float, ...], ...]
    compared_m2: float
    significant_m2: float

    def totals(self) -> dict[str, float]:
        """Areas in m2 and volumes in m3."""
        volumes = np.array([row[-1] for row in self.listed])
        return {
            "compared_m2": self.compared_m2,
            "significant_m2": self.significant_m2,
            "changed_m2": sum(row[4] for row in self.listed),
            "gain_m3": float(volumes[volumes > 0].sum()),
            "loss_m3": -float(volumes[volumes < 0].sum()),
        }

    def table(self, shift: np.ndarray, most: int) -> dict:
        """The largest changes at most; ``shift`` (3,) is added to their places."""
        rows = [[k, *(row[:3] + shift).tolist(), *row[3:]] for k, row in enumerate(self.listed[:most], 1)]
        return {"columns": list(COLUMNS), "rows": rows}


def changes(found: Differences) -> Changes:
    """Changes by significant core points near each other with differences of one sign.

    Fewer than 12 together are chance: 5 % of unchanged ones are significant.
    """
    known = found.known
    xyz, distance, loud = found.xyz[known], found.distance_m[known].astype(float), found.significant[known]
    if not len(xyz):
        return Changes(listed=(), compared_m2=0.0, significant_m2=0.0)
    # A point stands for a disc that it shares with the points in it; at a border that is too large by half.
    radius = 3 * found.cylinders.cores_m
    area = np.pi * radius**2 / cKDTree(xyz).query_ball_point(xyz, radius, return_length=True, workers=-1)
    where, out = np.flatnonzero(loud), []
    i, j = cKDTree(xyz[where]).query_pairs(2 * found.cylinders.cores_m, output_type="ndarray").T
    alike = np.sign(distance[where[i]]) == np.sign(distance[where[j]])
    label = graph.parts(i[alike], j[alike], len(where))
    for piece in (where[label == k] for k in np.flatnonzero(np.bincount(label) >= 12)):
        own, a = distance[piece], area[piece]
        mean, largest = float(np.average(own, weights=a)), float(own[np.argmax(np.abs(own))])
        middle = np.median(xyz[piece], axis=0).tolist()
        out.append((*middle, len(piece), float(a.sum()), mean, largest, float(a @ own)))
    out.sort(key=lambda row: -abs(row[-1]))
    return Changes(listed=tuple(out), compared_m2=float(area.sum()), significant_m2=float(area[loud].sum()))
