"""A simulated canal kept in files, so that a stage's process holds of it only what it looks at.

The features of an image are read when they are asked for: those of 100 000 images are 1.5 GB.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.network import canalworld
from benchmarks.network.canalworld import CanalWorld, Image, canal_world
from tiegraph.scene.scene import Scene

_FEATURE = np.dtype([("point", "<i4"), ("xy", "<f4", 2), ("ray", "<f4", 3), ("far", "<f4")])
_ARRAYS = ("cam_from_world", "points", "side", "start_m", "texture", "brightness")
_CACHED = 4000  # images of about 17 kB
OUTAGE_M, EVERY_M = 200.0, 2000.0  # of GNSS: length, and from one to the next
SIGMA_M = 0.05  # of a GNSS position


def write_survey(folder: Path, images: int, seed: int) -> None:
    """A canal of about ``images`` images with GNSS positions, written below ``folder``."""
    world = canal_world(images, seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.json").write_text(_with_positions(world, np.random.default_rng(seed)).to_json())
    for name in _ARRAYS:
        np.save(folder / f"{name}.npy", getattr(world, name))
    ends = np.cumsum([0] + [len(image.point) for image in world.images])
    np.save(folder / "ends.npy", ends)
    with (folder / "features.bin").open("wb") as file:
        for image in world.images:
            rows = np.zeros(len(image.point), _FEATURE)
            for name in _FEATURE.names or ():
                rows[name] = getattr(image, name)
            rows.tofile(file)


def _with_positions(world: CanalWorld, rng: np.random.Generator) -> Scene:
    """The scene with a GNSS position of each frame, but for outages."""
    scene = world.scene
    first = np.unique(scene.frame, return_index=True)[1]
    pose = np.linalg.inv(world.cam_from_world[first])
    outage = np.mod(pose[:, 0, 3], EVERY_M) < OUTAGE_M
    prior = np.full((scene.frames, 4, 4), np.nan)
    prior[:, 3] = (0, 0, 0, 1)
    prior[~outage, :3, 3] = pose[~outage, :3, 3] + rng.normal(0, SIGMA_M, (int(np.sum(~outage)), 3))
    sigma = np.where(outage[:, None], np.nan, np.full((scene.frames, 3), SIGMA_M))
    return scene.with_(world_from_rig=prior, position_sigma_m=sigma, prior="gnss")


def read_survey(folder: Path) -> CanalWorld:
    """The canal of ``write_survey``; features are read when asked for."""
    scene = Scene.from_json((folder / "scene.json").read_text())
    arrays = {name: np.load(folder / f"{name}.npy") for name in _ARRAYS}
    return CanalWorld(scene=scene, images=_Features(folder), **arrays)


class _Features(Sequence[Image]):
    """The features of every image, in a file."""

    def __init__(self, folder: Path) -> None:
        self._ends = np.load(folder / "ends.npy")
        self._path = folder / "features.bin"
        self._read = lru_cache(_CACHED)(self._of)

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, image: Any) -> Any:
        return self._read(range(len(self))[image])  # IndexError behind the last one ends a loop

    def _of(self, image: int) -> Image:
        start, end = self._ends[image : image + 2]
        rows = np.fromfile(self._path, _FEATURE, int(end - start), offset=int(start) * _FEATURE.itemsize)
        return Image(rows["point"].astype(np.int64), rows["xy"], rows["ray"], rows["far"])


class Descriptors(Sequence[np.ndarray]):
    """Descriptors (K, 128) u1 of every image: those of the texture's points, weathered."""

    def __init__(self, world: CanalWorld, spent: Any) -> None:
        rng = np.random.default_rng(world.rng)
        self._world, self._spent = world, spent
        self._noise = rng.normal(0, 18, (4096, 128)).astype(np.int16)
        self._seeds = rng.integers(0, 2**31, int(world.texture.max()) + 1)
        self._known = lru_cache(256)(self._of_texture)

    def __len__(self) -> int:
        return len(self._world.images)

    def __getitem__(self, image: Any) -> Any:
        image = range(len(self))[image]
        with self._spent:
            point = self._world.images[image].point
            texture = self._world.texture[point // canalworld.POINTS]
            out = np.empty((len(point), 128), np.int16)
            for t in np.unique(texture):
                own = texture == t
                out[own] = self._known(int(t))[point[own] % canalworld.POINTS]
            noise = self._noise[(image * 977 + 31 * np.arange(len(point))) % len(self._noise)]
            return np.clip(out + noise, 0, 255).astype(np.uint8)

    def _of_texture(self, texture: int) -> np.ndarray:
        x = np.random.default_rng(self._seeds[texture]).gamma(0.5, size=(canalworld.POINTS, 128))
        x = np.sqrt(x)
        return np.clip(512 * x / np.linalg.norm(x, axis=1, keepdims=True), 0, 255).astype(np.int16)
