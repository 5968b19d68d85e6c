"""The calibration of a single camera, given by ``--camera``: in words, or as a file of the programs that make them.

``OPENCV,4000x3000,2759.5,2764.2,1520.7,1006.8,0,0,0,0`` is a model and its parameters, both as COLMAP has them, and
between them, optionally, the size of the images they belong to. Files: COLMAP's cameras.txt, OpenCV's and ROS's YAML or
XML (camera_matrix, distortion_coefficients), Kalibr's camchain.yaml, a rig.toml with one camera.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import pycolmap

from tiegraph.errors import InputError
from tiegraph.scan.assign import Survey
from tiegraph.scan.rigfaults import lens_fault
from tiegraph.scan.rigfile import camera_table
from tiegraph.scan.rigreader import nearest
from tiegraph.scan.rigspec import SensorSpec
from tiegraph.scan.tuning import CameraTuning, RigTuning
from tiegraph.scene.regular import names_file, regular
from tiegraph.scene.table import text_lines

WORDS = (
    "give MODEL,parameters as COLMAP names and orders them (such as OPENCV,4000x3000,fx,fy,cx,cy,k1,k2,p1,p2; the size "
    "of the images may be left away), or a file: COLMAP's cameras.txt, OpenCV's or ROS's YAML, Kalibr's camchain.yaml, "
    "or a rig.toml with one camera"
)
_MODELS = tuple(m for m in pycolmap.CameraModelId.__members__ if m not in ("INVALID", "EQUIRECTANGULAR"))
_FILES = (".txt", ".yaml", ".yml", ".xml", ".toml")
_CENTRE = 0.5  # OpenCV and Kalibr count pixels from the centre of the first one, COLMAP from its corner
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True)
class _Found:
    """A camera as a file has it; ``where`` is file and, if known, line."""

    model: str
    params: tuple[float, ...]
    size: tuple[int, int] | None
    where: str


def read_camera(text: str, tuning: RigTuning) -> SensorSpec:
    """The camera of an option ``--camera``: a sensor without name or folder. Raises InputError naming what is wrong."""
    path = Path(text)
    if not names_file(text):
        if path.suffix.lower() in _FILES or "/" in text:
            raise InputError(f"--camera {text}: no such file; {WORDS}")
        return _sensor(_in_words(re.split(r"[,;\s]+", text.strip()), f"--camera {text}"), tuning.camera)
    try:
        content = regular(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--camera {path}: cannot be read as text in UTF-8 ({error}); {WORDS}") from None
    if path.suffix.lower() == ".toml":
        return camera_table(path, content, tuning)
    if re.search(r"camera_model\s*:", content) and re.search(r"intrinsics\s*:", content):
        return _sensor(_kalibr(path, content), tuning.camera)
    if re.search(r"camera_?matrix|<K\b|^\s*K\s*:", content, re.IGNORECASE | re.MULTILINE):
        return _sensor(_opencv(path, content), tuning.camera)
    return _sensor(_cameras_txt(path, content), tuning.camera)


def _sensor(found: _Found, tuning: CameraTuning) -> SensorSpec:
    """A sensor with the camera, after a look whether a lens can be so."""
    if found.size is not None:
        width, height = found.size
        camera = pycolmap.Camera(model=found.model, width=width, height=height, params=list(found.params))
        wrong = lens_fault(camera, tuning)
        if wrong:
            raise InputError(f"{found.where}: {wrong}")
    return SensorSpec("camera", model=found.model, size=found.size, params=found.params, at=found.where)


def _in_words(words: list[str], where: str) -> _Found:
    model, rest = words[0].upper(), words[1:]
    if model not in _MODELS:
        raise InputError(f"{where}: no file, and {words[0]!r} is no camera model{nearest(model, _MODELS)}; {WORDS}")
    size = re.fullmatch(r"(\d+)[xX](\d+)", rest[0]) if rest else None
    if size:
        rest = rest[1:]
    numbers = [w for w in rest if w]
    wrong = next((w for w in numbers if not re.fullmatch(_NUMBER, w)), None)
    if wrong is not None:
        raise InputError(f"{where}: {wrong!r} is no number; {WORDS}")
    params = tuple(map(float, numbers))
    _check_count(model, params, where)
    return _Found(model=model, params=params, size=(int(size[1]), int(size[2])) if size else None, where=where)


def _check_count(model: str, params: tuple[float, ...], where: str) -> None:
    info = pycolmap.Camera.create_from_model_name(0, model, 1.0, 1, 1)
    if len(params) != len(info.params):
        raise InputError(f"{where}: {model} has {len(info.params)} parameters ({info.params_info}), got {len(params)}")


def _cameras_txt(path: Path, content: str) -> _Found:
    """COLMAP's cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]."""
    rows = [
        (k, line.split()) for k, line in enumerate(text_lines(content), 1) if line.strip() and line.strip()[0] != "#"
    ]
    if not rows or not (len(rows[0][1]) > 4 and rows[0][1][1] in _MODELS):
        raise InputError(f"--camera {path}: no calibration that is known; {WORDS}")
    if len(rows) > 1:
        raise InputError(
            f"--camera {path}, line {rows[1][0]}: {len(rows)} cameras; keep the one that took the images, or give "
            "each its folder and camera in a rig.toml (`tiegraph init` writes one)"
        )
    line, words = rows[0]
    return _in_words([words[1], f"{words[2]}x{words[3]}", *words[4:]], f"--camera {path}, line {line}")


