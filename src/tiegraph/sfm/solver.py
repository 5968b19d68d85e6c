"""How Ceres solves the linear systems of an adjustment."""

from __future__ import annotations

import pycolmap

# COLMAP leaves the sparse factorisation for an iterative solver at 1000 images, rig or not. What is factorised are the
# frames, and in surveys each sees few others: a corridor of 2000 images in 500 frames took five times the time of one
# of 1000 (benchmarks/sfm/README.md). Above so many frames the fill-in of loose collections might not fit into memory.
MOST_FRAMES = 10_000


def factorised(options: pycolmap.BundleAdjustmentOptions, frames: int, images: int) -> None:
    """Let an adjustment of so many frames and images be solved by sparse factorisation, unless it is too large."""
    if frames <= MOST_FRAMES:
        ceres = options.ceres
        ceres.max_num_images_direct_sparse_cpu_solver = max(ceres.max_num_images_direct_sparse_cpu_solver, images)
        options.ceres = ceres
