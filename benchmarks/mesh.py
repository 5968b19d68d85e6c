"""The mesh of a finished run beside that of COLMAP's Poisson mesher from the same fused points.

Completeness is the share of the fused points that lie within two GSD or two of their sigmas of a face; accuracy the
share of the mesh's area within as much of such a point: no truth, but how far a surface keeps what it was made of, and
how much it adds. The GSD is the median over the depth maps.

``python -m benchmarks.mesh OUT [--depth 13]``
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import trimesh
from scipy.spatial import cKDTree

from tiegraph.mesh.surface import Mesh, read_ply
from tiegraph.pipeline.files import load_map, world_origin
from tiegraph.scene.cloudfile import read_cloud, write_ply
from tiegraph.scene.results import Cloud

_MOST = 500_000  # places and points that are looked at


def places(mesh: Mesh, apart: float) -> np.ndarray:
    """(N, 3) places all over a mesh, one for each square of an edge of ``apart``."""
    area = np.linalg.norm(mesh.across, axis=1) / 2
    count = int(min(_MOST, area.sum() / apart**2))
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), count, p=area / area.sum())
    a, b = np.sort(rng.uniform(size=(2, count)), axis=0)
    return np.einsum("nk,nkc->nc", np.stack([a, b - a, 1 - b], axis=1), mesh.xyz[mesh.corners[face]])


def gsd(out: Path) -> float:
    """The median size of a pixel of the images of a run on what they see."""
    found = []
    for path in sorted((out / "depth").rglob("*.npz")):
        own = load_map(path)
        found.append(np.nanmedian(own.depth_m) / own.K[0, 0])
    return float(np.median(found))


def judged(mesh: Mesh, cloud: Cloud, pixel: float) -> dict[str, float]:
    """Shares in percent, the median distance of the points from the mesh in GSD, faces and area."""
    tree, room = cKDTree(cloud.xyz_m), 2 * np.maximum(pixel, np.nan_to_num(cloud.sigma_m))
    off, at = tree.query(places(mesh, pixel))
    some = slice(None, None, max(1, len(cloud) // _MOST))
    missed = distance(mesh, cloud.xyz_m[some])
    return {
        "accuracy_%": round(100 * float((off < room[at]).mean()), 1),
        "completeness_%": round(100 * float((missed < room[some]).mean()), 1),
        "median_off_gsd": round(float(np.median(missed)) / pixel, 2),
        "faces": len(mesh.corners),
        "area": round(float(np.linalg.norm(mesh.across, axis=1).sum() / 2), 1),
    }


def distance(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """(N,) of points (N, 3) from the faces with the eight nearest middles."""
    corners = mesh.xyz[mesh.corners]
    near = cKDTree(corners.mean(axis=1)).query(points, k=8)[1]
    found = np.full(len(points), np.inf)
    for k in range(near.shape[1]):
        there = trimesh.triangles.closest_point(corners[near[:, k]], points)
        found = np.minimum(found, np.linalg.norm(there - points, axis=1))
    return found


def main() -> None:
    """Print the figures of both meshes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--depth", type=int, default=13, help="of the octree of COLMAP's mesher: 13 is its own")
    given = parser.parse_args()
    cloud, pixel = read_cloud(given.out / "cloud.laz", world_origin(given.out)), gsd(given.out)
    own = given.out / "mesh" / "mesh.ply"
    rows = {"tiegraph": {**judged(read_ply(own), cloud, pixel), "MB": round(own.stat().st_size / 1e6, 1)}}
    rows["tiegraph"]["cpu_s"] = json.loads((given.out / "receipts" / "mesh.json").read_text())["cpu_s"]
    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder) / "fused.ply", Path(folder) / "poisson.ply"
        write_ply(replace(cloud.where(np.isfinite(cloud.normal).all(axis=1)), origin=None), source)  # near zero
        options = pycolmap.PoissonMeshingOptions()
        options.depth = given.depth
        start = time.process_time()
        pycolmap.poisson_meshing(source, made, options)
        seconds = time.process_time() - start
        size = round(made.stat().st_size / 1e6, 1)
        rows["COLMAP's Poisson"] = {**judged(read_ply(made), cloud, pixel), "MB": size, "cpu_s": round(seconds, 1)}
    print(json.dumps({"gsd": round(pixel, 5), "points": len(cloud), **rows}))  # noqa: T201


if __name__ == "__main__":
    main()