def _kalibr(path: Path, content: str) -> _Found:
    where = f"--camera {path}"
    cameras = re.findall(r"(?m)^\s*(cam\d+)\s*:", content)
    if len(cameras) > 1:
        raise InputError(
            f"{where}: {len(cameras)} cameras ({', '.join(cameras)}); keep one of them, or write a rig.toml "
            "(`tiegraph init` does) for the rig"
        )
    model, distortion = _word(content, "camera_model"), _word(content, "distortion_model") or "none"
    fx, fy, cx, cy = _exactly(_list(content, "intrinsics"), 4, f"{where}: intrinsics (fu, fv, pu, pv)")
    size = _list(content, "resolution")
    if model != "pinhole" or distortion not in ("radtan", "equidistant", "none"):
        raise InputError(
            f"{where}: {model} with {distortion}: read are pinhole with radtan, equidistant or none; calibrate with "
            "one of these"
        )
    given = _list(content, "distortion_coeffs")
    k = () if distortion == "none" else _exactly(given, 4, f"{where}: distortion_coeffs")
    name = {"none": "PINHOLE", "radtan": "OPENCV", "equidistant": "OPENCV_FISHEYE"}[distortion]
    return _Found(model=name, params=(fx, fy, cx + _CENTRE, cy + _CENTRE, *k), size=_size(size), where=where)


def _opencv(path: Path, content: str) -> _Found:
    where = f"--camera {path}"
    matrix = _list(content, "camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K")
    fx, skew, cx, _, fy, cy, *_ = _exactly(matrix, 9, f"{where}: camera_matrix")
    if abs(skew) > 1e-6 * abs(fx):
        raise InputError(f"{where}: camera_matrix has a skew of {skew:g}, which no model here has; calibrate without")
    names = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D")
    k = list(_list(content, *names))
    size = [_list(content, f"image_{n}", f"image_{n.title()}", n) for n in ("width", "height")]
    middle = (fx, fy, cx + _CENTRE, cy + _CENTRE)
    model = _word(content, "distortion_model").lower()
    if "fisheye" in model or "equidistant" in model:
        return _Found(
            model="OPENCV_FISHEYE",
            params=(*middle, *_exactly(tuple(k), 4, f"{where}: {names[0]}")),
            size=_both(size),
            where=where,
        )
    while k and not k[-1]:
        k.pop()
    if len(k) > 8:
        raise InputError(f"{where}: {len(k)} distortion coefficients; at most 8 are read (k1 k2 p1 p2 k3 k4 k5 k6)")
    count = 4 if len(k) <= 4 else 8
    k += [0.0] * (count - len(k))
    return _Found(model="OPENCV" if count == 4 else "FULL_OPENCV", params=(*middle, *k), size=_both(size), where=where)


# --- the few forms that YAML and XML take in these files --------------------------------------------------------------


def _word(content: str, key: str) -> str:
    found = re.search(rf"(?m)^[\s-]*{key}\s*:\s*[\"']?([\w+-]+)", content)
    return found[1] if found else ""


