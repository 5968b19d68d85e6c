"""Coded targets on a table, rendered with truth, and a model of the cameras that is right but for place and scale."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.project.settings import Settings
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.scene.targets import dictionary, target_of

EAST, NORTH = 386_000.0, 3_951_000.0  # of the table's zero, EPSG:32654
SIZE, FOCAL = (640, 480), 620.0
PLACES = {  # middles of the targets, metres
    "tag36h11:3": (-0.35, -0.25, 0.00), "tag36h11:7": (0.35, -0.25, 0.06), "tag36h11:12": (0.33, 0.26, 0.02),
    "tag36h11:20": (-0.36, 0.25, 0.08), "tag36h11:31": (0.02, 0.04, 0.12),
}  # fmt: skip
SIDE = 0.14
_MARGIN, _BITS, _BIT_PX, _OVER = 1, 8, 24, 2


@dataclass(frozen=True)
class Table:
    """Where everything truly is: places of names, camera, poses (N, 4, 4) cam_from_world."""

    places: dict[str, np.ndarray]
    camera: pycolmap.Camera
    poses: np.ndarray
    names: tuple[str, ...]


def table(count: int = 8) -> Table:
    """Cameras on an arc above the table."""
    camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=[FOCAL, FOCAL, 322.0, 239.0])
    camera.has_prior_focal_length = True
    poses = []
    for k in range(count):
        turn = 2 * np.pi * k / count
        centre = np.array([0.55 * np.cos(turn), 0.45 * np.sin(turn), 1.1 + 0.1 * np.cos(2 * turn)])
        z = -centre / np.linalg.norm(centre)
        x = np.cross([0.0, 1.0, 0.2], z)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z])
        poses.append(transforms.rigid(rotation, -rotation @ centre))
    places = {n: np.array(p) for n, p in PLACES.items()}
    return Table(places, camera, np.array(poses), tuple(f"{k:03d}.png" for k in range(count)))


def printed(name: str) -> np.ndarray:
    """A target as printed, with its white margin."""
    target = target_of(name)
    assert target is not None
    tag = cv2.aruco.generateImageMarker(dictionary(target.family), target.number, _BITS * _BIT_PX)
    return cv2.copyMakeBorder(tag, *[_MARGIN * _BIT_PX] * 4, cv2.BORDER_CONSTANT, value=255)


def picture(world: Table, image: int, drawn: dict[str, np.ndarray], noise: float = 2.0) -> np.ndarray:
    """(H, W) u1: the table from one camera with names drawn at places; the highest last."""
    rng = np.random.default_rng(image)
    shape = (SIZE[1] * _OVER, SIZE[0] * _OVER)
    out = cv2.GaussianBlur(rng.uniform(60, 190, shape).astype(np.float32), (0, 0), 6.0)
    out = 130 + 8 * (out - out.mean())
    f, _, cx, cy = world.camera.params
    pixels = np.array([[f, 0, cx - 0.5], [0, f, cy - 0.5], [0, 0, 1]])
    fine = np.array([[_OVER, 0, (_OVER - 1) / 2], [0, _OVER, (_OVER - 1) / 2], [0, 0, 1]])
    side = (_BITS + 2 * _MARGIN) * _BIT_PX
    for name, place in sorted(drawn.items(), key=lambda item: item[1][2]):
        metre = SIDE / (_BITS * _BIT_PX)
        middle = (side - 1) / 2
        plane = np.array([[metre, 0, place[0] - metre * middle], [0, -metre, place[1] + metre * middle], [0, 0, 1]])
        pose = world.poses[image]
        to_image = fine @ pixels @ np.column_stack([pose[:3, 0], pose[:3, 1], pose[:3, 2] * place[2] + pose[:3, 3]])
        own = printed(name.partition("#")[0])
        warp = to_image @ plane
        mask = cv2.warpPerspective(np.ones_like(own), warp, shape[::-1], flags=cv2.INTER_NEAREST)
        seen = cv2.warpPerspective(own, warp, shape[::-1], flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE)
        out = np.where(mask > 0, 40 + 0.7 * seen, out)
    small = cv2.resize(cv2.GaussianBlur(out, (0, 0), 0.6 * _OVER), SIZE, interpolation=cv2.INTER_AREA)
    return np.clip(small + noise * rng.standard_normal(small.shape), 0, 255).round().astype(np.uint8)


@cache
def _pictures() -> tuple[np.ndarray, ...]:
    world = table()
    return tuple(picture(world, k, world.places) for k in range(len(world.names)))


def survey(folder: Path, control: str) -> tuple[Any, Table]:
    """The artefacts of a run up to sparse, with a control file of this text; what georef's glue asks of a run."""
    world = table()
    (folder / "images").mkdir()
    for name, pixels in zip(world.names, _pictures()):
        cv2.imwrite(str(folder / "images" / name), pixels)
    count = len(world.names)
    rig = Rig("photographs", (Sensor("camera", world.camera),))
    alone = np.full(count, -1)
    scene = simple_scene(rig, list(world.names), np.arange(count), np.zeros(count, int), alone, sequences=())
    (folder / "network").mkdir()
    (folder / "network/scene.json").write_text(scene.to_json())
    (folder / "sparse/0").mkdir(parents=True)
    moved_model(world).write(str(folder / "sparse/0"))
    (folder / "control.csv").write_text(control)
    settings = Settings()
    georef = settings.georef.model_copy(update={"gcp": folder / "control.csv"})
    run = SimpleNamespace(
        path=folder.joinpath, settings=settings.model_copy(update={"georef": georef}), log=folder / "log.txt",
        inputs=SimpleNamespace(gnss=None, images=folder / "images"), receipts=SimpleNamespace(read=lambda stage: {}),
        map=lambda function, items, *args: [function(item, *args) for item in items],
    )  # fmt: skip
    return run, world


def moved_model(world: Table) -> pycolmap.Reconstruction:
    """The truth, moved and 0.3 times as large, with points that all cameras see to 0.2 px."""
    rng = np.random.default_rng(1)
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=world.camera.params, camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    points = rng.uniform([-0.5, -0.4, 0.0], [0.5, 0.4, 0.15], (60, 3))
    tracks: list[list[tuple[int, int]]] = [[] for _ in points]
    for k, (name, pose) in enumerate(zip(world.names, world.poses)):
        xy = np.asarray(camera.img_from_cam(transforms.apply(pose, points))) + 0.2 * rng.standard_normal((60, 2))
        seen = [j for j in range(60) if 0 < xy[j, 0] < SIZE[0] and 0 < xy[j, 1] < SIZE[1]]
        image = pycolmap.Image(name=name, camera_id=1, image_id=k + 1)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(xy[j]) for j in seen])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
        for n, j in enumerate(seen):
            tracks[j].append((k + 1, n))
    for xyz, track in zip(points, tracks):
        model.add_point3D(xyz, pycolmap.Track([pycolmap.TrackElement(*e) for e in track]), np.zeros(3, np.uint8))
    model.update_point_3d_errors()
    turn = pycolmap.Rotation3d(Rotation.from_rotvec([0.1, 0.4, 1.0]).as_quat())
    model.transform(pycolmap.Sim3d(0.3, turn, np.array([5.0, 1, 2])))
    return model
