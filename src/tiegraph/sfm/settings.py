"""Settings of the sparse and georef stages."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from tiegraph.settings import Section, user_path


class SparseSettings(Section):
    """How the images become a model: poses, points and cameras (COLMAP)."""

    mapper: Literal["auto", "incremental", "global"] = "auto"
    """Mapper: incremental, global (GLOMAP); auto = start from the coarse model, or choose by rig and number of
    images."""

    rig: Literal["auto", "fixed", "refined", "absent"] = "auto"
    """Rig: fixed = as given, refined = adjusted with the model, absent = ignored, auto = fixed if calibrated."""

    seed: int = Field(default=0, ge=0, le=2**31 - 10)
    """Seed of the mapper's random choices: another seed gives another of the models that the same matches allow."""

    use_positions: bool = True
    """Use GNSS, EXIF or trajectory positions in the incremental mapper; every fifth is kept back as a check."""

    refine_intrinsics: Literal["auto", "yes", "no"] = "auto"
    """Adjust focal length, principal point and distortion; auto = yes, except for calibrated cameras."""

    readout_ms: float | None = Field(default=None, ge=-200, le=200)
    """Rolling shutter of all cameras: milliseconds from the first row of an image to the last (negative: from the
    last to the first); 0 = none; default: estimated where frames have times."""

    min_matches: int = Field(default=15, ge=4, le=1000)
    """Pairs with fewer verified matches are not used."""

    covariance_frames: int = Field(default=3000, ge=0, le=50000)
    """Largest model, in frames, for which sigmas are computed from the bundle adjustment (0 = never): time and
    memory."""


class GeorefSettings(Section):
    """How the model is put into the world."""

    gcp: Path | None = user_path("file")
    """Ground control and check points, also given by --gcp: ODM's gcp_list.txt, or a CSV. Its points have the columns
    name, x, y, z (or name, lat, lon, height; and, if known, sigma_xy, sigma_z, role: gcp or check), its marks the
    columns name, image, px, py: in one table, in two tables with a header each, or in two files (see marks)."""

    marks: Path | None = user_path("file")
    """The marks of the points (name, image, px, py), where they are a file of their own; also given by --marks."""

    antenna: Literal["auto", "given", "estimated", "ignored"] = "auto"
    """GNSS lever arm: as the rig file gives it, estimated, or ignored; auto = given, else estimated if observable."""

    adjust: Literal["auto", "yes", "no"] = "auto"
    """Bundle adjustment with positions and control points, against drift; auto = kept if the held-out check agrees."""
