"""Settings of the preview stage."""

from pydantic import Field

from tiegraph.settings import Section


class PreviewSettings(Section):
    """Low-resolution features: cheap evidence of which images see the same things."""

    size_px: int = Field(400, ge=160, le=1600)
    """Longest side of a reduced 4:3 image, pixels; other shapes get the same area, smaller images are not enlarged."""
    features: int = Field(800, ge=100, le=5000)
    """SIFT features kept an image, spread over it."""
    ratio: float = Field(0.85, gt=0, le=1)
    """A match must be this much closer than the second best (Lowe's ratio test); 1 switches the test off."""
    max_error_px: float = Field(2.5, gt=0, le=20)
    """Largest epipolar error of an inlier, pixels of the reduced image."""
