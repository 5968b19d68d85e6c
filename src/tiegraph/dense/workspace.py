"""Depth maps handed over to COLMAP: a dense workspace as its image undistorter and PatchMatch leave it.

COLMAP's ``stereo_fusion`` (which needs no CUDA), Poisson and Delaunay meshing then work on our depth maps.
"""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from tiegraph.dense.plan import CameraModel, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.undistort import load_view, pinhole_of
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.composed import moved_pixels
from tiegraph.scene.names import inside
from tiegraph.scene.results import DepthMap

_SOURCES = 20  # partners PatchMatch would choose by itself, were it run in the workspace
_KIND = "geometric"  # the name of depth maps that were compared with each other


def write_workspace(
    target: Path,
    model: pycolmap.Reconstruction,
    images: Path,
    load: Callable[[str], DepthMap | None],
    settings: DenseSettings,
) -> int:
    """Write undistorted images, the model with their pinhole cameras, depth and normal maps below ``target``; the
    number of depth maps.

    ``load`` gives the depth map of an image by name, None where there is none: such an image is left out of the model.
    Raises InputError for images that cannot be read, and for names that lead out of the folder.
    """
    maps = target / "stereo" / "depth_maps"
    names = []
    for image in sorted((model.image(i) for i in model.reg_image_ids()), key=lambda i: i.name):
        depth = load(image.name)
        if depth is None:
            continue
        names.append(image.name)
        pose = matrix(image.cam_from_world())
        view = ViewPlan(image.name, CameraModel.of(model.camera(image.camera_id)), pose)
        path = inside(target / "images", image.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        bgr = load_view(view, images, None, settings).image_bgr
        path.write_bytes(cv2.imencode(path.suffix.lower(), bgr)[1].tobytes())  # OpenCV does not say that a disk is full
        _write_map(maps / f"{image.name}.{_KIND}.bin", depth.depth_m)
        normal = depth.normal if depth.normal is not None else np.zeros((*depth.depth_m.shape, 3), np.float32)
        _write_map(target / "stereo" / "normal_maps" / f"{image.name}.{_KIND}.bin", normal)
    (target / "sparse").mkdir(parents=True, exist_ok=True)
    undistorted(model, set(names), settings).write(str(target / "sparse"))
    folder = target / "stereo"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "fusion.cfg").write_text("".join(f"{n}\n" for n in names), encoding="utf-8")
    (folder / "patch-match.cfg").write_text("".join(f"{n}\n__auto__, {_SOURCES}\n" for n in names), encoding="utf-8")
    return len(names)


def undistorted(model: pycolmap.Reconstruction, names: set[str], settings: DenseSettings) -> pycolmap.Reconstruction:
    """A copy of the model with the pinhole cameras of the undistorted images, key points moved along; each of the
    images is a frame of its own, others and points without images left out."""
    result = pycolmap.Reconstruction()
    kept = {}
    for camera_id, camera in model.cameras.items():
        K, (width, height) = pinhole_of(CameraModel.of(camera), settings)
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        kept[camera_id] = pycolmap.Camera(
            model="PINHOLE", width=width, height=height, params=params, camera_id=camera_id
        )
        result.add_camera_with_trivial_rig(kept[camera_id])
    for image_id in sorted(model.reg_image_ids()):
        image = model.image(image_id)
        if image.name not in names:
            continue
        at = np.array([p.xy for p in image.points2D], float).reshape(-1, 2)
        moved = moved_pixels(at, model.camera(image.camera_id), kept[image.camera_id])
        own = pycolmap.Image(name=image.name, keypoints=moved, camera_id=image.camera_id, image_id=image_id)
        result.add_image_with_trivial_frame(own, image.cam_from_world())
    there = set(result.images)
    for point in model.points3D.values():
        elements = [e for e in point.track.elements if e.image_id in there]
        if len(elements) > 1:
            result.add_point3D(point.xyz, pycolmap.Track(elements), point.color)
    return result


def _write_map(path: Path, values: np.ndarray) -> None:
    """COLMAP's matrix file: sizes as text, then (channels, H, W) f4; 0 where there is nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = np.atleast_3d(np.nan_to_num(values, nan=0.0).astype("<f4")).transpose(2, 0, 1)
    channels, height, width = planes.shape
    with path.open("wb") as file:
        file.write(f"{width}&{height}&{channels}&".encode())
        file.write(np.ascontiguousarray(planes).tobytes())
