"""A COLMAP database of previews: what a small model of the survey is made from."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.features.database import DATABASE_BYTES, create_database
from tiegraph.features.preview import Preview
from tiegraph.limits import need_room
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties

_POINT_BYTES = 24  # of a key point in the database
_MATCH_BYTES = 8  # of each end of a match: it is there twice, as a match and as an inlier


def write_preview_database(
    path: Path, scene: Scene, previews: Iterable[Preview], ties: Ties, min_matches: int
) -> np.ndarray:
    """Database of the scene with the previews' key points (full-resolution pixels) and their ties as verified matches.

    Ties of fewer than ``min_matches`` are left out; returns (T,) bool, which ties were written. Raises InputError for a
    sensor without a camera or a full disk.
    """
    create_database(path, scene)
    used = ties.counts() >= min_matches
    points = len(scene) * (1 + int(ties.matches.max(initial=0))) * _POINT_BYTES
    need_room(path.with_name(path.name + ".room"), DATABASE_BYTES + 2 * (points + ties.matches.size * _MATCH_BYTES))
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for k, preview in enumerate(previews):
            database.write_keypoints(k + 1, np.ascontiguousarray(preview.xy, np.float32))
        for t in np.flatnonzero(used):
            i, j = int(ties.i[t]) + 1, int(ties.j[t]) + 1
            matches = ties.of(int(t)).astype(np.uint32)
            database.write_matches(i, j, matches)
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
            geometry.inlier_matches = matches
            database.write_two_view_geometry(i, j, geometry)
    return used
