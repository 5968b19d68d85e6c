"""Source ``poses``: pairs from prior positions and orientations by distance, line of sight and baseline (paper 003)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.geometry import transforms
from tiegraph.network.axes import vertical
from tiegraph.network.passes import Pass
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene

RANGE_SPACINGS = 10.0  # assumed distance to the object, in distances between frames
FAR_RANGES = 2.0  # frames further apart than this many ranges share nothing that matches
NEAR_RANGES = 1 / 500  # a shorter base of one camera measures nothing
NEIGHBOURS = 40  # nearest frames of a frame that are looked at
FIELD = 0.35  # probe points stand at this share of the field of view off the axis
MIN_SHARE = 0.4  # of the probe points of either image that the other must see
RANGE_RATIO = 3.0  # a thing seen from further than this times the range matches no more
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class PoseResult:
    """Pairs of the source, frames without a prior position, and what people should know."""

    pairs: Pairs
    without: np.ndarray  # (W,) frame indices
    notes: tuple[str, ...]


def pose_pairs(scene: Scene, passes: Sequence[Pass], settings: NetworkSettings) -> PoseResult:
    """Pairs of images by their prior poses; those that a test refused carry its reason.

    Distance (reason ``distance``), angle between optical axes (``axes``), a common view at the assumed range
    (``sight``), too short a base of one camera (``baseline``). Tests that need an unknown orientation are left out.
    """
    position = scene.world_from_rig[:, :3, 3]
    with_prior = np.isfinite(position).all(axis=1)
    without = np.flatnonzero(~with_prior)
    if with_prior.sum() < 2:
        return PoseResult(Pairs.empty(), without, ("poses: fewer than two frames have a prior position",))
    poses, headings = _with_headings(scene, passes)
    reach = settings.range_m or RANGE_SPACINGS * _spacing(position, passes)
    first, second = _frame_pairs(scene, np.flatnonzero(with_prior), FAR_RANGES * reach)
    i, j = _image_pairs(scene, first, second)
    axis, centre, trusted = _views(scene, poses, headings)
    code = _tests(scene, (i, j), (axis, centre, trusted), reach, settings)
    angle = _angle(axis[i], axis[j])
    base = np.linalg.norm(centre[i] - centre[j], axis=1)
    pairs = Pairs.make(i, j, "poses", dropped=code, baseline_m=base, angle_deg=angle)
    return PoseResult(pairs, without, _notes(scene, settings, reach, headings, without))


def _notes(
    scene: Scene, settings: NetworkSettings, reach: float, headings: np.ndarray, without: np.ndarray
) -> tuple[str, ...]:
    notes = []
    if not settings.range_m:
        notes.append(f"poses: distance to the object taken as {reach:.1f} m (ten times the distance between frames)")
    if headings.any():
        notes.append(
            f"poses: the heading of {int(headings.sum())} frames comes from the track of their positions; "
            "lines of sight are not tested there, only angles between axes"
        )
    if len(without):
        notes.append(f"poses: {len(without)} of {scene.frames} frames have no prior position")
    return tuple(notes)


def _spacing(position: np.ndarray, passes: Sequence[Pass]) -> float:
    """Median distance between successive frames; of loose photographs, to the nearest one."""
    steps = [np.linalg.norm(np.diff(position[p.frames], axis=0), axis=1) for p in passes if len(p) > 1]
    gaps = np.concatenate(steps) if steps else np.zeros(0)
    gaps = gaps[np.isfinite(gaps) & (gaps > 0)]
    if len(gaps):
        return float(np.median(gaps))
    known = position[np.isfinite(position).all(axis=1)]
    nearest = np.asarray(cKDTree(known).query(known, k=2)[0])[:, 1]
    return max(float(np.median(nearest)), 1e-3)


def _with_headings(scene: Scene, passes: Sequence[Pass]) -> tuple[np.ndarray, np.ndarray]:
    """Poses (F, 4, 4) with unknown rotations of passes filled by the direction of travel, and where (F,) bool.

    Reference camera forward, rig upright: wrong by a constant turn about the vertical if it is mounted otherwise, which
    angles between axes do not notice.
    """
    poses = scene.world_from_rig.copy()
    filled = np.zeros(scene.frames, bool)
    for p in passes:
        unknown = np.isnan(poses[p.frames][:, :3, :3]).any(axis=(1, 2))
        where = poses[p.frames][:, :3, 3]
        if not unknown.any() or len(p) < 2:
            continue
        sigma = np.nan_to_num(np.nanmax(scene.position_sigma_m[p.frames], axis=1, initial=0.0))
        for k in np.flatnonzero(unknown):
            way = _direction(where, sigma, int(k))
            if way is not None and np.isfinite(where[k]).all():
                poses[p.frames[k], :3, :3] = _upright(way, vertical(p.rig) if p.rig.known() else -np.eye(3)[1])
                poses[p.frames[k], 3] = (0, 0, 0, 1)
                filled[p.frames[k]] = True
    return poses, filled


def _direction(where: np.ndarray, sigma: np.ndarray, k: int) -> np.ndarray | None:
    """Horizontal unit vector of travel at frame k over the shortest stretch that is longer than its noise."""
    for half in range(1, len(where)):
        a, b = max(0, k - half), min(len(where) - 1, k + half)
        step = (where[b] - where[a]) * (1, 1, 0)
        if np.isfinite(step).all() and np.linalg.norm(step) > 4 * max(sigma[a], sigma[b], 1e-3):
            return step / np.linalg.norm(step)
        if a == 0 and b == len(where) - 1:
            return None
    return None


def _upright(way: np.ndarray, up_in_rig: np.ndarray) -> np.ndarray:
    """world_from_rig (3, 3) that takes the rig's vertical to the world's and the reference axis towards ``way``."""
    ahead = np.array([0.0, 0.0, 1.0])
    ahead = ahead - (ahead @ up_in_rig) * up_in_rig
    if np.linalg.norm(ahead) < 1e-3:  # the reference camera looks up: any direction in the plane serves
        ahead = np.cross(up_in_rig, [1.0, 0.0, 0.0])
    ahead /= np.linalg.norm(ahead)
    rig = np.stack([ahead, np.cross(up_in_rig, ahead), up_in_rig], axis=1)
    world = np.stack([way, np.cross(_UP, way), _UP], axis=1)
    return world @ rig.T


def _frame_pairs(scene: Scene, frames: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of frames (K,), (K,), first <= second: each with itself and its nearest NEIGHBOURS within twice the radius.

    Odometry of one pass knows nothing of another pass, and is never compared with it.
    """
    position = scene.world_from_rig[frames, :3, 3]
    groups = scene.track[frames] if scene.prior == "odometry" else np.zeros(len(frames), int)
    out = [np.stack([frames, frames], axis=1)]
    for group in np.unique(groups):
        member = np.flatnonzero(groups == group)
        count = min(NEIGHBOURS + 1, len(member))
        distance, near = cKDTree(position[member]).query(position[member], k=count)
        distance, near = np.reshape(distance, (len(member), -1)), np.reshape(near, (len(member), -1))
        a, b = np.nonzero(distance <= 2 * radius)
        out.append(np.stack([frames[member[a]], frames[member[near[a, b]]]], axis=1))
    pairs = np.unique(np.sort(np.concatenate(out), axis=1), axis=0)
    return pairs[:, 0], pairs[:, 1]


