"""Metres per model unit from the rig's baselines, if they are known and long enough."""

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix, sensor_id
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import ScaleTuning

RIG, BARS = "rig as given", "scale bars"


@dataclass(frozen=True)
class RigScale:
    """Scale from known lengths, those of the rig or of scale bars, its relative sigma, and whether it is reliable."""

    metres_per_unit: float
    sigma: float
    trusted: bool
    why_not: str = ""
    source: str = RIG

    @property
    def name(self) -> str:
        """The source of the scale in world.json."""
        return "rig baseline" if self.source == RIG else self.source


def rig_scale(
    model: pycolmap.Reconstruction,
    cam_from_world: np.ndarray,
    scene: Scene,
    tuning: ScaleTuning,
    inside: float = float("nan"),
) -> RigScale | None:
    """Median ratio of given to mapped baselines over all frames; None without a rig of given lengths.

    The sigma includes the baseline's own (2 mm, or that of the rig file), a rotation error of 0.01 deg at the model's
    median depth, and ``inside``: the accuracy with which the images transfer the baselines to the length of the whole
    (relative sigma of the adjustment, NaN = unknown). Reliability is judged from the file alone, and nominal rigs are
    not reliable.
    """
    ratios, lengths, sigmas, given = [], [], [], True
    by_frame: dict[int, list[int]] = {}
    for k in np.flatnonzero(np.isfinite(cam_from_world).all(axis=(1, 2))):
        by_frame.setdefault(int(scene.frame[k]), []).append(int(k))
    for frame, members in by_frame.items():
        rig = scene.rigs[scene.rig[frame]]
        given &= not rig.nominal
        for n, a in enumerate(members):
            for b in members[n + 1 :]:
                length, mapped = _baseline(model, cam_from_world, scene, (a, b))
                if np.isfinite(length) and length > 0 and mapped > 0:
                    ratios.append(length / mapped)
                    lengths.append(length)
                    sigmas.append(_stated(scene, a, b, tuning.baseline_sigma_m))
    if not ratios:
        return None
    longest = np.array(lengths) > tuning.long_share * max(lengths)
    scale = float(np.median(np.array(ratios)[longest]))
    length = float(np.max(lengths))
    stated = float(np.median(np.array(sigmas)[longest]))
    depth = scale * _median_depth(model, tuning.depth_points)
    sigma = float(np.hypot(stated, tuning.angle_sigma_rad * depth)) / length
    why = ""
    if not given:
        why = "its extrinsics are nominal"
    elif sigma > tuning.max_sigma:
        why = f"a baseline of {length:.3f} m at a distance of {depth:.0f} m gives the scale only to {sigma:.1%}"
    return RigScale(
        metres_per_unit=scale, sigma=float(np.hypot(sigma, np.nan_to_num(inside))), trusted=not why, why_not=why
    )


def _baseline(
    model: pycolmap.Reconstruction, poses: np.ndarray, scene: Scene, pair: tuple[int, int]
) -> tuple[float, float]:
    """Distance of two images of a frame as given (m) and in the model. In the model it is that of its rig, because
    cameras that fire at different times are elsewhere; without a rig, that of the images (N, 4, 4)."""
    given, mapped = [], []
    key = int(scene.rig[scene.frame[pair[0]]]) + 1
    rig = model.rigs[key] if key in model.rigs else None
    for image in pair:
        pose = scene.sensor_of(image).sensor_from_rig
        if pose is None:
            return float("nan"), 0.0
        given.append(transforms.centre(pose))
        identity = sensor_id(int(scene.sensor_key[image]) + 1)
        if rig is not None and rig.is_ref_sensor(identity):
            mapped.append(np.zeros(3))
        elif rig is not None and (own := rig.non_ref_sensors.get(identity)) is not None:
            mapped.append(transforms.centre(matrix(own)))
    there = mapped if len(mapped) == 2 else [transforms.centre(poses[k]) for k in pair]
    return float(np.linalg.norm(given[1] - given[0])), float(np.linalg.norm(there[1] - there[0]))


def _stated(scene: Scene, a: int, b: int, unknown_m: float) -> float:
    """Sigma (m) of the distance of two cameras of a rig: from the sigmas of their places in its file, else
    ``unknown_m``."""
    given = [s for s in (scene.sensor_of(a).sigma_m, scene.sensor_of(b).sigma_m) if s is not None]
    return float(np.linalg.norm(given)) if given else unknown_m


def _median_depth(model: pycolmap.Reconstruction, most: int) -> float:
    """Median distance of points from the first camera that sees them, model units."""
    ids = sorted(model.point3D_ids())
    ids = ids[:: max(1, len(ids) // most)]
    depths = []
    for point_id in ids:
        point = model.point3D(point_id)
        image = model.image(point.track.elements[0].image_id)
        depths.append(float(np.linalg.norm(point.xyz - image.projection_center())))
    return float(np.median(depths)) if depths else 0.0
