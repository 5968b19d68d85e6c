"""What watching decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class ArrivalsTuning(Section):
    """When a file is whole (`arrivals.py`)."""

    look_s: float = Field(0.3, gt=0)
    """Between two looks into the folder."""
    settled_s: float = Field(0.6, ge=0)
    """A file whose size and time have not changed for so long is opened; one that is not whole is opened again when
    they change: a card reader pauses for tenths of a second, a network for more."""
    again_s: float = Field(5.0, gt=0)
    """A file that could not be read is opened again after so long, and twice as long each time: some shares keep the
    size and the time of a file that grows."""
    tries: int = Field(5, gt=0)
    """Times it is opened without a change."""


class FramesTuning(Section):
    """The place of new frames between two models (`frames.py`)."""

    partners: int = Field(16, gt=1)
    """Images with a pose, of those tied to a frame most, whose ties give its points."""
    least_angle_deg: float = Field(1.5, gt=0)
    """Between the rays of a point: on previews an error of a pixel is a tenth to a fifth of a degree."""
    ray_deg: float = Field(0.5, gt=0)
    """Between a ray of a point and the point: three pixels of a preview of 400 pixels and 70 degrees."""
    least_points: int = Field(12, ge=6)
    """Points that a frame's pose needs."""
    inlier_small_px: float = Field(3.0, gt=0)
    """Distance of an inlier in pixels of the reduced image."""


class ModelTuning(Section):
    """The coarse model, made again and again (`pipeline/watchmodel.py`)."""

    first: int = Field(8, ge=3)
    """Images that the first is made of."""
    more: float = Field(0.1, gt=0)
    """Share of images by which the survey must have grown since the last one, while images still come ..."""
    idle_s: float = Field(3.0, ge=0)
    """... after so long without a new one the last is made."""
    look_alikes: int = Field(4, ge=0)
    """Of an image, matched before a model is made: what order does not tell of, loops and loose photographs."""
    training: int = Field(30_000, gt=0)
    """Descriptors that the words of look-alikes are learnt from: a second instead of six at 200 images."""
    vocabularies: int = Field(1, gt=0)
    """As in `network`; one finds 0.01 to 0.02 less than two."""


class Tuning(Section):
    """Constants of the engine; there is no run folder, so they are not in `tiegraph.toml`."""

    arrivals: ArrivalsTuning = Field(default_factory=ArrivalsTuning)
    """When a file is whole."""
    frames: FramesTuning = Field(default_factory=FramesTuning)
    """The place of new frames."""
    model: ModelTuning = Field(default_factory=ModelTuning)
    """The coarse model."""
    neighbours: int = Field(2, gt=0)
    """Frames before and after, of the own camera and of those that look nearly the same way, that an image is matched
    with; photographs without order by their names."""
