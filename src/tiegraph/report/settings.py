"""Settings of the report stage."""

from pydantic import Field

from tiegraph.settings import Section


class ReportSettings(Section):
    """The HTML report."""

    title: str = ""
    """Name of the survey at the top of the report; empty: the name of the run folder."""

    mask_images: int = Field(1, ge=0, le=8)
    """Images shown with their mask for each camera."""

    viewer_points: int = Field(200_000, ge=0, le=3_000_000)
    """Points of the cloud in the interactive view, about 12 bytes of the file each; 0 leaves the view out."""

    view_points: int = Field(4_000_000, ge=10_000, le=100_000_000)
    """Points of the cloud drawn in the static views."""

    view_px: int = Field(1400, ge=400, le=4000)
    """Width of the static cloud views in pixels."""
