"""Fisheye images whole and cut into views in a rendered world: ``python benchmarks/masks/fisheye.py WORK -o FILE``.

A 360 camera of two lenses back to back, each with the calibration of kerry_park_360rig (480 px, a circle of 100 degrees
off the axis), is carried on a stick round a room with patterned walls; the head of who carries it bobs at the foot of
both images. Registered frames, ATE after a similarity and CPU seconds of a run to ``georef`` for each way.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tiegraph  # before pycolmap
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline.files import load_model

SIDE, CIRCLE_DEG, FRAMES, SEED = 480, 100.0, 16, 5
FOCAL, BENT = 129.2, (0.038113, -0.0080085, 0.0083297, -0.0026902)
ROOM_M, TEXELS_M = np.array([14.0, 3.6, 9.0]), 40.0  # x, y down, z
BACK_M = 0.03


def lens_rays() -> tuple[np.ndarray, np.ndarray]:
    """(h, w, 3) unit rays of the pixels of a lens, and (h, w) bool what it lights."""
    angle = np.linspace(0, np.radians(CIRCLE_DEG), 2000)
    powers = angle[:, None] ** (2 * np.arange(1, 5))
    radius = FOCAL * angle * (1 + powers @ np.array(BENT))
    x, y = np.meshgrid(np.arange(SIDE) + 0.5 - SIDE / 2, np.arange(SIDE) + 0.5 - SIDE / 2)
    off = np.hypot(x, y)
    theta = np.interp(off, radius, angle)
    rays = np.stack([np.sin(theta) * x / off, np.sin(theta) * y / off, np.cos(theta)], axis=-1)
    return rays, off < min(radius[-1], 0.52 * SIDE)


def walls() -> list[np.ndarray]:
    """A pattern (h, w, 3) u1 for each of the six walls: blots of many sizes."""
    rng, made = np.random.default_rng(SEED), []
    for _ in range(6):
        side = int(ROOM_M.max() * TEXELS_M)
        total = np.zeros((side, side, 3), np.float32)
        for cells in (8, 24, 64, 160):
            total += cv2.resize(rng.random((cells, cells, 3), np.float32), (side, side), interpolation=cv2.INTER_CUBIC)
        made.append((40 + 190 * (total - total.min()) / np.ptp(total)).astype(np.uint8))
    return made


def look(rays: np.ndarray, centre: np.ndarray, pattern: list[np.ndarray]) -> np.ndarray:
    """Colours (h, w, 3) u1 that rays in the world see from a place in the room."""
    out = np.zeros(rays.shape, np.uint8)
    with np.errstate(divide="ignore"):
        reach = np.where(rays > 0, ROOM_M - centre, -centre) / rays
    axis = reach.argmin(axis=-1)
    hit = centre + rays * reach.min(axis=-1)[..., None]
    for wall in range(3):
        for far in range(2):
            mine = (axis == wall) & ((rays[..., wall] > 0) == bool(far))
            u, v = (np.nan_to_num(hit[..., k] * TEXELS_M).astype(np.float32) for k in range(3) if k != wall)
            out[mine] = cv2.remap(pattern[2 * wall + far], u, v, cv2.INTER_LINEAR)[mine]
    return out


def shots(folder: Path) -> np.ndarray:
    """Write the images and ``rig_config.json``; returns the centres (F, 3)."""
    rng, (rays, lit), pattern = np.random.default_rng(SEED), lens_rays(), walls()
    turn = np.linspace(0, 1.7 * np.pi, FRAMES)
    middle = ROOM_M / 2
    centres = middle + np.column_stack([4.5 * np.cos(turn), 0.1 * rng.standard_normal(FRAMES), 2.5 * np.sin(turn)])
    for k, centre in enumerate(centres):
        yaw = turn[k] + 0.2 * rng.standard_normal()
        body = cv2.Rodrigues(np.array([0.0, yaw, 0.0]))[0] @ cv2.Rodrigues(0.08 * rng.standard_normal(3))[0]
        for name, way in (("fisheye_left", 1.0), ("fisheye_right", -1.0)):
            at = centre + body @ np.array([0, 0, 0 if way > 0 else BACK_M * -1])
            picture = look((rays * (way, 1, way)) @ body.T, at, pattern)
            head = (round(SIDE / 2 + 12 * rng.standard_normal()), round(SIDE * 0.95 + 6 * rng.standard_normal()))
            cv2.ellipse(picture, head, (60, 45), 0, 0, 360, (40, 60, 90), -1)
            cv2.ellipse(picture, head, (30, 38), 20, 0, 360, (150, 160, 180), 3)
            picture = np.clip(picture + 3 * rng.standard_normal(picture.shape), 0, 255) * lit[..., None]
            (folder / name).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / name / f"{k:03d}.jpg"), picture.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 92])
    params = [FOCAL, FOCAL, SIDE / 2, SIDE / 2, *BENT]
    lens = {"camera_model_name": "OPENCV_FISHEYE", "camera_params": params}
    back = {"cam_from_rig_rotation": [0, 0, 1, 0], "cam_from_rig_translation": [0, 0, -BACK_M]}
    cameras = [
        {"image_prefix": "fisheye_left/", "ref_sensor": True, **lens},
        {"image_prefix": "fisheye_right/", **back, **lens},
    ]
    (folder / "rig_config.json").write_text(json.dumps([{"cameras": cameras}]))
    return centres


def measure(images: Path, out: Path, truth: np.ndarray, fisheye: str) -> dict[str, float]:
    """Registered frames, ATE in mm and CPU seconds of one way."""
    before = _cpu_s()
    tiegraph.open(
        images, out, rig=str(images / "rig_config.json"), settings={"scan": {"fisheye": fisheye}}, pool="serial"
    ).run("georef")
    spent = _cpu_s() - before
    centres: dict[int, np.ndarray] = {}
    for image in load_model(out / "sparse" / "0").images.values():
        if image.has_pose and "left" in image.name.split("/")[0]:
            centres[int(Path(image.name).stem)] = image.projection_center()
    frames = sorted(centres)
    found = np.array([centres[k] for k in frames])
    error = np.linalg.norm(umeyama(found, truth[frames])(found) - truth[frames], axis=1)
    rms = float(np.sqrt((error**2).mean()))
    return {"frames": len(frames), "of": FRAMES, "ate_mm": round(1e3 * rms, 1), "cpu_s": round(spent, 1)}


def _cpu_s() -> float:
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    args = parser.parse_args()
    known = shots(args.work / "images")
    rows = {way: measure(args.work / "images", args.work / way, known, way) for way in ("whole", "views")}
    print(json.dumps(rows, indent=1))  # noqa: T201
    if args.out:
        args.out.write_text(json.dumps(rows, indent=1) + "\n")
