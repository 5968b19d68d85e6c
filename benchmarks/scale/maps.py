"""Memory and time of a map over the number of its points: ``python -m benchmarks.scale.maps --millions 1 4 16 64``.

Of each size a cloud is written (a rolling plain with houses, four points in a pixel of ``--pixel-m``), and the tool's
own tiles of heights, terrain, contour lines and classified points are made of it on one process; with ``--images`` the
orthophoto too, of images of 12 megapixels from 75 m above, ``BASE_M`` apart, whose pixels are drawn and not read. The
peak is that of a process by itself, which grows up to the first full tile (4 million points; ``--tile`` makes smaller
ones); the powers are those of CPU and memory between the sizes.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.growth import exponent
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.stereo import Pinhole
from tiegraph.pipeline.files import CLOUD
from tiegraph.pipeline.products import TILE, TerrainWork, _Work
from tiegraph.products.frame import Frame
from tiegraph.products.raster import Place
from tiegraph.products.surface import MAP, Surface
from tiegraph.products.tuning import Tuning
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud

PIXEL_M, NOISE_M = 0.1, 0.02
BASE_M, HEIGHT_M, FOCAL = (40.0, 60.0), 75.0, 1500.0  # overlaps of 80 and 60 %
_PART = 500_000  # points written at once
_ORIGIN = Origin(lat_deg=35.7, lon_deg=139.8, height_m=0.0, crs="EPSG:32654", shift_m=(388000.0, 3951000.0, 0.0))


def parts(points: int, pixel_m: float) -> Iterator[Cloud]:
    """The cloud strip by strip: as wide as it is long."""
    side = pixel_m / 2
    wide = int(np.sqrt(points))
    rng = np.random.default_rng(0)
    for first in range(0, wide, step := max(1, _PART // wide)):
        x, y = np.meshgrid(np.arange(wide), np.arange(first, min(first + step, wide)))
        x, y = ((v.ravel() + rng.uniform(0.1, 0.9, v.size)) * side for v in (x, y))
        z = 3 * np.sin(x / 40) * np.cos(y / 55) + np.where((x % 40 < 12) & (y % 30 < 9), 6.0, 0.0)
        z += NOISE_M * rng.normal(size=z.size)
        yield Cloud(
            xyz_m=np.stack([x, y, z], axis=1),
            rgb=np.full((len(x), 3), 120, np.uint8),
            normal=np.tile(np.float32([0, 0, 1]), (len(x), 1)),
            sigma_m=np.full(len(x), NOISE_M, np.float32),
            views=np.full(len(x), 4, np.uint8),
            origin=_ORIGIN,
        )


class Drawn:
    """Images above a plain with an edge of so many metres, as ``pipeline.dense.Pictures``."""

    def __init__(self, edge: float) -> None:
        x, y = (v.ravel() for v in np.meshgrid(*(np.arange(b / 2, edge, b) for b in BASE_M)))
        K, down = np.array([[FOCAL, 0, 2000], [0, FOCAL, 1500], [0, 0, 1.0]]), np.diag([1.0, -1.0, -1.0])
        poses = [transforms.rigid(down, -down @ at) for at in np.stack([x, y, np.full(len(x), HEIGHT_M)], axis=1)]
        self.views = [Pinhole(K, pose, size=(4000, 3000), name=f"{k:05}.jpg") for k, pose in enumerate(poses)]
        self._texture = np.random.default_rng(0).integers(60, 200, (3000, 4000, 3), np.uint8)

    def picture(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """RGB and mask of an image."""
        rgb = np.roll(self._texture, k, axis=0)
        return rgb, np.ones(rgb.shape[:2], bool)


def _edge(points: int, pixel_m: float) -> float:
    return pixel_m * float(np.ceil(np.sqrt(points) / 2))


def made(points: int, stage: str, folder: Path, args: argparse.Namespace) -> dict[str, float]:
    """Write the cloud (``stage`` cloud) or make its map: CPU s and the peak of this process, MiB."""
    start = time.process_time()
    if stage == "cloud":
        write_copc(lambda: parts(points, args.pixel_m), folder / CLOUD, args.pixel_m / 2, folder)
    else:
        edge = _edge(points, args.pixel_m)
        low, high = np.array([0.0, 0.0, -50.0]), np.array([edge, edge, 50.0])
        surface = Surface(MAP, Frame(np.eye(4)), low, high, pixel_m=args.pixel_m, offset=np.array(_ORIGIN.shift_m))
        about = {"place": Place(_ORIGIN), "tuning": Tuning(), "tile": args.tile, "objects_m": 40.0}
        work = _Work(folder, surface, **about, pictures=Drawn(edge))
        steps = work.steps() if args.images else work.steps()[:1]
        for step in (*steps, *TerrainWork(folder, surface, **about).steps()):
            for item in step.todo():
                step.make(item)
            step.finish()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"cpu_s": time.process_time() - start, "peak_mib": peak}


def main() -> None:
    """Print a row a size, and the powers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--millions", type=float, nargs="+", default=[1, 4, 16, 64])
    parser.add_argument("--tile", type=int, default=TILE, help="pixels along the edge of a tile")
    parser.add_argument("--pixel-m", type=float, default=PIXEL_M, help="edge of a pixel of the map")
    parser.add_argument("--images", action="store_true", help="the orthophoto too")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    if args.child:
        points, stage, folder = args.child
        sys.stdout.write(json.dumps(made(int(points), stage, Path(folder), args)) + "\n")
        return
    rows = []
    for points in (int(m * 1e6) for m in args.millions):
        row: dict[str, float] = {"points": points}
        if args.images:
            row["images"] = len(Drawn(_edge(points, args.pixel_m)).views)
        with tempfile.TemporaryDirectory() as folder:
            for stage in ("cloud", "map"):
                command = [sys.executable, "-m", "benchmarks.scale.maps", *sys.argv[1:]]
                command += ["--child", str(points), stage, folder]
                found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                row |= {f"{stage}_{name}": value for name, value in found.items()}
        rows.append(row)
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()
    sizes = np.array([r["points"] for r in rows])
    powers = {n: exponent(sizes, np.array([r[n] for r in rows])) for n in rows[0] if n not in ("points", "images")}
    sys.stdout.write(json.dumps({"powers": powers}) + "\n")
    if args.output:
        args.output.write_text(json.dumps({"rows": rows, "powers": powers}, indent=1) + "\n")


if __name__ == "__main__":
    main()
