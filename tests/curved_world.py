"""A tunnel on a bend and a round tower, each with a bulge of 5 cm, and cameras that pass them.

The axis of the tunnel is an arc in plan, counter-clockwise, so that its coordinates need no search."""

from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.products.surface import Survey
from tiegraph.scene.results import Cloud

NOISE_M, CHECK, PIXEL = 0.01, 0.5, 0.02
BULGE_M, BELL_M = 0.05, 0.35  # height, and sigma of its Gaussian
MIDDLE = np.array([40.0, -15.0, 6.0])  # of the bend, or of the tower on the ground
SHIFT = np.array([500.0, 4000.0, 10.0])


class Swept:
    """What both have; ``rolled`` gives world points (..., 3) of s, v and w, ``unrolled`` is its inverse."""

    def bulge(self, s, v):
        """Its height (...)."""
        return BULGE_M * np.exp(-0.5 * ((s - self.at[0]) ** 2 + (v - self.at[1]) ** 2) / BELL_M**2)

    def cloud(self, spacing=0.12, seed=0, noise=NOISE_M, around=None):
        """Points with true normals, of all or so many metres ``around`` the bulge; neighbours share their errors."""
        rng = np.random.default_rng(seed)
        (s0, s1), (v0, v1) = self.extent
        if around is not None:
            (s0, s1), (v0, v1) = ((at - around, at + around) for at in self.at)
        count = int((s1 - s0) * (v1 - v0) / spacing**2)
        s, v = rng.uniform(s0, s1, count), rng.uniform(v0, v1, count)
        field = cv2.GaussianBlur(rng.normal(size=(int((v1 - v0) / PIXEL) + 2, int((s1 - s0) / PIXEL) + 2)), None, 2.0)
        error = (field / field.std())[((v - v0) / PIXEL).astype(int), ((s - s0) / PIXEL).astype(int)]
        xyz = self.rolled(s, v, self.bulge(s, v) + noise * error)
        normal = (self.rolled(s, v, 1.0) - self.rolled(s, v, 0.0)).astype(np.float32)
        return Cloud(xyz, np.zeros((count, 3), np.uint8), normal, np.full(count, noise, np.float32), np.full(count, 3))

    def survey(self):
        """What the choice needs, with cameras on the path that look at the surface."""
        path = self.path()
        to = [
            (s, (-1) ** k * 2.0 if isinstance(self, Tunnel) else v) for k, (s, v, _) in enumerate(self.unrolled(path))
        ]
        views = [look(f"{k}.jpg", p, self.rolled(*at, 0.0)) for k, (p, at) in enumerate(zip(path, to))]
        return Survey(self.cloud(seed=1), views, 0.04, SHIFT, path=path)

    def picture(self, camera):
        """RGB (H, W, 3) u1 of the checker in a camera, by the mean of 2 x 2 rays a pixel, which go on by 0.9 of their
        distance from the surface."""
        world_from_cam, total = transforms.invert(camera.cam_from_world), np.zeros(camera.size[::-1])
        for dx, dy in ((0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75)):
            x, y = np.meshgrid(np.arange(camera.size[0]) + dx, np.arange(camera.size[1]) + dy)
            ray = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T @ world_from_cam[:3, :3].T
            ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
            at = np.broadcast_to(world_from_cam[:3, 3], ray.shape).copy()
            for _ in range(16):
                s, v, w = np.moveaxis(self.unrolled(at), -1, 0)
                at += (0.9 * (w - self.bulge(s, v)))[..., None] * ray
            s, v, w = np.moveaxis(self.unrolled(at), -1, 0)
            light = np.where((np.floor(s / CHECK) + np.floor(v / CHECK)) % 2 == 1, 200.0, 60.0)
            (s0, s1), (v0, v1) = self.extent
            total += np.where((np.abs(w) < 0.2) & (s > s0) & (s < s1) & (v > v0) & (v < v1), light, 128.0)
        return np.repeat(np.rint(total / 4).astype(np.uint8)[..., None], 3, axis=-1)


@dataclass(frozen=True)
class Tunnel(Swept):
    """A tube of a radius round an arc of a radius ``bend`` and a length (m)."""

    radius: float = 3.0
    bend: float = 25.0
    length: float = 30.0
    at: tuple = (13.0, 2.0)  # s and v of the bulge
    extent = property(lambda self: ((0.0, self.length), (-np.pi * self.radius, np.pi * self.radius)))  # of s and v

    def unrolled(self, xyz):
        off = xyz - MIDDLE
        x, y = np.hypot(off[..., 0], off[..., 1]) - self.bend, off[..., 2]
        s = self.bend * np.arctan2(off[..., 1], off[..., 0])
        return np.stack([s, self.radius * np.arctan2(x, y), self.radius - np.hypot(x, y)], -1)

    def rolled(self, s, v, w):
        r, angle, turn = self.radius - w, np.divide(v, self.radius), np.divide(s, self.bend)
        out = self.bend + r * np.sin(angle)
        return MIDDLE + np.stack([out * np.cos(turn), out * np.sin(turn), r * np.cos(angle)], -1)

    def path(self, count=31):
        """(count, 3) places to the right of the axis and below it, that sway a little."""
        s = np.linspace(0, self.length, count)
        wide, turn = self.bend + 0.4 + 0.1 * np.sin(s), s / self.bend
        return MIDDLE + np.stack([wide * np.cos(turn), wide * np.sin(turn), 0.05 * np.cos(2 * s) - 0.8], -1)


@dataclass(frozen=True)
class Tower(Swept):
    """A vertical cylinder seen from outside: s counter-clockwise from north, v up."""

    radius: float = 4.0
    high: float = 8.0
    at: tuple = (6.0, 4.0)
    extent = property(lambda self: ((0.0, 2 * np.pi * self.radius), (0.0, self.high)))

    def unrolled(self, xyz):
        off = xyz - MIDDLE
        s = self.radius * (np.arctan2(off[..., 1], off[..., 0]) - np.pi / 2) % (2 * np.pi * self.radius)
        return np.stack([s, off[..., 2], np.hypot(off[..., 0], off[..., 1]) - self.radius], -1)

    def rolled(self, s, v, w):
        angle, r = np.divide(s, self.radius) + np.pi / 2, self.radius + w
        return MIDDLE + np.stack([r * np.cos(angle), r * np.sin(angle), v + 0 * angle], -1)

    def path(self, count=61, turns=1.3):
        """(count, 3) places round it, more than once, that sway a little."""
        s = np.linspace(0, turns * 2 * np.pi * self.radius, count)
        return self.rolled(s, 3 + 0.1 * np.sin(s), 5.0 + 0.2 * np.sin(2 * s))


def look(name, centre, target, focal=200.0, size=(320, 240)):
    """An upright camera at a place of the world that looks at another one."""
    z = np.subtract(target, centre) / np.linalg.norm(np.subtract(target, centre))
    x = np.cross(z, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(z, [0.0, 0.0, 1.0]))
    turn = np.stack([x, np.cross(z, x), z])
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    return Pinhole(K, transforms.rigid(turn, -turn @ np.asarray(centre, float)), size=size, name=name)
