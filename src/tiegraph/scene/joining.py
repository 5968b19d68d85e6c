"""Models of blocks in one frame, by their shared images; if these disagree, the survey is torn, with a note.

Two models of the same images differ by a similarity. Its rotation comes from the images' own rotations, because the
centres of a straight path do not determine the rotation about the path; then its scale and shift from the centres. All
blocks together:
logarithms of the scales, rotations and shifts by least squares over all joins, one after another.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.scene.graph import forest, parts
from tiegraph.scene.sorting import evenly
from tiegraph.scene.tuning import JoiningTuning

_ASKED = 40  # shared images, evenly spread, whose rotations are tried for the one with the most agreement
_ROUNDS = 10  # of the rotations of all blocks


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
    good = _consistent([j for j in joins if j.holds], len(models), tuning)
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
    turn, same = _mean_turn(turns, tuning)
    x, y = transforms.centre(pose_a), transforms.centre(pose_b)
    x_turned = x @ turn.T
    limit = tuning.shift * second.range_
    scale, shift = _start(x_turned, y, same, (first.range_, second.range_), tuning)
    agree = same & (np.linalg.norm(scale * x_turned + shift - y, axis=1) < limit)
    for _ in range(3):  # refinements of scale and shift to the images that agree
        if agree.sum() < tuning.shared:
            break
        scale, shift = _fitted(x_turned[agree], y[agree], scale, limit)
        agree = same & (np.linalg.norm(scale * x_turned + shift - y, axis=1) < limit)
    needed = max(tuning.shared, tuning.agree * len(shared))
    return Join(
        a=a,
        b=b,
        b_from_a=Similarity(scale, turn, shift),
        shared=len(shared),
        images=shared[agree],
        needed=needed,
        middle=np.median(x, axis=0),
    )


def _mean_turn(turns: np.ndarray, tuning: JoiningTuning) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the rotations (K, 3, 3) that agree with the one with the most agreement, and which (K,) do."""
    some = turns[evenly(len(turns), _ASKED)]
    near = transforms.angle_deg(some[:, None], turns[None]) < tuning.turn_deg
    same = near[np.argmax(near.sum(axis=1))]
    mean = Rotation.from_matrix(turns[same]).mean().as_matrix()
    return mean, transforms.angle_deg(mean[None], turns) < tuning.turn_deg


def _start(
    x: np.ndarray, y: np.ndarray, same: np.ndarray, ranges: tuple[float, float], tuning: JoiningTuning
) -> tuple[float, np.ndarray]:
    """Scale and shift that take most of the centres x to y (K, 3), of those ``same`` (K,): from two distant ones of
    them. If the images hardly moved, the scale is the ratio of the distances to their points, ``ranges``.

    No median over all: if a model has one of two passes in a wrong place, half the distances are wrong.
    """
    of = np.flatnonzero(same)
    asked = of[evenly(len(of), _ASKED)]
    i, j = (asked[k] for k in np.triu_indices(len(asked), 1))
    dx, dy = np.linalg.norm(x[i] - x[j], axis=1), np.linalg.norm(y[i] - y[j], axis=1)
    long = dx >= np.median(dx) if len(dx) else np.zeros(0, bool)
    if not long.any() or np.median(dx[long]) < tuning.shift * ranges[0]:
        scale = ranges[1] / ranges[0]
        return scale, np.median((y - scale * x)[same], axis=0)
    scales = dy[long] / dx[long]
    middle_x, middle_y = (x[i] + x[j])[long] / 2, (y[i] + y[j])[long] / 2
    shifts = middle_y - scales[:, None] * middle_x
    off = np.linalg.norm(scales[:, None, None] * x[of] + shifts[:, None] - y[of], axis=2)
    best = np.argmin(np.minimum(off, tuning.shift * ranges[1]).sum(axis=1))
    return float(scales[best]), shifts[best]


def _fitted(x: np.ndarray, y: np.ndarray, scale: float, limit: float) -> tuple[float, np.ndarray]:
    """Scale and shift that take x to y (K, 3), by least squares; the scale is kept if the images hardly moved."""
    dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
    if scale**2 * np.mean(np.sum(dx**2, axis=1)) > limit**2:
        scale = max(float(np.sum(dx * dy) / np.sum(dx**2)), 1e-12)
    return scale, y.mean(axis=0) - scale * x.mean(axis=0)


# ---------------------------------------------------------------- all blocks together


def _consistent(joins: list[Join], models: int, tuning: JoiningTuning) -> list[Join]:
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
    good = ((off < tuning.drift) & (off_deg < tuning.turn_deg)) | np.isin(np.arange(len(joins)), tree)
    return [x for x, fine in zip(joins, good) if fine]


def _along_tree(tree: list[Join], models: int) -> list[Similarity]:
    """world_from each model along joins without loops; the first model of each part is its world."""
    at: list[Similarity | None] = [None] * models
    beside: list[list[tuple[int, Similarity]]] = [[] for _ in range(models)]
    for x in tree:
        beside[x.a].append((x.b, x.b_from_a.inverse()))  # a_from_b
        beside[x.b].append((x.a, x.b_from_a))
    for root in range(models):
        if at[root] is not None:
            continue
        at[root] = Similarity()
        todo = [root]
        while todo:
            here = todo.pop()
            for there, here_from_there in beside[here]:
                if at[there] is None:
                    at[there] = at[here] @ here_from_there  # type: ignore[operator]
                    todo.append(there)
    return at  # type: ignore[return-value]


def _adjusted(joins: list[Join], models: int) -> tuple[Similarity, ...]:
    """world_from each model by all joins."""
    i, j = (np.array([getattr(x, n) for x in joins], int) for n in ("a", "b"))
    weight = np.array([x.agree for x in joins], float)
    tree = forest(i, j, weight, models) if len(joins) else np.zeros(0, int)
    start = _along_tree([joins[k] for k in tree], models)
    if len(tree) == len(joins):  # no loops: nothing to distribute
        return tuple(start)
    solve = _solver(i, j, np.sqrt(weight), models)
    log_scale = solve(np.log([x.b_from_a.scale for x in joins])[:, None])[:, 0]
    scale = np.exp(log_scale)
    turn = np.stack([s.rotation for s in start])
    measured = np.stack([x.b_from_a.rotation for x in joins])
    for _ in range(_ROUNDS):
        # world_from_a = world_from_b b_from_a; the misclosure, as a rotation vector in the world.
        missing = Rotation.from_matrix(turn[j] @ measured @ np.swapaxes(turn[i], 1, 2)).as_rotvec()
        turn = Rotation.from_rotvec(solve(missing)).as_matrix() @ turn
    shift = np.stack([x.b_from_a.translation for x in joins])
    shift = solve(scale[j, None] * np.einsum("kab,kb->ka", turn[j], shift))
    return tuple(Similarity(float(s), r, t) for s, r, t in zip(scale, turn, shift))


def _solver(i: np.ndarray, j: np.ndarray, weight: np.ndarray, count: int) -> Callable[[np.ndarray], np.ndarray]:
    """Least squares of values v with v[i] - v[j] = given (K, D), the first of each part zero."""
    held = np.unique(parts(i, j, count), return_index=True)[1]
    rows = np.zeros((len(i) + len(held), count))
    rows[np.arange(len(i)), i] = weight
    rows[np.arange(len(i)), j] = -weight
    rows[len(i) + np.arange(len(held)), held] = weight.max()
    inverse = np.linalg.pinv(rows)[:, : len(i)] * weight
    return lambda given: inverse @ given
