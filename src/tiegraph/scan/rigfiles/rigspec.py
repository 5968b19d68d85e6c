"""A rig as described by a user or a preset, before the images' sizes are known; and the writers of rig files:
tiegraph's rig.toml and COLMAP's rig_config.json.
"""

import json
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import invert, quaternion_xyzw, rigid
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.cells import number
from tiegraph.scene.rig import PAIR_KEYS, Rig, SensorPair, Source

# Rows: the camera-like axes right, down, forward of the body, written in the body's own axes.
AXES = {
    "camera": np.eye(3),  # x right, y down, z forward
    "flu": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),  # x forward, y left, z up (ROS)
    "frd": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),  # x forward, y right, z down (aviation)
    "rfu": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),  # x right, y forward, z up (surveying)
}
CIRCLE_DEG = 200.0  # assumed field of view across the circle of a fisheye lens: 360 cameras have 195 to 200
# Relative sigma of the focal length of a start model's camera, and of a factory's: it is adjusted. Three of Insta360's
# models of one camera agree to 0.4 %.
START_FOCAL = 0.01
LADYBUG_SIDES = 5
PRESET_WORDS = "ladybug5, ring:N, stereo, stereo:BASELINE, single, panorama"
UNIT = 1e-3  # tolerance of the length of a quaternion, and of products of two rows of a rotation
_LADYBUG_HFOV_DEG = 90.0  # of a rectified side image of the preset ladybug5, about


@dataclass(frozen=True)
class SensorSpec:
    """One sensor of a rig file or preset."""

    name: str
    folder: str | None = None  # None: a folder with the sensor's name
    role: str = "side"
    body_from_sensor: np.ndarray | None = None  # (4, 4); None = unknown
    model: str | None = None
    size: tuple[int, int] | None = None  # width, height that params belong to; None: those of the images
    params: tuple[float, ...] | None = None
    focal_px: float | None = None
    hfov_deg: float | None = None
    crop_px: tuple[int, int, int, int] | None = None
    sigma_deg: float | None = None
    sigma_m: float | None = None
    camera_sigma_px: float | None = None  # of the focal length; a camera with one is adjusted
    started: bool = False  # its camera is that of a start model
    view_of_panorama: tuple[float, ...] = ()  # a view of an equirectangular panorama: see ``Source.panorama``
    part: int | None = None  # which of the two images side by side in its files; None = the whole file is its image
    number: int = 0  # of its table in the rig file
    at: str = ""  # file and line of its camera, "" = from no file


@dataclass(frozen=True)
class RigSpec:
    """A rig of a file or preset. ``antenna_m`` is in the body frame, whose axes ``axes`` names."""

    name: str
    sensors: tuple[SensorSpec, ...]
    fixed: bool = False
    nominal: bool = False
    antenna_m: tuple[float, float, float] | None = None
    axes: str = "camera"
    file: str = ""  # "" = preset
    pairs: tuple[SensorPair, ...] = ()
    synchronised: bool = False
    body_is_reference: bool = False  # the body frame is sensor 0's frame whether or not its pose is written

    def rig_from_body(self) -> np.ndarray | None:
        """(4, 4) from the body frame to the reference sensor's frame = the rig frame; None = unknown."""
        pose = self.sensors[0].body_from_sensor
        return None if pose is None else np.linalg.inv(pose)


def orient(yaw_deg: float, pitch_deg: float, roll_deg: float, axes: str = "camera") -> np.ndarray:
    """Rotation body_from_sensor (3, 3) of a camera rotated away from the body's forward direction.

    yaw to the right (clockwise seen from above), then pitch up, then roll clockwise as seen by the camera.
    """
    # In right, down, forward: yaw turns forward (z) to right (x), pitch forward to up (-y), roll right (x) to down (y).
    turn = Rotation.from_euler("YXZ", [yaw_deg, pitch_deg, roll_deg], degrees=True)
    return AXES[axes].T @ turn.as_matrix()


