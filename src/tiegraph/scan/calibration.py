"""The calibration of a single camera, given by ``--camera``: in words, or as a file of the programs that make them.

``OPENCV,4000x3000,2759.5,2764.2,1520.7,1006.8,0,0,0,0`` is a model and its parameters, both as COLMAP has them, and
between them, optionally, the size of the images they belong to. Files: those of ``camerafile``, and a rig.toml with one
camera.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from tiegraph.errors import InputError
from tiegraph.scan.assign import Survey
from tiegraph.scan.camerafile import PROGRAMS, check_lens, in_words, read_camera_file
from tiegraph.scan.cameraread import FoundCamera, only_one
from tiegraph.scan.rigfile import camera_table
from tiegraph.scan.rigspec import SensorSpec
from tiegraph.scan.tuning import CameraTuning, RigTuning
from tiegraph.scene.regular import names_file, regular

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
        notes.append(f"{given.at}: taken for {sensor.name}; {len(others)} other cameras keep what EXIF says")
    camera = {
        n: getattr(given, n) for n in ("model", "size", "params", "focal_px", "hfov_deg", "camera_sigma_px", "at")
    }
    return {key: replace(sensor, **camera)}


def _same_shape(given: tuple[int, int] | None, size: tuple[int, int], tuning: CameraTuning) -> bool:
    return given is None or abs(given[0] * size[1] / (given[1] * size[0]) - 1) < tuning.same_shape
