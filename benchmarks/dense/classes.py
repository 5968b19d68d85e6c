"""What the depth maps of a finished run show, by the true class of their pixels: sky, water, boat, what moves, and what
stands. The masks of the truth are images of class numbers named as the images.

python -m benchmarks.dense.classes tiegraph_demo examples/canal/truth/masks
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

from tiegraph.pipeline.dense import depth_path
from tiegraph.pipeline.files import load_map, load_model, read_image

CLASSES = ("sky", "water", "the boat itself", "moving", "static")
_BESIDE_PX = 3  # of something static: a window of the matcher covers both


def counted(out: Path, truth: Path) -> np.ndarray:
    """(5, 3) of each class: pixels of the images, of these with a depth, of these beside something static."""
    total = np.zeros((len(CLASSES), 3), int)
    for image in load_model(out / "sparse" / "world").images.values():
        path, mask_path = depth_path(out, image.name), truth / Path(image.name).with_suffix(".png")
        if not path.exists() or not mask_path.exists():
            continue
        depth, mask = load_map(path), read_image(mask_path)
        row, column = np.nonzero(np.isfinite(depth.depth_m))
        rays = np.c_[column + 0.5, row + 0.5, np.ones(len(row))] @ np.linalg.inv(depth.K).T
        x, y = np.floor(image.camera.img_from_cam(rays)).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
        found = mask[y[inside], x[inside]]
        size = 2 * _BESIDE_PX + 1
        static = cv2.dilate((mask == CLASSES.index("static")).astype(np.uint8), np.ones((size, size))) > 0
        beside = found[static[y[inside], x[inside]]]
        total += np.stack([np.bincount(v.ravel(), minlength=len(CLASSES)) for v in (mask, found, beside)], axis=1)
    return total


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("truth", type=Path)
    args = parser.parse_args()
    total = counted(args.out, args.truth)
    said = ["| class | depths | share of all | of its pixels | beside something static |", "|---|---|---|---|---|"]
    for name, (pixels, depths, beside) in zip(CLASSES, total):
        shares = f"{depths / total[:, 1].sum():.2%} | {depths / max(pixels, 1):.1%} | {beside / max(depths, 1):.0%}"
        said.append(f"| {name} | {depths} | {shares} |")
    sys.stdout.write("\n".join(said) + "\n")


if __name__ == "__main__":
    main()
