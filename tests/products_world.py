"""A slanted plane with a box on it under cameras that look at it, in a frame that is turned into a map or a facade."""

from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.products.frame import Frame
from tiegraph.products.surface import Surface
from tiegraph.scene.results import Cloud

SIZE, BOX, ROOF = (8.0, 6.0), ((3.0, 5.0), (2.0, 4.0)), 2.0  # of the plane from (0, 0), of the box in u and v; w
CHECK, PIXEL, NOISE_M = 0.5, 0.05, 0.02
FACADE = np.array([[0.6, 0.0, -0.8], [-0.8, 0.0, -0.6], [0.0, 1.0, 0.0]])  # columns: along the wall, up, out of it
_PICTURES = {}  # of views by name: the same in every frame


def ground(u, v):
    """w of the plane."""
    return 0.1 * u - 0.05 * v


def in_box(u, v):
    """Whether a place is on the box."""
    return (u > BOX[0][0]) & (u < BOX[0][1]) & (v > BOX[1][0]) & (v < BOX[1][1])


def height(u, v):
    """w of what is seen from outside."""
    return np.where(in_box(u, v), ROOF, ground(u, v))


def colour(u, v, roof):
    """RGB (..., 3) u1 of the checker: grey on the plane, red on the roof."""
    light = (np.floor(u / CHECK) + np.floor(v / CHECK)) % 2 == 1
    value = np.where(light, 200, 60)
    return np.stack([value, np.where(roof, 20, value), np.where(roof, 20, value)], axis=-1).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Scene:
    """The world in a frame (4, 4) world_from_surface."""

    world_from_surface: np.ndarray
    name: str = "map"

    @property
    def surface(self):
        """Its reference surface, all around."""
        low, high = np.array([0.0, 0.0, -5.0]), np.array([*SIZE, 5.0])
        return Surface(self.name, Frame(transforms.invert(self.world_from_surface)), low, high, pixel_m=PIXEL)

    def cloud(self, spacing=0.025, seed=0, together=True):
        """Points of the plane and the roof with noise, and of the sides of the box. Neighbours have their errors
        ``together``, as those of depth maps do, or each its own."""
        rng = np.random.default_rng(seed)
        count = int(SIZE[0] * SIZE[1] / spacing**2)
        u, v = rng.uniform(0, SIZE[0], count), rng.uniform(0, SIZE[1], count)
        error = rng.normal(size=count)
        if together:
            field = cv2.GaussianBlur(rng.normal(size=(140, 180)), None, 2.5)  # of 5 cm
            error = (field / field.std())[(v / PIXEL).astype(int), (u / PIXEL).astype(int)]
        w = height(u, v) + NOISE_M * error
        sides = rng.uniform(size=(count // 20, 2))
        su, sw = np.full(len(sides), BOX[0][0]), 0.2 + sides[:, 1] * (ROOF - 0.2)
        uvw = np.concatenate([np.stack([u, v, w], 1), np.stack([su, BOX[1][0] + 2 * sides[:, 0], sw], 1)])
        normal = np.zeros((len(uvw), 3), np.float32)
        normal[:count, 2], normal[count:, 0] = 1, -1
        return Cloud(
            xyz_m=transforms.apply(self.world_from_surface, uvw),
            rgb=np.zeros((len(uvw), 3), np.uint8),
            normal=(normal @ self.world_from_surface[:3, :3].T).astype(np.float32),
            sigma_m=np.full(len(uvw), NOISE_M, np.float32),
            views=np.full(len(uvw), 3, np.uint8),
        )

    def view(self, name, centre, target, focal=400.0, size=(480, 360)):
        """A camera at a place of the surface's frame that looks at another one."""
        z = np.subtract(target, centre) / np.linalg.norm(np.subtract(target, centre))
        x = np.cross(z, [0.0, 1.0, 0.0])
        x /= np.linalg.norm(x)
        turn = np.stack([x, np.cross(z, x), z])
        pose = transforms.rigid(turn, -turn @ np.asarray(centre, float))
        K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
        return Pinhole(K, pose @ transforms.invert(self.world_from_surface), size=size, name=name)

    def views(self):
        """Nine cameras in a grid at a distance of 9, that overlap by more than half."""
        places = [(u, v) for v in (0.5, 3.0, 5.5) for u in (0.5, 4.0, 7.5)]
        return [self.view(f"{k}.jpg", (u, v, 9.0), (u, v + 1e-3, 0.0)) for k, (u, v) in enumerate(places)]

    def picture(self, view):
        """RGB (H, W, 3) u1 of what a view sees, by the mean of 2 x 2 rays a pixel; nothing is grey 128."""
        if view.name not in _PICTURES:
            _PICTURES[view.name] = self._rendered(view)
        return _PICTURES[view.name]

    def _rendered(self, view):
        surface_from_cam = transforms.invert(view.cam_from_world @ self.world_from_surface)
        width, high = view.size
        total = np.zeros((high, width, 3))
        for dx in (0.25, 0.75):
            for dy in (0.25, 0.75):
                x, y = np.meshgrid(np.arange(width) + dx, np.arange(high) + dy)
                ray = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(view.K).T
                total += self._seen(surface_from_cam[:3, 3], ray @ surface_from_cam[:3, :3].T)
        return np.rint(total / 4).astype(np.uint8)

    def _seen(self, centre, ray):
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = np.array([BOX[0][0], BOX[1][0], -9.0]), np.array([BOX[0][1], BOX[1][1], ROOF])
            a, b = (low - centre) / ray, (high - centre) / ray
            enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
            slope = np.array([0.1, -0.05, -1.0])
            plane = -(slope @ centre) / (ray @ slope)
        hits = (enter < leave) & (enter > 0)
        t = np.where(hits & (enter < plane), enter, plane)
        at = centre + t[..., None] * ray
        roof = hits & (enter < plane)
        side = roof & (at[..., 2] < ROOF - 1e-6)
        rgb = colour(at[..., 0], at[..., 1], roof).astype(float)
        rgb[side] = (20, 20, 220)
        beyond = (at[..., :2] < 0).any(-1) | (at[..., :2] > SIZE).any(-1)
        rgb[beyond & ~roof] = 128
        return rgb


MAP = Scene(np.eye(4))
WALL = Scene(transforms.rigid(FACADE, [10.0, -20.0, 3.0]), "elevation1")
