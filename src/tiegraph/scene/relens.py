"""A model converted to other images of the same views: undistorted ones, other names."""

from collections.abc import Mapping
from copy import deepcopy

import numpy as np
import pycolmap


def moved_pixels(at: np.ndarray, camera: pycolmap.Camera, other: pycolmap.Camera) -> np.ndarray:
    """Pixels (N, 2) of one camera converted to another at the same pose; NaN = outside its view."""
    if not len(at):
        return np.zeros((0, 2))
    return np.asarray(other.img_from_cam(np.asarray(camera.cam_ray_from_img(at)))).reshape(-1, 2)


def with_cameras(
    model: pycolmap.Reconstruction, cameras: Mapping[int, pycolmap.Camera], names: Mapping[str, str]
) -> pycolmap.Reconstruction:
    """A copy with other ``cameras`` by their ids and other ``names`` of images; those without one stay unchanged.

    Key points move along; observations that then lie outside the image are left out, and points with less than two.
    """
    result = pycolmap.Reconstruction(model)
    for key, camera in cameras.items():
        own = result.cameras[key]
        own.model = camera.model
        own.params, own.width, own.height = camera.params.tolist(), camera.width, camera.height
    for image in result.images.values():
        image.name = names.get(image.name, image.name)
    same = {k for k, camera in result.cameras.items() if repr(camera) == repr(model.camera(k))}
    for key in sorted(k for k in result.reg_image_ids() if result.image(k).camera_id not in same):
        image = result.image(key)
        old, new = model.camera(image.camera_id), result.camera(image.camera_id)
        moved = moved_pixels(np.array([p.xy for p in image.points2D], float).reshape(-1, 2), old, new)
        inside = np.all((moved >= 0) & (moved <= [new.width, new.height]), axis=1)  # NaN is not
        for k, (point, xy) in enumerate(zip(image.points2D, np.nan_to_num(moved, nan=0, posinf=0, neginf=0))):
            point.xy = xy
            if not inside[k] and point.has_point3D():
                result.delete_observation(key, k)
    return result


def same_lens(camera: pycolmap.Camera, model: str, params: list[float]) -> pycolmap.Camera:
    """The camera in another camera model, its pixels unchanged."""
    own = deepcopy(camera)
    own.model = pycolmap.CameraModelId.__members__[model]
    own.params = params
    return own
