"""Faults of a rig: wrong keys and values of its file, and impossible sizes, sigmas and lenses."""

import re
import sys
from collections.abc import Iterator, Sequence
from math import dist
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import from_quaternion_wxyz
from tiegraph.scan.rigfiles.rigspec import UNIT, RigSpec
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import PAIR_KEYS, SensorPair, on_plane
from tiegraph.text import meant

MAX_SIDE_PX = 100_000  # of an image in a rig file
MODELS = tuple(m for m in pycolmap.CameraModelId.__members__ if m not in ("INVALID", "EQUIRECTANGULAR"))
SIGMA_M, SIGMA_DEG = (1e-6, 100.0), (1e-6, 180.0)  # range of the sigmas of lengths and angles
FOV_DEG = (1.0, 170.0)  # across a perspective image: the edges of the largest lie at tan(85) = 11 focal lengths
_STRETCH = (1 / 3, 10.0)  # limits of the field angle at the edge of the image with distortion over that without
_FISHEYE_LINES = 8  # of a fisheye image; those of a perspective one go to its corners and the middles of its sides
_EDGE = 0.95  # share of that line that is tested: calibrations may fold in the last corner pixels

# --- keys and values --------------------------------------------------------------------------------------------------


class Part:
    """A table of a rig file, or the file itself: its keys and values, checked with file, line and key in the errors."""

    def __init__(self, path: Path, lines: Sequence[str], span: tuple[int, int] | None, data: dict[str, Any]) -> None:
        """``span``: lines [first, last) of the table, None = of the file."""
        self.path, self.data, self._lines, self._span = path, data, lines, span

    def within(self, data: dict[str, Any]) -> "Part":
        """A table within this one, with the same lines."""
        return Part(self.path, self._lines, self._span, data)

    def fail(self, key: str, message: str) -> InputError:
        """The error of a key, with file and line."""
        return InputError(f"{self.at(key)}: {message}")

    def at(self, key: str) -> str:
        """File and line of a key, else of the table."""
        first, last = self._span or (0, len(self._lines))
        pattern = re.compile(rf'(^|[\s{{,"]){re.escape(key)}"?\s*[=:]|^\s*\[+\s*{re.escape(key)}\s*\]')
        found = (k for k in range(first, last) if pattern.search(self._lines[k].split("#", 1)[0]))
        line = next(found, first if self._span and first < last else -1) + 1
        return f"{self.path}{f', line {line}' if line else ''}"

    def known(self, valid: tuple[str, ...], where: str) -> None:
        """Raise InputError for a key that is not valid, with a near match."""
        for key in self.data:
            if key not in valid:
                said = f"unknown key {key!r} in {where}{meant(key, valid)} (valid: {', '.join(valid)})"
                raise self.fail(key, said)

    def numbers(self, key: str, count: int = 0) -> tuple[float, ...] | None:
        """A list of finite numbers, with the given count if any; None if the key is not there."""
        value = self.data.get(key)
        if value is None:
            return None
        good = isinstance(value, list) and all(is_number(v) for v in value)
        if not good or (count and len(value) != count):
            many = f"{count} " if count else ""
            raise self.fail(key, f"{key} = {value!r:.99}: expected a list of {many}finite numbers")
        return tuple(float(v) for v in value)

    def positive(self, key: str) -> float | None:
        """A finite number that is 0 or more; None if the key is not there."""
        value = self.data.get(key)
        if value is not None and (not is_number(value) or value < 0):
            raise self.fail(key, f"{key} = {value!r:.99}: expected a finite number, 0 or more")
        return None if value is None else float(value)

    def choice(self, key: str, valid: tuple[Any, ...]) -> Any:
        """One of the valid values, the first if the key is not there."""
        value = self.data.get(key, valid[0])
        if value not in valid or isinstance(value, bool) != isinstance(valid[0], bool):
            words = ", ".join(str(v).lower() if isinstance(v, bool) else str(v) for v in valid)
            raise self.fail(key, f"{key} = {value!r}: valid are {words}{meant(str(value), map(str, valid), 0.5)}")
        return value

    def model(self, key: str, params: tuple[float, ...] | None) -> str | None:
        """A COLMAP camera model's name, with the right number of parameters; None if the key is not there."""
        value = self.data.get(key)
        if value is None:
            return None
        if value not in MODELS:
            raise self.fail(key, f"unknown camera model {value!r}{meant(value, MODELS, 0.5)} (COLMAP's names)")
        if params is not None and (wrong := count_fault(value, params)):
            raise self.fail(key, wrong)
        return str(value)

    def quaternion(self, key: str) -> np.ndarray | None:
        """Rotation (3, 3) of a unit quaternion, w first; None if the key is not there."""
        q = self.numbers(key, 4)
        if q is None:
            return None
        if abs(np.linalg.norm(q) - 1) > UNIT:
            raise self.fail(key, f"{key}: the quaternion has length {np.linalg.norm(q):.4g}, not 1")
        return from_quaternion_wxyz(np.array(q), np.zeros(3))[:3, :3]


