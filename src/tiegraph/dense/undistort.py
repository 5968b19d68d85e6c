"""From an image of any COLMAP camera to an undistorted view with a pinhole matrix.

Depth maps of such views are handed over to COLMAP as a dense workspace, as its image undistorter and PatchMatch leave
it: its ``stereo_fusion`` (which needs no CUDA), Poisson and Delaunay meshing then work on them.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from tiegraph.dense.engine import DenseView
from tiegraph.dense.plan import CameraModel, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.errors import InputError
from tiegraph.geometry.stereo import Pinhole
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.composed import moved_pixels
from tiegraph.scene.decoding import read_pixels
from tiegraph.scene.names import inside
from tiegraph.scene.results import DepthMap, row_strips

_KIND = "geometric"  # the name of depth maps that were compared with each other
_STRETCHED = 1.3  # pixels of an undistorted image per pixel of the image; more only stretches the corners


def _refuse_sphere(camera: CameraModel) -> None:
    if camera.model == "EQUIRECTANGULAR":
        raise InputError(f"camera model {camera.model} sees all round and cannot be undistorted: cut it into views")


def pinhole_of(camera: CameraModel, settings: DenseSettings) -> tuple[np.ndarray, tuple[int, int]]:
    """K (3, 3) and size (width, height) of the undistorted image of a camera.

    The resolution at the image centre is kept, and the field of view up to ``max_fov_deg``; then the whole is reduced
    to ``max_image_size``. Raises InputError for cameras that see all round.
    """
    _refuse_sphere(camera)
    limit, plane = np.tan(np.radians(settings.max_fov_deg / 2)), _border(camera).reshape(-1, 2)
    plane = plane[np.isfinite(plane).all(axis=1)]
    if not len(plane):  # nothing bounds the field of view
        plane = np.array([[-limit, -limit], [limit, limit]])
    low, high = np.clip(plane.min(axis=0), -limit, 0), np.clip(plane.max(axis=0), 0, limit)
    focal = _central_focal(camera)
    if camera.model in ("PINHOLE", "SIMPLE_PINHOLE"):
        focal = camera.params[0]
    area = np.prod(focal * (high - low))
    scale = min(1.0, np.sqrt(_STRETCHED * camera.width * camera.height / area))
    scale = min(scale, settings.max_image_size / np.max(focal * (high - low)))
    size = np.maximum(np.round(focal * scale * (high - low)), 2)
    focals = size / (high - low)  # takes up the rounding, so that the field is exact
    K = np.array([[focals[0], 0, -focals[0] * low[0]], [0, focals[1], -focals[1] * low[1]], [0, 0, 1.0]])
    return K, (int(size[0]), int(size[1]))


def centred_pinhole(camera: CameraModel, settings: DenseSettings) -> CameraModel:
    """The pinhole camera with square pixels and the principal point in the middle, as programs take for granted that
    know no other: the largest whose image has no blank pixel, with the resolution of the image's centre, no wider than
    ``max_fov_deg``. Raises InputError for cameras that see all round, or whose optical axis misses the image."""
    _refuse_sphere(camera)
    limit = np.tan(np.radians(settings.max_fov_deg / 2))
    top, bottom, left, right = _border(camera)
    reach = [[-left[:, 0], right[:, 0]], [-top[:, 1], bottom[:, 1]]]
    half = np.array([min(limit, *(np.min(side[np.isfinite(side)], initial=limit) for side in axis)) for axis in reach])
    if not (half > 0).all():
        raise InputError(
            f"camera model {camera.model}: its optical axis does not meet the image, which then has no middle"
        )
    focal = _central_focal(camera)
    focal *= min(1.0, np.sqrt(_STRETCHED * camera.width * camera.height / np.prod(2 * focal * half)))
    width, height = (int(n) for n in np.maximum(np.floor(2 * focal * half + 1e-6), 2))
    return CameraModel(model="PINHOLE", width=width, height=height, params=(focal, focal, width / 2, height / 2))


def load_view(view: ViewPlan, images: Path, masks: Path | None, settings: DenseSettings) -> DenseView:
    """Read, undistort and mask one image. ``masks`` holds COLMAP masks (``name.png``, 0 = ignore); a missing one means
    that all pixels are used. Raises InputError for an unreadable image or a size that is not the camera's."""
    K, size = pinhole_of(view.camera, settings)
    params = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    return view_through(CameraModel(model="PINHOLE", width=size[0], height=size[1], params=params), view, images, masks)


