"""Rig files written: tiegraph's rig.toml and COLMAP's rig_config.json."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.geometry.transforms import invert, quaternion_xyzw
from tiegraph.scan.rigfiles.rigspec import yaw_pitch_roll_deg
from tiegraph.scene.rig import PAIR_KEYS, Rig

_ANGLE_DECIMALS = 9  # of a degree
EXPLAINED = """\
Body frame: what all positions and angles below are in. axes says which way its axes point:
  camera = x right, y down, z forward; flu = x forward, y left, z up; frd = x forward, y right, z down;
  rfu = x right, y forward, z up.
Camera frame: x right, y down, z forward (along the view), as the camera sees; origin = its projection centre.
position_m: where the projection centre is in the body frame: x, y, z in metres.
yaw_pitch_roll_deg: how the camera is turned out of the body's forward direction, in degrees and in this order:
  yaw to the right (clockwise seen from above: 90 looks to the right), then pitch up (90 looks straight up),
  then roll clockwise as the camera sees (90: its right side points down). 0, 0, 0 looks forward, upright.
Instead of yaw_pitch_roll_deg, camera to body (the inverse of COLMAP's cam_from_rig):
  body_from_sensor = 3 rows of 3 numbers (point in body = rows times point in camera, plus position_m), or
  body_from_sensor_wxyz = the same rotation as a quaternion, w first.
antenna_m: the GNSS antenna in the body frame, metres. fixed = true: never refined. nominal = true: degrees off.
sigma_deg, sigma_m of a sensor: how well its angles and its position are known; it is adjusted about them.
params: COLMAP's model and order, for images of size (width, height); pixels count from the image's corner.
sigma_px: how well its focal length is known; such a camera is adjusted, one without is held as it stands here."""


def rig_config(rigs: Sequence[Rig]) -> str:
    """Rigs as text of COLMAP's rig_config.json (image prefixes are the sensors' folders, quaternions w first)."""
    return json.dumps([{"cameras": _colmap_cameras(rig)} for rig in rigs], indent=2) + "\n"


def _colmap_cameras(rig: Rig) -> list[dict]:
    cameras: list[dict] = []
    for number, sensor in enumerate(rig.sensors):
        camera: dict[str, Any] = {"image_prefix": f"{sensor.folder}/".removesuffix("*/") if sensor.folder else ""}
        if number == 0:
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
    """Write a rig as rig.toml that explains itself."""
    Path(path).write_text(rig_toml(rig, comment), encoding="utf-8")


def rig_toml(rig: Rig, comment: str = "") -> str:
    """A rig as text of a rig.toml that explains itself; its body frame is the reference sensor's (axes = camera)."""
    lines = [f"# {line}" for line in (*comment.splitlines(), *EXPLAINED.splitlines())]
    lines += [
        f"name = {json.dumps(rig.name, ensure_ascii=False)}",
        'axes = "camera"',
        f"fixed = {str(rig.fixed).lower()}",
    ]
    lines.append(f"nominal = {str(rig.nominal).lower()}")
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
        ]
        lines.append(f"role = {json.dumps(sensor.role)}")
        if sensor.sensor_from_rig is not None:
            pose = invert(sensor.sensor_from_rig)
            lines.append(f"position_m = {_toml(pose[:3, 3] + 0.0)}")
            # Angles and not a quaternion: these stay true when the body's axes are changed by hand.
            angles = np.round(yaw_pitch_roll_deg(pose), _ANGLE_DECIMALS) + 0.0
            lines.append(f"yaw_pitch_roll_deg = {_toml(angles)}")
        sigmas = (("sigma_deg", sensor.sigma_deg), ("sigma_m", sensor.sigma_m))
        lines += [f"{key} = {float(value)!r}" for key, value in sigmas if value is not None]
        camera = sensor.camera
        if sensor.source is not None and sensor.source.camera is not None:
            camera = sensor.source.camera  # the file describes what comes from the camera, not what scan made of it
        if sensor.source is not None and any(sensor.source.crop_px):
            lines.append(f"crop_px = {list(sensor.source.crop_px)}")
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
