"""Why the masks of paper 001 reach 91 % there and 73 to 78 % here: the paper's measure, its free constants, the data.

    TIEGRAPH_DATA=... python -m benchmarks.masks.paper001 -o benchmarks/results/masks_paper001.json

Three things may differ: what is called accuracy ("the proportion of masked regions was compared": shares of the image,
or pixels that agree), how the sentences of the recipe are read with the constants that it does not print (all
combinations below are tried, and the best is chosen by the truth: no reading with these parts can be better), and the
images (which class the recipe gets wrong). Images at the recipe's working size, every fifth frame.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks.masks.measure import MaskSet, load
from tiegraph.masks.frames import block_share, from_blocks, grey, read_small, two_frames
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning
from tiegraph.papers.meguro2025 import blue_sky, edge_sky, initial_mask

EVERY = 5
SIMILARITY = (0.3, 0.45, 0.6, 0.75, 0.9, 1.0)  # 1: the first stage masks nothing
EDGE = (4.0, 8.0, 16.0, 32.0, 0.0)  # 0: no sky by edges
OVEREXPOSED = (230, 250, 256)  # 256: none
SKY = ("either", "both")  # "the two types of sky masks are combined": as union or intersection
CLASSES = {"sky": 0, "water": 1, "platform": 2, "moving": 3, "static": 4}
_USEFUL = CLASSES["static"]


class Parts:
    """What each stage of the recipe masks in one image, by constant, and the true classes (h, w)."""

    def __init__(self, path: Path, truth: Path, initial: dict[float, np.ndarray | None], tuning: Tuning) -> None:
        image = read_small(path, tuning.work_px)
        brightness = grey(image)
        classes = cv2.imread(str(truth), cv2.IMREAD_GRAYSCALE)
        self.classes = cv2.resize(classes, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        self.blue = blue_sky(image, tuning.papers)
        none = np.zeros(brightness.shape, bool)
        self.edge = {e: edge_sky(brightness, e) if e else none for e in EDGE}
        self.bright = {b: brightness >= b for b in OVEREXPOSED}
        self.same = {s: none if use is None else ~use for s, use in initial.items()}

    def masked(self, similarity: float, edge: float, bright: int, sky: str, tuning: Tuning) -> np.ndarray:
        """(h, w) bool by one reading, smoothed by blocks as the recipe ends."""
        found = self.edge[edge] | self.blue if sky == "either" else self.edge[edge] & self.blue
        found = found | self.same[similarity] | self.bright[bright]
        own = tuning.papers
        return from_blocks(block_share(found, own.block_px) >= own.min_block, own.block_px, found.shape)


def parts_of(data: MaskSet, tuning: Tuning) -> dict[str, list[Parts]]:
    """Of every fifth frame of each camera."""
    out = {}
    for camera, names in data.cameras.items():
        frames = two_frames([data.folder / n for n in names], tuning.frames)
        assert frames is not None and data.truth is not None
        initial = {s: initial_mask(*frames, s, tuning.papers) if s < 1 else None for s in SIMILARITY}
        out[camera] = [Parts(data.folder / n, _truth(data.truth, n), initial, tuning) for n in names[::EVERY]]
    return out


def _truth(folder: Path, name: str) -> Path:
    return next(p for p in (folder / f"{name}.png", (folder / name).with_suffix(".png")) if p.exists())


def judge(parts: list[Parts], reading: tuple, tuning: Tuning) -> dict[str, float]:
    """Pixels that agree; agreement of the masked shares, image by image; of each class, the share that is wrong."""
    agree, apart, dry, wrong, size = [], [], [], dict.fromkeys(CLASSES, 0), dict.fromkeys(CLASSES, 0)
    for one in parts:
        made, true = one.masked(*reading, tuning), one.classes != _USEFUL
        agree.append(np.mean(made == true))
        without = one.classes != CLASSES["water"]
        dry.append(np.mean((made == true)[without]))
        apart.append(abs(made.mean() - true.mean()))
        for name, label in CLASSES.items():
            mine = one.classes == label
            wrong[name] += int(np.sum(mine & (made != true)))
            size[name] += int(mine.sum())
    errors = {f"{n} wrong": wrong[n] / size[n] for n in CLASSES if size[n]}
    budget = {f"{n} of all": wrong[n] / sum(size.values()) for n in CLASSES if size[n]}
    figures = {"pixels": agree, "pixels but water": dry, "shares": 1 - np.array(apart)}
    return {**{name: float(np.mean(v)) for name, v in figures.items()}, **errors, **budget}


def measure(name: str) -> list[dict[str, Any]]:
    """Rows: the recipe as built, by camera and whole, and the reading that the truth likes best."""
    tuning, settings = Tuning(), MasksSettings()
    built = (settings.similarity, settings.sky_edge, settings.overexposed, "either")
    by_camera = parts_of(load(name), tuning)
    every = [p for parts in by_camera.values() for p in parts]
    rows = [{"set": name, "camera": c, "reading": built, **judge(p, built, tuning)} for c, p in by_camera.items()]
    rows.append({"set": name, "camera": "all", "reading": built, **judge(every, built, tuning)})
    readings = list(itertools.product(SIMILARITY, EDGE, OVEREXPOSED, SKY))
    scored = [(judge(every, r, tuning), r) for r in readings]
    for measure_by in ("pixels", "shares"):
        found, reading = max(scored, key=lambda s: s[0][measure_by])
        rows.append({"set": name, "camera": f"all, best by {measure_by}", "reading": reading, **found})
    return rows


def main() -> int:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", default=["canal", "canal_demo"])
    parser.add_argument("-o", "--out", type=Path, required=True)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows = [row for name in given.sets for row in measure(name)]
    given.out.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    for row in rows:
        shown = {k: round(100 * v, 1) for k, v in row.items() if isinstance(v, float)}
        sys.stdout.write(f"{row['set']} {row['camera']} {row['reading']}: {shown}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
