"""The camera of a sensor: given by ``--camera``, a rig file or a start model, from EXIF, from a preset's field of view,
or guessed, with a note.

``--camera`` gives a calibration in words, or as a file of calibration software.
``OPENCV,4000x3000,2759.5,2764.2,1520.7,1006.8,0,0,0,0`` is a model and its parameters, both as in COLMAP, and
between them, optionally, the size of the images they belong to. Files: those of ``camerafile``, and a rig.toml with one
camera.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.scan.assign import Survey
from tiegraph.scan.folders import words
from tiegraph.scan.prepare import crop_camera, pinhole_camera
from tiegraph.scan.priors.startmodel import StartModel
from tiegraph.scan.priors.trajectory import images_by_name
from tiegraph.scan.rigfiles.camerafile import PROGRAMS, check_lens, in_words, read_camera_file
from tiegraph.scan.rigfiles.cameraread import FoundCamera, only_one
from tiegraph.scan.rigfiles.rigfaults import FOV_DEG, focal_fault, lens_fault
from tiegraph.scan.rigfiles.rigfile import camera_table
from tiegraph.scan.rigfiles.rigspec import CIRCLE_DEG, START_FOCAL, RigSpec, SensorSpec
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import CameraTuning
from tiegraph.scene.atomic import names_file
from tiegraph.scene.decoding import EIGHT_BIT, Levels
from tiegraph.scene.rig import Source, on_plane
from tiegraph.scene.textfile import utf8_text
from tiegraph.text import some


@dataclass(frozen=True)
class FileFacts:
    """The common values of the probes of one sensor's images."""

    size: tuple[int, int]  # width, height of most of them, upright if ``upright``
    focal_px: float  # median of EXIF, NaN = none
    upright: bool
    levels: Levels
    loose: bool
    radius_px: float = float("nan")  # of the circle that a fisheye lens lights in most of them, NaN = no circle


def calibrate(
    spec: SensorSpec, facts: FileFacts, file: str, settings: ScanSettings, tuning: CameraTuning
) -> tuple[pycolmap.Camera, Source | None, str]:
    """Camera of a sensor's prepared images, how to prepare them, and the source of the focal length (for people);
    ``file`` is the rig file, "" for presets and guesses.

    Raises InputError if the rig file's camera does not fit the images, if cropping leaves nothing, or if undistortion
    is asked for a camera that is not calibrated.
    """
    camera, how = _file_camera(spec, facts, file, settings, tuning)
    crop = spec.crop_px or settings.crop_px
    prepared = camera
    if any(crop):
        left, top, right, bottom = crop
        if min(crop) < 0 or min(camera.width - left - right, camera.height - top - bottom) < 32:
            raise InputError(
                f"crop_px = {list(crop)} of sensor {spec.name!r} leaves less than 32 px of "
                f"{camera.width} x {camera.height}: left, top, right, bottom are the pixels to cut off"
            )
        prepared = crop_camera(camera, *crop)
    if settings.undistort:
        if spec.params is None:
            raise InputError(
                f"undistort: sensor {spec.name!r} has no calibrated camera; give its model and params in a rig file, "
                "or leave undistort off: the distortion is then estimated with the model"
            )
        if not prepared.is_undistorted():
            prepared = pinhole_camera(prepared)
    deep = facts.levels != EIGHT_BIT
    if deep:
        how += "; pixels deeper than 8 bits: {:g} to {:g} become 0 to 255".format(*facts.levels)
    changed = spec.view_of_panorama or any(crop) or prepared.model != camera.model or not facts.upright or deep
    if not changed and spec.part is None:
        return prepared, None, how
    source = Source(camera=camera, crop_px=crop, upright=facts.upright, levels=facts.levels, part=spec.part)
    return prepared, replace(source, panorama=spec.view_of_panorama), how


