"""Files with a whole shot each: equirectangular panoramas, and the circles of two fisheye lenses side by side.

A panorama becomes one frame of a rig of pinhole views that share its centre.

Two circles in a file, as 360 cameras write them, become a frame of two lenses. Insta360's .insp is such a JPEG. The
factory's calibration of the lenses follows the picture (``recording.insta360``): their rolls, because both are mounted
sideways in most cameras, and then the second is not rotated about its own vertical but about the first one's
horizontal; and in newer cameras their distortion, an initial value if it fits the circles of the pictures.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePosixPath

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import ImageFiles, Report, Shot, Survey, Usable
from tiegraph.scan.folders import guess_layout
from tiegraph.scan.recording.insta360 import FactoryLens, factory_lenses
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import RigSpec, SensorSpec, orient, preset_sizes
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PanoramaTuning, Tuning
from tiegraph.scene.images import Probe
from tiegraph.scene.wideviews import seen
from tiegraph.text import some

PRESET = "panorama"


def _order(survey: Survey) -> str:
    """The order of the files, for people."""
    passes = len({s.sequence for s in survey.shots})
    return "in no order" if survey.loose else f"in the order of their names, {passes} pass(es)"


def perspective_views(
    usable: Usable, rig: str | None, settings: ScanSettings, report: Report, tuning: Tuning
) -> tuple[Survey, ImageFiles] | None:
    """Views of a survey of panoramas, and their owners; None if it is none.

    Panoramas are detected if no rig is given and most images are some; the rig ``panorama`` states it. Raises
    InputError if none of the images is twice as wide as high although the user states panoramas.
    """
    said = (rig or "").strip().lower() == PRESET
    full = [p.sphere is not None and (said or p.sphere.sure) for p in usable.probes]
    if said and not any(full):
        sizes = some(f"{w} x {h}" for w, h in sorted({p.upright_size() for p in usable.probes}))
        raise InputError(
            f"--rig {PRESET}: no image is twice as wide as high ({sizes}), as equirectangular panoramas are, or "
            "has tags that say which part of one it is (GPano)"
        )
    if not said and (rig is not None or 2 * sum(full) <= len(full)):
        if any(full):
            report.notes.append(f"{sum(full)} images look like panoramas; --rig {PRESET} reads them as such")
        return None
    could = [p.sphere is not None for p in usable.probes]
    kept = of_one_kind(usable, full, could, "not a panorama, as most images here are", report)
    return _views(kept, settings, report, tuning)


def of_one_kind(
    usable: Usable, surely: Sequence[bool], could: Sequence[bool], otherwise: str, report: Report
) -> Usable:
    """The images that are ``surely`` of a kind, and those of their sizes that ``could`` be: images taken in the dark do
    not show it. The report gets the others, with the reason ``otherwise``."""
    sizes_px = {(p.width, p.height) for p, sure in zip(usable.probes, surely) if sure}
    kept = [k for k, p in enumerate(usable.probes) if could[k] and (p.width, p.height) in sizes_px]
    report.drop([n for k, n in enumerate(usable.names) if k not in set(kept)], otherwise)
    names, probes = tuple(usable.names[k] for k in kept), tuple(usable.probes[k] for k in kept)
    return replace(usable, images=tuple(usable.images[k] for k in kept), names=names, probes=probes)


def _views(usable: Usable, settings: ScanSettings, report: Report, tuning: Tuning) -> tuple[Survey, ImageFiles]:
    spheres = [p.sphere for p in usable.probes if p.sphere is not None]
    width = sorted(s.width for s in spheres)[len(spheres) // 2]
    spec = panorama_rig(width, tuning.panorama)
    survey, images = share_files(usable, spec, settings, tuning)
    columns, rows = spec.sensors[0].size or (0, 0)
    cameras = [pycolmap.Camera(model=s.model, width=columns, height=rows, params=s.params) for s in spec.sensors]
    turns = [np.reshape(s.view_of_panorama, (3, 3)) for s in spec.sensors]
    of = {s.image: (images.probes[s.image].sphere, s.sensor) for s in survey.shots}
    share = {k: seen(sphere, cameras[view], turns[view]) for k, (sphere, view) in of.items() if sphere is not None}
    shots = tuple(s for s in survey.shots if share[s.image] > 0)
    level, parts = len(spec.sensors) - 1, sum(s.part for s in spheres)
    report.notes.append(
        f"{len(usable.names)} equirectangular panoramas, {width} x {width // 2} pixels: each unfolded into {level} "
        f"level views and one up, of {columns} x {rows} pixels: a calibrated rig without a base; {_order(survey)}"
    )
    if parts:
        report.notes.append(
            f"{parts} of the panoramas are parts of a sphere, by their tags (GPano) or because the rest is black: the "
            f"missing part is masked, and {len(survey.shots) - len(shots)} views that see nothing are left out"
        )
    # The mask of a view is the transparency of its file.
    names = [n if share[k] == 1 else str(PurePosixPath(n).with_suffix(".png")) for k, n in enumerate(images.names)]
    probes = [
        replace(p, width=columns, height=rows, exif=replace(p.exif, focal_px=float("nan"), orientation=1))
        for p in images.probes
    ]
    return replace(survey, shots=shots), replace(images, names=names, probes=probes)


def share_files(usable: Usable, spec: RigSpec, settings: ScanSettings, tuning: Tuning) -> tuple[Survey, ImageFiles]:
    """The images of a rig's sensors from each file, named like it in a folder of the sensor's name, with the
    probes of the files."""
    kind = "sequence" if settings.layout == "auto" else settings.layout
    exif, sizes = usable.facts()
    layout = guess_layout(usable.names, exif, sizes, kind, tuning.folders)
    views: list[str] = []
    shots: list[Shot] = []
    for name, place in zip(usable.names, layout.places):
        path = PurePosixPath(name)
        sequence = "" if layout.order.loose or place is None else place.sequence
        for k, sensor in enumerate(spec.sensors):
            shots.append(Shot(image=len(views), rig=0, sensor=k, sequence=sequence, stem=path.stem))
            views.append(str(path.parent / sensor.name / path.name))
    each = len(spec.sensors)
    probes, files = [p for p in usable.probes for _ in range(each)], [n for n in usable.names for _ in range(each)]
    return Survey((spec,), tuple(shots), layout.order.loose), ImageFiles(views, probes, files)


def panorama_rig(width_px: int, tuning: PanoramaTuning) -> RigSpec:
    """The rig of pinhole views into which a panorama of a width is unfolded, at the resolution of its horizon."""
    focal = width_px / (2 * np.pi)
    width, height = (2 * round(focal * np.tan(np.radians(v) / 2)) for v in (tuning.hfov_deg, tuning.vfov_deg))
    around = tuning.around
    poses = [orient(360.0 / around * k, 0, 0) for k in range(around)] + [orient(0, 90, 0)]
    sensors = tuple(
        SensorSpec(
            name=f"view{k}",
            folder=f"view{k}",
            role="up" if k == around else "side",
            body_from_sensor=rigid(pose, np.zeros(3)),
            model="SIMPLE_PINHOLE",
            size=(width, height),
            params=(focal, width / 2, height / 2),
            view_of_panorama=tuple(pose.T.ravel().tolist()),
        )
        for k, pose in enumerate(poses)
    )
    return RigSpec(PRESET, sensors, fixed=True, body_is_reference=True)


NAMES = ("lens0", "lens1")


def two_lenses(
    usable: Usable, rig: str | None, text: str | None, settings: ScanSettings, report: Report, tuning: Tuning
) -> tuple[Survey, ImageFiles] | None:
    """The lenses' images of a survey whose files hold two circles each; None if it is none.

    ``rig``: a file with two sensors, the left circle's first, cameras and sizes those of half a file; ``text``: of a
    rig.toml that comes from ``rig``, a run folder. Without, they are back to back with a usual field of view. Raises
    InputError for another rig.
    """
    if (rig or "").strip().lower() == PRESET:  # the user states panoramas
        return None
    both = [len(p.circles) == len(NAMES) and p.exif.orientation <= 1 for p in usable.probes]
    if 2 * sum(both) <= len(both):
        return None
    kept = of_one_kind(usable, both, [True] * len(both), "not two fisheye images, as most files here are", report)
    spec = _nominal(kept.probes, report, tuning) if rig is None else _given(rig, text, tuning)
    survey, images = share_files(kept, spec, settings, tuning)
    halves = [_half(p, s.sensor) for p, s in zip(images.probes, survey.shots)]
    jpeg = [n if PurePosixPath(n).suffix.lower() != ".insp" else f"{n[:-5]}.jpg" for n in images.names]
    report.notes.append(f"{len(kept.names)} files with the images of two fisheye lenses side by side; {_order(survey)}")
    return survey, replace(images, names=jpeg, probes=halves)


def _half(probe: Probe, part: int) -> Probe:
    """The probe of half a file."""
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
    told = "rolled by the factory's values" if factory else "their rolls are unknown: taken as upright"
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
    seen = f"each with an assumed field of view of {across_deg:g} degrees across its circle"
    if all(measured):
        seen = "their initial distortion is the factory's, which fits the circles of the pictures"
    elif any(lens.sphere for pair in factory for lens in pair):
        seen += ", because the factory's values do not fit the circles of these pictures: are they cropped?"
    report.notes.append(f"two lenses back to back, {told}; {seen}")
    return RigSpec("360", tuple(sensors), nominal=True, synchronised=True, body_is_reference=True)


def _factory_camera(
    factory: Sequence[tuple[FactoryLens, FactoryLens]], number: int, size: tuple[int, int], circle: np.ndarray,
    tuning: Tuning,
) -> tuple[float, ...]:  # fmt: skip
    """Parameters of OPENCV_FISHEYE by the factory of most of the files' cameras."""
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
    specs = read_rig_file(rig, tuning.rig, text)
    count = sum(len(s.sensors) for s in specs)
    if len(specs) != 1 or count != len(NAMES):
        raise InputError(
            f"--rig {rig}: {count} sensor(s), but the files hold two fisheye images each: give two sensors, that of "
            "the left circle first, with the cameras of half a file"
        )
    one, other = (replace(s, folder=s.name, part=k) for k, s in enumerate(specs[0].sensors))
    if one.body_from_sensor is None:
        one = replace(one, body_from_sensor=np.eye(4))
    return replace(specs[0], sensors=(one, other), synchronised=True)
