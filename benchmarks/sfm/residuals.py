"""How far key points lie from where the model sees them, by their scale: ``python -m benchmarks.sfm.residuals RUN...``

Points of four images and more. Each residual is divided by sqrt(1 - 3 / 2n): the point was made of its n images.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.scene.colmapdatabase import Rows

_EDGES = np.array([0.5, 1.2, 1.6, 2.2, 3.0, 4.5, 6.5, 9.0, 13.0, 20.0, 40.0])
_FEWEST = 30  # residuals that tell a sigma
_LEAST_IMAGES = 4


def main() -> None:
    """Print a table: scale, number, robust sigma of a coordinate, pixels."""
    for run in map(Path, sys.argv[1:]):
        scale, residual = residuals(run)
        sys.stdout.write(f"{run}\n")
        for low, high in zip(_EDGES, _EDGES[1:]):
            here = np.abs(residual[(scale >= low) & (scale < high)])
            if len(here) >= _FEWEST:
                sys.stdout.write(f"  {low:4} to {high:4} px: {len(here):6}, {np.median(here) / 0.6745:.3f} px\n")


def residuals(run: Path) -> tuple[np.ndarray, np.ndarray]:
    """Scales (N,) and residuals (N, 2) of the largest model of a run, pixels."""
    model = pycolmap.Reconstruction(run / "sparse" / "0")
    scales, found = [], []
    with Rows(run / "database.db") as rows:
        ids = {name: k for k, name in rows.image_names().items()}
    with pycolmap.Database.open(run / "database.db") as database:
        for k in model.reg_image_ids():
            image = model.image(k)
            shapes = np.asarray(database.read_keypoints(ids[image.name]), float)
            area = (
                np.abs(np.linalg.det(shapes[:, 2:6].reshape(-1, 2, 2))) if shapes.shape[1] == 6 else shapes[:, 2] ** 2
            )
            for row, point in enumerate(image.points2D):
                if not point.has_point3D():
                    continue
                seen = model.point3D(point.point3D_id)
                count = seen.track.length()
                place = image.project_point(seen.xyz)
                if count >= _LEAST_IMAGES and place is not None:
                    found.append((np.asarray(place) - point.xy) / np.sqrt(1 - 1.5 / count))
                    scales.append(np.sqrt(area[row]))
    return np.array(scales), np.array(found).reshape(-1, 2)


if __name__ == "__main__":
    main()