def _file_camera(
    spec: SensorSpec, facts: FileFacts, file: str, settings: ScanSettings, tuning: CameraTuning
) -> tuple[pycolmap.Camera, str]:
    if spec.params is not None and spec.model is not None:
        return _from_params(spec.model, spec.params, spec, facts, spec.at if spec.started else file)
    model = spec.model or _default_model(spec, facts, settings)
    fisheye, named = "FISHEYE" in model, Path(file).name  # without the private folders of this machine
    width, height = facts.size
    known = True
    if spec.focal_px is not None:
        scale = _scale(spec, facts, file)
        focal, how = spec.focal_px * scale, f"focal length from {named}{_scaled(scale)}"
        if wrong := focal_fault(focal, width, fisheye):
            raise InputError(f"{spec.at or file}: sensor {spec.name!r}: {wrong}")
    elif spec.hfov_deg is not None and file:
        if not fisheye and not FOV_DEG[0] <= spec.hfov_deg <= FOV_DEG[1]:
            raise InputError(
                f"{spec.at or file}: sensor {spec.name!r}: hfov_deg = {spec.hfov_deg:g}: a {model} image sees "
                f"{FOV_DEG[0]:g} to {FOV_DEG[1]:g} degrees; give a fisheye model?"
            )
        focal, how = _from_hfov(spec.hfov_deg, width, fisheye), f"field of view from {named}"
    elif np.isfinite(facts.focal_px):
        focal, how = facts.focal_px, "focal length from EXIF"
    else:
        known, (focal, how) = False, _guessed(spec, facts, fisheye, tuning)
    made = pycolmap.Camera.create_from_model_name(0, model, float(focal), width, height)
    camera = pycolmap.Camera(model=model, width=width, height=height, params=made.params)
    camera.has_prior_focal_length = known
    return camera, how


def _guessed(spec: SensorSpec, facts: FileFacts, fisheye: bool, tuning: CameraTuning) -> tuple[float, str]:
    """Focal length, pixels, of a camera without any information, and the basis of the guess."""
    width = facts.size[0]
    if spec.hfov_deg is not None:
        how = f"focal length from the preset's nominal field of view of {spec.hfov_deg:g} degrees"
        return _from_hfov(spec.hfov_deg, width, fisheye), how
    if fisheye:
        circle = np.isfinite(facts.radius_px)
        across = CIRCLE_DEG if circle else tuning.guessed_fisheye_deg
        how = f"focal length guessed: a fisheye of {across:g} degrees across{' its circle' if circle else ''}"
        return _from_hfov(across, 2 * facts.radius_px if circle else width, fisheye), how
    how = f"focal length guessed as {tuning.guessed_focal} x the longer side (no EXIF, no rig file with a camera)"
    return tuning.guessed_focal * max(facts.size), how


def _from_params(
    model: str, params: tuple[float, ...], spec: SensorSpec, facts: FileFacts, file: str
) -> tuple[pycolmap.Camera, str]:
    scale = _scale(spec, facts, file)
    width, height = spec.size or facts.size
    camera = pycolmap.Camera(model=model, width=width, height=height, params=list(params))
    if wrong := lens_fault(camera):
        raise InputError(f"{spec.at or file}: sensor {spec.name!r}: {wrong}")
    if (width, height) != facts.size:
        camera.rescale(*facts.size)
    camera.has_prior_focal_length = True
    named = Path(file).name or "its circle, a guess"
    origin = "an exact view of the panoramas" if spec.view_of_panorama else f"camera from {named}"
    return camera, f"{origin}{_scaled(scale)}"


def _scale(spec: SensorSpec, facts: FileFacts, file: str) -> float:
    """Images' width over the width of the rig file."""
    if spec.size is None or spec.size == facts.size:
        return 1.0
    across, down = facts.size[0] / spec.size[0], facts.size[1] / spec.size[1]
    if abs(across / down - 1) > _SAME_SHAPE:
        raise InputError(
            f"{file}: the camera of sensor {spec.name!r} is for {spec.size[0]} x {spec.size[1]} images, but its images "
            f"have {facts.size[0]} x {facts.size[1]}: another shape, so the parameters cannot be rescaled. Give the "
            "parameters of these images, or omit the camera"
        )
    return across


def _scaled(scale: float) -> str:
    return "" if scale == 1 else f", rescaled by {scale:.4g} to the size of the images"


def _from_hfov(hfov_deg: float, width: float, fisheye: bool) -> float:
    half = np.radians(hfov_deg) / 2
    return float(width / 2 / (half if fisheye else np.tan(half)))


def _default_model(spec: SensorSpec, facts: FileFacts, settings: ScanSettings) -> str:
    if settings.camera_model != "auto":
        return settings.camera_model
    if "fisheye" in words(spec.folder or spec.name) or np.isfinite(facts.radius_px):
        return "OPENCV_FISHEYE"
    # Loose photographs: few images of a camera, so one distortion parameter. Rigs and sequences: wide lenses need two,
    # but on the nearly straight tracks of a survey fy and the tangential terms of OPENCV are hardly observable and bend
    # the model, because they correlate with the rotations; the final adjustment adds them with priors
    # (sfm.adjustment.lens).
    return "SIMPLE_RADIAL" if facts.loose else "RADIAL"


