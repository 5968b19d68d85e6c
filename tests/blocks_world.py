"""A large survey that is mapped in blocks: there and back along a gentle bend, its ties, and models of it."""

from __future__ import annotations

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

FRAMES = 240  # of each of two passes, there and back, of two cameras: 960 images
SEES = 25.0  # frames
STEP_M = 2.0
WALL_M = 12.0
CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[310.0, 320, 240])


def survey() -> tuple[Scene, np.ndarray]:
    """Scene and true cam_from_world (N, 4, 4): along a gentle bend and back, a camera to either side."""
    rig = Rig("pair", (Sensor("left", CAMERA, np.eye(4)), Sensor("right", CAMERA, np.diag([-1.0, 1, -1, 1]))))
    frame, sensor = np.repeat(np.arange(2 * FRAMES), 2), np.tile([0, 1], 2 * FRAMES)
    names = [f"{'back' if f >= FRAMES else 'there'}/{s}/{f % FRAMES:04d}.jpg" for f, s in zip(frame, sensor)]
    order = np.array(sorted(range(len(names)), key=lambda k: names[k]))
    frame, sensor = frame[order], sensor[order]
    track, step = np.repeat([1, 0], FRAMES), np.tile(np.arange(FRAMES), 2)
    scene = simple_scene(rig, [names[k] for k in order], frame, sensor, track, step, sequences=("back", "there"))
    return scene, np.stack([pose(int(f), int(s)) for f, s in zip(frame, sensor)])


def place(frame: int) -> float:
    """How far along the way a frame was taken, in frames."""
    return float(2 * FRAMES - 1 - frame if frame >= FRAMES else frame)


def pose(frame: int, sensor: int) -> np.ndarray:
    along, bend = STEP_M * place(frame), np.radians(0.2) * place(frame)
    heading = bend + (np.pi if frame >= FRAMES else 0.0)
    yaw = heading + (np.pi / 2 if sensor == 0 else -np.pi / 2)
    ahead, right = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([np.sin(yaw), -np.cos(yaw), 0])
    rotation = np.stack([right, [0, 0, -1.0], ahead])
    centre = [along * np.cos(bend / 2), along * np.sin(bend / 2), 0.3 if frame >= FRAMES else 0.0]
    return transforms.rigid(rotation, -rotation @ centre)


def ties_of(scene: Scene) -> PreviewMatches:
    """Images that look to one side tie over SEES frames of the way, the more the nearer; of both passes."""
    where = np.array([place(int(f)) for f in scene.frame])
    side = (scene.sensor == 0) ^ (scene.frame >= FRAMES)
    i, j = np.triu_indices(len(scene), 1)
    apart = np.abs(where[i] - where[j])
    good = np.flatnonzero((apart < SEES) & (side[i] == side[j]) & (np.random.default_rng(0).random(len(i)) < 0.3))
    count = (15 + 60 * (1 - apart[good] / SEES)).astype(int)
    start = np.concatenate([[0], np.cumsum(count)])
    return PreviewMatches(i[good], j[good], start, np.zeros((start[-1], 2), np.uint16))


class Mapper:
    """Makes exact models in frames and units of their own; ``broken``: number of a block that tears in the middle."""

    def __init__(self, scene: Scene, truth: np.ndarray, noise_m: float = 0.0, broken: int | None = None) -> None:
        self.truth = dict(zip(scene.names, truth))
        self.rng = np.random.default_rng(3)
        self.noise_m, self.broken = noise_m, broken
        self.sizes: list[int] = []

    def __call__(self, scene: Scene, ties: PreviewMatches) -> CoarseModel:
        assert ties.i.max() < len(scene)
        pose = np.stack([self.truth[name] for name in scene.names])
        centre = transforms.centre(pose) + self.rng.normal(0, self.noise_m, (len(pose), 3))
        if self.broken == len(self.sizes):
            late = np.linalg.norm(centre, axis=1) > np.median(np.linalg.norm(centre, axis=1))
            centre[late] += 30.0 * self.rng.normal(size=3)
            turn = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
            pose[late, :3, :3] = pose[late, :3, :3] @ turn.T
        self.sizes.append(len(scene))
        own = Similarity(
            self.rng.uniform(0.2, 5), Rotation.random(random_state=len(self.sizes)).as_matrix(), self.rng.normal(size=3)
        )
        rotation = pose[:, :3, :3] @ own.rotation.T
        moved = own(centre)
        point = own(centre + WALL_M * pose[:, 2, :3])
        cam_from_own = transforms.rigid(rotation, -np.einsum("kab,kb->ka", rotation, moved))
        # Every image observes its own wall point twelve times, and that of the next image once.
        n = np.arange(len(pose))
        image, seen = np.concatenate([np.repeat(n, 12), n[1:]]), np.concatenate([np.repeat(n, 12), n[:-1]])
        return CoarseModel(cam_from_own, (CAMERA,) * len(pose), point, image, seen, scene.rigs)