def _image_pairs(scene: Scene, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every image of one frame with every image of the other, i != j."""
    most = max(len(r.sensors) for r in scene.rigs)
    table = np.full((scene.frames, most), -1)
    table[scene.frame, scene.sensor] = np.arange(len(scene))
    i = np.repeat(table[first], most, axis=1).ravel()
    j = np.tile(table[second], (1, most)).ravel()
    there = (i >= 0) & (j >= 0) & (i != j)
    return i[there], j[there]


def _views(scene: Scene, poses: np.ndarray, headings: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Optical axis (N, 3), NaN = unknown; centre (N, 3); whether the axis is known absolutely (N,) bool."""
    prior = scene.with_(world_from_rig=poses).image_priors()
    axis = prior[:, :3, 2]
    known = np.isfinite(axis).all(axis=1)
    centre = np.where(known[:, None], prior[:, :3, 3], poses[scene.frame][:, :3, 3])
    return axis, centre, known & ~headings[scene.frame]


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1, 1)))


def _tests(
    scene: Scene,
    pairs: tuple[np.ndarray, np.ndarray],
    views: tuple[np.ndarray, np.ndarray, np.ndarray],
    reach: float,
    settings: NetworkSettings,
) -> np.ndarray:
    """Index into REASONS of each pair (K,): the first test that refuses it, 0 = none does."""
    i, j = pairs
    axis, centre, trusted = views
    base = np.linalg.norm(centre[i] - centre[j], axis=1)
    code = np.zeros(len(i), int)
    both = trusted[i] & trusted[j]
    # Without orientation nothing but the number of neighbours limits the distance (as COLMAP's spatial matching does).
    oriented = np.isfinite(axis[i]).all(axis=1) & np.isfinite(axis[j]).all(axis=1)
    _refuse(code, oriented & (base > FAR_RANGES * reach), "distance")
    _refuse(code, _angle(axis[i], axis[j]) > settings.axes_deg, "axes")
    same_camera = (scene.sensor_key[i] == scene.sensor_key[j]) & (scene.frame[i] != scene.frame[j])
    _refuse(code, same_camera & oriented & (base < NEAR_RANGES * reach), "baseline")
    open_ = np.flatnonzero(both & (code == 0) & (scene.frame[i] != scene.frame[j]))
    if len(open_):
        half = np.radians([s.field_of_view_deg() / 2 for s in scene.all_sensors])
        half = np.where(np.isfinite(half), half, np.radians(30))[scene.sensor_key]
        prior = scene.image_priors()
        seen = [_share(prior, half, a[open_], b[open_], reach) for a, b in ((i, j), (j, i))]
        blind = np.zeros(len(i), bool)
        blind[open_] = np.maximum(*seen) < MIN_SHARE
        _refuse(code, blind, "sight")
    return code


