"""Metres per model unit by the rig's baselines, where they are known and long enough to tell."""

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import registered_images
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import ScaleTuning

RIG, BARS = "rig as given", "scale bars"


@dataclass(frozen=True)
class RigScale:
    """Scale by known lengths, those of the rig or of scale bars, its relative sigma, and whether to believe it."""

    metres_per_unit: float
    sigma: float
    trusted: bool
    why_not: str = ""
    source: str = RIG

    @property
    def name(self) -> str:
        """What holds the scale, in world.json."""
        return "rig baseline" if self.source == RIG else self.source


def rig_scale(
    model: pycolmap.Reconstruction,
    cam_from_world: np.ndarray,
    scene: Scene,
    tuning: ScaleTuning,
    inside: float = float("nan"),
) -> RigScale | None:
    """Median ratio of given to mapped baselines over all frames; None without a rig of given lengths.

    The sigma adds the baseline's own (2 mm, or what the rig file gives), a rotation error of 0.01 deg at the model's
    median depth, and ``inside``: how well the images carry the baselines to the length of the whole (relative sigma of
    the adjustment, NaN = not known). Whether the rig is believed is asked of the file alone, and nominal rigs are not.
    Of a relaxed rig, whose cameras fire apart, only what lies across the motion counts: along it an offset in time is
    one in place, at constant speed.
    """
    ratios, lengths, sigmas, given = [], [], [], True
    apart = relaxed(model, scene)
    ways = _ways(cam_from_world, scene) if apart else None
    by_frame: dict[int, list[int]] = {}
    for k in np.flatnonzero(np.isfinite(cam_from_world).all(axis=(1, 2))):
        by_frame.setdefault(int(scene.frame[k]), []).append(int(k))
    for frame, members in by_frame.items():
        rig = scene.rigs[scene.rig[frame]]
        given &= not rig.nominal
        for n, a in enumerate(members):
            for b in members[n + 1 :]:
                length, mapped = _baseline(cam_from_world, scene, (a, b), None if ways is None else ways[frame])
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
        why = f"a baseline of {length:.3f} m at {depth:.0f} m gives a scale to {sigma:.1%} only"
    return RigScale(
        metres_per_unit=scale, sigma=float(np.hypot(sigma, np.nan_to_num(inside))), trusted=not why, why_not=why
    )


def relaxed(model: pycolmap.Reconstruction, scene: Scene) -> bool:
    """Whether images of one frame of the scene stand in several frames of the model."""
    home: dict[int, int] = {}
    for index, image in registered_images(model, scene):
        if home.setdefault(int(scene.frame[index]), image.frame_id) != image.frame_id:
            return True
    return False


def _baseline(poses: np.ndarray, scene: Scene, pair: tuple[int, int], way: np.ndarray | None) -> tuple[float, float]:
    """Distance of two images of a frame as given (m) and in the model; with a unit ``way`` (3,) only across it."""
    a, b = pair
    first, second = scene.sensor_of(a).sensor_from_rig, scene.sensor_of(b).sensor_from_rig
    if first is None or second is None:
        return float("nan"), 0.0
    given = transforms.centre(second) - transforms.centre(first)
    mapped = transforms.centre(poses[b]) - transforms.centre(poses[a])
    if way is not None:
        turn = first[:3, :3].T @ poses[a, :3, :3]  # rig from model
        given = given - (given @ (turn @ way)) * (turn @ way)
        mapped = mapped - (mapped @ way) * way
    return float(np.linalg.norm(given)), float(np.linalg.norm(mapped))


def _ways(poses: np.ndarray, scene: Scene) -> np.ndarray:
    """(F, 3) unit directions of the motion at the frames, in the model; zero where nothing moves or none is known."""
    centres = transforms.centre(poses)
    place = np.full((scene.frames, 3), np.nan)
    for k in np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))[::-1]:
        place[scene.frame[k]] = centres[k]  # of the first camera of the frame that is there
    out = np.zeros((scene.frames, 3))
    for track in np.unique(scene.sequence):
        rows = np.flatnonzero((scene.sequence == track) & np.isfinite(place).all(axis=1))
        rows = rows[np.argsort(scene.sequence_index[rows], kind="stable")]
        if len(rows) > 1:
            way = np.gradient(place[rows], axis=0)
            out[rows] = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    return out


def _stated(scene: Scene, a: int, b: int, unknown_m: float) -> float:
    """Sigma (m) of the distance of two cameras of a rig: what its file gives of their places, else ``unknown_m``."""
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
