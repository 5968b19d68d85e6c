"""A bumpy body on a floor in a round room, seen by a rig like paper 004's: four cameras in a square of 7.5 cm with 8 mm
lenses and a wide one between the lower two; truth of everything.

The pitch of the pixels is twice the paper's 3.45 um, so that two cores bear it. The projector's dots are seen by the
four cameras alone, as by the paper's near-infrared filters; its shadows are not rendered.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import pycolmap
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from tiegraph.geometry.transforms import apply, invert, rigid
from tiegraph.scene.rig import on_plane

SIZE = (1224, 1025)
PITCH_MM = 0.0069
NAMES = ("cam0", "cam1", "cam2", "cam3", "wide")
STATIONS = 12
NEAR_M, FAR_M = 0.35, 0.8

_RADIUS_M = 0.14
_WAVES = ((0.040, 6.0), (0.022, 13.0), (0.006, 35.0), (0.002, 80.0))  # share of the radius, waves a radian
_FLOOR_M, _ROOM_M = -0.125, 1.8
_DISTANCE_M = 0.64  # of the rig from the body's middle: half a metre from its surface
_STEPS, _SLOPE = 60, 1.45  # of the march along a ray; a step is the distance over this and never passes the surface
_ON_M = 3e-6  # nearer than this a ray has hit
_FULL_WELL, _READ_E = 10_000.0, 12.0  # electrons at 255, and of the read noise
_DEFOCUS_PX = 0.7
_GRAINS_M = (0.0015, 0.004, 0.012, 0.04, 0.15)
_GRID = 64


@dataclass(frozen=True)
class Surface:
    """How the object looks: contrast of its own texture (1 = stone), and whether dots are projected onto it."""

    contrast: float
    dots: bool


SURFACES = {"textured": Surface(1.0, False), "plain": Surface(0.03, True)}


def cameras() -> tuple[pycolmap.Camera, ...]:
    """The true cameras: distorted, principal points off the middle, no two alike."""
    rng, out = np.random.default_rng(3), []
    for name in NAMES:
        focal = (4.3 if name == "wide" else 8.0) / PITCH_MM * rng.uniform(0.995, 1.005)
        bend = (-0.16, 0.025) if name == "wide" else (-0.09, 0.06)
        middle = np.array(SIZE) / 2 + rng.uniform(-9, 9, 2)
        params = [focal, focal * rng.uniform(0.9995, 1.0005), *middle, *bend, *rng.uniform(-2e-4, 2e-4, 2)]
        camera = pycolmap.Camera(model="OPENCV", width=SIZE[0], height=SIZE[1], params=params)
        camera.has_prior_focal_length = True
        out.append(camera)
    return tuple(out)


def sensor_from_rig() -> np.ndarray:
    """(5, 4, 4): the rig is the frame of the first camera."""
    rng = np.random.default_rng(5)
    places = np.array([(0, 0, 0), (75, 0, 0), (0, 75, 0), (75, 75, 0), (37.5, 75, 4)]) / 1000
    out = [np.eye(4)]
    for place in places[1:]:
        turn = Rotation.from_rotvec(np.radians(rng.uniform(-0.6, 0.6, 3))).as_matrix()
        out.append(invert(rigid(turn, place + rng.uniform(-4e-4, 4e-4, 3))))
    return np.array(out)


def stations() -> np.ndarray:
    """world_from_rig (12, 4, 4): round the body at changing heights, looking at its middle."""
    rng, out = np.random.default_rng(7), []
    for k in range(STATIONS):
        around, up = 2 * np.pi * k / STATIONS + rng.uniform(-0.05, 0.05), np.radians((12, 30, 20)[k % 3])
        away = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
        forward = -away
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        world_from_view = np.column_stack([right, np.cross(forward, right), forward])
        middle = np.array([0.0375, 0.0375, 0])  # of the square, in the rig
        out.append(rigid(world_from_view, _DISTANCE_M * away - world_from_view @ middle))
    return np.array(out)


@lru_cache(1)
def _waves() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amplitudes (W,), wave vectors (W, 3) and phases (W,) of the body's radius over its direction."""
    rng, height, wave = np.random.default_rng(11), [], []
    for share, number in _WAVES:
        for _ in range(3):
            axis = rng.normal(size=3)
            height.append(share * _RADIUS_M)
            wave.append(number * axis / np.linalg.norm(axis))
    return np.array(height), np.array(wave), rng.uniform(0, 2 * np.pi, len(height))


def body(points: np.ndarray) -> np.ndarray:
    """(P,) above 0 outside: distance from the middle minus the radius in that direction."""
    far = np.linalg.norm(points, axis=1)
    height, wave, phase = (w.astype(points.dtype) for w in _waves())
    return far - _RADIUS_M - np.sin((points / far[:, None]) @ wave.T + phase) @ height


def normals(points: np.ndarray) -> np.ndarray:
    """Gradient (P, 3) of the body's function, by differences: outward, of length about 1."""
    step = 1e-4
    sides = [body(points + step * axis) - body(points - step * axis) for axis in np.eye(3, dtype=points.dtype)]
    return np.stack(sides, axis=1) / (2 * step)


def distance_m(points: np.ndarray) -> np.ndarray:
    """(P,) signed distance of points (P, 3) to the true surface, positive outside; to first order."""
    to_body = body(points) / np.linalg.norm(normals(points), axis=1)
    others = points[:, 2] - _FLOOR_M, _ROOM_M - np.linalg.norm(points, axis=1)
    each = np.stack([to_body, *others])
    return each[np.abs(each).argmin(axis=0), np.arange(len(points))]


