"""A slanted plane under four cameras as a finished run: its cloud in a file, depth maps, what is known of the model."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import PlacementError
from tiegraph.pipeline.files import CLOUD
from tiegraph.pipeline.view import Viewed
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud, DepthMap, save_depth
from tiegraph.view.layers import Known

ORIGIN = Origin(lat_deg=35.7, lon_deg=139.8, height_m=40.0, crs="EPSG:32654", shift_m=(388700.0, 3951000.0, 40.0))
SIZE, COUNT, HIGH = (320, 240), 20_000, 6.0
NAMES = [f"cam/{k:03d}.png" for k in range(4)]
K = np.array([[200.0, 0, 160], [0, 200, 120], [0, 0, 1]])
KNOWN = Known(0.004, PlacementError(np.array([100.0, 200.0, 0.0]), np.diag([1e-6, 1e-6, 4e-6, 1e-4, 1e-4, 4e-4, 1e-8])))


def cloud() -> Cloud:
    """Points of the plane, a millimetre's grid; the sigma of each is its own."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(95, 105, COUNT), rng.uniform(196, 204, COUNT)
    xyz = np.round(np.stack([x, y, 0.1 * (x - 100)], axis=1), 3)
    return Cloud(
        xyz_m=xyz,
        rgb=rng.integers(0, 255, (COUNT, 3)).astype(np.uint8),
        normal=np.tile(np.float32([0, 0, 1]), (COUNT, 1)),
        sigma_m=rng.uniform(0.002, 0.02, COUNT).astype(np.float32),
        views=rng.integers(2, 9, COUNT).astype(np.uint8),
        origin=ORIGIN,
    )


def poses() -> list[np.ndarray]:
    """cam_from_world (4, 4) of cameras that look down; the last is turned to the sky."""
    down = np.diag([1.0, -1.0, -1.0])
    turns = [down, down, down, np.eye(3)]
    return [transforms.rigid(r, -r @ [98.0 + 1.5 * k, 200.0, HIGH]) for k, r in enumerate(turns)]


def as_run(folder: Path) -> Viewed:
    """The run; something 2 m below the second camera hides the plane from it."""
    write_copc(lambda: iter([cloud()]), folder / CLOUD, 0.05, folder)
    camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=[200, 200, 160, 120])
    for k, (name, pose) in enumerate(zip(NAMES, poses())):
        picture = np.full((SIZE[1], SIZE[0], 3), 40 * (k + 1), np.uint8)
        (folder / "images" / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / "images" / name), picture)
        depth = np.full(SIZE[::-1], 2.0 if k == 1 else HIGH + 0.7, np.float32)
        made = DepthMap(
            image=name, depth_m=depth, sigma_m=0.01 * depth, views=np.full(depth.shape, 3, np.uint8), K=K,
            cam_from_world=pose,
        )  # fmt: skip
        (folder / "depth" / name).parent.mkdir(parents=True, exist_ok=True)
        save_depth(made, folder / "depth" / f"{name}.npz")
    run: Any = SimpleNamespace(path=folder.joinpath, folder=folder)
    xyz = cloud().xyz_m + ORIGIN.shift_m
    return Viewed(
        run=run,
        origin=ORIGIN,
        unit="m",
        box=np.array([xyz.min(axis=0), xyz.max(axis=0)]),
        points=COUNT,
        images={n: (p, camera) for n, p in zip(NAMES, poses())},
        known=KNOWN,
    )
