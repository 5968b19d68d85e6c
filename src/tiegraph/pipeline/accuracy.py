"""Glue of paper 002's design: the accuracy of every previewed pair, by a bundle adjustment of its two images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.papers.fuse2014 import TwoView, two_view
from tiegraph.pipeline.files import load_scene
from tiegraph.pipeline.previews import preview_of
from tiegraph.scene.filecache import cached_by_file
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning import TwoViewTuning


def with_accuracy(
    pairs: Pairs,
    scene: Scene,
    ties: PreviewMatches,
    folder: Path,
    run_map: Callable[..., list[Any]],
    tuning: TwoViewTuning,
) -> Pairs:
    """The pairs with ``sigma_m`` (how far the adjustment moves the base) and ``h_over_b`` of those that were previewed.

    The base between two frames of a pass is as long as their numbers are apart (002, 2.3), else one: lengths are in
    frames, not metres. ``run_map``: map over a pool.
    """
    unknown = np.full(len(pairs), np.nan)  # what the coarse model says of them is none of the paper's
    pairs = pairs.with_(sigma_m=unknown, h_over_b=unknown)
    row = ties.find(pairs.i, pairs.j)
    if not (row >= 0).any():  # nothing was previewed (pairs in sequence without a coarse model)
        return pairs
    matches = np.where(row >= 0, ties.counts()[row], 0)
    usable = np.flatnonzero((pairs.dropped == 0) & (matches >= tuning.min_points))
    items = [_TwoViews(int(pairs.i[k]), int(pairs.j[k]), ties.of(int(row[k]))) for k in usable]
    found: list[TwoView | None] = run_map(_two_view_item, items, folder, tuning)
    sigma, ratio = np.array(pairs.sigma_m), np.array(pairs.h_over_b)
    frame_i, frame_j = scene.frame[pairs.i], scene.frame[pairs.j]
    apart = np.where(
        scene.sequence[frame_i] == scene.sequence[frame_j],
        np.abs(scene.sequence_index[frame_i] - scene.sequence_index[frame_j]),
        1,
    )
    base = np.maximum(apart, 1)
    for k, one in zip(usable, found):
        if one is not None:
            sigma[k] = one.moved * base[k]
            if frame_i[k] != frame_j[k]:  # images of one frame are no copies of each other
                ratio[k] = one.range
    return pairs.with_(sigma_m=sigma, h_over_b=ratio)


@dataclass(frozen=True)
class _TwoViews:
    """Two images of the scene and their matches (M, 2)."""

    i: int
    j: int
    match: np.ndarray


def _two_view_item(item: _TwoViews, folder: Path, tuning: TwoViewTuning) -> TwoView | None:
    i, j, match = item.i, item.j, item.match
    scene = _checked(folder)
    a, b = preview_of(folder, scene.names[i]), preview_of(folder, scene.names[j])
    cameras = [scene.sensor_of(k).camera for k in (i, j)]
    if cameras[0] is None or cameras[1] is None:
        return None
    pixel = 1.0 / min(a.scale, b.scale)
    return two_view(a.xy[match[:, 0]], b.xy[match[:, 1]], cameras[0], cameras[1], tuning, pixel)


@cached_by_file(2, lambda folder: folder / "network" / "scene.json")
def _checked(folder: Path) -> Scene:
    return load_scene(folder / "network" / "scene.json")
