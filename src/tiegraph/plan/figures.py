"""One camera before a surface, in closed form (paper 004, equations 1 and 2, table 1), and what a survey costs."""

from dataclasses import dataclass

import numpy as np

from tiegraph.errors import InputError

_BLUR_PX = 0.5  # motion during the exposure that is allowed: key points and matching keep their precision
_MOST_RAYS = 6  # of a point, up to which its precision is tabled


@dataclass(frozen=True)
class Lens:
    """The camera that the closed forms are about: focal length and image size, pixels; which side runs along the motion
    (0 = the width, 1 = the height)."""

    focal_px: float
    size: tuple[int, int]
    along: int = 0


@dataclass(frozen=True)
class Station:
    """What images at one distance give; lengths in metres."""

    distance_m: float
    gsd_m: float  # of a pixel on the surface
    footprint_m: tuple[float, float]  # width, height of an image on the surface
    base_m: float
    overlap: float  # of two images a base apart, along the motion
    precision_m: tuple[float, ...]  # sigma of a depth from 2, 3, ... rays, each a base further
    across_m: float  # sigma of a point along the surface, two rays
    farthest_m: float | None = None  # at which two rays still give the wanted precision
    blur_px: float | None = None  # by the given exposure
    exposure_s: float | None = None  # longest without blur

    @property
    def points_mm2(self) -> float:
        """Pixels, and so points of a dense cloud, on a square millimetre."""
        return 1e-6 / self.gsd_m**2

    def row(self) -> dict[str, float | None]:
        """JSON-ready, a name with its unit for each figure."""
        deep = {f"depth_sigma_{n}_rays_m": s for n, s in enumerate(self.precision_m, 2)}
        return {
            "distance_m": self.distance_m, "gsd_m": self.gsd_m, "px_per_mm2": self.points_mm2,
            "footprint_width_m": self.footprint_m[0], "footprint_height_m": self.footprint_m[1],
            "base_m": self.base_m, "overlap": self.overlap, **deep, "across_sigma_m": self.across_m,
            "farthest_m": self.farthest_m, "blur_px": self.blur_px, "longest_exposure_s": self.exposure_s,
        }  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """What is asked of the images, and how they are taken; None = not said. Base (m) or overlap (0 to 1) along the
    motion, precision of a depth (m), sigma of a disparity (px); speed of the camera (m/s), frames a second, exposure
    (s)."""

    base_m: float | None = None
    overlap: float | None = None
    precision_m: float | None = None
    match_px: float = 0.3
    speed_m_s: float | None = None
    rate_hz: float | None = None
    exposure_s: float | None = None

    def __post_init__(self) -> None:
        if self.base_m is not None:
            above_zero("base", self.base_m, "a number, or leave it away")
        if self.overlap is not None and not 0 <= self.overlap < 1:
            said = "an overlap is a share from 0 to below 1, such as 0.8; at 1 no frame is new"
            raise InputError(f"--overlap {self.overlap:g}: {said}")
        for name, value, other in (("speed", self.speed_m_s, "rate"), ("rate", self.rate_hz, "speed")):
            if value is not None and None in (self.speed_m_s, self.rate_hz):
                raise InputError(f"--{name} {value:g} without --{other}: both together say how far frames are apart")
        if self.exposure_s is not None and self.speed_m_s is None:
            raise InputError(f"--exposure {self.exposure_s:g} without --speed: a camera at rest does not blur")

    @property
    def step_m(self) -> float | None:
        """Way between two images: the base, else by speed and rate."""
        if self.base_m is not None or self.speed_m_s is None or self.rate_hz is None:
            return self.base_m
        return self.speed_m_s / self.rate_hz


def above_zero(option: str, value: float, what: str) -> None:
    """Raises InputError for the value of an option that is not finite and above zero."""
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"--{option} {value:g} is not above zero: give {what}")