def view_through(pinhole: CameraModel, view: ViewPlan, images: Path, masks: Path | None) -> DenseView:
    """As ``load_view``, through a pinhole camera of any size and field of view."""
    camera, (fx, fy, cx, cy) = view.camera, pinhole.params
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    image = _read(images / view.name, cv2.IMREAD_COLOR, camera)
    mask_path = None if masks is None else masks / f"{view.name}.png"
    mask = np.full(image.shape[:2], 255, np.uint8)
    if mask_path is not None and mask_path.exists():
        mask = _read(mask_path, cv2.IMREAD_GRAYSCALE, camera)
    x, y, valid = _maps(camera, pinhole)
    ratio, scale_x, scale_y = K[0, 0] / _central_focal(camera), 1.0, 1.0
    if ratio <= 0.75:  # shrunk by area averaging to about the working resolution first, against aliasing
        width, height = max(2, round(camera.width * ratio)), max(2, round(camera.height * ratio))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        scale_x, scale_y = width / camera.width, height / camera.height
    at_x, at_y = (x * scale_x - 0.5).astype(np.float32), (y * scale_y - 0.5).astype(np.float32)
    bgr = cv2.remap(image, at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    whole_x, whole_y = x - np.float32(0.5), y - np.float32(0.5)
    use = cv2.remap(mask, whole_x, whole_y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return DenseView(name=view.name, image_bgr=bgr, mask=(use > 0) & valid, K=K, cam_from_world=view.cam_from_world)


def pinhole(view: ViewPlan, settings: DenseSettings) -> Pinhole:
    """The undistorted camera of an image, without reading it."""
    K, size = pinhole_of(view.camera, settings)
    return Pinhole(K, view.cam_from_world, size=size, name=view.name)


def _read(path: Path, flag: int, camera: CameraModel) -> np.ndarray:
    image = read_pixels(path, flag)
    if image is None:
        raise InputError(f"{path} cannot be read as an image: restore it, or remove it and run the scan again")
    if image.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"{path} is {image.shape[1]} x {image.shape[0]} pixels, its camera {camera.width} x {camera.height}: "
            "use the images (and masks) the model was made from"
        )
    return image


def _border(camera: CameraModel) -> np.ndarray:
    """(4, 65, 2) where rays through the sides of an image (top, bottom, left, right) meet the plane z = 1; NaN = none.

    A ray at right angles or behind is far out: its direction in the image still says towards which side."""
    s = np.linspace(0.0, 1.0, 65)  # points of each side of an image that tell its field of view
    zero, one = np.zeros_like(s), np.ones_like(s)
    border = np.concatenate([np.c_[s, zero], np.c_[s, one], np.c_[zero, s], np.c_[one, s]])
    rays = np.asarray(camera.to_pycolmap().cam_ray_from_img(border * [camera.width, camera.height]))
    plane = rays[:, :2] / np.maximum(rays[:, 2:], 1e-3 * np.linalg.norm(rays, axis=1, keepdims=True))
    return plane.reshape(4, -1, 2)


def _central_focal(camera: CameraModel) -> float:
    """Pixels per unit of tangent at the optical axis."""
    step = 1e-4
    around = np.array([[step, 0, 1], [-step, 0, 1], [0, step, 1], [0, -step, 1]])
    at = np.asarray(camera.to_pycolmap().img_from_cam(around))
    return float((np.linalg.norm(at[0] - at[1]) + np.linalg.norm(at[2] - at[3])) / (4 * step))


@lru_cache(maxsize=8)  # a rig of six and two to spare; a map takes 8 bytes a pixel
def _maps(camera: CameraModel, pinhole: CameraModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Original pixel coordinates x, y (H, W) f4 of each undistorted pixel, and which lie in the image (H, W) bool."""
    shape = pinhole.height, pinhole.width
    x, y, valid = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, bool)
    (fx, fy, cx, cy), model = pinhole.params, camera.to_pycolmap()
    for rows in row_strips(shape):
        u, v = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(rows.start, rows.stop) + 0.5)
        rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1).reshape(-1, 3)
        at = np.asarray(model.img_from_cam(rays))
        there = (at >= 0).all(axis=1) & (at[:, 0] <= camera.width) & (at[:, 1] <= camera.height)
        back = np.asarray(model.cam_ray_from_img(np.where(there[:, None], at, 0.0)))
        back = back[:, :2] / np.maximum(back[:, 2:], 1e-6)
        error = np.abs(back - rays[:, :2]).max(axis=1) * model.mean_focal_length()
        # A ray that comes back from the image half a pixel off lies where the distortion polynomial folds over.
        valid[rows] = (there & (error < 0.5 * (1 + np.sum(rays[:, :2] ** 2, axis=1)))).reshape(u.shape)
        at = np.where(np.isfinite(at), at, -1e4).astype(np.float32)
        x[rows], y[rows] = at[:, 0].reshape(u.shape), at[:, 1].reshape(u.shape)
    return x, y, valid


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
    # PatchMatch, were it run in the workspace, would choose 20 partners by itself
    (folder / "fusion.cfg").write_text("".join(f"{n}\n" for n in names), encoding="utf-8")
    (folder / "patch-match.cfg").write_text("".join(f"{n}\n__auto__, 20\n" for n in names), encoding="utf-8")
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