def on_body(points: np.ndarray) -> np.ndarray:
    """(P,) bool: nearer to the body than to anything else, and above the floor by a centimetre."""
    return (np.abs(body(points)) < 0.02) & (points[:, 2] > _FLOOR_M + 0.01)


@lru_cache(1)
def _noise() -> np.ndarray:
    """Grey of stone in a cube (N, N, N) that repeats."""
    return np.random.default_rng(13).standard_normal((_GRID,) * 3).astype(np.float32)


def _stone(points: np.ndarray) -> np.ndarray:
    """(P,) grey of unit contrast, of several grains."""
    out = np.zeros(len(points), np.float32)
    for k, grain in enumerate(_GRAINS_M):
        turned = points @ Rotation.from_euler("xyz", (17 * k, 31 * k, 7), degrees=True).as_matrix().astype(np.float32)
        out += map_coordinates(_noise(), (turned / grain).T % _GRID, order=1, mode="grid-wrap")
    return out / np.sqrt(len(_GRAINS_M))


@lru_cache(1)
def _dots() -> np.ndarray:
    """The projector's picture (N, N), 0 to 1: dots of several sizes."""
    rng, n = np.random.default_rng(17), 3000
    out = np.zeros((n, n), np.float32)
    for x, y, r in rng.uniform([0, 0, 2.5], [n, n, 6], (45_000, 3)):
        cv2.circle(out, (int(x), int(y)), int(r), 1.0, -1)
    return cv2.GaussianBlur(out, (0, 0), 1.0)


def _projected(points_rig: np.ndarray) -> np.ndarray:
    """(P,) light of the projector, which stands above the square and spreads as far as the cameras see."""
    seen = points_rig - np.array([0.0375, -0.03, 0], np.float32)
    at = (seen[:, :2] / seen[:, 2:] / 1.5 + 0.5) * _dots().shape[0]
    x, y = (np.ascontiguousarray(a, np.float32).reshape(SIZE[1], SIZE[0]) for a in at.T)
    light = cv2.remap(_dots(), x, y, cv2.INTER_LINEAR)
    return light.ravel() * np.minimum(1.5, (0.5 / seen[:, 2]) ** 2)


def hit(start: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ranges (P,) of unit rays (P, 3) from ``start`` (3,) to the first surface, and which hit the body (P,) bool."""
    along = rays @ start
    outer = _RADIUS_M * (1 + 3 * sum(share for share, _ in _WAVES))
    root = along**2 - (start @ start - outer**2)
    may = np.flatnonzero((root > 0) & (along < 0))
    far = -along + np.sqrt(along**2 - (start @ start - _ROOM_M**2))
    down = np.where(rays[:, 2] < 0, (_FLOOR_M - start[2]) / np.minimum(rays[:, 2], -1e-9), np.inf)
    found = np.minimum(far, down)
    reach = -along[may] - np.sqrt(root[may])
    last = np.minimum(-along[may] + np.sqrt(root[may]), found[may])
    going, good = np.arange(len(may)), np.zeros(len(may), bool)
    for _ in range(_STEPS):
        height = body(start + rays[may[going]] * reach[going, None])
        reach[going] += height / _SLOPE
        good[going] = height < _ON_M
        going = going[(height >= _ON_M) & (reach[going] < last[going])]
    is_body = np.zeros(len(rays), bool)
    is_body[may[good]] = True
    found[may[good]] = reach[good]
    return found, is_body


@lru_cache(len(NAMES))
def _rays(camera: int) -> np.ndarray:
    """(H W, 3) unit rays of the pixels of a camera."""
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    plane = on_plane(cameras()[camera], np.column_stack([x.ravel(), y.ravel()]))
    rays = np.column_stack([plane, np.ones(len(plane))])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def images(station: int, camera: int) -> dict[str, np.ndarray]:
    """(H, W) u1 by surface: what a camera sees at a station, with defocus, photon and read noise."""
    world_from_rig = stations()[station]
    world_from_camera = world_from_rig @ invert(sensor_from_rig()[camera])
    rays = (_rays(camera) @ world_from_camera[:3, :3].T).astype(np.float32)
    start = world_from_camera[:3, 3].astype(np.float32)
    ranges, is_body = hit(start, rays)
    points = start + rays * ranges[:, None]
    normal = np.where((points[:, 2] < _FLOOR_M + 1e-6)[:, None], [0.0, 0, 1], -points / _ROOM_M)
    normal[is_body] = normals(points[is_body])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    light = 0.55 + 0.35 * np.clip(normal @ (np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])), 0, 1)
    stone, out = _stone(points.astype(np.float32)), {}
    for name, surface in SURFACES.items():
        grey = (120 + 36 * surface.contrast * stone) * light
        if surface.dots and NAMES[camera] != "wide":
            facing = np.clip(-np.sum(normal * rays, axis=1), 0, 1)
            grey = 0.55 * grey + 95 * facing * _projected(apply(invert(world_from_rig), points).astype(np.float32))
        sharp = np.clip(grey, 3, 250).reshape(SIZE[1], SIZE[0]).astype(np.float32)
        out[name] = _sensed(cv2.GaussianBlur(sharp, (0, 0), _DEFOCUS_PX), np.random.default_rng([station, camera]))
    return out


def _sensed(grey: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H, W) u1 of a sensor: photons come one by one, and reading adds noise."""
    electrons = grey / 255 * _FULL_WELL
    noisy = electrons + np.sqrt(electrons + _READ_E**2) * rng.standard_normal(grey.shape, np.float32)
    return np.clip(np.rint(255 * noisy / _FULL_WELL), 0, 255).astype(np.uint8)
