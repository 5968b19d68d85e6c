"""A two-camera rig that moves past random points; each point has its own descriptor, so that matches are exact."""

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.colmapdatabase import write_features
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

WIDTH, HEIGHT, FOCAL = 640, 480, 500.0
FRAMES, POINTS = 6, 400


def camera() -> pycolmap.Camera:
    return pycolmap.Camera(model="PINHOLE", width=WIDTH, height=HEIGHT, params=[FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2])


def rig(known: bool = True) -> Rig:
    turned = transforms.rigid(Rotation.from_euler("y", -20, degrees=True).as_matrix(), np.array([-0.1, 0.0, 0.0]))
    return Rig("pair", (Sensor("cam0", camera(), np.eye(4)), Sensor("cam1", camera(), turned if known else None)))


def scene(known: bool = True, space: bool = False) -> Scene:
    """Frames x 2 images; image k is of frame k // 2 and sensor k % 2."""
    gap = " " if space else "_"
    names = [f"cam{k % 2}/img{gap}{k // 2:02d}.jpg" for k in range(2 * FRAMES)]
    index = np.arange(2 * FRAMES)
    return simple_scene(rig(known), names, index // 2, index % 2)


def poses() -> np.ndarray:
    """(F, 4, 4) rig_from_world: sideways steps of 0.5 m, slightly turned."""
    turn = Rotation.from_rotvec(np.radians(np.outer(np.linspace(0, 4, FRAMES), [0, 1, 0]))).as_matrix()
    return transforms.rigid(turn, np.stack([-0.5 * np.arange(FRAMES), np.zeros(FRAMES), np.zeros(FRAMES)], 1))


def features(seed: int = 0, empty: tuple[int, ...] = ()) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Key points with 0.3 px noise and descriptors of every image; ``empty`` images have none."""
    rng = np.random.default_rng(seed)
    world = np.c_[rng.uniform(-6, 9, POINTS), rng.uniform(-3, 3, POINTS), rng.uniform(5, 12, POINTS)]
    vectors = rng.gamma(0.5, 40, (POINTS, 128))
    vectors = np.clip(512 * np.sqrt(vectors / vectors.sum(1, keepdims=True)), 0, 255).astype(np.uint8)
    out = []
    for k in range(2 * FRAMES):
        cam_from_world = rig().sensors[k % 2].sensor_from_rig @ poses()[k // 2]
        local = transforms.apply(cam_from_world, world)
        xy = FOCAL * local[:, :2] / local[:, 2:] + [WIDTH / 2, HEIGHT / 2] + rng.normal(0, 0.3, (POINTS, 2))
        seen = (local[:, 2] > 0) & (xy > 0).all(1) & (xy < [WIDTH, HEIGHT]).all(1) & (k not in empty)
        keypoints = np.c_[xy, np.full(POINTS, 3.0), np.zeros(POINTS)][seen].astype(np.float32)
        out.append((k, keypoints, vectors[seen]))
    return out


def filled_database(path, scene_, empty: tuple[int, ...] = ()):
    create_database(path, scene_)
    write_features(path, features(empty=empty))
    return path
