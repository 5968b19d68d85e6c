"""Surface models of a finished run beside a reference cloud: errors over what ``sigma.tif`` states.

The reference (LAZ, east-north-up metres about the place in ``meta.json``) is brought into the frame of each surface.
Only points within ``_NEAR_M`` of the surface count, where it is no steeper than ``_STEEP`` a pixel and their
``_AROUND`` nearest in the raster's plane reach over less than ``_FLAT_M`` (beside an edge and on the side of a
girder, a point and a pixel are of two surfaces). The place of the survey in the world is not in ``sigma.tif``: shift
and tilt of each surface against the reference are taken off first, and said. The reference's own noise is added to
sigma.

python -m benchmarks.elevations tiegraph_demo examples/canal/truth
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import laspy
import numpy as np
import rasterio
from scipy.spatial import cKDTree

from tiegraph.evaluate.reference import to_world
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.pipeline.files import world_origin
from tiegraph.products.raster import read_window
from tiegraph.products.surface import Window
from tiegraph.scene.cloudfile import shift_of

_NOISE_M = 0.02  # of the reference
_NEAR_M, _STEEP = 0.5, 0.05
_AROUND, _FLAT_M = 6, 0.2
_GROSS_SIGMAS = 5.0
_BANDS_M = (0.0, 0.02, 0.04, 0.08, 0.2, 1.0)


def reference(truth: Path, origin: Origin) -> np.ndarray:
    """(N, 3) points of the reference in the CRS of the run."""
    las, place = laspy.read(truth / "reference.laz"), json.loads((truth / "meta.json").read_text())["origin"]
    about = Origin(lat_deg=place["lat"], lon_deg=place["lon"], height_m=place["height"], crs=ENU)
    return np.asarray(to_world(np.asarray(las.xyz, float), about, origin) + shift_of(origin))


def errors(folder: Path, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Error of the surface at each point that counts (M,), its sigma (M,), and the shift that was taken off, metres."""
    frame = json.loads((folder / "frame.json").read_text())
    with rasterio.open(folder / "dsm.tif") as raster:
        whole = Window(0, 0, rows=raster.height, columns=raster.width)
    w, sigma = (read_window(folder / f"{name}.tif", whole).astype(float) for name in ("dsm", "sigma"))
    uvw = transforms.apply(np.array(frame["surface_from_crs"]), xyz)
    left, top = frame["upper_left_uv"]
    row, column = np.floor(np.stack([top - uvw[:, 1], uvw[:, 0] - left]) / frame["pixel"]).astype(int)
    inside = (row >= 0) & (column >= 0) & (row < w.shape[0]) & (column < w.shape[1])
    row, column, uvw = row[inside], column[inside], uvw[inside]
    off, steep = w[row, column] - uvw[:, 2], np.hypot(*np.gradient(w))[row, column]
    about = np.abs(off) < 2 * _NEAR_M
    off, steep, own, uvw = off[about], steep[about], sigma[row, column][about], uvw[about]
    _, around = cKDTree(uvw[:, :2]).query(uvw[:, :2], k=_AROUND)
    counts = (np.abs(off) < _NEAR_M) & (steep < _STEEP) & (np.ptp(uvw[around, 2], axis=1) < _FLAT_M)
    off, own = off[counts], own[counts]
    plane = np.c_[np.ones(len(off)), uvw[counts, :2] - uvw[counts, :2].mean(axis=0)]
    kept = np.ones(len(off), bool)
    for _ in range(5):
        fit = np.linalg.lstsq(plane[kept], off[kept], rcond=None)[0]
        rest = off - plane @ fit
        kept = np.abs(rest) < _GROSS_SIGMAS * np.hypot(own, _NOISE_M)
    return rest, own, float(fit[0])


def main() -> None:
    """Print the rows of a table for each surface, and for each band of sigma."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("truth", type=Path)
    args = parser.parse_args()
    origin = world_origin(args.out)
    if origin is None:
        raise SystemExit(f"{args.out} has no place on the Earth")
    xyz = reference(args.truth, origin)
    said = [
        "| surface | sigma, m | points | shift taken off, m | RMS, m | RMS of error / sigma | within 2 | beyond 5 |"
    ]
    said.append("|---|---|---|---|---|---|---|---|")
    for frame in sorted((args.out / "products").glob("*/frame.json")):
        off, sigma, shift = errors(frame.parent, xyz)
        ratio = off / np.hypot(sigma, _NOISE_M)
        bands = [(0.0, np.inf), *zip(_BANDS_M, _BANDS_M[1:])]
        for low, high in bands:
            some = (sigma >= low) & (sigma < high)
            sound = some & (np.abs(ratio) < _GROSS_SIGMAS)
            if np.count_nonzero(sound) < 200:
                continue
            name = f"all, median {np.median(sigma[some]):.3f}" if high == np.inf else f"{low:g} to {high:g}"
            rms, ratios = (float(np.sqrt(np.mean(v[sound] ** 2))) for v in (off, ratio))
            shares = f"{np.mean(np.abs(ratio[some]) < 2):.1%} | {np.mean(np.abs(ratio[some]) >= _GROSS_SIGMAS):.1%}"
            said.append(
                f"| {frame.parent.name} | {name} | {some.sum()} | {shift:.3f} | {rms:.3f} | {ratios:.2f} | {shares} |"
            )
    sys.stdout.write("\n".join(said) + "\n")


if __name__ == "__main__":
    main()
