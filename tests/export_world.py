"""A finished survey without a run: a tilted plane with bright spots, two cameras on a rig, two passes, known poses."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

import tiegraph
from tiegraph.api import Project
from tiegraph.dense.plan import CameraModel
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.undistort import pinhole_of
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.scene.colmapmodel import add_rig, matrix, rigid3d
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import DepthMap, save_depth
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SIZE, SPOT_PX, FRAMES = (320, 240), 1.7, 3
ORIGIN = Origin(35.6965, 139.769447, 39.5, crs="EPSG:32654", shift_m=(388700.0, 3951000.0, 40.0))
LENSES = {
    "OPENCV": [190.0, 191.0, 163.0, 118.0, -0.05, 0.01, 1e-3, -5e-4],
    "SIMPLE_RADIAL": [188.0, 157.0, 123.0, -0.06],
    "FULL_OPENCV": [190.0, 191.0, 163.0, 118.0, -0.05, 0.01, 1e-3, -5e-4, 1e-3, 2e-3, 0.0, 0.0],
    "OPENCV_FISHEYE": [150.0, 151.0, 162.0, 119.0, 0.02, -0.004, 1e-3, 0.0],
    "PINHOLE": [190.0, 190.0, 160.0, 120.0],
}
NORMAL, FAR = np.array([0.1, -0.2, 1.0]), 6.0  # the plane NORMAL @ x = FAR
NOTHING = ("cam1", "000000")  # an image without mask and depth map


@dataclass(frozen=True)
class Made:
    """The project, its model in the world, its scene and the true spots (P, 3), world metres."""

    project: Project
    model: pycolmap.Reconstruction
    scene: Scene
    points: np.ndarray


def camera_of(model: str) -> pycolmap.Camera:
    return pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=LENSES[model])


def finished(
    folder: Path, lenses: tuple[str, str] = ("OPENCV", "SIMPLE_RADIAL"), origin: Origin | None = ORIGIN
) -> Made:
    """What stands in a run folder after `dense`, as far as an export reads it."""
    cameras, out = [camera_of(name) for name in lenses], folder / "out"
    mounts = [np.eye(4), rigid(Rotation.from_rotvec([0.02, 0.15, -0.03]).as_matrix(), np.array([-0.4, 0.05, 0.1]))]
    sensors = tuple(Sensor(f"cam{k}", cameras[k], mounts[k]) for k in (0, 1))
    names = sorted(
        f"{p}/cam{c}/{f:06d}.{('jpg', 'png')[c]}" for p in ("down", "up") for c in (0, 1) for f in range(FRAMES)
    )
    frame = np.array([FRAMES * n.startswith("up") + int(n[-10:-4]) for n in names])
    scene = simple_scene(
        Rig("head", sensors), names, frame, np.array(["cam1" in n for n in names], int),
        sequence=np.repeat([0, 1], FRAMES), sequence_index=np.tile(np.arange(FRAMES), 2), sequences=("down", "up"),
        time_s=1.6e9 + 0.5 * np.arange(2 * FRAMES), origin=origin,
    )  # fmt: skip
    rng = np.random.default_rng(3)
    xy = np.stack(np.meshgrid(np.arange(-4.0, 8, 1.1), np.arange(-4.0, 4, 1.1)), axis=-1).reshape(-1, 2)
    xy += rng.uniform(-0.15, 0.15, xy.shape)
    points = np.c_[xy, FAR - xy @ NORMAL[:2]]
    poses = [
        rigid(
            Rotation.from_rotvec(rng.normal(0, 0.05, 3)).as_matrix(), np.array([0.9 * f, 0.3 * (f >= FRAMES), 0.1 * f])
        )
        for f in range(2 * FRAMES)
    ]
    model = _model(scene, cameras, mounts, poses, points)
    for image in model.images.values():
        _write_image(folder / "images" / image.name, image)
    (out / "network").mkdir(parents=True)
    (out / "images").symlink_to(folder / "images")
    for path in (out / "scene.json", out / "network" / "scene.json"):
        path.write_text(scene.to_json())
    (out / "sparse" / "world").mkdir(parents=True)
    model.write(str(out / "sparse" / "world"))
    error = {"middle": [0, 0, 0], "covariance": np.diag([1e-6] * 3 + [4e-4] * 3 + [1e-8]).tolist()}
    world = {"scale_source": "gnss", "origin": None if origin is None else origin.to_dict(), "placement_error": error}
    (out / "world.json").write_text(json.dumps(world))
    pairs = Pairs.make(np.array([0, 0, 1]), np.array([1, 2, 3]), "offsets", inliers=np.array([50, 20, 10]))
    np.savez(out / "match.npz", **{n: getattr(pairs, n) for n in pairs.columns()})
    _write_masks_and_depth(out, model)
    return Made(tiegraph.open(folder / "images", out, pool="serial"), model, scene, points)


def _model(scene, cameras, mounts, poses, points) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    add_rig(model, cameras, [rigid3d(m) for m in mounts])
    seen: dict[int, list] = {}
    for number, pose in enumerate(poses):
        frame = pycolmap.Frame(frame_id=number + 1, rig_id=1)
        own = [int(k) for k in np.flatnonzero(scene.frame == number)]
        for k in own:
            frame.add_data_id(pycolmap.data_t(model.camera(1 + int(scene.sensor[k])).sensor_id, k + 1))
        frame.rig_from_world = rigid3d(invert(pose))
        model.add_frame(frame)
        for k in own:
            sensor = int(scene.sensor[k])
            there = points @ (mounts[sensor] @ invert(pose))[:3, :3].T + (mounts[sensor] @ invert(pose))[:3, 3]
            at = np.asarray(cameras[sensor].img_from_cam(there))
            inside = (there[:, 2] > 0.5) & (at > 8).all(axis=1) & (at < np.array(SIZE) - 8).all(axis=1)
            image = pycolmap.Image(name=scene.names[k], camera_id=1 + sensor, image_id=k + 1, keypoints=at[inside])
            image.frame_id = frame.frame_id
            model.add_image(image)
            for row, point in enumerate(np.flatnonzero(inside)):
                seen.setdefault(int(point), []).append(pycolmap.TrackElement(k + 1, row))
        model.register_frame(frame.frame_id)
    for point, track in sorted(seen.items()):
        if len(track) > 1:
            model.add_point3D(points[point], pycolmap.Track(track), np.array([point % 256, 100, 200], np.uint8))
    return model


def _write_image(path: Path, image: pycolmap.Image) -> None:
    """Bright spots on grey where the key points are; COLMAP's pixels have their middle at a half."""
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    light = np.full(u.shape, 30.0)
    for point in image.points2D:
        light += 200 * np.exp(-((u - point.xy[0]) ** 2 + (v - point.xy[1]) ** 2) / (2 * SPOT_PX**2))
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.repeat(np.clip(light, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    cv2.imwrite(str(path), pixels, [cv2.IMWRITE_JPEG_QUALITY, 98] if path.suffix == ".jpg" else [])


def _write_masks_and_depth(out: Path, model: pycolmap.Reconstruction) -> None:
    for image in model.images.values():
        if all(part in image.name for part in NOTHING):
            continue
        mask = np.full(SIZE[::-1], 255, np.uint8)
        mask[:, :40] = 0
        for path in (out / "refine" / "masks" / f"{image.name}.png",):
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), mask)
        K, (width, height) = pinhole_of(CameraModel.of(model.camera(image.camera_id)), DenseSettings())
        pose = matrix(image.cam_from_world())
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
        depth = plane_depth(pose, rays).astype(np.float32)
        save_depth(
            DepthMap(image.name, depth, 0.01 * depth, np.full(depth.shape, 3, np.uint8), K, pose),
            out / "depth" / f"{image.name}.npz",
        )


def plane_depth(cam_from_world: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(...) depth of the plane along rays (..., 3) with z = 1 of a camera; NaN behind it."""
    world_from_cam = invert(cam_from_world)
    depth = (FAR - NORMAL @ world_from_cam[:3, 3]) / (rays @ world_from_cam[:3, :3].T @ NORMAL)
    return np.where(depth > 0, depth, np.nan)


def spot_near(grey: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(2,) the middle of the spot near a pixel (2,), as COLMAP counts pixels; NaN where there is none."""
    reach = 7
    x, y = (int(n) for n in np.floor(at))
    if min(x, y) < reach or x + reach >= grey.shape[1] or y + reach >= grey.shape[0]:
        return np.full(2, np.nan)
    part = np.clip(grey[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(float) - 40, 0, None)
    v, u = np.mgrid[y - reach : y + reach + 1, x - reach : x + reach + 1] + 0.5
    return np.array([(u * part).sum(), (v * part).sum()]) / part.sum() if part.max() > 100 else np.full(2, np.nan)
