"""A painted box that stands on the ground, the points of its five sides, and cameras around and above it."""

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.mesh.surface import Mesh
from tiegraph.scene.results import Cloud, DepthMap

SIZE = np.array([4.0, 3.0, 2.0])  # from (0, 0, 0)
SPACING, NOISE_M = 0.04, 0.004
GREY = 128  # of what is no box


def colour(xyz, stripes=25.0):
    """RGB (..., 3) f8 painted on places: waves longer than the faces of a mesh, and stripes every half metre."""
    x, y, z = np.moveaxis(np.asarray(xyz, float), -1, 0)
    wave = np.stack([np.sin(1.5 * x + z), np.cos(1.7 * y - x), np.sin(2 * z + y)], axis=-1)
    stripe = np.where(np.floor((x + y + z) / 0.5) % 2 == 1, stripes, -stripes)
    return 120 + 60 * wave + stripe[..., None]


def distance(xyz):
    """(N,) distance of places (N, 3) to the five sides, the bottom open."""
    sides = []
    for k in range(3):
        for end in (0.0, SIZE[k]):
            if (k, end) != (2, 0.0):
                near = np.clip(xyz, 0, SIZE)
                near[:, k] = end
                sides.append(np.linalg.norm(near - xyz, axis=1))
    return np.min(sides, axis=0)


def surface(spacing=SPACING, seed=0):
    """Places (N, 3) on the five sides and their normals (N, 3)."""
    rng, places, normals = np.random.default_rng(seed), [], []
    for k in range(3):
        others = [a for a in range(3) if a != k]
        for end in (0.0, SIZE[k]):
            if (k, end) == (2, 0.0):
                continue
            grid = np.stack(np.meshgrid(*(np.arange(spacing / 2, SIZE[a], spacing) for a in others)), -1).reshape(-1, 2)
            place, normal = np.zeros((len(grid), 3)), np.zeros((len(grid), 3))
            place[:, others] = grid + rng.uniform(-0.3, 0.3, grid.shape) * spacing
            place[:, k], normal[:, k] = end, 1.0 if end else -1.0
            places.append(place)
            normals.append(normal)
    return np.concatenate(places), np.concatenate(normals)


def cloud(noise=NOISE_M, seed=0):
    """The points of the box, with noise along their normals."""
    xyz, normal = surface()
    error = noise * np.random.default_rng(seed).normal(size=(len(xyz), 1))
    return Cloud(
        xyz_m=xyz + error * normal,
        rgb=np.clip(colour(xyz), 0, 255).astype(np.uint8),
        normal=normal.astype(np.float32),
        sigma_m=np.full(len(xyz), noise, np.float32),
        views=np.full(len(xyz), 4, np.uint8),
    )


def true_mesh(cells=20):
    """The sides of the box as triangles, so many squares along each edge."""
    xyz, corners = [], []
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        for end in (0.0, SIZE[k]):
            if (k, end) == (2, 0.0):
                continue
            s, t = np.meshgrid(np.linspace(0, SIZE[a], cells + 1), np.linspace(0, SIZE[b], cells + 1))
            place = np.zeros((s.size, 3))
            place[:, a], place[:, b], place[:, k] = s.ravel(), t.ravel(), end
            n = np.arange(s.size).reshape(s.shape)
            squares = np.stack([n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]], axis=-1).reshape(-1, 4)
            faces = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
            corners.append((faces if end else faces[:, ::-1]) + sum(len(p) for p in xyz))
            xyz.append(place)
    together = np.round(np.concatenate(xyz), 9)
    one, back = np.unique(together, axis=0, return_inverse=True)
    rgb = np.clip(colour(one), 0, 255).astype(np.uint8)
    return Mesh(one, back.ravel()[np.concatenate(corners)].astype(np.int64), rgb)


def view(name, centre, focal=500.0, size=(480, 360), target=SIZE / 2):
    """A camera at a place that looks at another one, upright."""
    z = np.subtract(target, centre) / np.linalg.norm(np.subtract(target, centre))
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z])
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    return Pinhole(K, transforms.rigid(turn, -turn @ np.asarray(centre, float)), size=size, name=name)


def views(count=10):
    """Cameras in a circle of 7 m around the middle, 3 m above the ground, and one straight above."""
    turn = np.arange(count) * 2 * np.pi / count
    around = [SIZE / 2 + [7 * np.cos(t), 7 * np.sin(t), 2.0] for t in turn]
    return [*(view(f"{k}.jpg", c) for k, c in enumerate(around)), view("above.jpg", SIZE / 2 + [0, 0, 7.0])]


def seen(one):
    """(H, W) depth of the box, NaN = none, and the places (H, W, 3) that a view sees."""
    camera = one
    width, height = camera.size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    back = transforms.invert(camera.cam_from_world)
    ray = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T @ back[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (0 - back[:3, 3]) / ray, (SIZE - back[:3, 3]) / ray
    enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    depth = np.where((enter < leave) & (enter > 0), enter, np.nan)
    return depth, back[:3, 3] + depth[..., None] * ray


def picture(one, gain=1.0, stripes=25.0):
    """RGB (H, W, 3) u1 of a view, exposed more or less."""
    depth, places = seen(one)
    rgb = np.where(np.isfinite(depth)[..., None], colour(np.nan_to_num(places), stripes), GREY)
    return np.clip(np.rint(gain * rgb), 0, 255).astype(np.uint8)


def depth_map(one):
    """The depth map of a view."""
    depth = seen(one)[0].astype(np.float32)
    return DepthMap(
        image=one.name,
        depth_m=depth,
        sigma_m=np.full(depth.shape, NOISE_M, np.float32),
        views=np.full(depth.shape, 3, np.uint8),
        K=one.K,
        cam_from_world=one.cam_from_world,
    )
