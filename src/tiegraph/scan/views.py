"""Files that become several images: panoramas, two fisheye images side by side, and wide fisheye images cut into views.

A panorama becomes one frame of a rig of pinhole views that share its centre.

Two circles in a file, as 360 cameras write them, become a frame of two lenses. Insta360's .insp is such a JPEG. The
factory's calibration of the lenses follows the picture (``telemetry``): their rolls, because both are mounted
sideways in most cameras, and then the second is not rotated about its own vertical but about the first one's
horizontal; and in newer cameras their distortion, an initial value if it fits the circles of the pictures.

Images of wide fisheye lenses are cut into pinhole views, a rig with one centre. COLMAP verifies and registers in the
plane before the camera, where an error of a pixel 75 degrees off the axis counts 15 times, and beyond 90 degrees there
is no such plane: the outer half of a 200 degree fisheye has hardly any ties.

Two lenses back to back are a 360 camera: its level views point in all directions, as those of a panorama, because the
carrier is below. One lens is rotated against the other about the camera's vertical, so their relative rotation gives
the camera's position in their images. A lens without such a partner is cut into views around its axis.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePosixPath

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.assign import ImageFiles, Shot, Survey
from tiegraph.scan.folders import guess_layout
from tiegraph.scan.prepare import Report, Usable
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import CIRCLE_DEG, START_FOCAL, RigSpec, SensorSpec, orient, preset_sizes
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.telemetry import FactoryLens, factory_lenses
from tiegraph.scan.tuning import FoldersTuning, RigTuning
from tiegraph.scene.images import Probe
from tiegraph.scene.rig import LensView, Rig, Sensor, Source
from tiegraph.scene.wideviews import is_fisheye, seen, seen_half_deg
from tiegraph.text import some

PRESET = "panorama"
NAMES = ("lens0", "lens1")
_FRONT = "front"
# Like the side cameras of a Ladybug, for the same offsets and sections as such a rig; and one up
_AROUND = 5  # level views of a panorama
_HFOV_DEG = (
    80.0  # of a view: 8 degrees more than a fifth of the circle, so that features at the edges have surroundings
)
_VFOV_DEG = 90.0  # likewise, and width and height of a view of a single fisheye lens
_REACH_DEG = 88.0  # off the axis in views of a lens: at 90 COLMAP's lenses end, and the last pixels would be black
_WIDER_DEG = 150.0  # a lens that sees more is cut into views: at its rim a pixel counts 15 times and more in a plane
_MOST_SIGMA = 0.0075  # relative sigma of the focal length of a lens that is cut into views: they hold it fixed


def _order(survey: Survey) -> str:
    passes = len({s.sequence for s in survey.shots})
    return "in no order" if survey.loose else f"in the order of their names, {passes} pass(es)"


def perspective_views(
    usable: Usable, rig: str | None, settings: ScanSettings, report: Report
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
    spheres = [p.sphere for p in kept.probes if p.sphere is not None]
    width = sorted(s.width for s in spheres)[len(spheres) // 2]
    spec = panorama_rig(width)
    survey, images = share_files(kept, spec, settings)
    columns, rows = spec.sensors[0].size or (0, 0)
    cameras = [pycolmap.Camera(model=s.model, width=columns, height=rows, params=s.params) for s in spec.sensors]
    turns = [np.reshape(s.view_of_panorama, (3, 3)) for s in spec.sensors]
    of = ((s.image, images.probes[s.image].sphere, s.sensor) for s in survey.shots)
    share = {k: seen(sphere, cameras[view], turns[view]) for k, sphere, view in of if sphere is not None}
    shots = tuple(s for s in survey.shots if share[s.image] > 0)
    parts = sum(s.part for s in spheres)
    report.notes.append(
        f"{len(kept.names)} equirectangular panoramas, {width} x {width // 2} pixels: each unfolded into "
        f"{len(turns) - 1} level views and one up, of {columns} x {rows} pixels: a calibrated rig without a base; "
        f"{_order(survey)}"
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


def share_files(usable: Usable, spec: RigSpec, settings: ScanSettings) -> tuple[Survey, ImageFiles]:
    """The images of a rig's sensors from each file, named like it in a folder of the sensor's name, with the
    probes of the files."""
    kind = "sequence" if settings.layout == "auto" else settings.layout
    exif, sizes = usable.facts()
    layout = guess_layout(usable.names, exif, sizes, kind, FoldersTuning())
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


def panorama_rig(width_px: int) -> RigSpec:
    """The rig of pinhole views into which a panorama of a width is unfolded, at the resolution of its horizon."""
    focal = width_px / (2 * np.pi)
    width, height = (2 * round(focal * np.tan(np.radians(v) / 2)) for v in (_HFOV_DEG, _VFOV_DEG))
    poses = [orient(360.0 / _AROUND * k, 0, 0) for k in range(_AROUND)] + [orient(0, 90, 0)]
    sensors = tuple(
        SensorSpec(
            name=f"view{k}",
            folder=f"view{k}",
            role="up" if k == _AROUND else "side",
            body_from_sensor=rigid(pose, np.zeros(3)),
            model="SIMPLE_PINHOLE",
            size=(width, height),
            params=(focal, width / 2, height / 2),
            view_of_panorama=tuple(pose.T.ravel().tolist()),
        )
        for k, pose in enumerate(poses)
    )
    return RigSpec(PRESET, sensors, fixed=True, body_is_reference=True)


def two_lenses(
    usable: Usable, rig: str | None, text: str | None, settings: ScanSettings, report: Report, tuning: RigTuning
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
    spec = _nominal(kept.probes, report) if rig is None else _given(rig, text, tuning)
    survey, images = share_files(kept, spec, settings)
    halves = []
    for probe, part in ((p, s.sensor) for p, s in zip(images.probes, survey.shots)):
        width = probe.width // len(NAMES)
        circles = tuple((x - part * width, y, radius) for x, y, radius in probe.circles[part : part + 1])
        exif = replace(probe.exif, focal_px=float("nan"))
        halves.append(replace(probe, width=width, exif=exif, circles=circles))
    jpeg = [n if PurePosixPath(n).suffix.lower() != ".insp" else f"{n[:-5]}.jpg" for n in images.names]
    report.notes.append(f"{len(kept.names)} files with the images of two fisheye lenses side by side; {_order(survey)}")
    return survey, replace(images, names=jpeg, probes=halves)


def _nominal(probes: Sequence[Probe], report: Report) -> RigSpec:
    found = [p for p in probes if len(p.circles) == len(NAMES)]
    circles = np.median([p.circles for p in found], axis=0)  # (2, 3)
    width, height = found[0].width // len(NAMES), found[0].height
    factory = [pair for p in found if (pair := factory_lenses(p.lenses)) is not None]
    told = "rolled by the factory's values" if factory else "their rolls are unknown: taken as upright"
    rolled = [sum(lens.roll_deg for lens in pair) for pair in factory]
    roll = 90 * round(float(np.median(rolled)) / 90) if rolled else 0
    measured = [_factory_camera(factory, k, (width, height), circles[k]) for k in range(len(NAMES))]
    sensors = []
    for k, name in enumerate(NAMES):
        x, y, radius = (float(v) for v in circles[k] - (k * width, 0, 0))
        focal = radius / np.radians(CIRCLE_DEG / 2)
        share = START_FOCAL if all(measured) else 0.05
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
    seen = f"each with an assumed field of view of {CIRCLE_DEG:g} degrees across its circle"
    if all(measured):
        seen = "their initial distortion is the factory's, which fits the circles of the pictures"
    elif any(lens.sphere for pair in factory for lens in pair):
        seen += ", because the factory's values do not fit the circles of these pictures: are they cropped?"
    report.notes.append(f"two lenses back to back, {told}; {seen}")
    return RigSpec("360", tuple(sensors), nominal=True, synchronised=True, body_is_reference=True)


def _factory_camera(
    factory: Sequence[tuple[FactoryLens, FactoryLens]], number: int, size: tuple[int, int], circle: np.ndarray
) -> tuple[float, ...]:
    """Parameters of OPENCV_FISHEYE by the factory of most of the files' cameras."""
    told = Counter(pair for pair in factory if pair[number].sphere)
    if not told:
        return ()
    lens = told.most_common(1)[0][0][number]
    with np.errstate(all="ignore"):
        params = lens.opencv_fisheye(number, size[0])
        scale = size[0] * len(NAMES) / lens.size[0]
        first, last = scale * lens.radius_px(np.radians([90.0, 106.0]))  # lenses see 95 to 102 degrees off the axis
    x, y, radius = circle - (number * size[0], 0, 0)
    if not len(params) or not np.hypot(params[2] - x, params[3] - y) <= 0.02 * radius or not first <= radius <= last:
        return ()
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=size[0], height=size[1], params=params)
    return () if lens_fault(camera) else params


