"""Joints and seams of blocks adjusted, no image touched: seven unknowns a block, then seven a piece of ten frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.scene.blocks import Block, Join, Poses, moved

TOGETHER = 25  # frames over which a block's own error is much the same
ROUNDS = 6
PIECE = 10  # frames that stay as they are to each other
SEAM_M = 0.01  # sigma of a place at the seam of two pieces of a block
FIRST_TURN, FIRST_STRETCH, SEAM_ROUNDS = 1e-3, 3e-3, 6  # sigmas of seams to begin with, and how often these are refined


@dataclass(frozen=True)
class Placed:
    """``world_from`` each block; covariance (7 M, 7 M) of shift, turn and scale about each block's ``middle`` (M, 3);
    ``inner_m``: what a position is off for its block's own bend."""

    world_from: tuple[Similarity, ...]
    covariance: np.ndarray
    middle: np.ndarray
    inner_m: float


def adjusted_joints(
    models: Sequence[Poses],
    joins: Sequence[Join],
    world_from: Sequence[Similarity],
    positions: np.ndarray,
    sigma_m: float,
) -> Placed:
    """Blocks placed by what they share and by positions (F, 3) of the frames (NaN = none): least squares over shift,
    turn and log scale of each, weighted by what the residuals say."""
    held = tuple(world_from)
    inner, apart_m, apart = 0.1, 0.1, 1e-3
    for _ in range(ROUNDS):
        poses = [moved(m.cam_from_world, s) for m, s in zip(models, held)]
        centres = [transforms.centre(p) for p in poses]
        middle = np.stack([c.mean(axis=0) for c in centres])
        fixes, fix_off = _position_rows(models, centres, middle, positions)
        ties, tie_off, turns, turn_off = _joint_rows(models, joins, poses, centres, middle)
        share = np.sqrt(TOGETHER)
        fix_sigma = np.hypot(sigma_m, share * inner)
        many = np.sqrt(np.mean([len(j.images) for j in joins]) / 4)  # two frames of two cameras tell as much
        parts = [(fixes, fix_off, fix_sigma), (ties, tie_off, many * apart_m), (turns, turn_off, many * apart)]
        rows = vstack([csr_array(a) / s for a, _, s in parts]).tocsr()
        off = np.concatenate([b / s for _, b, s in parts])
        normal = (rows.T @ rows).tocsc()
        solve = splu(normal)
        step = solve.solve(rows.T @ off)
        held = tuple(_stepped(s, step[7 * k : 7 * k + 7], middle[k]) for k, s in enumerate(held))
        left = [b - a @ step for a, b, _ in parts]
        inner = float(np.sqrt(max(np.mean(left[0] ** 2) - sigma_m**2, 1e-6)))
        apart_m, apart = (float(np.sqrt(np.mean(x**2))) for x in left[1:])
    return Placed(held, solve.solve(np.eye(7 * len(models))), middle, inner)


