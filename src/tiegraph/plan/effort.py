"""What a survey costs: images, time on site, disk, CPU time."""

from dataclasses import dataclass

import numpy as np

from tiegraph.plan.tuning import EffortTuning


@dataclass(frozen=True)
class Effort:
    """Of a whole survey; ``site_s``: on the way at the given speed, None = no speed was given."""

    images: int
    way_m: float
    site_s: float | None
    image_bytes: float
    model_bytes: float  # of the run folder up to georef
    dense_bytes: float  # depth maps and cloud on top
    scratch_bytes: float  # while sparse works
    sparse_cpu_s: float  # from the images to the georeferenced model, one core
    dense_cpu_s: float  # depth maps and cloud on top

    @property
    def run_bytes(self) -> float:
        """Of the run folder in the end."""
        return self.model_bytes + self.dense_bytes

    def row(self) -> dict[str, float | None]:
        """JSON-ready."""
        return {**self.__dict__, "run_bytes": self.run_bytes}


def effort(
    sizes: list[tuple[int, int]],
    frames: int,
    way_m: float,
    speed_m_s: float | None,
    most_features: float,
    tuning: EffortTuning,
) -> Effort:
    """Cost of so many frames of cameras of these sizes (width, height), pixels, which keep so many features at most."""
    images, pixels = frames * len(sizes), frames * _pixels(sizes)
    matched = frames * _pixels(sizes, tuning.dense_px)
    each = (min(tuning.features_a_megapixel * w * h / 1e6, most_features) for w, h in sizes)
    features = frames * sum(each)
    return Effort(
        images=images,
        way_m=way_m,
        site_s=None if speed_m_s is None else way_m / speed_m_s,
        image_bytes=tuning.image_bytes * pixels,
        model_bytes=tuning.room_bytes * images + tuning.feature_bytes * features,
        dense_bytes=tuning.dense_bytes * matched,
        scratch_bytes=tuning.copied_bytes * features,
        sparse_cpu_s=tuning.start_s
        + tuning.image_s * images
        + tuning.megapixel_s * frames * _pixels(sizes, tuning.features_px) / 1e6,
        dense_cpu_s=tuning.dense_megapixel_s * matched / 1e6,
    )


def _pixels(sizes: list[tuple[int, int]], most_px: float = np.inf) -> float:
    """Of all images together, each reduced to a longer side of ``most_px``."""
    return sum(width * height * min(1.0, most_px / max(width, height)) ** 2 for width, height in sizes)
