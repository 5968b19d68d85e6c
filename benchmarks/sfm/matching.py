"""What matching a pair costs, and what it finds: ours beside COLMAP's, on the pairs of finished runs.

``python -m benchmarks.sfm.matching RUN... --pairs 150``: milliseconds of CPU of a pair, matches and inliers in all. The
search by ``features.nearest`` and by NumPy; COLMAP's index (its default) with its verification; our verification, that
with COLMAP's number of trials, and that with another seed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.features import nearest
from tiegraph.features.matchblocks import Rules, colmap_options
from tiegraph.scene.colmapdatabase import Rows, copy_features

COLMAPS_TRIALS = {"min_num_trials": 100, "min_inlier_ratio": 0.25}
_ALIAS = "image:"


@dataclass(frozen=True)
class Sample:
    """Pairs of a run (P, 2) as image ids of its database, with the features of all their images."""

    database: Path
    pairs: np.ndarray
    cameras: dict[int, pycolmap.Camera]
    points: dict[int, np.ndarray]
    descriptors: dict[int, np.ndarray]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="run folders whose match is done")
    parser.add_argument("--pairs", type=int, default=150)
    args = parser.parse_args()
    pycolmap.logging.minloglevel = 2
    for run in args.runs:
        sample = _sample(run / "database.db", args.pairs)
        sys.stdout.write(f"{run}: {len(sample.pairs)} pairs\n")
        _searches(sample)
        _colmap(sample)
        _verifications(sample)


def _sample(database: Path, count: int) -> Sample:
    with Rows(database) as rows:
        pairs = rows.inlier_counts("matches")[:, :2]
        chosen = np.random.default_rng(0).choice(len(pairs), min(count, len(pairs)), replace=False)
        pairs = pairs[np.sort(chosen)]
        images = np.unique(pairs).tolist()
        points = {k: rows.keypoints_of(k) for k in images}
        return Sample(database, pairs, rows.cameras(), points, {k: rows.descriptors_of(k) for k in images})


def _searches(sample: Sample) -> None:
    options = colmap_options(Rules())[0].sift
    native, numpy = nearest.search, nearest._searched
    for name, search in (("nearest", native), ("nearest by NumPy", numpy)):
        nearest.search = search
        began = time.process_time()
        found = sum(
            len(nearest.matches(sample.descriptors[a], sample.descriptors[b], options)) for a, b in sample.pairs
        )
        _say(sample, name, time.process_time() - began, f"{found} matches")
    nearest.search = native


def _colmap(sample: Sample) -> None:
    """COLMAP's matcher with its index and its trials, on one thread."""
    matching, verification = _options(**COLMAPS_TRIALS)
    with tempfile.TemporaryDirectory() as folder:
        target, listed = Path(folder) / "pairs.db", Path(folder) / "pairs.txt"
        copy_features(sample.database, target, np.unique(sample.pairs) - 1, _ALIAS)
        listed.write_text("".join(f"{_ALIAS}{a} {_ALIAS}{b}\n" for a, b in sample.pairs))
        pairing = pycolmap.ImportedPairingOptions(match_list_path=listed, block_size=len(sample.pairs))
        began = time.process_time()
        pycolmap.match_image_pairs(target, matching, pairing, verification, device=pycolmap.Device.cpu)
        spent = time.process_time() - began
        with Rows(target) as rows:
            found, inliers = rows.inlier_counts("matches")[:, 2].sum(), rows.inlier_counts()[:, 2].sum()
        _say(sample, "COLMAP's index and verification", spent, f"{found} matches, {inliers} inliers")


def _verifications(sample: Sample) -> None:
    """Of the pairs that have matches enough."""
    matching, _ = _options()
    least, first = Rules().settings.min_inliers, None
    found = [nearest.matches(sample.descriptors[a], sample.descriptors[b], matching.sift) for a, b in sample.pairs]
    for name, changed in (("as COLMAP", COLMAPS_TRIALS), ("ours", {}), ("ours, another seed", {"random_seed": 1})):
        verification = _options(**changed)[1]
        began = time.process_time()
        inliers = np.array([
            len(pycolmap.estimate_two_view_geometry(
                sample.cameras[a], sample.points[a], sample.cameras[b], sample.points[b], pairs, verification
            ).inlier_matches) if len(pairs) >= least else 0
            for (a, b), pairs in zip(sample.pairs.tolist(), found)
        ])  # fmt: skip
        spent, verified = time.process_time() - began, inliers >= least
        first = verified if first is None else first
        told = f"{inliers.sum()} inliers, {verified.sum()} verified"
        told += f" ({np.sum(first & ~verified)} lost, {np.sum(verified & ~first)} won)"
        _say(sample, f"verification, {name}", spent, told)


def _options(**ransac: float) -> tuple[pycolmap.FeatureMatchingOptions, pycolmap.TwoViewGeometryOptions]:
    matching, verification = colmap_options(Rules())
    for name, value in ransac.items():
        setattr(verification.ransac, name, value)
    return matching, verification


def _say(sample: Sample, name: str, seconds: float, text: str) -> None:
    sys.stdout.write(f"  {name}: {1000 * seconds / len(sample.pairs):.1f} ms a pair, {text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
