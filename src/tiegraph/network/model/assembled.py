"""The preview model of a survey of any size: mapped whole, or in blocks that are joined by the images they share.

Time grows linearly with the images. Up to 600 images the model is mapped whole. Beyond, ``scene.blocks`` cuts the
graph of frames into blocks that keep both passes of a place together and share the frames at their borders. Each
block is mapped by itself, roughly (few tracks, no final adjustment), and ``scene.joining`` puts the models into one
frame by the images they share. Joins that the shared images or the other joins contradict are refused and reported.
Parts that do not hold together are judged each by itself, and the counts decide between them. The previews of an
image are bounded (``offsets``), pairs that the axes rule out are counted and not listed, and no process holds the
previews of all images.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from tiegraph.network.model.surveymodel import Maker, SurveyModel
from tiegraph.network.model.tuning import ModelTuning
from tiegraph.scene.blocks import Block, blocks_of
from tiegraph.scene.joining import Joined, Poses, join_models, moved
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties

NAMED = 5  # tears named one by one in the notes

log = logging.getLogger(__name__)


class SurveyMapper:
    """Makes models of one survey, of other ties each time it is asked.

    Blocks stay as they were cut the first time, and a block whose ties are those of the last time is not mapped again:
    where a few ties were wrong, only what they touch costs anything.
    """

    def __init__(self, scene: Scene, tuning: ModelTuning, make: Maker) -> None:
        self._scene = scene
        self._tuning = tuning
        self._make = make
        self._blocks: tuple[Block, ...] | None = None
        self._last: dict[int, tuple[Ties, SurveyModel | None]] = {}

    def __call__(self, ties: Ties) -> tuple[tuple[SurveyModel, ...], tuple[str, ...]]:
        """Models of the survey, most images first, none of which shares an image with another, and what people should
        know. One, if the survey was mapped whole or all blocks hold together; more where it is torn; perhaps none."""
        scene = self._scene
        blocks = self._blocks = (
            blocks_of(scene, ties, self._make.tuning.blocks) if self._blocks is None else self._blocks
        )
        if len(blocks) == 1 and len(blocks[0]) == len(scene):
            model = self._make.model(scene, ties, False)
            return (() if model is None or not model.placed().any() else (model,)), ()
        made: list[tuple[Block, SurveyModel]] = []
        for number, block in enumerate(blocks):
            model = self._of_block(number, ties)
            placed = 0 if model is None else int(model.placed().sum())
            log.info("block %d of %d: %d of %d images in its model", number + 1, len(blocks), placed, len(block))
            if model is not None and placed:
                made.append((block, model))
        poses = [_poses(block, model, self._tuning) for block, model in made]
        joined = join_models(poses, self._make.tuning.joining)
        whose = _whose(scene, made, joined.part)
        models = [_together(scene, made, joined, whose, k) for k in range(int(joined.part.max(initial=-1)) + 1)]
        models.sort(key=lambda m: -int(m.placed().sum()))
        return tuple(m for m in models if m.placed().any()), _notes(scene, blocks, made, joined)

    def _of_block(self, number: int, ties: Ties) -> SurveyModel | None:
        assert self._blocks is not None
        part, inside = self._blocks[number].part_of(self._scene, ties)
        before = self._last.get(number)
        if before is not None and np.array_equal(before[0].i, inside.i) and np.array_equal(before[0].j, inside.j):
            return before[1]
        model = self._make.model(part, inside, True) if len(inside) else None
        self._last[number] = inside, model
        return model


def _poses(block: Block, model: SurveyModel, tuning: ModelTuning) -> Poses:
    there = model.placed()
    far = np.nanmedian(model.reach(tuning)[:, 1]) if len(model.point) else np.nan
    return Poses(block.images[there], model.cam_from_world[there], float(far) if np.isfinite(far) else 1.0)


def _whose(scene: Scene, made: Sequence[tuple[Block, SurveyModel]], part: np.ndarray) -> np.ndarray:
    """(N,) the model each image is taken from: of the block whose own it is, else of one that was lent it and holds it,
    of the largest part; -1 = none holds it."""
    out = np.full(len(scene), -1)
    order = np.argsort(-part, kind="stable")  # what is written last stays
    for lent in (True, False):
        for k in order:
            block, model = made[k]
            out[block.images[model.placed() & (block.own != lent)]] = k
    return out


def _together(
    scene: Scene, made: Sequence[tuple[Block, SurveyModel]], joined: Joined, whose: np.ndarray, part: int
) -> SurveyModel:
    """The models of one part in one frame. A point is taken from the model that most of its observers are taken from,
    so that what two blocks see alike is there once."""
    poses = np.full((len(scene), 4, 4), np.nan)
    cameras: list = [None] * len(scene)
    points, image, point = [np.zeros((0, 3))], [np.zeros(0, int)], [np.zeros(0, int)]
    count = 0
    members = [int(k) for k in np.flatnonzero(joined.part == part)]
    for k, (block, model) in enumerate(made):
        for n, camera in zip(block.images, model.cameras):
            cameras[n] = camera if cameras[n] is None or whose[n] == k else cameras[n]
        if k not in members:
            continue
        own = whose[block.images] == k
        poses[block.images[own]] = moved(model.cam_from_world[own], joined.world_from[k])
        seen = np.bincount(model.point, minlength=len(model.points))
        keep = 2 * np.bincount(model.point, own[model.image], len(seen)) >= np.maximum(seen, 1)
        number = count + np.cumsum(keep) - 1
        observed = keep[model.point] & np.isin(whose[block.images[model.image]], members)
        points.append(joined.world_from[k](model.points[keep]))
        image.append(block.images[model.image[observed]])
        point.append(number[model.point[observed]])
        count += int(keep.sum())
    best = max(members, key=lambda k: int(made[k][1].placed().sum()))
    cameras = [scene.sensor_of(n).camera if c is None else c for n, c in enumerate(cameras)]
    joined_arrays = np.concatenate(points), np.concatenate(image), np.concatenate(point)
    return SurveyModel(poses, tuple(cameras), *joined_arrays, made[best][1].rigs)


def _notes(
    scene: Scene, blocks: Sequence[Block], made: Sequence[tuple[Block, SurveyModel]], joined: Joined
) -> tuple[str, ...]:
    shared, agree = sum(j.shared for j in joined.joins if j.holds), sum(j.agree for j in joined.joins if j.holds)
    text = f"preview model: mapped in {len(blocks)} blocks of up to {max(map(len, blocks), default=0)} images"
    if shared:
        text += f"; {100 * agree / shared:.0f} % of what two blocks share agrees"
    out = [text]
    if len(made) < len(blocks):
        out.append(f"preview model: of {len(blocks) - len(made)} blocks none could be made")
    torn = [j for j in joined.joins if not j.holds]
    for j in torn[:NAMED]:
        ends = " and ".join(_span(scene, made[k][0]) for k in (j.a, j.b))
        out.append(f"preview model: the blocks of {ends} share {j.shared} images, {j.agree} agree: not joined there")
    if len(torn) > NAMED:
        out.append(f"preview model: {len(torn) - NAMED} more couples of blocks do not agree")
    parts = len(np.unique(joined.part))
    if parts > 1:
        sizes = sorted((int(np.sum(joined.part == k)) for k in range(parts)), reverse=True)
        out.append(
            f"preview model: torn into {parts} parts of {', '.join(map(str, sizes))} blocks; between them the preview "
            "counts decide"
        )
    return tuple(out)


def _span(scene: Scene, block: Block) -> str:
    """From which to which own image of its first pass a block goes."""
    images = block.images[block.own]
    frame = scene.frame[images]
    first = images[scene.track[frame] == scene.track[frame].min()]
    order = np.argsort(scene.step[scene.frame[first]], kind="stable")
    return f"{scene.names[first[order[0]]]} .. {scene.names[first[order[-1]]]}"
