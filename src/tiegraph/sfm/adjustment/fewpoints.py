"""Adjustments with fewer points, for models that are not yet near their solution: the longest tracks, spread over
each image.

Such a round needs poses good to a tenth of a pixel, not the best possible ones, and its time grows with the number of
observations. COLMAP's mappers do the same (github.com/colmap/colmap/pull/3650). The last adjustment uses all points.
"""

import numpy as np
import pycolmap

from tiegraph.sfm.adjustment.lens import take_cameras
from tiegraph.sfm.tuning import FewPointsTuning


def thinned(model: pycolmap.Reconstruction, tuning: FewPointsTuning) -> pycolmap.Reconstruction:
    """A copy without the points that are not needed yet; the model itself where too few could be left out."""
    waiting = points_that_can_wait(model, tuning)
    if not waiting:
        return model
    out = pycolmap.Reconstruction(model)
    for point_id in waiting:
        out.delete_point3D(point_id)
    return out


def take_poses(model: pycolmap.Reconstruction, few: pycolmap.Reconstruction) -> None:
    """Give ``model`` the intrinsics, rigs and poses of its copy that was adjusted with fewer points; its points
    follow the images that see them."""
    _take_points_along(model, few)
    take_cameras(model, few)
    for key, rig in few.rigs.items():
        for sensor, extrinsics in rig.non_ref_sensors.items():
            if extrinsics is not None:
                model.rig(key).set_sensor_from_rig(sensor, extrinsics)
    for key in few.reg_frame_ids():
        model.frame(key).rig_from_world = few.frame(key).rig_from_world


def _take_points_along(model: pycolmap.Reconstruction, few: pycolmap.Reconstruction) -> None:
    """Move each point to the mean of the places that follow from the new poses in ``few`` of the images that see it.

    A model of thousands of images straightens by metres in its first adjustment. Points that were not moved along
    exceeded the limits in pixels and were lost (479 of 599 thousand of 4020 images), and the rigs looked torn.
    """
    ids = np.array(sorted(model.point3D_ids()), int)
    place = np.stack([model.point3D(k).xyz for k in ids.tolist()]) if len(ids) else np.zeros((0, 3))
    total, count = np.zeros_like(place), np.zeros(len(ids))
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        at = np.searchsorted(ids, np.array([p.point3D_id for p in image.get_observation_points2D()], int))
        moved = (few.image(image_id).cam_from_world().inverse() * image.cam_from_world()).matrix()
        np.add.at(total, at, place[at] @ moved[:, :3].T + moved[:, 3])
        np.add.at(count, at, 1)
    for k, xyz in zip(ids[count > 0].tolist(), total[count > 0] / count[count > 0, None]):
        model.point3D(k).xyz = xyz


def points_that_can_wait(model: pycolmap.Reconstruction, tuning: FewPointsTuning) -> list[int]:
    """Ids, in order, of the points that are not among the longest tracks of any cell of any image; none if more than
    the worthwhile share of the observations would stay."""
    cell, point = _sightings(model, tuning.cells)
    length = dict(zip(*(v.tolist() for v in np.unique(point, return_counts=True))))
    order = np.lexsort((point, -np.array([length[p] for p in point.tolist()], int), cell))
    _, start, count = np.unique(cell[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(start, count)
    telling = np.unique(point[order][rank < tuning.in_a_cell])
    if np.isin(point, telling).sum() > tuning.worth * len(point):
        return []
    return np.setdiff1d(np.array(sorted(model.point3D_ids()), int), telling).tolist()


def _sightings(model: pycolmap.Reconstruction, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """(O,) number of the image's cell and (O,) id of the point, for every observation."""
    cell, point = [np.zeros(0, int)], [np.zeros(0, int)]
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        seen = image.get_observation_points2D()
        if not seen or image.camera is None:
            continue
        size = np.array([image.camera.width, image.camera.height])
        column, row = (np.clip(np.stack([p.xy for p in seen]) / size, 0, 1 - 1e-9) * cells).astype(int).T
        cell.append((image_id * cells + row) * cells + column)
        point.append(np.array([p.point3D_id for p in seen]))
    return np.concatenate(cell), np.concatenate(point)
