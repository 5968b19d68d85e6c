"""Was the run wrong by more than three times its own sigma, and did it say so?

``right`` within it; ``said`` wrong, and a sentence names what is wrong; ``silent`` wrong, and none does; ``alarm`` a
survey without a fault that is right and yet said to contradict itself; ``failed`` ended by an error in words, which
counts as said; ``crashed`` ended otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from benchmarks.confront.given import Given
from benchmarks.confront.said import Said
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, geodetic_from_world, world_from_geodetic
from tiegraph.geometry.transforms import Similarity, umeyama

VERDICTS = ("right", "said", "silent", "alarm", "failed", "crashed")
SIGMAS = 3.0
BLUNDER_SHARE = 0.02  # of the images, or one stranger: at a wrong place
_BLUNDER_EXTENT, _BLUNDER_SIGMAS = 0.02, 10.0  # an image is at a wrong place beyond both
SEEING = 10  # points that an image must see to stand by itself
_KEPT = 0.5  # of a fault: a result that still has so much of it keeps what was handed over


@dataclass(frozen=True)
class Error:
    """One quantity: how wrong it is, the limit (three stated sigmas, or half the fault where it is held as given)."""

    quantity: str
    off: float
    sigma: float | None  # stated; None: held as given
    limit: float

    @property
    def wrong(self) -> bool:
        """Beyond the limit."""
        return bool(self.off > self.limit)


@dataclass(frozen=True)
class Judged:
    """Verdict, the quantities that are wrong (off in limits' units), how they were said, figures."""

    verdict: str
    wrong: tuple[str, ...]
    how: tuple[str, ...]
    errors: tuple[Error, ...]
    registered: int = 0

    def row(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


@dataclass(frozen=True)
class Poses:
    """A run's model: image -> cam_from_world (4, 4) and points seen; sensor -> focal length; where its world is."""

    cam_from_world: Mapping[str, np.ndarray]
    seen: Mapping[str, int]
    focal_px: Mapping[str, float]
    origin: Origin | None = None


def verdict(errors: tuple[Error, ...], said: Said, wrong_input: str, registered: int = 0) -> Judged:
    """The verdict on a run; ``wrong_input`` as ``faults.Fault.input``, "" for a survey without a fault."""
    if said.error:
        kind = "crashed" if "unexpected" in said.error or "Traceback" in said.error else "failed"
        return Judged(kind, (), (said.error[:300],), errors, registered)
    wrong = [e for e in errors if e.wrong]
    how = tuple(said.names(e.quantity, wrong_input) for e in wrong)
    if wrong:
        kind = "said" if all(how) else "silent"
        return Judged(kind, tuple(e.quantity for e in wrong), how, errors, registered)
    kind = "alarm" if not wrong_input and said.contradictions else "right"
    return Judged(kind, (), (), errors, registered)


def model_of(out: Path, given: Given, origin: dict | None) -> Poses:
    """The first model of a run, in its world."""
    folder = out / "sparse" / "world"
    model = pycolmap.Reconstruction(folder if folder.is_dir() else out / "sparse" / "0")
    poses, seen, focal = {}, {}, {}
    sensors = {s.folder: s.name for s in given.rig.sensors} if given.rig else {}
    folders = given.folders()
    for image in model.images.values():
        if image.has_pose:
            pose = image.cam_from_world()
            poses[image.name] = transforms.rigid(pose.rotation.matrix(), pose.translation)
            seen[image.name] = image.num_points3D
            if image.name in folders:
                name = sensors.get(folders[image.name], folders[image.name])
                focal[name] = float(model.camera(image.camera_id).mean_focal_length())
    return Poses(poses, seen, focal, Origin.from_dict(origin) if origin else None)


def errors_of(found: Poses, given: Given, said: Said, held: Mapping[str, float]) -> tuple[Error, ...]:
    """Every quantity that the run states and the truth knows."""
    truth = given.truth
    names = sorted(set(found.cam_from_world) & set(truth.cam_from_world))
    poses = _on_earth(found, truth.origin) if said.placed and truth.origin is not None else dict(found.cam_from_world)
    out = _strangers(found, given)
    if len(names) < 3:
        return tuple(out)
    here, true = (np.stack([transforms.centre(p[n]) for n in names]) for p in (poses, truth.cam_from_world))
    fit = umeyama(here, true)
    off = np.linalg.norm(fit(here) - true, axis=1)
    spread = float(np.sqrt(np.mean(np.sum((true - true.mean(axis=0)) ** 2, axis=1))))
    floor = truth.sigma_m
    if "camera" in said.sigma:
        own = _of_first(names, given)
        stated = said.sigma["camera"] * (1.0 if said.metric else fit.scale)
        out.append(_against("camera", float(np.median(off[own])), stated, floor))
        blunder = np.maximum(_BLUNDER_EXTENT * spread, _BLUNDER_SIGMAS * np.hypot(stated, floor))
        out.append(Error("images", float(np.mean(off > blunder)), None, BLUNDER_SHARE))
    shape = np.hypot(floor, float(np.median(off))) / spread  # what the fit itself leaves open
    if said.metric:
        limit = held.get("scale")
        out += _claim("scale", abs(fit.scale - 1), said, shape / np.sqrt(len(names)) + floor / spread, limit)
    if said.placed and truth.origin is not None:
        out += _placement(poses, truth, names, said, off)
    out += _rig(poses, given, said, (held, fit))
    for camera, focal in found.focal_px.items():
        if camera in truth.focal_px:
            share = abs(focal / truth.focal_px[camera] - 1)
            out += _claim(f"focal:{camera}", share, said, 0.001 if floor else 0.0, held.get(f"focal:{camera}"))
    return tuple(out)


def _of_first(names: list[str], given: Given) -> np.ndarray:
    """(N,) images of the first camera of their rig, whose places the stated sigma is of; all if there are few."""
    folders = given.folders()
    first = given.rig.sensors[0].folder if given.rig else ""
    own = np.array([folders.get(n, "") == first for n in names])
    return own if own.sum() >= 3 else np.ones(len(names), bool)


def _claim(quantity: str, off: float, said: Said, floor: float, held: float | None) -> list[Error]:
    """Against the stated sigma; without one only what a fault changed is judged: was it kept as given?"""
    sigma = said.sigma.get(quantity)
    if sigma is not None:
        return [_against(quantity, off, sigma, floor)]
    return [Error(quantity, off, None, max(_KEPT * held, SIGMAS * floor))] if held else []


def _against(quantity: str, off: float, sigma: float, floor: float) -> Error:
    return Error(quantity, off, sigma, SIGMAS * float(np.hypot(sigma, floor)))


def _strangers(found: Poses, given: Given) -> list[Error]:
    """Images of another place that have one here."""
    if not given.strangers:
        return []
    placed = sum(n in found.cam_from_world and found.seen.get(n, 0) >= SEEING for n in given.strangers)
    return [Error("images", float(placed), None, 0.5)]


def _on_earth(found: Poses, origin: Origin) -> dict[str, np.ndarray]:
    """The poses in the truth's world; both worlds are somewhere on the Earth."""
    assert found.origin is not None
    own = found.origin

    def there(points: np.ndarray) -> np.ndarray:
        return world_from_geodetic(geodetic_from_world(points, own), origin)

    centres = np.stack([transforms.centre(p) for p in found.cam_from_world.values()])
    middle = centres.mean(axis=0)
    axes = (there(middle + 10 * np.eye(3)) - there(middle)).T / 10  # columns: images of the axes
    u, _, vt = np.linalg.svd(axes)
    turn = u @ vt
    moved = there(centres)
    out = {}
    for (name, pose), centre in zip(found.cam_from_world.items(), moved):
        rotation = pose[:3, :3] @ turn.T
        out[name] = transforms.rigid(rotation, -rotation @ centre)
    return out


def _placement(poses: dict, truth: Any, names: list[str], said: Said, off: np.ndarray) -> list[Error]:
    """Place of the middle, heading and tilt, of the world against the truth's."""
    true = {n: truth.cam_from_world[n] for n in names}
    middle = np.mean([transforms.centre(poses[n]) - transforms.centre(true[n]) for n in names], axis=0)
    floor = float(np.hypot(truth.sigma_m, np.median(off) / np.sqrt(len(names))))
    out = [
        *_claim("plan", float(np.hypot(*middle[:2])), said, floor, None),
        *_claim("height", float(abs(middle[2])), said, floor, None),
    ]
    known = [n for n in names if np.isfinite(true[n]).all()]
    if known:
        turns = Rotation.from_matrix([poses[n][:3, :3].T @ true[n][:3, :3] for n in known])
        lean = np.degrees(turns.mean().as_rotvec())
        out += _claim("yaw", float(abs(lean[2])), said, truth.sigma_deg, None)
        out += _claim("tilt", float(np.hypot(*lean[:2])), said, truth.sigma_deg, None)
    return out


def _rig(poses: dict, given: Given, said: Said, more: tuple[Mapping[str, float], Similarity]) -> list[Error]:
    """Each camera against the first of its shot: median over the frames of what is found minus what is true."""
    held, fit = more
    if given.rig is None or len(given.rig.sensors) < 2:
        return []
    truth, out = given.truth, []
    first, *others = given.rig.sensors
    folders = given.folders()
    shot = {(given.frame_of(n), folders[n]): n for n in given.images}
    for sensor in others:
        places, turns = [], []
        for frame in {f for f, _ in shot}:
            pair = [shot.get((frame, s.folder)) for s in (first, sensor)]
            if any(n not in poses or n not in truth.cam_from_world for n in pair):
                continue
            (a, b), (ta, tb) = ([p[n] for n in pair] for p in (poses, truth.cam_from_world))
            found, true = b @ transforms.invert(a), tb @ transforms.invert(ta)
            if not np.isfinite(true).all():
                continue
            places.append(transforms.centre(found) * (1.0 if said.metric else fit.scale) - transforms.centre(true))
            turns.append(transforms.angle_deg(found[:3, :3], true[:3, :3]))
        if not places:
            continue
        place = float(np.linalg.norm(np.median(places, axis=0)))
        if said.metric:
            out += _claim(f"place:{sensor.name}", place, said, truth.sigma_m, held.get(f"place:{sensor.name}"))
        turn = float(np.median(turns))
        out += _claim(f"turn:{sensor.name}", turn, said, truth.sigma_deg, held.get(f"turn:{sensor.name}"))
    return out
