"""How upright level photographs stand: ``python -m benchmarks.sfm.upright [RUN]`` (needs TIEGRAPH_DATA).

Strecha's facades and the boat of `canal_demo`, all its cameras and one, by their true poses, against the vertical of
the set: what ``geometry.gravity`` says, the mean of the tops, and one least-squares fit of tops and x axes. With the
folder of a run of oppaiyama: the plane of its four surveyed points, which lie at one height to 0.1 m over 2 m, by
their marks.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks import datasets
from tiegraph.geometry.gravity import UpTuning, up_vector

_WEIGHTS = (0.001, 0.01, 0.05)  # of the tops in one fit


def of_truth(name: str, work: Path, folder: str = "") -> str:
    """The angles (degrees) of each estimate to the vertical axis of a set, by the images below a folder."""
    truth = {k: v for k, v in datasets.load(name, work).cam_from_world.items() if folder in k}
    poses = np.array(list(truth.values()))
    frames = np.unique([re.sub(r"cam\d/", "", image) for image in truth], return_inverse=True)[1]
    found, turns = up_vector(poses, frames, UpTuning()), poses[:, :3, :3]
    said = "nothing" if found is None else f"{_to_vertical(found.direction):.2f} deg by {found.cameras}"
    fits = ", ".join(f"{_to_vertical(_one_fit(turns, w)):.2f} at weight {w:g}" for w in _WEIGHTS)
    tops = _to_vertical(turns[:, 1].mean(axis=0))
    return f"{name} {folder}: {said}; mean of the tops {tops:.2f} deg; one fit {fits}"


def _one_fit(turns: np.ndarray, weight: float) -> np.ndarray:
    """(3,) least squares: across the x axes, and with a weight along the tops of cameras (N, 3, 3)."""
    x, y = turns[:, 0], turns[:, 1]
    return np.linalg.eigh(x.T @ x + weight * (len(y) * np.eye(3) - y.T @ y))[1][:, 0]


def surveyed(run: Path, work: Path) -> str:
    """The tilt (degrees) of the plane of oppaiyama's surveyed points in a georeferenced model."""
    model = pycolmap.Reconstruction(run / "sparse" / "world")
    images = {i.name: i for i in model.images.values()}
    sums: dict[tuple[float, ...], tuple[np.ndarray, np.ndarray]] = {}
    for mark in datasets.load("oppaiyama", work).marks:
        image = images[mark.image]
        ray = model.cameras[image.camera_id].cam_from_img(np.array([mark.xy_px]))[0]
        along = image.cam_from_world().rotation.matrix().T @ np.append(ray, 1.0)
        across = np.eye(3) - np.outer(along, along) / (along @ along)
        matrix, right = sums.get(mark.surveyed_m, (np.zeros((3, 3)), np.zeros(3)))
        sums[mark.surveyed_m] = matrix + across, right + across @ image.projection_center()
    points = np.array([np.linalg.solve(*sums[k]) for k in sums])
    normal = np.linalg.svd(points - points.mean(axis=0))[2][2]
    return f"oppaiyama: the plane of {len(points)} surveyed points is tilted by {_to_vertical(normal):.2f} deg"


def _to_vertical(direction: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, abs(direction[2]) / np.linalg.norm(direction)))))


def main() -> None:
    """Print the lines."""
    with tempfile.TemporaryDirectory() as work:
        for name in ("fountain-P11", "Herz-Jesus-P8", "Herz-Jesus-P25", "canal_demo"):
            sys.stdout.write(f"{of_truth(name, Path(work))}\n")
        sys.stdout.write(f"{of_truth('canal_demo', Path(work), '/cam0/')}\n")
        if len(sys.argv) > 1:
            sys.stdout.write(f"{surveyed(Path(sys.argv[1]), Path(work))}\n")


if __name__ == "__main__":
    main()
