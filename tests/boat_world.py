"""A synthetic boat survey between two walls: a rig of side cameras, passes there and back, previews by geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

HALF_WIDTH_M = 10.0
SEES_M = 30.0
CHANCE = 9  # preview matches of unrelated images


@dataclass(frozen=True)
class Result:
    """What a preview match gives."""

    inliers: int
    rotation: np.ndarray | None = None
    shift: np.ndarray | None = None
    matches: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.uint16))


def ring(count: int = 5, up: bool = True, nominal: bool = True) -> Rig:
    """Side cameras at equal angles, clockwise seen from above, and one that looks up."""
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[310.0, 320.0, 240.0])
    sensors = []
    for k in range(count):
        rotation = Rotation.from_euler("y", -360 * k / count, degrees=True).as_matrix()
        sensors.append(Sensor(f"cam{k}", camera, transforms.rigid(rotation, np.zeros(3)), "side"))
    if up:
        rotation = Rotation.from_euler("x", -90, degrees=True).as_matrix()
        sensors.append(Sensor(f"cam{count}", camera, transforms.rigid(rotation, np.zeros(3)), "up"))
    return Rig("ring", tuple(sensors), nominal=nominal)


@dataclass
class World:
    """A scene, its true poses, and a match function that counts its calls."""

    scene: Scene
    world_from_sensor: np.ndarray  # (N, 4, 4), z up
    seed: int = 0
    asked: int = 0
    pairs_asked: set | None = None
    alike: World | None = None  # the second pass elsewhere, where it would see walls that look like those it sees

    def overlap(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) share of 24 rays of image i whose wall point image j sees well."""
        rays = np.stack([np.tan(np.radians(np.linspace(-44, 44, 24))), np.full(24, -0.05), np.ones(24)], axis=1)
        pose = self.world_from_sensor
        ahead = np.einsum("kab,rb->kra", pose[i, :3, :3], rays)
        origin = pose[i, None, :3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (np.sign(ahead[..., 1]) * HALF_WIDTH_M - origin[..., 1]) / ahead[..., 1]
        level = (np.abs(ahead[..., 2]) < 0.9 * np.linalg.norm(ahead, axis=-1)) & (length > 0) & (length < SEES_M)
        point = origin + np.where(level, length, 1.0)[..., None] * ahead
        local = np.einsum("kba,krb->kra", pose[j, :3, :3], point - pose[j, None, :3, 3])
        depth = local[..., 2]
        seen = level & (depth > 0.5) & (np.abs(local[..., 0]) < 1.03 * depth) & (np.abs(local[..., 1]) < 0.78 * depth)
        near = np.linalg.norm(local, axis=-1)
        seen &= (near < SEES_M) & (near < 2.5 * length) & (near > length / 2.5)
        a, b = point - origin, point - pose[j, None, :3, 3]
        cosine = np.sum(a * b, axis=-1) / np.maximum(np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1), 1e-9)
        return np.mean(seen & (cosine > np.cos(np.radians(45))), axis=1)

    @property
    def step(self) -> np.ndarray:
        """(N,) number of each image's frame in its pass."""
        return self.scene.sequence_index[self.scene.frame]

    @property
    def track(self) -> np.ndarray:
        """(N,) pass of each image."""
        return self.scene.sequence[self.scene.frame]

    def useful(self, least: float = 0.15) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Every pair i, j (K,), and whether its overlap is enough."""
        i, j = np.triu_indices(len(self.scene), 1)
        return i, j, np.maximum(self.overlap(i, j), self.overlap(j, i)) >= least

    def across(self, least: float = 0.15) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As ``useful``, of two passes only."""
        i, j, good = self.useful(least)
        return i, j, good & self.of_two_passes(i, j)

    def of_two_passes(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """(K,) bool."""
        return self.track[i] != self.track[j]

    def only(self, keep: np.ndarray) -> World:
        """The survey with only some images (N,) bool; frames that lose all of theirs go too."""
        scene, frames = self.scene, np.unique(self.scene.frame[keep])
        place = np.full(scene.frames, -1)
        place[frames] = np.arange(len(frames))
        names = ("rig", "sequence", "sequence_index", "time_s", "world_from_rig", "section", "position_sigma_m")
        less = scene.with_(
            names=tuple(np.array(scene.names)[keep]), frame=place[scene.frame[keep]], sensor=scene.sensor[keep],
            **{n: getattr(scene, n)[frames] for n in names},
        )  # fmt: skip
        return World(less, self.world_from_sensor[keep])

    def seen_from(self, at: np.ndarray) -> World:
        """The survey with image k seen from where image ``at[k]`` was."""
        return World(self.scene, self.world_from_sensor[at])

    def match(self, pairs: np.ndarray) -> list[Result]:
        """Preview results of image pairs (P, 2)."""
        self.asked += len(pairs)
        if self.pairs_asked is not None:
            self.pairs_asked.update(map(tuple, pairs.tolist()))
        i, j = pairs[:, 0], pairs[:, 1]
        share = np.maximum(self.overlap(i, j), self.overlap(j, i))
        if self.alike is not None:
            share = np.maximum(share, 0.7 * np.maximum(self.alike.overlap(i, j), self.alike.overlap(j, i)))
        noise = np.random.default_rng(self.seed + int(np.sum(pairs[:, 0]) % 1000)).poisson(1.5, len(pairs))
        counts = np.round(CHANCE - 1 + noise + 60 * share).astype(int)
        relative = transforms.invert(self.world_from_sensor[j]) @ self.world_from_sensor[i]
        same = self.scene.frame[i] == self.scene.frame[j]
        return [
            Result(int(c), r[:3, :3], _shift(r[:3, :3]) if s else np.zeros(2), np.zeros((int(c), 2), np.uint16))
            for c, r, s in zip(counts, relative, same)
        ]


def _shift(b_from_a: np.ndarray) -> np.ndarray:
    """Motion in the picture of the direction midway between two axes, as a share of the image size."""
    middle_b = b_from_a @ np.array([0, 0, 1.0]) + np.array([0, 0, 1.0])
    middle_a = b_from_a.T @ middle_b
    return (middle_b[:2] / max(middle_b[2], 0.1) - middle_a[:2] / max(middle_a[2], 0.1)) / 2


def boat(
    frames: tuple[int, ...] = (12, 12), spacing_m: tuple[float, ...] = (2.0, 2.0), rig: Rig | None = None
) -> World:
    """Passes along the canal, every second one back; ``spacing_m`` is the speed of each pass."""
    rig = rig or ring()
    names, frame, sensor, track, step, poses = [], [], [], [], [], []
    forward = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])  # world_from_rig: z ahead along x, y down
    end = max(n * s for n, s in zip(frames, spacing_m))
    count = 0
    for p, (n, spacing) in enumerate(zip(frames, spacing_m)):
        back = p % 2 == 1
        turn = np.diag([-1.0, -1.0, 1.0]) if back else np.eye(3)
        for k in range(n):
            x = end - k * spacing if back else k * spacing
            where = np.array([x, 1.5 if back else -1.5, 2.0])
            poses.append(transforms.rigid(turn @ forward, where))
            for s in range(len(rig.sensors)):
                names.append(f"{'there' if not back else 'back'}{p}/cam{s}/{k:04d}.jpg")
                frame.append(count), sensor.append(s)
            track.append(p), step.append(k)
            count += 1
    order = np.argsort(names)
    frame_, sensor_ = np.array(frame)[order], np.array(sensor)[order]
    tracks = tuple(f"{'back' if p % 2 else 'there'}{p}" for p in range(len(frames)))
    scene = simple_scene(
        rig, [names[k] for k in order], frame_, sensor_, np.array(track), np.array(step), sequences=tracks
    )
    true = ring(sum(s.role != "up" for s in rig.sensors), any(s.role == "up" for s in rig.sensors))
    from_rig = np.stack([transforms.invert(s.sensor_from_rig) for s in true.sensors])
    return World(scene, np.stack(poses)[frame_] @ from_rig[sensor_])


def found(pairs, useful: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Recall and precision of kept pairs against pairs i, j and whether they are useful."""
    i, j, good = useful
    kept, n = pairs.kept(), int(j.max()) + 1
    true = np.zeros((n, n), bool)
    true[i, j] = good
    hit = true[kept.i, kept.j].sum()
    return float(hit / max(good.sum(), 1)), float(hit / max(len(kept), 1))


def quality(world: World, pairs) -> tuple[float, float, float]:
    """Recall, precision, and recall between passes."""
    i, j, good = world.useful()
    return *found(pairs, (i, j, good)), found(pairs, (i, j, good & world.of_two_passes(i, j)))[0]


def photos(count: int) -> Scene:
    """Loose photographs of one camera."""
    return simple_scene(
        Rig("camera", (Sensor("camera"),)), [f"{k:03d}.jpg" for k in range(count)], np.arange(count), np.zeros(count)
    )
