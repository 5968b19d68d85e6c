"""What a survey costs: images, time on site, disk, CPU time."""

from __future__ import annotations

from dataclasses import dataclass

from tiegraph.plan.tuning import EffortTuning


@dataclass(frozen=True)
class Effort:
    """Of a whole survey; ``site_s``: on the way at the given speed, None = no speed was given."""

    images: int
    way_m: float
    site_s: float | None
    image_bytes: float
    run_bytes: float
    sparse_cpu_s: float  # from the images to the georeferenced model, one core
    dense_cpu_s: float  # depth maps and cloud on top

    def row(self) -> dict[str, float | None]:
        """JSON-ready."""
        return dict(self.__dict__)


def effort(
    sizes: list[tuple[int, int]], frames: int, way_m: float, speed_m_s: float | None, tuning: EffortTuning
) -> Effort:
    """Cost of so many frames of cameras of these sizes (width, height), pixels."""
    pixels = frames * sum(width * height for width, height in sizes)
    images, megapixels = frames * len(sizes), pixels / 1e6
    return Effort(
        images=images,
        way_m=way_m,
        site_s=None if speed_m_s is None else way_m / speed_m_s,
        image_bytes=tuning.image_bytes * pixels,
        run_bytes=tuning.run_bytes * pixels,
        sparse_cpu_s=tuning.start_s + tuning.image_s * images + tuning.megapixel_s * megapixels,
        dense_cpu_s=tuning.dense_megapixel_s * megapixels,
    )
