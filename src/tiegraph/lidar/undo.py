"""Poses of scans whose points are in a world: PandaSet's poses.json, or any file of poses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import from_quaternion_wxyz
from tiegraph.scene.posefile import read_poses


def read_scan_poses(path: Path) -> np.ndarray:
    """world_from_scanner (R, 4, 4), a row a scan: TUM, KITTI, or PandaSet's list of {position, heading}.

    Raises InputError for a file that is none of them.
    """
    if path.suffix.lower() != ".json":
        return read_poses(path).poses
    try:
        rows = json.loads(path.read_text())
        place = np.array([[r["position"][c] for c in "xyz"] for r in rows], float)
        turn = np.array([[r["heading"][c] for c in "wxyz"] for r in rows], float)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: no list of poses with position x y z and heading w x y z ({error!r})") from None
    bad = np.flatnonzero(~(np.abs(np.linalg.norm(turn, axis=1) - 1) < 1e-2) | ~np.isfinite(place).all(axis=1))
    if len(bad):
        raise InputError(f"{path}: pose {bad[0]} is none: position {place[bad[0]]}, heading {turn[bad[0]]}")
    return from_quaternion_wxyz(turn, place)