WORDS = (
    "give MODEL,parameters as COLMAP names and orders them (such as OPENCV,4000x3000,fx,fy,cx,cy,k1,k2,p1,p2; the size "
    f"of the images may be omitted), or a file: {PROGRAMS}, or a rig.toml with one camera"
)
_FILES = (".txt", ".bin", ".yaml", ".yml", ".xml", ".json", ".toml")
_SAME_SHAPE = 0.01  # relative difference of two aspect ratios that rounding to whole pixels may cause
_GRID = 15  # points across an image at which cameras are compared


def read_camera(text: str) -> SensorSpec:
    """The camera of an option ``--camera``: a sensor without name or folder. Raises InputError naming what is wrong."""
    path, where = Path(text), f"--camera {text}"
    if not names_file(text):
        if path.suffix.lower() in _FILES or "/" in text:
            raise InputError(f"{where}: no such file; {WORDS}")
        found = in_words(re.split(r"[,;\s]+", text.strip()), where, WORDS)
    elif path.suffix.lower() == ".toml":
        return camera_table(path, utf8_text(path, where, f"; {WORDS}"))
    else:
        found = only_one(read_camera_file(path, where), where)
    check_lens(found)
    return SensorSpec("camera", **found.of_sensor())


Sizes = Mapping[tuple[int, int], tuple[int, int]]
"""Width and height of the images, by rig and sensor."""


def with_camera(survey: Survey, sizes: Sizes, camera: str | None, notes: list[str]) -> Survey:
    """The survey with the one camera whose calibration the user gave. Raises InputError."""
    if camera is None:
        return survey
    given = read_camera(camera)
    r, k = _taker(given, survey, sizes)
    sensor = survey.specs[r].sensors[k]
    if sensor.params is not None or sensor.focal_px is not None or sensor.hfov_deg is not None:
        raise InputError(f"{given.at}: the rig file gives a camera for {sensor.name!r} too: omit one of the two")
    if len(sizes) > 1:
        others = f"{len(sizes) - 1} other cameras keep the values of EXIF"
        notes.append(f"{Path(given.at).name}: used for {sensor.name}; {others}")
    fields = ("model", "size", "params", "focal_px", "hfov_deg", "camera_sigma_px", "at")
    specs = _with_sensor(survey.specs, (r, k), **{name: getattr(given, name) for name in fields})
    specs[r] = replace(specs[r], file=specs[r].file or given.at)
    return replace(survey, specs=tuple(specs))


def _taker(given: SensorSpec, survey: Survey, sizes: Sizes) -> tuple[int, int]:
    """Rig and sensor of a given camera: the only one, or that whose images have the shape of the calibration;
    photographs by other cameras keep the values of EXIF. Raises InputError if several or none fit."""
    fits = [key for key, size in sizes.items() if len(sizes) == 1 or _same_shape(given.size, size)]
    if len(fits) == 1:
        return fits[0]
    named = [f"{survey.specs[r].sensors[k].name} ({w} x {h})" for (r, k), (w, h) in sizes.items()]
    which = f"a camera of {given.size[0]} x {given.size[1]} images fits" if given.size else "without a size it fits"
    count = f"{len(fits)} of them" if fits else "none of them"
    raise InputError(
        f"{given.at}: {which} {count}, the images are of {len(sizes)} cameras: {', '.join(named[:4])}; give each its "
        "own camera in a rig.toml (`tiegraph init` writes one), or keep photographs of one camera"
    )


def _with_sensor(specs: Sequence[RigSpec], key: tuple[int, int], **changes: Any) -> list[RigSpec]:
    """The rigs with some fields of one sensor changed."""
    r, k = key
    sensors = [replace(s, **changes) if n == k else s for n, s in enumerate(specs[r].sensors)]
    return [replace(spec, sensors=tuple(sensors)) if n == r else spec for n, spec in enumerate(specs)]


