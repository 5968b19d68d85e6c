"""Settings of the stage filter."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section


class FilterSettings(Section):
    """View-graph filtering: matched pairs tested by the coarse model and by loops of rotations."""

    method: Literal["auto", "off"] = "auto"
    """auto: pairs of the coarse model by it, others by loops; off: all are kept."""
    max_error_px: float = Field(4.0, gt=0, le=50)
    """Most a match may lie off its epipolar line, pixels at the mean focal length."""
    max_loop_deg: float = Field(3.0, gt=0, le=45)
    """Most the rotation of a pair may contradict that of all others, degrees; widened if loops close badly."""
