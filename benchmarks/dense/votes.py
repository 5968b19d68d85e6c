"""What agreement is worth: errors of depths by the number of depth maps and of images that agree, against depth truth.

Takes the first maps that `clouds` left in its store. `--pair A B`: both images matched with each other alone, judged by
the confirmed maps of the store where six images or more agree. `--sigma`: first maps against these, error beside
prediction by distance, for sets without depth truth.

python -m benchmarks.dense.votes OUT canal --truth CANAL/gt/depth --store WORK
python -m benchmarks.dense.votes OUT fountain-P11 --store WORK --pair 0004.jpg 0005.jpg
python -m benchmarks.dense.votes OUT fountain-P11 --store WORK --sigma
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from benchmarks.datasets import load
from benchmarks.dense.clouds import Truth, alignment, depth_truth, sigma_rows
from tiegraph.dense.depth import LoadDepth, Surface, Tally, check, depth_map
from tiegraph.dense.plan import ImagePlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.scene.results import load_depth

_SETTINGS, _TUNING = DenseSettings(), Tuning()
_WRONG, _RIGHT = 0.05, 0.02
_SURE_VIEWS = 6


def votes(plan: ImagePlan, load_first: LoadDepth, truth: np.ndarray) -> np.ndarray:
    """(n, 5) of the pixels with truth and depth: other depth maps that agree, images that agree, that see through, that
    could see it, relative error."""
    depth = load_first(plan.view.name)
    assert depth is not None
    partners = [v.name for v in plan.partners]
    tally, unseen = Tally(depth), set(partners)
    for name in plan.witnesses:
        other = load_first(name)
        if other is not None:
            unseen.discard(name)
            partner = partners.index(name) if name in partners else None
            tally.hear(Surface(other), partner, _SETTINGS.tolerance_px, _TUNING.rays)
    maps = tally.maps - 1 + sum(tally.matched(k).astype(int) for k, name in enumerate(partners) if name in unseen)
    known = np.isfinite(depth.depth_m) & np.isfinite(truth)
    columns = (maps, tally.views, tally.against, tally.possible + len(unseen), np.abs(depth.depth_m / truth - 1))
    return np.stack([c[known] for c in columns], axis=1)


def report(rows: np.ndarray) -> str:
    """Errors by agreeing depth maps, and what four rules keep."""
    maps, views, against, possible, error = rows.T
    needed, open_ = np.clip(1 + possible, 2, 3), against < views
    lines = [f"{len(rows)} pixels"]
    for n in range(5):
        at = (views >= 3) & open_ & ((maps == n) if n < 4 else (maps >= n))
        if at.any():
            lines.append(f"{n} other depth maps agree: {_shares(at, error)}")
    two = (maps + 1 >= needed) & open_ & (views == 2)
    rules = {
        "matches count (before)": (views >= needed) & ((needed > 2) | (maps >= 1)) & open_,
        "depth maps count": (maps + 1 >= needed) & open_,
        "the same without two rays": (maps >= 2) & open_,
        "one depth map more": (maps >= np.clip(possible, 1, 3)) & open_,
    }
    if two.any():
        lines.append(f"two rays: {_shares(two, error)}")
    first = np.count_nonzero(next(iter(rules.values())) & (error < _RIGHT))
    for name, kept in rules.items():
        right = 100 * np.count_nonzero(kept & (error < _RIGHT)) / first
        lines.append(f"{name}: {_shares(kept, error)}, right ones kept {right:.1f} %")
    return "\n".join(lines) + "\n"


def _shares(at: np.ndarray, error: np.ndarray) -> str:
    return f"{100 * at.mean():.2f} % of the pixels, wrong by > 5 % {100 * np.mean(error[at] > _WRONG):.2f} %"


def pair_report(plans: dict[str, ImagePlan], pair: tuple[str, str], out: Path, sure: LoadDepth) -> str:
    """Two images alone: share answered and share wrong, by the tolerance of their agreement."""
    masks = out / "masks"
    maps = {}
    for one, other in (pair, pair[::-1]):
        plan = dataclasses.replace(plans[one], partners=(plans[other].view,))
        maps[one] = depth_map(plan, out / "images", masks, _SETTINGS, _TUNING)
    lines = []
    for one, other in (pair, pair[::-1]):
        known = sure(one)
        assert known is not None
        truth = np.where(known.views >= _SURE_VIEWS, known.depth_m, np.nan)
        for tolerance in (None, 1.0, 0.5):
            depth = maps[one]
            if tolerance is not None:
                settings = DenseSettings(tolerance_px=tolerance)
                depth, _ = check(depth, [other], [other], maps.get, settings, _TUNING.rays)
            error = np.abs(depth.depth_m / truth - 1)
            found = np.isfinite(error)
            share = 100 * np.count_nonzero(found) / np.count_nonzero(np.isfinite(truth))
            wrong = [100 * float(np.mean(error[found] > e)) for e in (0.01, _WRONG)]
            label = "one match" if tolerance is None else f"both within {tolerance:g} px"
            lines.append(
                f"{one} {label}: answered {share:.1f} %, wrong by > 1 % {wrong[0]:.2f} %, > 5 % {wrong[1]:.3f} %"
            )
    return "\n".join(lines) + "\n"


def sigma_report(folder: Path) -> str:
    """Depths of one image's own matches against the mean of all where six images or more agree."""
    first, mean = [], []
    for path in sorted((folder / "first").rglob("*.npz")):
        first.append(load_depth(path))
        sure = load_depth(folder / path.relative_to(folder / "first"))
        mean.append(np.where(sure.views >= _SURE_VIEWS, sure.depth_m, np.nan))
    return "".join(f"{row}\n" for row in sigma_rows(first, mean))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a run folder with sparse/world")
    parser.add_argument("set", help="data set whose truth is the reference (benchmarks/datasets.py)")
    parser.add_argument("--truth", type=Path, help="folder of true depth maps")
    parser.add_argument("--store", type=Path, required=True, help="the store of `clouds`")
    parser.add_argument("--variant", default="rays")
    parser.add_argument("--pair", nargs=2)
    parser.add_argument("--sigma", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    model = pycolmap.Reconstruction(str(args.out / "sparse" / "world"))
    plans = plan_images(model, _SETTINGS, _TUNING.partners).images
    folder = args.store / args.variant
    if args.sigma:
        sys.stdout.write(sigma_report(folder))
        return

    def load_from(where: Path, name: str):
        path = where / f"{name}.npz"
        return load_depth(path) if path.exists() else None

    if args.pair:
        sys.stdout.write(pair_report(plans, tuple(args.pair), args.out, lambda n: load_from(folder, n)))
        return
    data = load(args.set, args.store)
    truth: Truth = depth_truth(data, alignment(model, data), args.truth)
    rows = []
    for name, plan in sorted(plans.items()):
        known = truth(plan) if (folder / "first" / f"{name}.npz").exists() else None
        if known is not None:
            rows.append(votes(plan, lambda n: load_from(folder / "first", n), known))
    sys.stdout.write(report(np.concatenate(rows)))


if __name__ == "__main__":
    main()
