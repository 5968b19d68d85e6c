"""Errors over stated sigmas of every kind of unknown, over many small simulated blocks.

``python -m benchmarks.sfm.montecarlo --blocks 200 -o FILE``: a ring of four cameras along a winding canal
(``corridor.py``), key points with normal errors of half a pixel, lenses and mountings unknown, RTK positions of 2 cm
with white, slow and common errors. Each block is adjusted, its sigmas are asked for, and it is placed in the world, all
by the program's own functions. For each unknown: the mean of the squared errors over their variances (1 is right), the
bounds within which it lies by chance in 95 of 100 such campaigns, and the share within one sigma (68 % is right).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks.sfm.corridor import FOCAL, HEIGHT, WIDTH, Corridor, camera_of, corridor
from benchmarks.sfm.georef import receiver_rows, with_positions
from tiegraph.geometry.transforms import Similarity, umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.covariance import PositionSigma, position_sigma
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georeferencing import georeference_model

Errors = dict[str, list[float]]
LASTING = 0.7 * 0.02 * np.array([1, 1, 2])  # metres, of all positions


def block(length_m: float, seed: int) -> Errors:
    """Errors over sigmas (one an axis) of one block."""
    made = corridor(length_m, seed=seed)
    model = final_adjustment(made.model, tuning=Tuning().adjust).model
    sigma = position_sigma(model, nominal={}, tuning=Tuning())
    here = np.stack([_inverse(model, f)[:3, 3] for f in sigma.frame_ids])
    fit = umeyama(here, made.truth[:, :3, 3])
    return {
        **_shape(made, model, sigma, here, fit), **_cameras(model, sigma, fit), **_placed(made, model, sigma, seed),
    }  # fmt: skip


def _shape(
    made: Corridor, model: pycolmap.Reconstruction, sigma: PositionSigma, here: np.ndarray, fit: Similarity
) -> Errors:
    """Places and turns of the frames after the best similarity."""
    off = (fit(here) - made.truth[:, :3, 3]) @ fit.rotation / fit.scale
    turned = np.stack([_inverse(model, f)[:3, :3] for f in sigma.frame_ids])
    turn = fit.rotation @ turned @ np.swapaxes(made.truth[:, :3, :3], 1, 2)
    angle = Rotation.from_matrix(turn).as_rotvec() @ fit.rotation
    return {"place of a frame": _over(off, sigma.sigma), "turn of a frame": _over(angle, sigma.turn)}


def _cameras(model: pycolmap.Reconstruction, sigma: PositionSigma, fit: Similarity) -> Errors:
    """Lenses and mountings."""
    true = {"fx": FOCAL, "fy": FOCAL, "f": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    out: Errors = defaultdict(list)
    for _, name, value, own, *_ in sigma.interior:
        kind = "focal length" if name.startswith("f") else "principal point" if name in true else "distortion"
        out[kind].append((value - true.get(name, 0.0)) / own)
    for camera, mounting in sigma.mounting.items():
        centre = camera_of(camera - 1)
        off = np.array(mounting.centre) * fit.scale + centre[:3, :3].T @ centre[:3, 3]
        out["lever arm of a camera"].append(float(np.linalg.norm(off)) / (mounting.sigma * fit.scale))
    return out


def _placed(made: Corridor, model: pycolmap.Reconstruction, sigma: PositionSigma, seed: int) -> Errors:
    """The middle, the turn and the scale in the world, and the cameras there."""
    rng = np.random.default_rng(seed + 5000)
    rows = receiver_rows(made, 0.0, seed, white=0.7, slow=0.7, lasting=LASTING * rng.standard_normal(3))
    scene = with_positions(made.scene, rows)
    given = Measurements(rows, shape=Shape.of(model, sigma, scene))
    found, world = georeference_model(model, scene, GeorefSettings(antenna="ignored"), Tuning(), given)
    place, true = frame_poses(image_poses(world, scene), scene)[:, :3, 3], made.truth[:, :3, 3]
    known, error = found.uncertainty.shape, found.uncertainty.error
    if error is None or known is None:
        return {}
    off = umeyama(place, true)
    shift, spread = (place - true).mean(axis=0), error.covariance
    turn = Rotation.from_matrix(off.rotation).as_rotvec()
    sd = np.sqrt(np.diag(spread))
    own = np.sqrt(np.sum(known.modes**2, axis=0) + known.rest)
    return {
        "plan in the world": _over(shift[:2], sd[3:5]), "height in the world": _over(shift[2:], sd[5:6]),
        "heading": _over(turn[2:], sd[2:3]), "tilt": _over(turn[:2], sd[:2]),
        "scale": [float(np.log(off.scale)) / float(sd[6])],
        "a camera in the world": _over(place - true, np.hypot(error.sigma(place), own)),
    }  # fmt: skip


def _over(error: np.ndarray, sigma: np.ndarray) -> list[float]:
    return (np.asarray(error) / np.asarray(sigma)).ravel().tolist()


def _inverse(model: pycolmap.Reconstruction, frame: int) -> np.ndarray:
    pose = model.frame(frame).rig_from_world
    assert pose is not None
    return np.vstack([pose.inverse().matrix(), [0, 0, 0, 1]])


def summary(blocks: list[Errors]) -> dict[str, dict[str, float]]:
    """Of each unknown, over the blocks."""
    out = {}
    for name in dict.fromkeys(n for b in blocks for n in b):
        z = [np.array(b[name]) for b in blocks if name in b]
        every, means = np.concatenate(z), np.array([np.mean(v**2) for v in z])
        free = 2 * np.mean(means) ** 2 / max(np.var(means), 1e-12)  # of one block: its errors are not independent
        low, high = chi2.ppf([0.025, 0.975], free * len(z)) / (free * len(z))
        out[name] = {
            "mean_square": round(float(np.mean(means)), 2), "low": round(float(low), 2), "high": round(float(high), 2),
            "within": round(float(np.mean(np.abs(every) < 1)), 2), "blocks": len(z),
        }  # fmt: skip
    return out


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=200)
    parser.add_argument("--length", type=float, default=60.0, help="metres")
    parser.add_argument("-o", "--out", type=Path)
    asked = parser.parse_args()
    blocks: list[Errors] = []
    for seed in range(asked.blocks):
        blocks.append(block(asked.length, seed))
        if seed % 10 == 9 or seed == asked.blocks - 1:
            sys.stderr.write(f"{seed + 1} blocks\n")
    found = summary(blocks)
    for name, row in found.items():
        bounds = f"({row['low']:.2f} to {row['high']:.2f})"
        sys.stdout.write(f"{name:24} {row['mean_square']:6.2f} {bounds}  within a sigma {row['within']:.0%}\n")
    if asked.out:
        asked.out.write_text(json.dumps({"length_m": asked.length, "unknowns": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
