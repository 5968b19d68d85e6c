"""Cameras of OpenCV, ROS and Kalibr in their YAML (or OpenCV's XML), in COLMAP's models; and shared parts of readers
of camera files: their result, and the few forms of values in YAML, XML and JSON.

Pixels count from the centre of the first one in all three, so half a pixel is added to the principal point.

**OpenCV** (``cv::FileStorage``; the sample ``camera_calibration`` adds ``fisheye_model``) and **ROS**
(``camera_info``, REP 104: K, D, ``distortion_model``): k1, k2, p1, p2[, k3[, k4, k5, k6]] are those of FULL_OPENCV, in
its order; four coefficients of ``cv::fisheye`` (ROS: equidistant) are those of OPENCV_FISHEYE.

**Kalibr** (wiki, "yaml formats" and "supported models"): pinhole with radtan = OPENCV, equidistant = OPENCV_FISHEYE,
fov = FOV (both after Devernay and Faugeras 2001), eucm (alpha, beta, fu, fv, pu, pv) = EUCM. omni (xi, fu, ...; Mei
2007) is, without distortion, EUCM with alpha = xi / (1 + xi), beta = 1 and focal lengths over 1 + xi: both divide by
xi d + z, d the distance of the point, except for that factor.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from tiegraph.errors import InputError

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ENDLESS_PX = 1e9  # larger than any image, and within whole numbers of COLMAP
CENTRE = 0.5  # OpenCV, ROS and Kalibr count pixels from the centre of the first one, COLMAP from its corner


@dataclass(frozen=True)
class FoundCamera:
    """A camera of a file, in COLMAP's model and order of parameters; ``where`` is file and, if known, line.

    ``name``: its name in the file, "" = none.
    """

    model: str
    params: tuple[float, ...]
    size: tuple[int, int] | None
    where: str
    name: str = ""

    def of_sensor(self) -> dict[str, Any]:
        """The fields of a ``SensorSpec`` with this camera."""
        return {"model": self.model, "size": self.size, "params": self.params, "at": self.where}


def only_one(cameras: list[FoundCamera], where: str) -> FoundCamera:
    """The only camera of a file. Raises InputError naming them if there are several."""
    if len(cameras) == 1:
        return cameras[0]
    names = [c.name for c in cameras if c.name]
    listed = f" ({', '.join(names[:4])}{' ...' if len(names) > 4 else ''})" if names else ""
    raise InputError(
        f"{where}: {len(cameras)} cameras{listed}; keep the one of these images, or give each its folder and "
        "camera in a rig.toml (`tiegraph init` writes one)"
    )


def zero(values: dict[str, float], names: Iterable[str], where: str, remedy: str) -> None:
    """Refuse terms that no camera model of COLMAP has with the others. Raises InputError naming term and value."""
    for name in names:
        if values.get(name, 0.0) != 0.0:
            raise InputError(f"{where}: {name} = {values[name]:g}, a term that no camera model of COLMAP has; {remedy}")


def word(content: str, key: str) -> str:
    """The word of a YAML, XML or JSON key, "" if it is not there."""
    found = re.search(rf"(?m)^[\s-]*{key}\s*:\s*[\"']?([\w+-]+)", content)
    found = found or re.search(rf"<{key}>\s*[\"']?([\w+-]+)", content)
    return found[1] if found else ""


def numbers_of(content: str, *keys: str) -> tuple[float, ...]:
    """The numbers of the first key found: ``key: [..]``, ``key: {data: [..]}``, one a line, XML's ``data``."""
    for key in keys:
        xml = re.search(rf"<{key}\b[^>]*>(.*?)</{key}>", content, re.DOTALL)
        if xml:
            data = re.search(r"<data>(.*?)</data>", xml[1], re.DOTALL)
            return numbers(data[1] if data else xml[1])
        head = re.search(rf"(?m)^[ \t-]*{key}[ \t]*:", content)
        if head is None:
            continue
        rest = content[head.end() :]
        same = re.match(rf"[ \t]*({NUMBER})[ \t]*(?:$|#)", rest, re.MULTILINE)
        if same:
            return numbers(same[1])
        rows = re.match(rf"[ \t]*\n((?:\s*-\s*{NUMBER}[ \t]*\n?)+)", rest)
        if rows:
            return numbers(re.sub(r"(?m)^\s*-\s+", "", rows[1]))
        brackets = re.match(r"[^\[]{0,200}\[([^\]]*)\]", rest)
        if brackets:
            return numbers(brackets[1])
    return ()


