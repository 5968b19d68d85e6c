"""Priors of lens parameters: aspect and decentring, which the mappers' camera models do not have.

RADIAL has one focal length and no tangential terms. The principal point and the rig absorb what a real lens has of
these: on canal_demo and canal (aspect 0.1-0.2 %, decentring 2e-4 to 5e-4) that turned the cameras of the rig by up to
0.22 and 0.12 deg. The priors hold the terms where the images do not determine them, as on straight tracks.
SIMPLE_RADIAL, used to map loose photographs, also lacks a second radial term: straight down over flat ground the
focal length of a drone compensates for it (mirafiori of the ladder: 1050 px instead of 1906; with all terms 1653 px
and 0.12 m off instead of 0.37).
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pyceres
import pycolmap

from tiegraph.scene.rig import on_plane
from tiegraph.sfm.tuning import AdjustTuning, LensTuning

UNDISTORTED = ("SIMPLE_PINHOLE", "PINHOLE")  # calibrations that say nothing of distortion


def extensible(
    model: pycolmap.Reconstruction, cameras: Collection[int], kinds: Collection[str] = ("SIMPLE_RADIAL", "RADIAL")
) -> list[int]:
    """The cameras (COLMAP ids) whose camera model is one of these."""
    return [k for k in sorted(cameras) if model.camera(k).model.name in kinds]


def extended(model: pycolmap.Reconstruction, cameras: Collection[int]) -> pycolmap.Reconstruction:
    """A copy in which these cameras have COLMAP's model OPENCV with an unchanged projection."""
    out = pycolmap.Reconstruction(model)
    for key in cameras:
        camera = out.camera(key)
        params = _full(camera)
        camera.model = pycolmap.CameraModelId.OPENCV
        camera.params = params.tolist()
    return out


def take_cameras(model: pycolmap.Reconstruction, other: pycolmap.Reconstruction) -> None:
    """Give ``model`` the cameras of another model of the same images, with their camera models, which may be extended
    ones."""
    for key, camera in other.cameras.items():
        model.camera(key).model = camera.model
        model.camera(key).params = camera.params


def _full(camera: pycolmap.Camera) -> np.ndarray:
    """(8,) parameters of OPENCV with the projection of a pinhole or radial camera."""
    rest = dict(zip(camera.params_info.replace(" ", "").split(","), camera.params))
    radial = rest.get("k1", rest.get("k", 0.0)), rest.get("k2", 0.0)
    focal = [camera.focal_length_x, camera.focal_length_y]
    tangential = rest.get("p1", 0.0), rest.get("p2", 0.0)
    return np.array([*focal, camera.principal_point_x, camera.principal_point_y, *radial, *tangential])


def add_priors(
    problem: Any, model: pycolmap.Reconstruction, given: Mapping[int, pycolmap.Camera], tuning: AdjustTuning
) -> list[Any]:
    """Add the priors of those OPENCV cameras that are unknowns of the problem; keep the returned objects.

    ``given``: calibrations by camera id that are trusted except for small changes and distortion.
    """
    kept: list[Any] = []
    for key, camera in model.cameras.items():
        block = camera.params
        if camera.model == pycolmap.CameraModelId.OPENCV and problem.has_parameter_block(block):
            mean: np.ndarray = _full(given.get(key, camera))
            if key not in given:
                mean[:2], mean[6:] = mean[:2].mean(), 0.0
            expected = covariance(float(mean[0]), tuning.lens, key in given)
            kept.append(pyceres.factors.NormalPrior(mean, expected / tuning.robust_px**2))
            problem.add_residual_block(kept[-1], None, [block])
    return kept


def covariance(focal_px: float, tuning: LensTuning, calibrated: bool = False) -> np.ndarray:
    """(8, 8) prior covariance of OPENCV's parameters."""
    focal, centre, aspect, radial = tuning.loose_focal, tuning.loose_centre, tuning.aspect, tuning.radial
    if calibrated:
        focal = centre = aspect = tuning.given
    centre_px, decentring = centre * focal_px, tuning.decentring
    sigma = np.array([0.0, 0.0, centre_px, centre_px, radial, radial, decentring, decentring])
    out = np.diag(sigma**2)
    out[:2, :2] = (focal * focal_px) ** 2 + np.array([[1, -1], [-1, 1]]) * (aspect * focal_px / 2) ** 2
    return out


def difference_px(a: pycolmap.Camera, b: pycolmap.Camera) -> float:
    """Median distance in pixels between the images of the same ray by two calibrations, over the image of ``a``."""
    x, y = np.linspace(0, a.width, 9), np.linspace(0, a.height, 9)
    grid = np.array([[u, v] for u in x for v in y])
    rays = np.column_stack([on_plane(a, grid), np.ones(len(grid))])
    return float(np.nanmedian(np.linalg.norm(b.img_from_cam(rays) - grid, axis=1)))
