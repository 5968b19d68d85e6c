"""A large survey in blocks of bounded size, so that the time to map it grows linearly with its images.

The frames are a graph, linked by the preview matches of their images and by their order. Normalised cuts (Shi & Malik
2000), nested until every part is small enough, keep images of the same place together: both passes there, whatever
their order. Each part then takes from its neighbours the frames with the most ties to it. By these shared frames two
blocks are joined again (as in Zhu et al. 2018, Very large-scale global SfM by distributed motion averaging): the
rotation of the similarity comes from the images' own rotations, because the centres of a straight path do not determine
the rotation about the path; then its scale and shift from the centres. All blocks together: logarithms of the scales,
rotations and shifts by least squares over all joins, one after another.

Where walls repeat, a third of the matches tie distant places, and a cut through such a graph puts these into
one block, where nothing contradicts them. So if frames have prior positions, only links between near frames count:
each block is then one section of the path with all its passes, and ties between distant places are in no block.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import breadth_first_order
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.scene.graph import forest, parts, symmetric
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.scene import Scene, between_neighbours
from tiegraph.scene.sorting import evenly
from tiegraph.scene.tuning import BlocksTuning, JoiningTuning

# Nearest frames by prior positions whose links count. Of 1200 rendered images with repeated walls (canal generator,
# seed 5) 12, 24 and 48 give the same three sections of the path, also with noise of 5 m and 30 % of positions missing.
_NEAR = 24
_ORDER = 0.05  # weight of the links by the order of a pass alone, in mean links
_LEAST_TIES, _LEAST_LENT = 10, 4  # pairs of images that make two parts neighbours; frames that one lends the other
_AGREE, _TURN_DEG = 0.6, 3.0  # share of the shared images that must agree; tolerance of an image's poses in two models
_SHIFT = 0.06  # likewise, as a share of the distance to its points
_ITERATIONS, _VECTORS = 12, 4  # for the second eigenvector: the next eigenvalues of a long path lie close together
_ASKED = 40  # shared images, evenly spread, whose rotations are tried for the one with the most agreement


@dataclass(frozen=True)
class Block:
    """Images mapped together: ``images`` (K,) increasing; ``own`` (K,) bool, the others are lent by neighbours."""

    images: np.ndarray
    own: np.ndarray

    def __len__(self) -> int:
        return len(self.images)

    def part_of(self, scene: Scene, ties: PreviewMatches) -> tuple[Scene, PreviewMatches]:
        """The scene of the block's images and the ties between them, numbered in that scene."""
        number = np.full(len(scene), -1)
        number[self.images] = np.arange(len(self))
        inside = ties.where((number[ties.i] >= 0) & (number[ties.j] >= 0))
        return scene.only(self.images), PreviewMatches(
            i=number[inside.i], j=number[inside.j], start=inside.start, matches=inside.matches
        )


def blocks_of(
    scene: Scene, i: np.ndarray, j: np.ndarray, matches: np.ndarray, tuning: BlocksTuning
) -> tuple[Block, ...]:
    """Blocks of a survey by ties of images i, j (T,) and their number of matches (T,); a single one for a small survey.
    Every image is some block's own, except those of small components without ties to the rest."""
    if in_one_piece(scene, tuning):
        return (Block(np.arange(len(scene)), np.ones(len(scene), bool)),)
    size = np.bincount(scene.frame, minlength=scene.frames)
    graph, ties_between = _links(scene, i, j, matches)
    label = _cut(graph, size, round(_times(scene, tuning) * tuning.own))
    lent = _lent(graph, ties_between, label, size, tuning)
    out = []
    for k in range(label.max() + 1):
        inside = label[scene.frame] == k
        images = np.flatnonzero(inside | lent[k][scene.frame])
        if len(images) >= tuning.least:
            out.append(Block(images, inside[images]))
    return tuple(out)


def in_one_piece(scene: Scene, tuning: BlocksTuning) -> bool:
    """Whether a survey is small enough to be mapped as a whole."""
    return len(scene) <= _times(scene, tuning) * tuning.whole


def _times(scene: Scene, tuning: BlocksTuning) -> float:
    """Factor of the block size: 1 if most frames have positions in one world, which keep distant places apart."""
    world = scene.pose_world()
    return 1.0 if np.bincount(world[world >= 0], minlength=1).max() > 0.5 * scene.frames else tuning.unplaced