def matrix_of(content: str, key: str) -> tuple[float, ...]:
    """All numbers of a YAML key, in rows or not, up to the next key; () if it is not there."""
    head = re.search(rf"(?m)^[ \t-]*{key}[ \t]*:", content)
    if head is None:
        return ()
    rest = re.split(r"(?m)^[ \t]*[A-Za-z_]\w*[ \t]*:", content[head.end() :])[0]
    return numbers(re.sub(r"(?m)(?:(?<=^)|(?<=\s))-(?=\s)", " ", rest))


def numbers(text: str) -> tuple[float, ...]:
    """The numbers in a text."""
    return tuple(map(float, re.findall(NUMBER, text)))


def exactly(values: tuple[float, ...], count: int, what: str) -> tuple[float, ...]:
    """The values, if their number is right. Raises InputError."""
    if len(values) != count:
        raise InputError(f"{what}: {len(values)} numbers, {count} expected")
    return values


def size_of(values: tuple[float, ...]) -> tuple[int, int] | None:
    """Width and height, None if there are not two plausible ones; at most ``_ENDLESS_PX``."""
    if len(values) != 2 or min(values) < 1:
        return None
    return int(min(values[0], _ENDLESS_PX)), int(min(values[1], _ENDLESS_PX))


_BROWN = ("", "none", "plumb_bob", "rational_polynomial", "radtan", "brown", "opencv", "pinhole", "perspective")
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt")
_K = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "d")
_MOST = 8  # k1 k2 p1 p2 k3 k4 k5 k6


def opencv(content: str, where: str) -> list[FoundCamera]:
    """The camera of OpenCV's YAML or XML, or of ROS's camera_info. Raises InputError."""
    count = len(re.findall(r"(?im)^[ \t-]*camera_?matrix[ \t]*:|<camera_?matrix\b", content))
    if count > 1:
        raise InputError(f"{where}: {count} camera matrices; keep those of the camera that took the images")
    matrix = numbers_of(content, "camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K", "k")
    fx, skew, cx, _, fy, cy, *_ = exactly(matrix, 9, f"{where}: camera_matrix")
    if abs(skew) > 1e-6 * abs(fx):
        raise InputError(f"{where}: camera_matrix has a skew of {skew:g}, which no model here has; calibrate without")
    _whole_image(content, where)
    size = size_of(sum((numbers_of(content, f"image_{n}", f"image_{n.title()}", n) for n in ("width", "height")), ()))
    middle, k = (fx, fy, cx + CENTRE, cy + CENTRE), numbers_of(content, *_K)
    model = word(content, "distortion_model").lower()
    if xi := numbers_of(content, "xi"):
        return [_mei((xi[0], *middle), k, size, where)]
    if model in _FISHEYE or numbers_of(content, "fisheye_model") == (1.0,):
        params = (*middle, *exactly(k, 4, f"{where}: {_K[0]} of a fisheye"))
        return [FoundCamera(model="OPENCV_FISHEYE", params=params, size=size, where=where)]
    if model not in _BROWN:
        raise InputError(
            f"{where}: distortion_model {model}: read are plumb_bob, rational_polynomial and equidistant; calibrate "
            "with one of these"
        )
    return [_brown(middle, k, size, where)]


def _brown(
    middle: tuple[float, ...], given: tuple[float, ...], size: tuple[int, int] | None, where: str
) -> FoundCamera:
    k = list(given)
    while k and not k[-1]:
        k.pop()
    if len(k) > _MOST:
        raise InputError(
            f"{where}: {len(k)} distortion coefficients; at most 8 are read (k1 k2 p1 p2 k3 k4 k5 k6): calibrate "
            "without thin prisms and a tilted sensor"
        )
    count = 4 if len(k) <= 4 else _MOST
    k += [0.0] * (count - len(k))
    return FoundCamera(model="OPENCV" if count == 4 else "FULL_OPENCV", params=(*middle, *k), size=size, where=where)


