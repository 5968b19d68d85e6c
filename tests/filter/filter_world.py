"""A rig that drives along a street of points: key points, true matches, and the false ones of a repeated wall."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.filter.filter import Filtering, Prior, filter_pairs
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.tuning import CourseTuning

MAX_IMAGES = 2147483647
NOISE_PX = 0.5
LEAST = 15


def serial(function, items, *args):
    """The pool of the tests."""
    return [function(item, *args) for item in items]


@dataclass
class World:
    """Scene with the truth, and the database's content."""

    scene: Scene
    points: list[np.ndarray]
    matches: dict[tuple[int, int], np.ndarray]
    false: set[tuple[int, int]]

    def run(self, folder: Path, prior: Prior | None = None, **settings) -> tuple[Filtering, np.ndarray]:
        """(Result, false pairs (P,) bool)."""
        database = folder / "database.db"
        self.write(database)
        ends = np.array(sorted(self.matches))
        pairs = Pairs.make(ends[:, 0], ends[:, 1], "sequence")
        result = filter_pairs(
            database, self.scene, pairs, FilterSettings(**settings), (Tuning(), CourseTuning()), serial, prior
        )
        return result, np.array([(int(i), int(j)) in self.false for i, j in zip(pairs.i, pairs.j)])

    def write(self, path: Path) -> None:
        """The two tables that filter reads."""
        path.unlink(missing_ok=True)
        with sqlite3.connect(path) as c:
            c.execute("CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY, rows, cols, data BLOB)")
            c.execute("CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY, rows, cols, data BLOB)")
            for k, p in enumerate(self.points):
                c.execute("INSERT INTO keypoints VALUES (?,?,2,?)", (k + 1, len(p), p.astype(np.float32).tobytes()))
            for (i, j), m in self.matches.items():
                row = (MAX_IMAGES * (i + 1) + j + 1, len(m), m.astype(np.uint32).tobytes())
                c.execute("INSERT INTO two_view_geometries VALUES (?,?,2,?)", row)
        c.close()


def rig(sensors: int, radius_m: float) -> Rig:
    """A ring of cameras that look outwards; z is down the street's vertical."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[310, 310, 320, 240])
    out = []
    for k in range(sensors):
        turn = Rotation.from_euler("y", -72.0 * k, degrees=True).as_matrix()
        out.append(Sensor(f"cam{k}", camera, transforms.rigid(turn, np.array([0.0, 0.0, -radius_m]))))
    reference = out[0].sensor_from_rig
    out = [replace(s, sensor_from_rig=s.sensor_from_rig @ transforms.invert(reference)) for s in out]
    return Rig("ring", tuple(out))


def rig_from_world(f: int) -> np.ndarray:
    """Where frame f of the drive truly is."""
    turn = Rotation.from_euler("yxz", [6 * np.sin(f), 2 * np.cos(2 * f), 1.5 * np.sin(3 * f)], degrees=True)
    return transforms.rigid(turn.as_matrix(), -turn.apply([1.5 * f, 0.1 * np.sin(f), 0.2 * np.cos(f)]))


def world(frames: int = 5, sensors: int = 4, radius_m: float = 0.06, seed: int = 0, cloud: int = 500) -> World:
    """A gently winding drive of 1.5 m steps between walls 6 m away."""
    rng = np.random.default_rng(seed)
    x = np.column_stack(
        [rng.uniform(-20, 35, cloud), rng.uniform(-4, 4, cloud), rng.choice([-6, 6], cloud) + rng.normal(0, 1.2, cloud)]
    )
    the_rig = rig(sensors, radius_m)
    n = frames * sensors
    frame, sensor = np.repeat(np.arange(frames), sensors), np.tile(np.arange(sensors), frames)
    names = [f"cam{s}/{f}.jpg" for f, s in zip(frame, sensor)]
    scene = simple_scene(the_rig, names, frame, sensor, np.zeros(frames), np.arange(frames), sequences=("drive",))
    points, seen = [], []
    for k in range(n):
        local = transforms.apply(the_rig.sensors[sensor[k]].sensor_from_rig @ rig_from_world(frame[k]), x)
        pixel = local[:, :2] / np.maximum(local[:, 2:], 0.1) * 310 + [320, 240]
        inside = (local[:, 2] > 0.5) & (pixel > 0).all(axis=1) & (pixel < [640, 480]).all(axis=1)
        points.append(pixel[inside] + rng.normal(0, NOISE_PX, (int(inside.sum()), 2)))
        seen.append(np.flatnonzero(inside))
    matches = {}
    for i in range(n):
        for j in range(i + 1, n):
            if frame[i] == frame[j] or frame[j] - frame[i] > 4:
                continue
            both, a, b = np.intersect1d(seen[i], seen[j], return_indices=True)
            if len(both) >= LEAST:
                wrong = rng.random(len(both)) < 0.1
                b = np.where(wrong, rng.permutation(b), b)
                matches[i, j] = np.column_stack([a, b])
    return World(scene, points, matches, set())


def add_repeats(made: World, share: float = 0.35, seed: int = 1) -> World:
    """Give frame pairs 2 and more apart false pairs: matches of one consistent, wrong motion each, new key points."""
    rng = np.random.default_rng(seed)
    scene = made.scene
    for i in range(len(scene)):
        for j in range(i + 1, len(scene)):
            apart = scene.frame[j] - scene.frame[i]
            if apart < 2 or scene.sensor[i] == scene.sensor[j] or (i, j) in made.matches or rng.random() > share:
                continue
            turn = Rotation.from_rotvec(rng.normal(size=3) * 0.15).as_matrix()
            x = np.column_stack([rng.uniform(-3, 3, 60), rng.uniform(-2, 2, 60), rng.uniform(5, 8, 60)])
            y = x @ turn.T + rng.normal(size=3) * 0.6
            start_i, start_j = len(made.points[i]), len(made.points[j])
            for k, local in ((i, x), (j, y)):
                pixel = local[:, :2] / local[:, 2:] * 310 + [320, 240] + rng.normal(0, NOISE_PX, (60, 2))
                made.points[k] = np.concatenate([made.points[k], pixel])
            made.matches[i, j] = np.column_stack([start_i + np.arange(60), start_j + np.arange(60)])
            made.false.add((i, j))
    return made
