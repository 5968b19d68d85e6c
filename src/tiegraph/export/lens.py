"""Which images can stay as they are, by what the programs' cameras can say."""

from collections.abc import Mapping

import numpy as np
import pycolmap

from tiegraph.scene.composed import same_lens

Cameras = dict[int, pycolmap.Camera]
FISHEYE = "OPENCV_FISHEYE"
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
_RADIAL = {"SIMPLE_RADIAL": 1, "RADIAL": 2}  # radial terms, behind one focal length
_OFF_PX = 0.05  # a principal point this far from the middle, or an edge by unequal focal lengths, shows in no image


def opencv(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Cameras that OPENCV or OPENCV_FISHEYE can say, all in one of the two: a file of nerfstudio has one model. Where
    both occur the fisheye lenses are left out."""
    found = {key: own for key, camera in cameras.items() if (own := _opencv(camera)) is not None}
    kinds = {camera.model_name for camera in found.values()}
    return {k: c for k, c in found.items() if len(kinds) == 1 and len(found) == len(cameras) or c.model_name != FISHEYE}


def _opencv(camera: pycolmap.Camera) -> pycolmap.Camera | None:
    name, params = camera.model_name, [float(p) for p in camera.params]
    if name in ("OPENCV", FISHEYE):
        return camera
    if name in _PINHOLES or name in _RADIAL:
        wide = [camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y]
        radial = params[-_RADIAL[name] :] if name in _RADIAL else []
        return same_lens(camera, "OPENCV", [*wide, *radial, *[0.0] * (4 - len(radial))])
    return None


def pinholes(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Cameras without distortion, as PINHOLE."""
    wide = ("focal_length_x", "focal_length_y", "principal_point_x", "principal_point_y")
    return {
        key: same_lens(camera, "PINHOLE", [getattr(camera, n) for n in wide])
        for key, camera in cameras.items()
        if camera.model_name in _PINHOLES
    }


def centred(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Those of them with square pixels and the principal point in the middle."""
    return {key: camera for key, camera in pinholes(cameras).items() if _is_centred(camera)}


def _is_centred(camera: pycolmap.Camera) -> bool:
    size = np.array([camera.width, camera.height], float)
    off = np.array([camera.principal_point_x, camera.principal_point_y]) - size / 2
    uneven = abs(camera.focal_length_x / camera.focal_length_y - 1) * size[1] / 2
    return bool(max(*np.abs(off), uneven) < _OFF_PX)
