"""A large survey mapped roughly in blocks and in parallel, to give the poses from which the whole survey is adjusted.

A mapper's time grows faster than the number of images, and so does the damage of one false tie. Blocks keep both
passes of a place together and share the frames at their borders (``scene/blocks.py``); their models are joined by the
shared images (``scene/blocks.py``). All images are then adjusted together, starting from these poses.
"""

import logging
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.child import run_in_child
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.scene.blocks import Block, JoinResult, Poses, blocks_of, join_models, moved
from tiegraph.scene.colmapmodel import image_poses, read_model, tracks
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.run import MappingResult, Request, run_mapper
from tiegraph.sfm.verified import ViewGraph

log = logging.getLogger(__name__)

RunMap = Callable[..., list[Any]]  # function, items, further arguments: a result an item, perhaps in parallel


def serially(function: Callable[..., Any], items: Sequence[Any], *args: Any) -> list[Any]:
    """One item after the other."""
    return [function(item, *args) for item in items]


def poses_by_blocks(
    request: Request, graph: ViewGraph, tuning: SceneTuning, log_file: Path, run_map: RunMap
) -> tuple[np.ndarray, str]:
    """cam_from_world (N, 4, 4) of all images from rough models of blocks, NaN = in no block of the largest component;
    a note. ``request``: the request of the whole survey; ``run_map`` runs the blocks."""
    scene, method = request.scene, replace(request.method, rough=True, positions=False)
    blocks = blocks_of(scene, graph.pairs[:, 0], graph.pairs[:, 1], graph.inliers, tuning.blocks)
    parts = [
        replace(
            request,
            folder=request.folder / f"block-{k}",
            method=method,
            matches=replace(request.matches, only=block.images),
        )
        for k, block in enumerate(blocks)
    ]
    request.folder.mkdir(parents=True, exist_ok=True)
    made = [(blocks[k], m) for k, found in enumerate(run_map(_map_block, parts, log_file)) for m in found]
    shutil.rmtree(request.folder, ignore_errors=True)
    joined = join_models([m for _, m in made], tuning.joining)
    return _together(len(scene), made, joined), _note(blocks, made, joined)


def _map_block(request: Request, log_file: Path) -> list[Poses]:
    """The rough models of a block; none if COLMAP finds none or gives up."""
    try:
        mapped: MappingResult = run_in_child(run_mapper, request, log=log_file, task="mapping of a block")
    except ReconstructionError as error:
        log.warning("%s: %s", request.folder.name, error)
        return []
    found = [_poses(read_model(folder), request.scene) for folder in mapped.folders]
    shutil.rmtree(request.folder, ignore_errors=True)
    return [m for m in found if m is not None]


def _poses(model: pycolmap.Reconstruction, scene: Scene) -> Poses | None:
    poses = image_poses(model, scene)
    images = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    points, image, point = tracks(model, scene)
    if not len(images) or not len(point):
        return None
    far = np.linalg.norm(points[point] - transforms.centre(poses)[image], axis=1)
    return Poses(images, poses[images], float(np.median(far)))


def _together(count: int, made: Sequence[tuple[Block, Poses]], joined: JoinResult) -> np.ndarray:
    """(N, 4, 4) poses of the largest component; an image is taken from the block that owns it, else from a block that
    shares it."""
    out = np.full((count, 4, 4), np.nan)
    for own in (False, True):
        for k, (block, model) in enumerate(made):
            if joined.part[k] == 0:
                rows = np.isin(model.images, block.images[block.own == own])
                out[model.images[rows]] = moved(model.cam_from_world[rows], joined.world_from[k])
    return out


def _note(blocks: Sequence[Block], made: Sequence[tuple[Block, Poses]], joined: JoinResult) -> str:
    held = sum(j.holds for j in joined.joins)
    placed = sum(joined.part[k] == 0 for k in range(len(made)))
    return (
        f"mapped in {len(blocks)} blocks of up to {max(map(len, blocks), default=0)} images ({len(made)} models, "
        f"{placed} of them in one component; {held} of {len(joined.joins)} joins between blocks are consistent)"
    )
