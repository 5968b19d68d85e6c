"""What lenses look like: aspect and decentring, which the mappers' cameras do not have, with priors.

RADIAL has one focal length and no tangential terms. What a lens has of these goes into principal point and rig instead:
on canal_demo and canal (aspect 0.1-0.2 %, decentring 2e-4 to 5e-4) it turned the cameras of the rig by up to 0.22 and
0.12 deg. The priors keep the terms where the images do not tell them: on straight tracks.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

import numpy as np
import pycolmap

# Sigma of fx / fy - 1 and of p1, p2: pixels are square, and lenses are centred to some hundredths of a millimetre.
ASPECT, DECENTRING = 0.002, 0.0005
LOOSE_FOCAL, LOOSE_CENTRE, LOOSE_RADIAL = 0.2, 0.1, 0.5  # of the rest: parts of f, parts of f, absolute
SIGMA_PX = 0.5  # reprojection errors are not divided by their sigma, so the priors are multiplied by it


@cache
def available() -> bool:
    """Whether priors of intrinsics can be added to Ceres' problem (package pyceres)."""
    try:
        import pyceres

        return hasattr(pyceres.factors, "NormalPrior")
    except (ImportError, AttributeError):
        return False


def extensible(
    model: pycolmap.Reconstruction, cameras: Collection[int], kinds: Collection[str] = ("RADIAL",)
) -> list[int]:
    """Those of these cameras (COLMAP ids) whose model is of these kinds; none without pyceres."""
    return [k for k in sorted(cameras) if available() and model.camera(k).model.name in kinds]


def extended(model: pycolmap.Reconstruction, cameras: Collection[int]) -> pycolmap.Reconstruction:
    """A copy in which these cameras have COLMAP's model OPENCV, with the projection they had."""
    out = pycolmap.Reconstruction(model)
    for key in cameras:
        camera = out.camera(key)
        params = _full(camera)
        camera.model = pycolmap.CameraModelId.OPENCV
        camera.params = params.tolist()
    return out


def _full(camera: pycolmap.Camera) -> np.ndarray:
    """(8,) parameters of OPENCV with the projection of a pinhole or radial camera."""
    rest = dict(zip(camera.params_info.replace(" ", "").split(","), camera.params))
    radial = rest.get("k1", rest.get("k", 0.0)), rest.get("k2", 0.0)
    focal = [camera.focal_length_x, camera.focal_length_y]
    tangential = rest.get("p1", 0.0), rest.get("p2", 0.0)
    return np.array([*focal, camera.principal_point_x, camera.principal_point_y, *radial, *tangential])


def add_priors(problem: Any, model: pycolmap.Reconstruction) -> list[Any]:
    """Add what is expected of the OPENCV cameras that are unknowns of the problem; keep what is returned."""
    kept: list[Any] = []
    for camera in model.cameras.values() if available() else ():
        block = camera.params
        if camera.model == pycolmap.CameraModelId.OPENCV and problem.has_parameter_block(block):
            mean: np.ndarray = np.array(block)
            mean[:2], mean[6:] = mean[:2].mean(), 0.0
            kept.append(_prior(mean, covariance(float(mean[0]))))
            problem.add_residual_block(kept[-1], None, [block])
    return kept


def covariance(focal_px: float) -> np.ndarray:
    """(8, 8) of OPENCV's parameters: what is expected of a lens before the images speak."""
    centre = LOOSE_CENTRE * focal_px
    sigma = np.array([0.0, 0.0, centre, centre, LOOSE_RADIAL, LOOSE_RADIAL, DECENTRING, DECENTRING])
    out = np.diag(sigma**2)
    out[:2, :2] = (LOOSE_FOCAL * focal_px) ** 2 + np.array([[1, -1], [-1, 1]]) * (ASPECT * focal_px / 2) ** 2
    return out


def _prior(mean: np.ndarray, sigma: np.ndarray) -> Any:
    import pyceres

    return pyceres.factors.NormalPrior(mean, sigma / SIGMA_PX**2)
