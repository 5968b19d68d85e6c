"""Metres per model unit by the rig's baselines, where they are known and long enough to tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.scene import Scene

# ALGORITHMS section 4: with 6 cm at 15 m a 2 mm error of the baseline is 3.3 % of scale; never take scale from that.
BASELINE_SIGMA_M = 0.002
ANGLE_SIGMA = 0.00017  # 0.01 deg: what is left of the extrinsic rotation; it acts like a parallax
MAX_SIGMA = 0.015  # of the scale, to be trusted
_MAX_DEPTHS = 20_000


@dataclass(frozen=True)
class RigScale:
    """Scale by the rig, its relative sigma, and whether to believe it."""

    metres_per_unit: float
    sigma: float
    trusted: bool
    why_not: str = ""


def rig_scale(model: pycolmap.Reconstruction, cam_from_world: np.ndarray, scene: Scene) -> RigScale | None:
    """Median ratio of given to mapped baselines over all frames; None without a rig of given lengths.

    The sigma adds the baseline's own (2 mm) and a rotation error of 0.01 deg at the model's median depth. Nominal rigs
    are not believed.
    """
    centres = transforms.centre(cam_from_world)
    ratios, lengths, given = [], [], True
    by_frame: dict[int, list[int]] = {}
    for k in np.flatnonzero(np.isfinite(cam_from_world).all(axis=(1, 2))):
        by_frame.setdefault(int(scene.frame[k]), []).append(int(k))
    for frame, members in by_frame.items():
        rig = scene.rigs[scene.rig[frame]]
        baselines = rig.baselines_m()
        given &= not rig.nominal
        for n, a in enumerate(members):
            for b in members[n + 1 :]:
                length = float(baselines[scene.sensor[a], scene.sensor[b]])
                mapped = float(np.linalg.norm(centres[a] - centres[b]))
                if np.isfinite(length) and length > 0 and mapped > 0:
                    ratios.append(length / mapped)
                    lengths.append(length)
    if not ratios:
        return None
    longest = np.array(lengths) > 0.7 * max(lengths)
    scale = float(np.median(np.array(ratios)[longest]))
    length = float(np.max(lengths))
    depth = scale * _median_depth(model)
    sigma = float(np.hypot(BASELINE_SIGMA_M, ANGLE_SIGMA * depth)) / length
    why = ""
    if not given:
        why = "its extrinsics are nominal"
    elif sigma > MAX_SIGMA:
        why = f"a baseline of {length:.3f} m at {depth:.0f} m gives a scale to {sigma:.1%} only"
    return RigScale(scale, sigma, not why, why)


def _median_depth(model: pycolmap.Reconstruction) -> float:
    """Median distance of points from the first camera that sees them, model units."""
    ids = sorted(model.point3D_ids())
    ids = ids[:: max(1, len(ids) // _MAX_DEPTHS)]
    depths = []
    for point_id in ids:
        point = model.point3D(point_id)
        image = model.image(point.track.elements[0].image_id)
        depths.append(float(np.linalg.norm(point.xyz - image.projection_center())))
    return float(np.median(depths)) if depths else 0.0
