"""Methods side by side on the same pairs, interleaved, in processor time of this process on one thread.

python -m benchmarks.dense.compare -o benchmarks/results/dense_pairs.json
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from benchmarks.dense.data import Pair, middlebury, rendered
from tiegraph.dense import _sgm
from tiegraph.dense.tsgm import match, without_speckles
from tiegraph.dense.tuning import TsgmTuning

Method = Callable[[Pair], np.ndarray]
_MAX_HH_CELLS = 700e6  # OpenCV's 8-path mode holds about 4 bytes a cell: larger pairs are left out


def opencv(mode: int) -> Method:
    """StereoSGBM with 3 x 3 blocks and the penalties OpenCV's documentation derives from them, left-right check 1."""

    def run(pair: Pair) -> np.ndarray:
        matcher = cv2.StereoSGBM_create(0, pair.disparities, 3, 72, 288, 1, 63, 5, 0, 0, mode)
        found = matcher.compute(pair.left, pair.right).astype(np.float32) / 16
        return np.where(found < 0, np.float32(np.nan), found)

    return run


def ours(tuning: TsgmTuning) -> Method:
    """The native matcher."""
    return lambda pair: match(pair.left, pair.right, 0, pair.disparities, tuning)


METHODS: dict[str, Method] = {
    "SGBM HH": opencv(cv2.STEREO_SGBM_MODE_HH),
    "SGBM 3WAY": opencv(cv2.STEREO_SGBM_MODE_SGBM_3WAY),
    "tsgm": ours(TsgmTuning()),
}


def fits(name: str, pair: Pair) -> bool:
    """Whether the method's memory for the pair is bearable."""
    return name != "SGBM HH" or pair.left.size * pair.disparities <= _MAX_HH_CELLS


def compare(pair: Pair, repeats: int, names: list[str]) -> dict[str, dict[str, float]]:
    """Scores after the same speckle filter, and the least processor time of the matching alone, in milliseconds."""
    names = [n for n in names if fits(n, pair)]
    least = dict.fromkeys(names, float("inf"))
    found = {}
    for _ in range(repeats):
        for name in names:
            start = time.process_time()
            found[name] = METHODS[name](pair)
            least[name] = min(least[name], time.process_time() - start)
    clean = {n: without_speckles(found[n]) for n in names}
    return {n: {"cpu_ms": round(1000 * least[n], 1), **score(clean[n], pair)} for n in names}


def score(found: np.ndarray, pair: Pair) -> dict[str, float]:
    """completeness: answered share of the judged pixels; bad_1, bad_2: share of the answers off by more than 1 or 2 px;
    good_1, good_2: share of the judged pixels answered within 1 or 2 px; sigma_px: of errors below 1 px; locking:
    largest share of a tenth of a pixel among the fractions, 1 = none; bar_<w>: share of a bar within 2 px."""
    judged = pair.judged
    error = found - pair.truth
    answered = judged & np.isfinite(error)
    size = np.abs(error[answered])
    n = np.count_nonzero(judged)
    fraction = np.histogram(found[answered] % 1, 10, (0, 1))[0] / max(1, np.count_nonzero(answered))
    result = {
        "completeness": len(size) / n,
        "bad_1": float(np.mean(size > 1)),
        "bad_2": float(np.mean(size > 2)),
        "good_1": np.count_nonzero(size <= 1) / n,
        "good_2": np.count_nonzero(size <= 2) / n,
        "sigma_px": float(np.std(error[answered][size < 1])),
        "locking": float(fraction.max() * 10),
    }
    for width, bar in pair.bars.items():
        here = bar & judged
        if here.any():
            result[f"bar_{width}"] = float(np.mean(np.abs(error[here]) <= 2))
    return {k: round(v, 4) for k, v in result.items()}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--large", action="store_true", help="also 2448 x 2048 with 512 disparities")
    parser.add_argument("--only", default="", help="pairs whose name contains this")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    root = Path(os.environ.get("TIEGRAPH_DATA", "../shared/data")) / "stereo_gt"
    pairs = [*middlebury(root), rendered(root, 1224, 1024, 256), rendered(root, 1224, 1024, 256, seed=100)]
    if arguments.large:
        pairs.append(rendered(root, 2448, 2048, 512, seed=200))
    results = {}
    for number, pair in enumerate(p for p in pairs if arguments.only in p.name):
        key = pair.name if pair.name not in results else f"{pair.name} ({number})"
        results[key] = compare(pair, arguments.repeats, arguments.methods)
        for name, row in results[key].items():
            words = " ".join(f"{k} {v}" for k, v in row.items())
            sys.stdout.write(f"{key:24s} {name:12s} {words}" + chr(10))
            sys.stdout.flush()
    if arguments.output:
        about = {"machine": platform.machine(), "kernels": _sgm.kernels(), "opencv": cv2.__version__, "threads": 1}
        arguments.output.write_text(json.dumps({"about": about, "pairs": results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
