"""How many matches agree on one geometry by chance: ``python -m benchmarks.sfm.chance RUN RUN ... [--pairs N]``

Pairs of images of different surveys, matched and verified as ``match`` does: whatever agrees does so by chance.
"""

from __future__ import annotations

import argparse
import sys
from itertools import combinations
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.features import nearest
from tiegraph.features.matchblocks import Rules, colmap_options
from tiegraph.features.settings import MatchSettings
from tiegraph.features.tuning import Tuning
from tiegraph.scene.colmapdatabase import Rows

_IMAGES = 5  # of each survey
_LEAST = 4  # matches that a geometry is looked for in
_QUANTILES = (0.5, 0.9, 0.99, 1.0)


def main() -> None:
    """Print the quantiles of the number of matches, and of those that agree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--pairs", type=int, default=300)
    args = parser.parse_args()
    draw = np.random.default_rng(1)
    images = [(run, image) for run in args.runs for image in _images(run, draw)]
    pairs = [(a, b) for (one, a), (other, b) in combinations(images, 2) if one != other]
    chosen = [pairs[k] for k in draw.permutation(len(pairs))[: args.pairs]]
    found = np.array([_by_chance(a, b) for a, b in chosen]).reshape(-1, 2)
    for name, values in zip(("matches", "agree"), found.T):
        shown = ", ".join(f"{100 * q:g} %: {v:.0f}" for q, v in zip(_QUANTILES, np.quantile(values, _QUANTILES)))
        sys.stdout.write(f"{name} of {len(values)} pairs: {shown}\n")


def _images(run: Path, draw: np.random.Generator) -> list[tuple]:
    """Camera, key points and descriptors of some images of a run."""
    with Rows(run / "database.db") as rows:
        cameras = rows.cameras()
        keys = draw.permutation(sorted(cameras))[:_IMAGES].tolist()
        return [(cameras[k], rows.keypoints_of(k), rows.descriptors_of(k)) for k in keys]


def _by_chance(a: tuple, b: tuple) -> tuple[int, int]:
    """Matches of two images, and how many of them agree on a geometry."""
    matching, verification = colmap_options(Rules(MatchSettings(), Tuning().verification))
    verification.min_num_inliers = _LEAST
    pairs = nearest.matches(a[2], b[2], matching.sift)
    if len(pairs) < _LEAST:
        return len(pairs), 0
    geometry = pycolmap.estimate_two_view_geometry(a[0], a[1], b[0], b[1], pairs, verification)
    return len(pairs), len(geometry.inlier_matches)


if __name__ == "__main__":
    main()
