"""What a user says of a survey: the options of `tiegraph plan`, in groups, and what they mean."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from pydantic import Field

from tiegraph.errors import InputError
from tiegraph.plan.figures import Wanted
from tiegraph.settings import Section

_HEIGHT_FACTOR = 1.5  # sigma of a receiver's height over that of its place, where none is given


class CameraRequest(Section):
    """Which cameras."""

    rig: str | None = None
    """A rig.toml (or Kalibr's or COLMAP's rig file) with cameras, or a preset: ring:5, stereo:0.54, ladybug5. Cameras
    that it leaves open are those of the options below."""
    size: str | None = None
    """Image size in pixels, such as 2448x2050."""
    focal: float | None = Field(None, gt=0)
    """Focal length in mm, with --pixel or --sensor."""
    pixel: float | None = Field(None, gt=0)
    """Pixel pitch in micrometres."""
    sensor: float | None = Field(None, gt=0)
    """Width of the sensor in mm, in place of --pixel."""
    focal_px: float | None = Field(None, gt=0)
    """Focal length in pixels, in place of --focal."""
    # Away from where it was calibrated, a vehicle's lens is half a pixel off (KITTI 0.65, the one vehicle measured,
    # rounded); one that came with its photographs 0.05 (Strecha).
    calibration_px: float = Field(0.5, ge=0)
    """How well lenses that a rig file gives, and that are held, are known, pixels in the image: 0.05 where they were
    calibrated with this survey (`tiegraph calibrate` tells it), else half a pixel."""

    def image_size(self) -> tuple[int, int] | None:
        """Width and height, pixels; None = not said. Raises InputError for what is no size."""
        if self.size is None:
            return None
        try:
            width, height = (int(word) for word in self.size.lower().split("x"))
        except ValueError:
            raise InputError(f"--size {self.size}: give width x height in pixels, such as 2448x2050") from None
        if min(width, height) < 1:
            raise InputError(f"--size {self.size}: an image has pixels: give width x height, such as 2448x2050")
        return width, height

    def focal_length_px(self) -> float | None:
        """Focal length in pixels, None = not said. Raises InputError for values that make none."""
        if self.focal_px is not None and self.focal is not None:
            raise InputError("--focal and --focal-px say the same: give one of them")
        if self.focal_px is not None or self.focal is None:
            return self.focal_px
        if self.pixel is not None and self.sensor is not None:
            raise InputError("--pixel and --sensor say the same: give one of them")
        if self.pixel is not None:
            return 1000 * self.focal / self.pixel
        size = self.image_size()
        if self.sensor is None or size is None:
            raise InputError(f"--focal {self.focal:g} mm: give --pixel too, or --sensor and --size")
        return self.focal * size[0] / self.sensor


class ImageRequest(Section):
    """What the images shall give, and how they are taken. Lists such as 0.5,0.7,1.0 are a sweep."""

    distance: str | None = None
    """From camera to surface, metres; flying height of a grid."""
    base: str | None = None
    """Way between two images, or base of a rig, metres; else by --speed and --rate, else by --overlap."""
    overlap: str | None = None
    """Of images along the way, 0 to below 1 (default 0.8 where nothing says how far images are apart)."""
    sidelap: float = Field(0.6, ge=0, lt=1)
    """Of rows or lines, 0 to below 1."""
    precision: float | None = Field(None, gt=0)
    """Sigma of a depth that is wanted, metres."""
    match_px: float = Field(0.3, gt=0)
    """Sigma of a disparity, pixels (paper 004: 0.2 to 0.3)."""
    speed: float | None = Field(None, gt=0)
    """Metres a second; with --rate."""
    rate: float | None = Field(None, gt=0)
    """Frames a second."""
    exposure: float | None = Field(None, gt=0)
    """Milliseconds."""

    def wanted(self, base: float | None, overlap: float | None) -> Wanted:
        """What is asked of one station of a sweep. Raises InputError for values that are none."""
        asked = Wanted(
            base_m=base,
            overlap=overlap,
            precision_m=self.precision,
            match_px=self.match_px,
            speed_m_s=self.speed,
            rate_hz=self.rate,
            exposure_s=None if self.exposure is None else self.exposure / 1000,
        )
        return asked if overlap is not None or asked.step_m is not None else replace(asked, overlap=0.8)

    def distances(self) -> list[float]:
        """Distances of the sweep. Raises InputError without any."""
        found = [d for d in numbers("distance", self.distance) if d is not None]
        if not found:
            raise InputError("give --distance, from camera to surface in metres; a list such as 0.5,0.7,1.0 is a sweep")
        return found


class PathRequest(Section):
    """A whole path. Shapes: canal (out and back between two walls), road, corridor, tunnel, facade, grid, orbit."""

    shape: str | None = None
    """Shape of the path; without one there is only the table of distances."""
    length: float = Field(100.0, gt=0)
    """Of the way, of a facade, of the lines of a grid, metres."""
    width: float | None = Field(None, gt=0)
    """Of a grid across its lines, of the object that is orbited, metres (default: length)."""
    height: float | None = Field(None, gt=0)
    """Of walls, facade, corridor or object, metres (default: twice the distance)."""
    relief: float | None = Field(None, ge=0)
    """How much the surface is uneven, sigma, metres: houses behind a quay, columns of a facade, forest (default: a
    tenth of the distance, of canal and road a quarter)."""
    passes: int | None = None
    """Out and back: 2 (default of a canal), 1 (of corridor and tunnel)."""
    yaw: float = 0.0
    """Turn of the rig to the right, degrees, out of the direction of the way (facade, orbit: to the surface)."""
    pitch: float = 0.0
    """Likewise, up; an orbit that looks down stands higher, round the same middle."""


class WorldRequest(Section):
    """Tie points, and what places the path in the world."""

    gnss: str | None = None
    """Sigma of positions in plan, or plan,height, metres: 0.02,0.03."""
    outage: tuple[str, ...] = ()
    """Stretches without positions, FROM-TO, metres from the start of the way: 25-33."""
    control: int = Field(0, ge=0)
    """Control points, evenly along the path."""
    control_sigma: float = Field(0.01, gt=0)
    """Of each of their coordinates, metres."""
    tie_px: float = Field(0.2, gt=0)
    """Sigma of a tie point in an image, pixels (measured: 0.13 to 0.34)."""
    ties: float | None = Field(None, ge=1)
    """Tie points that an image sees, from a survey before (default: by its pixels)."""
    origin: str | None = None
    """Where the path starts, LAT,LON or LAT,LON,HEIGHT: for waypoints on the Earth."""
    heading: float = 90.0
    """Direction of the first way there, degrees clockwise from north."""

    def positions(self) -> tuple[np.ndarray, list[tuple[float, float]]] | None:
        """Sigmas (3,) of a receiver's positions, metres, and the stretches (from, to), metres from the start, without
        any. None without a receiver.

        Raises InputError for words that are no sigmas or stretches.
        """
        if self.gnss is None:
            if self.outage:
                raise InputError(f"--outage {self.outage[0]} without --gnss: there are no positions that could fail")
            return None
        sigma = [v for v in numbers("gnss", self.gnss) if v is not None]
        if len(sigma) > 2:
            raise InputError(f"--gnss {self.gnss}: give the sigma in plan, or in plan and height: 0.02,0.03")
        plan, height = sigma[0], sigma[1] if len(sigma) > 1 else _HEIGHT_FACTOR * sigma[0]
        if not (plan > 0 and height > 0):
            raise InputError(f"--gnss {plan:g},{height:g}: sigmas in metres, above zero")
        stretches = []
        for text in self.outage:
            try:
                begin, end = map(float, text.split("-")[:2])
            except ValueError:
                raise InputError(f"--outage {text}: give FROM-TO, metres from the start of the way: 25-33") from None
            if not begin < end:
                raise InputError(f"--outage {text}: give FROM-TO, metres from the start of the way, FROM below TO")
            stretches.append((begin, end))
        return np.array([plan, plan, height]), stretches


@dataclass(frozen=True)
class OutputRequest:
    """What is written."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """A new folder for plan.json, table, 3-D view and waypoints."""
    compare: Path | None = None
    """A finished run: what was planned (--planned) against what it reached."""
    planned: Path | None = None
    """The plan.json to compare with (default: plan.json in the run folder)."""


@dataclass(frozen=True)
class PlanRequest:
    """All that is said."""

    camera: CameraRequest = CameraRequest()
    images: ImageRequest = ImageRequest()
    path: PathRequest = PathRequest()
    world: WorldRequest = WorldRequest()
    output: OutputRequest = OutputRequest()


def numbers(name: str, text: str | None) -> list[float | None]:
    """The numbers of a list such as 0.5,0.7; [None] where nothing is given. Raises InputError."""
    if text is None:
        return [None]
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"--{name} {text}: give a number, or several with commas between, such as 0.5,0.7") from None
