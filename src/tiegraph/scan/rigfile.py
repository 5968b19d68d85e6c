"""Rig files: tiegraph's rig.toml and COLMAP's rig_config.json, read and written.

rig.toml::

    name = "boat"            # optional
    axes = "flu"             # axes of the body frame: camera (right, down, forward: default), flu, frd or rfu
    fixed = false            # true: calibrated, never refined
    nominal = false          # true: orientations from a drawing, degrees off
    antenna_m = [0.9, 0.6, 0.3]      # GNSS antenna in the body frame

    [camera]                 # optional: what all sensors share
    model = "OPENCV"         # COLMAP's model and order of parameters
    size = [3072, 2048]      # width, height the parameters belong to; rescaled to images of the same shape
    params = [2759.5, 2764.2, 1520.7, 1006.8, 0, 0, 0, 0]     # or focal_px = 2760, or hfov_deg = 58

    [[sensors]]              # the first one is the reference
    name = "cam0"
    folder = "cam0"          # optional, default = name; "" = every image that no other sensor takes
    role = "side"            # side, up or wide
    position_m = [0, 0, 0.06]                # projection centre in the body frame
    yaw_pitch_roll_deg = [0, 0, 0]           # yaw to the right, pitch up, roll clockwise as the camera sees it
    # or body_from_sensor_wxyz = [1, 0, 0, 0], or body_from_sensor = 3 rows of 3 (rotation) or 4 numbers (with position)
    sigma_deg = 0.1                          # optional: how well its orientation and its place are known;
    sigma_m = 0.002                          # a sensor with sigmas is adjusted about what is given
    crop_px = [0, 0, 0, 0]                   # optional: left, top, right, bottom
    camera = {hfov_deg = 90}                 # optional: instead of the shared one

    [[pairs]]                # optional: what was measured between two sensors, with its sigma
    sensors = ["cam0", "cam2"]
    baseline_m = 0.152       # distance of the projection centres
    baseline_sigma_m = 0.001
    axis_deg = 144.0         # angle between the optical axes
    axis_sigma_deg = 0.1

The frame of a trajectory given beside a rig file is this body frame. Without orientation a sensor's place is unknown.
"""

from __future__ import annotations

import difflib
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import from_quaternion_wxyz, invert, rigid
from tiegraph.scan.rigspec import AXES, RigSpec, SensorSpec, orient
from tiegraph.scene.regular import regular
from tiegraph.scene.rig import PAIR_KEYS, ROLES, SensorPair

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_RIG_KEYS = ("name", "axes", "fixed", "nominal", "antenna_m", "camera", "sensors", "pairs")
_SENSOR_KEYS = (
    "name", "folder", "role", "position_m", "yaw_pitch_roll_deg", "body_from_sensor_wxyz", "body_from_sensor",
    "crop_px", "camera", "sigma_deg", "sigma_m",
)  # fmt: skip
_CAMERA_KEYS = ("model", "size", "params", "focal_px", "hfov_deg")
_COLMAP_KEYS = (
    "image_prefix", "ref_sensor", "cam_from_rig_rotation", "cam_from_rig_translation", "camera_model_name",
    "camera_params",
)  # fmt: skip
_TURNS = ("yaw_pitch_roll_deg", "body_from_sensor_wxyz", "body_from_sensor")