def _given(rig: str, text: str | None, tuning: RigTuning) -> RigSpec:
    if text is None and preset_sizes(rig, tuning):
        raise InputError(
            f"--rig {rig}: the files hold two fisheye images each: give a rig file with two sensors, or none"
        )
    specs = read_rig_file(rig, tuning, text)
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


def with_lit_circle(sensor: Sensor, probes: Sequence[Probe]) -> Sensor:
    """A sensor with the circle that its fisheye lens lights, without the blurred rim, if most of its images have one.

    The median over the images of those circles whose centre remains after cropping.
    """
    if not is_fisheye(sensor.camera):
        return sensor
    source = sensor.source or Source(camera=sensor.camera)
    left, top, right, bottom = source.crop_px
    found = []
    for probe in (p for p in probes if p.exif.orientation <= 1 or not source.upright):
        inside = [c for c in probe.circles if left < c[0] < probe.width - right and top < c[1] < probe.height - bottom]
        found += inside[:1]
    if 2 * len(found) <= len(probes):
        return sensor
    x, y, radius = (float(v) for v in np.median(found, axis=0))
    return replace(sensor, source=replace(source, circle_px=(x - left, y - top, 0.97 * radius)))


def into_views(
    rigs: tuple[Rig, ...], survey: Survey, pictures: ImageFiles, settings: ScanSettings, report: Report
) -> tuple[tuple[Rig, ...], Survey, ImageFiles]:
    """The survey with views instead of wide fisheye images. Raises InputError if they are requested and impossible."""
    cut = {(r, k): _why_not(s, settings) for r, rig in enumerate(rigs) for k, s in enumerate(rig.sensors)}
    reasons = sorted({why for why in cut.values() if why is not None}, key=lambda why: why == "")
    for why in reasons:
        those = some(rigs[r].sensors[k].name for (r, k), w in cut.items() if w == why)
        if why and settings.fisheye == "views":
            raise InputError(
                f"scan.fisheye = views: {those}: {why}; give its camera in a rig file (that of a run of the "
                "whole images is enough: `tiegraph rig OUT`)"
            )
        report.notes.append(
            f"{those}: fisheye images are used whole, with few ties far off their axis, because {why}; with its "
            "distortion in a rig file (`tiegraph rig OUT` of this run) they are cut into views and used nearly up to 90"
            if why
            else f"{those}: each fisheye image is cut into views up to {_REACH_DEG:g} degrees off its axis"
        )
    if not any(why == "" for why in cut.values()):
        return rigs, survey, pictures
    made: list[Rig] = []
    places: dict[tuple[int, int], list[int]] = {}
    for r, rig in enumerate(rigs):
        sensors: list[Sensor] = []
        for k, sensor in enumerate(rig.sensors):
            views = _lens_views(sensor, *_turns(rig, k)) if cut[r, k] == "" else [sensor]
            places[r, k] = list(range(len(sensors), len(sensors) + len(views)))
            sensors += views
        # A measurement between two lenses also holds between their front views, which have their centres and axes.
        front = {s.name: s.name if s in sensors else f"{s.name}-{_FRONT}" for s in rig.sensors}
        pairs = tuple(replace(p, sensors=(front[p.sensors[0]], front[p.sensors[1]])) for p in rig.pairs)
        # The views of one lens have exact relative poses, so the rig is held if its lenses are; if these are nominal
        # or measured with a sigma, each view has that of its lens.
        held = len(rig.sensors) == 1 or rig.fixed or (rig.known() and not rig.nominal and not rig.soft())
        made.append(replace(rig, sensors=tuple(sensors), pairs=pairs, fixed=held))
    shots: list[Shot] = []
    names: list[str] = []
    for shot in survey.shots:
        for place in places[shot.rig, shot.sensor]:
            sensor = made[shot.rig].sensors[place]
            path = PurePosixPath(pictures.names[shot.image])
            view = sensor.source is not None and sensor.source.view is not None
            shots.append(replace(shot, sensor=place, image=len(names)))
            names.append(str(path.parent / PurePosixPath(sensor.folder).name / path.name) if view else str(path))
    cut_from = [shot.image for shot in survey.shots for _ in places[shot.rig, shot.sensor]]
    made_of = ImageFiles(names, [pictures.probes[k] for k in cut_from], [pictures.files[k] for k in cut_from])
    return tuple(made), replace(survey, shots=tuple(shots)), made_of


