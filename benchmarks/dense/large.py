"""Images of 24 and 48 megapixels: a rendered site with exact truth; what the size of its depth maps gives and costs.

A drone flies two lines over boxes on a plain, 60 m up. Their textures are photographs of yours (12 of an aerial
survey), at about their own sharpness.

python -m benchmarks.dense.large render SITE --size 8064 6048 --focal 5376 --photos A.JPG B.JPG ...
tiegraph run SITE/images -o SITE/out
tiegraph status SITE/out                              # CPU s and peak of each stage, two processes
python -m benchmarks.dense.large sizes SITE/out --images 5 --sizes 1600 3200 4032 --truth SITE/truth.json
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from tiegraph.cloud.fuse import Maps, fuse, map_points
from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import ImagePlan
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline.dense import coloured, plan_of
from tiegraph.pipeline.files import FINAL, load_model
from tiegraph.project.inputs import Inputs
from tiegraph.project.progress import Meter
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.results import DepthMap, load_depth, save_depth

_HEIGHT_M, _LINES, _A_LINE, _FORWARD, _SIDE = 60.0, 2, 5, 0.75, 0.65  # flying height, images, overlaps
_BOXES, _TRIES = 45, 400
_LAT, _LON, _GROUND_M = 47.0, 8.0, 400.0
_EDGE_M = 0.6  # nearer to the side of a box a point may lie on it, below it or between
_GROSS_M = 0.15
_HALF = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # from OpenCV's pixel coordinates to those of corners


class Site:
    """Boxes on the plane z = 0; x to the right and y down in a texture, z down: metres."""

    def __init__(self, size: tuple[int, int], focal: float, photos: list[Path]) -> None:
        rng = np.random.default_rng(1)
        self.size, self.focal, self.gsd = size, focal, _HEIGHT_M / focal
        seen = np.array(size) * self.gsd
        self.step = seen * [1 - _SIDE, 1 - _FORWARD]
        self.low, self.extent = -0.575 * seen, self.step * [_LINES - 1, _A_LINE - 1] + 1.15 * seen
        self.texture = _mosaic(photos, np.ceil(self.extent / self.gsd).astype(int))
        self.boxes: list[np.ndarray] = []  # (5,) x and y of two corners, height
        for _ in range(_TRIES):
            edge = rng.uniform(5, 16, 2)
            low = self.low + rng.uniform(size=2) * (self.extent - edge)
            apart = [(low > b[2:4] + 1).any() or (low + edge < b[:2] - 1).any() for b in self.boxes]
            if all(apart) and len(self.boxes) < _BOXES:
                self.boxes.append(np.array([*low, *(low + edge), rng.uniform(2.5, 12)]))

    def picture(self, projection: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """(H, W, 3) u1 BGR as seen by a camera (3, 4)."""
        image = np.zeros((self.size[1], self.size[0], 3), np.uint8)
        axes = np.eye(3)
        self._draw(image, projection, np.array([*self.low, 0.0]), [*(axes[:2] * self.extent[:, None])], 0)
        for box in sorted(self.boxes, key=lambda b: -np.linalg.norm((b[:2] + b[2:4]) / 2 - centre[:2])):
            corner, (x, y, z) = np.array([*box[:2], -box[4]]), axes * [*(box[2:4] - box[:2]), box[4]]
            walls = [(corner, x, -1, 1), (corner + y, x, 1, 1), (corner, y, -1, 0), (corner + x, y, 1, 0)]
            for k, (at, along, side, axis) in enumerate(walls):
                if side * (centre[axis] - at[axis]) > 0:
                    self._draw(image, projection, at, [along, z], 137 * (k + 1))
            self._draw(image, projection, corner, [x, y], 777)
        return image

    def _draw(
        self, image: np.ndarray, projection: np.ndarray, corner: np.ndarray, edges: list[np.ndarray], shift: int
    ) -> None:
        """A rectangle with the part of the texture below it, moved by ``shift`` pixels."""
        count = np.maximum([int(np.linalg.norm(e) / self.gsd) for e in edges], 1)
        most = np.array(self.texture.shape[1::-1]) - count
        first = (((corner[:2] - self.low) / self.gsd).astype(int) + shift) % np.maximum(most, 1)
        plane = np.column_stack([edges[0] / count[0], edges[1] / count[1], corner])
        to_image = projection @ np.vstack([plane, [0, 0, 1]])
        rim = np.array([[0, 0, 1], [count[0], 0, 1], [*count, 1], [0, count[1], 1]]) @ to_image.T
        if (rim[:, 2] < 1).any():
            return
        rim = rim[:, :2] / rim[:, 2:]
        low = np.floor(np.clip(rim.min(axis=0) - 1, 0, self.size)).astype(int)
        high = np.ceil(np.clip(rim.max(axis=0) + 1, 0, self.size)).astype(int)
        if (high <= low).any():
            return
        moved = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1.0]]) @ to_image
        part = self.texture[first[1] : first[1] + count[1], first[0] : first[0] + count[0]]
        window, size = image[low[1] : high[1], low[0] : high[0]], (int(high[0] - low[0]), int(high[1] - low[1]))
        matrix = np.linalg.inv(_HALF) @ moved @ _HALF
        cv2.warpPerspective(part, matrix, size, dst=window, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)


def _mosaic(photos: list[Path], size: np.ndarray) -> np.ndarray:
    """Photographs side by side, row by row."""
    out, top, used = np.zeros((size[1], size[0], 3), np.uint8), 0, 0
    while top < size[1]:
        left, height = 0, 0
        while left < size[0]:
            image = cv2.imread(str(photos[used % len(photos)]))
            assert image is not None, photos[used % len(photos)]
            image = image[:, :: 1 if used < len(photos) else -1]
            used, height = used + 1, height or len(image)
            part = image[: min(height, size[1] - top), : size[0] - left]
            out[top : top + len(part), left : left + part.shape[1]] = part
            left += image.shape[1]
        top += height
    return out


def render(out: Path, size: tuple[int, int], focal: float, photos: list[Path]) -> None:
    """Images with EXIF positions, and what is true of them."""
    site, rng, centres = Site(size, focal, photos), np.random.default_rng(2), {}
    (out / "images").mkdir(parents=True)
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    for k in range(_LINES * _A_LINE):
        line, place = divmod(k, _A_LINE)
        along = place if line % 2 == 0 else _A_LINE - 1 - place
        centre = np.array([*(site.step * [line, along]), -_HEIGHT_M]) + rng.normal(0, 0.3, 3)
        tilt = cv2.Rodrigues(np.radians([*rng.normal(0, 2.5, 2), 0.0]))[0]
        turn = cv2.Rodrigues(np.radians([0, 0, rng.normal(0, 3) + 180.0 * (line % 2)]))[0]
        rotation = tilt @ turn
        image = site.picture(K @ np.column_stack([rotation, -rotation @ centre]), centre)
        for rows in np.array_split(image, 16):  # noise of a sensor
            cv2.add(rows, rng.normal(0, 2, rows.shape).astype(np.int16), dst=rows, dtype=cv2.CV_8U)
        name = f"{k:04d}.jpg"
        centres[name] = centre * [1, -1, -1]  # east, north, up
        exif = _exif(centres[name] + rng.normal(0, [0.02, 0.02, 0.03]), focal / math.hypot(*size))
        Image.fromarray(image[..., ::-1]).save(out / "images" / name, quality=92, exif=exif)
        sys.stdout.write(f"{name}\n")
    truth = {"boxes": [b.tolist() for b in site.boxes], "centres": {n: c.tolist() for n, c in centres.items()}}
    (out / "truth.json").write_text(json.dumps(truth))


def _exif(enu: np.ndarray, focal_diagonals: float) -> Image.Exif:
    exif = Image.Exif()
    exif[271], exif[272] = "rendered", "site"
    exif.get_ifd(0x8769)[0xA405] = round(43.27 * focal_diagonals)
    lat, lon = _LAT + enu[1] / 111_180, _LON + enu[0] / (111_320 * math.cos(math.radians(_LAT)))
    degrees = [(math.floor(v), math.floor(60 * v % 60), 3600 * v % 60) for v in (lat, lon)]
    exif.get_ifd(0x8825).update({1: "N", 2: degrees[0], 3: "E", 4: degrees[1], 5: b"\0", 6: _GROUND_M + enu[2]})
    return exif


def measure(run: Run, plans: dict[str, ImagePlan], size: int, truth: dict | None) -> str:
    """Depth maps of some images, one after another, and their cloud."""
    settings = run.settings.dense.model_copy(update={"max_image_size": size})
    tuning, images, spent = run.settings.tuning, run.path("images"), {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)

        def load(name: str, step: str = "first") -> DepthMap | None:
            path = work / f"{name}.{step}.npz"
            return load_depth(path) if path.exists() else None

        def first(name: str) -> None:
            masks = run.path(FINAL, "masks")
            save_depth(depth_map(plans[name], images, masks, settings, tuning.dense), work / f"{name}.first.npz")

        def last(name: str) -> None:
            depth = load(name)
            assert depth is not None
            save_depth(confirmed_map(plans[name], depth, load, settings, tuning.dense)[0], work / f"{name}.last.npz")

        for step in (first, last):
            meter = Meter(0.1)
            for name in plans:
                step(name)
            spent[step.__name__] = meter.stop()
        maps = Maps(lambda name: load(name, "last"), coloured(plans, images, settings))
        meter = Meter(0.1)
        (work / "tiles").mkdir()
        cloud = fuse(list(plans), maps, work / "tiles", run.settings.cloud, tuning.cloud)
        spent["cloud"] = meter.stop()
        sigma = np.median(np.concatenate([c.sigma_m[::20] for c in cloud.clouds()]))
        cost = "; ".join(f"{n} {s['cpu_s'] / len(plans):.1f}, {s['peak_mib']:.0f}" for n, s in spent.items())
        error = "" if truth is None else f"; {errors(run, [d for n in plans if (d := load(n, 'last'))], truth)}"
        return f"{size} px: CPU s an image, MiB: {cost}; {cloud.counts['points']} points, sigma {sigma:.4f}{error}\n"


def errors(run: Run, depths: list[DepthMap], truth: dict) -> str:
    """Heights against the truth, after a similarity by the camera centres and without a bend of second degree."""
    model, rows = load_model(run.path("sparse", "world")), []
    centres = {i.name: i.projection_center() for i in model.images.values() if i.name in truth["centres"]}
    world = umeyama(np.array(list(centres.values())), np.array([truth["centres"][n] for n in centres]))
    for depth in depths:
        shape = depth.depth_m.shape
        cloud = map_points(depth, np.zeros((*shape, 3), np.uint8), run.settings.cloud, slice(0, shape[0]))[0]
        xyz = world(cloud.xyz_m[:: max(1, len(cloud) // 400_000)])
        height, edge = np.zeros(len(xyz)), np.zeros(len(xyz), bool)
        for x0, y0, x1, y1, top in truth["boxes"]:
            inside = np.minimum.reduce([xyz[:, 0] - x0, x1 - xyz[:, 0], -xyz[:, 1] - y0, y1 + xyz[:, 1]])
            height[inside > 0] = top
            edge |= np.abs(inside) < _EDGE_M
        error, (x, y) = (xyz[:, 2] - height)[~edge], xyz[~edge, :2].T / 50
        bend, near = np.column_stack([np.ones(len(x)), x, y, x * x, y * y, x * y]), np.abs(error) < 2 * _GROSS_M
        error = error - bend @ np.linalg.lstsq(bend[near], error[near], rcond=None)[0]
        rows.append([1483 * np.median(np.abs(error)), 100 * np.mean(np.abs(error) > _GROSS_M)])
    spread, gross = np.mean(rows, axis=0)
    return f"error {spread:.1f} mm (1.48 times the median), {gross:.2f} % above {_GROSS_M} m"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("render")
    one.add_argument("out", type=Path)
    one.add_argument("--size", type=int, nargs=2, required=True)
    one.add_argument("--focal", type=float, required=True)
    one.add_argument("--photos", type=Path, nargs="+", required=True)
    two = verbs.add_parser("sizes")
    two.add_argument("out", type=Path, help="a run folder with sparse/world, images and final masks")
    two.add_argument("--images", type=int, default=5, help="the first so many")
    two.add_argument("--sizes", type=int, nargs="+", default=[1600, 3200])
    two.add_argument("--truth", type=Path)
    args = parser.parse_args()
    if args.verb == "render":
        render(args.out, (args.size[0], args.size[1]), args.focal, args.photos)
        return
    run = Run(args.out, Inputs(args.out / "images"), Settings())
    found = plan_of(run).images
    names = sorted(found)[: args.images]
    plans = {}
    for name in names:
        plan = found[name]
        partners = tuple(v for v in plan.partners if v.name in names)
        if partners:
            witnesses = tuple(w for w in plan.witnesses if w in names)
            plans[name] = replace(plan, partners=partners, witnesses=witnesses)
    truth = json.loads(args.truth.read_text()) if args.truth else None
    for size in args.sizes:
        sys.stdout.write(measure(run, plans, size, truth))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
