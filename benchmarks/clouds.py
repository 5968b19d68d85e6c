"""Memory and time of comparing clouds of any size: two generated surveys of 1 cm points, as LAS files.

``python -m benchmarks.clouds FOLDER --millions 25 [-o FILE]`` adds a row to FILE, or replaces that of the same size.
FOLDER takes 30 bytes a point of either cloud, and 64 more while they are compared.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from pathlib import Path

import laspy
import numpy as np

from tiegraph.evaluate.clouds.judge import Question, judge_cloud
from tiegraph.evaluate.tuning import Tuning
from tiegraph.scene.cloudchunks import open_cloud

_PART = 1_000_000
_STEP_M, _NOISE_M = 0.01, 0.005


def street(path: Path, millions: int, seed: int) -> None:
    """A street 20 m wide with a wall of 5 m on one side, as long as the number of points needs."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    rng, length = np.random.default_rng(seed), _PART * _STEP_M**2 / 25
    with laspy.open(path, mode="w", header=header) as out:
        for part in range(millions):
            x, y = length * (part + rng.uniform(size=_PART)), rng.uniform(0, 25, _PART)
            xyz = np.column_stack([x, np.minimum(y, 20), np.maximum(y - 20, 0) + 0.3 * np.sin(x / 5)])
            record = laspy.ScaleAwarePointRecord.zeros(_PART, header=header)
            record.x, record.y, record.z = (xyz + rng.normal(0, _NOISE_M, xyz.shape)).T
            out.write_points(record)


def main() -> None:
    """Generate, compare, print peak memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--millions", type=int, default=30)
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    paths = [given.folder / f"street{k}.las" for k in (0, 1)]
    for k, path in enumerate(paths):
        street(path, given.millions, k)
    before, start, cpu = _peak_mib(), time.perf_counter(), time.process_time()
    found = judge_cloud(open_cloud(paths[0]), open_cloud(paths[1]), given.folder, Question(), Tuning())
    summary, whole = found.differences.summary(), found.nearest.whole
    result = {
        "points of each cloud": given.millions * _PART,
        "judged points": whole.points,
        "core points": len(found.differences),
        "peak MiB before": round(before),
        "peak MiB": round(_peak_mib()),
        "wall s": round(time.perf_counter() - start),
        "CPU s": round(time.process_time() - cpu),
        "median m": round(whole.median_m, 5),
        "F %": {f"{d:g} m": round(100 * f, 2) for d, f in zip(found.nearest.criteria.distances_m, whole.fscore)},
        "M3C2 median m": round(summary["median m"], 6),
        "M3C2 significant %": round(summary["significant %"], 2),
        "cores": os.cpu_count(),
        "load at start": round(os.getloadavg()[1], 1),
    }
    print(json.dumps(result, indent=1))  # noqa: T201
    if given.out:
        rows = json.loads(given.out.read_text()) if given.out.exists() else []
        rows = [row for row in rows if row["points of each cloud"] != result["points of each cloud"]]
        rows = sorted([*rows, result], key=lambda row: row["points of each cloud"])
        given.out.write_text(json.dumps(rows, indent=1) + "\n")


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
