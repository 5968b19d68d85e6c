"""The calibration of a single camera, given by ``--camera``: in words, or as a file of the programs that make them.

``OPENCV,4000x3000,2759.5,2764.2,1520.7,1006.8,0,0,0,0`` is a model and its parameters, both as COLMAP has them, and
between them, optionally, the size of the images they belong to. Files: those of ``camerafile``, and a rig.toml with one
camera.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.scan.assign import Survey
from tiegraph.scan.priors.poses import images_by_name
from tiegraph.scan.priors.startmodel import StartModel
from tiegraph.scan.rigfiles.camerafile import PROGRAMS, check_lens, in_words, read_camera_file
from tiegraph.scan.rigfiles.cameraread import FoundCamera, only_one
from tiegraph.scan.rigfiles.rigfile import camera_table
from tiegraph.scan.rigfiles.rigspec import SensorSpec
from tiegraph.scan.tuning import CameraTuning, RigTuning
from tiegraph.scene.rays import on_plane
from tiegraph.scene.regular import names_file, regular
from tiegraph.text import some

WORDS = (
    "give MODEL,parameters as COLMAP names and orders them (such as OPENCV,4000x3000,fx,fy,cx,cy,k1,k2,p1,p2; the size "
    f"of the images may be left away), or a file: {PROGRAMS}, or a rig.toml with one camera"
)
_FILES = (".txt", ".bin", ".yaml", ".yml", ".xml", ".json", ".toml")


def read_camera(text: str, tuning: RigTuning) -> SensorSpec:
    """The camera of an option ``--camera``: a sensor without name or folder. Raises InputError naming what is wrong."""
    path, where = Path(text), f"--camera {text}"
    if not names_file(text):
        if path.suffix.lower() in _FILES or "/" in text:
            raise InputError(f"{where}: no such file; {WORDS}")
        return _sensor(in_words(re.split(r"[,;\s]+", text.strip()), where, WORDS), tuning.camera)
    if path.suffix.lower() == ".toml":
        try:
            return camera_table(path, regular(path).read_text(encoding="utf-8-sig"), tuning)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{where}: cannot be read as text in UTF-8 ({error}); {WORDS}") from None
    return _sensor(only_one(read_camera_file(path, where), where), tuning.camera)


def _sensor(found: FoundCamera, tuning: CameraTuning) -> SensorSpec:
    """A sensor with the camera, after a look whether a lens can be so."""
    check_lens(found, tuning)
    return SensorSpec("camera", model=found.model, size=found.size, params=found.params, at=found.where)


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
        notes.append(f"{Path(given.at).name}: taken for {sensor.name}; {len(others)} other cameras keep what EXIF says")
    camera = {
        n: getattr(given, n) for n in ("model", "size", "params", "focal_px", "hfov_deg", "camera_sigma_px", "at")
    }
    return {key: replace(sensor, **camera)}


def start_cameras(root: Path, by_folder: Mapping[str, FoundCamera], names: Sequence[str]) -> StartModel | None:
    """The cameras that bags have for the images below some folders of ``root``, as a start model without poses; None if
    there are none."""
    above = {name: [str(p) for p in PurePosixPath(name).parents] for name in names}
    found = {n: by_folder[f] for n, folders in above.items() for f in folders if f in by_folder}
    return StartModel(path=root, program="the bag", poses={}, cameras=found) if found else None


def with_start_cameras(
    survey: Survey, sizes: dict[tuple[int, int], tuple[int, int]], start: StartModel, notes: list[str],
    names: Sequence[str], tuning: CameraTuning,
) -> Survey:  # fmt: skip
    """The survey with the cameras of a start model where nobody gave one: a start, to be adjusted.

    ``sizes`` as for ``with_camera``; ``names`` of the images' files. Raises InputError for a camera of images of
    another shape.
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
        if not _same_shape(found.size, size, tuning):
            w, h = found.size or size
            raise InputError(
                f"{found.where}: its images of {sensor.name!r} have {w} x {h}, those here {size[0]} x {size[1]}: start "
                "from a model of these images (not undistorted, cropped or turned)"
            )
        check_lens(found, tuning)
        found = _adjustable(found, size)
        focal = tuning.start_focal * found.params[0]
        changed = replace(sensor, model=found.model, size=found.size, params=found.params, at=found.where)
        changed = replace(changed, camera_sigma_px=focal, started=True)
        specs[r] = replace(specs[r], sensors=tuple(changed if n == k else s for n, s in enumerate(specs[r].sensors)))
    if given:
        notes.append(f"{some(given)}: the cameras given are used, not those of {start.cameras_of()}")
    return replace(survey, specs=tuple(specs))


def _adjustable(found: FoundCamera, size: tuple[int, int]) -> FoundCamera:
    """The camera that a perspective one is adjusted from: the RADIAL that is nearest to it over its image.

    Freed, the second focal length and the terms beyond of other models run off where a survey is straight; what a lens
    has of them the final adjustment adds, with what is expected of lenses (``sfm.adjustment.lens``).
    """
    width, height = found.size or size
    camera = pycolmap.Camera(model=found.model, width=width, height=height, params=list(found.params))
    if found.model not in _PERSPECTIVE:
        return found
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


_PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_GRID = 15  # points across an image at which cameras are compared


def _middle(cameras: list[FoundCamera], name: str, whose: str, notes: list[str]) -> FoundCamera | None:
    """The camera of a sensor of those that a model has for its images: the one of the middle focal length, which is
    the first parameter of every model; None if they are of several models or sizes."""
    different = list(dict.fromkeys(cameras))
    if len({(c.model, c.size) for c in different}) > 1:
        notes.append(f"{name}: {whose} has cameras of several models or sizes for it: none is taken")
        return None
    order = sorted(different, key=lambda c: c.params[0])
    if len(order) > 1:
        low, high = order[0].params[0], order[-1].params[0]
        focal = f"focal length {low:.1f} to {high:.1f} px"
        notes.append(f"{name}: of {len(order)} cameras of {whose} ({focal}) the middle one is taken")
    return order[len(order) // 2]


def _same_shape(given: tuple[int, int] | None, size: tuple[int, int], tuning: CameraTuning) -> bool:
    return given is None or abs(given[0] * size[1] / (given[1] * size[0]) - 1) < tuning.same_shape
