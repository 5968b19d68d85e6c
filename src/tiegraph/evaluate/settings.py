"""Settings of the evaluate stage."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from tiegraph.settings import Section, user_path


class EvaluateSettings(Section):
    """What the result is measured against; everything is optional."""

    reference: Path | None = user_path("file or folder")
    """Reference poses: a COLMAP model folder (by image name), a TUM file, or a folder of TUM files, one a pass."""

    reference_cloud: Path | None = user_path("file")
    """Reference point cloud (.laz, .las, .ply or .e57), for instance a LiDAR scan."""

    reference_origin: (
        tuple[
            Annotated[float, Field(ge=-90, le=90)],
            Annotated[float, Field(ge=-360, le=360)],
            Annotated[float, Field(ge=-12_000, le=100_000)],
        ]
        | None
    ) = None
    """Latitude, longitude (deg), ellipsoidal height (m) of references given in local east-north-up metres about it; not
    of a cloud whose header names its CRS."""

    alignment: Literal["rigid", "similarity", "none"] = "rigid"
    """How the cloud is laid on the reference: by the matched poses without scale, with scale, or as it is."""

    distances_m: tuple[Annotated[float, Field(gt=0, le=100_000)], ...] = ()
    """Distances (m) at which accuracy, completeness and F-score of the cloud are stated (default: four of the series 1,
    2, 5, 10 from the ground sampling distance on)."""

    range_m: float = Field(50.0, gt=0, le=100_000)
    """Only the part of the reference cloud nearer than this (m) to a registered camera counts for completeness."""

    tolerance_m: float | None = Field(None, gt=0, le=100_000)
    """Accuracy in the world (m) that is asked for: answered yes, no or cannot be told, with what would make it yes."""
