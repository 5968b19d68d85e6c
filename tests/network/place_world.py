"""Images that see stretches of a line or ring of landmarks: overlap, preview matches and descriptors by landmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boat_world import CHANCE, Result
from tiegraph.network.loose import BagsOfWords, bags_of_words
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

FEATURES = 100  # an image shows
FOUND = 0.6  # of the landmarks in view, those found again in a picture
NOISE = 9.0  # of a descriptor's 128 bytes; unrelated ones differ by 60


@dataclass
class Places:
    """N images, each at a place of the landmarks it sees: ``centre`` (N,), modulo ``around`` if that is not 0.

    ``ghosts``: share of unrelated pairs whose single preview reaches the count of a true one.
    """

    centre: np.ndarray
    around: float = 0.0
    ghosts: float = 0.0
    asked: int = 0

    def __len__(self) -> int:
        return len(self.centre)

    def overlap(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) share of landmarks of image i that image j sees too."""
        apart = np.abs(self.centre[i] - self.centre[j])
        if self.around:
            apart = np.minimum(apart % self.around, self.around - apart % self.around)
        return np.maximum(0, 1 - apart / FEATURES)

    def match(self, pairs: np.ndarray) -> list[Result]:
        """Preview results of pairs (P, 2)."""
        self.asked += len(pairs)
        chance = np.array([np.random.default_rng((7, int(i), int(j))).random(3) for i, j in pairs]).reshape(-1, 3)
        count = CHANCE - 2 + 4 * chance[:, 0] + 60 * self.overlap(pairs[:, 0], pairs[:, 1])
        count = np.where(chance[:, 1] < self.ghosts, np.maximum(count, 16 + 10 * chance[:, 2]), count)
        return [Result(int(c)) for c in count]

    def descriptors(self) -> list[np.ndarray]:
        """(K, 128) u1 of each image."""
        return [self._descriptors(k) for k in range(len(self))]

    def _descriptors(self, k: int) -> np.ndarray:
        seen = np.round(self.centre[k]).astype(int) + np.arange(FEATURES) - FEATURES // 2
        seen = np.mod(seen, round(self.around)) if self.around else seen
        rng = np.random.default_rng(k)
        seen = seen[rng.random(FEATURES) < FOUND]
        exact = np.array([_landmark(int(s)) for s in seen]).reshape(-1, 128)
        return np.clip(exact + rng.normal(0, NOISE, exact.shape), 0, 255).astype(np.uint8)

    def useful(self, least: float = 0.15) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every pair i, j (K,), and whether its overlap is enough."""
        i, j = np.triu_indices(len(self), 1)
        return i, j, self.overlap(i, j) >= least


_known: dict[int, np.ndarray] = {}


def _landmark(number: int) -> np.ndarray:
    if number not in _known:
        _known[number] = np.clip(np.random.default_rng(number % (1 << 32)).exponential(40, 128), 0, 255)
    return _known[number]


_words: dict[bytes, BagsOfWords] = {}


def words_of(world: Places) -> BagsOfWords:
    """Words of a world, learnt once for all tests."""
    key = np.append(world.centre, world.around).astype(float).tobytes()
    if key not in _words:
        _words[key] = bags_of_words(world.descriptors())
    return _words[key]


def shuffled_ring(count: int, spacing: float = 12.0) -> Places:
    """Photographs at equal distances on a ring, in no order."""
    return Places(np.random.default_rng(1).permutation(count) * spacing, around=count * spacing)


def video(count: int) -> Scene:
    """Frames of one camera."""
    rig = Rig("camera", (Sensor("camera"),))
    names = [f"clip/{k:05d}.jpg" for k in range(count)]
    return simple_scene(
        rig, names, np.arange(count), np.zeros(count), np.zeros(count), np.arange(count), sequences=("clip",)
    )
