"""A long canal that exists only as points: what the previews of a rig survey of thousands of images would hold.

Two walls in sections of 12 m, most of them one of a few textures that come again and again; bridges now and then. A rig
of five cameras in a ring and one that looks up goes up and comes back. No pixels: an image is the list of the points it
detects, a match of two images is the largest set of matches that one geometry explains, be it the true one or that of
two walls with one texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.features.preview import PreviewMatch
from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

WIDTH, HEIGHT, FOCAL = 640, 480, 310.0  # pixels
GUESSED_FOCAL = 340.0  # what the method is told
PREVIEW_SCALE = 0.625  # reduced pixels a pixel
FEATURES = 800
STEP_M, WALL_M, TALL_M, EYE_M = 2.0, 12.0, 14.0, 2.0  # frame to frame; half width; height of walls; of the cameras
SECTION_M, POINTS = 12.0, 700  # a section of a wall and its points
TEXTURES, UNIQUE = 5, 0.3  # repeated textures; share of sections that have one of their own
BRIDGE_EVERY, BRIDGE_SECTIONS, CEILING_M = 12, 2, 6.0  # sections from bridge to bridge, under it, height
RANGE_M, FAR_M = 45.0, 35.0  # seen at all; where features get few
DETECTED, MATCHED, WEATHERED = 0.9, 0.85, 0.45  # chances: of a feature, a match, a match on another wall of one texture
ALIKE_DEG = 40.0  # between two views of a point that still match
NOISE_PX = 0.7
CHANCE = 8.0  # mean inliers of images that share nothing; up to CHANCE_MOST
CHANCE_MOST, LEAST = 11, 8  # fewer than LEAST are none (features.preview)
NOMINAL_OFF_DEG = 1.0
SIDES, CEILING = (0, 1), 2


@dataclass(frozen=True)
class Image:
    """K features: point (K,) sorted ids, xy (K, 2) f4 pixels, ray (K, 3) f4 unit in the world, far (K,) f4 metres."""

    point: np.ndarray
    xy: np.ndarray
    ray: np.ndarray
    far: np.ndarray


@dataclass(frozen=True)
class CanalWorld:
    """The survey: scene as a method gets it, true poses (N, 4, 4), images, points (P, 3), sections of the points."""

    scene: Scene
    cam_from_world: np.ndarray
    points: np.ndarray
    side: np.ndarray  # (C,) 0 and 1 walls, 2 ceilings
    start_m: np.ndarray  # (C,) where along the canal
    texture: np.ndarray  # (C,)
    brightness: np.ndarray  # (N,)
    images: Sequence[Image] = field(repr=False)
    rng: int = 0

    def __len__(self) -> int:
        return len(self.images)

    def match(self, pairs: np.ndarray) -> list[PreviewMatch]:
        """What ``features.preview.match_previews`` would say of pairs (P, 2)."""
        return [self._match(int(i), int(j)) for i, j in pairs]

    def _match(self, i: int, j: int) -> PreviewMatch:
        rng = np.random.default_rng((self.rng, min(i, j), max(i, j)))
        a, b = self.images[i], self.images[j]
        groups = self._groups(a, b, rng)
        best = max(groups, key=lambda g: len(groups[g][0]), default=None)
        chance = int(min(CHANCE_MOST, rng.poisson(CHANCE)))
        if best is None or len(groups[best][0]) < max(LEAST, chance):
            if chance < LEAST or min(len(a.point), len(b.point)) < chance:
                return PreviewMatch(0)
            rows = [rng.permutation(len(x.point))[:chance] for x in (a, b)]
            return _result(a, b, rows[0], rows[1], _turn(rng.normal(size=3)))
        left, right = groups[best]
        turn = self.cam_from_world[j, :3, :3] @ _half_turn(best[1]) @ self.cam_from_world[i, :3, :3].T
        wrong = min(chance // 3, len(a.point), len(b.point))  # outliers that happen to lie on the epipolar line
        left = np.concatenate([left, rng.permutation(len(a.point))[:wrong]])
        right = np.concatenate([right, rng.permutation(len(b.point))[:wrong]])
        first = np.unique(left, return_index=True)[1]
        first = first[np.unique(right[first], return_index=True)[1]]
        return _result(a, b, left[first], right[first], turn)

    def _groups(
        self, a: Image, b: Image, rng: np.random.Generator
    ) -> dict[tuple[float, bool], tuple[np.ndarray, np.ndarray]]:
        """Matches (rows of a, rows of b) by the geometry that explains them: shift along the canal, half turn."""
        out: dict[tuple[float, bool], list[tuple[np.ndarray, np.ndarray]]] = {}
        slices_a, slices_b = _slices(a.point), _slices(b.point)
        for s, (from_a, to_a) in slices_a.items():
            for t, (from_b, to_b) in slices_b.items():
                if self.texture[s] != self.texture[t]:
                    continue
                local = a.point[from_a:to_a] % POINTS, b.point[from_b:to_b] % POINTS
                _, left, right = np.intersect1d(*local, assume_unique=True, return_indices=True)
                left, right = left + from_a, right + from_b
                turned = bool(self.side[s] != self.side[t])
                ray = b.ray[right] @ _half_turn(turned)
                cosine = np.clip(np.sum(a.ray[left] * ray, axis=1), -1, 1)
                angle, scale = np.degrees(np.arccos(cosine)), np.log2(a.far[left] / b.far[right])
                chance = MATCHED * np.exp(-((angle / ALIKE_DEG) ** 2) - scale**2) * (1.0 if s == t else WEATHERED)
                found = rng.random(len(left)) < chance
                if found.any():
                    key = (0.0 if s == t else float(self.start_m[t] - self.start_m[s]), turned)
                    out.setdefault(key, []).append((left[found], right[found]))
        return {k: (np.concatenate([g[0] for g in v]), np.concatenate([g[1] for g in v])) for k, v in out.items()}

    def overlap(self, every: int = 4) -> np.ndarray:
        """(N, N) f2 larger share of the points in one field of view that are in the other, from every so many-th."""
        from scipy.sparse import csr_array

        seen = [_visible(pose, self.points[::every], self.start_m)[0] for pose in self.cam_from_world]
        row = np.repeat(np.arange(len(seen)), [len(s) for s in seen])
        table = csr_array(
            (np.ones(len(row), np.float32), (row, np.concatenate(seen))), shape=(len(seen), len(self.points))
        )
        count = np.array([max(1, len(s)) for s in seen], np.float32)
        share = np.zeros((len(seen), len(seen)), np.float16)
        turned = table.T.tocsr()
        for start in range(0, len(seen), 256):
            part = slice(start, start + 256)
            share[part] = (table[part] @ turned).toarray() / count[part, None]
        share = np.maximum(share, share.T)
        np.fill_diagonal(share, 0)
        return share


def canal_world(images: int, seed: int = 0) -> CanalWorld:
    """A survey of about ``images`` images: 6 cameras, two passes of ``images / 12`` frames."""
    rng = np.random.default_rng(seed)
    frames = max(4, round(images / 12))
    true, nominal = _rig(rng)
    body = _trajectory(frames, rng)  # world_from_body of all frames
    points, side, start, texture = _walls(frames * STEP_M, rng)
    frame, sensor = np.repeat(np.arange(2 * frames), 6), np.tile(np.arange(6), 2 * frames)
    cam_from_world = np.stack([true[s] @ transforms.invert(body[f]) for f, s in zip(frame, sensor)])
    names = [f"{'up' if f >= frames else 'down'}/cam{s}/{f % frames:06d}.jpg" for f, s in zip(frame, sensor)]
    order = np.array(sorted(range(len(names)), key=lambda k: names[k]))
    frame, sensor, cam_from_world = frame[order], sensor[order], cam_from_world[order]
    scene = simple_scene(
        nominal,
        [names[k] for k in order],
        frame,
        sensor,
        np.repeat([0, 1], frames),
        np.tile(np.arange(frames), 2),
        sequences=("down", "up"),
    )
    dark = (start[side == CEILING, None] <= body[None, :, 0, 3]) & (
        body[None, :, 0, 3] < start[side == CEILING, None] + SECTION_M
    )
    light = np.where(dark.any(axis=0), 60.0, 210.0)[frame]
    found = [_image(pose, points, start, np.random.default_rng((seed, k))) for k, pose in enumerate(cam_from_world)]
    return CanalWorld(scene, cam_from_world, points, side, start, texture, light, found, seed)


def _rig(rng: np.random.Generator) -> tuple[np.ndarray, Rig]:
    """True cam_from_body (6, 4, 4), and the nominal rig, a degree off."""
    true, sensors = [], []
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[GUESSED_FOCAL, WIDTH / 2, HEIGHT / 2]
    )
    nominal = []
    for k in range(6):
        yaw = -2 * np.pi * k / 5
        forward = np.array([np.cos(yaw), np.sin(yaw), 0.0]) if k < 5 else np.array([0.0, 0.0, 1.0])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0]) if k < 5 else np.array([0.0, -1.0, 0.0])
        rotation = np.stack([right, np.cross(forward, right), forward])
        nominal.append(transforms.rigid(rotation, -rotation @ (0.06 * forward)))
        off = _turn(np.radians(NOMINAL_OFF_DEG) * rng.normal(size=3) / np.sqrt(3))
        true.append(transforms.rigid(off, np.zeros(3)) @ nominal[-1])
    reference = transforms.invert(nominal[0])
    for k, pose in enumerate(nominal):
        sensors.append(Sensor(f"cam{k}", camera, pose @ reference, "up" if k == 5 else "side", f"cam{k}"))
    return np.stack(true), Rig("ring", tuple(sensors), nominal=True)


def _trajectory(frames: int, rng: np.random.Generator) -> np.ndarray:
    """world_from_body (2 F, 4, 4): up the canal and back, at a speed that wanders."""
    out = []
    for back in (False, True):
        phase = rng.uniform(0, 2 * np.pi, 3)
        s = np.arange(frames) / max(1, frames - 1)
        turns = max(1.0, frames * STEP_M / 120)  # one wave in 120 m
        x = STEP_M * (frames - 1) * s + 5 * np.sin(2 * np.pi * turns * s + phase[0])
        y = (-3.0 if back else 3.0) + np.sin(2 * np.pi * 1.3 * turns * s + phase[1])
        yaw = np.radians(3) * np.sin(2 * np.pi * 2.1 * turns * s + phase[2]) + (np.pi if back else 0.0)
        for k in np.arange(frames)[:: -1 if back else 1]:
            turn = _turn(np.array([0, 0, yaw[k]]))
            out.append(transforms.rigid(turn, np.array([x[k], y[k], EYE_M])))
    return np.stack(out)


def _walls(length_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points (P, 3), POINTS of each section; of the sections (C,) side, start and texture."""
    count = int(np.ceil((length_m + 2 * RANGE_M) / SECTION_M))
    x = SECTION_M * np.arange(count) - RANGE_M
    under = x[(np.arange(count) % BRIDGE_EVERY) < BRIDGE_SECTIONS]
    side = np.repeat([0, 1, CEILING], [count, count, len(under)])
    start = np.concatenate([x, x, under])
    own = (rng.random(len(side)) < UNIQUE) | (side == CEILING)
    texture = np.where(own, TEXTURES + np.arange(len(side)), rng.integers(0, TEXTURES, len(side)))
    parts = []
    for s, at, t in zip(side, start, texture):
        u, v = np.random.default_rng((7, int(t))).random((2, POINTS))
        across = np.full(POINTS, WALL_M)
        if s == 0:
            parts.append(np.stack([at + SECTION_M * u, across, TALL_M * v], axis=1))
        elif s == 1:  # a half turn of the other side
            parts.append(np.stack([at + SECTION_M * (1 - u), -across, TALL_M * v], axis=1))
        else:
            parts.append(np.stack([at + SECTION_M * u, WALL_M * (2 * v - 1), np.full(POINTS, CEILING_M)], axis=1))
    return np.concatenate(parts), side, start, texture


