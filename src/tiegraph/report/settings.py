"""Settings of the report stage."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section


class About(Section):
    """Client, project and people of a report: the fields of its first page; empty ones are lines to write on."""

    client: str = ""
    """The client of the survey."""

    project: str = ""
    """Name or number of the project."""

    equipment: str = ""
    """Cameras, vessel or vehicle, receiver."""

    surveyor: str = ""
    """Person responsible for the survey; the name is below the line of the signature."""


class ReportSettings(Section):
    """The HTML report."""

    title: str = ""
    """Name of the survey at the top of the report; empty: the name of the run folder."""

    about: About = About()
    """Client, project, equipment and surveyor on the first page: a table [report.about]."""

    language: Literal["en", "ja"] = "en"
    """Language of the report: en or ja. Remarks and warnings that stages wrote stay English."""

    mask_images: int = Field(1, ge=0, le=8)
    """Images shown with their mask for each camera."""

    viewer_points: int = Field(200_000, ge=0, le=3_000_000)
    """Points of the cloud in the interactive view, about 12 bytes of the file each; 0 leaves the view out."""
