"""Reading of rig files: tiegraph's rig.toml, COLMAP's rig_config.json and Kalibr's camchain.yaml (``camerafile``).

rig.toml::

    name = "boat"            # optional, default "rig"
    axes = "flu"             # axes of the body frame: camera (right, down, forward: default), flu, frd or rfu
    fixed = false            # true: calibrated, never refined
    nominal = false          # true: orientations from a drawing, off by degrees
    synchronised = false     # true: all cameras fire at one instant (a wire, a trigger); false: the images decide
    antenna_m = [0.9, 0.6, 0.3]      # GNSS antenna in the body frame

    [camera]                 # optional: common values of all sensors
    model = "OPENCV"         # COLMAP's model and order of parameters
    size = [3072, 2048]      # width, height the parameters belong to; rescaled to images of the same shape
    params = [2759.5, 2764.2, 1520.7, 1006.8, 0, 0, 0, 0]     # or focal_px = 2760, or hfov_deg = 58
    sigma_px = 0.4           # optional: of the focal length; with it the camera is adjusted, without it is held fixed

    [[sensors]]              # the first one is the reference
    name = "cam0"
    folder = "cam0"          # optional, default = name; "" = every image that no other sensor takes; "*_GRE" = the
                             # images whose names end so, for cameras that write into one folder
    role = "side"            # side; up (looks at the sky, or the bridge above); wide: the wide cameras of a rig alone
                             # carry structure from motion, the others hang on the rig, which must be calibrated
    position_m = [0, 0, 0.06]                # projection centre in the body frame
    yaw_pitch_roll_deg = [0, 0, 0]           # yaw to the right, pitch up, roll clockwise as the camera sees it
    # or body_from_sensor_wxyz = [1, 0, 0, 0], or body_from_sensor = 3 rows of 3 (rotation) or 4 numbers (with position)
    sigma_deg = 0.1                          # optional: accuracy of its orientation and position;
    sigma_m = 0.002                          # a sensor with sigmas is adjusted about the given values
    crop_px = [0, 0, 0, 0]                   # optional: left, top, right, bottom
    camera = {hfov_deg = 90}                 # optional: instead of the shared one; {file = "left.yaml"}: a calibration
                                             # of another program, as of ``--camera``, beside the rig file

    [[pairs]]                # optional: measurements between two sensors, with their sigmas
    sensors = ["cam0", "cam2"]
    baseline_m = 0.152       # distance of the projection centres
    baseline_sigma_m = 0.001
    axis_deg = 144.0         # angle between the optical axes
    axis_sigma_deg = 0.1

The frame of a trajectory given beside a rig file is this body frame. A sensor without orientation has no known pose.
"""

import json
import re
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import are_rotations, finite_array, invert, rigid
from tiegraph.scan.rigfiles.camerafile import check_lens, kalibr_rig, read_camera_file
from tiegraph.scan.rigfiles.cameraread import only_one
from tiegraph.scan.rigfiles.rigfaults import MAX_SIDE_PX, Part, faults, is_number, lens_fault
from tiegraph.scan.rigfiles.rigspec import AXES, PRESET_WORDS, UNIT, RigSpec, SensorSpec, orient
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import PAIR_KEYS, ROLES, SensorPair
from tiegraph.scene.textfile import text_lines, utf8_text
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
RIG_NAME = "rig"  # of a file that gives none: its own name does not describe the rig
_TURNS = ("yaw_pitch_roll_deg", "body_from_sensor_wxyz", "body_from_sensor")


