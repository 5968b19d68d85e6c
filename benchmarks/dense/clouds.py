"""Clouds of a finished model with three ways to a depth, against a reference cloud, depth truth, or each other.

sgbm = OpenCV's matcher; pairs = our matcher, each pixel from its most exact partner alone; rays = our matcher, all
partners' rays intersected (the dense stage). Same model, partners, masks and filters; `pairs` and `rays` even share the
disparities.

python -m benchmarks.dense.clouds OUT canal --images '*/cam[0-4]/00001[0-4].jpg' --truth CANAL/gt/depth
python -m benchmarks.dense.clouds OUT Herz-Jesus-P25 --halves   # no reference: every second frame against the others
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from benchmarks.accuracy import pose_centre
from benchmarks.datasets import Dataset, load
from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning as CloudTuning
from tiegraph.dense.depth import confirmed_map
from tiegraph.dense.engine import Candidates, propose, solve
from tiegraph.dense.plan import ImagePlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tsgm import MAX_CELLS, match_sgbm, match_tsgm
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view, pinhole_of
from tiegraph.evaluate.clouds.nearest import Cameras, cloud_to_cloud, criteria_of, nearest
from tiegraph.evaluate.clouds.tiles import tile_clouds
from tiegraph.evaluate.tuning import CloudTuning as JudgedCloud
from tiegraph.geometry.transforms import Similarity, apply, umeyama
from tiegraph.pipeline.dense import coloured
from tiegraph.scene.cloudchunks import open_cloud, points_of
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud, DepthMap, load_depth, save_depth

Truth = Callable[[ImagePlan], "np.ndarray | None"]  # depth at the pixels of the undistorted image, NaN = unknown

VARIANTS = ("sgbm", "pairs", "rays")
_SETTINGS, _TUNING, _JUDGED = DenseSettings(), Tuning(), JudgedCloud()
_DISTANCES_M = (0.02, 0.05, 0.10, 0.20)
_RANGE_M, _MOST_POINTS = 50.0, 20_000_000
_BINS_M = (0.0, 5.0, 10.0, 20.0, 40.0, 1e9)  # distance from the camera


def most_exact(candidates: Sequence[Candidates]) -> list[Candidates]:
    """One proposal a pixel: that of the partner with the smallest unit."""
    unit = np.stack([c.unit for c in candidates])
    best = np.argmin(np.where(np.isfinite(unit), unit, np.inf), axis=0)
    return [Candidates(np.where(best == k, c.inverse, np.float32(np.nan)), c.unit) for k, c in enumerate(candidates)]


def first_maps(plan: ImagePlan, out: Path, store: Path, variants: Sequence[str]) -> dict[str, float]:
    """Write the depth maps of one image before comparison; CPU seconds of each variant."""
    masks = next(m for m in (out / "refine" / "masks", out / "masks") if m.exists())
    start = time.process_time()
    reference = load_view(plan.view, out / "images", masks, _SETTINGS)
    partners = [load_view(v, out / "images", masks, _SETTINGS) for v in plan.partners]
    reading = time.process_time() - start
    spent, candidates = {}, {}
    for name, matcher, cells in (("sgbm", match_sgbm, MAX_CELLS), ("tsgm", match_tsgm, np.inf)):
        if name == "tsgm" or "sgbm" in variants:
            start = time.process_time()
            candidates[name] = propose(reference, partners, plan.depth_range, _SETTINGS, _TUNING, matcher, cells)
            spent[name] = reading + time.process_time() - start
    ways: dict[str, Callable[[], tuple[str, list[Candidates]]]] = {
        "sgbm": lambda: ("sgbm", candidates["sgbm"]),
        "pairs": lambda: ("tsgm", most_exact(candidates["tsgm"])),
        "rays": lambda: ("tsgm", candidates["tsgm"]),
    }
    seconds = {}
    for variant in variants:
        start = time.process_time()
        matched, proposals = ways[variant]()
        solved = solve(reference, proposals, _SETTINGS, _TUNING.rays)
        save_depth(solved, store / variant / "first" / f"{plan.view.name}.npz")
        seconds[variant] = spent[matched] + time.process_time() - start
    return seconds


def confirm(plan: ImagePlan, folder: Path) -> tuple[DepthMap, dict[str, float]]:
    """The depth map after comparison (written too) and what the comparison did."""

    def load_first(name: str) -> DepthMap | None:
        path = folder / "first" / f"{name}.npz"
        return load_depth(path) if path.exists() else None

    first = load_first(plan.view.name)
    assert first is not None
    start = time.process_time()
    depth, counts = confirmed_map(plan, first, load_first, _SETTINGS, _TUNING)
    seconds = time.process_time() - start
    save_depth(depth, folder / f"{plan.view.name}.npz")
    size = depth.depth_m.size
    shares = {k: getattr(counts, k) / size for k in ("before", "kept", "few_views", "seen_through", "two_rays")}
    return depth, {"confirm_cpu_s": seconds, **shares}


def sigma_rows(depths: Sequence[DepthMap], truths: Sequence[np.ndarray]) -> list[dict[str, float]]:
    """Error beside prediction by distance: medians of |error| (as a sigma), of sigma, share of blunders (> 5 sigmas and
    > 2 %), and the same by number of views."""
    error = np.concatenate([np.abs(d.depth_m - t).ravel() for d, t in zip(depths, truths, strict=True)])
    sigma = np.concatenate([d.sigma_m.ravel() for d in depths])
    views = np.concatenate([d.views.ravel() for d in depths])
    truth = np.concatenate([t.ravel() for t in truths])
    known = np.isfinite(error)
    rows = []
    groups = [(f"{a:g}-{b:g} m", (truth >= a) & (truth < b)) for a, b in zip(_BINS_M[:-1], _BINS_M[1:], strict=True)]
    groups += [(f"{n} views", views == n) for n in (2, 3, 4)] + [("5 views or more", views >= 5)]
    for label, group in groups:
        at = known & group
        if at.sum() < 200:
            continue
        e, s = error[at], sigma[at]
        blunder = (e > 5 * s) & (e > 0.02 * truth[at])
        actual, predicted = 1.4826 * float(np.median(e)), float(np.median(s))
        rows.append({
            "group": label, "pixels": int(at.sum()), "actual_m": round(actual, 4), "predicted_m": round(predicted, 4),
            "within_1_sigma": round(float(np.mean(e < s)), 3), "within_2_sigma": round(float(np.mean(e < 2 * s)), 3),
            "blunders_%": round(100 * float(blunder.mean()), 2),
        })  # fmt: skip
    return rows


def alignment(reconstruction: pycolmap.Reconstruction, data: Dataset) -> Similarity:
    """True world from the model's, by the projection centres of all images with a known pose."""
    pairs = [
        (image.projection_center(), pose_centre(data.cam_from_world[image.name]))
        for image in reconstruction.images.values()
        if image.has_pose and image.name in data.cam_from_world
    ]
    return umeyama(np.array([a for a, _ in pairs]), np.array([b for _, b in pairs]))


