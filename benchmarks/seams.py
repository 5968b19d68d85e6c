"""How far the two images of a seam of an orthophoto are from each other: pixels of the raster.

Both images are drawn on the surface around places along the seams, as the orthophoto has them, and the shift between
them is found by least squares of the grey values (shift, gain and offset; Lucas and Kanade). Only places count where
the surface is known all around, the texture fixes both directions, and the two agree once shifted.

python -m benchmarks.seams tiegraph_demo
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import rasterio

from tiegraph.geometry import transforms
from tiegraph.pipeline.files import load_model, read_image, world_origin
from tiegraph.products.raster import read_window
from tiegraph.products.surface import Window
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.colmapmodel import matrix

_HALF = 14  # pixels from the middle of a place to its border
_APART = 12  # pixels between places
_ALIKE = 0.8  # least correlation after the shift
_FIRM_PX = 0.1  # largest standard deviation of a shift
_MOST_PX = 4.0  # a larger shift is no longer found


def places(source: np.ndarray, known: np.ndarray) -> list[tuple[int, int, int, int]]:
    """(row, column, image, image) along the seams."""
    found, taken = [], np.zeros(source.shape, bool)
    seam = np.argwhere((source[:, :-1] != source[:, 1:]) & (source[:, :-1] > 0) & (source[:, 1:] > 0))
    for r, c in np.random.default_rng(0).permutation(seam):
        part = (slice(r - _HALF, r + _HALF + 1), slice(c - _HALF, c + _HALF + 1))
        if min(r, c) < _HALF or known[part].shape != (2 * _HALF + 1,) * 2 or taken[r, c] or not known[part].all():
            continue
        taken[max(r - _APART, 0) : r + _APART, max(c - _APART, 0) : c + _APART] = True
        found.append((int(r), int(c), int(source[r, c]), int(source[r, c + 1])))
    return found


def shift(one: np.ndarray, two: np.ndarray) -> float:
    """Length of the shift between two grey pictures (rows, columns), pixels; NaN = not told."""
    one, two = (cv2.GaussianBlur(v.astype(float), None, 1.0) for v in (one, two))
    at = np.zeros(2)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in one.shape[::-1]))
    for _ in range(8):
        moved = cv2.remap(two, x + np.float32(at[0]), y + np.float32(at[1]), cv2.INTER_CUBIC)
        inner = (slice(4, -4), slice(4, -4))
        dy, dx = np.gradient(moved)
        design = np.stack([v[inner].ravel() for v in (dx, dy, moved, np.ones_like(moved))], axis=1)
        goal = one[inner].ravel() - moved[inner].ravel()
        normal = design.T @ design
        if np.linalg.cond(normal) > 1e12:
            return np.nan
        step = np.linalg.solve(normal, design.T @ goal)
        at += step[:2]
        if np.abs(at).max() > _MOST_PX:
            return np.nan
    noise = np.var(goal - design @ step)
    firm = np.sqrt(noise * np.diag(np.linalg.inv(normal))[:2]).max() < _FIRM_PX
    alike = float(np.corrcoef(one[inner].ravel(), moved[inner].ravel())[0, 1])
    return float(np.hypot(*at)) if firm and alike > _ALIKE else np.nan


def measured(out: Path, folder: Path) -> np.ndarray:
    """Shifts (K,) at the places along the seams of one surface, pixels; NaN = not told."""
    frame, origin = json.loads((folder / "frame.json").read_text()), world_origin(out)
    with rasterio.open(folder / "source.tif") as raster:
        source = raster.read(1).astype(int)
    w = read_window(folder / "dsm.tif", Window(0, 0, rows=source.shape[0], columns=source.shape[1])).astype(float)
    names = {int(k): name for k, name in list(csv.reader((folder / "source.csv").open()))[1:]}
    model = {i.name: i for i in load_model(out / "sparse" / "world").images.values()}
    crs_from_surface = transforms.invert(np.array(frame["surface_from_crs"]))
    left, top = frame["upper_left_uv"]

    @cache
    def grey(name: str) -> np.ndarray:
        return read_image(out / "images" / name).astype(np.float32)

    def drawn(k: int, xyz: np.ndarray) -> np.ndarray:
        image = model[names[k]]
        rays = transforms.apply(matrix(image.cam_from_world()), xyz.reshape(-1, 3))
        xy = np.asarray(image.camera.img_from_cam(rays), np.float32).reshape(*xyz.shape[:2], 2) - np.float32(0.5)
        return cv2.remap(grey(image.name), xy[..., 0], xy[..., 1], cv2.INTER_CUBIC)

    found = []
    for r, c, a, b in places(source, np.isfinite(w)):
        rows, columns = np.mgrid[r - _HALF : r + _HALF + 1, c - _HALF : c + _HALF + 1]
        u, v = left + (columns + 0.5) * frame["pixel"], top - (rows + 0.5) * frame["pixel"]
        xyz = transforms.apply(crs_from_surface, np.stack([u, v, w[rows, columns]], axis=-1)) - shift_of(origin)
        found.append(shift(drawn(a, xyz), drawn(b, xyz)))
    return np.array(found)


def main() -> None:
    """Print a row of each surface."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    sys.stdout.write(
        "| surface | places | told | median shift, px | 90 % | below a pixel |\n|---|---|---|---|---|---|\n"
    )
    for path in sorted((out / "products").glob("*/frame.json")):
        off = measured(out, path.parent)
        told = off[np.isfinite(off)]
        if len(told):
            middle, most = np.percentile(told, [50, 90])
            row = f"{len(off)} | {len(told)} | {middle:.2f} | {most:.2f} | {np.mean(told < 1):.0%}"
            sys.stdout.write(f"| {path.parent.name} | {row} |\n")


if __name__ == "__main__":
    main()