def _links(scene: Scene, i: np.ndarray, j: np.ndarray, matches: np.ndarray) -> tuple[csr_array, csr_array]:
    """(F, F) strength of the links between frames by preview matches and order; (F, F) pairs of images that tie."""
    a, b, count = scene.frame[i], scene.frame[j], matches.astype(float)
    apart = (a != b) & ~_far(scene, a, b)
    strength = symmetric(a[apart], b[apart], count[apart], scene.frames)
    pairs = symmetric(a[apart], b[apart], np.ones(int(apart.sum())), scene.frames)
    order = np.lexsort((scene.sequence_index, scene.rig, scene.sequence))
    before, after = order[:-1], order[1:]
    next_ = (scene.sequence[before] == scene.sequence[after]) & (scene.rig[before] == scene.rig[after])
    next_ &= scene.sequence[before] >= 0
    level = _ORDER * float(strength.data.mean()) if strength.nnz else 1.0
    path = symmetric(before[next_], after[next_], np.full(int(next_.sum()), level), scene.frames)
    return csr_array(strength + path), pairs


def _far(scene: Scene, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) bool: links between frames a, b (T,) neither of which is among the nearest ones of the other, by
    prior positions, interpolated along the pass. Frames beyond its known ends are linked with the ``near`` around them
    on the pass alone: a false link would pull the end of a pass elsewhere. For other frames nothing is known."""
    pose = np.array(scene.world_from_rig)
    positions = pose[:, :3, 3] = between_neighbours(pose[:, :3, 3], scene)
    world = scene.with_(world_from_rig=pose).pose_world()
    beside = csr_array((scene.frames, scene.frames), dtype=bool)
    for number in np.unique(world[world >= 0]):
        frames = np.flatnonzero(world == number)
        _, nearest = cKDTree(positions[frames]).query(positions[frames], k=min(_NEAR + 1, len(frames)))
        nearest = frames[nearest.reshape(len(frames), -1)]
        here = np.repeat(frames, nearest.shape[1])
        beside = beside + csr_array((np.ones(nearest.size, bool), (here, nearest.ravel())), shape=beside.shape)
    beside = csr_array(beside + beside.T)
    compared = (world[a] >= 0) & (world[a] == world[b])
    beyond = (world < 0) & np.isin(scene.sequence, scene.sequence[(world >= 0) & (scene.sequence >= 0)])
    follow = (scene.sequence[a] == scene.sequence[b]) & (scene.sequence[a] >= 0)
    follow &= np.abs(scene.sequence_index[a] - scene.sequence_index[b]) <= _NEAR // 2
    return ((beyond[a] | beyond[b]) & ~follow) | (compared & ~np.asarray(beside[a, b]).ravel())


def _cut(graph: csr_array, size: np.ndarray, own: int) -> np.ndarray:
    """(F,) part of every frame; none has more than ``own`` images, unless one frame has."""
    label = np.zeros(len(size), int)
    row, column = graph.tocoo().coords
    piece = parts(row, column, len(size))
    todo = [np.flatnonzero(piece == k) for k in range(piece.max() + 1)]
    done: list[np.ndarray] = []
    while todo:
        frames = todo.pop()
        count = -(-int(size[frames].sum()) // own)
        if count < 2 or len(frames) < 2:
            done.append(frames)
            continue
        first = _first_side(csr_array(graph[frames][:, frames]), size[frames], (count // 2, count), own)
        todo += [frames[first], frames[~first]]
    for k, frames in enumerate(done):
        label[frames] = k
    return label


def _first_side(graph: csr_array, size: np.ndarray, blocks: tuple[int, int], own: int) -> np.ndarray:
    """(F,) bool: the side for the first of some ``blocks``, (some, all), by the cheapest cut."""
    share, total = blocks[0] / blocks[1], float(size.sum())
    order = np.argsort(_second_vector(graph), kind="stable")
    place = np.argsort(order)
    coo = graph.tocoo()
    low, high = np.minimum(*place[np.stack(coo.coords)]), np.maximum(*place[np.stack(coo.coords)])
    # Links that a cut after place k severs: from k or before to behind it.
    severed = np.cumsum(np.bincount(low, coo.data, len(order)) - np.bincount(high, coo.data, len(order)))[:-1]
    done = np.cumsum(size[order])[:-1] / total
    allowed = np.abs(done - share) <= 0.2 * min(share, 1 - share)  # a cut off the half may be where ties are few
    # Neither side may need one block more than intended: an extra block costs more than a cut through ties.
    allowed &= (done * total <= blocks[0] * own) & ((1 - done) * total <= (blocks[1] - blocks[0]) * own)
    allowed[np.argmin(np.abs(done - share))] = True
    volume = np.cumsum(np.bincount(place[coo.coords[0]], coo.data, len(order)))
    cost = severed / np.maximum(np.minimum(volume[:-1], volume[-1] - volume[:-1]), 1e-12)
    return place <= np.argmin(np.where(allowed, cost, np.inf))


def _second_vector(graph: csr_array) -> np.ndarray:
    """(F,) second eigenvector of the normalised Laplacian over the root of the degrees: neighbours have near values."""
    degree = np.asarray(graph.sum(axis=1)).ravel()
    root = np.sqrt(np.maximum(degree, 1e-12))
    normal = diags_array(1 / root) @ graph @ diags_array(1 / root)
    solve = splu((diags_array(np.full(len(root), 1.0 + 1e-9)) - normal).tocsc()).solve
    first = root / np.linalg.norm(root)
    block = np.random.default_rng(0).normal(size=(len(root), _VECTORS))
    for _ in range(_ITERATIONS):
        block = solve(block)
        block -= np.outer(first, first @ block)
        block = np.linalg.qr(block)[0]
    _, turn = np.linalg.eigh(block.T @ (normal @ block))
    return (block @ turn[:, -1]) / root


def _lent(
    graph: csr_array, pairs: csr_array, label: np.ndarray, size: np.ndarray, tuning: BlocksTuning
) -> list[np.ndarray]:
    """For every part (F,) bool: the frames it takes from its neighbours, of each those with the most ties to it."""
    count = label.max() + 1
    member = csr_array((np.ones(len(label)), label, np.arange(len(label) + 1)), shape=(len(label), count))
    between = (member.T @ pairs @ member).toarray()
    strength = csr_array(graph @ member).tocsc()  # of every frame to every part
    out = []
    for k in range(count):
        taken = np.zeros(len(label), bool)
        column = slice(strength.indptr[k], strength.indptr[k + 1])
        tied, value = strength.indices[column], strength.data[column]
        for other in np.flatnonzero((between[k] >= _LEAST_TIES) & (np.arange(count) != k)):
            mine = label[tied] == other
            frames = tied[mine][np.argsort(-value[mine], kind="stable")]
            enough = np.searchsorted(np.cumsum(size[frames]), tuning.lent) + 1
            taken[frames[: np.maximum(enough, _LEAST_LENT)]] = True
        out.append(taken)
    return out


@dataclass(frozen=True)
class Poses:
    """The data of a model for joining: ``images`` (K,) increasing numbers, ``cam_from_world`` (K, 4, 4) without NaN,
    ``range_`` usual distance to their points, in model units."""

    images: np.ndarray
    cam_from_world: np.ndarray
    range_: float


@dataclass(frozen=True)
class Join:
    """Two models a, b: ``b_from_a``, the number of shared images, which of them agree with it, ``images`` (K,), how
    many must, and ``middle`` (3,) of their centres in the frame of a. ``refused``: other joins contradict it."""

    a: int
    b: int
    b_from_a: Similarity
    shared: int
    images: np.ndarray
    needed: float
    middle: np.ndarray
    refused: bool = False

    @property
    def agree(self) -> int:
        """How many of the shared images agree."""
        return 0 if self.refused else len(self.images)

    @property
    def holds(self) -> bool:
        """Whether enough of the shared images agree."""
        return self.agree >= self.needed


@dataclass(frozen=True)
class JoinResult:
    """``world_from`` each model, ``part`` (M,): number of its connected component, 0 = the one with most images;
    worlds of different components are unrelated. ``joins``: all, including refused ones."""

    world_from: tuple[Similarity, ...]
    part: np.ndarray
    joins: tuple[Join, ...]


def join_models(models: Sequence[Poses], tuning: JoiningTuning) -> JoinResult:
    """Put models into one frame, that of the first model of each component."""
    couples = ((a, b) for a in range(len(models)) for b in range(a))
    joins = tuple(j for a, b in couples if (j := join(a, b, models[a], models[b], tuning)))
    good = _consistent([j for j in joins if j.holds], len(models))
    joins = tuple(j if not j.holds or any(j is g for g in good) else replace(j, refused=True) for j in joins)
    part = parts(np.array([j.a for j in good], int), np.array([j.b for j in good], int), len(models))
    size = np.bincount(part, [len(m.images) for m in models])
    rank = np.argsort(np.argsort(-size, kind="stable"))
    return JoinResult(_adjusted(good, len(models)), rank[part], joins)


def moved(cam_from_model: np.ndarray, world_from_model: Similarity) -> np.ndarray:
    """cam_from_world (K, 4, 4) in units of the world."""
    rotation = cam_from_model[:, :3, :3] @ world_from_model.rotation.T
    centre = world_from_model(transforms.centre(cam_from_model))
    return transforms.rigid(rotation, -np.einsum("kab,kb->ka", rotation, centre))


def join(a: int, b: int, first: Poses, second: Poses, tuning: JoiningTuning) -> Join | None:
    """The transformation from the first model's frame to the second's; None if they share too few images."""
    shared, at_a, at_b = np.intersect1d(first.images, second.images, assume_unique=True, return_indices=True)
    if len(shared) < tuning.shared:
        return None
    pose_a, pose_b = first.cam_from_world[at_a], second.cam_from_world[at_b]
    turns = np.swapaxes(pose_b[:, :3, :3], 1, 2) @ pose_a[:, :3, :3]
    some = turns[evenly(len(turns), _ASKED)]
    near = transforms.angle_deg(some[:, None], turns[None]) < _TURN_DEG
    turn = Rotation.from_matrix(turns[near[np.argmax(near.sum(axis=1))]]).mean().as_matrix()
    same = transforms.angle_deg(turn[None], turns) < _TURN_DEG
    x, y = transforms.centre(pose_a), transforms.centre(pose_b)
    x_turned = x @ turn.T
    limit = _SHIFT * second.range_
    scale, shift = _start(x_turned, y, same, (first.range_, second.range_))
    agree = same & (np.linalg.norm(scale * x_turned + shift - y, axis=1) < limit)
    for _ in range(3):  # refinements of scale and shift to the images that agree
        if agree.sum() < tuning.shared:
            break
        scale, shift = _fitted(x_turned[agree], y[agree], scale, limit)
        agree = same & (np.linalg.norm(scale * x_turned + shift - y, axis=1) < limit)
    return Join(
        a=a,
        b=b,
        b_from_a=Similarity(scale, turn, shift),
        shared=len(shared),
        images=shared[agree],
        needed=max(tuning.shared, _AGREE * len(shared)),
        middle=np.median(x, axis=0),
    )


def _start(x: np.ndarray, y: np.ndarray, same: np.ndarray, ranges: tuple[float, float]) -> tuple[float, np.ndarray]:
    """Scale and shift that take most of the centres x to y (K, 3), of those ``same`` (K,): from two distant ones of
    them. If the images hardly moved, the scale is the ratio of the distances to their points, ``ranges``.

    No median over all: if a model has one of two passes in a wrong place, half the distances are wrong.
    """
    of = np.flatnonzero(same)
    asked = of[evenly(len(of), _ASKED)]
    i, j = (asked[k] for k in np.triu_indices(len(asked), 1))
    dx, dy = np.linalg.norm(x[i] - x[j], axis=1), np.linalg.norm(y[i] - y[j], axis=1)
    long = dx >= np.median(dx) if len(dx) else np.zeros(0, bool)
    if not long.any() or np.median(dx[long]) < _SHIFT * ranges[0]:
        scale = ranges[1] / ranges[0]
        return scale, np.median((y - scale * x)[same], axis=0)
    scales = dy[long] / dx[long]
    middle_x, middle_y = (x[i] + x[j])[long] / 2, (y[i] + y[j])[long] / 2
    shifts = middle_y - scales[:, None] * middle_x
    off = np.linalg.norm(scales[:, None, None] * x[of] + shifts[:, None] - y[of], axis=2)
    best = np.argmin(np.minimum(off, _SHIFT * ranges[1]).sum(axis=1))
    return float(scales[best]), shifts[best]


def _fitted(x: np.ndarray, y: np.ndarray, scale: float, limit: float) -> tuple[float, np.ndarray]:
    """Scale and shift that take x to y (K, 3), by least squares; the scale is kept if the images hardly moved."""
    dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
    if scale**2 * np.mean(np.sum(dx**2, axis=1)) > limit**2:
        scale = max(float(np.sum(dx * dy) / np.sum(dx**2)), 1e-12)
    return scale, y.mean(axis=0) - scale * x.mean(axis=0)


def _consistent(joins: list[Join], models: int) -> list[Join]:
    """The joins without those that contradict their strongest tree: repeated walls can tie two blocks wrongly,
    together with all the images they share."""
    if not joins:
        return joins
    i, j = (np.array([getattr(x, n) for x in joins]) for n in ("a", "b"))
    tree = forest(i, j, np.array([x.agree for x in joins], float), models)
    world_from = _along_tree([joins[k] for k in tree], models)
    here = np.stack([world_from[x.a](x.middle[None])[0] for x in joins])
    there = np.stack([world_from[x.b](x.b_from_a(x.middle[None]))[0] for x in joins])
    off = np.linalg.norm(here - there, axis=1) / max(float(np.linalg.norm(np.ptp(here, axis=0))), 1e-12)
    turned = [world_from[x.a].rotation.T @ world_from[x.b].rotation @ x.b_from_a.rotation for x in joins]
    off_deg = transforms.angle_deg(np.stack(turned), np.eye(3)) / np.sqrt(len(tree))
    good = ((off < 0.1) & (off_deg < _TURN_DEG)) | np.isin(np.arange(len(joins)), tree)
    return [x for x, fine in zip(joins, good) if fine]


def _along_tree(tree: list[Join], models: int) -> list[Similarity]:
    """world_from each model along joins without loops; the first model of each part is its world."""
    steps = {(x.b, x.a): x.b_from_a for x in tree} | {(x.a, x.b): x.b_from_a.inverse() for x in tree}
    ends = np.array(list(steps), int).reshape(-1, 2).T
    graph = coo_array((np.ones(len(steps), np.int8), tuple(ends)), shape=(models, models)).tocsr()
    at: dict[int, Similarity] = {}
    for root in range(models):
        if root not in at:
            order, before = breadth_first_order(graph, root)
            at[root] = Similarity()
            for k in order[1:].tolist():
                at[k] = at[int(before[k])] @ steps[int(before[k]), k]
    return [at[k] for k in range(models)]


def _adjusted(joins: list[Join], models: int) -> tuple[Similarity, ...]:
    """world_from each model by all joins."""
    i, j = (np.array([getattr(x, n) for x in joins], int) for n in ("a", "b"))
    weight = np.array([x.agree for x in joins], float)
    tree = forest(i, j, weight, models) if len(joins) else np.zeros(0, int)
    start = _along_tree([joins[k] for k in tree], models)
    if len(tree) == len(joins):  # no loops: nothing to distribute
        return tuple(start)
    solve = _solver(i, j, np.sqrt(weight), models)
    scale = np.exp(solve @ np.log([x.b_from_a.scale for x in joins]))
    turn = np.stack([s.rotation for s in start])
    measured = np.stack([x.b_from_a.rotation for x in joins])
    for _ in range(10):  # rounds of the rotations of all blocks
        # world_from_a = world_from_b b_from_a; the misclosure, as a rotation vector in the world.
        missing = Rotation.from_matrix(turn[j] @ measured @ np.swapaxes(turn[i], 1, 2)).as_rotvec()
        turn = Rotation.from_rotvec(solve @ missing).as_matrix() @ turn
    shift = np.stack([x.b_from_a.translation for x in joins])
    shift = solve @ (scale[j, None] * np.einsum("kab,kb->ka", turn[j], shift))
    return tuple(Similarity(float(s), r, t) for s, r, t in zip(scale, turn, shift))


def _solver(i: np.ndarray, j: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    """(count, K) from given (K, D) to values v of least squares: v[i] - v[j] = given, the first of each part zero."""
    held = np.unique(parts(i, j, count), return_index=True)[1]
    rows = np.zeros((len(i) + len(held), count))
    rows[np.arange(len(i)), i], rows[np.arange(len(i)), j] = weight, -weight
    rows[len(i) + np.arange(len(held)), held] = weight.max()
    return np.linalg.pinv(rows)[:, : len(i)] * weight
