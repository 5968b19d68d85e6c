"""Time and memory of the design on a simulated survey of many images: ``python -m benchmarks.network.design_large``.

Five cameras a frame, two passes along two walls of landmarks; every image is a candidate for its partners that see the
same stretch of wall; one pair in three was previewed, the others have an expected count only.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

from tiegraph.design.design import design
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import Tuning
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

CAMERAS = 5
SEEN = 240  # landmarks in the view of an image
STEP = 16  # landmarks from frame to frame
DETECTED, MATCHED = 0.6, 0.55  # chance of a feature, and of a match of two features in images that look the same way
_BLOCK = 20_000  # pairs drawn together


def large_survey(images: int, partners: int, previewed: float, seed: int = 0) -> tuple[Scene, Pairs, PreviewMatches]:
    """A scene of about ``images`` images, ``images * partners`` candidates or fewer, and their ties."""
    rng = np.random.default_rng(seed)
    frames = images // (2 * CAMERAS)
    frame = np.repeat(np.arange(2 * frames), CAMERAS)
    sensor = np.tile(np.arange(CAMERAS), 2 * frames)
    back = frame >= frames
    place = np.where(back, 2 * frames - 1 - frame, frame)
    yaw = 2 * np.pi * sensor / CAMERAS + 0.4 + np.pi * back  # seen from the wall
    wall = np.sin(yaw) > 0
    first = (STEP * place + SEEN * np.cos(yaw)).astype(np.int64) + SEEN  # of the landmarks in view
    scene = simple_scene(
        Rig("ring", tuple(Sensor(f"cam{c}") for c in range(CAMERAS))),
        [f"{a:06d}_{c}.jpg" for a, c in zip(frame, sensor)],
        frame,
        sensor,
        np.repeat([0, 1], frames),
        np.tile(np.arange(frames), 2),
        sequences=("up", "down"),
    )
    i, j, shared = [], [], []
    for side in (False, True):
        own = np.flatnonzero(wall == side)
        own = own[np.argsort(first[own], kind="stable")]
        for k in range(1, 2 * partners + 1):
            a, b = own[:-k], own[k:]
            common = SEEN - (first[b] - first[a])
            near = common > 0.15 * SEEN
            i.append(np.minimum(a, b)[near])
            j.append(np.maximum(a, b)[near])
            shared.append(common[near])
    i, j, shared = np.concatenate(i), np.concatenate(j), np.concatenate(shared)
    turn = np.abs((yaw[i] - yaw[j] + np.pi) % (2 * np.pi) - np.pi)
    chance = MATCHED * np.exp(-((turn / 1.2) ** 2))
    count = shared * DETECTED**2 * chance
    good = np.flatnonzero(count > 8)
    good = rng.permutation(good)[: images * partners]
    seen = np.sort(rng.permutation(good)[: round(previewed * len(good))])
    score = np.where(np.isin(good, seen), np.nan, count[good] * rng.lognormal(0, 0.3, len(good)))
    pairs = Pairs.make(i[good], j[good], "model", score=score, overlap=shared[good] / SEEN)
    return scene, pairs, _draw(i[seen], j[seen], chance[seen], first, rng)


def _draw(
    i: np.ndarray, j: np.ndarray, chance: np.ndarray, first: np.ndarray, rng: np.random.Generator
) -> PreviewMatches:
    """Matches of pairs i < j: landmarks both have a feature of, each with the chance of its pair."""
    key = i << 32 | j
    order = np.argsort(key)
    i, j, chance = i[order], j[order], chance[order]
    matches, counts = [], []
    for k in range(0, len(i), _BLOCK):
        block = slice(k, k + _BLOCK)
        landmark = first[j[block], None] + np.arange(SEEN)[None]
        at = landmark - first[i[block], None]
        there = (at >= 0) & (at < SEEN) & (rng.random(at.shape, np.float32) < chance[block, None])
        row, column = np.nonzero(there)
        known = _detected(i[block][row], landmark[row, column]) & _detected(j[block][row], landmark[row, column])
        row, column = row[known], column[known]
        matches.append(np.stack([at[row, column], column], axis=1).astype(np.uint16))
        counts.append(np.bincount(row, minlength=len(at)))
    return PreviewMatches(i, j, np.concatenate([[0], np.cumsum(np.concatenate(counts))]), np.concatenate(matches))


def _detected(image: np.ndarray, landmark: np.ndarray) -> np.ndarray:
    """Whether an image has a feature of a landmark: a fixed random number of both."""
    with np.errstate(over="ignore"):
        mixed = (image.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) ^ (
            landmark.astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        )
        mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return (mixed >> np.uint64(40)).astype(float) < DETECTED * 2**24


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _say(*words: object) -> None:
    sys.stdout.write(" ".join(str(w) for w in words) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Print candidates, pairs kept, seconds and peak memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=100_000)
    parser.add_argument("--partners", type=int, default=40, help="candidates an image brings")
    parser.add_argument("--previewed", type=float, default=1 / 3)
    parser.add_argument("--method", default="hybrid")
    parser.add_argument("--budget", default="loss")
    parser.add_argument("--pairs-per-image", type=int, default=16)
    given = parser.parse_args()
    scene, pairs, ties = large_survey(given.images, given.partners, given.previewed)
    made = _peak_mib()
    _say(f"{len(scene)} images, {len(pairs)} candidates, {len(ties)} previewed, {len(ties.matches)} matches")
    settings = DesignSettings(method=given.method, budget=given.budget, pairs_per_image=given.pairs_per_image)
    began = time.process_time()
    found = design(pairs, scene, ties, settings, Tuning(few_pairs=0))
    seconds = time.process_time() - began
    _say(f"{seconds:.1f} CPU s, peak {_peak_mib():.0f} MiB ({made:.0f} MiB before the design)")
    _say(found.counts)
    _say("\n".join(found.notes))


if __name__ == "__main__":
    main()
