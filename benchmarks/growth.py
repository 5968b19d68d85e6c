"""How a run grows with its images: ``python -m benchmarks.growth RUN [RUN ...]`` prints CPU seconds an image by stage.

The runs are of surveys alike in kind and unlike in size; their receipts say all. The last column is the exponent of the
power law CPU ~ images ** p through all runs: 1 = the same for each image, however many there are.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

Receipts = dict[str, dict]


def receipts(run: Path) -> Receipts:
    """The receipts of a run folder by stage, in the order they were finished."""
    found = [json.loads(p.read_text()) for p in (run / "receipts").glob("*.json")]
    found = [r for r in found if "finished" in r]  # not of a stage that runs now
    return {r["stage"]: r for r in sorted(found, key=lambda r: r["finished"])}


def exponent(images: np.ndarray, cpu_s: np.ndarray) -> float:
    """p of cpu_s ~ images ** p (K,), by least squares of the logarithms; NaN of one size alone."""
    if len(np.unique(images)) < 2:
        return np.nan
    return float(np.polyfit(np.log(images), np.log(np.maximum(cpu_s, 1e-3)), 1)[0])


def table(runs: list[Receipts]) -> list[list[str]]:
    """Rows of the table: the sizes, each stage that all runs have, their sum, and what came out."""
    runs = sorted(runs, key=lambda r: r["scan"]["counts"]["images"])
    images = np.array([r["scan"]["counts"]["images"] for r in runs])
    stages = [s for s in runs[0] if all(s in r for r in runs)]
    cpu = {s: np.array([r[s]["cpu_s"] for r in runs]) for s in stages}
    cpu["all"] = np.sum(list(cpu.values()), axis=0)
    rows = [["CPU s an image", *(f"{n}" for n in images), "p"]]
    rows += [[s, *(f"{v:.3f}" for v in cpu[s] / images), f"{exponent(images, cpu[s]):.2f}"] for s in cpu]
    minutes = [sum(r[s]["seconds"] for s in stages) / 60 for r in runs]
    memory = [max(r[s]["peak_mib"] for s in stages) / 1024 for r in runs]
    rows += [["wall, min", *(f"{v:.1f}" for v in minutes), ""], ["peak, GiB", *(f"{v:.1f}" for v in memory), ""]]
    for stage, count, name in (("design", "pairs", "pairs an image"), ("sparse", "registered", "registered, share")):
        if stage in stages:
            shares = [r[stage]["counts"][count] for r in runs] / images
            rows.append([name, *(f"{v:.3g}" for v in shares), ""])
    return rows


def main() -> None:
    """Print the table of the run folders given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    rows = table([receipts(run) for run in parser.parse_args().runs])
    width = [max(len(r[k]) for r in rows) for k in range(len(rows[0]))]
    for row in rows:
        cells = [row[0].ljust(width[0]), *(c.rjust(w) for c, w in zip(row[1:], width[1:]))]
        sys.stdout.write("  ".join(cells).rstrip() + "\n")


if __name__ == "__main__":
    main()
