"""Fewer points for the adjustments that bring a model near: the longest tracks, spread over each image.

Such a round needs poses good to a tenth of a pixel, not all that can be known, and its time goes with the observations;
COLMAP's mappers do likewise (github.com/colmap/colmap/pull/3650). The last adjustment takes all points.
"""

from __future__ import annotations

import numpy as np
import pycolmap

from tiegraph.sfm.tuning import FewPointsTuning


def thinned(model: pycolmap.Reconstruction, tuning: FewPointsTuning) -> pycolmap.Reconstruction:
    """A copy with the points that tell most (``telling_points``)."""
    out = pycolmap.Reconstruction(model)
    for point_id in set(model.point3D_ids()) - telling_points(model, tuning):
        out.delete_point3D(point_id)
    return out


def take_poses(model: pycolmap.Reconstruction, few: pycolmap.Reconstruction) -> None:
    """Give ``model`` the intrinsics, rigs and poses of the same model adjusted with fewer points; its points follow
    where its poses went."""
    for key, camera in few.cameras.items():
        model.camera(key).params = camera.params
    for key, rig in few.rigs.items():
        for sensor, extrinsics in rig.non_ref_sensors.items():
            if extrinsics is not None:
                model.rig(key).set_sensor_from_rig(sensor, extrinsics)
    for key in few.reg_frame_ids():
        model.frame(key).rig_from_world = few.frame(key).rig_from_world


def telling_points(model: pycolmap.Reconstruction, tuning: FewPointsTuning) -> set[int]:
    """Ids of the points that are among the longest tracks in one cell of one image at least."""
    cell, point, length = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0, int)]
    tracks = {k: p.track.length() for k, p in model.points3D.items()}
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        seen = image.get_observation_points2D()
        if not seen or image.camera is None:
            continue
        size = np.array([image.camera.width, image.camera.height])
        at = np.clip(np.stack([p.xy for p in seen]) / size, 0, 1 - 1e-9) * tuning.cells
        own = [p.point3D_id for p in seen]
        cell.append((image_id * tuning.cells + at[:, 1].astype(int)) * tuning.cells + at[:, 0].astype(int))
        point.append(np.array(own))
        length.append(np.array([tracks[k] for k in own]))
    cells, points = np.concatenate(cell), np.concatenate(point)
    order = np.lexsort((points, -np.concatenate(length), cells))
    _, start, count = np.unique(cells[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(start, count)
    return set(points[order][rank < tuning.in_a_cell].tolist())
