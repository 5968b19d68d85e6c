"""Rig files: tiegraph's rig.toml, COLMAP's rig_config.json and Kalibr's camchain.yaml (``camerafile``), read.

rig.toml::

    name = "boat"            # optional, default "rig"
    axes = "flu"             # axes of the body frame: camera (right, down, forward: default), flu, frd or rfu
    fixed = false            # true: calibrated, never refined
    nominal = false          # true: orientations from a drawing, degrees off
    synchronised = false     # true: all cameras fire at one instant (a wire, a trigger); false: the images decide
    antenna_m = [0.9, 0.6, 0.3]      # GNSS antenna in the body frame

    [camera]                 # optional: what all sensors share
    model = "OPENCV"         # COLMAP's model and order of parameters
    size = [3072, 2048]      # width, height the parameters belong to; rescaled to images of the same shape
    params = [2759.5, 2764.2, 1520.7, 1006.8, 0, 0, 0, 0]     # or focal_px = 2760, or hfov_deg = 58
    sigma_px = 0.4           # optional: of the focal length; a camera with one is adjusted, one without held as it is

    [[sensors]]              # the first one is the reference
    name = "cam0"
    folder = "cam0"          # optional, default = name; "" = every image that no other sensor takes; "*_GRE" = the
                             # images whose names end so, for cameras that write into one folder
    role = "side"            # side; up (looks at the sky, or the bridge above); wide: the wide cameras of a rig alone
                             # carry structure from motion, the others hang on the rig, which must be calibrated
    position_m = [0, 0, 0.06]                # projection centre in the body frame
    yaw_pitch_roll_deg = [0, 0, 0]           # yaw to the right, pitch up, roll clockwise as the camera sees it
    # or body_from_sensor_wxyz = [1, 0, 0, 0], or body_from_sensor = 3 rows of 3 (rotation) or 4 numbers (with position)
    sigma_deg = 0.1                          # optional: how well its orientation and its place are known;
    sigma_m = 0.002                          # a sensor with sigmas is adjusted about what is given
    crop_px = [0, 0, 0, 0]                   # optional: left, top, right, bottom
    camera = {hfov_deg = 90}                 # optional: instead of the shared one; {file = "left.yaml"}: a calibration
                                             # of another program, as of ``--camera``, beside the rig file

    [[pairs]]                # optional: what was measured between two sensors, with its sigma
    sensors = ["cam0", "cam2"]
    baseline_m = 0.152       # distance of the projection centres
    baseline_sigma_m = 0.001
    axis_deg = 144.0         # angle between the optical axes
    axis_sigma_deg = 0.1

The frame of a trajectory given beside a rig file is this body frame. Without orientation a sensor's place is unknown.
"""

import json
import re
import sys
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.scan.rigfiles.camerafile import check_lens, kalibr_rig, read_camera_file
from tiegraph.scan.rigfiles.cameraread import only_one
from tiegraph.scan.rigfiles.rigfaults import MAX_SIDE_PX, faults, lens_fault
from tiegraph.scan.rigfiles.rigreader import Reader, is_number
from tiegraph.scan.rigfiles.rigspec import AXES, PRESET_WORDS, UNIT, RigSpec, SensorSpec, orient
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.regular import regular
from tiegraph.scene.rig import PAIR_KEYS, ROLES, SensorPair
from tiegraph.text import composed

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_RIG_KEYS = ("name", "axes", "fixed", "nominal", "synchronised", "antenna_m", "camera", "sensors", "pairs")
_SENSOR_KEYS = (
    "name", "folder", "role", "position_m", "yaw_pitch_roll_deg", "body_from_sensor_wxyz", "body_from_sensor",
    "crop_px", "camera", "sigma_deg", "sigma_m",
)  # fmt: skip
_CAMERA_KEYS = ("model", "size", "params", "focal_px", "hfov_deg", "file", "sigma_px")
_COLMAP_KEYS = (
    "image_prefix", "ref_sensor", "cam_from_rig_rotation", "cam_from_rig_translation", "camera_model_name",
    "camera_params",
)  # fmt: skip
_KALIBR = (".yaml", ".yml")
RIG_NAME = "rig"  # of a file that gives none: a file's own name says how it was sent, not what it describes
_TURNS = ("yaw_pitch_roll_deg", "body_from_sensor_wxyz", "body_from_sensor")
_MAX_FOCAL_PX = 1e6  # that a rig file may name


