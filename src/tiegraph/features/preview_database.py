"""A COLMAP database of previews: what a small model of the survey is made from."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tiegraph.features.preview import Preview
from tiegraph.limits import need_room
from tiegraph.scene.colmaprows import DATABASE_BYTES, create_database, write_ties
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.scene import Scene

_POINT_BYTES = 24  # of a key point in the database
_MATCH_BYTES = 8  # of each end of a match: it is there twice, as a match and as an inlier


def write_preview_database(
    path: Path, scene: Scene, previews: Iterable[Preview], ties: PreviewMatches, min_matches: int
) -> np.ndarray:
    """Database of the scene with the previews' key points (full-resolution pixels) and their ties as verified matches.

    Ties of fewer than ``min_matches`` are left out; returns (T,) bool, which ties were written. Raises InputError for a
    sensor without a camera or a full disk.
    """
    create_database(path, scene)
    used = ties.counts() >= min_matches
    points = len(scene) * (1 + int(ties.matches.max(initial=0))) * _POINT_BYTES
    need_room(path.with_name(path.name + ".room"), DATABASE_BYTES + 2 * (points + ties.matches.size * _MATCH_BYTES))
    write_ties(path, (preview.xy for preview in previews), ties, used)
    return used
