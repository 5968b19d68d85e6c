"""The coarse model of a survey of any size: mapped whole, or in blocks that are joined by the images they share.

A model is made roughly (few tracks, no final adjustment): accurate to decimetres, which is enough to choose pairs and
to start from. A survey of some hundred images is mapped as a whole. Beyond that, ``scene.blocks`` cuts the graph of
frames into blocks that keep both passes of a place together and share the frames at their borders, and
``scene.joining`` puts their models into one frame. Joins that the shared images or the other joins contradict are
refused and reported; components that cannot be joined are judged separately, and the match counts decide between them.

A block whose two passes were tied by a wall similar to the right one has one pass in a wrong place, without any
residual of its own. The images shared with a neighbouring block then fall into two groups: each has the same shape in
both models, but not the same relative position. In each of the blocks the smallest set of points that connects the two
groups is found (minimum cut; consecutive frames are never separated). The block with the smaller set is taken as wrong,
the ties behind these points as false (``false_ties``), and the next try is made without them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from tiegraph.geometry import transforms
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.tuning import CoarseTuning
from tiegraph.scene.blocks import Block, Join, JoinResult, Poses, join, join_models, moved
from tiegraph.scene.graph import cheapest_cut, parts
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import JoiningTuning

NAMED = 5  # tears listed singly in the notes


@dataclass(frozen=True)
class Assembled:
    """Models of the survey, most images first, without common images, and notes. One model if the survey was mapped
    as a whole or all blocks were joined; more if it is torn; perhaps none. ``suspects``: images i, j (K,) of the ties
    that make blocks disagree (``false_ties``)."""

    models: tuple[CoarseModel, ...]
    notes: tuple[str, ...] = ()
    suspects: tuple[np.ndarray, np.ndarray] = (np.zeros(0, np.int64), np.zeros(0, np.int64))


def assembled(
    scene: Scene,
    blocks: Sequence[Block],
    models: Sequence[CoarseModel | None],
    tuning: CoarseTuning,
    joining: JoiningTuning,
) -> Assembled:
    """The models of the blocks, None where none could be made, joined by their shared images."""
    if is_whole(blocks, scene):
        return Assembled(tuple(m for m in models if m is not None and m.placed().any()))
    made = [(b, m) for b, m in zip(blocks, models) if m is not None and m.placed().any()]
    poses = []
    for block, model in made:
        there, far = model.placed(), np.nanmedian(model.reach()[:, 1]) if len(model.point) else np.nan
        poses.append(Poses(block.images[there], model.cam_from_world[there], float(far) if np.isfinite(far) else 1.0))
    joined = join_models(poses, joining)
    whose = _whose(scene, made, joined.part)
    found = [_together(scene, made, joined, whose, k) for k in range(int(joined.part.max(initial=-1)) + 1)]
    found.sort(key=lambda m: -int(m.placed().sum()))
    return Assembled(
        models=tuple(m for m in found if m.placed().any()),
        notes=_notes(scene, blocks, made, joined),
        suspects=false_ties(scene, made, poses, joined.joins, tuning.near_steps, joining),
    )


def is_whole(blocks: Sequence[Block], scene: Scene) -> bool:
    """Whether a single block covers the survey."""
    return len(blocks) == 1 and len(blocks[0]) == len(scene)


def _whose(scene: Scene, made: Sequence[tuple[Block, CoarseModel]], part: np.ndarray) -> np.ndarray:
    """(N,) model that gives each image: its block's, else one of the largest component that shares it; -1 = none."""
    out = np.full(len(scene), -1)
    order = np.argsort(-part, kind="stable")  # the last assignment wins
    for lent in (True, False):
        for k in order:
            block, model = made[k]
            out[block.images[model.placed() & (block.own != lent)]] = k
    return out


def _together(
    scene: Scene, made: Sequence[tuple[Block, CoarseModel]], joined: JoinResult, whose: np.ndarray, part: int
) -> CoarseModel:
    """The models of one component in one frame; a point is taken from the model that gives most of its observers."""
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
    cameras = [scene.sensor_of(n).camera if c is None else c for n, c in enumerate(cameras)]
    return CoarseModel(
        cam_from_world=poses,
        cameras=tuple(cameras),
        points=np.concatenate(points),
        image=np.concatenate(image),
        point=np.concatenate(point),
        rigs=_rigs(scene, [made[k] for k in members]),
    )


def _rigs(scene: Scene, members: Sequence[tuple[Block, CoarseModel]]) -> tuple[Rig, ...]:
    """Of each rig the estimate that differs least from those of the other blocks; of equal ones that of most images.

    Blocks are mapped roughly, and one of ten had a camera rotated by 10 deg.
    """
    out = []
    for index, given in enumerate(scene.rigs):
        rig = scene.rig[scene.frame]
        count = [int(np.sum(rig[block.images[model.placed()]] == index)) for block, model in members]
        order = [k for k in np.argsort(-np.array(count), kind="stable") if count[k]]
        found = [members[k][1].rigs[index] for k in order]
        apart = [sum(_apart(one, other) for other in found) for one in found]
        out.append(found[int(np.argmin(apart))] if found else given)
    return tuple(out)


def _apart(one: Rig, other: Rig) -> float:
    """Difference of two estimates of a rig, radians: of mountings, and of rays at 45 deg by the focal lengths."""
    total = 0.0
    for a, b in zip(one.sensors, other.sensors):
        if a.sensor_from_rig is not None and b.sensor_from_rig is not None:
            total += float(np.radians(transforms.angle_deg(a.sensor_from_rig[:3, :3], b.sensor_from_rig[:3, :3])))
        focal = [c.mean_focal_length() for c in (a.camera, b.camera) if c is not None]
        if len(focal) == 2 and min(focal) > 0:  # a panorama has none
            total += 0.5 * abs(float(np.log(focal[0] / focal[1])))
    return total


