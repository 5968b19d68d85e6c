"""A closed way in blocks, joined, and held by positions with outages: ``python -m benchmarks.scale.hierarchy``.

The way is simulated (``loop``: two cameras, points seen over some six frames, 0.7 px, a focal length that is held and
wrong by 0.03 %). The house's own functions cut it into blocks (``scene.blocks``), adjust each by itself
(``sfm.adjustment``) and join the models (``scene.joining``). Then only the joints are adjusted, never an image: first
seven unknowns a block, by the poses of the images that two blocks share and by the positions; then seven a piece of 10
frames, so that a block may bend at its seams as much as two blocks differ where both have the same frames.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

import tiegraph  # noqa: F401  before pycolmap
import pycolmap  # isort: skip

from benchmarks.scale.loop import LEAST, Loop, camera, links, loop, sensor_from_rig
from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.scene.blocks import Block, blocks_of
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.joining import Join, JoinResult, Poses, join_models, moved
from tiegraph.scene.tuning import BlocksTuning, JoiningTuning
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.tuning import AdjustTuning

FOCAL_ERROR = 3e-4  # share, of the calibration that is held
START_M, START_DEG = 0.03, 0.05  # by which the start of a block's adjustment is off
TOGETHER = 25  # frames over which a block's own error is much the same
ROUNDS = 6
PIECE = 10  # frames that stay as they are to each other
SEAM_M = 0.01  # sigma of a place at the seam of two pieces of a block
FIRST_TURN, FIRST_STRETCH, SEAM_ROUNDS = 1e-3, 3e-3, 6  # sigmas of seams to begin with, and how often these are refined


def adjusted_block(world: Loop, block: Block, rng: np.random.Generator) -> Poses:
    """The model of a block by its own observations, in a frame and unit of its own."""
    model = _start(world, block, rng)
    made = final_adjustment(model, fixed_rigs=[1], constant_cameras=[1, 2], tuning=AdjustTuning()).model
    images = block.images
    poses = np.stack([made.image(int(k) + 1).cam_from_world().matrix() for k in images])
    poses = np.concatenate([poses, np.tile([[[0.0, 0, 0, 1]]], (len(poses), 1, 1))], axis=1)
    own = Similarity(float(np.exp(rng.normal(0, 0.3))), Rotation.random(rng=rng).as_matrix(), rng.normal(0, 50, 3))
    return Poses(images, moved(poses, own), 15.0 * own.scale)


def _start(world: Loop, block: Block, rng: np.random.Generator) -> pycolmap.Reconstruction:
    """True poses and points, a little off, and the observations that the block has."""
    model = pycolmap.Reconstruction()
    row = pycolmap.Rig(rig_id=1)
    places = sensor_from_rig()
    for s, place in enumerate(places):
        own = camera(FOCAL_ERROR)
        own.camera_id = s + 1
        model.add_camera(own)
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, s + 1)
        row.add_ref_sensor(sensor) if s == 0 else row.add_sensor(
            sensor, rigid3d(place @ transforms.invert(places[0]))
        )
    model.add_rig(row)
    tracks: dict[int, list[tuple[int, int]]] = {}
    ends = np.searchsorted(world.image, np.stack([block.images, block.images + 1]))
    rows = {int(k): slice(int(a), int(b)) for k, a, b in zip(block.images, *ends)}
    for first in block.images[::2]:
        frame = pycolmap.Frame(frame_id=int(first) // 2 + 1, rig_id=1)
        images = []
        for k in (int(first), int(first) + 1):
            image = pycolmap.Image(
                name=world.scene.names[k], camera_id=k % 2 + 1, image_id=k + 1, keypoints=world.xy[rows[k]]
            )
            image.frame_id = frame.frame_id
            frame.add_data_id(image.data_id)
            images.append(image)
            for n, point in enumerate(world.point[rows[k]].tolist()):
                tracks.setdefault(point, []).append((k + 1, n))
        off = Rotation.from_rotvec(np.radians(START_DEG) * rng.normal(size=3)).as_matrix()
        off = transforms.rigid(off, START_M * rng.normal(size=3))
        frame.rig_from_world = rigid3d(off @ world.cam_from_world[first])
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(frame.frame_id)
    for point, elements in tracks.items():
        if len(elements) >= LEAST:
            xyz = world.points[point] + rng.normal(0, START_M, 3)
            model.add_point3D(xyz, pycolmap.Track([pycolmap.TrackElement(*e) for e in elements]))
    return model


# ---------------------------------------------------------------- joints


@dataclass(frozen=True)
class Placed:
    """``world_from`` each block; covariance (7 M, 7 M) of shift, turn and scale about each block's ``middle`` (M, 3);
    ``inner_m``: what a position is off for its block's own bend."""

    world_from: tuple[Similarity, ...]
    covariance: np.ndarray
    middle: np.ndarray
    inner_m: float