def _why_not(sensor: Sensor, settings: ScanSettings) -> str | None:
    """ "" for a sensor whose images are cut into views; a reason against it that users should know; else None."""
    camera = sensor.camera
    if settings.fisheye == "whole" or camera is None or not is_fisheye(camera):
        return None
    if settings.fisheye == "auto" and seen_half_deg(camera) < _WIDER_DEG / 2:
        return None
    bent = bool(np.any(np.asarray(camera.params)[camera.extra_params_idxs()]))
    known = camera.has_prior_focal_length and (bent or settings.fisheye == "views")
    if not known:
        return "its lens is not calibrated"
    rough = (sensor.camera_sigma_px or 0.0) > _MOST_SIGMA * camera.mean_focal_length()
    start = f"its calibration is an initial value (sigma of the focal length above {100 * _MOST_SIGMA:g} %)"
    return start if rough and settings.fisheye == "auto" else ""


def _turns(rig: Rig, sensor: int) -> tuple[dict[str, np.ndarray], tuple[float, float]]:
    """The views of a lens: view_from_lens (3, 3) by name, as far as the reach, and their fields of view, degrees: one
    ahead and four around; of a 360 camera level ones as wide and high as a panorama's, one ahead, two to the sides."""
    upright = _upright(rig, sensor)
    if upright is None:
        off = _REACH_DEG - _VFOV_DEG / 2
        ways = {_FRONT: (0.0, 0.0), "right": (off, 0.0), "left": (-off, 0.0), "up": (0.0, off), "down": (0.0, -off)}
        return {n: orient(*way, 0).T for n, way in ways.items()}, (_VFOV_DEG, _VFOV_DEG)
    off = _REACH_DEG - _HFOV_DEG / 2
    turns = {n: orient(yaw, 0, 0).T @ upright for n, yaw in ((_FRONT, 0.0), ("right", off), ("left", -off))}
    return turns, (_HFOV_DEG, _VFOV_DEG)


