"""Files of cameras: one table of the formats that are known, by what stands in them and not by their names.

COLMAP's own are here (cameras.txt, cameras.bin); those of other programs, and their conventions, in ``cameraread``
(OpenCV, ROS, Kalibr) and ``cameraforeign`` (OpenSfM, Agisoft). What a camera model of COLMAP cannot say exactly is
refused.

Kalibr's camchain.yaml is a whole rig, too: ``T_cn_cnm1`` of camera n takes points of camera n-1 into camera n (wiki,
"yaml formats": "always with respect to the last camera in the chain"), metres; the first camera has none and is the
reference. A sensor is called as its camera (cam0, ...), and so is its folder. What is said of an IMU (``T_cam_imu``,
``timeshift_cam_imu``) is no part of a rig of cameras.
"""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import are_rotations, invert
from tiegraph.scan.rigfiles.cameraforeign import agisoft, is_agisoft, is_opensfm, opensfm
from tiegraph.scan.rigfiles.cameraread import (
    NUMBER,
    FoundCamera,
    exactly,
    is_kalibr,
    is_opencv,
    kalibr,
    kalibr_blocks,
    matrix_of,
    opencv,
)
from tiegraph.scan.rigfiles.rigfaults import MAX_SIDE_PX, MODELS, count_fault, faults, lens_fault, nearest
from tiegraph.scan.rigfiles.rigspec import UNIT, RigSpec, SensorSpec
from tiegraph.scan.tuning import CameraTuning, RigTuning
from tiegraph.scene.regular import regular
from tiegraph.scene.textfile import text_lines

PROGRAMS = (
    "COLMAP's cameras.txt or cameras.bin, OpenCV's or ROS's YAML or XML, Kalibr's camchain.yaml, OpenSfM's "
    "camera_models.json, Agisoft's XML"
)
_ROW = re.compile(rf"(?m)^[ \t]*\d+[ \t]+(?:{'|'.join(MODELS)})[ \t]")


@dataclass(frozen=True)
class Format:
    """One line of the table."""

    name: str
    mine: Callable[[str], bool]  # whether a text is of this format
    read: Callable[[str, str], list[FoundCamera]]  # text and where it is from -> its cameras


def read_camera_file(path: Path, where: str) -> list[FoundCamera]:
    """The cameras of a file; ``where``: what errors call it. Raises InputError naming what is wrong."""
    try:
        data = regular(path).read_bytes()
        if path.suffix.lower() == ".bin":
            return cameras_bin(data, where)
        content = data.decode("utf-8-sig").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: cannot be read as text in UTF-8 ({error}); known are {PROGRAMS}") from None
    known = next((f for f in FORMATS if f.mine(content)), None)
    found = [] if known is None else known.read(content, where)
    if not found:
        raise InputError(f"{where}: no calibration that is known; known are {PROGRAMS}")
    for camera in found:
        check_count(camera.model, camera.params, camera.where)
    return found


def check_lens(found: FoundCamera, tuning: CameraTuning) -> None:
    """Raise InputError for a camera that no lens can be."""
    if found.size is None:
        return
    width, height = found.size
    if max(found.size) > MAX_SIDE_PX:
        raise InputError(f"{found.where}: images of {width} x {height}: at most {MAX_SIDE_PX} are read; mend it")
    camera = pycolmap.Camera(model=found.model, width=width, height=height, params=list(found.params))
    if wrong := lens_fault(camera, tuning):
        raise InputError(f"{found.where}: {wrong}")


def in_words(words: list[str], where: str, remedy: str) -> FoundCamera:
    """A camera of a model, optionally a size, and its parameters. Raises InputError, ending with ``remedy``."""
    model, rest = words[0].upper(), words[1:]
    if model not in MODELS:
        raise InputError(f"{where}: no file, and {words[0]!r} is no camera model{nearest(model, MODELS)}; {remedy}")
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
    """COLMAP's cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]."""
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


def cameras_bin(data: bytes, where: str) -> list[FoundCamera]:
    """COLMAP's cameras.bin: count u64; id u32, model i32, width u64, height u64, parameters f64. Raises InputError."""
    names = {int(v): n for n, v in pycolmap.CameraModelId.__members__.items() if n in MODELS}
    found, at = [], 8
    try:
        for _ in range(struct.unpack_from("<Q", data)[0]):
            camera, model, width, height = struct.unpack_from("<IiQQ", data, at)
            name = names[model]
            count = len(pycolmap.Camera.create_from_model_name(0, name, 1.0, 1, 1).params)
            params = struct.unpack_from(f"<{count}d", data, at + 24)
            at += 24 + 8 * count
            size = (width, height)
            found.append(FoundCamera(model=name, params=params, size=size, where=where, name=str(camera)))
    except (struct.error, KeyError, OverflowError):
        raise InputError(f"{where}: no cameras.bin of COLMAP, or cut off; export the model again") from None
    if at != len(data) or not found:
        raise InputError(f"{where}: no cameras.bin of COLMAP, or cut off; export the model again")
    return found


FORMATS = (
    Format("Kalibr's camchain.yaml", is_kalibr, kalibr),
    Format("OpenSfM's camera_models.json", is_opensfm, opensfm),
    Format("Agisoft's XML", is_agisoft, agisoft),
    Format("OpenCV's or ROS's YAML or XML", is_opencv, opencv),
    Format("COLMAP's cameras.txt", lambda content: bool(_ROW.search(content)), _cameras_txt),
)

_CHAIN = "T_cn_cnm1"


def kalibr_rig(path: Path, content: str, name: str, tuning: RigTuning) -> RigSpec:
    """The rig of a camchain.yaml, called ``name``. Raises InputError naming camera and key."""
    blocks, pose, sensors = kalibr_blocks(content), np.eye(4), []
    if not blocks:
        raise InputError(f"{path}: no camera (cam0: with camera_model and intrinsics) in it: is it a camchain.yaml?")
    for number, (camera, found) in enumerate(zip(blocks, kalibr(content, str(path)))):
        check_count(found.model, found.params, found.where)
        check_lens(found, tuning.camera)
        if number:
            pose = pose @ invert(_link(blocks[camera], f"{path}, {camera}"))
        sensors.append(
            SensorSpec(
                name=camera,
                body_from_sensor=pose,
                model=found.model,
                size=found.size,
                params=found.params,
                number=number,
                at=found.where,
            )
        )
    rig = RigSpec(name, tuple(sensors), file=str(path), body_is_reference=True)
    for fault in faults(rig, tuning):
        raise InputError(f"{path}: {fault.message}")
    return rig


def _link(block: str, where: str) -> np.ndarray:
    """(4, 4) from the camera before to this one."""
    given = matrix_of(block, _CHAIN)
    if not given:
        raise InputError(
            f"{where}: no {_CHAIN}: where it is in the rig is not said. Calibrate the cameras together, or give "
            "a rig.toml"
        )
    matrix = np.array(exactly(given, 16, f"{where}: {_CHAIN}")).reshape(4, 4)
    good = np.isfinite(matrix).all() and np.array_equal(matrix[3], [0, 0, 0, 1])
    if not good or not are_rotations(matrix[:3, :3], UNIT):
        raise InputError(f"{where}: {_CHAIN} is no rotation and place (4 rows of 4, the last 0, 0, 0, 1)")
    return matrix
