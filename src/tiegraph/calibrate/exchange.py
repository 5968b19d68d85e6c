"""Calibrations for other programs: Kalibr's camchain.yaml and OpenCV's YAML, the inverse of what ``scan`` reads.

Both count pixels from the centre of the first one, and hold fewer lenses than COLMAP: polynomials of the radius with
two tangential terms, and Kannala's of the angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pycolmap

from tiegraph.geometry.transforms import invert
from tiegraph.scene.targets import CENTRE

_RADTAN_TERMS = 4  # of Kalibr: k1 k2 p1 p2


@dataclass(frozen=True)
class Lens:
    """A camera in OpenCV's terms: fx, fy, cx, cy, and k1 k2 p1 p2 [k3 k4 k5 k6], of a fisheye k1 k2 k3 k4."""

    middle: tuple[float, ...]
    terms: tuple[float, ...]
    fisheye: bool


def lens_of(camera: pycolmap.Camera) -> Lens | None:
    """A camera in OpenCV's terms; None if its model has none."""
    focal = [camera.params[k] for k in camera.focal_length_idxs()]
    centre = (camera.principal_point_x - CENTRE, camera.principal_point_y - CENTRE)
    middle = tuple(float(v) for v in (focal[0], focal[-1], *centre))
    terms = [float(camera.params[k]) for k in camera.extra_params_idxs()]
    radial = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"}
    angular = {"SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"}
    if camera.model.name not in radial | angular:
        return None
    terms += [0.0] * (_RADTAN_TERMS - len(terms))
    return Lens(middle, tuple(terms), camera.model.name in angular)


def opencv_yaml(camera: pycolmap.Camera) -> str | None:
    """A camera as OpenCV's sample ``camera_calibration`` writes it; None if its model has no such form."""
    lens = lens_of(camera)
    if lens is None:
        return None
    fx, fy, cx, cy = lens.middle
    storage = cv2.FileStorage(".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("fisheye_model", int(lens.fisheye))
    storage.write("camera_matrix", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array(lens.terms)[:, None])
    return str(storage.releaseAndGetString())


def kalibr_yaml(cameras: Sequence[pycolmap.Camera], sensor_from_rig: np.ndarray) -> str | None:
    """A rig as Kalibr's camchain.yaml; None if one of its cameras has no such form."""
    lines: list[str] = []
    for number, camera in enumerate(cameras):
        lens = lens_of(camera)
        if lens is None or len(lens.terms) > _RADTAN_TERMS:
            return None
        lines.append(f"cam{number}:")
        if number:
            chain = sensor_from_rig[number] @ invert(sensor_from_rig[number - 1])
            lines += ["  T_cn_cnm1:", *(f"  - {_list(row)}" for row in chain)]
        lines += [
            "  camera_model: pinhole",
            f"  distortion_model: {'equidistant' if lens.fisheye else 'radtan'}",
            f"  distortion_coeffs: {_list(lens.terms)}",
            f"  intrinsics: {_list(lens.middle)}",
            f"  resolution: [{camera.width}, {camera.height}]",
        ]
    return "\n".join(lines) + "\n"


def _list(values: Sequence[float] | np.ndarray) -> str:
    return f"[{', '.join(repr(float(v)) for v in values)}]"
