"""CNES libsgm (Apache 2.0, `pip install libsgm`) beside our kernel over all disparities, on one thread, interleaved.

libsgm only adds up the costs of eight paths; it is given our census costs. Ours does that and everything else: census,
costs, paths, winner, left-right check, sub-pixel.

python -m benchmarks.dense.libsgm -o benchmarks/results/dense_libsgm.json
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.dense.data import Pair, middlebury
from tiegraph.dense import _sgm

_PATHS = np.array([(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)], np.int32)
_SMALL, _LARGE = 20, 120
_RADIUS = (4, 3)  # 9 x 7 census: 62 bits


def census_costs(pair: Pair) -> np.ndarray:
    """(H, W, D) u1 Hamming distances of 9 x 7 census bits; 62 where the partner has no pixel."""
    bits = [_census(image) for image in (pair.left, pair.right)]
    height, width = pair.left.shape
    costs = np.full((height, width, pair.disparities), 62, np.uint8)
    for d in range(pair.disparities):
        differ = bits[0][:, d:] ^ bits[1][:, : width - d]
        costs[:, d:, d] = np.unpackbits(differ.view(np.uint8).reshape(*differ.shape, 8), axis=2).sum(axis=2)
    return costs


def _census(image: np.ndarray) -> np.ndarray:
    padded = np.pad(image, ((_RADIUS[1],) * 2, (_RADIUS[0],) * 2), "edge")
    height, width = image.shape
    bits = np.zeros(image.shape, np.uint64)
    for v in range(2 * _RADIUS[1] + 1):
        for u in range(2 * _RADIUS[0] + 1):
            if (v, u) != (_RADIUS[1], _RADIUS[0]):
                bits = (bits << np.uint64(1)) | (padded[v : v + height, u : u + width] < image).astype(np.uint64)
    return bits


def methods(pair: Pair) -> dict[str, Callable[[], object]]:
    """What is timed. Raises ImportError where libsgm is not installed."""
    import c_libsgm

    costs = census_costs(pair)
    height, width = pair.left.shape
    segments = np.ones((height, width), np.float32)
    options, workspace = _sgm.Options(), _sgm.Workspace()
    options.radius_x, options.radius_y, options.small, options.large = *_RADIUS, _SMALL, _LARGE
    found: dict[str, Callable[[], object]] = {
        "full": lambda: _sgm.match_dense(pair.left, pair.right, 0, pair.disparities, options, workspace)
    }
    for kind in (np.uint8, np.float32):
        penalties = [np.full((height, width, len(_PATHS)), p, kind) for p in (_SMALL, _LARGE)]
        volume = costs.astype(kind)
        found[f"libsgm {kind.__name__}"] = lambda v=volume, p=penalties: c_libsgm.sgm_api(  # type: ignore[misc]
            v, p[0], p[1], _PATHS, 255, segments, False, False
        )
    return found


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--pair", default="Reindeer")
    arguments = parser.parse_args()
    root = Path(os.environ.get("TIEGRAPH_DATA", "../shared/data")) / "stereo_gt"
    pair = next(p for p in middlebury(root) if p.name == arguments.pair)
    timed = methods(pair)
    least = dict.fromkeys(timed, float("inf"))
    for _ in range(arguments.repeats):
        for name, run in timed.items():
            start = time.process_time()
            run()
            least[name] = min(least[name], time.process_time() - start)
    cells = pair.left.size * pair.disparities
    rows = {
        name: {
            "cpu_ms": round(1000 * s, 1),
            "million_disparities_a_s": round(cells / s / 1e6, 1),
            "times_ours": round(s / least["full"], 1),
        }
        for name, s in least.items()
    }
    for name, row in rows.items():
        sys.stdout.write(f"{name:16s} {row}\n")
    if arguments.output:
        about = {"pair": pair.name, "size": pair.left.shape, "disparities": pair.disparities, "libsgm": "0.5.2"}
        arguments.output.write_text(json.dumps({"about": about, "methods": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