def read_rig_file(path: Path | str, tuning: RigTuning) -> tuple[RigSpec, ...]:
    """Rigs of a rig.toml or Kalibr's camchain.yaml (one) or a COLMAP rig_config.json (one or more).

    Raises InputError with file, line and key for what is missing, unknown, misspelt or of the wrong kind.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"--rig {path}: no such file, and no preset: {PRESET_WORDS}")
    if path.is_dir():
        raise InputError(f"--rig {path}: a folder, not a file, and no run folder of tiegraph: give one of these")
    try:
        text = composed(regular(path).read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text in UTF-8 ({error})") from None
    if path.suffix.lower() in _KALIBR:
        return (kalibr_rig(path, text, RIG_NAME, tuning),)
    return parse_rig_file(path, text, tuning, path.suffix.lower() == ".json")


def parse_rig_file(path: Path, text: str, tuning: RigTuning, colmap: bool = False) -> tuple[RigSpec, ...]:
    """The rigs of the text of a rig.toml or rig_config.json that comes from ``path``. Raises InputError, naming it."""
    reader = _ColmapReader(path, text, tuning) if colmap else _TomlReader(path, text, tuning)
    try:
        rigs = reader.rigs()
    except RecursionError:
        raise InputError(f"{path}: too many brackets within brackets to be a rig file") from None
    for rig in rigs:
        for fault in faults(rig, tuning):
            raise reader.fault(fault, rig)
    return rigs


def camera_table(path: Path, text: str, tuning: RigTuning) -> SensorSpec:
    """The camera of a rig.toml with one sensor, or with a table [camera] alone. Raises InputError."""
    reader = _TomlReader(path, text, tuning)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a valid TOML file: {error}") from None
    if data.get("sensors"):
        sensors = reader.rig().sensors
        if len(sensors) > 1:
            raise InputError(f"--camera {path}: a rig of {len(sensors)} sensors; give it by --rig")
        found = sensors[0]
    else:
        reader.known(data, ("camera", "name"), "a camera's file")
        camera = reader.camera(data.get("camera", {}), "[camera]", "", 0)
        found = SensorSpec("camera", **camera)
    if not found.at:
        raise InputError(f"--camera {path}: no params, focal_px or hfov_deg in a table [camera]")
    return found


_SENSORS_TABLE = r"\s*\[\[\s*sensors\s*\]\]"
_PAIRS_TABLE = r"\s*\[\[\s*pairs\s*\]\]"


class _TomlReader(Reader):
    tables: ClassVar[dict[str, str]] = {"sensors": _SENSORS_TABLE, "pairs": _PAIRS_TABLE}

    def rigs(self) -> tuple[RigSpec, ...]:
        return (self.rig(),)

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
            name=str(data.get("name", RIG_NAME)),
            sensors=sensors,
            fixed=self.choice(data, "fixed", (False, True)),
            nominal=self.choice(data, "nominal", (False, True)),
            synchronised=self.choice(data, "synchronised", (False, True)),
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
            number=number,
            **camera,
        )

    def pairs(self, tables: Any, names: list[str]) -> tuple[SensorPair, ...]:
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise self.fail("pairs", "pairs: expected [[pairs]] tables")
        out = []
        for number, data in enumerate(tables):
            at = (_PAIRS_TABLE, number)
            self.known(data, ("sensors", *PAIR_KEYS), f"pair {number + 1}", *at)
            both = data.get("sensors")
            good = isinstance(both, list) and len(both) == 2 and all(b in names for b in both)
            if not good or both[0] == both[1]:
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
        if not is_number(value) or value < 0:
            raise self.fail(key, f"{key} = {value!r:.99}: expected a finite number, 0 or more", table, number)
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
        if len(values) == 3 and max(map(abs, values)) > 360.0:
            raise self.fail(turns[0], f"{turns[0]} = {list(values)}: expected degrees, 360 at most", table, number)
        rotation = orient(*values, axes) if len(values) == 3 else self.quaternion(values, turns[0], table, number)
        return rigid(rotation, np.array(position or (0.0, 0.0, 0.0)))

    def matrix(self, data: dict, position: tuple[float, ...] | None, table: str, number: int) -> np.ndarray:
        key = "body_from_sensor"
        try:
            matrix = np.array(data[key], float)
        except (TypeError, ValueError, OverflowError):
            matrix = np.zeros(0)
        if matrix.shape not in ((3, 3), (3, 4), (4, 4)) or not np.isfinite(matrix).all():
            raise self.fail(key, f"{key}: expected 3 rows of 3 or 4 finite numbers", table, number)
        if len(matrix) == 4 and not np.array_equal(matrix[3], [0, 0, 0, 1]):
            raise self.fail(key, f"{key}: the fourth row must be 0, 0, 0, 1", table, number)
        rotation = matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=UNIT) or np.linalg.det(rotation) < 0:
            raise self.fail(
                key, f"{key}: not a rotation (rows of length 1, at right angles, right-handed)", table, number
            )
        if matrix.shape == (3, 3):
            return rigid(rotation, np.array(position or (0.0, 0.0, 0.0)))
        if position is not None:
            raise self.fail("position_m", f"position_m is already in the last column of {key}", table, number)
        return rigid(rotation, matrix[:3, 3])

    def camera(self, data: Any, where: str, table: str, number: int) -> dict:
        at, can = (table or r"\s*\[\s*camera\s*\]", number), self.tuning.camera
        if not isinstance(data, dict):
            raise self.fail("camera", f"camera of {where}: expected a table such as {{hfov_deg = 90}}", *at)
        self.known(data, _CAMERA_KEYS, f"the camera of {where}", *at)
        if "file" in data:
            return self.other_program(data, where, *at)
        params, size = self.numbers(data, "params", (), *at), self.numbers(data, "size", (2,), *at)
        given = [k for k in ("params", "focal_px", "hfov_deg") if k in data]
        if len(given) > 1:
            raise self.fail(given[1], f"camera of {where}: give one of {', '.join(given)}", *at)
        if params is not None and "model" not in data:
            raise self.fail("params", f"camera of {where}: params need a model, for example OPENCV", *at)
        model = self.model(data["model"], params, *at) if "model" in data else None
        for key, most in (("focal_px", _MAX_FOCAL_PX), ("hfov_deg", 360.0)):
            value = data.get(key, 1.0)
            if not is_number(value) or not 0 < value <= most:
                raise self.fail(key, f"{key} = {value!r:.99}: expected a number above 0, at most {most:g}", *at)
        if size is not None and (any(v != int(v) for v in size) or not 1 <= min(size) <= max(size) <= MAX_SIDE_PX):
            raise self.fail("size", f"size = {data['size']!r}: expected width and height in whole pixels", *at)
        if size is not None and params is not None and model is not None:
            lens = pycolmap.Camera(model=model, width=int(size[0]), height=int(size[1]), params=params)
            if wrong := lens_fault(lens, can):
                raise self.fail("params", f"camera of {where}: {wrong}", *at)
        return {
            "at": self.at(given[0], *at) if given else "",
            "model": model,
            "size": None if size is None else (int(size[0]), int(size[1])),
            "params": params,
            "focal_px": data.get("focal_px"),
            "hfov_deg": data.get("hfov_deg"),
            "camera_sigma_px": self.positive(data, "sigma_px", *at) or None,
        }

    def other_program(self, data: dict, where: str, table: str, number: int) -> dict:
        """The camera of a file of another program, its path from the folder of this one."""
        if len(data) > 1 or not isinstance(data["file"], str):
            raise self.fail(
                "file", f"camera of {where}: file = the path of a calibration, and no other key", table, number
            )
        at = f"{self.at('file', table, number)}: {data['file']}"
        found = only_one(read_camera_file(self.path.parent / data["file"], at), at)
        check_lens(found, self.tuning.camera)
        given = {"at": found.where, "model": found.model, "size": found.size, "params": found.params}
        return {**given, "focal_px": None, "hfov_deg": None}


_CAMERA_TABLE = "cameras"


class _ColmapReader(Reader):
    tables: ClassVar[dict[str, str]] = {"sensors": _CAMERA_TABLE}
    words: ClassVar[dict[str, str]] = {"position_m": "cam_from_rig_translation"}

    def span(self, table: str, number: int) -> tuple[int, int]:
        """Lines of the ``number``-th camera: cameras are the objects that hold no other."""
        text = "\n".join(self.lines)
        found = next(islice(re.finditer(r"\{[^{}]*\}", text), number, None), None)
        if found is None:
            return 0, 0
        return text.count("\n", 0, found.start()), text.count("\n", 0, found.end()) + 1

    def rigs(self) -> tuple[RigSpec, ...]:
        try:
            data = json.loads("\n".join(self.lines))
        except json.JSONDecodeError as error:
            raise InputError(f"{self.path}, line {error.lineno}: not valid JSON: {error.msg}") from None
        if not isinstance(data, list) or not data or not all(isinstance(r, dict) for r in data):
            raise InputError(f'{self.path}: COLMAP rig files are a list of rigs: [{{"cameras": [...]}}]')
        lists = [r.get("cameras") for r in data]
        for number, cameras in enumerate(lists):
            self.known(data[number], ("cameras",), f"rig {number + 1}")
            if not isinstance(cameras, list) or not cameras or not all(isinstance(c, dict) for c in cameras):
                raise self.fail("cameras", f"rig {number + 1} needs a list of cameras")
        given = [c.get("image_prefix") for cameras in lists for c in cameras]
        prefixes = [p.strip("/") if isinstance(p, str) else None for p in given]
        twice = next((k for k, p in enumerate(prefixes) if p is not None and p in prefixes[:k]), None)
        if twice is not None:
            message = f"two cameras have the image_prefix {prefixes[twice]!r}, the same folder: give each its own"
            raise self.fail("image_prefix", message, _CAMERA_TABLE, twice)
        before = np.cumsum([0, *map(len, lists)])
        return tuple(self.rig(cameras, k, len(data), int(before[k])) for k, cameras in enumerate(lists))

    def rig(self, cameras: list[dict], number: int, count: int, before: int) -> RigSpec:
        references = [k for k, c in enumerate(cameras) if c.get("ref_sensor") is True]
        if len(references) != 1:
            raise self.fail(
                "ref_sensor", f"rig {number + 1}: exactly one camera must have ref_sensor, got {len(references)}"
            )
        order = references + [k for k in range(len(cameras)) if k not in references]
        sensors = tuple(self.sensor(cameras[k], before + k) for k in order)
        name = RIG_NAME if count == 1 else f"{RIG_NAME} {number + 1}"
        return RigSpec(name, sensors, file=str(self.path), body_is_reference=True)

    def sensor(self, data: dict, number: int) -> SensorSpec:
        at = (_CAMERA_TABLE, number)
        self.known(data, _COLMAP_KEYS, f"camera {number + 1}", *at)
        prefix = data.get("image_prefix")
        if not isinstance(prefix, str):
            raise self.fail("image_prefix", f"camera {number + 1} needs an image_prefix", *at)
        params = self.numbers(data, "camera_params", (), *at)
        model = data.get("camera_model_name")
        if (model is None) != (params is None):
            raise self.fail("camera_params", f"{prefix}: camera_model_name and camera_params belong together", *at)
        folder = prefix.strip("/")
        return SensorSpec(
            name=folder or "camera",
            folder=folder if prefix.endswith("/") or not folder else f"{folder}*",  # it may begin the names of files
            body_from_sensor=self.pose(data, number),
            model=None if model is None else self.model(model, params, *at, "camera_model_name"),
            params=params,
            number=number,
            at=self.at("camera_params", *at) if params is not None else "",
        )

    def pose(self, data: dict, number: int) -> np.ndarray | None:
        at = (_CAMERA_TABLE, number)
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
