"""Settings of the stages candidates, coarse and network."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from tiegraph.plugins import or_plugin
from tiegraph.settings import Section, user_path

SourceName = Literal["auto", "sequence", "exhaustive", "file", "offsets", "poses", "retrieval"]


class CandidatesSettings(Section):
    """Sources of candidate pairs, and their tests."""

    sources: tuple[Annotated[SourceName | str, or_plugin("pairs", SourceName)], ...] = Field(("auto",), min_length=1)
    """Pair sources, merged; auto: sequence and offsets for passes, poses where priors are known, exhaustive for few
    loose photographs, previews for many."""
    pairs_file: Path | None = user_path("file")
    """COLMAP pair list (two image names a line) for the source file."""
    sequence_frames: int = Field(2, ge=0, le=1000)
    """Source sequence: number of following frames of the same camera to which every image is tied."""
    sequence_cameras: bool = False
    """Source sequence: also tie neighbouring cameras of the rig over these frames."""
    offsets: Literal["local", "constant"] = "local"
    """Source offsets: the best frame offset is followed along the pass (local), or one holds for each camera pair
    (constant, as in papers 000 and 001)."""
    offset_range: int = Field(5, ge=0, le=1000)
    """Constant offsets: number of frames on either side of the best offset that are candidates."""
    offset_best: int = Field(0, ge=0, le=100)
    """Constant offsets: best matching frames that an image keeps for each camera, by preview (paper 000); 0 keeps the
    whole range."""
    sample_frames: int = Field(12, ge=2, le=200)
    """Frames of a pass on which the offsets are voted."""
    min_matches: int = Field(12, ge=6, le=500)
    """Preview matches from which two images count as tied, averaged over neighbouring frames; chance gives 10."""
    min_overlap: float = Field(0.1, ge=0.01, le=0.9)
    """Share of the surface seen by one image that another must see too to be its candidate, where the coarse model or
    poses predict it."""
    axes_deg: float = Field(110.0, ge=10, le=180)
    """Largest angle, degrees, at which two views of a surface match: cameras of one pass whose axes are further apart
    are not matched, except pairs whose rays meet at a smaller angle in the coarse model."""
    range_m: float = Field(0.0, ge=0, le=100_000)
    """Source poses: typical distance from camera to surface (paper 003), metres; 0 = ten times the distance between
    frames."""

    @model_validator(mode="after")
    def _file_goes_with_source(self) -> "CandidatesSettings":
        if self.pairs_file is not None and "file" not in self.sources:
            said = " ".join(self.sources)
            raise ValueError(
                f"pairs_file is given, but sources = {said} does not use it: add file, or leave pairs_file out"
            )
        return self

    def uses_axes(self) -> bool:
        """Whether a source uses the axes of the cameras: offsets does."""
        return bool({"auto", "offsets"} & set(self.sources))


class CoarseSettings(Section):
    """The coarse model: a reconstruction of the survey from previews, which predicts shared surface of images."""

    method: Literal["mapper", "off"] = "mapper"
    """mapper: the best previews are mapped, and the model predicts which images see the same surface; off: the
    numbers of preview matches decide alone."""
    pairs_per_image: int = Field(8, ge=2, le=100)
    """Best pairs of each image of which the model is made."""


class NetworkSettings(Section):
    """The final candidate pairs: sections of the survey."""

    sections: Literal["off", "link", "split", "meguro2025"] = "link"
    """Bridge and open sections by the light in the up camera: not cut (off), cut with ties between them (link),
    mapped separately, joined by the matches between them and adjusted together (split), or separated by the
    brightness of the up camera's pixels alone, without a match between them (meguro2025, paper 001)."""
