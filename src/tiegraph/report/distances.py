"""What was measured at points and what section they lie in, for the colours of the interactive view."""

from __future__ import annotations

import logging
from pathlib import Path

import laspy
import numpy as np
from scipy.spatial import cKDTree

from tiegraph.report.runfolder import RunFolder
from tiegraph.report.tables import section_name
from tiegraph.report.texts import t
from tiegraph.report.viewer import Scale

log = logging.getLogger(__name__)
_MOST = 1_000_000  # points of a file that are read
_NEAR = 3.0  # a point has the value of a measured one this near, in spacings of these
_SIGNED = ("differences.laz",)
_FILES = {
    "evaluate/distances.laz": "distance to the reference cloud",
    "passes/differences.laz": "one pass against the other",
}


def distance_scales(run: RunFolder, xyz: np.ndarray) -> dict[str, Scale]:
    """Distances that were measured near points (N, 3) of the world, by name; those of files that are there."""
    out = {}
    for name, text in _FILES.items():
        path = run.path / name
        if path.exists() and len(xyz):
            try:
                at, values = _measured(path, np.array((run.world or {}).get("shift_m") or (0.0, 0.0, 0.0), float))
            except Exception as error:  # laspy raises what it meets
                log.warning("report: %s cannot be read and is left out: %s", path, error)
                continue
            if len(at) > 1:
                out[t(text)] = Scale(_nearest(at, values, xyz), signed=path.name in _SIGNED)
    return out


def _measured(path: Path, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 3) of the world and their ``distance_m`` (K,), every n-th of a large file."""
    parts = [(np.zeros((0, 3)), np.zeros(0))]
    with laspy.open(path) as reader:
        step = max(1, -(-reader.header.point_count // _MOST))
        for chunk in reader.chunk_iterator(_MOST):
            part = chunk[::step]
            parts.append((np.column_stack([part.x, part.y, part.z]) - shift, np.asarray(part["distance_m"], float)))
    xyz, values = (np.concatenate(column) for column in zip(*parts))
    known = np.isfinite(values)
    return xyz[known], values[known]


def _nearest(at: np.ndarray, values: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """(N,) the value of the nearest measured point, NaN where none is near."""
    tree = cKDTree(at)
    some = at[:: max(1, len(at) // 5000)]
    reach = _NEAR * float(np.median(tree.query(some, k=2)[0][:, 1]))
    away, row = tree.query(xyz, distance_upper_bound=max(reach, 1e-9))
    return np.where(np.isfinite(away), values[np.minimum(row, len(at) - 1)], np.nan)


def section_scale(run: RunFolder, xyz: np.ndarray) -> dict[str, Scale]:
    """The section that points (N, 3) lie in, that of the nearest camera; {} where there are not several."""
    assert run.scene is not None and run.model is not None
    placed = np.flatnonzero(run.model.placed)
    section = run.scene.section[run.scene.frame[placed]]
    if len(np.unique(section)) < 2 or not len(xyz):
        return {}
    numbers, of_camera = np.unique(section, return_inverse=True)
    names = tuple(section_name(run, int(k)) for k in numbers)
    nearest = cKDTree(run.model.centres[placed]).query(xyz)[1]
    return {t("section"): Scale(of_camera[nearest].astype(float), names=names)}
