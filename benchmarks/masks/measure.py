"""How good each mask source is, and what it costs: ``python benchmarks/masks/measure.py --sets canal -o x.json``.

The sources take turns image by image in one process with one thread; times are CPU times. ``learnt+model`` is learnt,
corrected by the waterline and the points of a COLMAP model of the set (``--model``). Truth is opened only to compare.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tiegraph  # noqa: F401, I001  before pycolmap
import cv2
import numpy as np
import pycolmap

from benchmarks.datasets import data_root
from tiegraph import papers
from tiegraph.masks import EGO, NAMES, USE
from tiegraph.masks.folder import compare, compare_classes, table_text
from tiegraph.masks.frames import full_size, image_size
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import SOURCES, Camera
from tiegraph.masks.skyline import places, without_points
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.waterline import View, camera_rays, final_classes, find_water, first_line, lines_of

TUNING = Tuning()
for name in papers.MASKS:
    papers.plug_in(papers.MASKS, name, SOURCES)
PLAIN = ("meguro2024", "meguro2025", "learnt")
GEOMETRY = "learnt+model"
COLUMNS = ("set", "source", "images", "accuracy %", "IoU used %", "useful lost %", "sky IoU %", "water IoU %",
           "platform IoU %", "CPU s an image")  # fmt: skip


@dataclass(frozen=True)
class MaskSet:
    """Images of a set by camera, and its labels, None if it has none."""

    folder: Path
    cameras: Mapping[str, tuple[str, ...]]  # names below folder, in order
    upward: tuple[str, ...] = ()
    truth: Path | None = None
    useful: tuple[int, ...] = ()
    labels: Mapping[str, int] | None = None  # class -> true label


def load(name: str) -> MaskSet:
    """One of the sets, from TIEGRAPH_DATA."""
    root = data_root() / name
    if name.startswith("canal"):
        truth = {"sky": 0, "water": 1, "platform": 2}
        return MaskSet(root / "images", _by_camera(root / "images", "*/{}/*.jpg", [f"cam{c}" for c in range(6)]),
                       ("cam5",), root / "gt" / "masks", (4,), truth)  # fmt: skip
    if name == "camvid":
        every = tuple(range(1, 12))
        return MaskSet(root / "images", _by_camera(root / "images", "*", [""]), (), root / "labels", every, {"sky": 0})
    if name == "pandaset":
        folder = root / "camera"
        return MaskSet(folder, _by_camera(folder, "{}/*.jpg", sorted(p.name for p in folder.iterdir() if p.is_dir())))
    if name == "kitti_stereo":
        folder = root / "KITTI_sequence_1"
        return MaskSet(folder, _by_camera(folder, "{}/*", ["image_l", "image_r"]))
    folder = root / "images" if (root / "images").is_dir() else data_root() / "strecha" / name / "images"
    return MaskSet(folder, _by_camera(folder, "*", [""]))


def _by_camera(folder: Path, pattern: str, cameras: list[str]) -> dict[str, tuple[str, ...]]:
    kinds = (".jpg", ".png")
    return {
        c or "camera": tuple(
            p.relative_to(folder).as_posix() for p in sorted(folder.glob(pattern.format(c))) if p.suffix in kinds
        )
        for c in cameras
    }


def measure(name: str, sources: tuple[str, ...], model: Path | None, out: Path) -> list[dict[str, Any]]:
    """One row a source; masks and classes stay below ``out``."""
    data = load(name)
    keys = {c: k for k, c in enumerate(data.cameras)}
    cameras = {
        keys[c]: Camera(tuple(data.folder / n for n in names), c in data.upward) for c, names in data.cameras.items()
    }
    camera_of = {n: c for c, names in data.cameras.items() for n in names}
    cpu = dict.fromkeys(sources, 0.0)
    prepared, settings = {}, {s: MasksSettings(source=s) for s in sources}
    for source in sources:
        began = time.process_time()
        prepared[source] = SOURCES[source].prepare(cameras, settings[source], TUNING, map)
        cpu[source] += time.process_time() - began
    for image, camera in camera_of.items():
        for source in sources:
            began = time.process_time()
            _write(source, data.folder / image, image, prepared[source][keys[camera]], settings[source], out / source)
            cpu[source] += time.process_time() - began
    if model is not None and "learnt" in sources:
        began = time.process_time()
        _refine(data, camera_of, model, out)
        cpu[GEOMETRY] = cpu["learnt"] + time.process_time() - began
    notes = {c: getattr(prepared["learnt"][k], "note", "") for c, k in keys.items()} if "learnt" in sources else {}
    return [_row(name, s, data, camera_of, out / s, cpu[s], notes if "learnt" in s else {}) for s in cpu]


def _write(source: str, path: Path, name: str, prepared: Any, settings: MasksSettings, out: Path) -> None:
    keep = SOURCES[source].look(path, prepared, settings, TUNING, name)
    if keep.dtype != bool:
        _save(out / "classes" / f"{name}.png", keep)
        keep = keep == USE
    keep = full_size(keep, image_size(path))
    _save(out / "masks" / f"{name}.png", np.where(keep, 255, 0).astype(np.uint8))


def _save(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def _refine(data: MaskSet, camera_of: Mapping[str, str], folder: Path, out: Path) -> None:
    """What the refine stage does, with a model given: its cameras' tops on average point up."""
    model = pycolmap.Reconstruction(str(folder))
    images = {i.name: i for i in model.images.values() if i.has_pose and i.name in camera_of}
    level = [n for n in images if camera_of[n] not in data.upward]
    up = -np.mean([images[n].cam_from_world().rotation.matrix()[1] for n in level], axis=0)
    up /= np.linalg.norm(up)
    first = {n: cv2.imread(str(out / "learnt" / "classes" / f"{n}.png"), cv2.IMREAD_GRAYSCALE) for n in camera_of}
    grids: dict[int, np.ndarray] = {}
    views = {}
    for name, image in images.items():
        camera = image.camera_id
        if camera not in grids:
            grids[camera] = camera_rays(model.cameras[camera], first[name].shape, TUNING)
        views[name] = View(grids[camera] @ image.cam_from_world().rotation.matrix(), image.projection_center())
    points = np.array([p.xyz for p in model.points3D.values() if p.track.length() >= TUNING.witnesses])
    edges = [first_line(first[n], TUNING) for n in level]
    water = find_water([views[n] for n in level], edges, points, up, TUNING)
    for name in camera_of:
        found = first[name]
        if name in views:
            seen = places(images[name], model.cameras[images[name].camera_id], points, TUNING)
            lines = lines_of(views[name], up, water)
            found = without_points(final_classes(found, lines, TUNING), seen, TUNING)
        _save(out / GEOMETRY / "classes" / f"{name}.png", found)
        keep = full_size(found == USE, image_size(data.folder / name))
        _save(out / GEOMETRY / "masks" / f"{name}.png", np.where(keep, 255, 0).astype(np.uint8))


