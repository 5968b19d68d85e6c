"""A closed way in blocks, joined, and held by positions with outages: ``python -m benchmarks.scale.hierarchy``.

The way is simulated (``loop``: two cameras, points seen over some six frames, 0.7 px, a focal length that is held and
wrong by 0.03 %). The house's own functions cut it into blocks (``scene.blocks``), adjust each by itself
(``sfm.adjustment``) and join the models (``scene.blocks``). Then only the joints are adjusted, never an image: first
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
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks.scale.joints import adjusted_joints, bent, frame_centres, pieces_of, sigma_of
from benchmarks.scale.loop import LEAST, Loop, camera, links, loop, sensor_from_rig
from benchmarks.scale.results import save
from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.scene.blocks import Block, JoinResult, Poses, blocks_of, join_models, moved
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.tuning import BlocksTuning, JoiningTuning
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.tuning import AdjustTuning

FOCAL_ERROR = 3e-4  # share, of the calibration that is held
START_M, START_DEG = 0.03, 0.05  # by which the start of a block's adjustment is off


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
        row.add_ref_sensor(sensor) if s == 0 else row.add_sensor(sensor, rigid3d(place @ transforms.invert(places[0])))
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


# ---------------------------------------------------------------- the whole


def frame_places(
    world: Loop, blocks: Sequence[Block], models: Sequence[Poses], world_from: Sequence[Similarity]
) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3) places of the frames, each by the block whose own it is, and which (F,) that is."""
    out, whose = np.full((world.scene.frames, 3), np.nan), np.full(world.scene.frames, -1)
    for k, (block, model, s) in enumerate(zip(blocks, models, world_from)):
        frame, centre = frame_centres(model, s(transforms.centre(model.cam_from_world)))
        own = block.own[::2]
        out[frame[own]], whose[frame[own]] = centre[own], k
    return out, whose


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
    blocks = blocks_of(world.scene, ties.i, ties.j, ties.counts(), BlocksTuning())
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
    frame, centre = frame_centres(model, transforms.centre(model.cam_from_world))
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
    parser.add_argument("--note", default="")
    parser.add_argument("-o", "--output", type=Path, help="JSON file")
    given = parser.parse_args(argv)
    rows = []
    for seed in given.seeds:
        rows.append({"seed": seed, **measured(given.frames, seed)})
        sys.stdout.write(json.dumps(rows[-1]) + "\n")
        if given.output is not None:
            save(given.output, rows, given.note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
