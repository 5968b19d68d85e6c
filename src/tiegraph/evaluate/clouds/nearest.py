"""Cloud against reference by nearest points: accuracy, completeness, F-score, ghosts; as a whole and by groups."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.evaluate.clouds.tiles import TiledClouds
from tiegraph.scene.results import Metric
from tiegraph.scene.sorting import row_numbers, run_starts

_PART = 500_000  # points looked up at once
_JUDGED = np.dtype([("xyz", "<f8", 3), ("distance_m", "<f4")])
# Of a point: distance to the other cloud (inf: further than looked for), numbers of band and section, does it count?
_ROW = np.dtype([("distance_m", "<f4"), ("group", "u1", 2), ("counts", "?")])
MEANING = (
    "Of either cloud one point a voxel ({voxel_m:g} m) is judged, so that dense patches do not outweigh thin ones. "
    "Accuracy: share of the cloud's points nearer than the distance to the reference, among those where the reference "
    "has points within {observed_m:g} m in plan and in its range of heights: what it observed. Completeness: share of "
    "the reference's points nearer than the distance to the cloud, among {counted}; whether a camera could see a point "
    "is not looked at. F = 2AC/(A+C). Ghosts: points where the reference observed, further than {ghost_m:g} m from it. "
    "The reference's points are {spacing_m:.2g} m apart: distances below half of that are not told."
)
_BANDS_M = (5.0, 10.0, 20.0, 50.0)  # between the bands of distance from camera to point


@dataclass(frozen=True)
class Criteria:
    """What a cloud was judged by, metres."""

    distances_m: tuple[float, ...]  # nearer is accurate, and complete
    ghost_m: float  # what is further from the reference is a ghost
    observed_m: float  # in plan from the reference's points: what it observed
    voxel_m: float  # one point of each is judged
    reach_m: float  # nearest points are looked for so far
    spacing_m: float  # of the reference's points
    range_m: float | None = None  # from a camera, that the reference counts in; None: all of it

    @property
    def meaning(self) -> str:
        """The definitions in words."""
        near = f"reference points within {self.range_m:g} m of a registered camera" if self.range_m else "all of them"
        return MEANING.format(counted=near, **{k: v for k, v in self.__dict__.items() if k != "range_m"})


def criteria_of(
    clouds: TiledClouds, distances_m: Sequence[float] = (), gsd_m: float | None = None, range_m: float | None = None
) -> Criteria:
    """The distances given, or those of the series 1, 2, 5 from the ground sampling distance (else the cloud's spacing)
    on; the rest follows from them. Cloud 1 is the reference."""
    distances = tuple(sorted(distances_m)) or _series(gsd_m or clouds.spacing_m[0], 4)
    spacing = float(np.nan_to_num(clouds.spacing_m[1]))
    # As the tables of 3D benchmarks have it, and beyond the gaps of a thin reference, lest these make ghosts
    ghost = float(f"{max(5 * distances[0], 3 * spacing):.3g}")
    return Criteria(
        distances_m=distances,
        ghost_m=ghost,
        observed_m=4 * ghost,  # less excuses walls in the wrong place, more calls what lies beyond its border wrong
        voxel_m=distances[0] / 2,
        reach_m=10 * max(distances[-1], ghost),
        spacing_m=spacing,
        range_m=range_m,
    )


def _series(least: float, count: int) -> tuple[float, ...]:
    """So many numbers 1, 2, 5 x 10^k, none below the least."""
    least = least if np.isfinite(least) and least > 0 else 0.01
    start = int(np.floor(np.log10(least)))
    steps = (float(f"{s * 10.0**k:.6g}") for k in range(start, start + count + 1) for s in (1, 2, 5))
    return tuple([s for s in steps if s >= least * (1 - 1e-9)][:count])


@dataclass(frozen=True)
class Cameras:
    """Registered cameras: ``centres`` (K, 3) in the frame of the comparison, and the ``section`` (K,) of each."""

    centres: np.ndarray
    section: tuple[str, ...]

    def sections(self) -> tuple[str, ...]:
        """Names of the sections, each once."""
        return tuple(dict.fromkeys(self.section))


@dataclass(frozen=True)
class Shares:
    """How some points were judged; shares are 0..1, one per distance; distances are cloud to reference, metres."""

    points: int  # of the cloud, judged
    reference_points: int
    outside: float  # share of the cloud's points where the reference observed nothing: not judged
    accuracy: tuple[float, ...]
    completeness: tuple[float, ...]
    median_m: float  # NaN: further than nearest points are looked for
    p90_m: float
    ghosts: float

    @property
    def fscore(self) -> tuple[float, ...]:
        """Harmonic means of accuracy and completeness."""
        return tuple(2 * a * c / (a + c) if a + c > 0 else 0.0 for a, c in zip(self.accuracy, self.completeness))


@dataclass(frozen=True)
class CloudComparison:
    """Result of ``cloud_to_cloud``: of all points, of those by section, by band of distance from the cameras."""

    criteria: Criteria
    whole: Shares
    sections: dict[str, Shares]
    bands: dict[str, Shares]
    judged: Path  # file of the points judged

    def points(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The cloud's judged points, part by part: (N, 3) and their distances (N,) (NaN: further than looked for)."""
        count = self.judged.stat().st_size // _JUDGED.itemsize
        for start in range(0, count, _PART):
            rows = np.fromfile(self.judged, _JUDGED, min(_PART, count - start), offset=start * _JUDGED.itemsize)
            yield rows["xyz"], rows["distance_m"]

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        scores = zip(self.criteria.distances_m, self.whole.fscore)
        return [
            Metric("cloud_to_cloud_median", self.whole.median_m, "m"),
            Metric("cloud_to_cloud_90", self.whole.p90_m, "m"),
            Metric("ghosts", 100 * self.whole.ghosts, "%", target=0.0),
            *(Metric(f"fscore_{d:g}m", 100 * f, "%", better="high", target=100.0) for d, f in scores),
        ]

    def tables(self) -> dict[str, dict]:
        """Tables for metrics.json."""
        columns = ["distance m", "accuracy %", "completeness %", "F %"]
        shares = zip(self.criteria.distances_m, self.whole.accuracy, self.whole.completeness, self.whole.fscore)
        rows = [[d, 100 * a, 100 * c, 100 * f] for d, a, c, f in shares]
        out = {"cloud against reference": {"columns": columns, "rows": rows}}
        each = [f"F at {d:g} m %" for d in self.criteria.distances_m]
        for what, groups in (("section", self.sections), ("distance from camera", self.bands)):
            columns = [what, "points", "reference points", "median m", "90 % m", "ghosts %", *each]
            rows = [
                [name, s.points, s.reference_points, s.median_m, s.p90_m, 100 * s.ghosts, *(100 * f for f in s.fscore)]
                for name, s in groups.items()
            ]
            out |= {f"cloud against reference by {what}": {"columns": columns, "rows": rows}} if rows else {}
        return out


def cloud_to_cloud(
    clouds: TiledClouds, criteria: Criteria, scratch: Path, cameras: Cameras | None = None
) -> CloudComparison:
    """Compare cloud 0 with the reference, cloud 1, both in one frame and in metres.

    With cameras, completeness counts the reference within ``criteria.range_m`` of one of them. Definitions: MEANING.
    Memory is that of a tile and 7 bytes a judged point; their places lie in a file. Raises ValueError when either side
    is empty, none of the reference is in range, or no point of the cloud is where the reference observed.
    """
    for which, what in enumerate(("cloud", "reference")):
        if not clouds.count(which):
            raise ValueError(f"the {what} has no points to compare")
    path = scratch / "judged.points"
    found: list[tuple[np.ndarray, np.ndarray]] = []
    with open(path, "wb") as out:
        for tile in range(len(clouds)):
            (xyz, own), (_, back) = (_judged(clouds, which, tile, criteria, cameras) for which in (0, 1))
            found.append((own, back))
            rows = np.zeros(int(own["counts"].sum()), _JUDGED)
            distance = own["distance_m"][own["counts"]]
            rows["xyz"], rows["distance_m"] = xyz[own["counts"]], np.where(np.isfinite(distance), distance, np.nan)
            out.write(rows.tobytes())
    cloud, reference = (np.concatenate(side) for side in zip(*found))
    if not cloud["counts"].any():
        raise ValueError(apart(clouds))
    if not reference["counts"].any():
        raise ValueError(f"no reference point lies within {criteria.range_m:g} m of a camera: do both share a frame?")
    bands = [f"{a:g} to {b:g} m" for a, b in zip((0.0, *_BANDS_M), _BANDS_M)] + [f"over {_BANDS_M[-1]:g} m"]
    names = ([], ()) if cameras is None else (bands, cameras.sections())
    by_band, by_section = (_grouped(cloud, reference, criteria, k, own) for k, own in enumerate(names))
    return CloudComparison(criteria, _shares(cloud, reference, criteria), by_section, bands=by_band, judged=path)


def _judged(
    clouds: TiledClouds, which: int, tile: int, criteria: Criteria, cameras: Cameras | None
) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of either side in a tile that are judged, and their rows (N,): one of the cloud counts where the
    reference observed, one of the reference near a camera."""
    xyz = thinned(clouds, which, tile, criteria.voxel_m)
    other = clouds.around(1 - which, tile, criteria.reach_m).xyz
    rows, away = np.zeros(len(xyz), _ROW), np.zeros(len(xyz))
    rows["distance_m"] = nearest(xyz, other, criteria.reach_m)
    if cameras is not None:
        away, near = cKDTree(cameras.centres).query(xyz)
        section = np.array([cameras.sections().index(s) for s in cameras.section], int)
        rows["group"] = np.stack([np.searchsorted(_BANDS_M, away), section[near]], axis=1)
    if which == 1:
        rows["counts"] = away <= (criteria.range_m or np.inf)
        return xyz, rows
    beyond = criteria.observed_m
    level = (xyz[:, 2] >= clouds.low[1][2] - beyond) & (xyz[:, 2] <= clouds.high[1][2] + beyond)
    rows["counts"] = level & (nearest(xyz[:, :2], other[:, :2], beyond) <= beyond)
    return xyz, rows


def thinned(clouds: TiledClouds, which: int, tile: int, voxel_m: float) -> np.ndarray:
    """(N, 3) the points of a tile that are, of all the cloud's points in their voxel, nearest to its centre."""
    own = clouds.own(which, tile).xyz
    if not len(own):
        return own
    xyz = np.concatenate([own, clouds.halo(which, tile, 2 * voxel_m).xyz])
    cell = np.floor(xyz / voxel_m)
    off = np.sum((xyz / voxel_m - cell - 0.5) ** 2, axis=1)
    key = row_numbers(cell.astype(np.int64).T)
    order = np.lexsort((off, key))
    first = order[run_starts(key[order])]
    return own[np.sort(first[first < len(own)])]


def nearest(points: np.ndarray, target: np.ndarray, limit: float = np.inf) -> np.ndarray:
    """(N,) distances from points (N, D) to the nearest target; inf beyond ``limit``. Works in parts."""
    out = np.full(len(points), np.inf)
    if not len(target):
        return out
    tree = cKDTree(target)
    for start in range(0, len(points), _PART):
        part = slice(start, start + _PART)
        out[part] = tree.query(points[part], distance_upper_bound=limit * (1 + 1e-12), workers=-1)[0]
    return out


def _shares(cloud: np.ndarray, reference: np.ndarray, criteria: Criteria) -> Shares:
    """Of the rows (N,), (M,) of both sides."""
    own, back = (side["distance_m"][side["counts"]] for side in (cloud, reference))
    with np.errstate(invalid="ignore"):  # between two distances that were not found
        ends = np.quantile(own, np.array([0.5, 0.9])) if len(own) else np.full(2, np.nan)
    median, p90 = np.where(np.isfinite(ends), ends, np.nan).tolist()
    return Shares(
        points=len(own),
        reference_points=len(back),
        outside=1 - len(own) / max(len(cloud), 1),
        accuracy=tuple(_share(own < d) for d in criteria.distances_m),
        completeness=tuple(_share(back < d) for d in criteria.distances_m),
        median_m=median,
        p90_m=p90,
        ghosts=_share(own > criteria.ghost_m),
    )


def _share(which: np.ndarray) -> float:
    return float(which.mean()) if len(which) else 0.0


def _grouped(
    cloud: np.ndarray, reference: np.ndarray, criteria: Criteria, group: int, names: Sequence[str]
) -> dict[str, Shares]:
    """Shares by group (0 band, 1 section); none of what has no points. One group alone is the whole."""
    own, back = (side["group"][:, group] for side in (cloud, reference))
    found = {n: _shares(cloud[own == k], reference[back == k], criteria) for k, n in enumerate(names)}
    found = {n: s for n, s in found.items() if s.points or s.reference_points}
    return found if len(found) > 1 else {}


def meeting(clouds: TiledClouds) -> None:
    """Raise ValueError for clouds whose boxes do not meet."""
    if (np.maximum(*clouds.low) > np.minimum(*clouds.high)).any():
        raise ValueError(apart(clouds))


def apart(clouds: TiledClouds) -> str:
    """That two clouds do not meet, and where they are."""
    corners = [["(" + ", ".join(f"{v:.2f}" for v in xyz) + ")" for xyz in side] for side in (clouds.low, clouds.high)]
    own, other = (f"from {low} to {high}" for low, high in zip(*corners))
    gap = np.maximum(*clouds.low) - np.minimum(*clouds.high)
    why = "are both in one CRS, with heights above the same surface?"
    if gap[0] <= 0 and gap[1] <= 0 < gap[2]:
        middle = (clouds.low + clouds.high)[:, 2] / 2
        off = f"{abs(middle[0] - middle[1]):.0f} m apart"
        why = f"they lie over each other, {off}: is one above the ellipsoid, the other above a geoid?"
    return f"the cloud (x, y, z {own}) and the other ({other}) do not meet: {why}"
