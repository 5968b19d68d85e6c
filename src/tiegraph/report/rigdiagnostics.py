"""The rig: its cameras as adjusted, and along the run where each stands by its own sightings against its place."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.report import formatting
from tiegraph.report.formatting import Table
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.svg.charts import along
from tiegraph.report.texts import t

FILE = ("sparse", "0", "rig_diagnostics.csv")
CAPTION = (
    "Every camera placed by the points that the other cameras made, against its place in the rig, frame by frame. A "
    "rigid, synchronised rig scatters about zero within its band (twice the expected sigma). A constant offset is an "
    "error of the given geometry; one that grows with speed is a camera that fires at another time; scatter beyond the "
    "band is a loose camera."
)
_NUMBERS = ("frame", "right_m", "down_m", "forward_m", "turn_x_deg", "turn_y_deg", "turn_z_deg", "sigma_m", "sigma_deg")


def rig_table(run: RunFolder) -> Table | None:
    """Cameras: model, focal length, place on the rig as refined, and how far that is from the nominal one."""
    if run.scene is None or run.model is None:
        return None
    unit = "mm" if run.metric else "units"
    given = (run.scanned or run.scene).all_sensors
    factor = 1000 if unit == "mm" else 1
    rows = []
    for key, sensor in enumerate(run.scene.all_sensors):
        camera = run.model.cameras.get(key)
        pose, nominal = run.model.sensor_from_rig.get(key), given[key].sensor_from_rig
        from_first = turn = moved = bent = None
        if pose is not None:
            from_first = factor * float(np.linalg.norm(transforms.centre(pose)))
            turn = float(transforms.angle_deg(pose[:3, :3], np.eye(3)))
            if nominal is not None:
                moved = factor * float(np.linalg.norm(transforms.centre(pose) - transforms.centre(nominal)))
                bent = float(transforms.angle_deg(pose[:3, :3], nominal[:3, :3]))
        rows.append([
            sensor.name, camera["model"] if camera else None, camera["size"] if camera else None,
            camera["focal_px"] if camera else None, from_first, turn, moved, bent,
        ])  # fmt: skip
    columns = ["camera", "model", "size px", "focal px", f"to first {unit}", "turned °"]
    columns += [f"moved from nominal {unit}", "turned from it °"]
    filled = [c for c in range(len(columns)) if any(r[c] is not None for r in rows)]
    data = {"columns": [columns[c] for c in filled], "rows": [[r[c] for c in filled] for r in rows]}
    return formatting.table(data, t("Cameras as adjusted"))


def rig_diagnostics(run: RunFolder) -> dict[str, Any] | None:
    """Charts and caption, None without a file of at least two rows."""
    rows = _read(run.path.joinpath(*FILE))
    if len(rows) < 2:
        return None
    kinds = (
        (("right_m", "down_m", "forward_m"), "sigma_m", t("place, m")),
        (("turn_x_deg", "turn_y_deg", "turn_z_deg"), "sigma_deg", t("rotation, degrees")),
    )
    drawn = [along(_series(rows, names, sigma), label, t("Rig diagnostics")) for names, sigma, label in kinds]
    return {"charts": drawn, "caption": t(CAPTION)}


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        with path.open(newline="") as stream:
            return [{**row, **{k: float(row[k]) for k in _NUMBERS}} for row in csv.DictReader(stream)]
    except (OSError, KeyError, ValueError):
        return []


def _series(
    rows: list[dict[str, Any]], names: tuple[str, ...], sigma: str
) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    """(camera, frames, how far it is off, half width of its band) of each camera."""
    out = []
    for camera in dict.fromkeys(r["camera"] for r in rows):
        own = sorted((r for r in rows if r["camera"] == camera), key=lambda r: r["frame"])
        off = np.array([[r[k] for k in names] for r in own])
        # of the three directions, the one that this camera is off most in
        worst = off[:, int(np.argmax(np.median(np.abs(off), axis=0)))]
        frames = np.array([r["frame"] for r in own])
        out.append((camera, frames, worst, 2 * float(np.median([r[sigma] for r in own]))))
    return out