def adjusted_joints(
    models: Sequence[Poses], joins: Sequence[Join], world_from: Sequence[Similarity], positions: np.ndarray, sigma_m: float
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
        frame, own = _frame_centres(model, centre)
        there = np.isfinite(positions[frame]).all(axis=1)
        rows.append(_sparse([(k, _block_columns(own[there], middle[k]))], len(models)))
        off.append((positions[frame[there]] - own[there]).ravel())
    return vstack(rows), np.concatenate(off)


def _frame_centres(model: Poses, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
            frame, centre = _frame_centres(model, centres[k][own])
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


# ---------------------------------------------------------------- the whole


def frame_places(
    world: Loop, blocks: Sequence[Block], models: Sequence[Poses], world_from: Sequence[Similarity]
) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3) places of the frames, each by the block whose own it is, and which (F,) that is."""
    out, whose = np.full((world.scene.frames, 3), np.nan), np.full(world.scene.frames, -1)
    for k, (block, model, s) in enumerate(zip(blocks, models, world_from)):
        frame, centre = _frame_centres(model, s(transforms.centre(model.cam_from_world)))
        own = block.own[::2]
        out[frame[own]], whose[frame[own]] = centre[own], k
    return out, whose


def sigma_of(placed: Placed, places: np.ndarray, whose: np.ndarray) -> np.ndarray:
    """(F,) predicted position sigma of each frame (length of the vector): placement and bend of its block."""
    out = np.empty(len(places))
    for k in np.unique(whose):
        own = whose == k
        rows = _block_columns(places[own], placed.middle[k])
        part = placed.covariance[7 * k : 7 * k + 7, 7 * k : 7 * k + 7]
        out[own] = np.einsum("kai,ij,kaj->k", rows, part, rows)
    return np.sqrt(out + 3 * placed.inner_m**2)


def _error(
    places: np.ndarray, truth: np.ndarray, outage: np.ndarray, sigma: np.ndarray | None = None
) -> dict[str, float]:
    """RMS error of the frames with positions and of those in outages, and the largest, metres; likewise what was
    predicted, and the RMS of error over sigma (both are lengths of vectors: 1 is right)."""
    off = np.linalg.norm(places - truth, axis=1)
    out = {"rms_m": _rms(off[~outage]), "outage_rms_m": _rms(off[outage]), "most_m": float(off.max())}
    if sigma is not None:
        out |= {"sigma_m": _rms(sigma[~outage]), "outage_sigma_m": _rms(sigma[outage])}
        out |= {"over_sigma": _rms((off / sigma)[~outage]), "outage_over_sigma": _rms((off / sigma)[outage])}
    return out


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def measured(frames: int, seed: int) -> dict[str, Any]:
    """One closed way: costs and errors of each step."""
    clock = Clock()
    world = loop(frames, seed)
    ties = links(world)
    clock.done("simulated")
    blocks = blocks_of(world.scene, ties, BlocksTuning())
    clock.done("blocks")
    rng = np.random.default_rng(seed)
    models = [adjusted_block(world, block, rng) for block in blocks]
    clock.done("adjusted")
    joined: JoinResult = join_models(models, JoiningTuning())
    clock.done("joined")
    truth, positions = world.frames(), np.array(world.scene.world_from_rig[:, :3, 3])
    outage = ~np.isfinite(positions).all(axis=1)
    chain, _ = frame_places(world, blocks, models, joined.world_from)
    whole = umeyama(chain[~outage], positions[~outage])
    start = [_after(whole, s) for s in joined.world_from]
    good = [j for j in joined.joins if j.holds]
    sigma_m = float(np.nanmin(world.scene.position_sigma_m))
    placed = adjusted_joints(models, good, start, positions, sigma_m)
    places, whose = frame_places(world, blocks, models, placed.world_from)
    clock.done("blocks placed")
    cut = pieces_of(blocks, models, placed.world_from)
    fine = bent(cut, positions, sigma_m)
    clock.done("pieces placed")
    inside = [_inside(m, truth) for m in models]
    return {
        "frames": frames, "images": len(world.scene), "blocks": len(blocks), "largest": max(map(len, blocks)),
        "joins": len(joined.joins), "held": len(good), "parts": int(joined.part.max()) + 1, "pieces": len(cut.models),
        "seams": {"turn_rad": fine.turn, "log_scale": fine.stretch},
        "inside_m": {"median": float(np.median(inside)), "most": float(np.max(inside))},
        "joined": _error(whole(chain), truth, outage),
        "blocks placed": _error(places, truth, outage, sigma_of(placed, places, whose)),
        "pieces placed": _error(fine.places, truth, outage, fine.sigma),
        "cpu_s": clock.spent, "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }  # fmt: skip


def _inside(model: Poses, truth: np.ndarray) -> float:
    """RMS error of a block by itself, after the best similarity, metres."""
    frame, centre = _frame_centres(model, transforms.centre(model.cam_from_world))
    off = umeyama(centre, truth[frame])(centre) - truth[frame]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _after(c_from_b: Similarity, b_from_a: Similarity) -> Similarity:
    """c_from_a."""
    shift = c_from_b(b_from_a.translation[None])[0]
    return Similarity(c_from_b.scale * b_from_a.scale, c_from_b.rotation @ b_from_a.rotation, shift)


class Clock:
    """CPU seconds of one step after the other."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._last = time.process_time()

    def done(self, name: str) -> None:
        """What was spent since the last call goes under a name."""
        now = time.process_time()
        self.spent[name], self._last = now - self._last, now


def main(argv: list[str] | None = None) -> int:
    """Prints the figures of each seed; writes them all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("-o", "--output", type=Path, help="JSON file")
    given = parser.parse_args(argv)
    rows = []
    for seed in given.seeds:
        rows.append({"seed": seed, **measured(given.frames, seed)})
        sys.stdout.write(json.dumps(rows[-1]) + "\n")
        if given.output is not None:
            from benchmarks import run

            head = {"format": 1, "machine": run._machine(), "software": run._software()}
            given.output.write_text(json.dumps(run._rounded({**head, "runs": rows}), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