def station(lens: Lens, distance_m: float, wanted: Wanted) -> Station:
    """The figures of one distance. The base is that which is given, else way between two frames, else by the overlap.

    Raises InputError for a distance that is none, and where nothing says how far frames are apart.
    """
    above_zero("distance", distance_m, "the distance from camera to surface in metres")
    gsd = distance_m / lens.focal_px
    footprint = gsd * lens.size[0], gsd * lens.size[1]
    along, base = footprint[lens.along], wanted.step_m
    if base is None:
        if wanted.overlap is None:
            raise InputError("nothing says how far images are apart: give --overlap, --base, or --speed and --rate")
        base = (1 - wanted.overlap) * along
    overlap = max(0.0, 1 - base / along)
    most = int(np.clip(np.floor(along / base) + 1, 2, _MOST_RAYS))
    two = distance_m**2 / (lens.focal_px * base) * wanted.match_px  # equation 2
    per_match = lens.focal_px * base / wanted.match_px
    speed, exposure = wanted.speed_m_s, wanted.exposure_s
    return Station(
        distance_m=distance_m,
        gsd_m=gsd,
        footprint_m=footprint,
        base_m=base,
        overlap=overlap,
        precision_m=tuple(two * rays_gain(n) for n in range(2, most + 1)) if overlap > 0 else (),
        across_m=gsd * wanted.match_px / 2,  # each image has a half of the disparity's variance, and there are two
        farthest_m=None if wanted.precision_m is None else float(np.sqrt(wanted.precision_m * per_match)),
        blur_px=None if speed is None or exposure is None else speed * exposure / gsd,
        exposure_s=None if speed is None else _BLUR_PX * gsd / speed,
    )


def rays_gain(rays: int) -> float:
    """Sigma of a depth from so many images in a row, each a base further, over that from two of them.

    Least squares of the disparities x_k = f k B / H: the sum of (k - mean k)^2 is n (n^2 - 1) / 12, and 1/2 for two.
    """
    return float(np.sqrt(6 / (rays * (rays**2 - 1))))


def advice(made: Station, lens: Lens, wanted: Wanted) -> list[str]:
    """What must change for what is wanted, each with the figure that would do."""
    out, where, along = [], f"at {made.distance_m:g} m", made.footprint_m[lens.along]
    if not made.precision_m:
        out.append(f"{where} images {made.base_m:.3g} m apart do not overlap: nothing can be measured")
    elif wanted.precision_m is not None and made.precision_m[0] > wanted.precision_m:
        base = made.distance_m**2 * wanted.match_px / (lens.focal_px * wanted.precision_m)
        rays = [n for n, s in enumerate(made.precision_m, 2) if s <= wanted.precision_m]
        more = f"points seen {rays[0]} times have it" if rays else "no number of rays up to the last one has it"
        instead = f"or a base of {base:.3g} m" if base < along else "and no base with overlap gives it"
        have, want = (f"{1000 * value:.3g} mm" for value in (made.precision_m[0], wanted.precision_m))
        out.append(
            f"{where} two rays give {have} for the {want} wanted: {more}, {instead}, or a distance of "
            f"{made.farthest_m:.3g} m"
        )
    speed, rate = wanted.speed_m_s, wanted.rate_hz
    if wanted.overlap is not None and made.overlap < wanted.overlap and speed and rate and wanted.base_m is None:
        base = (1 - wanted.overlap) * along
        out.append(
            f"{where} {speed:g} m/s at {rate:g} frames/s overlap by {100 * made.overlap:.0f} %: for "
            f"{100 * wanted.overlap:.0f} % go {base * rate:.3g} m/s or take {speed / base:.3g} frames/s"
        )
    if made.blur_px is not None and made.exposure_s is not None and made.exposure_s < (wanted.exposure_s or 0):
        out.append(
            f"{where} {1000 * (wanted.exposure_s or 0):g} ms blur by {made.blur_px:.2g} px: expose "
            f"{1000 * made.exposure_s:.2g} ms at most"
        )
    return out


