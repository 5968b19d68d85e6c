"""Which files of a folder have arrived whole, while they are still being copied; where the new frames are, by points
that posed images tied to them see (resection), until the next model says it; and what the page draws of all, seen from
above: levelled by the cameras, turned by positions if there are some."""

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import levelled
from tiegraph.geometry.transforms import level_umeyama, normal_matrices, robust_umeyama
from tiegraph.scene.images import find_images, searched
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.rig import Rig, pixel_rays
from tiegraph.scene.scene import Scene
from tiegraph.watch.tuning import ArrivalsTuning


@dataclass
class _File:
    """What is known of a file: size and time of change, since when (s), and how often it was handed out so."""

    stamp: tuple[int, int]
    since: float
    tries: int = 0
    due: float = 0.0  # when a broken one is handed out again
    whole: bool = False


class Arrivals:
    """The image files below a folder, each handed out when it has settled, and again when it has changed."""

    def __init__(self, folder: Path, tuning: ArrivalsTuning) -> None:
        self.folder, self._tuning = folder, tuning
        self.trouble = ""  # why the folder cannot be looked into now
        self._files: dict[str, _File] = {}

    @property
    def root(self) -> Path:
        """The folder that names are relative to."""
        return searched(self.folder)

    def waiting(self) -> int:
        """Files that are there and were not handed out as they are now."""
        return sum(not f.tries for f in self._files.values())

    def look(self, now: float) -> list[str]:
        """Names of files to open, in the order they came. Never raises: a folder that is gone is ``trouble``."""
        try:
            names = find_images(self.folder)
            self.trouble = ""
        except (InputError, OSError) as error:
            there = os.path.isdir(self.folder)
            self.trouble = str(error) if there else f"{self.folder} is gone (card pulled out, share lost?)"
            return []
        root = self.root
        ready = []
        for name in names:
            try:
                info = (root / name).stat()
            except OSError:  # gone since the folder was listed
                continue
            if self._is_ready(name, (info.st_size, info.st_mtime_ns), now):
                ready.append(name)
        return sorted(ready, key=lambda name: (self._files[name].stamp[1], name))

    def _is_ready(self, name: str, stamp: tuple[int, int], now: float) -> bool:
        file = self._files.get(name)
        if file is None or file.stamp != stamp:
            self._files[name] = _File(stamp, now)
            return self._tuning.settled_s == 0
        if file.whole or now - file.since < self._tuning.settled_s:
            return False
        return file.tries == 0 or (file.tries < self._tuning.tries and now >= file.due)

    def opened(self, name: str, whole: bool, now: float) -> None:
        """What became of a file that was handed out."""
        file = self._files[name]
        file.whole, file.tries = whole, file.tries + 1
        file.due = now + self._tuning.again_s * 2 ** (file.tries - 1)

    def came(self, name: str) -> float:
        """When a file was first seen as it is now, s."""
        return self._files[name].since


_PARTNERS = 16  # images with a pose, of those tied to a frame most, whose ties give its points
_LEAST_ANGLE_DEG = 1.5  # between the rays of a point: an error of a pixel of a preview is 0.1 to 0.2 degrees
_RAY_DEG = 0.5  # between a ray of a point and the point: three pixels of a preview of 400 pixels and 70 degrees
LEAST_POINTS = 12
"""Points that a frame's pose needs."""

Resect = Callable[[Rig, np.ndarray, np.ndarray, np.ndarray], "np.ndarray | None"]
"""(rig, sensor (K,), xy (K, 2), points (K, 3)) -> rig_from_world (4, 4), or None"""


@dataclass(frozen=True)
class Known:
    """What is known of N images: cam_from_world (N, 4, 4), NaN = no pose; a camera each; key points (K, 2) of the
    preview of an image; the rigs as the model has them."""

    poses: np.ndarray
    cameras: Sequence[pycolmap.Camera]
    keypoints: Callable[[int], np.ndarray]
    rigs: Sequence[Rig]

    def placed(self) -> np.ndarray:
        """(N,) bool."""
        return np.all(np.isfinite(self.poses), axis=(1, 2))


