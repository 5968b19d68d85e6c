"""What no rig can be, however good the form of its file: sizes, sigmas and lenses that make no sense."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import dist

import numpy as np
import pycolmap

from tiegraph.scan.rigfiles.rigspec import RigSpec
from tiegraph.scan.tuning import CameraTuning, RigTuning
from tiegraph.scene.rays import on_plane
from tiegraph.scene.rig import PAIR_KEYS, SensorPair

MAX_SIDE_PX = 100_000  # of an image that a rig file may name
SIGMA_M, SIGMA_DEG = (1e-6, 100.0), (1e-6, 180.0)  # sigmas of lengths and angles, from and to
_STEPS = 24  # along a line from the middle to the edge
_EDGE = 0.95  # share of that line that is looked at: calibrations may fold in the last corner pixels


@dataclass(frozen=True)
class Fault:
    """What is wrong: the key at fault in the ``number``-th sensor or pair, and the sentence."""

    table: str  # "sensors", "pairs" or "" = the rig itself
    number: int
    key: str
    message: str


def faults(spec: RigSpec, tuning: RigTuning) -> Iterator[Fault]:
    """Everything that is wrong with the geometry of a rig, worst first."""
    yield from _far_apart(spec, tuning.max_rig_m)
    for number, sensor in enumerate(spec.sensors):
        for key, value, (_, most) in (
            ("sigma_m", sensor.sigma_m, SIGMA_M),
            ("sigma_deg", sensor.sigma_deg, SIGMA_DEG),
        ):
            if value is not None and value > most:
                yield Fault(
                    table="sensors",
                    number=number,
                    key=key,
                    message=f"{key} = {value:g}: {most:g} at most; leave it away if unknown",
                )
    seen: dict[frozenset[str], int] = {}
    for number, pair in enumerate(spec.pairs):
        yield from _pair(pair, number, tuning)
        first = seen.setdefault(frozenset(pair.sensors), number)
        if first != number:
            both = " - ".join(pair.sensors)
            yield Fault(
                table="pairs",
                number=number,
                key="sensors",
                message=f"pair {both} is given twice (pair {first + 1}): join the two",
            )


def contradictions(spec: RigSpec, tuning: RigTuning) -> list[str]:
    """What pairs say against the positions and orientations beside them; a nominal rig's are no measurement."""
    places = {s.name: s.body_from_sensor for s in spec.sensors if s.body_from_sensor is not None}
    out = []
    for pair in spec.pairs:
        if spec.nominal or not set(pair.sensors) <= set(places):
            continue
        a, b = (places[n] for n in pair.sensors)
        baseline = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
        cosine = float(a[:3, 2] @ b[:3, 2])
        axis = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        said = (
            (pair.baseline_m, pair.baseline_sigma_m, baseline, "m apart"),
            (pair.axis_deg, pair.axis_sigma_deg, axis, "degrees between the axes"),
        )
        for value, sigma, found, unit in said:
            if value is None or sigma is None:
                continue
            if abs(value - found) > tuning.contradiction_sigmas * sigma:
                out.append(
                    f"pair {' - '.join(pair.sensors)}: {value:g} {unit} with sigma {sigma:g}, but the sensors' own "
                    f"poses say {found:.4g}: check which is right"
                )
    return out


def _far_apart(spec: RigSpec, most_m: float) -> Iterator[Fault]:
    placed = [(k, s.body_from_sensor) for k, s in enumerate(spec.sensors) if s.body_from_sensor is not None]
    remedy = f"more than {most_m:g} m: are these millimetres?"
    for n, (k, pose) in enumerate(placed):
        for j, other in placed[:n]:
            away = dist(pose[:3, 3], other[:3, 3])
            if not away <= most_m:
                names = f"{spec.sensors[k].name!r} is {away:g} m from {spec.sensors[j].name!r}"
                yield Fault(table="sensors", number=k, key="position_m", message=f"sensor {names}, {remedy}")
    if spec.antenna_m is not None and placed:
        nearest = min(dist(spec.antenna_m, pose[:3, 3]) for _, pose in placed)
        if not nearest <= most_m:
            yield Fault(
                table="",
                number=0,
                key="antenna_m",
                message=f"antenna_m: {nearest:g} m from the nearest camera, {remedy}",
            )


def _pair(pair: SensorPair, number: int, tuning: RigTuning) -> Iterator[Fault]:
    values = {key: getattr(pair, key) for key in PAIR_KEYS}
    if all(v is None for v in values.values()):
        yield Fault(
            table="pairs", number=number, key="sensors", message=f"the pair says nothing: give {', '.join(PAIR_KEYS)}"
        )
    limits = {
        "baseline_m": (0.0, tuning.max_rig_m),
        "baseline_sigma_m": SIGMA_M,
        "axis_deg": (0.0, 180.0),
        "axis_sigma_deg": SIGMA_DEG,
    }
    for key, (least, most) in limits.items():
        value = values[key]
        if value is not None and not least <= value <= most:
            yield Fault(
                table="pairs", number=number, key=key, message=f"{key} = {value:g}: expected {least:g} to {most:g}"
            )


# --- lenses ---------------------------------------------------------------------------------------------------------


