"""A simulated corridor survey as a COLMAP model: a ring of four cameras on a boat, one pass, points on two walls.

Everything is true but the observations (noise of half a pixel) and the starting poses, which drift as a random walk; a
bundle adjustment without positions then finds what the images alone say. No image is rendered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

WIDTH, HEIGHT, FOCAL = 640, 480, 400.0
NOISE_PX = 0.5
REACH_M = 25.0  # a point is seen no farther away
SIGHT = 12  # images in a row that see a point at most: how long key points last


@dataclass(frozen=True)
class Corridor:
    """The truth world_from_rig (F, 4, 4), the scene (no positions yet) and the model as the images alone give it."""

    truth: np.ndarray
    scene: Scene
    model: pycolmap.Reconstruction


def corridor(
    length_m: float = 400.0, step_m: float = 2.0, points_per_m: float = 12.0, radial: float = 0.0, seed: int = 0
) -> Corridor:
    """One pass along a gently winding canal of 20 m width.

    ``radial``: distortion that the lenses have and the model's calibrated cameras do not know: it bends the model.
    """
    rng = np.random.default_rng(seed)
    s = np.arange(0.0, length_m, step_m)
    truth = path_of(s)
    cameras = [camera_of(k) for k in range(4)]
    count = int(points_per_m * length_m)
    along, side = rng.uniform(-10, length_m + 10, count), rng.choice([-1.0, 1.0], count)
    base = path_of(along)
    offset = np.stack([side * rng.uniform(9, 14, count), -rng.uniform(-1, 6, count), np.zeros(count)], axis=1)
    xyz = np.einsum("nij,nj->ni", base[:, :3, :3], offset) + base[:, :3, 3]
    names = [f"cam{c}/{k:05d}.jpg" for k in range(len(s)) for c in range(4)]
    seen = sights(truth, cameras, xyz, radial, rng)
    rig = Rig("ring", tuple(Sensor(f"cam{c}", pinhole(c + 1), p, folder=f"cam{c}") for c, p in enumerate(cameras)))
    model = _model(drifted(truth, rng), cameras, xyz + rng.normal(0, 0.05, xyz.shape), seen, names)
    order = np.argsort(names, kind="stable")
    frame, sensor = np.repeat(np.arange(len(s)), 4)[order], np.tile(np.arange(4), len(s))[order]
    scene = simple_scene(
        rig, [names[k] for k in order], frame, sensor, np.zeros(len(s)), sequences=("up",), time_s=s / 1.5
    )
    return Corridor(truth, scene, model)


def path_of(s: np.ndarray) -> np.ndarray:
    """world_from_rig along the canal: x right, y down, z forward."""
    heading = 0.4 * np.sin(s / 60)
    grid = np.arange(-20.0, float(np.max(s)) + 30, 0.1)
    turn = 0.4 * np.sin(grid / 60)
    east, north = np.cumsum(0.1 * np.cos(turn)), np.cumsum(0.1 * np.sin(turn))
    place = np.stack([np.interp(s, grid, east), np.interp(s, grid, north), np.full(len(s), 2.0)], axis=1)
    ahead = np.stack([np.cos(heading), np.sin(heading), np.zeros(len(s))], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (len(s), 1))
    return transforms.rigid(np.stack([np.cross(down, ahead), down, ahead], axis=2), place)


def camera_of(k: int) -> np.ndarray:
    """sensor_from_rig of a ring camera: 90 degrees apart, 10 cm from the middle; the first is the reference."""
    turn = Rotation.from_euler("y", -90.0 * k, degrees=True).as_matrix()
    centre = 0.1 * (turn.T @ [0.0, 0.0, 1.0] - [0.0, 0.0, 1.0])
    return transforms.rigid(turn, -turn @ centre)


def pinhole(camera_id: int) -> pycolmap.Camera:
    params = [FOCAL, WIDTH / 2, HEIGHT / 2, 0.0]
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=params, camera_id=camera_id)
    camera.has_prior_focal_length = True
    return camera


def sights(truth, cameras, xyz, radial, rng) -> list[list[tuple[int, np.ndarray]]]:  # type: ignore[no-untyped-def]
    """Per image (frame by frame, camera by camera): the points it sees and where."""
    out = []
    left = np.full((4, len(xyz)), SIGHT)
    for pose in truth:
        rig_from_world = transforms.invert(pose)
        near = np.flatnonzero(np.linalg.norm(xyz - pose[:3, 3], axis=1) < REACH_M)
        for c, sensor in enumerate(cameras):
            inside = transforms.apply(sensor @ rig_from_world, xyz[near])
            ray = inside[:, :2] / np.maximum(inside[:, 2:], 1e-6)
            xy = FOCAL * ray * (1 + radial * np.sum(ray**2, axis=1, keepdims=True)) + [WIDTH / 2, HEIGHT / 2]
            good = (inside[:, 2] > 1) & (xy > 0).all(axis=1) & (xy < [WIDTH, HEIGHT]).all(axis=1)
            good &= (left[c, near] > 0) & (rng.random(len(near)) < 0.7)
            left[c, near[good]] -= 1
            out.append([(int(p), q) for p, q in zip(near[good], xy[good] + rng.normal(0, NOISE_PX, (good.sum(), 2)))])
    return out


def drifted(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The poses with small steps wrong by a random walk, as a start."""
    steps = transforms.invert(truth[:-1]) @ truth[1:]
    turn = Rotation.from_rotvec(np.radians(0.02) * rng.standard_normal((len(steps), 3))).as_matrix()
    wrong = transforms.rigid(turn, 0.002 * rng.standard_normal((len(steps), 3)))
    out = [truth[0]]
    for step in steps @ wrong:
        out.append(out[-1] @ step)
    return np.array(out)


def _model(poses, cameras, xyz, seen, names) -> pycolmap.Reconstruction:  # type: ignore[no-untyped-def]
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    for c, sensor in enumerate(cameras):
        model.add_camera(pinhole(c + 1))
        identity = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, c + 1)
        if c == 0:
            rig.add_ref_sensor(identity)
        else:
            rig.add_sensor(identity, rigid3d(sensor))
    model.add_rig(rig)
    elements: dict[int, list] = {}
    for k, pose in enumerate(poses):
        frame = pycolmap.Frame(frame_id=k + 1, rig_id=1)
        images = []
        for c in range(4):
            number = 4 * k + c
            points = pycolmap.Point2DList([pycolmap.Point2D(xy) for _, xy in seen[number]])
            image = pycolmap.Image(
                name=names[number], points2D=points, camera_id=c + 1, image_id=number + 1, frame_id=k + 1
            )
            frame.add_data_id(image.data_id)
            images.append(image)
            for n, (p, _) in enumerate(seen[number]):
                elements.setdefault(p, []).append(pycolmap.TrackElement(number + 1, n))
        frame.rig_from_world = rigid3d(transforms.invert(pose))
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(k + 1)
    for p, track in elements.items():
        if len(track) >= 3:
            model.add_point3D(_meet(model, track, xyz[p]), pycolmap.Track(track), np.zeros(3, np.uint8))
    return model


def _meet(model: pycolmap.Reconstruction, track: list, otherwise: np.ndarray) -> np.ndarray:
    """Where the rays of a track meet in the drifted start."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for element in track:
        image = model.image(element.image_id)
        pose = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        ray = np.append(image.camera.cam_from_img(image.points2D[element.point2D_idx].xy), 1.0) @ pose[:3, :3]
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += across
        right += across @ transforms.centre(pose)
    found = np.linalg.solve(normal + 1e-9 * np.eye(3), right)
    return found if np.isfinite(found).all() else otherwise
