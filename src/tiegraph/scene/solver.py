"""How Ceres solves the linear systems of an adjustment, and on how many threads."""

from collections.abc import Mapping
from typing import Any

import pycolmap

# COLMAP replaces the sparse factorisation by an iterative solver at 1000 images, rig or not. Factorised are
# the frames, and in surveys each sees few others: a corridor of 2000 images in 500 frames took five times the time of
# one of 1000 (benchmarks/sfm/README.md). Above this number the fill-in of loose collections might not fit into memory.
MOST_FRAMES = 10_000
# Ceres adds up the parts of its threads in the order they come (github.com/ceres-solver/ceres-solver/issues/664): with
# two, no run is like another. One thread gives every run and every machine's number of cores the same sums. (Costs
# written in Python would wait for each other anyway: the thread that solves holds the interpreter's lock.)
THREADS = 1
# Of the first step for a model that is nearly right. Ceres' own 1e4 damps what single observations hardly tell and all
# together do: where positions want a long model to lie, and how it bends.
NEAR_RADIUS = 1e7


def options_of(
    iterations: int, tolerance: float | None = None, robust_px: float | None = None, **refine: bool
) -> pycolmap.BundleAdjustmentOptions:
    """Options of an adjustment with reproducible bits: at most ``iterations``, until the cost changes by a relative
    amount less than ``tolerance``, with Cauchy's loss of scale ``robust_px``, if these are given;
    ``refine_...``: parameters adjusted that COLMAP would hold, or the other way round."""
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, **refine)
    if robust_px is not None:
        _change(options, loss_function_type=pycolmap.LossFunctionType.CAUCHY, loss_function_scale=robust_px)
    limits = {} if tolerance is None else {"function_tolerance": tolerance}
    _change(options, {"max_num_iterations": iterations, **limits})
    repeatable(options)
    return options


def _change(options: pycolmap.BundleAdjustmentOptions, solver: Mapping[str, Any] | None = None, **ceres: Any) -> None:
    """Set options of Ceres and of its solver; pycolmap returns copies of them."""
    own = options.ceres
    inner = own.solver_options
    for name, value in (solver or {}).items():
        setattr(inner, name, value)
    own.solver_options = inner
    for name, value in ceres.items():
        setattr(own, name, value)
    options.ceres = own


def all_images(model: pycolmap.Reconstruction) -> pycolmap.BundleAdjustmentConfig:
    """An adjustment of all images that have a pose."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    return config


def factorised(options: pycolmap.BundleAdjustmentOptions, frames: int, images: int) -> None:
    """Make an adjustment of some frames and images use sparse factorisation, unless it is too large, and
    always the same sums."""
    if frames <= MOST_FRAMES:
        most = max(options.ceres.max_num_images_direct_sparse_cpu_solver, images)
        _change(options, max_num_images_direct_sparse_cpu_solver=most)
    repeatable(options)


def repeatable(options: pycolmap.BundleAdjustmentOptions) -> None:
    """Make an adjustment give the same bits each time, and on a machine with a GPU those of one without."""
    _change(options, {"num_threads": THREADS}, use_gpu=False)


def undamped(options: pycolmap.BundleAdjustmentOptions) -> None:
    """Make an adjustment of a model that was adjusted before begin with whole steps: few suffice at any length."""
    _change(options, {"initial_trust_region_radius": NEAR_RADIUS})