def judged(cloud: Cloud, points: np.ndarray, fit: Similarity | None, cameras: np.ndarray) -> dict[str, Any]:
    """Accuracy, completeness, F, ghosts, and the distance to the reference by predicted sigma (quarters)."""
    own = points_of(fit(cloud.xyz_m) if fit else cloud.xyz_m)
    views = Cameras(fit(cameras) if fit else cameras, ("all",) * len(cameras))
    with tempfile.TemporaryDirectory() as scratch:
        tiled = tile_clouds(own, points_of(points), Path(scratch), _JUDGED)
        criteria = criteria_of(tiled, _DISTANCES_M, range_m=_RANGE_M)
        found = cloud_to_cloud(tiled, criteria, Path(scratch), views).whole
    rows = {
        f"{d:g} m": [round(100 * x, 1) for x in (a, c, f)]
        for d, a, c, f in zip(_DISTANCES_M, found.accuracy, found.completeness, found.fscore, strict=True)
    }
    some = cloud.where(np.random.default_rng(0).permutation(len(cloud))[:200_000])
    away = nearest(fit(some.xyz_m) if fit else some.xyz_m, points, 1.0)
    order = np.array_split(np.argsort(some.sigma_m), 4)
    quarters = [
        [round(float(np.median(some.sigma_m[q])), 4), round(float(np.median(away[q])), 4)] for q in order if len(q)
    ]
    figures = {"median_m": found.median_m, "p90_m": found.p90_m, "ghosts_%": 100 * found.ghosts}
    return {
        "accuracy_completeness_F_%": rows,
        **{k: round(v, 4) for k, v in figures.items()},
        "sigma_and_distance_by_quarter_of_sigma": quarters,
    }