def read_rig_file(path: Path) -> tuple[RigSpec, ...]:
    """Rigs of a rig.toml (one) or a COLMAP rig_config.json (one or more).

    Raises InputError with file, line and key for what is missing, unknown, misspelt or of the wrong kind.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(
            f"--rig {path}: no such file, and no preset: ladybug5, ring:N, stereo, stereo:BASELINE, single, panorama"
        )
    try:
        text = regular(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    if path.suffix.lower() == ".json":
        return _ColmapReader(path, text).rigs()
    return (_TomlReader(path, text).rig(),)


class _Reader:
    """Checks of keys and values that name the file, the line and the key."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.lines = path, text.splitlines()

    def fail(self, key: str, message: str, table: str = "", number: int = 0) -> InputError:
        line = self.line(key, table, number)
        return InputError(f"{self.path}{f', line {line}' if line else ''}: {message}")

    def line(self, key: str, table: str, number: int) -> int:
        """Line of a key in the ``number``-th table, 0 if not found."""
        start, seen = 0, -1
        if table:
            for k, text in enumerate(self.lines):
                seen += bool(re.match(table, text))
                if seen == number:
                    start = k
                    break
        pattern = re.compile(rf'(^|[\s{{,"]){re.escape(key)}"?\s*[=:]')
        for k in range(start, len(self.lines)):
            if pattern.search(self.lines[k]) or re.match(rf"\s*\[+\s*{re.escape(key)}\s*\]", self.lines[k]):
                return k + 1
        return start + 1 if table and seen == number else 0

    def known(self, data: dict, valid: tuple[str, ...], where: str, table: str = "", number: int = 0) -> None:
        for key in data:
            if key not in valid:
                near = difflib.get_close_matches(key, valid, n=1)
                hint = f"; perhaps you meant {near[0]!r}?" if near else ""
                raise self.fail(key, f"unknown key {key!r} in {where}{hint} (valid: {', '.join(valid)})", table, number)

    def numbers(
        self, data: dict, key: str, count: tuple[int, ...], table: str = "", number: int = 0
    ) -> tuple[float, ...] | None:
        value = data.get(key)
        if value is None:
            return None
        good = isinstance(value, list) and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value)
        if not good or (count and len(value) not in count) or not np.isfinite(value).all():
            many = f"{' or '.join(map(str, count))} " if count else ""
            raise self.fail(key, f"{key} = {value!r}: expected a list of {many}finite numbers", table, number)
        return tuple(float(v) for v in value)

    def choice(self, data: dict, key: str, valid: tuple[Any, ...], table: str = "", number: int = 0) -> Any:
        value = data.get(key, valid[0])
        if value not in valid or isinstance(value, bool) != isinstance(valid[0], bool):
            words = ", ".join(str(v).lower() if isinstance(v, bool) else str(v) for v in valid)
            raise self.fail(key, f"{key} = {value!r}: valid are {words}{_near(value, valid)}", table, number)
        return value

    def model(self, value: Any, params: Any, table: str = "", number: int = 0, key: str = "model") -> str:
        """A COLMAP camera model name, with the right number of parameters."""
        valid = tuple(m for m in pycolmap.CameraModelId.__members__ if m != "INVALID")
        if value not in valid:
            raise self.fail(key, f"unknown camera model {value!r}{_near(value, valid)} (COLMAP's names)", table, number)
        info = pycolmap.Camera.create_from_model_name(0, value, 1.0, 1, 1)
        if params is not None and len(params) != len(info.params):
            message = f"{value} has {len(info.params)} parameters ({info.params_info}), got {len(params)}"
            raise self.fail(key, message, table, number)
        return str(value)

    def quaternion(self, q: tuple[float, ...], key: str, table: str = "", number: int = 0) -> np.ndarray:
        if abs(np.linalg.norm(q) - 1) > 1e-3:
            raise self.fail(key, f"{key}: the quaternion has length {np.linalg.norm(q):.4g}, not 1", table, number)
        return from_quaternion_wxyz(np.array(q), np.zeros(3))[:3, :3]


def _near(value: Any, valid: tuple[Any, ...]) -> str:
    near = difflib.get_close_matches(str(value), [str(v) for v in valid], n=1, cutoff=0.5)
    return f"; perhaps you meant {near[0]!r}?" if near else ""


_SENSORS_TABLE = r"\s*\[\[\s*sensors\s*\]\]"


