"""What is told of a run beside the LiDAR: the rows of paper 001's tables 1 and 3 to 5, and the hand-eye calibration."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.lidar.handeye import HandEye

_NAN = float("nan")


@dataclass(frozen=True)
class Column:
    """One column of the table: the whole survey or a section. ``surface_m``: of the cloud along the normals of the
    LiDAR's map (M3C2), median and spread; ``cloud_m``: distances to the nearest point of the map, median and 90 %,
    which grow with the gaps between its rings; ``rmse_m``: of the frames' positions against the LiDAR's trajectory."""

    name: str
    images: int
    used: int
    points: int = 0
    seconds: dict[str, float] | None = None  # of mask, SfM, MVS, overall processing
    frames: int = 0  # with a pose of the LiDAR
    rmse_m: float = _NAN
    scale: float = _NAN
    surface_m: tuple[float, float] = (_NAN, _NAN)
    cloud_m: tuple[float, float] = (_NAN, _NAN)


TIMES = ("Mask processing", "SfM", "MVS", "Overall processing")


def survey_table(columns: list[Column]) -> dict[str, Any]:
    """{"columns", "rows"}: the rows as paper 001 names them."""
    rows: list[list[Any]] = [
        *([f"{time} [s]", *((c.seconds or {}).get(time, _NAN) for c in columns)] for time in TIMES),
        ["The number of input images", *(c.images for c in columns)],
        ["The number of used images", *(c.used for c in columns)],
        ["The number of points after MVS", *(c.points for c in columns)],
        ["RMSE of positions against the LiDAR [m]", *(c.rmse_m for c in columns)],
        ["frames with a pose of the LiDAR", *(c.frames for c in columns)],
        ["scale against the LiDAR", *(c.scale for c in columns)],
        ["cloud along the LiDAR's surfaces (M3C2), median [m]", *(c.surface_m[0] for c in columns)],
        ["cloud along the LiDAR's surfaces (M3C2), spread [m]", *(c.surface_m[1] for c in columns)],
        ["cloud to the LiDAR's nearest point, median [m]", *(c.cloud_m[0] for c in columns)],
        ["cloud to the LiDAR's nearest point, 90 % [m]", *(c.cloud_m[1] for c in columns)],
    ]
    known = [r for r in rows if any(np.isfinite(v) for v in r[1:])]
    return {"columns": ["", *(c.name for c in columns)], "rows": known}


def hand_eye_table(found: HandEye) -> dict[str, Any]:
    """{"columns", "rows"}: value and sigma of each parameter."""
    place = found.rig_from_lidar[:3, 3]
    rows = [["clock offset [s]", found.clock_s, found.clock_sigma_s]]
    rows += [[f"lever arm {a} [m]", v, s] for a, v, s in zip("xyz", place, found.place_sigma_m)]
    rows += [[f"turn about {a} [deg]", _NAN, s] for a, s in zip("xyz", found.turn_sigma_deg)]
    rows.append(["scale", found.scale, found.scale_sigma])
    return {"columns": ["LiDAR on the rig", "value", "sigma"], "rows": rows}