def variant_cloud(out: Path, plans: dict[str, ImagePlan], folder: Path, truth: Truth) -> tuple[Cloud, dict]:
    """Second step and fusion of one variant: the cloud and its figures."""
    rows, depths, truths = [], [], []
    for plan in plans.values():
        depth, row = confirm(plan, folder)
        rows.append(row)
        known = truth(plan)
        if known is not None:
            depths.append(depth)
            truths.append(known)
    start = time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        colours = coloured(plans, out / "images", _SETTINGS)
        maps = Maps(lambda name: load_depth(folder / f"{name}.npz"), colours)
        fused = fuse(sorted(plans), maps, Path(scratch), CloudSettings(), CloudTuning())
        cloud = fused.cloud()
    figures = {k: round(float(np.mean([r[k] for r in rows])), 4) for k in rows[0]}
    figures |= {"fuse_cpu_s_an_image": round((time.process_time() - start) / len(plans), 3), "voxel": fused.voxel}
    figures |= {"points": len(cloud), "median_sigma": round(float(np.median(cloud.sigma_m)), 5)}
    if depths:
        figures["sigma"] = sigma_rows(depths, truths)
    return cloud, figures


def one_set(out: Path, model: pycolmap.Reconstruction, pattern: str, store: Path, truth: Truth, keep: list[str]):
    """(clouds, figures) by variant of the images of a model that match a pattern; first maps in the store are used."""
    found = plan_images(model, _SETTINGS, _TUNING.partners)
    plans = {n: p for n, p in found.images.items() if fnmatch.fnmatch(n, pattern)}
    todo = [p for n, p in plans.items() if not all((store / v / "first" / f"{n}.npz").exists() for v in keep)]
    seconds = [first_maps(p, out, store, keep) for p in todo]
    clouds, figures = {}, {}
    for variant in keep:
        clouds[variant], figures[variant] = variant_cloud(out, plans, store / variant, truth)
        spent = {"match_cpu_s": round(float(np.mean([s[variant] for s in seconds])), 3)} if seconds else {}
        figures[variant] = {"images": len(plans), **spent, **figures[variant]}
    return clouds, figures