def _notes(
    scene: Scene, blocks: Sequence[Block], made: Sequence[tuple[Block, CoarseModel]], joined: JoinResult
) -> tuple[str, ...]:
    shared, agree = sum(j.shared for j in joined.joins if j.holds), sum(j.agree for j in joined.joins if j.holds)
    text = f"mapped in {len(blocks)} blocks of up to {max(map(len, blocks), default=0)} images"
    if shared:
        text += f"; {100 * agree / shared:.0f} % of the images shared by two blocks agree"
    out = [text]
    if len(made) < len(blocks):
        out.append(f"{len(blocks) - len(made)} blocks could not be mapped")
    torn = [j for j in joined.joins if not j.holds]
    for j in torn[:NAMED]:
        ends = " and ".join(_span(scene, made[k][0]) for k in (j.a, j.b))
        out.append(f"the blocks of {ends} share {j.shared} images, of which {j.agree} agree: they are not joined there")
    if len(torn) > NAMED:
        out.append(f"{len(torn) - NAMED} more pairs of blocks do not agree")
    sizes = np.sort(np.unique(joined.part, return_counts=True)[1])[::-1].tolist()
    if len(sizes) > 1:
        said = f"torn into {len(sizes)} components of {', '.join(map(str, sizes))} blocks"
        out.append(f"{said}; between them the numbers of preview matches decide")
    return tuple(f"coarse model: {said}" for said in out)


def _span(scene: Scene, block: Block) -> str:
    """The first and last own image of a block's first pass."""
    images = block.images[block.own]
    frame = scene.frame[images]
    first = images[scene.sequence[frame] == scene.sequence[frame].min()]
    order = np.argsort(scene.sequence_index[scene.frame[first]], kind="stable")
    return f"{scene.names[first[order[0]]]} .. {scene.names[first[order[-1]]]}"


# ---------------------------------------------------------------- false ties where two blocks disagree


def false_ties(
    scene: Scene,
    made: Sequence[tuple[Block, CoarseModel]],
    poses: Sequence[Poses],
    joins: Sequence[Join],
    near_steps: int,
    tuning: JoiningTuning,
) -> tuple[np.ndarray, np.ndarray]:
    """Images i, j (K,) of the ties that make blocks disagree. ``poses``: those of the joined models. ``near_steps``:
    frames of a pass closer than this are never separated."""
    ends = [np.zeros((2, 0), np.int64)]
    for one in joins:
        if one.holds or one.refused:
            continue
        others = []  # the poses of images that the join does not explain
        for whole in (poses[one.a], poses[one.b]):
            keep = ~np.isin(whole.images, one.images)
            others.append(Poses(whole.images[keep], whole.cam_from_world[keep], whole.range_))
        other = join(one.a, one.b, others[0], others[1], tuning)
        if other is None or min(len(one.images), len(other.images)) < tuning.shared:
            continue
        cuts = [cut_between(scene, *made[k], (one.images, other.images), near_steps) for k in (one.a, one.b)]
        found = [c for c in cuts if c is not None]
        if found:
            left, right, _ = min(found, key=lambda c: c[2])
            ends.append(np.stack([left, right]))
    i, j = np.concatenate(ends, axis=1)
    return i, j


def cut_between(
    scene: Scene, block: Block, model: CoarseModel, groups: tuple[np.ndarray, np.ndarray], near_steps: int
) -> tuple[np.ndarray, np.ndarray, int] | None:
    """The image pairs i, j (K,) behind the smallest set of points that connects two groups of images in the model of
    a block, and the size of the set; None if consecutive frames connect them, or nothing does."""
    shape = len(model.cam_from_world), len(model.points)
    sees = csr_array((np.ones(len(model.image), np.int64), (model.image, model.point)), shape=shape)
    both = coo_array(sees @ sees.T)
    upper = both.coords[0] < both.coords[1]
    (i, j), points = (ends[upper] for ends in both.coords), both.data[upper]  # images and how many points both see
    frames, frame = np.unique(scene.frame[block.images], return_inverse=True)
    a, b = frame[i], frame[j]
    # A section of a pass, or a frame that is not placed, is one piece.
    at = np.unique(frame[model.placed()])
    order = at[np.lexsort((scene.sequence_index[frames[at]], scene.rig[frames[at]], scene.sequence[frames[at]]))]
    near = near_frames(scene, frames[order[:-1]], frames[order[1:]], near_steps)
    piece = parts(order[:-1][near], order[1:][near], len(frames))
    first, second = (np.unique(piece[frame[np.isin(block.images, group)]]) for group in groups)
    if np.isin(first, second).any():
        return None
    node = np.where(np.isin(piece, first), 0, np.where(np.isin(piece, second), 1, 2 + piece))
    links = coo_array((points.astype(np.int32), (node[a], node[b])), shape=(int(node.max()) + 1,) * 2)
    side = cheapest_cut(csr_array(links + links.T), 0, 1)[node]
    cut = side[a] != side[b]
    if not cut.any():
        return None
    return block.images[i[cut]], block.images[j[cut]], int(points[cut].sum())


def near_frames(scene: Scene, a: np.ndarray, b: np.ndarray, steps: int) -> np.ndarray:
    """(K,) bool: frames a, b (K,) differ and are at most this many steps of one pass apart."""
    same = (
        (scene.sequence[a] == scene.sequence[b]) & (scene.sequence[a] >= 0) & (scene.rig[a] == scene.rig[b]) & (a != b)
    )
    return same & (np.abs(scene.sequence_index[a] - scene.sequence_index[b]) <= steps)