def _list(content: str, *keys: str) -> tuple[float, ...]:
    """The numbers of the first key that is there: behind it, in brackets, in rows with dashes, or in <data>."""
    for key in keys:
        xml = re.search(rf"<{key}\b[^>]*>(.*?)</{key}>", content, re.DOTALL)
        if xml:
            data = re.search(r"<data>(.*?)</data>", xml[1], re.DOTALL)
            return _numbers(data[1] if data else xml[1])
        head = re.search(rf"(?m)^[ \t-]*{key}[ \t]*:", content)
        if head is None:
            continue
        rest = content[head.end() :]
        same = re.match(rf"[ \t]*({_NUMBER})[ \t]*(?:$|#)", rest, re.MULTILINE)
        if same:
            return _numbers(same[1])
        rows = re.match(rf"[ \t]*\n((?:\s*-\s*{_NUMBER}[ \t]*\n?)+)", rest)
        if rows:
            return _numbers(re.sub(r"(?m)^\s*-\s+", "", rows[1]))
        brackets = re.match(r"[^\[]{0,200}\[([^\]]*)\]", rest)
        if brackets:
            return _numbers(brackets[1])
    return ()


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, re.findall(_NUMBER, text)))


def _exactly(values: tuple[float, ...], count: int, what: str) -> tuple[float, ...]:
    if len(values) != count:
        raise InputError(f"{what}: {len(values)} numbers, {count} expected")
    return values


def _both(size: list[tuple[float, ...]]) -> tuple[int, int] | None:
    return _size(size[0] + size[1])


def _size(values: tuple[float, ...]) -> tuple[int, int] | None:
    return (int(values[0]), int(values[1])) if len(values) == 2 and min(values) >= 1 else None


# --- which camera of the survey it is -------------------------------------------------------------------------------


def with_camera(
    survey: Survey,
    sizes: dict[tuple[int, int], tuple[int, int]],
    camera: str | None,
    notes: list[str],
    tuning: RigTuning,
) -> Survey:
    """The survey with the one camera that the user gave the calibration of; ``sizes`` are those of the images, by rig
    and sensor. Raises InputError."""
    if camera is None:
        return survey
    given = read_camera(camera, tuning)
    specs = list(survey.specs)
    there = {(r, k): (specs[r].sensors[k], size) for (r, k), size in sizes.items()}
    for (r, k), sensor in _takers(given, there, notes, tuning.camera).items():
        sensors = tuple(sensor if n == k else s for n, s in enumerate(specs[r].sensors))
        specs[r] = replace(specs[r], sensors=sensors, file=specs[r].file or given.at)
    return replace(survey, specs=tuple(specs))


def _takers(
    given: SensorSpec,
    sensors: dict[tuple[int, int], tuple[SensorSpec, tuple[int, int]]],
    notes: list[str],
    tuning: CameraTuning,
) -> dict[tuple[int, int], SensorSpec]:
    """The sensors that take a given camera: {key: sensor} of {key: (sensor, size of its images)}.

    The lone camera, or those whose images have the shape the calibration is of: photographs by other cameras keep what
    EXIF says. Raises InputError if it could be several, or none.
    """
    fits = {k: s for k, (s, size) in sensors.items() if len(sensors) == 1 or _same_shape(given.size, size, tuning)}
    listed = ", ".join(f"{s.name} ({w} x {h})" for s, (w, h) in list(sensors.values())[:4])
    if len(fits) != 1:
        which = f"a camera of {given.size[0]} x {given.size[1]} images fits" if given.size else "without a size it fits"
        count = f"{len(fits)} of them" if fits else "none of them"
        raise InputError(
            f"{given.at}: {which} {count}, the images are of {len(sensors)} cameras: {listed}; give each its own "
            "camera in a rig.toml (`tiegraph init` writes one), or keep photographs of one camera"
        )
    ((key, sensor),) = fits.items()
    if sensor.params is not None or sensor.focal_px is not None or sensor.hfov_deg is not None:
        raise InputError(f"{given.at}: the rig file gives a camera for {sensor.name!r} too: leave one of the two away")
    others = [s.name for k, (s, _) in sensors.items() if k != key]
    if others:
        notes.append(f"{given.at}: taken for {sensor.name}; {len(others)} other cameras keep what EXIF says")
    camera = {n: getattr(given, n) for n in ("model", "size", "params", "focal_px", "hfov_deg", "at")}
    return {key: replace(sensor, **camera)}


def _same_shape(given: tuple[int, int] | None, size: tuple[int, int], tuning: CameraTuning) -> bool:
    return given is None or abs(given[0] * size[1] / (given[1] * size[0]) - 1) < tuning.same_shape
