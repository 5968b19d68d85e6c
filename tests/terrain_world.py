"""A slope with houses, trees and cars on it, as a raster; and a run folder that has it as its map."""

import json
from dataclasses import replace

import cv2
import numpy as np

from tiegraph.geometry.geodesy import Origin
from tiegraph.pipeline.files import CLOUD
from tiegraph.products.frame import Frame
from tiegraph.products.raster import Place, write_raster
from tiegraph.products.surface import Surface
from tiegraph.project.folder import SETTINGS
from tiegraph.scene.atomic import MARK
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud

PIXEL, ROWS, COLUMNS, NOISE_M = 0.2, 256, 320, 0.02
ORIGIN = Origin(lat_deg=35.7, lon_deg=139.8, height_m=40.0, crs="EPSG:32654", shift_m=(388700.0, 3951000.0, 40.0))
HOUSES = ((8.0, 20.0, 9.0, 12.0), (40.0, 30.0, 12.0, 8.0), (30.0, 6.0, 8.0, 6.0))  # left, low, wide, deep
TREES = ((25.0, 30.0, 3.0), (52.0, 12.0, 2.0), (14.0, 42.0, 4.0), (55.0, 44.0, 1.5))  # east, north, radius
CARS = ((24.0, 20.0), (45.0, 22.0))


def errors(shape, seed=0, bell_px=1.5):
    """Noise (rows, columns) of sigma 1 that neighbours share; ``bell_px`` 0: each pixel its own."""
    found = np.random.default_rng(seed).normal(size=shape)
    return found if not bell_px else cv2.GaussianBlur(found, None, bell_px) * (2 * np.sqrt(np.pi) * bell_px)


def surface(rows=ROWS, columns=COLUMNS, name="map"):
    """A reference surface of so many pixels, its lower left corner at (100, 200) of the world."""
    low, high = np.array([100.0, 200.0, -50.0]), np.array([100.0 + columns * PIXEL, 200.0 + rows * PIXEL, 50.0])
    return Surface(name, Frame(np.eye(4)), low, high, pixel_m=PIXEL, offset=np.array(ORIGIN.shift_m))


def places(shape=(ROWS, COLUMNS)):
    """Metres to the right of the left border and up from the lower one (rows, columns)."""
    x, y = np.meshgrid((np.arange(shape[1]) + 0.5) * PIXEL, (np.arange(shape[0])[::-1] + 0.5) * PIXEL)
    return x, y


def ground(x, y):
    """Height of the terrain."""
    return 0.15 * x - 0.05 * y + 0.5 * np.sin(x / 12) * np.cos(y / 15)


def town(seed=0):
    """Heights of the ground and of what stands on it (rows, columns), and what is an object."""
    x, y = places()
    bare, top = ground(x, y), ground(x, y)
    for left, low, wide, deep in HOUSES:
        inside = (x > left) & (x < left + wide) & (y > low) & (y < low + deep)
        top = np.where(inside, bare[inside].max() + 4, top)
    for east, north, radius in TREES:
        away = np.hypot(x - east, y - north) / radius
        top = np.where(away < 1, np.maximum(top, bare + 2 + 4 * (1 - away**2)), top)
    for left, low in CARS:
        top = np.where((x > left) & (x < left + 4.5) & (y > low) & (y < low + 1.8), bare + 1.5, top)
    objects = top > bare
    top = cv2.GaussianBlur(top, None, 0.8) + NOISE_M * errors(top.shape, seed)
    return bare, top.astype(np.float32), objects


def cloud(seed=1):
    """A point in each pixel of the town's heights, a few below the houses, and one beyond the raster; and which of them
    are on an object (N,)."""
    (x, y), (bare, top, objects), rng = places(), town(), np.random.default_rng(seed)
    below = objects & (x % 2 < PIXEL)
    xyz = [np.stack([x, y, top], axis=-1).reshape(-1, 3), np.stack([x, y, bare], axis=-1)[below], [[-5.0, 3.0, 0.0]]]
    xyz = np.concatenate(xyz) + surface().low * [1, 1, 0]
    xyz[:-1] += rng.uniform(-0.4, 0.4, (len(xyz) - 1, 3)) * [PIXEL, PIXEL, 0]
    count = len(xyz)
    points = Cloud(
        xyz_m=xyz,
        rgb=np.full((count, 3), 90, np.uint8),
        normal=np.tile(np.float32([0, 0, 1]), (count, 1)),
        sigma_m=np.full(count, NOISE_M, np.float32),
        views=np.full(count, 3, np.uint8),
        origin=ORIGIN,
    )
    return points, np.r_[objects.ravel(), np.zeros(np.count_nonzero(below) + 1, bool)]


def as_run(folder, origin=ORIGIN, scale="gnss", **rasters):
    """A run folder with rasters (rows, columns) of the world's heights as its map, dsm and sigma by default."""
    values = {"dsm": town()[1], "sigma": np.full((ROWS, COLUMNS), NOISE_M, np.float32)} | rasters
    place = Place(origin, "units" if scale == "none" else "m", "accuracy predicted: none")
    top = surface(*values["dsm"].shape)
    if origin is None:
        top = replace(top, offset=np.zeros(3))
    for name, w in values.items():
        up = 0.0 if name.endswith("sigma") or origin is None else top.offset[2]
        parts = [(v, w[v.row : v.row + v.rows, v.column : v.column + v.columns] + up) for v in top.windows(128)]
        write_raster(folder / "products" / "map" / f"{name}.tif", parts, top, place, folder / "scratch")
    write_copc(lambda: iter([cloud()[0]]), folder / CLOUD, PIXEL, folder)
    world = {"origin": None if origin is None else origin.to_dict(), "scale_source": scale, "placement_error": None}
    (folder / "world.json").write_text(json.dumps(world))
    (folder / SETTINGS).write_text(f'[run]\nimages = "{folder}"\n')
    (folder / MARK).parent.mkdir()
    (folder / MARK).write_text(json.dumps({"made by": "tiegraph run", "format": 3}))
    return folder
