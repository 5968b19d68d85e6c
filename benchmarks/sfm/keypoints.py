"""Which key points are found again: inliers of neighbouring images by how they are searched and chosen, beside COLMAP.

``python -m benchmarks.sfm.keypoints FOLDER... --steps 1 3``: of each folder pairs of images that are so many places
apart. A rule is "search,power,number,edges": ``doubled`` or ``own`` (the image's own resolution), kept by response
times scale to this power, so many, with this edge threshold. COLMAP: its own extractor with 8192.
All are matched and verified by our ``match``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.features import nearest
from tiegraph.features.matchblocks import Rules, colmap_options
from tiegraph.features.sift import read_gray, root_sift, shrunk
from tiegraph.scene.images import find_images

_RULES = (
    "doubled,0,4096,10", "doubled,1,4096,10", "own,1,4096,10", "own,1,8192,10", "own,1,12288,10", "own,2,12288,10",
    "own,1,12288,15",
)  # fmt: skip
_LONGER_SIDE, _CONTRAST = 3200, 0.02
Features = tuple[np.ndarray, np.ndarray]
Extractor = Callable[[np.ndarray], Features]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--steps", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--most", type=int, default=8, help="first images of pairs, spread over the folder")
    parser.add_argument("--rules", nargs="+", default=_RULES)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    pycolmap.logging.minloglevel = 2
    for folder in args.folders:
        images = [folder / name for name in find_images(folder)]
        first = range(0, len(images), max(len(images) // args.most, 1))
        pairs = [(images[k], images[k + s]) for k in first for s in args.steps if k + s < len(images)]
        theirs, row = _inliers(pairs, _colmap)
        sys.stdout.write(f"{folder}: {len(pairs)} pairs\n  {'COLMAP, 8192':16} {row}\n")
        for rule in args.rules:
            search, power, number, edges = rule.split(",")
            ours, row = _inliers(pairs, _ours(search == "own", float(power), int(number), float(edges)))
            seen = (ours > 0) | (theirs > 0)
            ratio = np.median((ours[seen] + 1) / (theirs[seen] + 1))
            as_many = f"{int((ours >= theirs)[seen].sum())} of {int(seen.sum())}"
            sys.stdout.write(f"  {rule:16} {row}, median ratio {ratio:.2f}, as many in {as_many}\n")
            sys.stdout.flush()


def _inliers(pairs: list[tuple[Path, Path]], extract: Extractor) -> tuple[np.ndarray, str]:
    """(P,) verified matches of each pair, and a line about them all."""
    rules = Rules()
    matching, verification = colmap_options(rules)
    found: dict[Path, tuple[pycolmap.Camera, np.ndarray, np.ndarray]] = {}
    seconds, counts = [], []
    for path in dict.fromkeys(p for pair in pairs for p in pair):
        gray, start = read_gray(path), time.process_time()
        xy, descriptors = extract(gray)
        seconds.append(time.process_time() - start)
        height, width = gray.shape
        params = [1.2 * max(width, height), width / 2, height / 2]
        camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=params)
        found[path] = camera, xy, descriptors
    for one, other in pairs:
        (a, xy_a, of_a), (b, xy_b, of_b) = found[one], found[other]
        matches = nearest.matches(of_a, of_b, matching.sift)
        geometry = pycolmap.TwoViewGeometry()
        if len(matches) >= rules.settings.min_inliers:
            geometry = pycolmap.estimate_two_view_geometry(a, xy_a, b, xy_b, matches, verification)
        counts.append(len(geometry.inlier_matches))
    sizes = int(np.median([len(xy) for _, xy, _ in found.values()]))
    verified = int(np.count_nonzero(counts))
    line = f"{sum(counts):7} inliers, {verified} verified, {sizes} features, {np.median(seconds):.2f} CPU s an image"
    return np.array(counts), line


def _colmap(gray: np.ndarray) -> Features:
    small = shrunk(gray, _LONGER_SIDE)
    options = pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False)
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    points, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(small))
    xy = np.array([[p.x, p.y] for p in points]).reshape(-1, 2) * (gray.shape[1] / small.shape[1])
    return xy, np.asarray(descriptors.data, np.uint8).reshape(-1, 128)


def _ours(own: bool, power: float, number: int, edges: float) -> Extractor:
    def extract(gray: np.ndarray) -> Features:
        small = shrunk(gray, _LONGER_SIDE)
        small = shrunk(small, max(small.shape) // 2) if own else small
        contrast = _CONTRAST / (1 + own)
        sift = cv2.SIFT.create(contrastThreshold=contrast, edgeThreshold=edges, enable_precise_upscale=True)
        points = sorted(sift.detect(small, None), key=lambda p: -p.response * p.size**power)[:number]
        points, descriptors = sift.compute(small, points)
        scale = gray.shape[1] / small.shape[1], gray.shape[0] / small.shape[0]
        return (np.array([p.pt for p in points]) + 0.5) * scale, root_sift(descriptors)

    return extract


if __name__ == "__main__":
    main()
