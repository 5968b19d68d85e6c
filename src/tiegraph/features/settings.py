"""Settings of the stages preview, features and match."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from tiegraph.plugins import or_plugin
from tiegraph.settings import Section, user_path

EngineName = Literal["opencv", "onnx"]
MatcherName = Literal["nearest"]


class PreviewSettings(Section):
    """Low-resolution features: cheap evidence of which images show the same scene."""

    size_px: int = Field(400, ge=160, le=1600)
    """Longest side of a reduced 4:3 image, pixels; other shapes get the same area, smaller images are not enlarged."""
    features: int = Field(800, ge=100, le=5000)
    """SIFT features kept an image, spread over it."""
    ratio: float = Field(0.85, gt=0, le=1)
    """A match must be this much closer than the second best (Lowe's ratio test); 1 switches the test off."""
    max_error_px: float = Field(2.5, gt=0, le=20)
    """Largest epipolar error of an inlier, pixels of the reduced image."""


__all__ = ["FeaturesSettings", "MatchSettings", "PreviewSettings"]


class FeaturesSettings(Section):
    """Features at full resolution, for the model."""

    engine: Annotated[EngineName | str, or_plugin("features", EngineName)] = "opencv"
    """opencv = SIFT; onnx = learned features by a network, of the file that is given as model."""
    model: Path | None = user_path("file")
    """ONNX file of a network as COLMAP publishes them for ALIKED (aliked-n16rot.onnx, aliked-n32.onnx). Needs ONNX
    Runtime: pip install 'tiegraph[onnx]'."""
    max_features: int = Field(12288, ge=64, le=65536)
    """Most features kept in an image of 4.5 megapixels or more, the clearest first; smaller ones keep fewer in
    proportion, but a third at least."""
    max_image_size: int = Field(3200, ge=64, le=20000)
    """Longer side in pixels above which an image is shrunk for the search; positions are scaled back."""
    contrast: float = Field(0.02, gt=0, le=0.2)
    """Least contrast of a feature (grey range 0 to 1, Lowe's threshold): lower finds more in weak texture."""

    @model_validator(mode="after")
    def _model_goes_with_engine(self) -> "FeaturesSettings":
        if self.engine == "onnx" and self.model is None:
            raise ValueError("engine = onnx needs the setting model: the ONNX file of the network")
        if self.model is not None and self.engine != "onnx":
            raise ValueError(
                f"model is given, but engine = {self.engine} does not read it: omit it or set engine = onnx"
            )
        return self


class MatchSettings(Section):
    """Matching at full resolution and verification of the listed pairs."""

    engine: Annotated[MatcherName | str, or_plugin("matchers", MatcherName)] = "nearest"
    """nearest = mutual nearest descriptors; COLMAP verifies what is found."""
    max_ratio: float = Field(0.8, gt=0, le=1)
    """Most a match's distance may be of the second best one's (Lowe's ratio test)."""
    max_error_px: float = Field(4.0, gt=0, le=50)
    """Most a verified match may lie off its epipolar line or homography, pixels."""
    min_inliers: int = Field(15, ge=7, le=1000)
    """Fewest verified matches of a pair; a pair with fewer is dropped."""
    guided: bool = False
    """Match again along the epipolar lines once a pair is verified: more matches, about twice the time."""
    stationary: bool = False
    """Remove matches at the same pixel in both images (the platform itself). Not for a platform that ever stops."""

    @model_validator(mode="after")
    def _guided_by_colmap(self) -> "MatchSettings":
        if self.guided and self.engine != "nearest":
            raise ValueError(f"guided matching is COLMAP's own: omit guided, or engine = {self.engine}")
        return self