def read_rig_file(path: Path | str, tuning: RigTuning, text: str | None = None) -> tuple[RigSpec, ...]:
    """Rigs of a rig.toml or Kalibr's camchain.yaml (one) or a COLMAP rig_config.json (one or more); of the ``text`` of
    a rig.toml, if that comes from ``path``, a run folder.

    Raises InputError with file, line and key for missing, unknown, misspelt or wrong values.
    """
    path = Path(path)
    if text is not None:
        return parse_rig_file(path, text, tuning)
    if not path.exists():
        raise InputError(f"--rig {path}: no such file, and no preset: {PRESET_WORDS}")
    if path.is_dir():
        raise InputError(f"--rig {path}: a folder, not a file, and no run folder of tiegraph: give one of these")
    text = composed(utf8_text(path, str(path)))
    if path.suffix.lower() in (".yaml", ".yml"):
        return (kalibr_rig(path, text, RIG_NAME, tuning),)
    return parse_rig_file(path, text, tuning, path.suffix.lower() == ".json")


def parse_rig_file(path: Path, text: str, tuning: RigTuning, colmap: bool = False) -> tuple[RigSpec, ...]:
    """The rigs of the text of a rig.toml or rig_config.json that comes from ``path``. Raises InputError, naming it."""
    try:
        reader = _ColmapReader(path, text) if colmap else _TomlReader(path, text)
        rigs = reader.rigs()
    except RecursionError:
        raise InputError(f"{path}: too many nested brackets for a rig file") from None
    for rig in rigs:
        for fault in faults(rig, tuning):
            number = rig.sensors[fault.number].number if fault.table == "sensors" else fault.number
            key = "cam_from_rig_translation" if colmap and fault.key == "position_m" else fault.key
            raise reader.part(fault.table, number).fail(key, fault.message)
    return rigs


def camera_table(path: Path, text: str) -> SensorSpec:
    """The camera of a rig.toml with one sensor, or with a table [camera] alone. Raises InputError."""
    reader = _TomlReader(path, text)
    if reader.data.get("sensors"):
        (rig,) = reader.rigs()
        if len(rig.sensors) > 1:
            raise InputError(f"--camera {path}: a rig of {len(rig.sensors)} sensors; give it by --rig")
        found = rig.sensors[0]
    else:
        reader.part().known(("camera", "name"), "a camera's file")
        found = SensorSpec("camera", **reader.shared_camera())
    if not found.at:
        raise InputError(f"--camera {path}: no params, focal_px or hfov_deg in a table [camera]")
    return found


