"""Predicted position sigmas of finished runs against the errors that their models really have.

Reads run folders (what ``benchmarks/run.py --keep`` leaves). The first model is adjusted once more by the present code;
its positions are compared with the truth after the best similarity, as the prediction is meant.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from benchmarks import datasets
from benchmarks.sfm.finished import each_run
from benchmarks.sfm.rig import rotations
from tiegraph.geometry.align import umeyama
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjust import final_adjustment, free_cameras
from tiegraph.sfm.covariance import position_sigma
from tiegraph.sfm.mapper import believed_cameras
from tiegraph.sfm.rig.given import drawings, given_geometry
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import SparseSettings

EXPLAINED = 0.999  # of the predicted variance lies in the modes whose errors are looked at one by one


def main() -> None:
    """Command line."""
    each_run(__doc__, measure)


def measure(name: str, folder: Path, scratch: Path) -> dict[str, Any]:
    """Predicted and actual errors of one run's first model, millimetres of the truth."""
    dataset = datasets.load(name, scratch)
    scene = Scene.from_json((folder / "network" / "scene.json").read_text()).measured()
    constant = believed_cameras(scene, SparseSettings())
    fixed = [k + 1 for k, mode in rig_modes(scene, "auto").items() if mode == "fixed"]
    mapped = pycolmap.Reconstruction(folder / "sparse" / "0")
    found = final_adjustment(mapped, fixed, constant, given_geometry(mapped, scene, ()))
    model = found.model
    start = time.process_time()
    rigs = set(model.rigs) - set(fixed)
    sigma = position_sigma(model, free_cameras(model) - set(constant), rigs, (), drawings(model, scene))
    cpu = time.process_time() - start
    truth = reference_centres(model, dataset)
    rows = np.array([k for k, f in enumerate(sigma.frame_ids) if f in truth])
    ids = [sigma.frame_ids[k] for k in rows]
    here = np.stack([_centre(model, f) for f in ids])
    true = np.stack([truth[f] for f in ids])
    fit = umeyama(here, true)
    off = (fit(here) - true) @ fit.rotation / fit.scale  # along the model's axes, in its units
    predicted = float(np.sqrt(np.mean(np.sum(sigma.sigma[rows] ** 2, axis=1))))
    actual = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert sigma.covariance is not None
    return {
        "set": name, "frames": len(ids), "points": model.num_points3D(),
        "predicted_mm": round(1000 * fit.scale * predicted, 3), "actual_mm": round(1000 * fit.scale * actual, 3),
        "ratio": round(predicted / actual, 3), "widened": round(sigma.widened, 2),
        **modes(sigma.covariance, rows, off),
        "rig_sigma_deg": {str(k): round(m.sigma_deg, 4) for k, m in sigma.mounting.items()},
        **rotations(model, scene, dataset), "note": found.note, "cpu_s": round(cpu, 1),
    }  # fmt: skip


def modes(covariance: np.ndarray, rows: np.ndarray, off: np.ndarray) -> dict[str, Any]:
    """Errors along the eigenvectors of the covariance, in their sigmas: root mean square, and of the first ones."""
    at = (3 * rows[:, None] + np.arange(3)).ravel()
    values, vectors = np.linalg.eigh(covariance[np.ix_(at, at)])
    values, vectors = values[::-1], vectors[:, ::-1]
    count = int(np.searchsorted(np.cumsum(values) / values.sum(), EXPLAINED)) + 1
    z = vectors[:, :count].T @ off.ravel() / np.sqrt(values[:count])
    return {
        "modes": count, "first_mode_share": round(float(values[0] / values.sum()), 2),
        "rms_z": round(float(np.sqrt(np.mean(z**2))), 2), "first_z": [round(float(v), 1) for v in z[:3]],
    }  # fmt: skip


def reference_centres(model: pycolmap.Reconstruction, dataset: datasets.Dataset) -> dict[int, np.ndarray]:
    """True places of the frames' reference cameras, by frame id."""
    out = {}
    centres = dataset.centres_m()
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        if image.is_ref_in_frame() and image.name in centres:
            out[image.frame_id] = centres[image.name]
    return out


def _centre(model: pycolmap.Reconstruction, frame_id: int) -> np.ndarray:
    pose = model.frame(frame_id).rig_from_world
    assert pose is not None
    return np.asarray(pose.tgt_origin_in_src(), float)


if __name__ == "__main__":
    main()