def _whole_image(content: str, where: str) -> None:
    """Refuse a camera_info of binned images or of a part of the sensor: its matrix is that of the whole sensor."""
    part = {n: numbers_of(content, n) for n in ("binning_x", "binning_y", "x_offset", "y_offset")}
    for name, value in part.items():
        if value and value[0] > (1 if name.startswith("binning") else 0):
            raise InputError(
                f"{where}: {name} = {value[0]:g}: the camera_info is of binned images or a part of the sensor; "
                "calibrate the images in this form, or take the camera_info of whole ones"
            )


def kalibr_blocks(content: str) -> dict[str, str]:
    """The texts of the cameras of a camchain.yaml by their names (cam0, cam1, ...), in order."""
    heads = list(re.finditer(r"(?m)^([A-Za-z_][\w-]*)[ \t]*:[ \t]*(?:#.*)?$", content))
    ends = [h.start() for h in heads[1:]] + [len(content)]
    return {h[1]: content[h.end() : end] for h, end in zip(heads, ends) if "camera_model" in content[h.end() : end]}


def kalibr(content: str, where: str) -> list[FoundCamera]:
    """The cameras of Kalibr's camchain.yaml. Raises InputError."""
    blocks = kalibr_blocks(content) or {"": content}
    if len(re.findall(r"camera_model\s*:", content)) != len(blocks):
        raise InputError(
            f"{where}: each camera needs one camera_model, below a name (cam0:) that begins its line; correct it"
        )
    return [_kalibr(name, text, where if len(blocks) == 1 else f"{where}, {name}") for name, text in blocks.items()]


def _kalibr(name: str, content: str, where: str) -> FoundCamera:
    model, distortion = word(content, "camera_model"), word(content, "distortion_model") or "none"
    size, k = size_of(numbers_of(content, "resolution")), numbers_of(content, "distortion_coeffs")
    more = {"omni": ("xi",), "eucm": ("alpha", "beta")}.get(model, ())
    names = (*more, "fu", "fv", "pu", "pv")
    given = exactly(numbers_of(content, "intrinsics"), len(names), f"{where}: intrinsics ({', '.join(names)})")
    *extra, fx, fy, cx, cy = given
    middle = (fx, fy, cx + CENTRE, cy + CENTRE)
    if model == "omni" and distortion in ("none", "radtan"):
        return _mei((extra[0], *middle), k, size, where, name)
    if model == "eucm" and distortion == "none":
        return FoundCamera(model="EUCM", params=(*middle, *extra), size=size, where=where, name=name)
    lenses = {"none": ("PINHOLE", 0), "radtan": ("OPENCV", 4), "equidistant": ("OPENCV_FISHEYE", 4), "fov": ("FOV", 1)}
    if model != "pinhole" or distortion not in lenses:
        raise InputError(
            f"{where}: {model} with {distortion}: read are pinhole with radtan, equidistant, fov or none, eucm, and "
            "omni without distortion; calibrate with one of these"
        )
    lens, count = lenses[distortion]
    coefficients = exactly(k, count, f"{where}: distortion_coeffs") if count else ()
    return FoundCamera(model=lens, params=(*middle, *coefficients), size=size, where=where, name=name)


def _mei(
    given: tuple[float, ...], k: tuple[float, ...], size: tuple[int, int] | None, where: str, name: str = ""
) -> FoundCamera:
    """An omnidirectional camera (xi, fx, fy, cx, cy) as EUCM."""
    xi, fx, fy, cx, cy = given
    remedy = "calibrate as a pinhole with equidistant distortion"
    zero(dict(zip(("k1", "k2", "p1", "p2", "k3"), k)), ("k1", "k2", "p1", "p2", "k3"), f"{where}: xi = {xi:g}", remedy)
    params = (fx / (1 + xi), fy / (1 + xi), cx, cy, xi / (1 + xi), 1.0)
    return FoundCamera(model="EUCM", params=params, size=size, where=where, name=name)
