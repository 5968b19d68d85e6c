"""All that is known or expected beside the images, added to the problem of an adjustment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pycolmap

from tiegraph.sfm import lens
from tiegraph.sfm.rig import compact
from tiegraph.sfm.rig.soft import Soft, add_soft


def add_priors(
    adjuster: Any, model: pycolmap.Reconstruction, soft: Soft | None, given: Mapping[int, pycolmap.Camera] | None = None
) -> list[Any]:
    """What a rig file gives with a sigma, what lenses look like, what a rig lets expect; keep it until it has solved.

    ``given``: as of ``lens.add_priors``.
    """
    kept = add_soft(adjuster, model, soft) if soft else []
    kept += lens.add_priors(adjuster.problem, model, given or {})
    known, drawings = (soft.known_sensors(), soft.drawings) if soft is not None else ((), {})
    return kept + compact.add_priors(adjuster.problem, model, known, drawings)