class _TomlReader:
    def __init__(self, path: Path, text: str) -> None:
        """Raises InputError for what is no TOML."""
        self.path, self.lines = path, text_lines(text)
        try:
            self.data = tomllib.loads("\n".join(self.lines))
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{path}: not a valid TOML file: {error}") from None

    def part(self, table: str = "", number: int = 0, data: Any = None) -> Part:
        """The ``number``-th table of a name, with its ``data``; "" = the file.

        A table ends at the next header outside of it ([sensors.camera] is within [[sensors]]).
        """
        if not table:
            return Part(self.path, self.lines, None, self.data)
        heads = [k for k, text in enumerate(self.lines) if re.match(rf"\s*\[+\s*{table}\s*\]", text)]
        first = heads[number] if number < len(heads) else len(self.lines)
        ends = (
            k
            for k in range(first + 1, len(self.lines))
            if re.match(rf"\s*\[+\s*(?!{table}\s*\.)[A-Za-z_]", self.lines[k])
        )
        return Part(self.path, self.lines, (first, next(ends, len(self.lines))), data)

    def rigs(self) -> tuple[RigSpec, ...]:
        data, whole = self.data, self.part()
        whole.known(_RIG_KEYS, "the rig")
        axes = whole.choice("axes", tuple(AXES))
        shared = self.shared_camera()
        tables = data.get("sensors", [])
        if not isinstance(tables, list) or not tables or not all(isinstance(t, dict) for t in tables):
            raise whole.fail("sensors", "the rig needs at least one [[sensors]] table with a name")
        sensors = tuple(self.sensor(t, k, axes, shared) for k, t in enumerate(tables))
        for key, values in (("name", [s.name for s in sensors]), ("folder", [s.folder or s.name for s in sensors])):
            twice = next((k for k, v in enumerate(values) if v in values[:k]), None)
            if twice is not None:
                raise self.part("sensors", twice).fail(key, f"two sensors have the {key} {values[twice]!r}")
        rig = RigSpec(
            name=str(data.get("name", RIG_NAME)),
            sensors=sensors,
            fixed=whole.choice("fixed", (False, True)),
            nominal=whole.choice("nominal", (False, True)),
            synchronised=whole.choice("synchronised", (False, True)),
            antenna_m=whole.numbers("antenna_m", 3),  # type: ignore[arg-type]
            axes=axes,
            pairs=self.pairs(data.get("pairs", []), [s.name for s in sensors]),
            file=str(self.path),
        )
        return (rig,)

    def sensor(self, data: dict, number: int, axes: str, shared: dict) -> SensorSpec:
        part = self.part("sensors", number, data)
        where = f"sensor {data.get('name', number + 1)!r}"
        part.known(_SENSOR_KEYS, where)
        if not isinstance(data.get("name"), str) or not data["name"]:
            raise part.fail("name", f"{where} needs a name")
        folder = data.get("folder")
        if folder is not None and not isinstance(folder, str):
            raise part.fail("folder", f"folder = {folder!r}: expected text")
        camera = self.camera(part, data["camera"], where) if "camera" in data else shared
        crop = part.numbers("crop_px", 4)
        if crop is not None and (min(crop) < 0 or any(c != int(c) for c in crop)):
            raise part.fail("crop_px", f"crop_px = {list(crop)}: expected whole pixels, none below 0")
        return SensorSpec(
            name=data["name"],
            folder=None if folder is None else folder.strip("/"),
            role=part.choice("role", ROLES),
            body_from_sensor=_pose(part, axes),
            crop_px=None if crop is None else tuple(int(c) for c in crop),  # type: ignore[arg-type]
            sigma_deg=part.positive("sigma_deg"),
            sigma_m=part.positive("sigma_m"),
            number=number,
            **camera,
        )

    def pairs(self, tables: Any, names: list[str]) -> tuple[SensorPair, ...]:
        if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
            raise self.part().fail("pairs", "pairs: expected [[pairs]] tables")
        out = []
        for number, data in enumerate(tables):
            part = self.part("pairs", number, data)
            part.known(("sensors", *PAIR_KEYS), f"pair {number + 1}")
            both = data.get("sensors")
            good = isinstance(both, list) and len(both) == 2 and all(b in names for b in both)
            if not good or both[0] == both[1]:
                raise part.fail("sensors", f"sensors = {both!r}: expected two of {', '.join(names)}")
            values = {key: part.positive(key) for key in PAIR_KEYS}
            for value, sigma in (PAIR_KEYS[:2], PAIR_KEYS[2:]):
                if (values[value] is None) != (values[sigma] is None):
                    raise part.fail(value, f"pair {both[0]} - {both[1]}: {value} and {sigma} belong together")
            out.append(SensorPair((both[0], both[1]), **values))
        return tuple(out)

    def shared_camera(self) -> dict[str, Any]:
        """The table [camera], as fields of a sensor."""
        return self.camera(self.part("camera"), self.data.get("camera", {}), "[camera]")

    def camera(self, table: Part, data: Any, where: str) -> dict[str, Any]:
        """Fields of a sensor by its camera, whose keys are in a table of the file."""
        if not isinstance(data, dict):
            raise table.fail("camera", f"camera of {where}: expected a table such as {{hfov_deg = 90}}")
        part = table.within(data)
        part.known(_CAMERA_KEYS, f"the camera of {where}")
        if "file" in data:
            return self.other_program(part, where)
        params, size = part.numbers("params"), part.numbers("size", 2)
        given = [k for k in ("params", "focal_px", "hfov_deg") if k in data]
        if len(given) > 1:
            raise part.fail(given[1], f"camera of {where}: give one of {', '.join(given)}")
        if params is not None and "model" not in data:
            raise part.fail("params", f"camera of {where}: params need a model, for example OPENCV")
        model = part.model("model", params)
        for key, most in (("focal_px", 1e6), ("hfov_deg", 360.0)):  # largest values in a rig file
            value = data.get(key, 1.0)
            if not is_number(value) or not 0 < value <= most:
                raise part.fail(key, f"{key} = {value!r:.99}: expected a number above 0, at most {most:g}")
        if size is not None and (any(v != int(v) for v in size) or not 1 <= min(size) <= max(size) <= MAX_SIDE_PX):
            raise part.fail("size", f"size = {data['size']!r}: expected width and height in whole pixels")
        if size is not None and params is not None and model is not None:
            lens = pycolmap.Camera(model=model, width=int(size[0]), height=int(size[1]), params=params)
            if wrong := lens_fault(lens):
                raise part.fail("params", f"camera of {where}: {wrong}")
        return {
            "at": part.at(given[0]) if given else "",
            "model": model,
            "size": None if size is None else (int(size[0]), int(size[1])),
            "params": params,
            "focal_px": data.get("focal_px"),
            "hfov_deg": data.get("hfov_deg"),
            "camera_sigma_px": part.positive("sigma_px") or None,
        }

    def other_program(self, part: Part, where: str) -> dict[str, Any]:
        """The camera of a file of another program, its path from the folder of this one."""
        name = part.data["file"]
        if len(part.data) > 1 or not isinstance(name, str):
            raise part.fail("file", f"camera of {where}: file = the path of a calibration, and no other key")
        at = f"{part.at('file')}: {name}"
        found = only_one(read_camera_file(self.path.parent / name, at), at)
        check_lens(found)
        return found.of_sensor()