def _visible(pose: np.ndarray, points: np.ndarray, start_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in a field of view: ids (K,), xy (K, 2), distance (K,). ``start_m`` (C,): where the sections begin."""
    centre = transforms.centre(pose)
    each = len(points) // len(start_m)
    sections = np.flatnonzero((start_m > centre[0] - RANGE_M - SECTION_M) & (start_m < centre[0] + RANGE_M))
    near = (sections[:, None] * each + np.arange(each)).ravel()
    near = near[np.abs(points[near, 0] - centre[0]) < RANGE_M]
    local = points[near] @ pose[:3, :3].T + pose[:3, 3]
    far = np.linalg.norm(local, axis=1)
    front = (local[:, 2] > 0.5) & (far < RANGE_M)
    near, local, far = near[front], local[front], far[front]
    xy = FOCAL * local[:, :2] / local[:, 2:] + (WIDTH / 2, HEIGHT / 2)
    inside = (xy >= 0).all(axis=1) & (xy < (WIDTH, HEIGHT)).all(axis=1)
    return near[inside], xy[inside], far[inside]


def _image(pose: np.ndarray, points: np.ndarray, start_m: np.ndarray, rng: np.random.Generator) -> Image:
    seen, xy, far = _visible(pose, points, start_m)
    found = np.flatnonzero(rng.random(len(seen)) < DETECTED * np.exp(-((far / FAR_M) ** 2)))
    found = np.sort(rng.permutation(found)[:FEATURES])
    ray = points[seen[found]] - transforms.centre(pose)
    far = far[found].astype(np.float32)
    noisy = xy[found] + rng.normal(0, NOISE_PX, (len(found), 2))
    return Image(seen[found], noisy.astype(np.float32), (ray / far[:, None]).astype(np.float32), far)


def _slices(point: np.ndarray) -> dict[int, tuple[int, int]]:
    """Rows of each section among sorted points."""
    sections, first = np.unique(point // POINTS, return_index=True)
    ends = np.append(first[1:], len(point))
    return {int(s): (int(a), int(b)) for s, a, b in zip(sections, first, ends)}


def _turn(vector: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a rotation vector, radians."""
    return Rotation.from_rotvec(vector).as_matrix()


def _half_turn(turned: bool) -> np.ndarray:
    """What maps a wall onto the one across with its texture, or nothing."""
    return np.diag([-1.0, -1.0, 1.0]) if turned else np.eye(3)


def _result(a: Image, b: Image, left: np.ndarray, right: np.ndarray, rotation: np.ndarray) -> PreviewMatch:
    shift = np.median((b.xy[right] - a.xy[left]) / (WIDTH, HEIGHT), axis=0)
    return PreviewMatch(len(left), rotation, shift, np.stack([left, right], axis=1).astype(np.uint16))
