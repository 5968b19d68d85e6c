"""What the room sections decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class SectionsTuning(Section):
    """Bridge and open-sky sections (`light.py`, `sections.py`)."""

    min_frames: int = Field(8, ge=2)
    """Of a pass with an up camera, or nothing can be learnt from it alone."""
    min_separation: float = Field(0.7, ge=0, le=1)
    """Share of the variance the two classes must explain (a normal distribution: 0.64 to 0.67)."""
    min_class: int = Field(2, gt=0)
    """Frames of the smaller class."""
    sky_contrast: float = Field(0.3, ge=0)
    """By which the classes' open shares of the masks must differ."""
    luminance_contrast: float = Field(2.0, gt=0)
    """Factor by which the classes' luminances must differ."""
    brightness_contrast: float = Field(1.25, gt=0)
    """Factor by which the classes' brightnesses must differ."""
    gamma: float = Field(2.2, gt=0)
    """Of grey values, to make them proportional to light."""
    known_exposure: float = Field(0.9, ge=0, le=1)
    """Share of the up images that must carry their exposure."""
    narrowest: float = Field(1 / 6, gt=0)
    """Of the contrast: least scatter within a class that is believed."""
    frame_say: float = Field(4.0, ge=0)
    """Log likelihood ratio of one frame at most: none decides alone ..."""
    switch_cost: float = Field(2.5, ge=0)
    """... against leaving a state and coming back."""
    min_shared: float = Field(0.2, ge=0)
    """Of the density of pairs within sections: what two sections must share to be one place."""
    min_links: int = Field(2, gt=0)
    """Independent ties across a border."""
