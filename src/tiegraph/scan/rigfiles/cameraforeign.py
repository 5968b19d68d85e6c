"""Cameras of OpenSfM and of Agisoft's programs in COLMAP's models: exact, or refused with the term that does not fit.

**OpenSfM** (``camera_models.json``, ``reconstruction.json``; ``camera_distortions_functions.h``): lengths are parts of
the longer side, the principal point is told from the middle of the image, as pixel = size/2 + longer side * (x + c).
perspective, radial, simple_radial = RADIAL (two focal lengths: OPENCV), brown = FULL_OPENCV, fisheye = RADIAL_FISHEYE,
fisheye_opencv = OPENCV_FISHEYE, fisheye62 without k5, k6 = THIN_PRISM_FISHEYE; p1 and p2 are as OpenCV's.

**Agisoft** Metashape, PhotoScan from 1.2 and Lens (manual, appendix "Camera models"; XML of a calibration, or the
``sensor`` of a camera file): u = w/2 + cx + x' (f + b1) + y' b2, v = h/2 + cy + y' f, pixels from the corner of the
first one (whose centre is 0.5, 0.5), as COLMAP's. x' has p1 (r2 + 2 x2) + 2 p2 xy: p1 and p2 change places against
OpenCV. frame = FULL_OPENCV, which has no k4 of this kind, no b2, no p3 and p4. fisheye is the same of theta instead of
tan theta, so k4 fits: OPENCV_FISHEYE, with p1 or p2 THIN_PRISM_FISHEYE. Older files (fx, fy, skew; cx, cy from the
corner) are read without p1 and p2, whose order changed between the versions.
"""

import json
import re
from typing import Any

from tiegraph.errors import InputError
from tiegraph.scan.rigfiles.cameraread import NUMBER, FoundCamera, size_of, zero
from tiegraph.scan.rigfiles.rigfaults import is_number

# --- OpenSfM ----------------------------------------------------------------------------------------------------------


def is_opensfm(content: str) -> bool:
    """Whether a text is a camera_models.json or reconstruction.json."""
    return content.lstrip()[:1] in ("{", "[") and '"projection_type"' in content


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
    """COLMAP's model and parameters."""

    def k(*names: str) -> tuple[float, ...]:
        return tuple(value.get(n, 0.0) for n in names)

    one = focal[0] == focal[1]
    wide = (*focal, *middle)
    if kind in ("perspective", "radial", "simple_radial") and one:
        return "RADIAL", (focal[0], *middle, *k("k1", "k2"))
    if kind in ("radial", "simple_radial"):
        return "OPENCV", (*wide, *k("k1", "k2"), 0.0, 0.0)
    if kind == "brown" and not value.get("k3"):
        return "OPENCV", (*wide, *k("k1", "k2", "p1", "p2"))
    if kind == "brown":
        return "FULL_OPENCV", (*wide, *k("k1", "k2", "p1", "p2", "k3"), 0.0, 0.0, 0.0)
    if kind == "fisheye":
        return "RADIAL_FISHEYE", (focal[0], *middle, *k("k1", "k2"))
    if kind == "fisheye_opencv":
        return "OPENCV_FISHEYE", (*wide, *k("k1", "k2", "k3", "k4"))
    if kind == "fisheye62":
        zero(value, ("k5", "k6"), where, "calibrate as fisheye_opencv")
        return "THIN_PRISM_FISHEYE", (*wide, *k("k1", "k2", "p1", "p2", "k3", "k4"), 0.0, 0.0)
    raise InputError(
        f"{where}: projection_type {kind}: read are perspective, simple_radial, radial, brown, fisheye, fisheye_opencv "
        "and fisheye62 without k5, k6; calibrate with one of these (panoramas: --rig panorama)"
    )


# --- Agisoft ----------------------------------------------------------------------------------------------------------


_TERMS = (
    "width", "height", "f", "fx", "fy", "cx", "cy", "skew", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4",
)  # fmt: skip


def is_agisoft(content: str) -> bool:
    """Whether a text is a calibration or a camera file of Metashape, PhotoScan or Lens."""
    return bool(re.search(r"<calibration\b", content) and re.search(r"<fx?>", content))


def agisoft(content: str, where: str) -> list[FoundCamera]:
    """The cameras of Agisoft's XML; of each sensor the adjusted one where there is one. Raises InputError."""
    sensors = re.findall(r"<sensor\b([^>]*)>(.*?)</sensor>", content, re.DOTALL) or [("", content)]
    found = []
    for head, text in sensors:
        blocks = re.findall(r"<calibration\b([^>]*)>(.*?)</calibration>", text, re.DOTALL)
        blocks = [b for b in blocks if re.search(r"<fx?>", b[1])]
        if not blocks:  # a sensor without images has no calibration
            continue
        block = next((b for b in blocks if "adjusted" in b[0]), blocks[0])
        label = re.search(r'label="([^"]*)"', head)
        found.append(_agisoft(label[1] if label else "", block[0], block[1], where))
    return found


def _agisoft(name: str, head: str, text: str, where: str) -> FoundCamera:
    value = _values(text, where)
    kind = re.search(r"<projection>\s*(\w+)", text) or re.search(r'type="(\w+)"', head)
    place = re.search(r'<resolution width="(\d+)" height="(\d+)"', text)
    width, height = map(float, place.groups()) if place else (value.get("width", 0.0), value.get("height", 0.0))
    if min(width, height) < 1:
        raise InputError(f"{where}: width and height are missing, from whose middle cx and cy are told; add them")
    remedy = "optimise or calibrate without it, then export again"
    zero(value, ("b2", "skew", "p3", "p4"), where, remedy)
    if "fx" in value:
        zero(value, ("p1", "p2"), f"{where}: a file of an old version (fx, fy)", "export it with Metashape")
        focal = value["fx"], value.get("fy", value["fx"])
        middle = value.get("cx", width / 2), value.get("cy", height / 2)
    else:
        if "f" not in value:
            raise InputError(f"{where}: no focal length (f); export the calibration again")
        focal = value["f"] + value.get("b1", 0.0), value["f"]
        middle = width / 2 + value.get("cx", 0.0), height / 2 + value.get("cy", 0.0)
    model, params = _agisoft_lens(kind[1] if kind else "frame", (*focal, *middle), value, where, remedy)
    return FoundCamera(model=model, params=params, size=size_of((width, height)), where=where, name=name)


def _values(text: str, where: str) -> dict[str, float]:
    """The numbers of the elements that are known. Raises InputError for one that is none."""
    out = {}
    for name, content in re.findall(r"<(\w+)>([^<]*)</\1>", text):
        if name not in _TERMS:
            continue
        if not re.fullmatch(NUMBER, content.strip()):
            raise InputError(f"{where}: {name} = {content.strip()!r:.99}: expected a number")
        out[name] = float(content)
    return out


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
