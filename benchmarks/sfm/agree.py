"""Two programs' models of the same images against each other and against the truth.

Errors that both share are the truth's, or the images'; what differs is what either prediction of accuracy speaks of.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from benchmarks import datasets
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=sorted(datasets.LOADERS))
    parser.add_argument("first", type=Path, help="folder of a COLMAP model")
    parser.add_argument("second", type=Path, help="folder of another's")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        truth = datasets.load(args.set, Path(scratch)).cam_from_world
    found = compare(centres(args.first), centres(args.second), {k: transforms.centre(v) for k, v in truth.items()})
    sys.stdout.write(json.dumps({"set": args.set, **found}) + "\n")


def centres(folder: Path) -> dict[str, np.ndarray]:
    """Projection centres of a model by image name."""
    model = pycolmap.Reconstruction(str(folder))
    return {model.image(i).name: model.image(i).projection_center() for i in model.reg_image_ids()}


def compare(a: dict[str, np.ndarray], b: dict[str, np.ndarray], truth: dict[str, np.ndarray]) -> dict[str, float]:
    """RMS in millimetres of the truth: of each to the truth, of one to the other; correlation of the two errors."""
    names = sorted(set(a) & set(b) & set(truth))
    one, other, true = (np.array([x[k] for k in names]) for x in (a, b, truth))
    one, other = umeyama(one, true)(one), umeyama(other, true)(other)
    off, off_other = one - true, other - true
    between = umeyama(one, other, with_scale=True)(one) - other
    correlation = np.sum(off * off_other) / np.sqrt(np.sum(off**2) * np.sum(off_other**2))
    return {
        "images": len(names), "first_mm": _rms(off), "second_mm": _rms(off_other), "between_mm": _rms(between),
        "correlation": round(float(correlation), 2),
    }  # fmt: skip


def _rms(off: np.ndarray) -> float:
    return round(1000 * float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), 2)


if __name__ == "__main__":
    main()
