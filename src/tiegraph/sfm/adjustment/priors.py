"""All that is known or expected beside the images, added to the problem of an adjustment."""

from collections.abc import Mapping
from typing import Any

import pycolmap

from tiegraph.sfm.adjustment import lens, leverarmprior
from tiegraph.sfm.adjustment.constraints import PoseConstraints, add_constraints
from tiegraph.sfm.tuning import AdjustTuning


def add_priors(
    adjuster: Any,
    model: pycolmap.Reconstruction,
    soft: PoseConstraints | None,
    tuning: AdjustTuning,
    given: Mapping[int, pycolmap.Camera] | None = None,
) -> list[Any]:
    """What a rig file gives with a sigma, what lenses look like, what a rig lets expect; keep it until it has solved.

    ``given``: as of ``lens.add_priors``.
    """
    soft = PoseConstraints() if soft is None else soft
    kept = add_constraints(adjuster, model, soft, tuning.robust_px)
    kept += lens.add_priors(adjuster.problem, model, given or {}, tuning)
    return kept + leverarmprior.add_priors(adjuster.problem, model, soft.known_sensors(), soft.nominal, tuning)
