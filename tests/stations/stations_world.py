"""Clouds of shots round a bumpy object, each in the frame of its own camera, with truth."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from near import off_after_similarity, rms
from tiegraph.geometry import transforms
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud


@dataclass(frozen=True)
class View:
    """What one station measured (N, 3) and without its noise (N, 3), in its own frame; normals; world_from_station."""

    xyz: np.ndarray
    true: np.ndarray
    normal: np.ndarray
    sigma_m: np.ndarray
    world_from_station: np.ndarray


def bumpy(direction, seed):
    """(N, 3) points of an object of 0.4 m with 40 bumps and dents of some centimetres."""
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(40, 3))
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    high, sharp = 0.02 * rng.normal(size=40), rng.uniform(15, 80, 40)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * (0.2 + np.exp(sharp * (direction @ middle.T - 1)) @ high)[:, None]


def views(angles_deg, seed=0, points=30_000, noise_m=(0.0003, 0.0008), distance_m=0.7):
    """Stations round the object, at random turns; noise along the ray grows with the distance from 0.45 to 0.75 m."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(10 * points, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    xyz, normal = bumpy(direction, seed), _normals(direction, seed)
    out = []
    for k, angle in enumerate(np.radians(angles_deg)):
        eye = distance_m * np.array([np.cos(angle), np.sin(angle), 0.15 * np.sin(3 * angle)])
        away = np.linalg.norm(xyz - eye, axis=1)
        ray = (xyz - eye) / away[:, None]
        seen = (np.einsum("ij,ij->i", normal, -ray) > 0.35) & (ray @ -eye > 0.9 * np.linalg.norm(eye))
        rows = rng.permutation(np.flatnonzero(seen))[:points]
        pose = transforms.rigid(Rotation.random(random_state=100 * seed + k).as_matrix(), eye)
        sigma = np.interp(away[rows], [0.45, 0.75], noise_m)
        true = transforms.apply(transforms.invert(pose), xyz[rows])
        noisy = true * (1 + rng.normal(size=len(rows)) * sigma / away[rows])[:, None]
        out.append(View(noisy, true, normal[rows] @ pose[:3, :3], sigma, pose))
    return out


def _normals(direction, seed):
    along = np.cross(direction, [0.36, 0.48, 0.8])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across, step = np.cross(direction, along), 1e-4
    a, b = (bumpy(direction + step * t, seed) - bumpy(direction - step * t, seed) for t in (along, across))
    out = np.cross(a, b)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return out * np.sign(np.einsum("ij,ij->i", out, direction))[:, None]


def write_view(view, path, origin=None):
    """A cloud file as `tiegraph shots` leaves it."""
    count = len(view.xyz)
    normal, sigma = view.normal.astype(np.float32), view.sigma_m.astype(np.float32)
    cloud = Cloud(view.xyz, np.full((count, 3), 128, np.uint8), normal, sigma, np.full(count, 2, np.uint8), origin)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_cloud(cloud, path)


def error_m(world_from_shot, some):
    """RMS of the true points of views by their poses, after one rigid motion of all."""
    here = np.concatenate([transforms.apply(p, v.true) for p, v in zip(world_from_shot, some)])
    there = np.concatenate([transforms.apply(v.world_from_station, v.true) for v in some])
    return rms(off_after_similarity(here, there, with_scale=False))


def hall(bays=8, bay_m=2.0, side_m=0.02):
    """(N, 3) points of a hall 5 m wide and 3 m high: walls, floor, both ends, a column a bay on both sides, and at one
    end a block, so that the hall turned round is another one."""
    rng, long = np.random.default_rng(0), bays * bay_m

    def face(corner, u, v):
        count = int(np.linalg.norm(u) * np.linalg.norm(v) / side_m**2)
        return np.asarray(corner) + rng.random((count, 1)) * np.asarray(u) + rng.random((count, 1)) * np.asarray(v)

    faces = [face([0, -2.5, 0], [long, 0, 0], [0, 5, 0])]
    faces += [face([0, y, 0], [long, 0, 0], [0, 0, 3]) for y in (-2.5, 2.5)]
    faces += [face([x, -2.5, 0], [0, 5, 0], [0, 0, 3]) for x in (0, long)]
    faces += [face([0.6, 0.3, 0], [0, 1.2, 0], [0, 0, 1.8]), face([0, 0.3, 0], [0.6, 0, 0], [0, 0, 1.8])]
    faces += [face([0, 1.5, 0], [0.6, 0, 0], [0, 0, 1.8]), face([0, 0.3, 1.8], [0.6, 0, 0], [0, 1.2, 0])]
    for k in range(bays):
        for low, high in ((-1.9, -1.5), (1.5, 1.9)):
            x = (k + 0.5) * bay_m - 0.2
            faces += [face([x + d, low, 0], [0, 0.4, 0], [0, 0, 3]) for d in (0, 0.4)]
            faces += [face([x, y, 0], [0.4, 0, 0], [0, 0, 3]) for y in (low, high)]
    return np.concatenate(faces)


def scans(xyz, eyes, seed=0, points=40_000, noise_m=0.003, reach_m=9.0):
    """What scanners at (K, 3) see of points all round: the nearest in each direction of half a degree, to their reach;
    each in a frame turned at random."""
    out = []
    for k, eye in enumerate(np.asarray(eyes, float)):
        rng, ray = np.random.default_rng(100 * seed + k), xyz - eye
        away = np.linalg.norm(ray, axis=1)
        near = away < reach_m
        ray, away = ray[near], away[near]
        turn = np.degrees([np.arctan2(ray[:, 1], ray[:, 0]), np.arcsin(ray[:, 2] / away)])
        cell = (turn[0] // 0.5) * 1000 + turn[1] // 0.5
        order = np.lexsort([away, cell])
        first = order[np.r_[True, np.diff(cell[order]) > 0]]
        rows = rng.permutation(first)[:points]
        pose = transforms.rigid(Rotation.random(random_state=100 * seed + k).as_matrix(), eye)
        true = transforms.apply(transforms.invert(pose), ray[rows] + eye)
        noisy = true * (1 + rng.normal(size=len(rows)) * noise_m / away[rows])[:, None]
        out.append(View(noisy, true, np.full_like(true, np.nan), np.full(len(rows), noise_m), pose))
    return out
