"""Simulated surveys with known points, and the exact covariance of their bundle adjustment for any choice of pairs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import bsr_array, coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

FOCAL, WIDTH, HEIGHT = 800.0, 1200, 900  # pixels
SIGMA_PX = 0.7  # of an observation at full resolution
PREVIEW_SHARE = 0.12  # of the points a preview finds
CAMERAS, WINDOW = 5, 20


@dataclass(frozen=True)
class Survey:
    """Centres (N, 3), world-to-camera rotations (N, 3, 3), points (P, 3), and of every candidate pair (E, 2) the points
    matched at full resolution and in previews."""

    scene: Scene
    centre: np.ndarray
    rotation: np.ndarray
    points: np.ndarray
    edges: np.ndarray
    match: list[np.ndarray]
    preview: list[np.ndarray]

    def __len__(self) -> int:
        return len(self.centre)

    def pairs(self) -> Pairs:
        """The candidates, scored by their preview matches."""
        score = np.array([len(m) for m in self.preview], float)
        return Pairs.make(self.edges[:, 0], self.edges[:, 1], "file", score=score)

    def ties(self, which: np.ndarray | None = None) -> PreviewMatches:
        """The preview matches of the pairs which (K,), of all by default."""
        which = np.arange(len(self.edges)) if which is None else which
        seen: list[list[np.ndarray]] = [[np.zeros(0, int)] for _ in range(len(self))]
        for (i, j), points in zip(self.edges, self.preview):
            seen[i].append(points)
            seen[j].append(points)
        known = [np.unique(np.concatenate(s)) for s in seen]
        rows = []
        for e in which:
            i, j = self.edges[e]
            rows.append(np.stack([np.searchsorted(known[k], self.preview[e]) for k in (i, j)], axis=1))
        return PreviewMatches.make(self.edges[which, 0], self.edges[which, 1], rows)


def survey(kind: str, seed: int = 0, frames: int = 0) -> Survey:
    """``rig``: five cameras on a ring up and down a corridor, all pairs; ``video``: one camera around a structure,
    window of 20 frames (paper 002)."""
    rng = np.random.default_rng(seed)
    build = {"rig": _rig_survey, "video": _video_survey}[kind]
    scene, centre, rotation, points, normal, tried = build(rng, frames)
    seen, distance, direction = _visible(rng, centre, rotation, points, normal)
    found = rng.random(len(points)) < PREVIEW_SHARE
    edges, match, preview = [], [], []
    for i, j in tried:
        both = np.flatnonzero(seen[i] & seen[j])
        if len(both) < 30:
            continue
        angle = np.arccos(np.clip(np.sum(direction[i, both] * direction[j, both], axis=1), -1, 1))
        scale = np.log2(distance[i, both] / distance[j, both])
        chance = 0.75 * np.exp(-((angle / np.radians(25)) ** 2)) * np.exp(-(scale**2))
        m = both[rng.random(len(both)) < chance]
        if len(m) >= 25 and np.sum(found[m]) >= 6:
            edges.append((i, j))
            match.append(m)
            preview.append(m[found[m]])
    return Survey(scene, centre, rotation, points, np.array(edges), match, preview)


def _look(yaw: float, pitch: float) -> np.ndarray:
    """World-to-camera rotation of a camera with a level horizon; world z up, camera x right, y down, z ahead."""
    ahead = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0])
    return np.stack([right, np.cross(ahead, right), ahead])


def _video_survey(rng: np.random.Generator, frames: int) -> tuple:
    n = frames or 150
    turn = np.linspace(0, 1.7 * np.pi, n)
    radius = 14 + 2 * np.sin(3 * turn)
    height = 1.6 + 0.3 * rng.standard_normal(n)
    centre = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
    rotation = np.stack([_look(a + np.pi + 0.15 * rng.standard_normal(), 0.1) for a in turn])
    u, h = rng.uniform(0, 2 * np.pi, 9000), rng.uniform(0, 8, 9000)
    r = 6 + np.sin(5 * u) + 0.3 * rng.standard_normal(9000)
    points = np.stack([r * np.cos(u), r * np.sin(u), h], axis=1)
    normal = np.stack([np.cos(u), np.sin(u), 0 * u], axis=1)
    names = [f"{k:05d}.jpg" for k in range(n)]
    rig = Rig("camera", (Sensor("camera"),))
    scene = simple_scene(rig, names, np.arange(n), np.zeros(n), np.zeros(n), sequences=("video",))
    tried = [(i, j) for i in range(n) for j in range(i + 1, min(n, i + WINDOW + 1))]
    return scene, centre, rotation, points, normal, tried


def _rig_survey(rng: np.random.Generator, frames: int) -> tuple:
    f = frames or 20
    centre, rotation = [], []
    for back in (False, True):
        for k in range(f):
            x = (f - 1 - k) * 1.5 + 0.4 if back else k * 1.5
            y = (-3 if back else 3) * -1 + 0.5 * rng.standard_normal()
            head = 0.05 * rng.standard_normal() + (np.pi if back else 0)
            for c in range(CAMERAS):
                yaw = head + 2 * np.pi * c / CAMERAS
                centre.append([x + 0.05 * np.cos(yaw), y + 0.05 * np.sin(yaw), 2.0])
                rotation.append(_look(yaw, 0.05))
    n = round(12000 * f / 20)
    side = rng.integers(0, 2, n) * 2 - 1
    depth = 15 + rng.exponential(3, n) * (rng.random(n) < 0.4)
    points = np.stack([rng.uniform(-25, 1.5 * f + 30, n), side * depth, rng.uniform(0, 12, n)], axis=1)
    normal = np.stack([0.0 * side, -1.0 * side, 0.0 * side], axis=1)
    frame, sensor = np.repeat(np.arange(2 * f), CAMERAS), np.tile(np.arange(CAMERAS), 2 * f)
    names = [f"{('up', 'down')[a // f]}/cam{c}/{a % f:05d}.jpg" for a, c in zip(frame, sensor)]
    rig = Rig("ring", tuple(Sensor(f"cam{c}") for c in range(CAMERAS)))
    track, step = np.repeat([0, 1], f), np.tile(np.arange(f), 2)
    scene = simple_scene(rig, names, frame, sensor, track, step, sequences=("up", "down"))
    return scene, np.array(centre), np.array(rotation), points, normal, list(combinations(range(len(centre)), 2))


def _visible(
    rng: np.random.Generator, centre: np.ndarray, rotation: np.ndarray, points: np.ndarray, normal: np.ndarray
):
    """(N, P) whether an image has a feature of a point, the distance, and (N, P, 3) the direction to it."""
    ray = points[None] - centre[:, None]
    local = np.einsum("nij,npj->npi", rotation, ray)
    depth, distance = local[..., 2], np.linalg.norm(ray, axis=2)
    with np.errstate(all="ignore"):
        pixel = FOCAL * local[..., :2] / depth[..., None]
    inside = (np.abs(pixel[..., 0]) < WIDTH / 2) & (np.abs(pixel[..., 1]) < HEIGHT / 2) & (depth > 1.5)
    facing = -np.sum(ray * normal[None], axis=2) / distance
    there = inside & (facing > 0.25) & (distance < 45) & (rng.random(depth.shape) < 0.6)
    return there, distance, ray / distance[..., None]


def position_sigma(world: Survey, chosen: np.ndarray, rigid: bool = False) -> float:
    """RMS position sigma of the images, metres, of the bundle adjustment over the tracks of the chosen pairs (K,).

    Exact covariance, similarity-aligned; the unknowns are six an image, or with ``rigid`` six a frame (a known rig).
    inf where images fall apart.
    """
    image, point, track = _observations(world, chosen)
    unit, base = (world.scene.frame, _frame_centres(world)) if rigid else (np.arange(len(world)), world.centre)
    a, p = _jacobians(world, image, point, base[unit])
    n, tracks = int(unit.max()) + 1, int(track.max(initial=-1)) + 1
    inverse = np.linalg.inv(_summed(np.einsum("nki,nkj->nij", p, p), track, tracks) + 1e-6 * np.eye(3))
    mixed = np.einsum("nki,nkj->nij", a, p) @ np.linalg.cholesky(inverse)[track]
    row = (6 * unit[image][:, None, None] + np.arange(6)[None, :, None]) + np.zeros((1, 1, 3), int)
    column = (3 * track[:, None, None] + np.arange(3)[None, None]) + np.zeros((1, 6, 1), int)
    cross = coo_array((mixed.ravel(), (row.ravel(), column.ravel())), shape=(6 * n, 3 * tracks)).tocsc()
    own = _summed(np.einsum("nki,nkj->nij", a, a), unit[image], n)
    normal = bsr_array((own, np.arange(n), np.arange(n + 1)), shape=(6 * n, 6 * n)).toarray()
    for k in range(0, 3 * tracks, 3000):
        block = cross[:, k : k + 3000].toarray()
        normal -= block @ block.T
    return _sigma(normal / SIGMA_PX**2, base)


def _summed(blocks: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    """(count, ..) sums of blocks (M, ..) by label (M,)."""
    pick = csr_array((np.ones(len(label)), (label, np.arange(len(label)))), shape=(count, len(label)))
    return (pick @ blocks.reshape(len(label), -1)).reshape(count, *blocks.shape[1:])


def _frame_centres(world: Survey) -> np.ndarray:
    frame = world.scene.frame
    return np.stack([np.bincount(frame, world.centre[:, k]) for k in range(3)], axis=1) / np.bincount(frame)[:, None]


def _observations(world: Survey, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image, point and track of every observation in the tracks of the chosen pairs."""
    p = len(world.points)
    a = np.concatenate([world.edges[e, 0] * p + world.match[e] for e in chosen])
    b = np.concatenate([world.edges[e, 1] * p + world.match[e] for e in chosen])
    used, place = np.unique(np.concatenate([a, b]), return_inverse=True)
    graph = coo_array((np.ones(len(a)), (place[: len(a)], place[len(a) :])), shape=(len(used), len(used)))
    return used // p, used % p, connected_components(graph.tocsr(), directed=False)[1]