def is_number(value: Any) -> bool:
    """Whether a value of a file is a finite number within the range of a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) < sys.float_info.max


class Fault(NamedTuple):
    """A fault: the key in the ``number``-th sensor or pair, and the sentence."""

    table: str  # "sensors", "pairs" or "" = the rig itself
    number: int
    key: str
    message: str


def faults(spec: RigSpec, tuning: RigTuning) -> Iterator[Fault]:
    """All faults of the geometry of a rig, worst first."""
    yield from _far_apart(spec, tuning.max_rig_m)
    for number, sensor in enumerate(spec.sensors):
        sigmas = ("sigma_m", sensor.sigma_m, SIGMA_M), ("sigma_deg", sensor.sigma_deg, SIGMA_DEG)
        for key, value, (_, most) in sigmas:
            if value is not None and value > most:
                said = f"{key} = {value:g}: {most:g} at most; omit it if unknown"
                yield Fault(table="sensors", number=number, key=key, message=said)
    seen: dict[frozenset[str], int] = {}
    for number, pair in enumerate(spec.pairs):
        wrong = list(_pair(pair, tuning))
        first = seen.setdefault(frozenset(pair.sensors), number)
        if first != number:
            twice = f"pair {' - '.join(pair.sensors)} is given twice (pair {first + 1}): join the two"
            wrong.append(("sensors", twice))
        for key, said in wrong:
            yield Fault(table="pairs", number=number, key=key, message=said)


def contradictions(spec: RigSpec) -> list[str]:
    """Contradictions of pairs to positions and orientations; those of a nominal rig are no measurement."""
    places = {s.name: s.body_from_sensor for s in spec.sensors if s.body_from_sensor is not None}
    out = []
    for pair in spec.pairs:
        if spec.nominal or not set(pair.sensors) <= set(places):
            continue
        a, b = (places[n] for n in pair.sensors)
        axis = float(np.degrees(np.arccos(np.clip(a[:3, 2] @ b[:3, 2], -1, 1))))
        said = (
            (pair.baseline_m, pair.baseline_sigma_m, dist(a[:3, 3], b[:3, 3]), "m apart"),
            (pair.axis_deg, pair.axis_sigma_deg, axis, "degrees between the axes"),
        )
        out += [
            f"pair {' - '.join(pair.sensors)}: {value:g} {unit} with sigma {sigma:g}, but the sensors' own poses give "
            f"{found:.4g}: check which is right"
            for value, sigma, found, unit in said
            if value is not None and sigma is not None and abs(value - found) > 10 * sigma
        ]
    return out


def _far_apart(spec: RigSpec, most_m: float) -> Iterator[Fault]:
    placed = [(k, s.body_from_sensor) for k, s in enumerate(spec.sensors) if s.body_from_sensor is not None]
    remedy = f"more than {most_m:g} m: are these millimetres?"
    for n, (k, pose) in enumerate(placed):
        for j, other in placed[:n]:
            away = dist(pose[:3, 3], other[:3, 3])
            if not away <= most_m:
                names = f"{spec.sensors[k].name!r} is {away:g} m from {spec.sensors[j].name!r}"
                yield Fault(table="sensors", number=k, key="position_m", message=f"sensor {names}, {remedy}")
    if spec.antenna_m is not None and placed:
        near = min(dist(spec.antenna_m, pose[:3, 3]) for _, pose in placed)
        if not near <= most_m:
            said = f"antenna_m: {near:g} m from the nearest camera, {remedy}"
            yield Fault(table="", number=0, key="antenna_m", message=said)


def _pair(pair: SensorPair, tuning: RigTuning) -> Iterator[tuple[str, str]]:
    """Wrong keys of a pair, and why."""
    if all(getattr(pair, key) is None for key in PAIR_KEYS):
        yield "sensors", f"the pair has no measurement: give {', '.join(PAIR_KEYS)}"
    for key, (least, most) in zip(PAIR_KEYS, ((0.0, tuning.max_rig_m), SIGMA_M, (0.0, 180.0), SIGMA_DEG)):
        value = getattr(pair, key)
        if value is not None and not least <= value <= most:
            yield key, f"{key} = {value:g}: expected {least:g} to {most:g}"


def count_fault(model: str, params: Sequence[float]) -> str:
    """The fault in the number of parameters of a camera model, "" if none."""
    info = pycolmap.Camera.create_from_model_name(0, model, 1.0, 1, 1)
    said = f"{model} has {len(info.params)} parameters ({info.params_info}), got {len(params)}"
    return "" if len(params) == len(info.params) else said


def lens_fault(camera: pycolmap.Camera) -> str:
    """The fault of a calibrated camera, "" if none: focal lengths, principal point, view, distortion.

    Lines from the principal point to the edge of the image must become rays whose angle grows steadily, that are finite
    and project back to their pixels: distortion that folds the image maps two places of the world to one. Of a fisheye
    image only the middle is tested, because its circle may end before the edge.
    """
    width, height = camera.width, camera.height
    focal = [float(camera.params[k]) for k in camera.focal_length_idxs()]
    if not focal:
        return f"{camera.model.name} is no camera model of a rig: --rig panorama reads panoramas"
    if min(focal) <= 0:
        return f"the focal length is {min(focal):g} px: it must be above 0"
    if max(focal) > 2 * min(focal):
        return f"the focal lengths {focal[0]:g} and {focal[1]:g} px differ too much: fx and fy of nearly square pixels"
    fisheye = "FISHEYE" in camera.model.name or camera.model.name in ("EUCM", "EQUIRECTANGULAR")
    if wrong := focal_fault(min(focal), width, fisheye):
        return wrong
    middle = np.array([camera.principal_point_x, camera.principal_point_y])
    if not (0 < middle[0] < width and 0 < middle[1] < height):
        return (
            f"the principal point ({middle[0]:g}, {middle[1]:g}) is not inside the {width} x {height} image. If the "
            "parameters belong to another image size, give it as size = [width, height] in a rig.toml"
        )
    if (np.abs(middle / [width, height] - 0.5) > 0.4).all():
        return (
            f"the principal point ({middle[0]:g}, {middle[1]:g}) is in a corner of the {width} x {height} image: it "
            "counts pixels from the upper left corner, not from the middle, and is no fraction of the sides"
        )
    return _fold(camera, middle, fisheye)


def focal_fault(focal_px: float, width: int, fisheye: bool) -> str:
    """The fault of a focal length of images ``width`` px wide, "" if none."""
    ratio = width / 2 / focal_px
    across = float(np.degrees(2 * (ratio if fisheye else np.arctan(ratio))))
    least, most = FOV_DEG[0], 360.0 if fisheye else FOV_DEG[1]
    if least <= across <= most:
        return ""
    said = f"a focal length of {focal_px:g} px sees {across:.3g} degrees across {width} px"
    return f"{said}, not {least:g} to {most:g}: is it in millimetres, or of another image size?"


def _fold(camera: pycolmap.Camera, middle: np.ndarray, fisheye: bool) -> str:
    said = f"{camera.model.name} with the parameters {[float(f'{p:.6g}') for p in camera.params]}"
    limit = 0.01 * max(camera.width, camera.height)  # between a pixel and that to which its ray is projected back
    share = np.linspace(0, 1, 25)[1:, None]  # along a line from the middle to the edge
    for end in _ends(camera, middle, fisheye):
        if np.linalg.norm(end - middle) < limit:  # the principal point is at that edge
            continue
        pixels = middle + _EDGE * share * (end - middle)
        rays = np.column_stack([on_plane(camera, pixels), np.ones(len(pixels))])
        off = np.asarray(camera.img_from_cam(rays), float) - pixels
        lost = ~(np.hypot(off[:, 0], off[:, 1]) < limit)
        outward = rays[:, :2] @ (end - middle) / np.linalg.norm(end - middle)
        angle = np.arctan2(outward, rays[:, 2])
        lost |= ~(np.diff(angle, prepend=0.0) > 0)
        if lost.any():
            x, y = pixels[int(np.argmax(lost))]
            return f"{said} folds or tears the image at pixel ({x:.0f}, {y:.0f}): are the distortion parameters right?"
        straight = np.linalg.norm((end - middle) * _EDGE) / camera.mean_focal_length()
        stretch = float(angle[-1] if fisheye else np.tan(angle[-1])) / straight
        if not _STRETCH[0] <= stretch <= _STRETCH[1]:
            return (
                f"{said} moves the edge of the image {stretch:.2g} times as far out as without distortion: are the "
                "parameters those of normalised coordinates?"
            )
    return ""


def _ends(camera: pycolmap.Camera, middle: np.ndarray, fisheye: bool) -> np.ndarray:
    """(E, 2) ends of lines from the middle: the edge of the image, or the circle that any fisheye lens covers."""
    width, height = camera.width, camera.height
    if fisheye:
        turn = 2 * np.pi / _FISHEYE_LINES * np.arange(_FISHEYE_LINES)
        return middle + min(width, height) / 4 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    x, y = middle
    return np.array([[0, 0], [x, 0], [width, 0], [0, y], [width, y], [0, height], [x, height], [width, height]], float)
