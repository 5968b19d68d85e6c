"""How upright level photographs stand: ``python -m benchmarks.sfm.upright [RUN]`` (needs TIEGRAPH_DATA).

Strecha's facades by their true poses, against the vertical of the set: the direction across the x axes of the cameras
(``sfm.world.gravity``) and the mean of their tops. With the folder of a run of oppaiyama: the plane of its four
surveyed points, which lie at one height to 0.1 m over 2 m, by their marks.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks import datasets
from tiegraph.sfm.tuning.world import UpTuning
from tiegraph.sfm.world.gravity import across_horizon


def facade(name: str, work: Path) -> str:
    """The angles (degrees) of both directions to the vertical axis of a set."""
    turns = np.array(list(datasets.load(name, work).cam_from_world.values()))[:, :3, :3]
    found, tops = across_horizon(turns, UpTuning()), -turns[:, 1].mean(axis=0)
    off = [_to_vertical(d) for d in (found.direction, tops)] if found is not None else [np.nan, _to_vertical(tops)]
    sigma = np.nan if found is None else found.sigma_deg
    return f"{name}: across the x axes {off[0]:.2f} deg (sigma {sigma:.1f}), mean of the tops {off[1]:.2f} deg"


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
        for name in ("fountain-P11", "Herz-Jesus-P8"):
            sys.stdout.write(f"{facade(name, Path(work))}\n")
        if len(sys.argv) > 1:
            sys.stdout.write(f"{surveyed(Path(sys.argv[1]), Path(work))}\n")


if __name__ == "__main__":
    main()
