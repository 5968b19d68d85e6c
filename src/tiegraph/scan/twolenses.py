"""Files with the circles of two fisheye lenses side by side, as 360 cameras write them: a frame of two lenses each.

Insta360's .insp is such a JPEG. What its factory measured of the lenses stands behind the picture
(``recording.insta360``): how the lenses are rolled, for both lie on their sides in most cameras, and then the second is
not turned about its own upright but about the first one's horizontal; and in newer cameras their distortion, a start
where it fits the circles of the pictures.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import Report, Usable
from tiegraph.scan.perspective import PRESET, SharedFiles, of_one_kind, share_files
from tiegraph.scan.recording.insta360 import FactoryLens, factory_lenses
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.rigfiles.rigfile import parse_rig_file, read_rig_file
from tiegraph.scan.rigfiles.rigspec import RigSpec, SensorSpec, orient, preset_sizes
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
    kept = of_one_kind(usable, both, [True] * len(both), "not two fisheye images, as most files here are", report)
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
    factory = [pair for p in found if (pair := factory_lenses(p.lenses)) is not None]
    told = "as its factory says" if factory else "nothing says how they are rolled: taken for upright"
    rolled = [sum(lens.roll_deg for lens in pair) for pair in factory]
    roll = 90 * round(float(np.median(rolled)) / 90) if rolled else 0
    measured = [_factory_camera(factory, k, (width, height), circles[k], tuning) for k in range(len(NAMES))]
    sensors = []
    for k, name in enumerate(NAMES):
        x, y, radius = (float(v) for v in circles[k] - (k * width, 0, 0))
        focal = radius / np.radians(across_deg / 2)
        share = tuning.lens_views.factory_sigma if all(measured) else tuning.lens_views.nominal_sigma
        params = measured[k] if all(measured) else (focal, focal, x, y, 0.0, 0.0, 0.0, 0.0)
        sensors.append(
            SensorSpec(
                name=name,
                folder=name,
                body_from_sensor=rigid(orient(180.0 * k, 0, roll * k), np.zeros(3)),
                model="OPENCV_FISHEYE",
                size=(width, height),
                params=params,
                camera_sigma_px=share * params[0],
                part=k,
            )
        )
    seen = f"each taken to see {across_deg:g} degrees across its circle"
    if all(measured):
        seen = "their distortion starts from what the factory measured, which fits the circles of the pictures"
    elif any(lens.sphere for pair in factory for lens in pair):
        seen += ", for what the factory measured does not fit the circles of these pictures: are they cropped?"
    report.notes.append(f"two lenses back to back, {told}; {seen}")
    return RigSpec("360", tuple(sensors), nominal=True, synchronised=True, body_is_reference=True)


def _factory_camera(
    factory: Sequence[tuple[FactoryLens, FactoryLens]], number: int, size: tuple[int, int], circle: np.ndarray,
    tuning: Tuning,
) -> tuple[float, ...]:  # fmt: skip
    """Parameters of OPENCV_FISHEYE as the factory of most of the files' cameras measured them; () where nothing is
    told, or where it does not fit the circle (3,) that the lens lights in half a file of a size."""
    told = Counter(pair for pair in factory if pair[number].sphere)
    if not told:
        return ()
    lens = told.most_common(1)[0][0][number]
    with np.errstate(all="ignore"):
        params = lens.opencv_fisheye(number, size[0])
        scale = size[0] * len(NAMES) / lens.size[0]
        first, last = scale * lens.radius_px(np.radians(tuning.lens_views.factory_edge_deg))
    if not np.isfinite(params).all() or not len(params):
        return ()
    x, y, radius = circle - (number * size[0], 0, 0)
    near = np.hypot(params[2] - x, params[3] - y) <= tuning.lens_views.factory_off * radius
    if not (near and first <= radius <= last):
        return ()
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=size[0], height=size[1], params=params)
    return () if lens_fault(camera, tuning.rig.camera) else params


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