def place_frames(scene: Scene, ties: PreviewMatches, known: Known, frames: Sequence[int], resect: Resect) -> np.ndarray:
    """The poses (N, 4, 4) with those frames placed that can be, each by those placed before it.

    Images of a frame of which another has a pose already are placed by the rig.
    """
    poses = known.poses.copy()
    now = replace(known, poses=poses)
    for frame in frames:
        own = np.flatnonzero(scene.frame == frame)
        rig = known.rigs[scene.rig[frame]]
        rig_from_world = _by_sibling(own, scene, rig, poses)
        if rig_from_world is None:
            rig_from_world = _resected(own, scene, ties, now, resect)
        if rig_from_world is None:
            continue
        for image in own:
            pose = rig.sensors[scene.sensor[image]].sensor_from_rig
            if pose is not None and not np.isfinite(poses[image]).all():
                poses[image] = pose @ rig_from_world
    return poses


def _by_sibling(own: np.ndarray, scene: Scene, rig: Rig, poses: np.ndarray) -> np.ndarray | None:
    for image in own:
        sensor = rig.sensors[scene.sensor[image]].sensor_from_rig
        if sensor is not None and np.isfinite(poses[image]).all():
            return np.asarray(transforms.invert(sensor) @ poses[image])
    return None


def _resected(own: np.ndarray, scene: Scene, ties: PreviewMatches, known: Known, resect: Resect) -> np.ndarray | None:
    """rig_from_world of a frame's images (K,)."""
    placed, count = known.placed(), ties.counts()
    inward = np.isin(ties.i, own) & placed[ties.j]
    outward = np.isin(ties.j, own) & placed[ties.i]
    ends = np.concatenate([ties.j[inward], ties.i[outward]])
    weight = np.bincount(ends, np.concatenate([count[inward], count[outward]]), len(scene))
    partners = np.argsort(-weight, kind="stable")[:_PARTNERS]
    group = np.concatenate([own, partners[weight[partners] > 0]])
    inside = ties.where(np.isin(ties.i, group) & np.isin(ties.j, group) & (count > 0))
    track, image, feature = inside.observations()
    if not len(track):
        return None
    xy = np.zeros((len(track), 2))
    rays = np.zeros((len(track), 3))
    for k in np.unique(image):
        at = image == k
        xy[at] = known.keypoints(int(k))[feature[at]]
        rays[at] = pixel_rays(known.cameras[int(k)], xy[at])
    seen = placed[image] & np.isfinite(rays).all(axis=1)
    points = _points(rays[seen], known.poses[image[seen]], track[seen], int(track.max()) + 1)
    new = np.isin(image, own) & np.isfinite(points[track, 0])
    if new.sum() < LEAST_POINTS:
        return None
    rig = known.rigs[scene.rig[scene.frame[own[0]]]]
    return resect(rig, scene.sensor[image[new]].astype(int), xy[new], points[track[new]])


