"""Files of cameras: one table of the known formats, recognised by their contents and not by their names.

Terms that no camera model of COLMAP has exactly are refused, with the name of the term. OpenCV, ROS and Kalibr are
read in ``cameraread``.

**OpenSfM** (``camera_models.json``, ``reconstruction.json``; ``camera_distortions_functions.h``): lengths are fractions
of the longer side, the principal point is relative to the middle of the image: pixel = size/2 + longer side * (x + c).
perspective, radial, simple_radial = RADIAL (two focal lengths: OPENCV), brown = FULL_OPENCV, fisheye = RADIAL_FISHEYE,
fisheye_opencv = OPENCV_FISHEYE, fisheye62 without k5, k6 = THIN_PRISM_FISHEYE; p1 and p2 are as OpenCV's.

**Agisoft** Metashape, PhotoScan from 1.2 and Lens (manual, appendix "Camera models"; XML of a calibration, or the
``sensor`` of a camera file): u = w/2 + cx + x' (f + b1) + y' b2, v = h/2 + cy + y' f, pixels from the corner of the
first one (whose centre is 0.5, 0.5), as COLMAP's. x' has p1 (r2 + 2 x2) + 2 p2 xy: p1 and p2 are exchanged against
OpenCV. frame = FULL_OPENCV, which has no k4 of this kind, no b2, p3 and p4. fisheye is the same with theta instead of
tan theta, so k4 fits: OPENCV_FISHEYE, with p1 or p2 THIN_PRISM_FISHEYE. Older files (fx, fy, skew; cx, cy from the
corner) are read without p1 and p2, whose order changed between the versions.

**Kalibr's** camchain.yaml is a whole rig, too: ``T_cn_cnm1`` of camera n takes points of camera n-1 into camera n
(wiki, "yaml formats": "always with respect to the last camera in the chain"), metres; the first camera has none and is
the reference. A sensor has the name of its camera (cam0, ...), and so has its folder. Values of an IMU
(``T_cam_imu``, ``timeshift_cam_imu``) are no part of a rig of cameras.
"""

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import are_rotations, invert
from tiegraph.scan.rigfiles.cameraread import (
    NUMBER,
    FoundCamera,
    exactly,
    kalibr,
    kalibr_blocks,
    matrix_of,
    opencv,
    size_of,
    zero,
)
from tiegraph.scan.rigfiles.rigfaults import MAX_SIDE_PX, MODELS, count_fault, faults, is_number, lens_fault
from tiegraph.scan.rigfiles.rigspec import UNIT, RigSpec, SensorSpec
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.atomic import regular
from tiegraph.scene.textfile import Element, parse_xml, text_lines, utf8_text
from tiegraph.text import meant

PROGRAMS = (
    "COLMAP's cameras.txt or cameras.bin, OpenCV's or ROS's YAML or XML, Kalibr's camchain.yaml, OpenSfM's "
    "camera_models.json, Agisoft's XML"
)


def read_camera_file(path: Path, where: str) -> list[FoundCamera]:
    """The cameras of a file; ``where``: its name in errors. Raises InputError naming the fault."""
    known = f"; known are {PROGRAMS}"
    if path.suffix.lower() == ".bin":
        return cameras_bin(path, where)
    content = utf8_text(path, where, known)
    read = next((read for marks, read in FORMATS.values() if all(re.search(m, content) for m in marks)), None)
    found = [] if read is None else read(content, where)
    if not found:
        raise InputError(f"{where}: the format of the calibration is unknown{known}")
    for camera in found:
        check_count(camera.model, camera.params, camera.where)
    return found


def check_lens(found: FoundCamera) -> None:
    """Raise InputError for a camera that is physically impossible."""
    if found.size is None:
        return
    width, height = found.size
    if max(found.size) > MAX_SIDE_PX:
        raise InputError(f"{found.where}: images of {width} x {height}: at most {MAX_SIDE_PX} are read; correct it")
    camera = pycolmap.Camera(model=found.model, width=width, height=height, params=list(found.params))
    if wrong := lens_fault(camera):
        raise InputError(f"{found.where}: {wrong}")


