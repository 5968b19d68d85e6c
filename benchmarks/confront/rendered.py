"""Small rendered surveys with exact truth: a vehicle's ring of cameras on a straight way at constant speed, and a boat
there and back. Each image is rendered at its own time, so that cameras can fire apart."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.confront.given import Given, Picture, Positions, Truth, pinhole
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.rig import Rig, Sensor

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))

import worlds  # the corridor of the tests

ORIGIN = Origin(35.6965, 139.7695, 40.0)
START_S = 36000.0
SIZE = (320, 240)
FOCAL_PX = 0.66 * SIZE[0]
GNSS_SIGMA_M, GNSS_HZ = 0.02, 5.0
_HEIGHT_M = 1.7

# name -> heading of the camera (deg, to port) and its place in the body (forward, port, up), metres
VEHICLE = {
    "left": (80.0, (0.1, 0.5, 0.0)), "right": (-80.0, (0.1, -0.5, 0.0)),
    "front_left": (35.0, (0.8, 0.3, 0.05)), "front_right": (-35.0, (0.8, -0.3, 0.05)),
}  # fmt: skip
BOAT = {"cam0": (80.0, (0.1, 0.35, 0.0)), "cam1": (-80.0, (0.1, -0.35, 0.0))}


class Way:
    """A body's path: ``kind`` vehicle (one pass, straight, constant speed) or boat (there and back, it sways)."""

    def __init__(self, kind: str, frames: int, seed: int) -> None:
        self.kind, self.frames, self.seed = kind, frames, seed
        self.passes = ("drive",) if kind == "vehicle" else ("up", "down")
        self.step_s = 0.2 if kind == "vehicle" else 1.0
        self.speed = 5.0 if kind == "vehicle" else 1.3
        self.length_m = self.speed * self.step_s * frames

    def start_s(self, track: str) -> float:
        """When a pass begins."""
        return START_S + 200.0 * self.passes.index(track)

    def body(self, track: str, time_s: np.ndarray) -> np.ndarray:
        """(T, 4, 4) world_from_body (forward, port, up) at times."""
        t = np.asarray(time_s, float) - self.start_s(track)
        way = self.speed * t
        if self.kind == "vehicle":
            x, y, yaw, turned = way, np.full(len(t), -0.3), np.zeros(len(t)), 0.0
        else:
            phase = 1.0 if track == "up" else 2.5
            sway = 0.3 * np.sin(way / 3 + phase)
            yaw = np.radians(4.0) * np.sin(way / 2 + phase)
            back = track == "down"
            x = self.length_m + 0.6 - way if back else way
            y, turned = (0.6 + sway, np.pi) if back else (-0.6 + sway, 0.0)
        rotation = np.zeros((len(t), 3, 3))
        rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw + turned)
        rotation[:, 1, 0], rotation[:, 0, 1] = np.sin(yaw + turned), -np.sin(yaw + turned)
        rotation[:, 2, 2] = 1
        return transforms.rigid(rotation, np.stack([x, y, np.full(len(t), _HEIGHT_M)], axis=1))


def mountings(kind: str) -> dict[str, np.ndarray]:
    """Sensor -> cam_from_body (4, 4)."""
    out = {}
    for name, (heading_deg, place) in (VEHICLE if kind == "vehicle" else BOAT).items():
        a = np.radians(heading_deg)
        rotation = np.array([[np.sin(a), -np.cos(a), 0], [0, 0, -1], [np.cos(a), np.sin(a), 0]])
        out[name] = transforms.rigid(rotation, -rotation @ np.array(place))
    return out


def survey(folder: Path, kind: str, frames: int, seed: int = 0, late_s: Mapping[str, float] | None = None) -> Given:
    """A rendered survey below ``folder``; ``late_s``: sensor -> by how much it fires after the frame's time.

    What is rendered already is used again.
    """
    way, cams, late = Way(kind, frames, seed), mountings(kind), dict(late_s or {})
    world = worlds.corridor(seed, length_m=way.length_m)
    camera = pinhole(*SIZE, FOCAL_PX)
    truth, pictures, times = {}, {}, {}
    for track in way.passes:
        stamps = way.start_s(track) + way.step_s * np.arange(frames)
        for name, cam_from_body in cams.items():
            bodies = way.body(track, stamps + late.get(name, 0.0))
            for k, body in enumerate(bodies):
                image = f"{track}/{name}/{k:06d}.jpg" if len(way.passes) > 1 else f"{name}/{k:06d}.jpg"
                truth[image] = cam_from_body @ transforms.invert(body)
                pictures[image] = Picture(folder / image)
                if name == next(iter(cams)):
                    times[image] = float(stamps[k])
    _render(folder, world, camera, truth, late)
    reference = next(iter(cams.values()))
    sensors = tuple(Sensor(n, camera, c @ transforms.invert(reference), folder=n) for n, c in cams.items())
    rig = Rig(kind, sensors)
    known = Truth(truth, ORIGIN, {n: FOCAL_PX for n in cams}, 0.0, 0.0)
    return Given(dict(sorted(pictures.items())), known, rig, _positions(way, reference, seed), times)


def _render(folder: Path, world: worlds.Corridor, camera, truth: Mapping[str, np.ndarray], late: dict) -> None:
    done = folder / "late.json"
    same = done.exists() and json.loads(done.read_text()) == late
    for name, pose in truth.items():
        path = folder / name
        if not (same and path.exists()):
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), world.render(camera, pose), [cv2.IMWRITE_JPEG_QUALITY, 95])
    done.write_text(json.dumps(late))


def _positions(way: Way, reference: np.ndarray, seed: int) -> Positions:
    """RTK at the reference camera (no lever arm), white noise of the stated sigma."""
    rng = np.random.default_rng([seed, 7])
    rows, times = [], []
    for track in way.passes:
        t = way.start_s(track) + np.arange(0, way.step_s * way.frames, 1 / GNSS_HZ)
        pose = way.body(track, t) @ transforms.invert(reference)
        rows.append(pose[:, :3, 3] + rng.normal(0, [GNSS_SIGMA_M, GNSS_SIGMA_M, 1.5 * GNSS_SIGMA_M], (len(t), 3)))
        times.append(t)
    place, time_s = np.concatenate(rows), np.concatenate(times)
    return Positions(time_s, place, np.tile([GNSS_SIGMA_M, 1.5 * GNSS_SIGMA_M], (len(place), 1)), ORIGIN)


def fired_apart(given: Given, folder: Path, kind: str, frames: int, late_s: Mapping[str, float]) -> Given:
    """The same survey whose cameras fire apart: images rendered anew, times and rig as stated before."""
    other = survey(folder, kind, frames, 0, late_s)
    return replace(given, images=other.images, truth=other.truth)