def _upright(rig: Rig, sensor: int) -> np.ndarray | None:
    """The rotation (3, 3) about its axis that makes a lens' image upright, none or a quarter, by the lens in the
    opposite direction; None if there is none. The sense of a quarter is unknown."""
    mine = rig.sensors[sensor].sensor_from_rig
    for other in rig.sensors:
        if mine is None or other.sensor_from_rig is None or not is_fisheye(other.camera):
            continue
        turn = Rotation.from_matrix(mine[:3, :3] @ other.sensor_from_rig[:3, :3].T).as_rotvec()
        if mine[2, :3] @ other.sensor_from_rig[2, :3] <= np.cos(np.radians(150.0)):
            return orient(0, 0, 90.0 if abs(turn[0]) > abs(turn[1]) else 0.0)
    return None


def _lens_views(sensor: Sensor, turns: dict[str, np.ndarray], fov_deg: tuple[float, float]) -> list[Sensor]:
    """The views of a lens at the resolution of its middle."""
    lens, source = sensor.camera, sensor.source or Source()
    assert lens is not None
    focal = lens.mean_focal_length()
    width, height = (2 * round(focal * np.tan(np.radians(v / 2))) for v in fov_deg)
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=[focal, width / 2, height / 2])
    camera.has_prior_focal_length = True
    pose = sensor.sensor_from_rig
    return [
        replace(
            sensor,
            name=f"{sensor.name}-{name}",
            folder=str(PurePosixPath(sensor.folder) / name),
            camera=camera,
            camera_sigma_px=None,
            source=replace(source, camera=camera, view=LensView(sensor.name, lens, tuple(turn.ravel().tolist()))),
            sensor_from_rig=None if pose is None else rigid(turn, np.zeros(3)) @ pose,
        )
        for name, turn in turns.items()
    ]