def in_words(words: list[str], where: str, remedy: str) -> FoundCamera:
    """A camera of a model, optionally a size, and its parameters. Raises InputError, ending with ``remedy``."""
    model, rest = words[0].upper(), words[1:]
    if model not in MODELS:
        raise InputError(f"{where}: no file, and {words[0]!r} is no camera model{meant(model, MODELS, 0.5)}; {remedy}")
    size = re.fullmatch(r"(\d+)[xX](\d+)", rest[0]) if rest else None
    if size:
        rest = rest[1:]
    numbers = [w for w in rest if w]
    wrong = next((w for w in numbers if not re.fullmatch(NUMBER, w)), None)
    if wrong is not None:
        raise InputError(f"{where}: {wrong!r} is no number; {remedy}")
    params = tuple(map(float, numbers))
    check_count(model, params, where)
    return FoundCamera(model=model, params=params, size=(int(size[1]), int(size[2])) if size else None, where=where)


def check_count(model: str, params: tuple[float, ...], where: str) -> None:
    """Raise InputError for a wrong number of parameters."""
    if wrong := count_fault(model, params):
        raise InputError(f"{where}: {wrong}")


def _cameras_txt(content: str, where: str) -> list[FoundCamera]:
    found = []
    for number, line in enumerate(text_lines(content), 1):
        words, at = line.split(), f"{where}, line {number}"
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 5 or words[1] not in MODELS:
            raise InputError(f"{at}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[], as COLMAP writes them")
        made = in_words([words[1], f"{words[2]}x{words[3]}", *words[4:]], at, "write it as COLMAP does")
        found.append(FoundCamera(model=made.model, params=made.params, size=made.size, where=at, name=words[0]))
    return found


def cameras_bin(path: Path, where: str) -> list[FoundCamera]:
    """COLMAP's cameras.bin: count u64; id u32, model i32, width u64, height u64, parameters f64. Raises InputError."""
    names = {int(v): n for n, v in pycolmap.CameraModelId.__members__.items() if n in MODELS}
    found, at = [], 8
    try:
        data = regular(path).read_bytes()
        for _ in range(struct.unpack_from("<Q", data)[0]):
            camera, model, width, height = struct.unpack_from("<IiQQ", data, at)
            name = names[model]
            count = len(pycolmap.Camera.create_from_model_name(0, name, 1.0, 1, 1).params)
            params = struct.unpack_from(f"<{count}d", data, at + 24)
            at += 24 + 8 * count
            size = (width, height)
            found.append(FoundCamera(model=name, params=params, size=size, where=where, name=str(camera)))
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error})") from None
    except (struct.error, KeyError, OverflowError):
        at = -1
    if at != len(data) or not found:
        raise InputError(f"{where}: no cameras.bin of COLMAP, or cut off; export the model again")
    return found


def kalibr_rig(path: Path, content: str, name: str, tuning: RigTuning) -> RigSpec:
    """The rig of a camchain.yaml, called ``name``. Raises InputError naming camera and key."""
    blocks, pose, sensors = kalibr_blocks(content), np.eye(4), []
    if not blocks:
        raise InputError(f"{path}: no camera (cam0: with camera_model and intrinsics) in it: is it a camchain.yaml?")
    for number, (camera, found) in enumerate(zip(blocks, kalibr(content, str(path)))):
        check_count(found.model, found.params, found.where)
        check_lens(found)
        if number:
            pose = pose @ invert(_link(blocks[camera], f"{path}, {camera}"))
        sensors.append(SensorSpec(name=camera, body_from_sensor=pose, number=number, **found.of_sensor()))
    rig = RigSpec(name, tuple(sensors), file=str(path), body_is_reference=True)
    for fault in faults(rig, tuning):
        raise InputError(f"{path}: {fault.message}")
    return rig


