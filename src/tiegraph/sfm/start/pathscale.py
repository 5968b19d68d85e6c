"""Is the path as long as the rig says? The length of a path against the baselines of a rig that must not change.

A model made of few ties can have both right but for their ratio: of cameras that look away from each other it is hardly
seen (PandaSet: the path of a coarse model 16 times too long, with nothing in its errors to tell). Bundle adjustment
does not get out of that. The scale is one number, and every match between frames votes for it: by the angle of its ray
to the other's epipolar plane, as a function of the scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.rays import cross, off_plane
from tiegraph.scene.rig import rays_or_axis
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.start import ScaleTuning
from tiegraph.sfm.verified import VerifiedMatches


@dataclass(frozen=True)
class PathScale:
    """``scale`` that the path needs (1 = as it is; NaN = nothing tells), and what tells it."""

    scale: float
    by: str


def path_scale(
    scene: Scene, cam_from_rig: np.ndarray, world_from_rig: np.ndarray, verified: VerifiedMatches, tuning: ScaleTuning
) -> PathScale:
    """Scale of the path of the frames (F, 4, 4) for rigs whose extrinsics (N, 4, 4), one an image, stay: by the matches
    if they tell it, else by the prior positions, else unknown."""
    rays = _rays(scene, cam_from_rig, world_from_rig, verified, tuning.matches_a_pair)
    told = (_by_matches(rays, cap_rad, tuning) for cap_rad in tuning.caps_rad) if rays is not None else ()
    for scale in told:
        if scale is not None:
            return PathScale(scale, "its matches")
    placed = _by_positions(scene, world_from_rig[:, :3, 3], tuning)
    if placed is not None:
        return PathScale(placed, "the positions")
    return PathScale(float("nan"), "nothing")


@dataclass(frozen=True)
class _Rays:
    """Matches (M): rays a, b of both images in the world, their cross product, the way between the frames as the model
    has it, and between their cameras within the rigs."""

    a: np.ndarray
    normal: np.ndarray
    path: np.ndarray
    lever: np.ndarray

    def cost(self, scale: float, cap_rad: float) -> float:
        """Mean angle between rays and epipolar planes, cut at a cap and in units of it."""
        way = scale * self.path + self.lever
        return float(np.minimum(off_plane(way, self.a, self.normal), cap_rad).mean() / cap_rad)


def _rays(
    scene: Scene, cam_from_rig: np.ndarray, world_from_rig: np.ndarray, verified: VerifiedMatches, most: int
) -> _Rays | None:
    """``most``: matches of a pair of images that vote."""
    rng = np.random.default_rng(0)
    known = np.all(np.isfinite(cam_from_rig) & np.isfinite(world_from_rig[scene.frame]), axis=(1, 2))
    centre = transforms.centre(cam_from_rig)
    rows: list[Sequence[np.ndarray]] = []
    for (i, j), matches in zip(verified.pairs.tolist(), verified.matches):
        if scene.frame[i] == scene.frame[j] or not (known[i] and known[j]) or len(matches) == 0:
            continue
        if len(matches) > most:
            matches = matches[rng.choice(len(matches), most, replace=False)]
        pose_i, pose_j = world_from_rig[scene.frame[i]], world_from_rig[scene.frame[j]]
        a = _turned(scene, i, verified.xy[i][matches[:, 0]], pose_i, cam_from_rig[i])
        b = _turned(scene, j, verified.xy[j][matches[:, 1]], pose_j, cam_from_rig[j])
        lever = pose_j[:3, :3] @ centre[j] - pose_i[:3, :3] @ centre[i]
        path = pose_j[:3, 3] - pose_i[:3, 3]
        rows.append((a, cross(a, b), np.tile(path, (len(a), 1)), np.tile(lever, (len(a), 1))))
    if not rows:
        return None
    return _Rays(*(np.concatenate(column) for column in zip(*rows)))


def _turned(scene: Scene, image: int, xy: np.ndarray, pose: np.ndarray, cam_from_rig: np.ndarray) -> np.ndarray:
    """Rays (M, 3) of pixels, unit length, in the world."""
    camera = cast(pycolmap.Camera, scene.sensor_of(image).camera)  # the scan gave each sensor one
    return rays_or_axis(camera, xy) @ (cam_from_rig[:3, :3] @ pose[:3, :3].T)


def _by_matches(rays: _Rays, cap_rad: float, tuning: ScaleTuning) -> float | None:
    grid = np.linspace(-np.log(tuning.range), np.log(tuning.range), tuning.grid)
    for _ in range(2):
        costs = np.array([rays.cost(float(np.exp(x)), cap_rad) for x in grid])
        best = float(grid[np.argmin(costs)])
        step = float(grid[1] - grid[0])
        grid = np.linspace(best - step, best + step, tuning.fine_grid)
    lowest = float(costs.min())
    beside = min(rays.cost(float(np.exp(best + x)), cap_rad) for x in (-np.log(tuning.near), np.log(tuning.near)))
    return float(np.exp(best)) if beside - lowest > tuning.dip * max(lowest, 1e-9) else None


def _by_positions(scene: Scene, centre: np.ndarray, tuning: ScaleTuning) -> float | None:
    """Scale that the positions ask for, 1 where they bear the length of the path out; None: both lie within the noise.

    Its sigma is that of one long distance, for a receiver's errors go together. A vehicle that hardly moves has no
    distance beyond the noise, and a path of a hundred times its length is refuted all the same.
    """
    position = scene.world_from_rig[:, :3, 3]
    known = np.flatnonzero(np.isfinite(centre).all(axis=1) & np.isfinite(position).all(axis=1))
    if len(known) < tuning.least_positions:
        return None
    sigma = np.nan_to_num(np.nanmax(scene.position_sigma_m[known], axis=1, initial=0.0))
    a, b = np.random.default_rng(0).choice(len(known), (2, tuning.distances))
    apart = np.linalg.norm(position[known[a]] - position[known[b]], axis=1)
    own = np.linalg.norm(centre[known[a]] - centre[known[b]], axis=1)
    noise = np.maximum(sigma[a] + sigma[b], tuning.least_noise_m)
    far = (np.maximum(apart, own) > tuning.sigmas * noise) & (own > 0)
    if far.sum() < tuning.least_distances:
        return None
    apart, own, noise = apart[far], own[far], noise[far]
    scale = float(np.median(np.maximum(apart, noise / tuning.sigmas) / own))
    known_to = float(np.median(noise / np.maximum(apart, own)))
    clear = max(np.log(tuning.clear), tuning.clear_sigmas * known_to)
    return scale if abs(np.log(scale)) > clear else 1.0
