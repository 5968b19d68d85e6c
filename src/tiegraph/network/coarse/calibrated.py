"""Rigs and cameras as the coarse model found them: what was only guessed is replaced, what was measured stays."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.tuning.coarse import CoarseTuning
from tiegraph.scene.rig import Rig, calibrated, camera_from_dict, camera_to_dict
from tiegraph.scene.scene import Scene


def turned_deg(given: Sequence[Rig], found: Sequence[Rig]) -> np.ndarray:
    """(S,) by how much the model turns each nominal mounting, 0 for those that are not nominal or not known."""
    out = []
    for old, new in zip(given, found):
        for a, b in zip(old.sensors, new.sensors):
            known = old.nominal and a.sensor_from_rig is not None and b.sensor_from_rig is not None
            poses = np.stack(
                [np.eye(4) if not known or p is None else p for p in (a.sensor_from_rig, b.sensor_from_rig)]
            )
            out.append(float(transforms.angle_deg(*poses[:, :3, :3])))
    return np.array(out)


def calibrated_scene(
    scene: Scene, model: CoarseModel, loose: np.ndarray, tuning: CoarseTuning
) -> tuple[Scene, tuple[str, ...]]:
    """The scene with the rigs as the model found them, where it holds enough of the images; what to say of them."""
    if model.placed().sum() < tuning.calibrates * len(scene):
        return scene, ()
    rigs, moved = calibrated_rigs(scene.rigs, model.rigs, tuning.most_focal, loose)
    return scene.with_(rigs=rigs), moved


def calibrated_rigs(
    given: Sequence[Rig], found: Sequence[Rig], most_focal: float, loose: np.ndarray | None = None
) -> tuple[tuple[Rig, ...], tuple[str, ...]]:
    """Rigs with what was only guessed replaced by what the model found: cameras that were not calibrated, and of a
    nominal rig the rotations (its centres nearly coincide: the model's lever arms have no scale to be told by).
    ``most_focal``: by which factor a focal length of a data sheet may be corrected. Sensors that are ``loose`` (S,) in
    the model stay as given."""
    rigs, notes = [], []
    held = iter(np.zeros(sum(len(r.sensors) for r in given), bool) if loose is None else loose)
    for old, new in zip(given, found):
        sensors = []
        turned = []
        for a, b in zip(old.sensors, new.sensors):
            if next(held):
                sensors.append(a)
                continue
            camera = _better_camera(a.camera, b.camera, old.fixed, most_focal)
            extrinsics = a.sensor_from_rig
            if old.nominal and extrinsics is not None and b.sensor_from_rig is not None:
                centre = transforms.centre(extrinsics)
                rotation = b.sensor_from_rig[:3, :3]
                turned.append(transforms.angle_deg(extrinsics[:3, :3], rotation))
                extrinsics = transforms.rigid(rotation, -rotation @ centre)
            elif extrinsics is None:
                extrinsics = b.sensor_from_rig
            sensors.append(replace(a, camera=camera, sensor_from_rig=extrinsics))
        guessed = old.nominal or not old.known()
        rigs.append(replace(old, sensors=tuple(sensors), nominal=guessed))
        if turned:
            notes.append(f"rig {old.name}: its cameras turned by up to {max(turned):.2f} deg from nominal")
    return tuple(rigs), tuple(notes)


def _better_camera(
    given: pycolmap.Camera | None, found: pycolmap.Camera | None, fixed: bool, most_focal: float
) -> pycolmap.Camera | None:
    """The camera to go on with. A focal length of a data sheet or of EXIF is right to some per cent and says nothing of
    principal point and distortion; at the side of an image that is more than the degree ``filter`` allows."""
    if given is None or found is None:
        return given
    if not given.has_prior_focal_length:
        return found
    change = found.mean_focal_length() / given.mean_focal_length()
    if fixed or calibrated(given) or not 1 / most_focal < change < most_focal:
        return given
    # It was not calibrated: what follows may go on adjusting it.
    return camera_from_dict({**(camera_to_dict(found) or {}), "prior_focal": False})