def _link(block: str, where: str) -> np.ndarray:
    """(4, 4) from the previous camera to this one."""
    given = matrix_of(block, "T_cn_cnm1")
    if not given:
        raise InputError(
            f"{where}: no T_cn_cnm1: its pose in the rig is missing. Calibrate the cameras together, or give a rig.toml"
        )
    matrix = np.array(exactly(given, 16, f"{where}: T_cn_cnm1")).reshape(4, 4)
    good = np.isfinite(matrix).all() and np.array_equal(matrix[3], [0, 0, 0, 1])
    if not good or not are_rotations(matrix[:3, :3], UNIT):
        raise InputError(f"{where}: T_cn_cnm1 is no rotation and position (4 rows of 4, the last 0, 0, 0, 1)")
    return matrix


def opensfm(content: str, where: str) -> list[FoundCamera]:
    """The cameras of OpenSfM. Raises InputError."""
    try:
        data = json.loads(content)
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{where}: not valid JSON: {error}") from None
    parts = data if isinstance(data, list) else [data]
    return opensfm_cameras([p.get("cameras", p) for p in parts if isinstance(p, dict)], where)


def opensfm_cameras(tables: list[Any], where: str) -> list[FoundCamera]:
    """The cameras of tables name -> camera. Raises InputError."""
    found = {name: row for table in tables if isinstance(table, dict) for name, row in table.items()}
    if not found or not all(isinstance(row, dict) for row in found.values()):
        raise InputError(f'{where}: cameras of OpenSfM are {{"name": {{"projection_type": ..., "width": ...}}}}')
    return [_opensfm(name, row, where if len(found) == 1 else f"{where}, {name}") for name, row in found.items()]


def _opensfm(name: str, row: dict[str, Any], where: str) -> FoundCamera:
    kind = str(row.get("projection_type", "perspective"))
    wrong = next((k for k, v in row.items() if k != "projection_type" and not is_number(v)), None)
    if wrong is not None:
        raise InputError(f"{where}: {wrong} = {row[wrong]!r:.99}: expected a finite number")
    value = {k: float(v) for k, v in row.items() if k != "projection_type"}
    if min(value.get("width", 0), value.get("height", 0)) < 1:
        raise InputError(f"{where}: width and height are missing, and lengths are parts of the longer side; add them")
    size = size_of((value["width"], value["height"]))
    assert size is not None
    focal = value.get("focal", value.get("focal_x", 0.0)), value.get("focal", value.get("focal_y", 0.0))
    if min(focal) <= 0:
        raise InputError(f"{where}: no focal length (focal, or focal_x and focal_y)")
    longer = max(size)
    middle = tuple(s / 2 + longer * value.get(c, 0.0) for s, c in zip(size, ("c_x", "c_y")))
    model, params = _opensfm_lens(kind, (longer * focal[0], longer * focal[1]), middle, value, where)
    return FoundCamera(model=model, params=params, size=size, where=where, name=name)


def _opensfm_lens(
    kind: str, focal: tuple[float, float], middle: tuple[float, ...], value: dict[str, float], where: str
) -> tuple[str, tuple[float, ...]]:
    one = focal[0] == focal[1]
    radial = ("RADIAL", "k1 k2") if one else ("OPENCV", "k1 k2 - -")
    forms = {  # a term that OpenSfM lacks is 0
        **dict.fromkeys(("perspective", "radial", "simple_radial"), radial),
        "brown": ("FULL_OPENCV", "k1 k2 p1 p2 k3 - - -") if value.get("k3") else ("OPENCV", "k1 k2 p1 p2"),
        "fisheye": ("RADIAL_FISHEYE", "k1 k2"),
        "fisheye_opencv": ("OPENCV_FISHEYE", "k1 k2 k3 k4"),
        "fisheye62": ("THIN_PRISM_FISHEYE", "k1 k2 p1 p2 k3 k4 - -"),
    }
    if kind not in forms:
        raise InputError(
            f"{where}: projection_type {kind}: read are perspective, simple_radial, radial, brown, fisheye, "
            "fisheye_opencv and fisheye62 without k5, k6; calibrate with one of these (panoramas: --rig panorama)"
        )
    if kind == "fisheye62":
        zero(value, ("k5", "k6"), where, "calibrate as fisheye_opencv")
    model, terms = forms[kind]
    first = focal[:1] if model.startswith("RADIAL") else focal
    return model, (*first, *middle, *(value.get(t, 0.0) for t in terms.split()))