def lens_fault(camera: pycolmap.Camera, tuning: CameraTuning) -> str:
    """What is wrong with a calibrated camera, "" if nothing: focal lengths, principal point, view, distortion.

    Lines from the principal point to the edge of the image must become rays whose angle grows all along, finite, and
    that come back to their pixels: distortion that folds the image maps two places of the world to one. Of a fisheye
    image only the middle is looked at, for its circle may end before the edge.
    """
    width, height = camera.width, camera.height
    focal = [float(camera.params[k]) for k in camera.focal_length_idxs()]
    if not focal:
        return f"{camera.model.name} is no camera of a rig: --rig panorama reads panoramas"
    if min(focal) <= 0:
        return f"the focal length is {min(focal):g} px: it must be above 0"
    if max(focal) > tuning.max_aspect * min(focal):
        return f"the focal lengths {focal[0]:g} and {focal[1]:g} px differ too much: fx and fy of nearly square pixels"
    fisheye = "FISHEYE" in camera.model.name or camera.model.name in ("EUCM", "EQUIRECTANGULAR")
    if wrong := focal_fault(min(focal), width, fisheye, tuning):
        return wrong
    middle = np.array([camera.principal_point_x, camera.principal_point_y])
    if not (0 < middle[0] < width and 0 < middle[1] < height):
        return (
            f"the principal point ({middle[0]:g}, {middle[1]:g}) is not inside the {width} x {height} image. If the "
            "parameters belong to another image size, give it as size = [width, height] in a rig.toml"
        )
    if (np.abs(middle / [width, height] - 0.5) > tuning.off_centre).all():
        return (
            f"the principal point ({middle[0]:g}, {middle[1]:g}) is in a corner of the {width} x {height} image: it "
            "counts pixels from the upper left corner, not from the middle, and is no share of the sides"
        )
    return _fold(camera, middle, fisheye, tuning)


def focal_fault(focal_px: float, width: int, fisheye: bool, tuning: CameraTuning) -> str:
    """What is wrong with a focal length of images ``width`` px wide, "" if nothing."""
    ratio = width / 2 / focal_px
    across = float(np.degrees(2 * (ratio if fisheye else np.arctan(ratio))))
    least, most = tuning.min_fov_deg, 360.0 if fisheye else tuning.max_fov_deg
    if least <= across <= most:
        return ""
    said = f"a focal length of {focal_px:g} px sees {across:.3g} degrees across {width} px"
    return f"{said}, not {least:g} to {most:g}: is it in millimetres, or of another image size?"


def _fold(camera: pycolmap.Camera, middle: np.ndarray, fisheye: bool, tuning: CameraTuning) -> str:
    said = f"{camera.model.name} with the parameters {[float(f'{p:.6g}') for p in camera.params]}"
    limit = tuning.round_trip * max(camera.width, camera.height)
    share = np.linspace(0, 1, _STEPS + 1)[1:, None]
    for end in _ends(camera, middle, fisheye, tuning):
        if np.linalg.norm(end - middle) < limit:  # the principal point is at that edge
            continue
        pixels = middle + _EDGE * share * (end - middle)
        rays = np.array([np.append(on_plane(camera, p[None])[0], 1.0) for p in pixels])
        off = np.array([_pixel(camera, r) for r in rays]) - pixels
        lost = ~(np.hypot(off[:, 0], off[:, 1]) < limit)
        outward = rays[:, :2] @ (end - middle) / np.linalg.norm(end - middle)
        angle = np.arctan2(outward, rays[:, 2])
        lost |= ~(np.diff(angle, prepend=0.0) > 0)
        if lost.any():
            x, y = pixels[int(np.argmax(lost))]
            return f"{said} folds or tears the image at pixel ({x:.0f}, {y:.0f}): are the distortion parameters right?"
        straight = np.linalg.norm((end - middle) * _EDGE) / camera.mean_focal_length()
        stretch = float(angle[-1] if fisheye else np.tan(angle[-1])) / straight
        if not tuning.stretch[0] <= stretch <= tuning.stretch[1]:
            return (
                f"{said} lets the edge of the image look {stretch:.2g} times as far out as without distortion: are the "
                "parameters those of normalised coordinates?"
            )
    return ""


def _ends(camera: pycolmap.Camera, middle: np.ndarray, fisheye: bool, tuning: CameraTuning) -> np.ndarray:
    """(E, 2) ends of lines from the middle: the edge of the image, or the circle surely seen by a fisheye lens."""
    width, height = camera.width, camera.height
    if fisheye:
        turn = np.radians(360.0 / tuning.fisheye_lines * np.arange(tuning.fisheye_lines))
        return middle + tuning.fisheye_middle * min(width, height) / 2 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    x, y = middle
    return np.array([[0, 0], [x, 0], [width, 0], [0, y], [width, y], [0, height], [x, height], [width, height]], float)


def _pixel(camera: pycolmap.Camera, ray: np.ndarray) -> np.ndarray:
    found = camera.img_from_cam(ray) if np.isfinite(ray).all() else None
    return np.full(2, np.nan) if found is None else np.ravel(np.asarray(found, float))[:2]
