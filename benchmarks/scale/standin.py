"""What takes the place of pixels: matches of previews, descriptors, and the model of a block.

The CPU time that it takes is counted apart (``Spent``); what the real thing costs an image is known from real runs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from benchmarks.network.canalworld import FOCAL, HEIGHT, WIDTH, CanalWorld, Image
from benchmarks.scale.survey import Descriptors
from tiegraph.features.preview import PreviewMatch
from tiegraph.geometry import transforms
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.coarse.search import Coarse
from tiegraph.pipeline import features as previews_glue
from tiegraph.pipeline import network as candidates_glue
from tiegraph.pipeline import network as coarse_glue
from tiegraph.project.run import Run
from tiegraph.scene.pairs import PreviewMatches, Visibility
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene

TRACKS = 100  # of an image, at most, as a rough model of a block has them
LEAST = 12  # observations of an image that is placed
BEND_M, NOISE_M, NOISE_DEG = 0.15, 0.01, 0.03  # of a block's model: what its ends are off by, and each image


class Spent:
    """CPU seconds and calls of what is no part of the program: ``with spent: ...``."""

    def __init__(self) -> None:
        self.cpu_s, self.calls = 0.0, 0

    def __enter__(self) -> None:
        self._began = time.process_time()

    def __exit__(self, *_: object) -> None:
        self.cpu_s += time.process_time() - self._began
        self.calls += 1


@contextmanager
def without_pixels(world: CanalWorld) -> Iterator[dict[str, Spent]]:
    """The glue of candidates, coarse, network and design with the world's previews in place of files of previews."""
    spent = {name: Spent() for name in ("previews", "descriptors", "mapping")}

    def match_item(pair: tuple[int, int], *_: Any) -> PreviewMatch:
        with spent["previews"]:
            return world.match(np.array([pair]))[0]

    def preview(_: Path, name: str) -> Image:
        with spent["previews"]:
            return world.images[world.scene.image_index[name]]

    def light_of(name: str, _: Any) -> tuple[float, float]:
        return float(world.brightness[world.scene.image_index[name]]), float("nan")

    def model(_: Any, scene: Scene, ties: PreviewMatches) -> CoarseModel | None:
        with spent["mapping"]:
            return block_model(world, scene, ties)

    def surface(run: Run, found: Coarse, _: PreviewMatches) -> Visibility:
        assert found.model is not None
        return found.model.visibility(run.settings.tuning.network.coarse)  # by its own points: previews have no pixels

    with ExitStack() as stack:
        for owner, name, value in (
            (previews_glue, "match_item", match_item),
            (previews_glue, "_light_of", light_of),
            (candidates_glue, "_Descriptors", lambda *_: Descriptors(world, spent["descriptors"])),
            (coarse_glue, "read_preview", preview),
            (coarse_glue, "coarse_model", model),
            (coarse_glue, "surface_seen", surface),
        ):
            stack.enter_context(patch.object(owner, name, value))
        yield spent


def block_model(world: CanalWorld, scene: Scene, ties: PreviewMatches) -> CoarseModel | None:
    """A model of the images of a block: true poses and points in a frame and unit of its own, bent as such models are.
    Only true matches are in it; what false ties do to a mapper is not simulated."""
    index = np.array([world.scene.image_index[name] for name in scene.names])
    rng = np.random.default_rng(index[:1])
    image, point = _observed(world, index, ties, rng)
    placed = np.bincount(image, minlength=len(index)) >= LEAST
    image, point = image[placed[image]], point[placed[image]]
    known, point, count = np.unique(point, return_inverse=True, return_counts=True)
    if not placed.any() or not (count >= 2).any():
        return None
    true = world.cam_from_world[index]
    centre = transforms.centre(true)
    middle, half = centre[placed].mean(axis=0), np.ptp(centre[placed, 0]) / 2 + 1e-9
    bend = BEND_M * rng.normal(size=3) * (0.2, 1, 1)

    def bent(xyz: np.ndarray) -> np.ndarray:
        return xyz + ((xyz[:, :1] - middle[0]) / half) ** 2 * bend

    scale, turn = float(np.exp(rng.normal(0, 0.5))), Rotation.random(rng=rng).as_matrix()
    off = Rotation.from_rotvec(np.radians(NOISE_DEG) * rng.normal(size=(len(index), 3))).as_matrix()
    rotation = off @ true[:, :3, :3] @ turn.T
    moved = scale * (bent(centre) + rng.normal(0, NOISE_M, centre.shape) - middle) @ turn.T
    poses = transforms.rigid(rotation, -np.einsum("kab,kb->ka", rotation, moved))
    poses[~placed] = np.nan
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[FOCAL, WIDTH / 2, HEIGHT / 2])
    return CoarseModel(
        cam_from_world=poses,
        cameras=(camera,) * len(index),
        points=scale * (bent(world.points[known]) - middle) @ turn.T,
        image=image,
        point=point,
        rigs=tuple(_true_rig(world, rig, camera) for rig in scene.rigs),
    )


def _observed(
    world: CanalWorld, index: np.ndarray, ties: PreviewMatches, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Image of the block and point of the world of the observations (K,) of true matches, at most TRACKS an image."""
    points = [world.images[k].point for k in index]
    start = np.cumsum([0] + [len(p) for p in points])[:-1]
    all_points = np.concatenate(points)
    pair = np.repeat(np.arange(len(ties)), ties.counts())
    ends = [start[side[pair]] + ties.matches[:, k] for k, side in enumerate((ties.i, ties.j))]
    true = all_points[ends[0]] == all_points[ends[1]]
    rows = np.unique(np.concatenate([e[true] for e in ends]))
    image = np.searchsorted(start, rows, side="right") - 1
    # Points that many images see first, so that what an image keeps its neighbours keep too.
    seen = np.unique(all_points[rows], return_inverse=True, return_counts=True)
    order = np.lexsort((rng.random(len(rows)), -seen[2][seen[1]], image))
    rank = np.arange(len(rows)) - np.searchsorted(image[order], image[order])
    keep = np.sort(order[rank < TRACKS])
    return image[keep], all_points[rows[keep]]


def _true_rig(world: CanalWorld, rig: Rig, camera: pycolmap.Camera) -> Rig:
    """The rig as a model finds it."""
    one = world.cam_from_world[world.scene.frame == world.scene.frame[0]]
    sensors = [
        replace(s, camera=camera, sensor_from_rig=pose @ transforms.invert(one[0])) for s, pose in zip(rig.sensors, one)
    ]
    return replace(rig, sensors=tuple(sensors))
