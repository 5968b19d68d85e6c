"""Pairs that contradict the coarse model are refused, by their matches as bearing vectors, which are read from COLMAP's
database pair by pair, in whichever process needs them.

A wall that repeats along the path gives false matches with the right rotation and on the right epipolar lines, but at
impossible distances. What else is false contradicts the model that the mapper makes, which leaves it out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import PriorTuning, Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.atomic import cached_by_file
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.graph import parts
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import camera_from_dict, camera_to_dict, pixel_rays
from tiegraph.scene.scene import Scene

Map = Callable[..., list[Any]]  # (function, items, *args) -> results in the order of the items

Camera = tuple[tuple[str, object], ...]  # items of ``camera_to_dict``, so that rays can be cached by it


@dataclass(frozen=True)
class Matches:
    """The verified matches of a database, in a form that can be sent to other processes: the camera of each sensor, and
    the sensor (N,) of each image; of a pair at most ``most`` matches are read, spread evenly."""

    database: str
    cameras: tuple[Camera, ...]
    sensor: np.ndarray
    most: int

    @staticmethod
    def of(database: Path, scene: Scene, most: int) -> Matches:
        """Those of a scene. Raises InputError for a sensor without a camera."""
        cameras = []
        for k, sensor in enumerate(scene.all_sensors):
            if sensor.camera is None:
                raise InputError(f"sensor {k} has no camera: no image of it was found, remove it from the rig")
            said = camera_to_dict(sensor.camera) or {}
            cameras.append(tuple(sorted((n, tuple(v) if isinstance(v, list) else v) for n, v in said.items())))
        return Matches(str(database), cameras=tuple(cameras), sensor=np.asarray(scene.sensor_key), most=most)

    def rays(self, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Unit rays (K, 3), (K, 3) of the matches of images i and j in the frames of their sensors."""
        matches = _connection(self.database).verified_of(i + 1, j + 1)
        if len(matches) > self.most:
            matches = matches[np.linspace(0, len(matches) - 1, self.most).astype(int)]
        rays = (_rays(self.database, k, self.cameras[self.sensor[k]]) for k in (i, j))
        first, second = (own[matches[:, side]] for side, own in enumerate(rays))
        return first, second


def _camera(camera: Camera) -> pycolmap.Camera:
    made = camera_from_dict(dict(camera))
    assert made is not None
    return made


@cached_by_file(maxsize=2)
def _connection(database: str) -> Rows:
    return Rows(Path(database), any_thread=True)


@cached_by_file(maxsize=512)  # 100 kB each, in every worker
def _rays(database: str, image: int, camera: Camera) -> np.ndarray:
    """(K, 3) unit rays of an image's key points in the sensor frame."""
    points = _connection(database).keypoints_of(image + 1)
    return np.nan_to_num(pixel_rays(_camera(camera), points)) if len(points) else np.zeros((0, 3))


def forget() -> None:
    """Close the database and drop cached rays of this process."""
    _connection.cache_clear()
    _rays.cache_clear()


@dataclass(frozen=True)
class Prior:
    """A rough model: cam_from_world (N, 4, 4), NaN = not there or not trusted; reach (N, 2): nearest and farthest
    points each image sees, same units."""

    cam_from_world: np.ndarray
    reach: np.ndarray

    def known(self) -> np.ndarray:
        """(N,) bool: images it can judge."""
        return np.all(np.isfinite(self.cam_from_world), axis=(1, 2)) & np.all(np.isfinite(self.reach), axis=1)


def agreement(pair: tuple[int, int], matches: Matches, prior: Prior, tuning: PriorTuning) -> float:
    """Share of the verified matches of an image pair that a surface within reach explains; NaN without any."""
    i, j = pair
    a, b = matches.rays(i, j)
    if not len(a):
        return float("nan")
    j_from_i = prior.cam_from_world[j] @ transforms.invert(prior.cam_from_world[i])
    off = off_course_deg(a, b, j_from_i, prior.reach[i], tuning)
    back = off_course_deg(b, a, transforms.invert(j_from_i), prior.reach[j], tuning)
    return float(np.mean(np.maximum(off, back) <= tuning.tolerance_deg))


