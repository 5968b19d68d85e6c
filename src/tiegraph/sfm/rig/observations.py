"""What the images of a model see, as arrays: points, rays, and points made anew from some of the cameras only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses, registered_images
from tiegraph.scene.rays import rays_or_axis
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.rig import DiagnosticsTuning


@dataclass(frozen=True)
class Observations:
    """M observations of P points by the scene's images; model units."""

    cam_from_world: np.ndarray  # (N, 4, 4), NaN = not registered
    xyz: np.ndarray  # (P, 3)
    image: np.ndarray  # (M,) scene index
    point: np.ndarray  # (M,) row of xyz
    xy: np.ndarray  # (M, 2) pixels
    ray: np.ndarray  # (M, 3) unit, camera frame
    focal_px: np.ndarray  # (M,)

    def where(self, rows: np.ndarray) -> Observations:
        """Some of the observations."""
        parts = (getattr(self, name)[rows] for name in ("image", "point", "xy", "ray", "focal_px"))
        return Observations(self.cam_from_world, self.xyz, *parts)


def model_observations(reconstruction: pycolmap.Reconstruction, scene: Scene) -> Observations:
    """All observations of a model's registered images that the scene knows."""
    ids = np.array(sorted(reconstruction.point3D_ids()), np.int64)
    xyz = np.array([reconstruction.point3D(int(k)).xyz for k in ids]).reshape(-1, 3)
    image, point, xy, ray, focal = [], [], [], [], []
    for index, found in registered_images(reconstruction, scene):
        seen = found.get_observation_points2D()
        if not seen:
            continue
        camera = reconstruction.camera(found.camera_id)
        at = np.array([p.xy for p in seen])
        image.append(np.full(len(seen), index))
        point.append(np.searchsorted(ids, [p.point3D_id for p in seen]))
        xy.append(at)
        ray.append(rays_or_axis(camera, at))
        focal.append(np.full(len(seen), camera.mean_focal_length()))
    if not image:
        none = np.zeros(0, int)
        rest = (none, none, np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0))
        return Observations(image_poses(reconstruction, scene), xyz, *rest)
    columns = [np.concatenate(c) for c in (image, point, xy, ray, focal)]
    return Observations(image_poses(reconstruction, scene), xyz, *columns)


@dataclass(frozen=True)
class Retriangulation:
    """Points made from some observations: place (P, 3) and information (P, 3, 3) per squared pixel; NaN = too few."""

    xyz: np.ndarray
    information: np.ndarray

    def sigma_px(self, rows: np.ndarray, cam_from_world: np.ndarray, focal_px: float) -> np.ndarray:
        """(K,) how far, in pixels, the points' own uncertainty (1 px sightings) spreads in an image."""
        local = transforms.apply(cam_from_world, self.xyz[rows])
        depth = np.maximum(local[:, 2], 1e-9)
        flat = np.zeros((len(rows), 2, 3))
        flat[:, 0, 0] = flat[:, 1, 1] = focal_px / depth
        flat[:, :, 2] = -focal_px * local[:, :2] / depth[:, None] ** 2
        jacobian = flat @ cam_from_world[:3, :3]
        spread = np.linalg.inv(self.information[rows])
        return np.sqrt(np.einsum("kij,kjl,kil->k", jacobian, spread, jacobian) / 2)


def retriangulate(seen: Observations, tuning: DiagnosticsTuning) -> Retriangulation:
    """Points from the given sightings alone: least squares of the rays' distances, weighted by focal length / range.

    Needs two sightings or more whose rays meet at an angle. Robust by Cauchy weights from the second round on.
    """
    count = len(seen.xyz)
    # (M, 3) unit rays in the world
    rays = np.einsum("mji,mj->mi", seen.cam_from_world[seen.image, :3, :3], seen.ray)
    centres = transforms.centre(seen.cam_from_world)[seen.image]
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    xyz = seen.xyz.copy()
    information = np.zeros((count, 3, 3))
    for k in range(tuning.point_rounds):
        away = xyz[seen.point] - centres
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        weight = (seen.focal_px / distance) ** 2
        if k:
            off = np.linalg.norm(np.einsum("mij,mj->mi", across, away), axis=1) * seen.focal_px / distance
            weight = weight / (1 + (off / tuning.point_cauchy_px) ** 2)
        information = np.zeros((count, 3, 3))
        right = np.zeros((count, 3))
        np.add.at(information, seen.point, weight[:, None, None] * across)
        np.add.at(right, seen.point, weight[:, None] * np.einsum("mij,mj->mi", across, centres))
        # (P,) bool: the rays of a point span an angle; two rays at angle a have eigenvalues 1 - cos a and 1 + cos a
        values = np.linalg.eigvalsh(information)
        usable = values[:, 0] > np.maximum(values[:, 2], 1e-12) * (1 - np.cos(np.radians(tuning.min_angle_deg))) / 2
        xyz = np.full((count, 3), np.nan)
        xyz[usable] = np.linalg.solve(information[usable], right[usable][..., None])[..., 0]
        information[~usable] = np.nan
        if k + 1 < tuning.point_rounds:
            xyz[~usable] = seen.xyz[~usable]
    return Retriangulation(xyz, information)
