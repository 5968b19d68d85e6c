"""Files with the circles of two fisheye lenses side by side, as 360 cameras write them: a frame of two lenses each.

Insta360's .insp is such a JPEG. What its factory measured of the lenses stands in a line behind the picture:
"2_R_x_y_yaw_pitch_roll_R_x_y_yaw_pitch_roll_width_height_kind", radii and centres in pixels of the whole file, angles
in degrees (ExifTool's Parameters). Of that only how the lenses are rolled is used: both lie on their sides in most
cameras, and then the second is not turned about its own upright but about the first one's horizontal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import Report, Usable
from tiegraph.scan.perspective import PRESET, SharedFiles, of_one_kind, share_files
from tiegraph.scan.rigfile import parse_rig_file, read_rig_file
from tiegraph.scan.rigspec import RigSpec, SensorSpec, orient, preset_sizes
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.images import Probe

NAMES = ("lens0", "lens1")


def two_lenses(
    usable: Usable, rig: str | None, text: str | None, settings: ScanSettings, report: Report, tuning: Tuning
) -> SharedFiles | None:
    """The lenses' images of a survey whose files hold two circles each; None if it is none.

    ``rig``: a file with two sensors, the left circle's first, cameras and sizes those of half a file; ``text``: of a
    rig.toml that comes from ``rig``, a run folder. Without, they stand back to back and see what is usual. Raises
    InputError for another rig.
    """
    if (rig or "").strip().lower() == PRESET:  # the user says they are panoramas
        return None
    both = [len(p.circles) == len(NAMES) and p.exif.orientation <= 1 for p in usable.probes]
    if sum(both) <= tuning.lens_views.most * len(both):
        return None
    kept = of_one_kind(usable, both, "not two fisheye images, as most files here are", report)
    spec = _nominal(kept.probes, report, tuning) if rig is None else _given(rig, text, tuning)
    shared = share_files(kept, spec, settings, tuning)
    halves = tuple(_half(p, s.sensor) for p, s in zip(shared.probes, shared.survey.shots))
    jpeg = tuple(n if PurePosixPath(n).suffix.lower() != ".insp" else f"{n[:-5]}.jpg" for n in shared.names)
    report.notes.append(f"{len(kept.names)} files with the images of two fisheye lenses side by side; {shared.order()}")
    return replace(shared, names=jpeg, probes=halves)


def _half(probe: Probe, part: int) -> Probe:
    """What a look at half a file would have found."""
    width = probe.width // len(NAMES)
    circles = tuple((x - part * width, y, radius) for x, y, radius in probe.circles[part : part + 1])
    exif = replace(probe.exif, focal_px=float("nan"))
    return replace(probe, width=width, exif=exif, circles=circles)


def _nominal(probes: Sequence[Probe], report: Report, tuning: Tuning) -> RigSpec:
    across_deg = tuning.rig.camera.guessed_circle_deg
    found = [p for p in probes if len(p.circles) == len(NAMES)]
    circles = np.median([[c for c in p.circles] for p in found], axis=0)  # (2, 3)
    width, height = found[0].width // len(NAMES), found[0].height
    rolled = [r for p in found if (r := _roll_deg(p)) is not None]
    told = "as its factory says" if rolled else "nothing says how they are rolled: taken for upright"
    roll = 90 * round(float(np.median(rolled)) / 90) if rolled else 0
    sensors = []
    for k, name in enumerate(NAMES):
        x, y, radius = (float(v) for v in circles[k] - (k * width, 0, 0))
        focal = radius / np.radians(across_deg / 2)
        sensors.append(
            SensorSpec(
                name=name,
                folder=name,
                body_from_sensor=rigid(orient(180.0 * k, 0, roll * k), np.zeros(3)),
                model="OPENCV_FISHEYE",
                size=(width, height),
                params=(focal, focal, x, y, 0.0, 0.0, 0.0, 0.0),
                camera_sigma_px=tuning.lens_views.nominal_sigma * focal,
                part=k,
            )
        )
    report.notes.append(f"two lenses back to back, {told}; each taken to see {across_deg:g} degrees across its circle")
    return RigSpec("360", tuple(sensors), nominal=True, synchronised=True, body_is_reference=True)


def _roll_deg(probe: Probe) -> float | None:
    """How far the two lenses of a shot are rolled together, by the factory; None if the file does not say, or says it
    of a picture of another shape."""
    words = probe.lenses.split("_")
    if len(words) != 16 or float(words[13]) != 2 * float(words[14]):
        return None
    return float(words[6]) + float(words[12])


def _given(rig: str, text: str | None, tuning: Tuning) -> RigSpec:
    if text is None and preset_sizes(rig, tuning.rig):
        raise InputError(
            f"--rig {rig}: the files hold two fisheye images each: give a rig file with two sensors, or none"
        )
    specs = read_rig_file(rig, tuning.rig) if text is None else parse_rig_file(Path(rig), text, tuning.rig)
    count = sum(len(s.sensors) for s in specs)
    if len(specs) != 1 or count != len(NAMES):
        raise InputError(
            f"--rig {rig}: {count} sensor(s), but the files hold two fisheye images each: give two sensors, that of "
            "the left circle first, with the cameras of half a file"
        )
    sensors = tuple(
        replace(s, folder=s.name, part=k, body_from_sensor=_pose(s, k)) for k, s in enumerate(specs[0].sensors)
    )
    return replace(specs[0], sensors=sensors, synchronised=True)


def _pose(sensor: SensorSpec, number: int) -> np.ndarray | None:
    """The first sensor is the body where no orientation is given."""
    return np.eye(4) if sensor.body_from_sensor is None and number == 0 else sensor.body_from_sensor
