"""Which ties are false where two blocks of the coarse model do not agree.

A block whose two passes were tied by a wall like the right one has one of them in a wrong place, without any error of
its own. The images that it shares with a neighbour then fall into two groups: each is the same in both models, but not
where the one is against the other. One of the blocks must be wrong. In each of them, the fewest points that hold the
two groups together are looked for (minimum cut; frames that follow each other are never cut apart): the block where
they are fewer is taken to be wrong, as in ``trust``, and the ties behind these points to be false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.coarse.trust import near_frames
from tiegraph.scene.blocks import Block
from tiegraph.scene.graph import cheapest_cut, parts
from tiegraph.scene.joining import Join, Poses, join
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import JoiningTuning


@dataclass(frozen=True)
class Cut:
    """Pairs of images i, j (K,) that hold two groups of images together in a model, by so many shared ``points``."""

    i: np.ndarray
    j: np.ndarray
    points: int


def false_ties(
    scene: Scene,
    made: Sequence[tuple[Block, CoarseModel]],
    poses: Sequence[Poses],
    joins: Sequence[Join],
    near_steps: int,
    tuning: JoiningTuning,
) -> tuple[np.ndarray, np.ndarray]:
    """Images i, j (K,) of the ties that put blocks at odds. ``poses``: those of the models that were joined.
    ``near_steps``: frames of a pass that are never cut apart."""
    i, j = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for one in joins:
        if one.holds or one.refused:
            continue
        first, second = (_without(poses[k], one.images) for k in (one.a, one.b))
        other = join(one.a, one.b, first, second, tuning)
        if other is None or min(len(one.images), len(other.images)) < tuning.shared:
            continue
        cuts = [cut_between(scene, *made[k], (one.images, other.images), near_steps) for k in (one.a, one.b)]
        found = [c for c in cuts if c is not None]
        if found:
            least = min(found, key=lambda c: c.points)
            i.append(least.i)
            j.append(least.j)
    return np.concatenate(i), np.concatenate(j)


def _without(poses: Poses, images: np.ndarray) -> Poses:
    keep = ~np.isin(poses.images, images)
    return Poses(poses.images[keep], poses.cam_from_world[keep], poses.range_)


def cut_between(
    scene: Scene, block: Block, model: CoarseModel, groups: tuple[np.ndarray, np.ndarray], near_steps: int
) -> Cut | None:
    """The fewest points that hold two groups of images (K,) together in the model of a block; None where frames that
    follow each other do so, or nothing does."""
    i, j, points = _shared_points(model)
    frames, frame = np.unique(scene.frame[block.images], return_inverse=True)
    a, b = frame[i], frame[j]
    piece = _pieces(scene, frames, np.isin(np.arange(len(frames)), frame[model.placed()]), near_steps)
    first, second = (np.unique(piece[frame[np.isin(block.images, group)]]) for group in groups)
    if np.isin(first, second).any():
        return None
    node = np.where(np.isin(piece, first), 0, np.where(np.isin(piece, second), 1, 2 + piece))
    links = coo_array((points.astype(np.int32), (node[a], node[b])), shape=(int(node.max()) + 1,) * 2)
    side = cheapest_cut(csr_array(links + links.T), 0, 1)[node]
    cut = side[a] != side[b]
    if not cut.any():
        return None
    return Cut(i=block.images[i[cut]], j=block.images[j[cut]], points=int(points[cut].sum()))


def _pieces(scene: Scene, frames: np.ndarray, placed: np.ndarray, near_steps: int) -> np.ndarray:
    """(F,) number of the stretch of a pass that a frame is on; frames not ``placed`` (F,) are by themselves."""
    at = np.flatnonzero(placed)
    order = at[np.lexsort((scene.sequence_index[frames[at]], scene.rig[frames[at]], scene.sequence[frames[at]]))]
    before, after = order[:-1], order[1:]
    near = near_frames(scene, frames[before], frames[after], near_steps)
    return parts(before[near], after[near], len(frames))


def _shared_points(model: CoarseModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Images i < j of the model and how many points both see, (K,) each."""
    shape = len(model.cam_from_world), len(model.points)
    sees = csr_array((np.ones(len(model.image), np.int64), (model.image, model.point)), shape=shape)
    both = coo_array(sees @ sees.T)
    i, j = both.coords
    upper = i < j
    return i[upper], j[upper], both.data[upper]