def half(model: pycolmap.Reconstruction, odd: int) -> pycolmap.Reconstruction:
    """The model with every second frame only, in the order of the image names."""
    part = pycolmap.Reconstruction(model)
    named = sorted((min(part.image(d.id).name for d in part.frame(f).image_ids), f) for f in part.reg_frame_ids())
    for _, frame in named[1 - odd :: 2]:
        part.deregister_frame(frame)
    return part


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a run folder with sparse/world")
    parser.add_argument("set", help="data set whose truth is the reference (benchmarks/datasets.py)")
    parser.add_argument("--images", default="*", help="pattern of image names")
    parser.add_argument("--truth", type=Path, help="folder of true depth maps")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=VARIANTS)
    parser.add_argument("--halves", action="store_true", help="two halves of the frames against each other")
    parser.add_argument("--store", type=Path, required=True, help="folder for depth maps and clouds; kept first maps")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    model = pycolmap.Reconstruction(str(args.out / "sparse" / "world"))
    data = load(args.set, args.store)
    fit = alignment(model, data)
    centres = np.array([i.projection_center() for i in model.images.values() if fnmatch.fnmatch(i.name, args.images)])
    truth = depth_truth(data, fit, args.truth)
    run = partial(one_set, args.out, pattern=args.images, truth=truth, keep=args.variants)
    if args.halves:
        clouds, figures = run(model=half(model, 0), store=args.store / "even")
        others, _ = run(model=half(model, 1), store=args.store / "odd")
        for name, cloud in clouds.items():
            figures[name] |= judged(cloud, fit(others[name].xyz_m), fit, centres)
    else:
        clouds, figures = run(model=model, store=args.store)
        if data.reference_cloud is not None:
            points = reference_points(data.reference_cloud)
            for name, cloud in clouds.items():
                figures[name] |= judged(cloud, points, fit, centres)
    for name, cloud in clouds.items():
        write_cloud(cloud, args.store / f"{name}.ply")
        sys.stdout.write(f"{name} {json.dumps(figures[name])}\n")
    figures["peak_mib"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    if args.output:
        args.output.write_text(json.dumps(figures, indent=1) + "\n")


def depth_truth(data: Dataset, fit: Similarity, folder: Path | None) -> Truth:
    """What is known of an image's depths: maps in a folder, PandaSet's laser scans, or nothing."""
    if folder is not None:
        return partial(true_depth, folder=folder, settings=_SETTINGS)
    if data.name == "pandaset":
        assert data.reference_cloud is not None
        scans = PandaScans(data.reference_cloud.parent, reference_points(data.reference_cloud), fit)
        return partial(scans, settings=_SETTINGS)
    return lambda plan: None


def reference_points(path: Path) -> np.ndarray:
    """Points (M, 3) in metres of a reference cloud: LAS, LAZ, PLY, or PandaSet's .npz of centimetres."""
    if path.suffix != ".npz":
        return open_cloud(path).sample(_MOST_POINTS)
    with np.load(path) as file:
        return file["xyz_cm"].astype(float) / 100


# --- true depths: of rendered images, and from laser scans ------------------------------------------------------------


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


_HIDDEN_PX = 21  # the laser stands elsewhere than the camera: a point is hidden by one much nearer within this window
_HIDDEN = 1.05
_MESH = 1.2  # and where others lie this much further within the window, it may be on a mesh that images see through
_STATIC_M = 0.12  # a point further than this from the cloud of what stands still is on something that may move


def scan_depth(plan: ImagePlan, xyz: np.ndarray, counted: np.ndarray, settings: DenseSettings) -> np.ndarray:
    """(H, W) f4 depth at the pixels of the undistorted image that a counted (N,) bool point (N, 3), in the model's
    world, falls on; NaN elsewhere, where any point near by would hide it, and where the surface
    is not closed."""
    K, (width, height) = pinhole_of(plan.view.camera, settings)
    local = apply(plan.view.cam_from_world, xyz)
    counted, local = counted[local[:, 2] > 0], local[local[:, 2] > 0]
    at = local @ K.T
    column, row = (np.floor(at[:, k] / at[:, 2]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    inverse, any_inverse = np.zeros((2, height, width), np.float32)
    for image, points in ((inverse, inside & counted), (any_inverse, inside)):
        np.maximum.at(image, (row[points], column[points]), (1 / local[points, 2]).astype(np.float32))
    nearest = cv2.dilate(any_inverse, np.ones((_HIDDEN_PX, _HIDDEN_PX)))
    furthest = cv2.erode(np.where(any_inverse > 0, any_inverse, np.float32(1e6)), np.ones((_HIDDEN_PX, _HIDDEN_PX)))
    seen = (inverse > 0) & (nearest < _HIDDEN * inverse) & (furthest * _MESH > inverse)
    return np.where(seen, 1 / np.where(seen, inverse, 1), np.nan).astype(np.float32)


class PandaScans:
    """PandaSet's scans, one a frame, without what moves; depths of an image by its name and the model's alignment."""

    def __init__(self, folder: Path, static: np.ndarray, world_from_model: Similarity) -> None:
        self.folder, self.static, self.fit = folder, cKDTree(static), world_from_model

    def __call__(self, plan: ImagePlan, settings: DenseSettings) -> np.ndarray | None:
        """True depth of an image, None where its frame has no scan."""
        path = self.folder / f"{Path(plan.view.name).stem}.npz"
        if not path.exists():
            return None
        with np.load(path) as file:
            xyz = file["xyz_cm"].astype(float) / 100
        still = self.static.query(xyz, distance_upper_bound=_STATIC_M)[0] < _STATIC_M
        model = (xyz - self.fit.translation) @ self.fit.rotation / self.fit.scale
        return scan_depth(plan, model, still, settings)


if __name__ == "__main__":
    main()