def _block_columns(centre: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """(K, 3, 7) derivative of centres (K, 3) by shift, turn and log scale of their block about its middle."""
    d = centre - middle
    out = np.zeros((len(d), 3, 7))
    out[:, [0, 1, 2], [0, 1, 2]] = 1
    out[:, 0, 4], out[:, 0, 5] = d[:, 2], -d[:, 1]
    out[:, 1, 3], out[:, 1, 5] = -d[:, 2], d[:, 0]
    out[:, 2, 3], out[:, 2, 4] = d[:, 1], -d[:, 0]
    out[:, :, 6] = d
    return out


def _sparse(blocks: Sequence[tuple[int, np.ndarray]], count: int) -> csr_array:
    """(R, 7 count) of rows (K, 3, 7) of one block, or of two whose rows add up."""
    rows = np.arange(blocks[0][1].shape[0] * 3).repeat(7)
    columns = [np.tile(7 * k + np.arange(7), len(rows) // 7) for k, _ in blocks]
    data = [values.reshape(-1) for _, values in blocks]
    where = np.tile(rows, len(blocks)), np.concatenate(columns)
    return csr_array((np.concatenate(data), where), shape=(len(rows) // 7, 7 * count))


def _position_rows(
    models: Sequence[Poses], centres: Sequence[np.ndarray], middle: np.ndarray, positions: np.ndarray
) -> tuple[csr_array, np.ndarray]:
    """Rows of the frames' positions in every block that has the frame, and what is missing."""
    rows, off = [], []
    for k, (model, centre) in enumerate(zip(models, centres)):
        frame, own = frame_centres(model, centre)
        there = np.isfinite(positions[frame]).all(axis=1)
        rows.append(_sparse([(k, _block_columns(own[there], middle[k]))], len(models)))
        off.append((positions[frame[there]] - own[there]).ravel())
    return vstack(rows), np.concatenate(off)


def frame_centres(model: Poses, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames (K,) of a block and the middle (K, 3) of their two cameras."""
    return model.images[::2] // 2, centre.reshape(-1, 2, 3).mean(axis=1)


def _joint_rows(
    models: Sequence[Poses],
    joins: Sequence[Join | Shared],
    poses: Sequence[np.ndarray],
    centres: Sequence[np.ndarray],
    middle: np.ndarray,
) -> tuple[csr_array, np.ndarray, csr_array, np.ndarray]:
    """Rows of centres and turns of shared images, and what is missing of each."""
    ties, tie_off, turns, turn_off = [], [], [], []
    for join in joins:
        a, b = join.a, join.b
        at = [np.searchsorted(models[k].images, join.images) for k in (a, b)]
        x, y = centres[a][at[0]], centres[b][at[1]]
        ties.append(_sparse([(a, _block_columns(x, middle[a])), (b, -_block_columns(y, middle[b]))], len(models)))
        tie_off.append((y - x).ravel())
        turn = np.swapaxes(poses[b][at[1]][:, :3, :3], 1, 2) @ poses[a][at[0]][:, :3, :3]
        only = np.zeros((len(x), 3, 7))
        only[:, [0, 1, 2], [3, 4, 5]] = 1
        turns.append(_sparse([(a, only), (b, -only)], len(models)))
        turn_off.append(Rotation.from_matrix(turn).as_rotvec().ravel())
    return vstack(ties), np.concatenate(tie_off), vstack(turns), np.concatenate(turn_off)


def _stepped(s: Similarity, step: np.ndarray, middle: np.ndarray) -> Similarity:
    """A placement moved by shift, turn and log scale about a middle."""
    turn, scale = Rotation.from_rotvec(step[3:6]).as_matrix(), float(np.exp(step[6]))
    shift = middle + step[:3] + scale * turn @ (s.translation - middle)
    return Similarity(scale * s.scale, turn @ s.rotation, shift)


def sigma_of(placed: Placed, places: np.ndarray, whose: np.ndarray) -> np.ndarray:
    """(F,) predicted position sigma of each frame (length of the vector): placement and bend of its block."""
    out = np.empty(len(places))
    for k in np.unique(whose):
        own = whose == k
        rows = _block_columns(places[own], placed.middle[k])
        part = placed.covariance[7 * k : 7 * k + 7, 7 * k : 7 * k + 7]
        out[own] = np.einsum("kai,ij,kaj->k", rows, part, rows)
    return np.sqrt(out + 3 * placed.inner_m**2)


# ---------------------------------------------------------------- pieces of blocks


@dataclass(frozen=True)
class Shared:
    """Images (K,) that two models a, b have."""

    a: int
    b: int
    images: np.ndarray


@dataclass(frozen=True)
class Pieces:
    """Blocks cut into ``models`` whose poses are in the world; ``block`` and ``place`` on the way (M,) of each, and
    which frames are its own: ``own`` M x (K,)."""

    models: list[Poses]
    block: np.ndarray
    place: np.ndarray
    own: list[np.ndarray]

    def follow(self) -> list[tuple[int, int]]:
        """Pieces of one block that follow each other on the way."""
        at = {(b, p): k for k, (b, p) in enumerate(zip(self.block, self.place))}
        count = int(self.place.max()) + 1
        return [(k, at[b, (p + 1) % count]) for (b, p), k in at.items() if (b, (p + 1) % count) in at]

    def shared(self) -> list[Shared]:
        """Pieces of two blocks that have the same frames."""
        out = []
        for place in np.unique(self.place):
            here = np.flatnonzero(self.place == place)
            for n, a in enumerate(here):
                for b in here[n + 1 :]:
                    images = np.intersect1d(self.models[a].images, self.models[b].images)
                    if len(images):
                        out.append(Shared(int(a), int(b), images))
        return out


def pieces_of(blocks: Sequence[Block], models: Sequence[Poses], world_from: Sequence[Similarity]) -> Pieces:
    """Every block cut where the frame numbers are multiples of ``PIECE``."""
    made, block_of, places, own = [], [], [], []
    for k, (block, model, s) in enumerate(zip(blocks, models, world_from)):
        place = model.images // 2 // PIECE
        poses = moved(model.cam_from_world, s)
        for n in np.unique(place):
            of = place == n
            made.append(Poses(model.images[of], poses[of], model.range_))
            own.append(block.own[of][::2])
            block_of.append(k)
            places.append(int(n))
    return Pieces(made, np.array(block_of), np.array(places), own)


@dataclass(frozen=True)
class Bent:
    """``places`` (F, 3) of the frames, their ``sigma`` (F,), and what pieces turn (radians) and stretch by (log scale)
    from one to the next: sigmas."""

    places: np.ndarray
    sigma: np.ndarray
    turn: float
    stretch: float


def bent(cut: Pieces, positions: np.ndarray, sigma_m: float) -> Bent:
    """All pieces adjusted: least squares over shift, turn and log scale of each, by what follows in a block, what two
    blocks share and by positions (F, 3), NaN = none. Linear: the pieces are where ``adjusted_joints`` put their blocks.

    By how much a block turns and stretches at a seam is estimated from the seams themselves, their posterior variance
    added (expectation maximisation). What two blocks differ in where they overlap says too little: they have the same
    observations there.
    """
    models = cut.models
    poses = [m.cam_from_world for m in models]
    centres = [transforms.centre(p) for p in poses]
    middle = np.stack([c.mean(axis=0) for c in centres])
    owned = [np.repeat(own, 2) for own in cut.own]
    of_own = [Poses(m.images[o], m.cam_from_world[o], m.range_) for m, o in zip(models, owned)]
    fixes, fix_off = _position_rows(of_own, [c[o] for c, o in zip(centres, owned)], middle, positions)
    ties, tie_off, turns, turn_off = _joint_rows(models, cut.shared(), poses, centres, middle)
    seams, straight, even = _seam_rows(cut, centres, middle)
    right = np.concatenate([fix_off / sigma_m, tie_off / (np.sqrt(PIECE) * SEAM_M)])
    turn, stretch = FIRST_TURN, FIRST_STRETCH
    for _ in range(SEAM_ROUNDS):
        parts = [(fixes, sigma_m), (ties, np.sqrt(PIECE) * SEAM_M), (turns, turn), (seams, SEAM_M), (straight, turn)]
        rows = vstack([csr_array(a) / s for a, s in [*parts, (even, stretch)]]).tocsr()
        wanted = np.zeros(rows.shape[0])
        wanted[: len(right) + len(turn_off)] = np.concatenate([right, turn_off / turn])
        solve = splu((rows.T @ rows).tocsc())
        step, covariance = solve.solve(rows.T @ wanted), solve.solve(np.eye(rows.shape[1]))
        turn, stretch = (_spread(a, step, covariance) for a in (straight, even))
    places, sigma = np.full(positions.shape, np.nan), np.full(len(positions), np.nan)
    for k, (model, own) in enumerate(zip(of_own, owned)):
        if len(model.images):
            part = slice(7 * k, 7 * k + 7)
            frame, centre = frame_centres(model, centres[k][own])
            columns = _block_columns(centre, middle[k])
            places[frame] = centre + columns @ step[part]
            sigma[frame] = np.sqrt(np.einsum("kai,ij,kaj->k", columns, covariance[part, part], columns))
    return Bent(places, sigma, turn, stretch)


def _spread(rows: csr_array, step: np.ndarray, covariance: np.ndarray) -> float:
    """Sigma of what rows say of unknowns, their posterior variance included."""
    variance = np.asarray((rows @ covariance) * rows.toarray()).sum(axis=1)
    return float(np.sqrt(np.mean((rows @ step) ** 2 + variance)))


def _seam_rows(
    cut: Pieces, centres: Sequence[np.ndarray], middle: np.ndarray
) -> tuple[csr_array, csr_array, csr_array]:
    """Rows that hold the pieces of a block together at their seams: place, turn and log scale."""
    count = len(cut.models)
    place, turn, scale = [], [], []
    for a, b in cut.follow():
        seam = np.concatenate([centres[a][-2:], centres[b][:2]]).mean(axis=0, keepdims=True)
        place.append(_sparse([(a, _block_columns(seam, middle[a])), (b, -_block_columns(seam, middle[b]))], count))
        only = np.zeros((1, 3, 7))
        only[0, [0, 1, 2], [3, 4, 5]] = 1
        turn.append(_sparse([(a, only), (b, -only)], count))
        scale.append(csr_array(([1.0, -1.0], ([0, 0], [7 * a + 6, 7 * b + 6])), shape=(1, 7 * count)))
    return vstack(place), vstack(turn), vstack(scale)
