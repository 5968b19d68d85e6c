"""Predicted sigmas of finished runs against the errors that their models really have: positions, scale, attitude.

``python -m benchmarks.sigma SET=FOLDER ... [--second SET=MODEL ...] -o FILE`` reads run folders (``benchmarks/run.py
--keep`` leaves them) and changes nothing there. ``SET`` is one of
``datasets`` (``canal@PATH``: a canal of any seed); ``--run SET=FOLDER`` makes the run first, until the stage sparse.
Errors are those after the best similarity of the positions, as the prediction is meant. Where another solver made a
model of the same images (``--second``), the three differences tell the truth's own error (three-cornered hat: the two
solvers see the same images, so it is what they do not share).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from benchmarks import datasets
from benchmarks.sfm.agree import centres, compare
from benchmarks.sfm.finished import arguments, each_run
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity, umeyama
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import free_cameras
from tiegraph.sfm.adjustment.constraints import nominal_geometry
from tiegraph.sfm.covariance import PositionSigma, position_sigma
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning

_FEW = 20  # points below which nothing is said of them
EXPLAINED = 0.999  # of the predicted variance lies in the modes whose errors are looked at one by one

_HAT = "tiegraph's, openMVG's model and the truth against each other (benchmarks/sfm/README.md)"
# Root mean square error of the truth itself, metres, and who says so: None = not known.
TRUTH_M: Mapping[str, tuple[float | None, str]] = {
    "canal": (0.0, "rendered"),
    "canal_demo": (0.0, "rendered"),
    "fountain-P11": (0.0029, _HAT),
    "Herz-Jesus-P25": (0.0059, _HAT),
    "Herz-Jesus-P8": (0.0040, _HAT),
    "kitti_stereo": (0.0149, _HAT + "; GNSS/INS"),
    "pandaset": (None, "GNSS/INS"),
    "dino_part": (None, "calibration of a gantry"),
    "ring": (None, "calibration by the set's authors"),
    "rgbd_part": (0.017, "KinectFusion, a centimetre an axis by the set's notes"),
}


def main(argv: list[str] | None = None) -> int:
    """Command line; 0 if every run could be judged."""
    parser = arguments(__doc__)
    parser.add_argument("--second", nargs="+", default=[], metavar="SET=MODEL", help="another solver's COLMAP model")
    args = parser.parse_args(argv)
    second = {name: Path(folder) for name, folder in (item.split("=", 1) for item in args.second)}
    rows = each_run(args, lambda name, folder, work: measure(name, datasets.load(name, work), folder, second.get(name)))
    sys.stdout.write(table(rows) + "\n")
    return 0


def measure(name: str, dataset: datasets.Dataset, folder: Path, second: Path | None = None) -> dict[str, Any]:
    """Predicted and actual errors of one run's first model, in metres and degrees of the truth."""
    scene = Scene.from_json((folder / "network" / "scene.json").read_text()).measured()
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    if model.num_reg_frames() > scene.frames:  # of cameras that fire apart
        return _as_stated(name, dataset, folder, model, second)
    start = time.process_time()
    sigma = predicted(model, scene)
    cpu = time.process_time() - start
    truth = reference_poses(model, dataset)
    rows = np.array([k for k, f in enumerate(sigma.frame_ids) if f in truth])
    ids = [sigma.frame_ids[k] for k in rows]
    here = np.stack([_pose(model, f) for f in ids])
    true = np.stack([truth[f] for f in ids])
    places = [np.stack([datasets.pose_centre(p) for p in poses]) for poses in (here, true)]
    fit = umeyama(*places)
    off = (fit(places[0]) - places[1]) @ fit.rotation / fit.scale  # along the model's axes, in its units
    out = {
        "set": name, "frames": len(ids), "points": model.num_points3D(), "pixel_sigma": round(sigma.pixel_sigma, 3),
        "position_m": _pair(fit.scale * _rms(sigma.sigma[rows]), fit.scale * _rms(off)),
        "cpu_s": round(cpu, 1),
    }  # fmt: skip
    if sigma.covariance is not None:
        out |= modes(sigma.covariance, rows, off)
    if getattr(sigma, "scale", None) is not None:
        out["scale"] = _pair(sigma.scale, abs(float(np.log(fit.scale))))
    if getattr(sigma, "turn", None) is not None and np.isfinite(true).all():
        turned = fit.rotation @ np.swapaxes(here[:, :3, :3], 1, 2) @ true[:, :3, :3]
        angle = transforms.angle_deg(turned, np.broadcast_to(np.eye(3), turned.shape))
        out["attitude_deg"] = _pair(float(np.degrees(_rms(sigma.turn[rows]))), float(np.sqrt(np.mean(angle**2))))
        out["lens_px"] = {str(f.camera): [round(f.rms_px, 3), round(f.reach_px)] for f in sigma.lenses}
    out |= _points(name, model, sigma, dataset, fit)
    return {**out, **_with_truth(name, folder, dataset, second, out["position_m"])}


def _as_stated(
    name: str, dataset: datasets.Dataset, folder: Path, model: pycolmap.Reconstruction, second: Path | None
) -> dict[str, Any]:
    """The row of a model whose cameras fire apart: it was adjusted with key points at one instant, so the receipt says
    what the stage stated of positions (medians) and of the scale."""
    counts = json.loads((folder / "receipts" / "sparse.json").read_text())["counts"]
    truth = reference_poses(model, dataset)
    here = np.stack([transforms.centre(_pose(model, f)) for f in truth])
    there = np.stack([datasets.pose_centre(p) for p in truth.values()])
    fit = umeyama(here, there)
    off = float(np.median(np.linalg.norm(fit(here) - there, axis=1)))
    out: dict[str, Any] = {"set": name, "frames": len(truth), "points": model.num_points3D()}
    out["position_m"] = _pair(fit.scale * counts["position_sigma_median"], off)
    if "scale_sigma" in counts:
        out["scale"] = _pair(counts["scale_sigma"], abs(float(np.log(fit.scale))))
    return {**out, **_with_truth(name, folder, dataset, second, out["position_m"])}