def _cross(v: np.ndarray) -> np.ndarray:
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - np.transpose(out, (0, 2, 1))


def _jacobians(world: Survey, image: np.ndarray, point: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M, 2, 6) by rotation and position of the unit around base (N, 3), (M, 2, 3) by the point."""
    ray = world.points[point] - world.centre[image]
    x, y, z = np.einsum("nij,nj->ni", world.rotation[image], ray).T
    project = np.zeros((len(ray), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = FOCAL / z
    project[:, 0, 2], project[:, 1, 2] = -FOCAL * x / z**2, -FOCAL * y / z**2
    by_point = project @ world.rotation[image]
    arm = (world.centre - base)[image]
    by_rotation = -by_point @ _cross(ray) - by_point @ _cross(arm)
    return np.concatenate([by_rotation, -by_point], axis=2), by_point


def _sigma(normal: np.ndarray, base: np.ndarray) -> float:
    n = len(base)
    centred = base - base.mean(axis=0)
    gauge = np.zeros((n, 6, 7))
    gauge[:, 3:, :3], gauge[:, :3, 3:6] = np.eye(3), np.eye(3)
    gauge[:, 3:, 3:6] = _cross(centred)
    gauge[:, 3:, 6] = centred
    gauge = gauge.reshape(6 * n, 7)
    residual = np.linalg.norm(normal @ gauge, axis=0) / np.linalg.norm(gauge, axis=0)
    size = np.trace(normal) / len(normal)
    if np.any(residual[:6] > 1e-6 * size):  # a rigid rig fixes the scale, weakly
        raise RuntimeError(f"the free directions are wrong: {residual / size}")
    if np.sum(np.linalg.eigvalsh(normal / size) < 1e-9) > 7:
        return float("inf")
    unit = gauge / np.linalg.norm(gauge, axis=0)
    covariance = np.linalg.inv(normal + size * unit @ unit.T)
    at = (6 * np.arange(n)[:, None] + np.arange(3, 6)).ravel()
    free = gauge[at]
    align = np.eye(3 * n) - free @ np.linalg.solve(free.T @ free, free.T)
    return float(np.sqrt(np.trace(align @ covariance[np.ix_(at, at)] @ align.T) / n))
