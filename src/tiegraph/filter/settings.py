"""Settings of the stage filter."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section


class FilterSettings(Section):
    """View-graph filtering: matched pairs tested by common motions of the rig and loops of frames."""

    method: Literal["auto", "rig", "images", "off"] = "auto"
    """What moves as one: rig (whole frames), images (each for itself), off (keep all), auto (the rig if it holds)."""
    max_error_px: float = Field(4.0, gt=0, le=50)
    """Most a match may lie off the epipolar line of the common motion, pixels at the mean focal length."""
    max_loop_deg: float = Field(3.0, gt=0, le=45)
    """Most a rotation may contradict loops of frames, degrees; widened when loops are noisy."""
