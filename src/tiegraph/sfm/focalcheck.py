"""Focal lengths that ran off while a mapper started from nothing.

A short base line and a narrow field of view leave focal length and depth exchangeable (the bas-relief ambiguity), and
the incremental mapper adjusts both with its first two images. Forty frames of a hand-held camera of 585 px came out at
1210 px that way: every image had its place, and the centres were 43 mm off instead of 17; from these poses no
adjustment comes back, nor with the focal length held. A given one, of a data sheet or of EXIF, is nearer than that as a
rule, but not always (a video is cropped): so the other mapper is asked too, both models are adjusted to their end, and
the one that explains the images better stays.
"""

from __future__ import annotations

from collections.abc import Collection

import pycolmap

from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment, robust_cost
from tiegraph.sfm.tuning import AdjustTuning


def ran_off(model: pycolmap.Reconstruction, scene: Scene, most: float) -> str | None:
    """A word on the first camera whose focal length is more than ``most`` times longer or shorter than the one given;
    None: there is none."""
    for key, sensor in enumerate(scene.all_sensors, start=1):
        given = sensor.camera
        if given is None or not given.has_prior_focal_length or key not in model.cameras:
            continue
        found_px, given_px = model.cameras[key].mean_focal_length(), given.mean_focal_length()
        if not 1 / most < found_px / given_px < most:
            return f"the focal length of {sensor.name} {found_px:.0f} px, {given_px:.0f} px are given"
    return None


def cost_in_the_end(
    model: pycolmap.Reconstruction, fixed_rigs: Collection[int], constant_cameras: Collection[int], tuning: AdjustTuning
) -> float:
    """Mean Cauchy cost of an observation after the final adjustment, px2."""
    adjusted = final_adjustment(model, fixed_rigs, constant_cameras, tuning=tuning).model
    return robust_cost(adjusted, tuning.robust_px)
