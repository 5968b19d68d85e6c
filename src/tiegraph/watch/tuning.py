"""What watching decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class ArrivalsTuning(Section):
    """When a file is whole (`onsite.py`)."""

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


class ModelTuning(Section):
    """The coarse model, made again and again (`pipeline/watchmodel.py`)."""

    first: int = Field(8, ge=3)
    """Images that the first is made of."""
    more: float = Field(0.1, gt=0)
    """Share of images by which the survey must have grown since the last one, while images still come ..."""
    idle_s: float = Field(3.0, ge=0)
    """... after so long without a new one the last is made."""


class Tuning(Section):
    """Constants of the engine; there is no run folder, so they are not in `tiegraph.toml`."""

    arrivals: ArrivalsTuning = Field(default_factory=ArrivalsTuning)
    model: ModelTuning = Field(default_factory=ModelTuning)
    neighbours: int = Field(2, gt=0)
    """Frames before and after, of the own camera and of those that look nearly the same way, that an image is matched
    with; photographs without order by their names."""