class _TomlReader(_Reader):
    def rig(self) -> RigSpec:
        try:
            data = tomllib.loads("\n".join(self.lines))
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{self.path}: not a valid TOML file: {error}") from None
        self.known(data, _RIG_KEYS, "the rig")
        axes = self.choice(data, "axes", tuple(AXES))
        shared = self.camera(data.get("camera", {}), "[camera]", "", 0)
        tables = data.get("sensors", [])
        if not isinstance(tables, list) or not tables or not all(isinstance(t, dict) for t in tables):
            raise self.fail("sensors", "the rig needs at least one [[sensors]] table with a name")
        sensors = tuple(self.sensor(t, k, axes, shared) for k, t in enumerate(tables))
        for key, values in (("name", [s.name for s in sensors]), ("folder", [s.folder or s.name for s in sensors])):
            twice = next((k for k, v in enumerate(values) if v in values[:k]), None)
            if twice is not None:
                raise self.fail(key, f"two sensors have the {key} {values[twice]!r}", _SENSORS_TABLE, twice)
        return RigSpec(
            name=str(data.get("name", self.path.stem)),
            sensors=sensors,
            fixed=self.choice(data, "fixed", (False, True)),
            nominal=self.choice(data, "nominal", (False, True)),
            antenna_m=self.numbers(data, "antenna_m", (3,)),  # type: ignore[arg-type]
            axes=axes,
            pairs=self.pairs(data.get("pairs", []), [s.name for s in sensors]),
            file=str(self.path),
        )

    def sensor(self, data: dict, number: int, axes: str, shared: dict) -> SensorSpec:
        at = (_SENSORS_TABLE, number)
        where = f"sensor {data.get('name', number + 1)!r}"
        self.known(data, _SENSOR_KEYS, where, *at)
        if not isinstance(data.get("name"), str) or not data["name"]:
            raise self.fail("name", f"{where} needs a name", *at)
        folder = data.get("folder")
        if folder is not None and not isinstance(folder, str):
            raise self.fail("folder", f"folder = {folder!r}: expected text", *at)
        camera = self.camera(data["camera"], where, *at) if "camera" in data else shared
        crop = self.numbers(data, "crop_px", (4,), *at)
        if crop is not None and (min(crop) < 0 or any(c != int(c) for c in crop)):
            raise self.fail("crop_px", f"crop_px = {list(crop)}: expected whole pixels, none below 0", *at)
        return SensorSpec(
            name=data["name"],
            folder=None if folder is None else folder.strip("/"),
            role=self.choice(data, "role", ROLES, *at),
            body_from_sensor=self.pose(data, axes, *at),
            crop_px=None if crop is None else tuple(int(c) for c in crop),  # type: ignore[arg-type]
            sigma_deg=self.positive(data, "sigma_deg", *at),
            sigma_m=self.positive(data, "sigma_m", *at),
            **camera,
        )

    def pairs(self, tables: Any, names: list[str]) -> tuple[SensorPair, ...]:
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise self.fail("pairs", "pairs: expected [[pairs]] tables")
        out = []
        for number, data in enumerate(tables):
            at = (r"\s*\[\[\s*pairs\s*\]\]", number)
            self.known(data, ("sensors", *PAIR_KEYS), f"pair {number + 1}", *at)
            both = data.get("sensors")
            if not isinstance(both, list) or len(both) != 2 or both[0] == both[1] or not set(both) <= set(names):
                raise self.fail("sensors", f"sensors = {both!r}: expected two of {', '.join(names)}", *at)
            values = {key: self.positive(data, key, *at) for key in PAIR_KEYS}
            for value, sigma in (PAIR_KEYS[:2], PAIR_KEYS[2:]):
                if (values[value] is None) != (values[sigma] is None):
                    raise self.fail(value, f"pair {both[0]} - {both[1]}: {value} and {sigma} belong together", *at)
            out.append(SensorPair((both[0], both[1]), **values))
        return tuple(out)

    def positive(self, data: dict, key: str, table: str, number: int) -> float | None:
        value = data.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < np.inf:
            raise self.fail(key, f"{key} = {value!r}: expected a number, 0 or more", table, number)
        return float(value)

    def pose(self, data: dict, axes: str, table: str, number: int) -> np.ndarray | None:
        turns = [t for t in _TURNS if t in data]
        if len(turns) > 1:
            raise self.fail(turns[1], f"give one of {', '.join(_TURNS)}, not {' and '.join(turns)}", table, number)
        position = self.numbers(data, "position_m", (3,), table, number)
        if not turns:
            if position is None:
                return None
            raise self.fail(
                "position_m", f"position_m needs an orientation too: one of {', '.join(_TURNS)}", table, number
            )
        if turns[0] == "body_from_sensor":
            return self.matrix(data, position, table, number)
        values = self.numbers(data, turns[0], (3,) if turns[0].startswith("yaw") else (4,), table, number)
        assert values is not None
        rotation = orient(*values, axes) if len(values) == 3 else self.quaternion(values, turns[0], table, number)
        return rigid(rotation, np.array(position or (0.0, 0.0, 0.0)))

    def matrix(self, data: dict, position: tuple[float, ...] | None, table: str, number: int) -> np.ndarray:
        key = "body_from_sensor"
        try:
            matrix = np.array(data[key], float)
        except (TypeError, ValueError):
            matrix = np.zeros(0)
        if matrix.shape not in ((3, 3), (3, 4), (4, 4)):
            raise self.fail(key, f"{key}: expected 3 rows of 3 or 4 numbers", table, number)
        rotation = matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(rotation) < 0:
            raise self.fail(
                key, f"{key}: not a rotation (rows of length 1, at right angles, right-handed)", table, number
            )
        if matrix.shape == (3, 3):
            return rigid(rotation, np.array(position or (0.0, 0.0, 0.0)))
        if position is not None:
            raise self.fail("position_m", f"position_m is already in the last column of {key}", table, number)
        return rigid(rotation, matrix[:3, 3])

    def camera(self, data: Any, where: str, table: str, number: int) -> dict:
        at = (table or r"\s*\[\s*camera\s*\]", number)
        if not isinstance(data, dict):
            raise self.fail("camera", f"camera of {where}: expected a table such as {{hfov_deg = 90}}", *at)
        self.known(data, _CAMERA_KEYS, f"the camera of {where}", *at)
        params, size = self.numbers(data, "params", (), *at), self.numbers(data, "size", (2,), *at)
        given = [k for k in ("params", "focal_px", "hfov_deg") if k in data]
        if len(given) > 1:
            raise self.fail(given[1], f"camera of {where}: give one of {', '.join(given)}", *at)
        if params is not None and "model" not in data:
            raise self.fail("params", f"camera of {where}: params need a model, for example OPENCV", *at)
        model = self.model(data["model"], params, *at) if "model" in data else None
        for key, most in (("focal_px", 1e6), ("hfov_deg", 179.0)):
            value = data.get(key, 1.0)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value <= most:
                raise self.fail(key, f"{key} = {value!r}: expected a number above 0, at most {most:g}", *at)
        if size is not None and min(size) < 1:
            raise self.fail("size", f"size = {data['size']!r}: expected width and height in pixels", *at)
        return {
            "model": model,
            "size": None if size is None else (int(size[0]), int(size[1])),
            "params": params,
            "focal_px": data.get("focal_px"),
            "hfov_deg": data.get("hfov_deg"),
        }


