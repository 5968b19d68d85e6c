"""Settings of the stage verify."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section


class VerifySettings(Section):
    """Verification of matched pairs by common motions of the rig and loops of frames."""

    method: Literal["auto", "rig", "images", "off"] = "auto"
    """What moves as one: rig (whole frames), images (each for itself), off (keep all), auto (the rig if it holds)."""
    max_error_px: float = Field(4.0, gt=0, le=50)
    """Most a match may lie off the epipolar line of the common motion, pixels at the mean focal length."""
    min_agree: int = Field(12, ge=5, le=1000)
    """Fewest matches of a pair that must agree with the common motion."""
    min_share: float = Field(0.3, gt=0, le=1)
    """Least share of a pair's matches that must agree with the common motion of its two frames."""
    max_loop_deg: float = Field(3.0, gt=0, le=45)
    """Most a rotation may contradict those of its neighbours (loops of frames), degrees; widened when loops are noisy."""
    refine_rig: bool = True
    """Refine the rig's rotations from the matches first when they are off by more than 0.3 degrees."""
