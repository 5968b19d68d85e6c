"""What is said of two compared clouds: how a reference judges a cloud (registration if asked, nearest distances, M3C2),
how well two passes of one survey agree, which needs no reference, and the map of differences.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import ndimage
from scipy.spatial import cKDTree

from tiegraph.errors import InputError
from tiegraph.evaluate.clouds.m3c2 import Differences, cylinders_of, m3c2_tiled
from tiegraph.evaluate.clouds.nearest import Cameras, CloudComparison, cloud_to_cloud, criteria_of
from tiegraph.evaluate.clouds.register import Registration, registered
from tiegraph.evaluate.clouds.tiles import tile_clouds
from tiegraph.evaluate.tuning import PassesTuning, Tuning
from tiegraph.scene.cloudchunks import PointSource
from tiegraph.scene.results import Metric, png
from tiegraph.text import round_below

Register = Literal["none", "rigid", "similarity"]


@dataclass(frozen=True)
class Question:
    """What is asked: distances (none: by ``gsd_m``, else by the cloud's spacing), cameras in the reference's frame with
    the range in which they count, how the cloud is registered first, and whether from a start by shapes (``coarse``)
    because it is far off."""

    distances_m: tuple[float, ...] = ()
    gsd_m: float | None = None
    cameras: Cameras | None = None
    range_m: float | None = None
    register: Register = "none"
    coarse: bool = False


@dataclass(frozen=True)
class CloudJudgement:
    """What was found; ``differences`` are of the cloud against the reference, along the reference's normals."""

    nearest: CloudComparison
    differences: Differences
    registration: Registration | None

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        found = self.differences.summary()
        named = {"m3c2_median": "median m", "m3c2_spread": "spread m"}
        more = [Metric(n, found.get(k, np.nan), "m") for n, k in named.items()]
        return [*self.nearest.metrics(), *more]

    def tables(self) -> dict[str, dict]:
        """Tables for metrics.json."""
        rows = [[k, v] for k, v in self.differences.summary().items()]
        out = self.nearest.tables()
        out["cloud against reference, M3C2"] = {"columns": ["of M3C2", "value"], "rows": rows}
        if self.registration is not None:
            out["registration of the cloud on the reference"] = self.registration.table()
        return out

    def notes(self) -> str:
        """The definitions in words."""
        lengths, outside = self.differences.cylinders, self.nearest.whole.outside
        return (
            f"{self.nearest.criteria.meaning} {100 * outside:.0f} % of the cloud lie where the reference observed "
            "nothing and are not judged. M3C2: mean of the cloud minus mean of the reference in cylinders of radius "
            f"{lengths.radius_m:g} m and {2 * lengths.depth_m:g} m length along the reference's normal."
        )


@contextmanager
def told_of(name: str) -> Iterator[None]:
    """What is wrong with clouds is an InputError that names one of them, if it does not name its file already."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{name}: {error}") from None


def judge_cloud(
    cloud: PointSource, reference: PointSource, scratch: Path, question: Question, tuning: Tuning
) -> CloudJudgement:
    """Judge a cloud of any size by a reference in the same frame; ``scratch`` is a folder for its files.

    Raises InputError, naming the reference, for clouds that do not meet or cannot be registered as asked.
    """
    cameras, fitted = question.cameras, None
    with told_of(reference.name):
        if question.register != "none":
            scaled = question.register == "similarity"
            fitted = registered(cloud, reference, tuning.registration, scaled, question.coarse)
            cloud = cloud.moved(fitted.fit, cloud.crs)
            cameras = cameras and Cameras(fitted.fit(cameras.centres), cameras.section)
        clouds = tile_clouds(cloud, reference, scratch, tuning.cloud)
        criteria = criteria_of(clouds, question.distances_m, question.gsd_m, question.range_m)
        cylinders = cylinders_of(clouds, tuning.m3c2)
        nearest = cloud_to_cloud(clouds, criteria, scratch, cameras)
    clouds = clouds.exchanged()
    sigma = None if fitted is None else fitted.sigma_along
    differences = m3c2_tiled(clouds, cylinders, tuning.m3c2, cameras, sigma)
    return CloudJudgement(nearest, differences, fitted)


TABLE = "one pass against the other, M3C2"
_WHOLE = "all"
_NAN = float("nan")


@dataclass(frozen=True)
class PassAgreement:
    """What M3C2 found between the clouds of two passes: the second minus the first.

    ``maps`` depth maps of either took part, of ``there``; ``found``: by section and of all, the summary of the
    differences (``Differences.summary``); ``why_not``: why nothing could be compared.
    """

    passes: Sequence[str]
    maps: Sequence[int]
    there: Sequence[int]
    found: Mapping[str, Mapping[str, float]]
    why_not: str = ""

    @property
    def rms_m(self) -> float:
        """Root mean square of the differences without strays, of their median and spread; NaN = nothing compared."""
        whole = self.found.get(_WHOLE, {})
        return float(np.hypot(whole.get("median m", _NAN), whole.get("spread m", _NAN)))

    @property
    def detection_m(self) -> float:
        """Median level of detection; NaN = nothing compared."""
        return float(self.found.get(_WHOLE, {}).get("level of detection m", _NAN))

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        whole = self.found.get(_WHOLE, {})
        named = (("median", "median m", "m"), ("spread", "spread m", "m"), ("significant", "significant %", "%"))
        return [Metric(f"passes_{n}", whole[of], unit) for n, of, unit in named if of in whole]

    def tables(self) -> dict[str, dict]:
        """The table for metrics.json: by section where there are several."""
        columns = list(self.found.get(_WHOLE, {}))
        shown = {n: v for n, v in self.found.items() if n == _WHOLE or len(self.found) > 2}
        rows = [[name, *(values.get(c) for c in columns)] for name, values in shown.items()]
        short = {"95 % of absolute m": "95 % within m", "level of detection m": "detection m"}
        return {TABLE: {"columns": ["section", *(short.get(c, c) for c in columns)], "rows": rows}} if columns else {}

    def note(self) -> str:
        """What was compared and what that does not tell."""
        if self.why_not:
            return f"Passes {' and '.join(self.passes)} were not compared with each other: {self.why_not}"
        few = self.maps != self.there
        sampled = ", near places along the way; `tiegraph compare --passes` takes all" if few else ""
        used = f"{self.maps[0]} of {self.there[0]} and {self.maps[1]} of {self.there[1]} depth maps{sampled}"
        return (
            f"Pass {self.passes[1]} against pass {self.passes[0]} (M3C2 along the normal; {used}): it tells how well "
            "the passes agree in pose and depth. It does not tell what both share: place, scale, cameras, what "
            "matching got wrong in both; and a depth map of one pass may have been confirmed by images of the other."
        )


def by_section(found: Differences, cameras: Cameras) -> dict[str, dict[str, float]]:
    """Summaries of differences, of all and by the section of the nearest camera."""
    nearest = cKDTree(cameras.centres).query(found.xyz)[1] if len(found) else np.zeros(0, int)
    section = np.array(cameras.section)[nearest]
    parts = {_WHOLE: found, **{name: found.where(section == name) for name in sorted(cameras.sections())}}
    return {n: {k: float(f"{v:.6g}") for k, v in part.summary().items()} for n, part in parts.items()}


def near_places(first: np.ndarray, second: np.ndarray, tuning: PassesTuning) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the cameras that take part, of the first pass (N, 3) in the order of its way and of the second (M, 3):
    all of few, else those nearest to places along the first."""
    if max(len(first), len(second)) <= tuning.maps:
        return np.arange(len(first)), np.arange(len(second))
    at = first[np.linspace(0, len(first) - 1, tuning.places + 2)[1:-1].round().astype(int)]
    each = max(1, tuning.maps // tuning.places)
    found = [cKDTree(c).query(at, k=np.arange(1, min(each, len(c)) + 1))[1] for c in (first, second)]
    return np.unique(found[0]), np.unique(found[1])


_CELLS = 500  # along the longer side


def difference_map(found: Differences, title: str, only_significant: bool = False) -> bytes:
    """Medians of the differences in plan, x to the right (east) and y up (north); grey: compared, but nothing
    significant (``only_significant``); white: nothing compared."""
    xyz, value = found.xyz[found.known], found.distance_m[found.known]
    wide, high = np.ptp(xyz[:, :2], axis=0) if len(xyz) else (1.0, 1.0)
    inches = (8.0, float(np.clip(8.0 * high / max(wide, 1e-9), 2.0, 16.0)) + 1.6)
    figure = Figure(figsize=inches, dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=11, loc="left")
    if len(xyz):
        edge, low = max(float(wide), float(high)) / _CELLS, xyz[:, :2].min(axis=0)
        at = np.floor((xyz[:, :2] - low) / max(edge, found.cylinders.cores_m)).astype(np.int64)
        size = at.max(axis=0) + 1
        extent = np.column_stack([low, low + size * max(edge, found.cylinders.cores_m)]).ravel().tolist()
        shown: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
        loud = found.significant[found.known] if only_significant else np.ones(len(xyz), bool)
        if only_significant:
            grey = np.where(np.isnan(_medians(at, value, size)), np.nan, 0.85)
            axes.imshow(grey, cmap="gray", vmin=0, vmax=1, **shown)
        limit = float(np.percentile(np.abs(value[loud] if loud.any() else value), 95)) or 1e-3
        drawn = axes.imshow(_medians(at[loud], value[loud], size), cmap="coolwarm", vmin=-limit, vmax=limit, **shown)
        label = "difference along the normal, m"
        figure.colorbar(drawn, ax=axes, shrink=0.6, location="bottom", extend="both", label=label)
        _scale_bar(axes, extent)
        axes.text(0.01, 0.99, "N \u2191", transform=axes.transAxes, va="top", fontsize=11)
    else:
        axes.text(0.5, 0.5, "nothing could be compared", transform=axes.transAxes, ha="center")
    axes.set(xticks=[], yticks=[], aspect="equal")
    return png(figure)


def _medians(at: np.ndarray, value: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(Y, X) median of the values (N,) in each cell x, y (N, 2), NaN without any."""
    cell = at[:, 1] * size[0] + at[:, 0]
    out, found = np.full(size[0] * size[1], np.nan), np.unique(cell)
    out[found] = ndimage.median(value, cell, found) if len(found) else []
    return out.reshape(size[1], size[0])


def _scale_bar(axes: Axes, extent: list[float]) -> None:
    left, right, low, high = extent
    length, y = round_below((right - left) / 4), low - 0.04 * (high - low)
    axes.plot([left, left + length], [y, y], color="#444444", linewidth=3, solid_capstyle="butt", clip_on=False)
    axes.text(left + length / 2, y - 0.015 * (high - low), f"{length:g} m", ha="center", va="top", fontsize=9)
    axes.set_ylim(low - 0.1 * (high - low), high)