_TERMS = (
    "width", "height", "f", "fx", "fy", "cx", "cy", "skew", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4",
)  # fmt: skip


def agisoft(content: str, where: str) -> list[FoundCamera]:
    """The cameras of Agisoft's XML. Raises InputError."""
    root = parse_xml(where, content.encode())
    sensors = list(root.all("sensor")) or [root]
    return [camera for sensor in sensors if (camera := agisoft_camera(sensor, where)) is not None]


def agisoft_camera(sensor: Element, where: str) -> FoundCamera | None:
    """The camera of an element with calibrations, the adjusted one if there is one; None without any, as for a
    sensor without images. Raises InputError."""
    given = [c for c in sensor.all("calibration") if {"f", "fx"} & {part.name for part in c.children}]
    if not given:
        return None
    block = next((c for c in given if c.given.get("class") == "adjusted"), given[0])
    value: dict[str, float] = {}
    for part in block.children:
        if part.name in _TERMS:
            if not re.fullmatch(NUMBER, part.text.strip()):
                raise InputError(f"{where}: {part.name} = {part.text.strip()!r:.99}: expected a number")
            value[part.name] = float(part.text)
    kind = block.said("projection") or block.given.get("type", "frame")
    sizes = [r.given for r in block.children if r.name == "resolution"] or [value]
    width, height = (float(sizes[0].get(side, 0.0)) for side in ("width", "height"))
    if min(width, height) < 1:
        raise InputError(f"{where}: width and height are missing, but cx and cy are relative to their middle; add them")
    remedy = "optimise or calibrate without it, then export again"
    zero(value, ("b2", "skew", "p3", "p4"), where, remedy)
    if "fx" in value:
        zero(value, ("p1", "p2"), f"{where}: a file of an old version (fx, fy)", "export it with Metashape")
        focal = value["fx"], value.get("fy", value["fx"])
        middle = value.get("cx", width / 2), value.get("cy", height / 2)
    else:
        focal = value["f"] + value.get("b1", 0.0), value["f"]
        middle = width / 2 + value.get("cx", 0.0), height / 2 + value.get("cy", 0.0)
    model, params = _agisoft_lens(kind, (*focal, *middle), value, where, remedy)
    size, name = size_of((width, height)), sensor.given.get("label", "")
    return FoundCamera(model=model, params=params, size=size, where=where, name=name)


def _agisoft_lens(
    kind: str, wide: tuple[float, ...], value: dict[str, float], where: str, remedy: str
) -> tuple[str, tuple[float, ...]]:
    k1, k2, k3, k4, p1, p2 = (value.get(n, 0.0) for n in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if kind in ("fisheye", "equidistant_fisheye"):
        if p1 or p2:
            return "THIN_PRISM_FISHEYE", (*wide, k1, k2, p2, p1, k3, k4, 0.0, 0.0)
        return "OPENCV_FISHEYE", (*wide, k1, k2, k3, k4)
    if kind != "frame":
        raise InputError(f"{where}: a camera of type {kind}: read are frame and fisheye; export undistorted images")
    zero(value, ("k4",), where, remedy)
    if k3:
        return "FULL_OPENCV", (*wide, k1, k2, p2, p1, k3, 0.0, 0.0, 0.0)
    return "OPENCV", (*wide, k1, k2, p2, p1)


FORMATS: dict[str, tuple[tuple[str, ...], Callable[[str, str], list[FoundCamera]]]] = {
    "Kalibr's camchain.yaml": ((r"camera_model\s*:", r"intrinsics\s*:"), kalibr),
    "OpenSfM's camera_models.json": ((r"\A\s*[{\[]", '"projection_type"'), opensfm),
    "Agisoft's XML": ((r"<calibration\b", "<fx?>"), agisoft),
    "OpenCV's or ROS's YAML or XML": ((r"(?im)camera_?matrix|<K\b|^\s*K\s*:",), opencv),
    "COLMAP's cameras.txt": ((rf"(?m)^[ \t]*\d+[ \t]+(?:{'|'.join(MODELS)})[ \t]",), _cameras_txt),
}
"""For each format expressions that a text of it has, and the reader of its cameras (text, where it is from)."""