def yaw_pitch_roll_deg(body_from_sensor: np.ndarray) -> tuple[float, float, float]:
    """Inverse of ``orient`` of a body with a camera's axes; looking straight up or down, roll is 0."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of looking straight up
        yaw, pitch, roll = Rotation.from_matrix(body_from_sensor[:3, :3]).as_euler("YXZ", degrees=True).tolist()
    return yaw, pitch, roll


def preset_sizes(text: str, tuning: RigTuning) -> tuple[int, ...]:
    """Numbers of cameras that a preset allows; () if ``text`` is no preset. Raises InputError for a bad number."""
    word, _, number = text.strip().lower().partition(":")
    if word == "ring":
        count = _number(number, text)
        if count != int(count) or not 2 <= count <= 360:
            raise InputError(f"--rig {text}: a ring has 2 or more cameras, for example ring:5")
        return (int(count),)
    if word == "stereo":
        if number and not 0 <= _number(number, text) <= tuning.max_rig_m:
            raise InputError(f"--rig {text}: a baseline is 0 to {tuning.max_rig_m:g} metres, for example stereo:0.54")
        return (2,)
    return {"ladybug5": (LADYBUG_SIDES + 1, LADYBUG_SIDES), "single": (1,)}.get(text.strip().lower(), ())


def preset(text: str, folders: tuple[str, ...], tuning: RigTuning) -> RigSpec:
    """Rig of a preset for the camera folders found.

    ``ladybug5``, ``ring:N``, ``stereo[:baseline in m]``, ``single``. All are nominal: axes are off by degrees, centres
    coincide (paper 000 eq. 1-3), and the sense of rotation is an assumption that the network stage checks. Raises
    InputError if the number of folders does not fit.
    """
    sizes = preset_sizes(text, tuning)
    if len(folders) not in sizes:
        found = ", ".join(folders) if any(folders) else "none"
        raise InputError(
            f"--rig {text}: the preset has {' or '.join(map(str, sizes))} camera(s), but the camera folders found are: "
            f"{found}. Put each camera's images into a folder of its own, choose another preset, or write a rig.toml"
        )
    word, _, number = text.strip().lower().partition(":")
    if word == "ring":
        return _named(f"ring of {sizes[0]}", _ring(sizes[0]), folders)
    if word == "stereo":
        baseline = _number(number, text) if number else 0.0
        right = rigid(np.eye(3), np.array([baseline, 0.0, 0.0]))
        left_first = sorted(folders, key=lambda f: not re.search(r"left|(^|[^a-z])l([^a-z]|$)", f.lower()))
        return _named("stereo", [np.eye(4), right], tuple(left_first))
    if word == "single":
        return _named("single", [np.eye(4)], folders)
    poses = _ring(LADYBUG_SIDES) + [rigid(orient(0, 90, 0), np.zeros(3))]
    rig = _named("ladybug5", poses[: len(folders)], folders)
    sensors = [replace(s, hfov_deg=_LADYBUG_HFOV_DEG) for s in rig.sensors]
    sensors[LADYBUG_SIDES:] = [replace(s, role="up") for s in sensors[LADYBUG_SIDES:]]
    return replace(rig, sensors=tuple(sensors))


def _ring(count: int) -> list[np.ndarray]:
    return [rigid(orient(360.0 / count * k, 0, 0), np.zeros(3)) for k in range(count)]


def _named(name: str, poses: list[np.ndarray], folders: tuple[str, ...]) -> RigSpec:
    sensors = tuple(SensorSpec(f.lstrip("*_") or "camera", f, body_from_sensor=p) for f, p in zip(folders, poses))
    return RigSpec(name, sensors, nominal=len(poses) > 1, body_is_reference=True)


def _number(text: str, whole: str) -> float:
    value = number(text)
    if not np.isfinite(value):
        raise InputError(f"--rig {whole}: expected a number after the colon, for example ring:5 or stereo:0.54")
    return value


EXPLAINED = """\
Body frame: the frame of all positions and angles below. axes names the directions of its axes:
  camera = x right, y down, z forward; flu = x forward, y left, z up; frd = x forward, y right, z down;
  rfu = x right, y forward, z up.
Camera frame: x right, y down, z forward (along the view), as the camera sees; origin = its projection centre.
position_m: the projection centre in the body frame: x, y, z in metres.
yaw_pitch_roll_deg: rotation of the camera away from the body's forward direction, in degrees and in this order:
  yaw to the right (clockwise seen from above: 90 looks to the right), then pitch up (90 looks straight up),
  then roll clockwise as the camera sees (90: its right side points down). 0, 0, 0 looks forward, upright.
