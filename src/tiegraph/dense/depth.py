"""The two steps of a depth map, each for one image in one worker: match with partners, then compare with neighbours."""

from __future__ import annotations

from pathlib import Path

import cv2

from tiegraph.dense.consistency import Consistency, LoadDepth, check
from tiegraph.dense.engine import ENGINES, installed
from tiegraph.dense.normals import with_normals
from tiegraph.dense.plan import ImagePlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view
from tiegraph.errors import choose
from tiegraph.scene.results import DepthMap


def depth_map(
    plan: ImagePlan, images: Path, masks: Path | None, settings: DenseSettings, tuning: Tuning, threads: int = 1
) -> DepthMap:
    """First step: match one image with its partners. ``masks`` None = use all pixels.

    ``threads`` limits OpenCV in this process. Raises InputError for an image that cannot be read.
    """
    cv2.setNumThreads(threads)
    engine = choose("dense engine", installed(settings.engine)[0], ENGINES)
    reference = load_view(plan.view, images, masks, settings, tuning.views)
    partners = [load_view(view, images, masks, settings, tuning.views) for view in plan.partners]
    return engine(reference, partners, plan.depth_range, settings, tuning)  # type: ignore[operator]


def confirmed_map(
    plan: ImagePlan, depth: DepthMap, load: LoadDepth, settings: DenseSettings, tuning: Tuning
) -> tuple[DepthMap, Consistency]:
    """Second step, when all first steps are done: compare with the witnesses' first maps (``load`` by name), then fit
    normals."""
    partners = [view.name for view in plan.partners]
    confirmed, counts = check(depth, partners, plan.witnesses, load, settings, tuning.rays)
    return with_normals(confirmed, tuning.normals), counts