def _row(
    name: str, source: str, data: MaskSet, cameras: Mapping[str, str], out: Path, cpu: float, notes: dict[str, str]
) -> dict[str, Any]:
    row: dict[str, Any] = {"set": name, "source": source, "images": len(cameras), "cpu_s_image": cpu / len(cameras)}
    if notes:
        row["notes"] = notes
    if (out / "classes").is_dir():
        row["shares"] = _shares(out / "classes", cameras)
    if data.truth is None:
        return row
    made = compare(out / "masks", data.truth, cameras, data.useful)
    row["cameras"] = made.table()
    row |= {k: float(getattr(made.rows[-1], k)) for k in ("accuracy", "iou", "useful_lost", "useless_kept")}
    if (out / "classes").is_dir() and data.labels:
        classes = compare_classes(out / "classes", data.truth, data.labels, cameras)
        row["classes"] = classes.table()
        row |= {f"{n}_iou": float(v) for n, v in zip(classes.labels, classes.iou[-1])}
    return row


def _shares(folder: Path, cameras: Mapping[str, str]) -> dict[str, dict[str, float]]:
    found: dict[str, list] = {}
    for name, camera in cameras.items():
        classes = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
        found.setdefault(camera, []).append(np.bincount(classes.ravel(), minlength=EGO + 2) / classes.size)
    return {c: {n: round(float(s), 4) for n, s in zip(NAMES, np.mean(v, axis=0))} for c, v in found.items()}


def shown(rows: list[dict[str, Any]]) -> str:
    """The rows as a table."""

    def percent(row: dict, key: str) -> float | None:
        return None if row.get(key) is None else round(100 * row[key], 1)

    keys = ("accuracy", "iou", "useful_lost", "sky_iou", "water_iou", "platform_iou")
    cells = [
        [r["set"], r["source"], r["images"], *(percent(r, k) for k in keys), round(r["cpu_s_image"], 4)] for r in rows
    ]
    return table_text({"columns": COLUMNS, "rows": cells})


def main() -> int:
    """Measure, print the table, add to the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", nargs="+", default=["canal_demo"])
    parser.add_argument("--sources", nargs="+", default=list(PLAIN), choices=sorted(SOURCES))
    parser.add_argument("--model", help="COLMAP model folder for learnt+model; SET stands for the set's name")
    parser.add_argument("--keep", type=Path, help="folder for the masks, else they are thrown away")
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows = json.loads(given.out.read_text())["rows"] if given.out and given.out.exists() else []
    with tempfile.TemporaryDirectory() as scratch:
        for name in given.sets:
            model = Path(given.model.replace("SET", name)) if given.model else None
            new = measure(name, tuple(given.sources), model if model and model.is_dir() else None,
                          (given.keep or Path(scratch)) / name)  # fmt: skip
            rows = [r for r in rows if (r["set"], r["source"]) not in {(n["set"], n["source"]) for n in new}] + new
            print(shown(new), flush=True)  # noqa: T201
            if given.out:
                machine = {"machine": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}
                when = datetime.now(timezone.utc).isoformat(timespec="seconds")
                given.out.write_text(json.dumps({**machine, "finished": when, "rows": rows}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