Instead of yaw_pitch_roll_deg, camera to body (the inverse of COLMAP's cam_from_rig):
  body_from_sensor = 3 rows of 3 numbers (point in body = rows times point in camera, plus position_m), or
  body_from_sensor_wxyz = the same rotation as a quaternion, w first.
antenna_m: the GNSS antenna in the body frame, metres. fixed = true: never refined. nominal = true: off by degrees.
sigma_deg, sigma_m of a sensor: accuracy of its angles and its position; it is adjusted about them.
params: COLMAP's model and order, for images of size (width, height); pixels count from the image's corner.
sigma_px: accuracy of its focal length; such a camera is adjusted, one without is held fixed."""


def rig_config(rigs: Sequence[Rig]) -> str:
    """Rigs as text of COLMAP's rig_config.json (image prefixes are the sensors' folders, quaternions w first)."""
    return json.dumps([{"cameras": _colmap_cameras(rig)} for rig in rigs], indent=2) + "\n"


def _colmap_cameras(rig: Rig) -> list[dict]:
    cameras: list[dict] = []
    for k, sensor in enumerate(rig.sensors):
        camera: dict[str, Any] = {"image_prefix": f"{sensor.folder}/".removesuffix("*/") if sensor.folder else ""}
        if k == 0:
            camera["ref_sensor"] = True
        elif sensor.sensor_from_rig is not None:
            camera["cam_from_rig_rotation"] = np.roll(quaternion_xyzw(sensor.sensor_from_rig[:3, :3]), 1).tolist()
            camera["cam_from_rig_translation"] = sensor.sensor_from_rig[:3, 3].tolist()
        if sensor.camera is not None:
            camera["camera_model_name"] = sensor.camera.model.name
            camera["camera_params"] = [float(p) for p in sensor.camera.params]
        cameras.append(camera)
    return cameras


def write_rig_toml(rig: Rig, path: Path, comment: str = "") -> None:
    """Write a rig as a commented rig.toml."""
    Path(path).write_text(rig_toml(rig, comment), encoding="utf-8")


def rig_toml(rig: Rig, comment: str = "") -> str:
    """A rig as text of a commented rig.toml; its body frame is the reference sensor's (axes = camera)."""
    lines = [f"# {line}" for line in (*comment.splitlines(), *EXPLAINED.splitlines())]
    lines += [
        f"name = {json.dumps(rig.name, ensure_ascii=False)}",
        'axes = "camera"',
        f"fixed = {str(rig.fixed).lower()}",
        f"nominal = {str(rig.nominal).lower()}",
    ]
    if rig.synchronised:
        lines.append("synchronised = true")
    if rig.antenna_m is not None:
        lines.append(f"antenna_m = {_toml(rig.antenna_m)}")
    for sensor in rig.sensors:
        lines += [
            "",
            "[[sensors]]",
            f"name = {json.dumps(sensor.name, ensure_ascii=False)}",
            f"folder = {json.dumps(sensor.folder, ensure_ascii=False)}",
            f"role = {json.dumps(sensor.role)}",
        ]
        if sensor.sensor_from_rig is not None:
            pose = invert(sensor.sensor_from_rig)
            lines.append(f"position_m = {_toml(pose[:3, 3] + 0.0)}")
            # Angles and not a quaternion: these stay true when the body's axes are changed by hand.
            angles = np.round(yaw_pitch_roll_deg(pose), 9) + 0.0  # of a degree
            lines.append(f"yaw_pitch_roll_deg = {_toml(angles)}")
        sigmas = (("sigma_deg", sensor.sigma_deg), ("sigma_m", sensor.sigma_m))
        lines += [f"{key} = {float(value)!r}" for key, value in sigmas if value is not None]
        source = sensor.source or Source()
        camera = source.camera or sensor.camera  # of the camera's own images, not those that scan made
        lines += [f"crop_px = {list(source.crop_px)}"] if any(source.crop_px) else []
        if camera is not None:
            lines += ["[sensors.camera]", f'model = "{camera.model.name}"', f"size = [{camera.width}, {camera.height}]"]
            lines.append(f"params = {_toml(camera.params)}")
            lines += [f"sigma_px = {float(sensor.camera_sigma_px)!r}"] if sensor.camera_sigma_px else []
    for pair in rig.pairs:
        lines += ["", "[[pairs]]", f"sensors = {json.dumps(list(pair.sensors), ensure_ascii=False)}"]
        lines += [f"{key} = {float(v)!r}" for key in PAIR_KEYS if (v := getattr(pair, key)) is not None]
    return "\n".join(lines) + "\n"


def _toml(values: Any) -> str:
    return "[" + ", ".join(repr(float(v)) for v in values) + "]"
