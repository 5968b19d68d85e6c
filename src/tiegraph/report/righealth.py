"""Rig health along the run: where each camera stands by its own sightings against where the rig puts it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from tiegraph.report.artefacts import RunFolder
from tiegraph.report.charts import PASSES, figure_axes, saved

FILE = ("sparse", "0", "rig_health.csv")
CAPTION = (
    "Every camera placed by the points that the other cameras made, against its place in the rig, frame by frame. A "
    "rigid, synchronised rig scatters about zero within its band (twice the expected sigma). A constant offset is an "
    "error of the given geometry; one that grows with speed is a camera that fires at another time; scatter beyond the "
    "band is a loose camera."
)
_NUMBERS = ("frame", "right_m", "down_m", "forward_m", "turn_x_deg", "turn_y_deg", "turn_z_deg", "sigma_m", "sigma_deg")


def rig_health(run: RunFolder) -> dict[str, Any] | None:
    """Chart and caption, None without a file of at least two rows."""
    rows = _read(run.path.joinpath(*FILE))
    if len(rows) < 2:
        return None
    return {"chart": _chart(rows), "caption": CAPTION}


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        with path.open(newline="") as stream:
            return [{**row, **{k: float(row[k]) for k in _NUMBERS}} for row in csv.DictReader(stream)]
    except (OSError, KeyError, ValueError):
        return []


def _chart(rows: list[dict[str, Any]]) -> str:
    figure, axes = figure_axes(3.6, 2)
    cameras = list(dict.fromkeys(r["camera"] for r in rows))
    kinds = (
        (("right_m", "down_m", "forward_m"), "sigma_m", "place, m"),
        (("turn_x_deg", "turn_y_deg", "turn_z_deg"), "sigma_deg", "rotation, degrees"),
    )
    for ax, (names, sigma, label) in zip(axes, kinds):
        for n, camera in enumerate(cameras):
            own = sorted((r for r in rows if r["camera"] == camera), key=lambda r: r["frame"])
            frame = np.array([r["frame"] for r in own])
            off = np.array([[r[k] for k in names] for r in own])
            # of the three directions, the one that this camera is off most in
            worst = off[:, int(np.argmax(np.median(np.abs(off), axis=0)))]
            colour = PASSES[n % len(PASSES)]
            ax.plot(frame, worst, ".-", ms=4, lw=0.9, color=colour, label=camera)
            band = 2 * float(np.median([r[sigma] for r in own]))
            ax.axhspan(-band, band, color=colour, alpha=0.05, lw=0)
        ax.axhline(0, color="#8b949e", lw=0.8)
        ax.set_xlabel("frame")
        ax.set_ylabel(label)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        most = float(np.percentile([abs(r[k]) for r in rows for k in names], 98))
        ax.set_ylim(-1.3 * most - 1e-6, 1.3 * most + 1e-6)
    axes[0].legend(frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0, 1.0), fontsize=8)
    return saved(figure)