def off_course_deg(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: np.ndarray, tuning: PriorTuning
) -> np.ndarray:
    """(M,) least angle in degrees between rays b (M, 3) and where the points on rays a (M, 3), at all distances within
    ``reach`` (2,) times ``margin``, would be seen."""
    near, far = reach[0] / tuning.margin, reach[1] * tuning.margin
    distance = np.geomspace(near, far, tuning.steps)
    course = distance[:, None, None] * (a @ b_from_a[:3, :3].T) + b_from_a[:3, 3]  # (steps, M, 3)
    course /= np.maximum(np.linalg.norm(course, axis=2, keepdims=True), 1e-12)
    along = np.diff(course, axis=0)
    share = np.sum((b - course[:-1]) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-18)
    nearest = course[:-1] + np.clip(share, 0, 1)[..., None] * along
    nearest /= np.linalg.norm(nearest, axis=2, keepdims=True)
    cosine = np.max(np.sum(nearest * b, axis=2), axis=0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@dataclass(frozen=True)
class Filtering:
    """The pair table with reason "repeat"; figures by name, notes and tables for people."""

    pairs: Pairs
    counts: dict[str, int]
    notes: tuple[str, ...]
    tables: dict[str, dict]


def filter_pairs(
    database: Path,
    scene: Scene,
    pairs: Pairs,
    settings: FilterSettings,
    tuning: Tuning,
    run_map: Map,
    prior: Prior | None = None,
) -> Filtering:
    """Refuse ("repeat") the kept pairs that contradict ``prior``, a rough model; the database is read only.

    ``run_map(function, items, *args)`` runs items anywhere. Raises InputError for a missing database or camera.
    """
    kept = pairs.kept()
    if settings.method == "off" or prior is None or not len(kept):
        counts = {"pairs": len(kept), "kept": len(kept), "refused": 0}
        return Filtering(pairs, counts, notes=("no pair was tested",), tables={})
    forget()
    matches = Matches.of(database, scene, tuning.matches_a_pair)
    refused, notes = _by_prior(kept, matches, prior, tuning.prior, run_map)
    forget()
    gone = np.zeros(len(pairs), bool)
    gone[np.flatnonzero(pairs.dropped == 0)[refused]] = True
    count = int(refused.sum())
    return Filtering(
        pairs=pairs.drop(gone, "repeat"),
        counts={"pairs": len(kept), "kept": len(kept) - count, "refused": count},
        notes=notes,
        tables={"camera pairs": _table(scene, kept, refused)},
    )


def _by_prior(
    pairs: Pairs, matches: Matches, prior: Prior, tuning: PriorTuning, run_map: Map
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Of each pair (P,) bool whether a rough model refuses it; notes.

    A model that contradicts many pairs is not used, and neither is the relative pose of two parts of it if it
    contradicts all pairs between them.
    """
    known = prior.known()
    refused = np.zeros(len(pairs), bool)
    rows = np.flatnonzero(known[pairs.i] & known[pairs.j])
    if not len(rows):
        return refused, ()
    ends = np.stack([pairs.i[rows], pairs.j[rows]])
    wrong = np.array(run_map(agreement, ends.T.tolist(), matches, prior, tuning)) < tuning.min_share
    said = f"the coarse model agrees with {len(rows) - int(wrong.sum())} of {len(rows)} pairs"
    if wrong.mean() > tuning.max_refused:
        return refused, (f"{said}: too few, so it is not used",)
    asked_of, wrong_of = (np.bincount(e.ravel(), minlength=len(known)) for e in (ends, ends[:, wrong]))
    misplaced = wrong_of > tuning.max_refused_image * asked_of
    if misplaced.any():
        said += f"; it has {int(misplaced.sum())} images at a wrong place, whose pairs it does not judge"
        placed = ~misplaced[ends].any(axis=0)
        rows, wrong, ends = rows[placed], wrong[placed], ends[:, placed]
    part = parts(ends[0, ~wrong], ends[1, ~wrong], len(known))
    alone = wrong & (part[ends[0]] != part[ends[1]])
    if alone.any():
        said += f"; {int(alone.sum())} of the others are the only ties of parts of it, and are not refused by it"
        rows, wrong = rows[~alone], wrong[~alone]
    refused[rows[wrong]] = True
    return refused, (said,)


def _table(scene: Scene, kept: Pairs, refused: np.ndarray) -> dict:
    """Pairs and refused ones by camera pair."""
    names = [s.name for s in scene.all_sensors]
    keys = np.sort(np.stack([scene.sensor_key[kept.i], scene.sensor_key[kept.j]], axis=1), axis=1)
    found, place = np.unique(keys, axis=0, return_inverse=True)
    asked = np.bincount(place.ravel(), minlength=len(found))
    gone = np.bincount(place.ravel(), weights=refused, minlength=len(found)).astype(int)
    rows = [[names[a], names[b], int(n), int(g)] for (a, b), n, g in zip(found, asked, gone)]
    return {"columns": ["camera", "camera", "pairs", "refused"], "rows": rows}
