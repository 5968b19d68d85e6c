"""A rendered corridor with its true model: what the sparse stage would hand to the dense stage, without error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from worlds import Survey, make_survey

_STEP_PX = 20  # one sparse point in every 20 x 20 pixels of every second image
_SAME_SURFACE = 0.01


def render(folder: Path) -> Survey:
    """One pass of five frames of two cameras."""
    return make_survey(folder, passes=("up",), frames=5, size=(256, 192), seed=3)


def true_model(survey: Survey) -> pycolmap.Reconstruction:
    """The survey's cameras and poses, and true surface points with every image that sees them."""
    names = sorted(survey.cam_from_world)
    sensors = {s.name: s for s in survey.rig.sensors}
    cameras = {n: sensors[n.split("/")[1]].camera for n in names}
    depths = {n: survey.world.depth_m(cameras[n], survey.cam_from_world[n]) for n in names}
    world = np.concatenate([_points(cameras[n], survey.cam_from_world[n], depths[n]) for n in names[::2]])
    seen = [_see(world, cameras[n], survey.cam_from_world[n], depths[n]) for n in names]
    return model_of(names, [cameras[n] for n in names], [survey.cam_from_world[n] for n in names], world, seen)


def model_of(
    names: list[str],
    cameras: list[pycolmap.Camera],
    poses: list[np.ndarray],
    world: np.ndarray,
    seen: list[np.ndarray],
) -> pycolmap.Reconstruction:
    """A reconstruction of images and points (P, 3); ``seen``: per image (P, 2) pixels, NaN = not seen."""
    model = pycolmap.Reconstruction()
    tracks: list[list[tuple[int, int]]] = [[] for _ in world]
    for k, (name, camera, pose) in enumerate(zip(names, cameras, poses, strict=True)):
        own = pycolmap.Camera(
            model=camera.model_name, width=camera.width, height=camera.height, params=camera.params, camera_id=k + 1
        )
        model.add_camera_with_trivial_rig(own)
        visible = np.flatnonzero(np.isfinite(seen[k]).all(axis=1))
        image = pycolmap.Image(name=name, keypoints=seen[k][visible], camera_id=k + 1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
        for row, point in enumerate(visible):
            tracks[point].append((k + 1, row))
    for xyz, track in zip(world, tracks, strict=True):
        if len(track) > 1:
            elements = [pycolmap.TrackElement(i, r) for i, r in track]
            model.add_point3D(xyz, pycolmap.Track(elements), np.zeros(3, np.uint8))
    return model


def _points(camera: pycolmap.Camera, cam_from_world: np.ndarray, depth: np.ndarray) -> np.ndarray:
    v, u = np.mgrid[_STEP_PX // 2 : camera.height : _STEP_PX, _STEP_PX // 2 : camera.width : _STEP_PX]
    u, v = u.ravel(), v.ravel()
    z = depth[v, u]
    u, v, z = u[np.isfinite(z)], v[np.isfinite(z)], z[np.isfinite(z)]
    rays = np.c_[u + 0.5, v + 0.5, np.ones(len(z))] @ np.linalg.inv(camera.calibration_matrix()).T
    return transforms.apply(transforms.invert(cam_from_world), rays * z[:, None])


def _see(world: np.ndarray, camera: pycolmap.Camera, cam_from_world: np.ndarray, depth: np.ndarray) -> np.ndarray:
    there = transforms.apply(cam_from_world, world)
    pixel = np.full((len(world), 2), np.nan)
    front = there[:, 2] > 0.1
    pixel[front] = camera.img_from_cam(there[front])
    inside = front & (pixel >= 0).all(axis=1) & (pixel[:, 0] < camera.width) & (pixel[:, 1] < camera.height)
    column, row = (np.where(inside, pixel[:, k], 0).astype(int) for k in (0, 1))
    visible = inside & (np.abs(depth[row, column] / there[:, 2] - 1) < _SAME_SURFACE)
    return np.where(visible[:, None], pixel, np.nan)
