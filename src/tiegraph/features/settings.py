"""Settings of the stages preview, features and match."""

from typing import Literal

from pydantic import Field

from tiegraph.features.preview_settings import PreviewSettings
from tiegraph.settings import Section

__all__ = ["FeaturesSettings", "MatchSettings", "PreviewSettings"]


class FeaturesSettings(Section):
    """Features at full resolution, for the model."""

    engine: Literal["opencv", "colmap"] = "opencv"
    """Who extracts SIFT: opencv (fast), or colmap (its own extractor, several times slower on a CPU)."""
    max_features: int = Field(4096, ge=64, le=65536)
    """Most features kept in an image, strongest first."""
    max_image_size: int = Field(3200, ge=64, le=20000)
    """Longer side in pixels above which an image is shrunk for the search; positions are scaled back."""
    contrast: float = Field(0.02, gt=0, le=0.2)
    """Least contrast of a feature (grey range 0 to 1, Lowe's threshold): lower finds more in weak texture."""


class MatchSettings(Section):
    """Matching at full resolution and verification of the listed pairs."""

    max_ratio: float = Field(0.8, gt=0, le=1)
    """Most a match's distance may be of the second best one's (Lowe's ratio test)."""
    max_error_px: float = Field(4.0, gt=0, le=50)
    """Most a verified match may lie off its epipolar line or homography, pixels."""
    min_inliers: int = Field(15, ge=7, le=1000)
    """Fewest verified matches of a pair; a pair with fewer is dropped."""
    guided: bool = False
    """Match again along the epipolar lines once a pair is verified: more matches, about twice the time."""
    stationary: bool = False
    """Throw out matches at the same pixel in both images (the platform itself). Not for a platform that ever stops."""
