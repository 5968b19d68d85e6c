"""How the kernels scale from one thread to two: wall time, tries with one and two threads in turn, the least of each.

On a machine with other work the least of many tries is the one that was disturbed least; the load is stated with it.

python -m benchmarks.dense.threads -o benchmarks/results/dense_threads.json
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

from benchmarks.dense.data import Pair, rendered
from tiegraph.dense import _sgm

_RANGE = 256
_AROUND = 16  # disparities a pixel in the ragged form


def forms(pair: Pair) -> dict[str, Callable[[int], object]]:
    """The dense form over all disparities, the ragged one with a block of 16 about the true disparity."""
    options, workspace = _sgm.Options(), _sgm.Workspace()
    first = (np.nan_to_num(pair.truth) - _AROUND // 2).astype(np.int16)
    blocks = np.ones(first.shape, np.uint8)

    def dense(threads: int) -> object:
        options.threads = threads
        return _sgm.match_dense(pair.left, pair.right, 0, pair.disparities, options, workspace)

    def ragged(threads: int) -> object:
        options.threads = threads
        return _sgm.match_ragged(pair.left, pair.right, first, blocks, options, workspace)

    return {"dense": dense, "ragged": ragged}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--tries", type=int, default=20)
    arguments = parser.parse_args()
    root = Path(os.environ.get("TIEGRAPH_DATA", "../shared/data")) / "stereo_gt"
    rows = {}
    for name, run in forms(rendered(root, 1224, 1024, _RANGE)).items():
        least = {1: float("inf"), 2: float("inf")}
        for _ in range(arguments.tries):
            for threads in least:
                start = time.perf_counter()
                run(threads)
                least[threads] = min(least[threads], time.perf_counter() - start)
        rows[name] = {
            "one_ms": round(1000 * least[1], 1),
            "two_ms": round(1000 * least[2], 1),
            "times": round(least[1] / least[2], 2),
            "load": round(os.getloadavg()[0], 1),
        }
        sys.stdout.write(f"{name:8s} {rows[name]}\n")
    if arguments.output:
        about = {"pair": "rendered 1224x1024", "tries": arguments.tries, "cores": os.cpu_count()}
        arguments.output.write_text(json.dumps({"about": about, "forms": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
