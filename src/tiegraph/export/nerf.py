"""nerfstudio's ``transforms.json``: cameras by frame, OpenGL's axes, masks, and depth along the optical axis."""

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.export.lens import FISHEYE
from tiegraph.export.survey import Survey, write_json, write_offset
from tiegraph.geometry.transforms import invert
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.namedposes import TRANSFORMS
from tiegraph.scene.results import DepthMap, row_strips

_POINTS = "sparse_pc.ply"
_TERMS = {FISHEYE: ("k1", "k2", "k3", "k4")}  # behind the focal lengths and the principal point
_OPENCV = ("k1", "k2", "p1", "p2")
_LARGEST = 65535  # of a depth map of 16 bits


def nerfstudio(survey: Survey, target: Path) -> int:
    """Write ``transforms.json`` and the points; the number of frames."""
    frames = []
    for image in survey.images():
        camera = survey.model.camera(image.camera_id)
        values = [float(v) for v in camera.params]
        pose = invert(matrix(image.cam_from_world()))
        pose[:3, 1:3] *= -1  # to OpenGL's camera
        frame: dict[str, Any] = {"file_path": f"images/{image.name}", "w": camera.width, "h": camera.height}
        frame |= dict(zip(("fl_x", "fl_y", "cx", "cy", *_TERMS.get(camera.model_name, _OPENCV)), values))
        frame |= {"transform_matrix": pose.tolist(), "colmap_im_id": image.image_id}
        for key, files in (("mask_path", survey.masks), ("depth_file_path", survey.depths)):
            if image.name in files:
                frame[key] = files[image.name]
        frames.append(frame)
    kinds = {c.model_name for c in survey.model.cameras.values()}
    data = {
        "camera_model": FISHEYE if FISHEYE in kinds else "OPENCV",
        "applied_transform": np.eye(4)[:3].tolist(),  # to the world of the survey: none
        "ply_file_path": _POINTS,
        "frames": frames,
    }
    survey.model.export_PLY(str(target / _POINTS))
    write_json(target / TRANSFORMS, data)
    write_offset(survey, target)
    return len(frames)


def depth_through(camera: pycolmap.Camera, depth: DepthMap | None) -> np.ndarray:
    """Depth (H, W) f4 along the optical axis as an image of the camera sees it, world units, 0 = none: nerfstudio wants
    one for every frame, of the size of its image."""
    out = np.zeros((camera.height, camera.width), np.float32)
    if depth is None:
        return out
    height, width = depth.depth_m.shape
    known = np.nan_to_num(depth.depth_m, nan=0.0)
    for rows in row_strips(out.shape):
        u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(rows.start, rows.stop) + 0.5)
        rays = np.asarray(camera.cam_ray_from_img(np.stack([u, v], axis=-1).reshape(-1, 2)))
        with np.errstate(all="ignore"):  # no ray, or one behind
            at = (rays / rays[:, 2:]) @ depth.K.T
            x, y = np.floor(at[:, 0]), np.floor(at[:, 1])
        there = (rays[:, 2] > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        values = np.zeros(len(rays), np.float32)
        values[there] = known[y[there].astype(int), x[there].astype(int)]
        out[rows] = values.reshape(u.shape)
    return out


def in_thousandths(depth: np.ndarray, unit: str) -> np.ndarray:
    """Depth (H, W) in thousandths, as nerfstudio's unit of depth is: millimetres as u2 where these hold it, else f4."""
    scaled = 1000 * depth
    if unit != "m" or scaled.max(initial=0) > _LARGEST:
        return scaled.astype(np.float32)
    return np.rint(scaled).astype(np.uint16)
