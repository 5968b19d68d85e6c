"""One shot of a close-range rig like paper 004's, rendered: four cameras of 5 MP in a square of 7.5 cm, 8 mm lenses,
3.45 um pixels, 70 cm before a relief with a projected dot pattern; points a shot and their precision.

python -m benchmarks.dense.station --store WORK -o benchmarks/results/dense_station.json
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from tiegraph.dense.depth import depth_map
from tiegraph.dense.plan import CameraModel, DepthRange, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.shot import plan_shot
from tiegraph.dense.tuning import Tuning
from tiegraph.geometry.transforms import rigid
from tiegraph.scene.results import DepthMap

SIZE = (2448, 2050)
FOCAL_PX = 8.0 / 0.00345
BASE_M = 0.075
_TEXEL_M = 0.0001
_EXTENT_M = 0.9
_STEPS = 14  # fixed point of ray and relief: slopes stay below 0.5, so each step halves the error at least
_PAPER = {"points": 3.5e6, "precision_mm": 0.84}


def relief(x: np.ndarray, y: np.ndarray, distance: float) -> np.ndarray:
    """Depth (m) of the carved background: waves of 2 to 20 cm, 4 cm deep in all."""
    z = 0.012 * np.sin(31 * x + 4 * y) + 0.008 * np.sin(9 * x - 41 * y + 1)
    z += 0.003 * np.sin(83 * x + 1.3) * np.sin(97 * y) + 0.0008 * np.sin(290 * x + 240 * y)
    return (distance + z).astype(np.float32)


def boss(distance: float) -> np.ndarray:
    """Round plates before the background, rows (x, y, radius, depth): their rims hide what is behind."""
    rng = np.random.default_rng(4)
    at = rng.uniform([-0.26, -0.2], [0.26, 0.2], (9, 2))
    return np.column_stack([at, rng.uniform(0.015, 0.05, 9), distance - rng.uniform(0.04, 0.09, 9)])


def pattern(seed: int) -> np.ndarray:
    """Grey of the object (T, T) f4 by place: stone of several grains, and dots of several sizes as of a projector."""
    rng = np.random.default_rng(seed)
    n = int(_EXTENT_M / _TEXEL_M)
    grey = np.full((n, n), 105.0, np.float32)
    for grain, contrast in ((3, 9.0), (9, 12.0), (40, 14.0), (160, 14.0)):
        coarse = rng.standard_normal((n // grain + 2, n // grain + 2)).astype(np.float32)
        grey += contrast * cv2.resize(coarse, (n, n), interpolation=cv2.INTER_CUBIC)
    dots = np.zeros((n, n), np.float32)
    for x, y, r in rng.uniform([0, 0, 4], [n, n, 11], (60_000, 3)):
        cv2.circle(dots, (int(x), int(y)), int(r), 1.0, -1)
    return cv2.GaussianBlur(grey + 55 * dots, (0, 0), 1.6)


def render(position: np.ndarray, distance: float, texture: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Image (H, W) u1 and depth (H, W) f4 from a camera at ``position`` (3,) looking along z."""
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float32) + 0.5, np.arange(SIZE[1], dtype=np.float32) + 0.5)
    rx, ry = (u - SIZE[0] / 2) / np.float32(FOCAL_PX), (v - SIZE[1] / 2) / np.float32(FOCAL_PX)
    px, py = np.float32(position[0]), np.float32(position[1])
    z = np.full_like(rx, distance)
    for _ in range(_STEPS):
        z = relief(px + rx * z, py + ry * z, distance)
    for x, y, radius, depth in boss(distance):
        inside = (px + rx * depth - x) ** 2 + (py + ry * depth - y) ** 2 < radius**2
        z = np.where(inside & (depth < z), np.float32(depth), z)
    x, y = px + rx * z, py + ry * z
    at = [((w + _EXTENT_M / 2) / _TEXEL_M).astype(np.float32) for w in (x, y)]
    grey = cv2.remap(texture, at[0], at[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    rng = np.random.default_rng(seed)
    gain, offset = rng.uniform(0.92, 1.08), rng.uniform(-6, 6)
    noisy = gain * grey + offset + 2.0 * rng.standard_normal(grey.shape, np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), z


def rig(cameras: int) -> list[np.ndarray]:
    """Positions (3,): the square of paper 004, the upper left camera first."""
    return [np.array([x * BASE_M, y * BASE_M, 0.0]) for x, y in ((0, 0), (1, 0), (0, 1), (1, 1))][:cameras]


def judged(depth: DepthMap, truth: np.ndarray) -> dict[str, float]:
    """Points, and their precision: robust and plain sigma of the depth error, by prediction, and blunders."""
    known = np.isfinite(depth.depth_m)
    error = 1000 * (depth.depth_m[known] - truth[known])
    sigma = 1000 * depth.sigma_m[known]
    inner = np.abs(error) < 5
    return {
        "points": int(known.sum()),
        "share_of_pixels_%": round(100 * float(known.mean()), 1),
        "robust_sigma_mm": round(1.4826 * float(np.median(np.abs(error - np.median(error)))), 3),
        "sigma_mm_of_errors_below_5_mm": round(float(np.std(error[inner])), 3),
        "rms_mm": round(float(np.sqrt(np.mean(error**2))), 3),
        "bias_mm": round(float(np.median(error)), 3),
        "predicted_sigma_mm": round(float(np.median(sigma)), 3),
        "within_1_sigma_%": round(100 * float(np.mean(np.abs(error) < sigma)), 1),
        "beyond_5_mm_%": round(100 * float(np.mean(~inner)), 3),
    }


def run(store: Path, distance: float) -> dict[str, dict[str, float]]:
    """Render, match and judge one shot from its first camera: three partners, and one partner alone."""
    texture, positions = pattern(1), rig(4)
    params = (FOCAL_PX, FOCAL_PX, SIZE[0] / 2, SIZE[1] / 2)
    camera = CameraModel("PINHOLE", *SIZE, params)
    views, truth = [], None
    for k, position in enumerate(positions):
        image, depth = render(position, distance, texture, k)
        truth = depth if k == 0 else truth
        cv2.imwrite(str(store / f"cam{k}.png"), image)
        views.append(ViewPlan(f"cam{k}.png", camera, rigid(np.eye(3), -position)))
    assert truth is not None
    sought = DepthRange(0.5, 1.2)  # the working range of paper 004, section 5.2.4
    results, tuning = {}, Tuning()
    for label, used, fewest in (("3 partners, >= 3 rays", views, 3), ("1 partner", views[:2], 2)):
        settings = DenseSettings(max_image_size=2448, min_views=fewest)
        plan = plan_shot(views=used, sought=sought, settings=settings, tuning=tuning).images[views[0].name]
        start = time.process_time()
        first = depth_map(plan, store, None, settings, tuning)
        spent = time.process_time() - start
        if fewest == 3:  # one base image, as in the paper: no depth maps of others, three rays are asked of its own
            keep = first.views >= fewest
            first = DepthMap(**{**first.__dict__, "depth_m": np.where(keep, first.depth_m, np.float32(np.nan))})
        results[label] = {**judged(first, truth), "cpu_s": round(spent, 2)}
        np.savez_compressed(store / f"{len(used)}.npz", depth=first.depth_m, truth=truth, views=first.views)
    return results


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, required=True, help="folder for the rendered images")
    parser.add_argument("--distances", type=float, nargs="+", default=[0.7])
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    args.store.mkdir(parents=True, exist_ok=True)
    results: dict = {"paper": _PAPER}
    for distance in args.distances:
        results[f"{distance:g} m"] = run(args.store, distance)
    sys.stdout.write(json.dumps(results, indent=1) + "\n")
    if args.output:
        args.output.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