def _pose(part: Part, axes: str) -> np.ndarray | None:
    """body_from_sensor (4, 4) of a table of a sensor; None without a pose."""
    turns = [t for t in _TURNS if t in part.data]
    if len(turns) > 1:
        raise part.fail(turns[1], f"give one of {', '.join(_TURNS)}, not {' and '.join(turns)}")
    position = part.numbers("position_m", 3)
    if not turns:
        if position is not None:
            raise part.fail("position_m", f"position_m needs an orientation too: one of {', '.join(_TURNS)}")
        return None
    place = np.array(position or (0.0, 0.0, 0.0))
    if turns[0] == "body_from_sensor":
        matrix = _matrix(part)
        if matrix.shape == (3, 3):
            return rigid(matrix, place)
        if position is not None:
            raise part.fail("position_m", "position_m is already in the last column of body_from_sensor")
        return rigid(matrix[:3, :3], matrix[:3, 3])
    if turns[0] == "body_from_sensor_wxyz":
        return rigid(np.asarray(part.quaternion(turns[0])), place)
    angles = part.numbers(turns[0], 3)
    assert angles is not None
    if max(map(abs, angles)) > 360.0:
        raise part.fail(turns[0], f"{turns[0]} = {list(angles)}: expected degrees, 360 at most")
    yaw, pitch, roll = angles
    return rigid(orient(yaw, pitch, roll, axes), place)


def _matrix(part: Part) -> np.ndarray:
    key = "body_from_sensor"
    matrix = finite_array(part.data[key], (3, 3), (3, 4), (4, 4))
    if matrix is None:
        raise part.fail(key, f"{key}: expected 3 rows of 3 or 4 finite numbers")
    if len(matrix) == 4 and not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise part.fail(key, f"{key}: the fourth row must be 0, 0, 0, 1")
    if not are_rotations(matrix[:3, :3], UNIT):
        raise part.fail(key, f"{key}: not a rotation (rows of length 1, at right angles, right-handed)")
    return matrix


