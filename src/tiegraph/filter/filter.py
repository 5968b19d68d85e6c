"""Pairs that contradict the coarse model are refused, by their matches as bearing vectors, which are read from COLMAP's
database pair by pair, in whichever process needs them.

A wall that repeats along the path gives false matches with the right rotation and on the right epipolar lines, but at
impossible distances.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.atomic import cached_by_file
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.course import off_course_deg
from tiegraph.scene.graph import parts
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import camera_from_dict, camera_to_dict, pixel_rays
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import CourseTuning

_CACHED_IMAGES = 512  # of about 100 kB each, in every worker

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
    def of(database: Path, scene: Scene, most: int) -> "Matches":
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


@cached_by_file(maxsize=2)
def _connection(database: str) -> Rows:
    return Rows(Path(database), any_thread=True)


@cached_by_file(maxsize=_CACHED_IMAGES)
def _rays(database: str, image: int, camera: Camera) -> np.ndarray:
    """(K, 3) unit rays of an image's key points in the sensor frame."""
    points = _connection(database).keypoints_of(image + 1)
    lens = cast(pycolmap.Camera, camera_from_dict(dict(camera)))  # ``Matches.of`` refuses a sensor without one
    return np.nan_to_num(pixel_rays(lens, points)) if len(points) else np.zeros((0, 3))


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


def agreement(pair: tuple[int, int], matches: Matches, prior: Prior, tuning: CourseTuning) -> float:
    """Share of the verified matches of an image pair that a surface within reach explains; NaN without any."""
    i, j = pair
    a, b = matches.rays(i, j)
    if not len(a):
        return float("nan")
    j_from_i = prior.cam_from_world[j] @ transforms.invert(prior.cam_from_world[i])
    off = off_course_deg(a, b, j_from_i, (prior.reach[i], prior.reach[j]), tuning)
    return float(np.mean(off <= tuning.tolerance_deg))


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
    tunings: tuple[Tuning, CourseTuning],
    run_map: Map,
    prior: Prior | None = None,
) -> Filtering:
    """Refuse ("repeat") the kept pairs that contradict the ``prior``, a rough model; the database is read only.

    ``run_map(function, items, *args)`` runs items anywhere. Raises InputError for a missing database or camera.
    """
    kept = pairs.kept()
    refused, notes, tables = np.zeros(len(kept), bool), ("no pair was tested",), {}
    if settings.method != "off" and prior is not None and len(kept):
        forget()
        matches = Matches.of(database, scene, tunings[0].matches_a_pair)
        refused, notes = _by_prior(kept, matches, prior, tunings, run_map)
        forget()
        tables = {"camera pairs": _table(scene, kept, refused)}
    in_table, gone = np.zeros(len(pairs), bool), int(refused.sum())
    in_table[np.flatnonzero(pairs.dropped == 0)[refused]] = True
    counts = {"pairs": len(kept), "kept": len(kept) - gone, "refused": gone}
    return Filtering(pairs=pairs.drop(in_table, "repeat"), counts=counts, notes=notes, tables=tables)


def _by_prior(
    pairs: Pairs, matches: Matches, prior: Prior, tunings: tuple[Tuning, CourseTuning], run_map: Map
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Of each pair (P,) bool whether a rough model refuses it; notes.

    A model that contradicts many pairs is not used, and neither is the relative pose of two parts of it if it
    contradicts all pairs between them.
    """
    tuning, course = tunings
    known, refused = prior.known(), np.zeros(len(pairs), bool)
    rows = np.flatnonzero(known[pairs.i] & known[pairs.j])
    if not len(rows):
        return refused, ("the coarse model has no images of any pair, so none was tested",)
    ends = np.stack([pairs.i[rows], pairs.j[rows]])
    wrong = np.array(run_map(agreement, ends.T.tolist(), matches, prior, course)) < course.min_share
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