# CPU seconds of one core of an AMD EPYC, by benchmarks/results: of a run, of an image from `scan` to `georef`, and of
# its megapixels: small_sets.json and large_sets.json, seven sets of 8 to 300 images within a third (canal 441 s
# measured, 337 so; PandaSet 269 and 400; KITTI 164 and 134; canal_demo 121 and 121; Herz-Jesus-P25 59 and 64).
START_S, _IMAGE_S, _MEGAPIXEL_S = 5.0, 0.8, 1.0
_DENSE_MEGAPIXEL_S = 2.4  # matched in `dense` and `cloud`: whole_way.json, canal, 221 s for 92 megapixels
_PRODUCTS_MEGAPIXEL_S = 3.2  # of the images at full size: canal_demo 3.1 (64 s), fountain-P11 3.2 (56 s)
_PRODUCTS_BYTES = 0.8  # of each of their pixels, for rasters and pictures: canal_demo 0.4, fountain-P11 1.2
_IMAGE_BYTES = 0.3  # of a pixel as JPEG: canal 0.27, PandaSet 0.13; cameras set to their finest write up to 0.6
# In the run folder up to `georef`: of an image (preview, masks, its part of the tables), and of each of its features.
# `du` has, kB an image: canal_demo 323 measured, 348 so, canal 523 and 544, KITTI 1025 and 740, PandaSet 395 and 838,
# Herz-Jesus-P8 1004 and 1134.
_ROOM_BYTES, _FEATURE_BYTES, _FEATURES_A_MEGAPIXEL = 110e3, 250.0, 5600.0
_DENSE_BYTES = 6.0  # of a matched pixel, depth maps and cloud: canal_demo 7.0, kerry_park, half of it placed, 0.5


@dataclass(frozen=True)
class Effort:
    """Of a whole survey; ``site_s``: on the way at the given speed, None = no speed was given."""

    images: int
    way_m: float
    site_s: float | None
    image_bytes: float
    model_bytes: float  # of the run folder up to georef
    dense_bytes: float  # depth maps, cloud and products on top
    scratch_bytes: float  # while sparse works
    sparse_cpu_s: float  # from the images to the georeferenced model, one core
    dense_cpu_s: float  # depth maps, cloud and products on top

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
    longest_px: tuple[float, float] = (3200.0, 3200.0),
    products: bool = True,
) -> Effort:
    """Cost of so many frames of cameras of these sizes (width, height), pixels, which keep so many features at most;
    ``longest_px`` is worked on in features and dense."""
    images, pixels = frames * len(sizes), frames * _pixels(sizes)
    made = pixels if products else 0.0
    matched = frames * _pixels(sizes, longest_px[1])
    each = (min(_FEATURES_A_MEGAPIXEL * w * h / 1e6, most_features) for w, h in sizes)
    features = frames * sum(each)
    return Effort(
        images=images,
        way_m=way_m,
        site_s=None if speed_m_s is None else way_m / speed_m_s,
        image_bytes=_IMAGE_BYTES * pixels,
        model_bytes=_ROOM_BYTES * images + _FEATURE_BYTES * features,
        dense_bytes=_DENSE_BYTES * matched + _PRODUCTS_BYTES * made,
        scratch_bytes=160.0 * features,  # bytes of a feature, in the copy of the database that `sparse` works on
        sparse_cpu_s=START_S + _IMAGE_S * images + _MEGAPIXEL_S * frames * _pixels(sizes, longest_px[0]) / 1e6,
        dense_cpu_s=(_DENSE_MEGAPIXEL_S * matched + _PRODUCTS_MEGAPIXEL_S * made) / 1e6,
    )


def _pixels(sizes: list[tuple[int, int]], most_px: float = np.inf) -> float:
    """Of all images together, each reduced to a longer side of ``most_px``."""
    return sum(width * height * min(1.0, most_px / max(width, height)) ** 2 for width, height in sizes)
