"""Settings of the masks stage."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from tiegraph.plugins import or_plugin
from tiegraph.settings import Section, user_path

SourceName = Literal["auto", "learnt", "meguro2025", "meguro2024", "sky", "model", "folder", "marks", "none"]


class MasksSettings(Section):
    """The pixels of an image that may become features and depths."""

    source: Annotated[SourceName | str, or_plugin("masks", SourceName)] = "auto"
    """Source of masks: learnt = platform, sky and water learnt from the whole sequence; meguro2025 = similar
    parts of first and last frame, sky, overexposure (paper 001); meguro2024 = equal parts of first and last frame
    (paper 000); sky = only sky and overexposure; model = your segmentation model; folder = your masks;
    marks = what stands still in all images of a camera: text, scales, dirt; none = all is used;
    auto = folder if given, else learnt for rigs on a path, else marks."""

    folder: Path | None = user_path("folder")
    """Folder of your own masks; for up/cam0/a.jpg the first of up/cam0/a.jpg.png, up/cam0/a_mask.png, up/cam0/a.png, or
    one mask a camera: up/cam0.png, cam0.png. 0 = ignore, 255 or 1 = use; the size of the image."""

    keep_labels: tuple[Annotated[int, Field(ge=0, le=65535)], ...] = ()
    """Label values to use, if the folder contains class labels instead of masks; all other labels are ignored."""

    model: Path | None = user_path("file")
    """TOML file of your segmentation model: onnx = file, size = [width, height], mean, deviation, and [classes] with
    its labels for sky, water, platform, overexposed. Needs ONNX Runtime: pip install 'tiegraph[onnx]'."""

    difference: int = Field(default=8, ge=1, le=254)
    """meguro2024: pixels that differ less than this between the two frames are masked (grey levels, 255 = white)."""

    similarity: float = Field(default=0.6, gt=0, lt=1)
    """meguro2025: pixels whose structural similarity (SSIM, 1 = equal) between the two frames is higher are masked."""

    sky_edge: float = Field(default=8.0, gt=0, le=255)
    """meguro2025, sky: from the top of the image down to the first edge this strong is sky (grey levels a pixel)."""

    overexposed: int = Field(default=250, ge=128, le=255)
    """learnt, meguro2025, sky: pixels at least this bright are masked (grey levels, 255 = white)."""

    water: Literal["auto", "on", "off"] = "auto"
    """learnt: auto = water is masked if three or more cameras of a rig show it; on = if any camera does (a single
    forward camera cannot distinguish it from a road passed fast); off = never."""

    leave_out: Literal["none", "blurred", "similar", "both"] = "none"
    """Flagged images that are left out of everything: much more blurred than their neighbours, or hardly different from
    the image before. They are flagged in masks.csv and in the report in any case."""

    @model_validator(mode="after")
    def _folder_goes_with_source(self) -> "MasksSettings":
        if self.source == "folder" and self.folder is None:
            raise ValueError("source = folder needs the setting folder: where the masks are")
        if self.source == "model" and self.model is None:
            raise ValueError("source = model needs the setting model: the TOML file of your segmentation model")
        if self.folder is not None and self.source not in ("folder", "auto"):
            raise ValueError(f"folder is given, but source = {self.source} does not read it: omit one of them")
        if self.keep_labels and self.folder is None:
            raise ValueError("keep_labels needs the setting folder: where the label images are")
        return self


class RefineSettings(Section):
    """Final masks, for depth maps: the first ones corrected by water and horizon of the model."""

    geometry: Literal["auto", "off"] = "auto"
    """auto = masks that know sky and water are corrected by the waterline and the horizon of the model, if its cameras
    define the vertical; off = the first masks are the final ones."""