def start_cameras(root: Path, by_folder: Mapping[str, FoundCamera], names: Sequence[str]) -> StartModel | None:
    """The cameras of bags for the images below some folders of ``root``, as a start model without poses; None if
    there are none."""
    above = {name: [str(p) for p in PurePosixPath(name).parents] for name in names}
    found = {n: by_folder[f] for n, folders in above.items() for f in folders if f in by_folder}
    return StartModel(path=root, program="the bag", poses={}, cameras=found) if found else None


def with_start_cameras(
    survey: Survey, sizes: Sizes, start: StartModel, notes: list[str], names: Sequence[str]
) -> Survey:
    """The survey with the cameras of a start model where the user gave none: initial values, to be adjusted.

    ``names`` of the images' files. Raises InputError for a camera of images of another shape.
    """
    taken_by = images_by_name(list(start.cameras), start.path, names) if start.cameras else {}
    cameras, specs, given = list(start.cameras.values()), list(survey.specs), []
    for (r, k), size in sizes.items():
        sensor = specs[r].sensors[k]
        own = [taken_by[s.image] for s in survey.shots if (s.rig, s.sensor) == (r, k) and s.image in taken_by]
        if not own:
            continue
        if sensor.params is not None or sensor.focal_px is not None or (sensor.hfov_deg is not None and specs[r].file):
            given.append(sensor.name)
            continue
        found = _middle([cameras[row] for row in own], sensor.name, start.cameras_of(), notes)
        if found is None:
            continue
        if not _same_shape(found.size, size):
            w, h = found.size or size
            raise InputError(
                f"{found.where}: its images of {sensor.name!r} have {w} x {h}, those here {size[0]} x {size[1]}: start "
                "from a model of these images (not undistorted, cropped or turned)"
            )
        check_lens(found)
        found = _adjustable(found, size)
        focal = START_FOCAL * found.params[0]
        specs = _with_sensor(specs, (r, k), **found.of_sensor(), camera_sigma_px=focal, started=True)
    if given:
        notes.append(f"{some(given)}: the cameras given are used, not those of {start.cameras_of()}")
    return replace(survey, specs=tuple(specs))


def _adjustable(found: FoundCamera, size: tuple[int, int]) -> FoundCamera:
    """The camera from which a perspective one is adjusted: the RADIAL that is nearest to it over its image.

    The second focal length and the further terms of other models diverge in straight surveys if they are free; the
    final adjustment adds them with the priors of common lenses (``sfm.adjustment.lens``).
    """
    if found.model not in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"):
        return found
    width, height = found.size or size
    camera = pycolmap.Camera(model=found.model, width=width, height=height, params=list(found.params))
    grid = np.array([[u, v] for u in np.linspace(0, width, _GRID) for v in np.linspace(0, height, _GRID)])
    plane = on_plane(camera, grid)
    seen = np.isfinite(plane).all(axis=1)
    plane, grid = plane[seen], grid[seen]
    square = np.sum(plane**2, axis=1, keepdims=True)
    # pixel = centre + f (1 + k1 r2 + k2 r4) (x, y) is linear in f, f k1, f k2 and the centre.
    terms = np.stack([plane, plane * square, plane * square**2], axis=2).reshape(-1, 3)
    middle = np.tile(np.eye(2), (len(plane), 1))
    f, k1, k2, cx, cy = np.linalg.lstsq(np.hstack([terms, middle]), grid.ravel(), rcond=None)[0]
    params = tuple(float(v) for v in (f, cx, cy, k1 / f, k2 / f))
    return replace(found, model="RADIAL", params=params, size=(width, height))


def _middle(cameras: list[FoundCamera], name: str, whose: str, notes: list[str]) -> FoundCamera | None:
    """The camera of a sensor from those that a model has for its images: the one of the median focal length, which is
    the first parameter of every model; None if they are of several models or sizes."""
    different = list(dict.fromkeys(cameras))
    if len({(c.model, c.size) for c in different}) > 1:
        notes.append(f"{name}: {whose} has cameras of several models or sizes for it: none is taken")
        return None
    order = sorted(different, key=lambda c: c.params[0])
    if len(order) > 1:
        low, high = order[0].params[0], order[-1].params[0]
        focal = f"focal length {low:.1f} to {high:.1f} px"
        notes.append(f"{name}: of {len(order)} cameras of {whose} ({focal}) the one of median focal length is taken")
    return order[len(order) // 2]


def _same_shape(given: tuple[int, int] | None, size: tuple[int, int]) -> bool:
    return given is None or abs(given[0] * size[1] / (given[1] * size[0]) - 1) < _SAME_SHAPE
