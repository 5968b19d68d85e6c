"""Depth maps of a survey with two engines: the same model, partners, masks and filters.

python -m benchmarks.dense.survey OUT --images 'up/cam[0-4]/00001[123].jpg' --truth CANAL/gt/depth
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import ImagePlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import pinhole_of
from tiegraph.scene.results import DepthMap

_DEPTH_SCALE = 256  # truth is uint16, metres times this
_STATIC = 4  # class of the truth masks that has a depth worth comparing


def true_depth(plan: ImagePlan, folder: Path, settings: DenseSettings) -> np.ndarray | None:
    """Depth at the pixels of the undistorted image, NaN = unknown or an edge; None = no truth for the image."""
    path = (folder / plan.view.name).with_suffix(".png")
    if not path.exists():
        return None
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    mask = cv2.imread(str((folder.parent / "masks" / plan.view.name).with_suffix(".png")), cv2.IMREAD_UNCHANGED)
    metres = depth.astype(np.float32) / _DEPTH_SCALE
    metres[metres <= 0] = np.nan
    if mask is not None:
        metres[mask != _STATIC] = np.nan
    low, high = cv2.erode(metres, np.ones((3, 3))), cv2.dilate(metres, np.ones((3, 3)))
    metres = np.where(high < 1.1 * np.minimum(low, 1e6), metres, np.float32(np.nan))
    K, (width, height) = pinhole_of(plan.view.camera, settings)
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], -1).reshape(-1, 3)
    at = (
        np.asarray(plan.view.camera.to_pycolmap().img_from_cam(rays)).reshape(height, width, 2).astype(np.float32) - 0.5
    )
    outside = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": float("nan")}
    return cv2.remap(metres, at[..., 0], at[..., 1], cv2.INTER_NEAREST, **outside)


def compare(depth: DepthMap, truth: np.ndarray) -> dict[str, float]:
    """Shares of the true pixels that were answered, and answered within 1, 2, 5 %; of the answers beyond 5 and 20 %;
    the error in sigmas that two thirds stay below. The model's scale is not judged."""
    ratio = depth.depth_m / truth
    known = np.isfinite(ratio)
    error = np.abs(ratio / np.median(ratio[known]) - 1)
    n = np.count_nonzero(np.isfinite(truth))
    sigmas = (error * depth.depth_m / depth.sigma_m)[known]
    shares = {f"within_{p}%": np.count_nonzero(error[known] <= p / 100) / n for p in (1, 2, 5)}
    wrong = {f"beyond_{p}%": float(np.mean(error[known] > p / 100)) for p in (5, 20)}
    return {"answered": np.count_nonzero(known) / n, **shares, **wrong, "sigmas": float(np.percentile(sigmas, 68))}


def run(out: Path, pattern: str, truth: Path | None, engine: str) -> dict[str, float]:
    """All measures of one engine, means over the images."""
    settings, tuning = DenseSettings(engine=engine), Tuning()
    model = pycolmap.Reconstruction(str(out / "sparse" / "world"))
    plans = plan_images(model, settings, tuning.partners).images
    names = [n for n in sorted(plans) if fnmatch.fnmatch(n, pattern)]
    start = time.process_time()
    first = {n: depth_map(plans[n], out / "images", out / "masks", settings, tuning) for n in names}
    seconds = (time.process_time() - start) / len(names)
    rows = []
    for name in names:
        depth, _ = confirmed_map(plans[name], first[name], first.get, settings, tuning)
        row = {
            "kept": float(np.isfinite(depth.depth_m).mean()),
            "before": float(np.isfinite(first[name].depth_m).mean()),
        }
        row["relative_sigma"] = float(np.nanmedian(depth.sigma_m / depth.depth_m))
        row["views"] = float(depth.views[depth.views > 0].mean())
        known = None if truth is None else true_depth(plans[name], truth, settings)
        if known is not None:
            row |= compare(depth, known)
        rows.append(row)
    keys = sorted({k for r in rows for k in r})
    means = {k: round(float(np.mean([r[k] for r in rows if k in r])), 4) for k in keys}
    return {"images": len(names), "cpu_s_an_image": round(seconds, 2), **means}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="a run folder with sparse/world")
    parser.add_argument("--images", default="*", help="pattern of image names")
    parser.add_argument("--truth", type=Path, help="folder of true depth maps")
    parser.add_argument("--engines", nargs="+", default=["sgbm", "tsgm"])
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    results = {e: run(arguments.out, arguments.images, arguments.truth, e) for e in arguments.engines}
    for engine, row in results.items():
        sys.stdout.write(f"{engine} {json.dumps(row)}\n")
    if arguments.output:
        arguments.output.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