class _ColmapReader(_Reader):
    def rigs(self) -> tuple[RigSpec, ...]:
        try:
            data = json.loads("\n".join(self.lines))
        except json.JSONDecodeError as error:
            raise InputError(f"{self.path}, line {error.lineno}: not valid JSON: {error.msg}") from None
        if not isinstance(data, list) or not data or not all(isinstance(r, dict) for r in data):
            raise InputError(f'{self.path}: COLMAP rig files are a list of rigs: [{{"cameras": [...]}}]')
        return tuple(self.rig(r, k, len(data)) for k, r in enumerate(data))

    def rig(self, data: dict, number: int, count: int) -> RigSpec:
        self.known(data, ("cameras",), f"rig {number + 1}")
        cameras = data.get("cameras", [])
        if not isinstance(cameras, list) or not cameras or not all(isinstance(c, dict) for c in cameras):
            raise self.fail("cameras", f"rig {number + 1} needs a list of cameras")
        references = [k for k, c in enumerate(cameras) if c.get("ref_sensor") is True]
        if len(references) != 1:
            raise self.fail(
                "ref_sensor", f"rig {number + 1}: exactly one camera must have ref_sensor, got {len(references)}"
            )
        order = references + [k for k in range(len(cameras)) if k not in references]
        sensors = tuple(self.sensor(cameras[k], k) for k in order)
        name = self.path.stem if count == 1 else f"{self.path.stem} {number + 1}"
        return RigSpec(name, sensors, file=str(self.path), body_is_reference=True)

    def sensor(self, data: dict, number: int) -> SensorSpec:
        at = (r'.*"image_prefix"', number)
        self.known(data, _COLMAP_KEYS, f"camera {number + 1}")
        prefix = data.get("image_prefix")
        if not isinstance(prefix, str):
            raise self.fail("image_prefix", f"camera {number + 1} needs an image_prefix")
        params = self.numbers(data, "camera_params", (), *at)
        model = data.get("camera_model_name")
        if (model is None) != (params is None):
            raise self.fail("camera_params", f"{prefix}: camera_model_name and camera_params belong together", *at)
        folder = prefix.strip("/")
        return SensorSpec(
            name=folder or "camera",
            folder=folder,
            body_from_sensor=self.pose(data, number),
            model=None if model is None else self.model(model, params, *at, "camera_model_name"),
            params=params,
        )

    def pose(self, data: dict, number: int) -> np.ndarray | None:
        at = (r'.*"image_prefix"', number)
        q = self.numbers(data, "cam_from_rig_rotation", (4,), *at)
        t = self.numbers(data, "cam_from_rig_translation", (3,), *at)
        if data.get("ref_sensor"):
            if q is not None or t is not None:
                raise self.fail(
                    "cam_from_rig_rotation", "the reference sensor is the rig frame: leave its pose away", *at
                )
            return np.eye(4)
        if q is None and t is None:
            return None
        if q is None or t is None:
            raise self.fail("image_prefix", "cam_from_rig_rotation and cam_from_rig_translation belong together", *at)
        return invert(rigid(self.quaternion(q, "cam_from_rig_rotation", *at), np.array(t)))
