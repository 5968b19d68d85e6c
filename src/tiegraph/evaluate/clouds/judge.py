"""A cloud judged by a reference: registration if asked, nearest distances, M3C2, and what to say of them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from tiegraph.errors import InputError
from tiegraph.evaluate.clouds.m3c2 import Differences, cylinders_of, m3c2_tiled
from tiegraph.evaluate.clouds.nearest import Cameras, CloudComparison, cloud_to_cloud, criteria_of
from tiegraph.evaluate.clouds.register import Registration, registered
from tiegraph.evaluate.clouds.tiles import tile_clouds
from tiegraph.evaluate.tuning import Tuning
from tiegraph.scene.cloudchunks import PointSource
from tiegraph.scene.results import Metric

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
        more = [Metric(name=n, value=found.get(k, np.nan), unit="m", better="low") for n, k in named.items()]
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
        criteria = criteria_of(clouds, tuning.cloud, question.distances_m, question.gsd_m, question.range_m)
        cylinders = cylinders_of(clouds, tuning.m3c2)
        nearest = cloud_to_cloud(clouds, criteria, scratch, cameras)
    clouds = clouds.exchanged()
    sigma = None if fitted is None else fitted.sigma_along
    differences = m3c2_tiled(clouds, cylinders, tuning.m3c2, cameras, sigma)
    return CloudJudgement(nearest, differences, fitted)