def _points(
    name: str, model: pycolmap.Reconstruction, sigma: PositionSigma, dataset: datasets.Dataset, fit: Similarity
) -> dict[str, Any]:
    """Predicted and actual errors of sparse points, where depth maps of true images tell where their surface is.

    The true place of a point is where the true ray of its key point meets the surface. The worst twentieth, on edges
    where depth jumps, is left out of both.
    """
    folder = dataset.images.parent / "gt" / "depth"
    if not folder.is_dir():
        return {}
    error, own = [], []
    for point_id, axes in sigma.points.items():
        point = model.point3D(point_id)
        found = [_true_place(model, e, dataset, folder) for e in point.track.elements]
        seen = [place for place in found if place is not None]
        if seen:
            error.append(float(np.linalg.norm(fit(point.xyz[None])[0] - np.mean(seen, axis=0))))
            own.append(fit.scale * float(np.linalg.norm(axes)))
    if len(error) < _FEW:
        return {}
    keep = np.argsort(error)[: int(0.95 * len(error))]
    return {"point_m": _pair(_rms(np.array(own)[keep, None]), _rms(np.array(error)[keep, None])), "judged": len(error)}


def _true_place(
    model: pycolmap.Reconstruction, element: Any, dataset: datasets.Dataset, folder: Path
) -> np.ndarray | None:
    """Where the true ray of a key point meets the true surface (3,), None without a depth map of its image."""
    image = model.image(element.image_id)
    path = (folder / image.name).with_suffix(".png")
    if image.name not in dataset.cam_from_world or not path.exists():
        return None
    depth = _depth(path)
    at = np.asarray(image.points2D[element.point2D_idx].xy)
    column, row = (int(v) for v in at)
    z = float(depth[row, column])
    ray = model.camera(image.camera_id).cam_from_img(at)
    if not z or ray is None:
        return None
    inverse = np.linalg.inv(dataset.cam_from_world[image.name])
    return (inverse @ np.array([ray[0] * z, ray[1] * z, z, 1.0]))[:3]


@cache
def _depth(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 256.0


def predicted(model: pycolmap.Reconstruction, scene: Scene) -> PositionSigma:
    """What the stage would say of a model."""
    constant = believed_cameras(scene, SparseSettings())
    fixed = {k + 1 for k, mode in rig_modes(scene, "auto").items() if mode == "fixed"}
    free = free_cameras(model, Tuning().adjust) - set(constant)
    return position_sigma(model, free, set(model.rigs) - fixed, (), nominal_geometry(model, scene), tuning=Tuning())


def _with_truth(
    name: str, folder: Path, dataset: datasets.Dataset, second: Path | None, pair: dict[str, float]
) -> dict[str, Any]:
    """What is known of the truth's own error (root mean square in space), and the ratio when it is counted in."""
    known, source = TRUTH_M.get(name.partition("@")[0], (None, "unknown"))
    own = known
    out: dict[str, Any] = {"truth": source}
    if second is not None:
        found = compare(centres(folder / "sparse" / "0"), centres(second), dataset.centres_m())
        squares = found["first_mm"] ** 2 + found["second_mm"] ** 2 - found["between_mm"] ** 2
        own = 0.001 * float(np.sqrt(max(squares, 0.0) / 2))
        out["truth"] += "; its error by two solvers"
        out |= {"second_m": found["second_mm"] / 1000, "between_m": found["between_mm"] / 1000}
    if own is not None:
        out["truth_m"] = float(f"{own:.3g}")
        out["ratio_with_truth"] = round(float(np.hypot(pair["predicted"], own)) / pair["actual"], 3)
    return out


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


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as a table of text: predicted over actual."""
    lines = [
        "set | frames | positions predicted / actual mm | ratio | truth mm | ratio with it | scale | attitude | points"
    ]
    for row in rows:
        pair = row["position_m"]
        lines.append(" | ".join([
            row["set"], str(row["frames"]), f"{1000 * pair['predicted']:.2f} / {1000 * pair['actual']:.2f}",
            f"{pair['ratio']:.2f}", f"{1000 * row['truth_m']:.2f}" if "truth_m" in row else "?",
            str(row.get("ratio_with_truth", "?")),
            *(f"{row[k]['ratio']:.2f}" if k in row else "-" for k in ("scale", "attitude_deg", "point_m")),
        ]))  # fmt: skip
    return "\n".join(lines)


def reference_poses(model: pycolmap.Reconstruction, dataset: datasets.Dataset) -> dict[int, np.ndarray]:
    """True poses (4, 4) of the frames' reference cameras, by frame id."""
    out = {}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        if image.is_ref_in_frame() and image.name in dataset.cam_from_world:
            out[image.frame_id] = np.asarray(dataset.cam_from_world[image.name])
    return out


def _pose(model: pycolmap.Reconstruction, frame_id: int) -> np.ndarray:
    pose = model.frame(frame_id).rig_from_world
    assert pose is not None
    return np.vstack([pose.matrix(), [0, 0, 0, 1]])


def _pair(predicted: float, actual: float) -> dict[str, float]:
    ratio = predicted / max(actual, 1e-12)
    return {"predicted": float(f"{predicted:.4g}"), "actual": float(f"{actual:.4g}"), "ratio": round(ratio, 3)}


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


if __name__ == "__main__":
    sys.exit(main())