class _ColmapReader:
    def __init__(self, path: Path, text: str) -> None:
        self.path, self.lines = path, text_lines(text)

    def part(self, table: str = "", number: int = 0, data: Any = None) -> Part:
        """The ``number``-th camera, with its ``data``: cameras are the objects without nested ones; "" = the file."""
        text = "\n".join(self.lines)
        found = next(islice(re.finditer(r"\{[^{}]*\}", text), number, None), None) if table else None
        if found is None:
            return Part(self.path, self.lines, (0, 0) if table else None, data)
        span = text.count("\n", 0, found.start()), text.count("\n", 0, found.end()) + 1
        return Part(self.path, self.lines, span, data)

    def rigs(self) -> tuple[RigSpec, ...]:
        try:
            data = json.loads("\n".join(self.lines))
        except json.JSONDecodeError as error:
            raise InputError(f"{self.path}, line {error.lineno}: not valid JSON: {error.msg}") from None
        if not isinstance(data, list) or not data or not all(isinstance(r, dict) for r in data):
            raise InputError(f'{self.path}: COLMAP rig files are a list of rigs: [{{"cameras": [...]}}]')
        lists = [r.get("cameras") for r in data]
        for number, cameras in enumerate(lists):
            whole = self.part(data=data[number])
            whole.known(("cameras",), f"rig {number + 1}")
            if not isinstance(cameras, list) or not cameras or not all(isinstance(c, dict) for c in cameras):
                raise whole.fail("cameras", f"rig {number + 1} needs a list of cameras")
        given = [c.get("image_prefix") for cameras in lists for c in cameras]
        prefixes = [p.strip("/") if isinstance(p, str) else None for p in given]
        twice = next((k for k, p in enumerate(prefixes) if p is not None and p in prefixes[:k]), None)
        if twice is not None:
            message = f"two cameras have the image_prefix {prefixes[twice]!r}, the same folder: give each its own"
            raise self.part("sensors", twice).fail("image_prefix", message)
        before = np.cumsum([0, *map(len, lists)])
        return tuple(self.rig(cameras, k, len(data), int(before[k])) for k, cameras in enumerate(lists))

    def rig(self, cameras: list[dict], number: int, count: int, before: int) -> RigSpec:
        references = [k for k, c in enumerate(cameras) if c.get("ref_sensor") is True]
        if len(references) != 1:
            message = f"rig {number + 1}: exactly one camera must have ref_sensor, got {len(references)}"
            raise self.part().fail("ref_sensor", message)
        order = references + [k for k in range(len(cameras)) if k not in references]
        sensors = tuple(self.sensor(cameras[k], before + k) for k in order)
        name = RIG_NAME if count == 1 else f"{RIG_NAME} {number + 1}"
        return RigSpec(name, sensors, file=str(self.path), body_is_reference=True)

    def sensor(self, data: dict, number: int) -> SensorSpec:
        part = self.part("sensors", number, data)
        part.known(_COLMAP_KEYS, f"camera {number + 1}")
        prefix = data.get("image_prefix")
        if not isinstance(prefix, str):
            raise part.fail("image_prefix", f"camera {number + 1} needs an image_prefix")
        params = part.numbers("camera_params")
        if (data.get("camera_model_name") is None) != (params is None):
            raise part.fail("camera_params", f"{prefix}: camera_model_name and camera_params belong together")
        folder = prefix.strip("/")
        return SensorSpec(
            name=folder or "camera",
            folder=folder if prefix.endswith("/") or not folder else f"{folder}*",  # it may begin the names of files
            body_from_sensor=self.pose(part),
            model=part.model("camera_model_name", params),
            params=params,
            number=number,
            at=part.at("camera_params") if params is not None else "",
        )

    def pose(self, part: Part) -> np.ndarray | None:
        turn, place = part.quaternion("cam_from_rig_rotation"), part.numbers("cam_from_rig_translation", 3)
        if part.data.get("ref_sensor"):
            if turn is not None or place is not None:
                raise part.fail("cam_from_rig_rotation", "the reference sensor is the rig frame: omit its pose")
            return np.eye(4)
        if (turn is None) != (place is None):
            raise part.fail("image_prefix", "cam_from_rig_rotation and cam_from_rig_translation belong together")
        return None if turn is None or place is None else invert(rigid(turn, np.array(place)))