def _points(rays: np.ndarray, poses: np.ndarray, track: np.ndarray, tracks: int) -> np.ndarray:
    """(T, 3) points of tracks (K,) by rays (K, 3) of images with poses (K, 4, 4); NaN where rays do not meet well."""
    way = np.einsum("kji,kj->ki", poses[:, :3, :3], rays)
    centre = transforms.centre(poses)
    normal = normal_matrices(way, np.ones(len(way)), track, tracks)
    # Of two rays the smallest eigenvalue is one less the cosine of their angle.
    good = np.linalg.eigvalsh(normal)[:, 0] > 1 - np.cos(np.radians(_LEAST_ANGLE_DEG))
    across = centre - way * np.sum(way * centre, axis=1, keepdims=True)
    right = np.column_stack([np.bincount(track, across[:, a], tracks) for a in range(3)])
    out = np.full((tracks, 3), np.nan)
    out[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
    to = out[track] - centre
    with np.errstate(invalid="ignore"):
        off = np.sum(to * way, axis=1) < np.cos(np.radians(_RAY_DEG)) * np.linalg.norm(to, axis=1)
    out[track[off]] = np.nan
    return out


_WIDE = 0.2  # of the length of the positions' extent: from this width on they tell all seven unknowns
_LEAST_POSITIONS = 3  # a similarity in the plan has four unknowns, and one is to contradict


def plan_from_world(cam_from_world: np.ndarray, scene: Scene) -> tuple[np.ndarray, float]:
    """(4, 4) rotation, scale and shift into the plan (x right, y up the page, z height), and its scale.

    With measured positions of three frames and more, in metres and with north up; else the path lies along x and the
    unit stays. Positions that lie along a line do not tell its roll: there the cameras say what is up.
    """
    plan = levelled(cam_from_world, scene.frame)
    placed = np.isfinite(cam_from_world).all(axis=(1, 2))
    frames, centre = scene.frame[placed], transforms.centre(cam_from_world[placed])
    known = scene.measured_positions()[frames] & scene.metric_positions()
    here, there = transforms.apply(plan, centre)[known], scene.world_from_rig[frames[known], :3, 3]
    if len(here) < _LEAST_POSITIONS or not min(np.ptp(p[:, :2], axis=0).max() for p in (here, there)) > 0:
        return plan, 1.0
    sigma = np.nan_to_num(scene.position_sigma_m[frames[known]], nan=1.0)
    spread = np.linalg.svd(there - there.mean(axis=0), compute_uv=False)
    wide = len(there) > _LEAST_POSITIONS and spread[1] > _WIDE * spread[0]
    fit, _ = robust_umeyama(here, there, np.linalg.norm(sigma, axis=1)) if wide else level_umeyama(here, there, sigma)
    return fit.matrix @ plan, fit.scale


def path_and_ties(
    scene: Scene, ties: PreviewMatches, places: np.ndarray, modelled: np.ndarray, least: int, most: int
) -> dict[str, Any]:
    """Frames with their places in the plan and ties between frames, for the page; images that are not tied, by name.

    places (N, 3) of the images, NaN = no pose; modelled (N,): by the coarse model and not by resection; ``least``
    matches of a tie; ``most`` ties drawn, the strongest first.
    """
    where = np.full((scene.frames, 2), np.nan)
    by_model = np.zeros(scene.frames, bool)
    for image in np.flatnonzero(np.isfinite(places[:, 0]))[::-1]:
        where[scene.frame[image]] = places[image, :2]
        by_model[scene.frame[image]] = modelled[image]
    count = ties.counts()
    tied = count >= least
    i, j, count = ties.i[tied], ties.j[tied], count[tied]
    degree = np.bincount(np.concatenate([i, j]), minlength=len(scene))
    low, high = np.minimum(scene.frame[i], scene.frame[j]), np.maximum(scene.frame[i], scene.frame[j])
    between = low != high
    pair, at = np.unique(low[between].astype(np.int64) * scene.frames + high[between], return_inverse=True)
    total = np.bincount(at, count[between], len(pair))
    strongest = np.argsort(-total, kind="stable")[:most]
    return {
        "frames": [
            [*rounded(where[k]), int(by_model[k]), int(scene.sequence[k]), scene.frame_names[k]]
            for k in np.lexsort((scene.sequence_index, scene.sequence))
            if np.isfinite(where[k]).all()
        ],
        "ties": [
            [*rounded(where[a]), *rounded(where[b]), int(total[k])]
            for k, a, b in zip(strongest, pair[strongest] // scene.frames, pair[strongest] % scene.frames)
            if np.isfinite(where[[a, b]]).all()
        ],
        "tied_pairs": int(tied.sum()),
        "untied": [name for name, number in zip(scene.names, degree) if number == 0],
    }


def rounded(values: Sequence[float] | np.ndarray) -> list[float]:
    """Numbers of a page: five digits."""
    return [float(f"{v:.5g}") for v in values]


_PAGE = Path(__file__).with_name("page.html")
_HOLE = "/*STATE*/null"  # in the page; a page that is kept has its data here and asks nobody


def page(state: dict[str, Any] | None) -> bytes:
    """The page; with a state, one that shows it without a server."""
    text = _PAGE.read_text(encoding="utf-8")
    if state is not None:
        text = text.replace(_HOLE, json.dumps(state).replace("<", "\\u003c"))
    return text.encode()
