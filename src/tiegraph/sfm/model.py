"""Reading a COLMAP model back into the scene's frames, images and sensors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.registered import BY_RIG, Registration
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import FixTuning


def matrix(transform: pycolmap.Rigid3d) -> np.ndarray:
    """(4, 4) of a COLMAP rigid transform."""
    return np.vstack([transform.matrix(), [0.0, 0.0, 0.0, 1.0]])


def rigid3d(target_from_source: np.ndarray) -> pycolmap.Rigid3d:
    """COLMAP rigid transform of (4, 4)."""
    rotation = pycolmap.Rotation3d(transforms.quaternion_xyzw(target_from_source[:3, :3]))
    return pycolmap.Rigid3d(rotation, np.asarray(target_from_source[:3, 3], float))


def image_poses(reconstruction: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """cam_from_world (N, 4, 4) of the scene's images, model units; NaN = not registered. Images go by name."""
    poses = np.full((len(scene), 4, 4), np.nan)
    for image_id in reconstruction.reg_image_ids():
        image = reconstruction.image(image_id)
        index = scene.image_index.get(image.name)
        if index is not None:
            poses[index] = matrix(image.cam_from_world())
    return poses


def observations(reconstruction: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """(N,) i8: model points that each image of the scene sees. Of a finished model ask ``scene.registered``."""
    counts = np.zeros(len(scene), int)
    for image_id in reconstruction.reg_image_ids():
        image = reconstruction.image(image_id)
        index = scene.image_index.get(image.name)
        if index is not None:
            counts[index] = image.num_points3D
    return counts


def tracks(reconstruction: pycolmap.Reconstruction, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (P, 3), model units, and who sees them: image (M,) scene index, point (M,) row."""
    ids = list(reconstruction.points3D)
    xyz = np.array([reconstruction.points3D[k].xyz for k in ids]).reshape(-1, 3)
    row = {k: n for n, k in enumerate(ids)}
    seen: list[tuple[int, int]] = []
    for image_id in reconstruction.reg_image_ids():
        image = reconstruction.image(image_id)
        index = scene.image_index.get(image.name)
        if index is not None:
            seen += [(index, row[p.point3D_id]) for p in image.get_observation_points2D()]
    both = np.array(seen, int).reshape(-1, 2)
    return xyz, both[:, 0], both[:, 1]


def model_rigs(reconstruction: pycolmap.Reconstruction, scene: Scene) -> tuple[Rig, ...]:
    """The scene's rigs with the cameras and extrinsics of a model (its units); what it does not hold stays as given."""
    out, key = [], 0
    for index, rig in enumerate(scene.rigs):
        sensors = [
            replace(s, camera=_get(reconstruction.cameras, key + 1 + k, s.camera)) for k, s in enumerate(rig.sensors)
        ]
        held = _get(reconstruction.rigs, index + 1, None)
        ids = [pycolmap.sensor_t(pycolmap.SensorType.CAMERA, key + 1 + k) for k in range(len(sensors))]
        if held is not None and held.is_ref_sensor(ids[0]):
            for k in range(1, len(sensors)):
                if held.has_sensor_from_rig(ids[k]):
                    sensors[k] = replace(sensors[k], sensor_from_rig=matrix(held.sensor_from_rig(ids[k])))
        out.append(replace(rig, sensors=tuple(sensors)))
        key += len(sensors)
    return tuple(out)


def _get(table: Any, key: int, otherwise: Any) -> Any:
    return table[key] if key in table else otherwise


def rig_from_sensor(scene: Scene, scale: float = 1.0) -> np.ndarray:
    """(N, 4, 4) of each image by the scene's extrinsics, lengths times ``scale``; NaN = unknown."""
    out = np.full((len(scene), 4, 4), np.nan)
    for k in range(len(scene)):
        extrinsics = scene.sensor_of(k).sensor_from_rig
        if extrinsics is None and scene.sensor[k] == 0:
            extrinsics = np.eye(4)
        if extrinsics is not None:
            out[k] = transforms.invert(extrinsics)
    out[:, :3, 3] *= scale
    return out


def frame_poses(cam_from_world: np.ndarray, scene: Scene, metres_per_unit: float = 1.0) -> np.ndarray:
    """world_from_rig (F, 4, 4) of the scene's frames, model units; NaN = not registered.

    The reference sensor's image gives the pose; where it is not registered, the first registered image with known
    extrinsics does (``metres_per_unit`` of the model brings the rig's lengths to model units).
    """
    rig_from_cam = rig_from_sensor(scene, 1.0 / metres_per_unit)
    usable = np.isfinite(cam_from_world).all(axis=(1, 2)) & np.isfinite(rig_from_cam).all(axis=(1, 2))
    poses = np.full((scene.frames, 4, 4), np.nan)
    order = np.flatnonzero(usable)
    order = order[np.argsort(-scene.sensor[order].astype(int), kind="stable")]  # the reference is written last
    for k in order:
        poses[scene.frame[k]] = transforms.invert(rig_from_cam[k] @ cam_from_world[k])
    return poses


def held_out_frames(scene: Scene, tuning: FixTuning) -> np.ndarray:
    """(F,) bool: every fifth frame with a prior position, in the order of the passes; none when there are few.

    These positions take part in the final alignment only, neither in the mapping nor in the fit they are checked with.
    """
    out = np.zeros(scene.frames, bool)
    has = np.flatnonzero(np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1))
    if len(has) < tuning.least_to_hold_out:
        return out
    order = has[np.lexsort((scene.step[has], scene.track[has]))]
    out[order[tuning.held_out_every // 2 :: tuning.held_out_every]] = True
    return out


def registration_tables(scene: Scene, found: Registration) -> dict[str, dict]:
    """Tables of images, registered images and images that only their rig places, per camera, pass and section."""
    labels = scene.image_label()
    sections = scene.section[scene.frame]
    groups = {
        "camera": [camera for _, camera in labels],
        "pass": [track for track, _ in labels],
        "section": [str(s) if s >= 0 else "" for s in sections],
    }
    tables = {}
    for name, values in groups.items():
        column = np.array(values)
        rows = []
        for value in sorted(set(values)):
            of = column == value
            rows.append([value or "-", int(of.sum()), int(found.registered[of].sum()), int(found.by_rig[of].sum())])
        tables[f"registered_per_{name}"] = {
            "columns": [name, "images", "registered", BY_RIG],
            "rows": rows,
        }
    return tables