def _refuse(code: np.ndarray, mask: np.ndarray, reason: str) -> None:
    """Mark rows of a local array that no earlier test refused."""
    code[mask & (code == 0)] = REASONS.index(reason)


def _share(prior: np.ndarray, half: np.ndarray, i: np.ndarray, j: np.ndarray, reach: float) -> np.ndarray:
    """(K,) share of five probe points of image i, on its axis and towards its rims at the range, that image j sees."""
    off = np.tan(2 * FIELD * np.minimum(half[i], np.radians(70)))
    seen = np.zeros(len(i))
    sensor_from_world = transforms.invert(prior[j])
    for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 0.6), (0, -0.6)):
        ray = np.stack([dx * off, dy * off, np.ones(len(i))], axis=1)
        ray *= reach / np.linalg.norm(ray, axis=1, keepdims=True)
        point = np.einsum("kab,kb->ka", prior[i, :3, :3], ray) + prior[i, :3, 3]
        local = np.einsum("kab,kb->ka", sensor_from_world[:, :3, :3], point) + sensor_from_world[:, :3, 3]
        distance = np.linalg.norm(local, axis=1)
        inside = local[:, 2] > np.cos(np.minimum(1.15 * half[j], np.pi)) * distance
        seen += inside & (distance < RANGE_RATIO * reach) & (distance > reach / RANGE_RATIO)
    return seen / 5
