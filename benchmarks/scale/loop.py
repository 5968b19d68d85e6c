"""A closed way of many frames that exists only as points: poses, tracks of a few frames, GNSS with outages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

STEP_M, WAVE_M = 1.0, 400.0  # frame to frame; from one bend to the next
OUTAGE_M, EVERY_M, SIGMA_M = 200.0, 1000.0, 0.03  # of GNSS: length, from one to the next; its sigma
YAWS_DEG, LEVER_M = (-35.0, 35.0), 0.25  # of two cameras, and how far each stands from the middle
WIDTH, HEIGHT, FOCAL = 800, 600, 500.0
NOISE_PX = 0.7
POINTS = 24  # that come into view at a frame
TRACK, TRACK_MOST = 6.0, 20  # frames that a point is followed over, mean and most
LEAST = 3  # observations of a point


@dataclass(frozen=True)
class Loop:
    """Scene with GNSS positions; truth: cam_from_world (N, 4, 4), points (P, 3); observations (M,): image (sorted),
    point, xy (M, 2)."""

    scene: Scene
    cam_from_world: np.ndarray
    points: np.ndarray
    image: np.ndarray
    point: np.ndarray
    xy: np.ndarray

    def frames(self) -> np.ndarray:
        """(F, 3) true positions of the rig."""
        return transforms.centre(self.cam_from_world).reshape(-1, 2, 3).mean(axis=1)


@dataclass(frozen=True)
class Links:
    """Pairs of images i < j (T,) that see ``shared`` points both."""

    i: np.ndarray
    j: np.ndarray
    shared: np.ndarray

    def counts(self) -> np.ndarray:
        """(T,) matches."""
        return self.shared


def camera(focal_error: float = 0.0) -> pycolmap.Camera:
    """One of the two cameras, its focal length off by a share."""
    focal = FOCAL * (1 + focal_error)
    return pycolmap.Camera(
        model="PINHOLE", width=WIDTH, height=HEIGHT, params=[focal, focal, WIDTH / 2, HEIGHT / 2],
        has_prior_focal_length=True,
    )  # fmt: skip


def sensor_from_rig() -> np.ndarray:
    """(2, 4, 4) of the cameras; the rig looks ahead, x to the right, y down."""
    out = []
    for yaw, side in zip(np.radians(YAWS_DEG), (-1, 1)):
        turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
        out.append(transforms.rigid(turn, -turn @ np.array([side * LEVER_M, 0, 0])))
    return np.stack(out)


def loop(frames: int, seed: int = 0) -> Loop:
    """A ring way of so many frames, a metre apart, that ends where it began."""
    rng = np.random.default_rng(seed)
    world_from_rig = _way(frames)
    points, first, length = _landmarks(world_from_rig, rng)
    k = np.repeat(np.arange(len(points)), length)
    frame = (first[k] + np.arange(len(k)) - np.repeat(np.cumsum(length) - length, length)) % frames
    places, rig_from_world = sensor_from_rig(), transforms.invert(world_from_rig)
    image, point, xy = [], [], []
    for s, place in enumerate(places):
        local = np.einsum("kab,kb->ka", (place @ rig_from_world)[frame][:, :3, :3], points[k])
        local += (place @ rig_from_world)[frame][:, :3, 3]
        pixel = FOCAL * local[:, :2] / np.maximum(local[:, 2:], 1e-6) + (WIDTH / 2, HEIGHT / 2)
        seen = (local[:, 2] > 1) & (pixel > 0).all(axis=1) & (pixel < (WIDTH, HEIGHT)).all(axis=1)
        image.append(2 * frame[seen] + s)
        point.append(k[seen])
        xy.append(pixel[seen] + rng.normal(0, NOISE_PX, (int(seen.sum()), 2)))
    image, point, xy = np.concatenate(image), np.concatenate(point), np.concatenate(xy)
    order = np.lexsort((point, image))
    scene = _scene(frames, world_from_rig, rng)
    poses = (places[None] @ rig_from_world[:, None]).reshape(-1, 4, 4)
    return Loop(scene, poses, points, image[order], point[order], xy[order])


def _way(frames: int) -> np.ndarray:
    """world_from_rig (F, 4, 4) along a ring that winds a little; z up."""
    turn = 2 * np.pi * np.arange(frames) / frames
    radius = frames * STEP_M / (2 * np.pi)
    waves = 6.0 * np.sin(max(1, round(frames * STEP_M / WAVE_M)) * turn)
    xyz = np.stack([(radius + waves) * np.cos(turn), (radius + waves) * np.sin(turn), 1.5 * np.sin(7 * turn)], axis=1)
    ahead = np.roll(xyz, -1, axis=0) - np.roll(xyz, 1, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.cross(ahead, (0, 0, 1.0))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return transforms.rigid(np.stack([right, np.cross(ahead, right), ahead], axis=2), xyz)


def _landmarks(world_from_rig: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (P, 3), the frame each is seen from first, and over how many it is followed."""
    first = np.repeat(np.arange(len(world_from_rig)), POINTS)
    side = rng.choice([-1.0, 1.0], len(first)) * rng.uniform(7, 15, len(first))
    local = np.stack([side, -rng.uniform(-1, 9, len(first)), rng.uniform(8, 32, len(first))], axis=1)
    pose = world_from_rig[first]
    points = np.einsum("kab,kb->ka", pose[:, :3, :3], local) + pose[:, :3, 3]
    return points, first, np.minimum(2 + rng.geometric(1 / (TRACK - 2), len(first)), TRACK_MOST)


def _scene(frames: int, world_from_rig: np.ndarray, rng: np.random.Generator) -> Scene:
    sensors = tuple(Sensor(f"cam{s}", camera(), p) for s, p in enumerate(sensor_from_rig()))
    along = STEP_M * np.arange(frames)
    outage = np.abs(np.mod(along, EVERY_M) - EVERY_M / 2) < OUTAGE_M / 2
    prior = np.full((frames, 4, 4), np.nan)
    prior[:, 3] = (0, 0, 0, 1)
    prior[~outage, :3, 3] = world_from_rig[~outage, :3, 3] + rng.normal(0, SIGMA_M, (int(np.sum(~outage)), 3))
    names = [f"way/{k:06d}_{s}.jpg" for k in range(frames) for s in range(2)]
    return simple_scene(
        Rig("two", sensors, fixed=True), names, np.repeat(np.arange(frames), 2), np.tile([0, 1], frames),
        np.zeros(frames), np.arange(frames), sequences=("way",), prior="gnss", world_from_rig=prior,
        position_sigma_m=np.where(outage[:, None], np.nan, np.full((frames, 3), SIGMA_M)),
    )  # fmt: skip


def links(world: Loop, least: int = 8) -> Links:
    """Pairs of images that see so many points both."""
    order = np.lexsort((world.image, world.point))
    point, image = world.point[order], world.image[order]
    keys = []
    for apart in range(1, 2 * TRACK_MOST):
        same = point[apart:] == point[:-apart]
        keys.append(image[:-apart][same].astype(np.int64) << 32 | image[apart:][same])
    key, count = np.unique(np.concatenate(keys), return_counts=True)
    key, count = key[count >= least], count[count >= least]
    return Links(key >> 32, key & 0xFFFFFFFF, count)
