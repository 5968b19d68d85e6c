"""The scan stage: from a folder of images and further files to a Scene."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.scan.assign import ImageFiles, Shot, Survey, assign, into_frames
from tiegraph.scan.cameras import FileFacts, calibrate, with_camera, with_start_cameras
from tiegraph.scan.folders import natural
from tiegraph.scan.prepare import KEPT_SUFFIXES, Report, need_two, prepare_image, usable_images, zoomed
from tiegraph.scan.priors.positions import Frames
from tiegraph.scan.priors.priors import Followed, estimate_priors
from tiegraph.scan.priors.startmodel import StartModel, must_be_whole
from tiegraph.scan.priors.times import FrameRow
from tiegraph.scan.rigfiles.rigspec import RigSpec
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import CameraTuning, Tuning
from tiegraph.scan.views import into_views, perspective_views, two_lenses, with_lit_circle
from tiegraph.scene.composed import wide_first
from tiegraph.scene.decoding import EIGHT_BIT
from tiegraph.scene.images import IMAGES_FOLDER, Probe, find_images, probe_image
from tiegraph.scene.names import clean, shortened
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene
from tiegraph.text import some

__all__ = ["Probe", "ScanInputs", "build_scene", "find_images", "prepare_image", "probe_image"]


@dataclass(frozen=True)
class ScanInputs:
    """The user's inputs: the folder of images, and optional rig (file or preset; ``rig_text``: of a rig.toml that
    replaces it), camera (in words or a file), GNSS, trajectory (a file, or odometry) or a start model, and
    times."""

    images: Path
    rig: str | None = None
    camera: str | None = None
    gnss: Path | None = None
    trajectory: Path | Followed | None = None
    start: StartModel | None = None
    times: Path | None = None
    rig_text: str | None = None
    video: bool = False  # the images are pictures of videos, or of bags
    cameras: StartModel | None = None  # those of bags, without poses

    def tells_order(self) -> bool:
        """Whether the time of each image is known, so that its neighbours are those in time."""
        return self.video or isinstance(self.trajectory, Path) or self.times is not None


def build_scene(
    inputs: ScanInputs, names: Sequence[str], probes: Sequence[Probe], settings: ScanSettings, tuning: Tuning
) -> Scene:
    """The scene of a survey from its images' names (as of ``find_images``) and probes (parallel).

    Images that cannot be used go to ``Scene.dropped``. Raises InputError for fewer than two usable images and for
    GNSS, trajectory and times files that are wrong or do not fit.
    """
    report, probes = Report(), zoomed(probes)
    if Path(inputs.images, IMAGES_FOLDER).is_dir():
        report.notes.append(f"only the folder {IMAGES_FOLDER}/ was searched for images")
    usable = replace(usable_images(names, probes, report), video=inputs.video)
    # Rig, sensor and pass of the images, or of the views that panoramas and double fisheyes are cut into
    cut = two_lenses(usable, inputs.rig, inputs.rig_text, settings, report, tuning.rig)
    cut = cut or perspective_views(usable, inputs.rig, settings, report)
    if cut is None:
        survey = assign(inputs.rig, usable, settings, report, tuning, inputs.rig_text)
        pictures = ImageFiles(names, probes, names)
    else:
        survey, pictures = cut
    survey = _one_size(survey, pictures.names, pictures.probes, report)
    survey = into_frames(survey, pictures.files, settings.frames, report)
    need_two(len(survey.shots), report)
    sizes = {k: _facts(shots, pictures.probes, survey.loose).size for k, shots in _sensors(survey).items()}
    survey = with_camera(survey, sizes, inputs.camera, report.notes)
    if inputs.start is not None:
        must_be_whole(inputs.start, cut is None)
    for start in filter(None, (inputs.start, inputs.cameras if cut is None else None)):
        survey = with_start_cameras(survey, sizes, start, report.notes, pictures.names)
    rigs, survey = _rigs(survey, pictures.probes, settings, report, tuning.rig.camera)
    rigs, survey, views = into_views(rigs, survey, pictures, settings, report)
    if inputs.start is not None:
        must_be_whole(inputs.start, views.names is pictures.names)
    return _scene(inputs, views, rigs, survey, settings, report)


def _sensors(survey: Survey) -> dict[tuple[int, int], list[Shot]]:
    groups: dict[tuple[int, int], list[Shot]] = {}
    for shot in survey.shots:
        groups.setdefault((shot.rig, shot.sensor), []).append(shot)
    return dict(sorted(groups.items()))


def _upright(shots: Sequence[Shot], probes: Sequence[Probe], loose: bool) -> bool:
    # A mounted camera has one calibration: if its EXIF orientations differ (they come from gravity), keep its own rows.
    return loose or len({probes[s.image].exif.orientation for s in shots}) == 1


def _size(probe: Probe, upright: bool) -> tuple[int, int]:
    return probe.upright_size() if upright else (probe.width, probe.height)


def _one_size(survey: Survey, names: Sequence[str], probes: Sequence[Probe], report: Report) -> Survey:
    kept: list[Shot] = []
    for (rig, sensor), shots in _sensors(survey).items():
        upright = _upright(shots, probes, survey.loose)
        name = survey.specs[rig].sensors[sensor].name
        if not upright:
            report.notes.append(f"{name}: images with different EXIF orientations are kept as the sensor wrote them")
        sizes = [_size(probes[s.image], upright) for s in shots]
        usual = Counter(sizes).most_common(1)[0][0]
        for shot, size in zip(shots, sizes):
            if size == usual:
                kept.append(shot)
            else:
                reason = f"{size[0]} x {size[1]} pixels, but most images of {name} have {usual[0]} x {usual[1]}"
                report.drop([names[shot.image]], reason)
    return replace(survey, shots=tuple(sorted(kept, key=lambda s: s.image)))


def _rigs(
    survey: Survey, probes: Sequence[Probe], settings: ScanSettings, report: Report, tuning: CameraTuning
) -> tuple[tuple[Rig, ...], Survey]:
    groups = _sensors(survey)
    hows: dict[str, list[str]] = {}
    rigs: list[Rig] = []
    renumber: dict[tuple[int, int], tuple[int, int]] = {}
    for r, spec in enumerate(survey.specs):
        present = [k for k in wide_first([s.role for s in spec.sensors]) if (r, k) in groups]
        if not present:
            continue
        sensors: list[Sensor] = []
        for k in present:
            sensor = spec.sensors[k]
            renumber[r, k] = len(rigs), len(sensors)
            facts = _facts(groups[r, k], probes, survey.loose)
            camera, source, how = calibrate(sensor, facts, spec.file, settings, tuning)
            hows.setdefault(how, []).append(sensor.name)
            made = Sensor(
                name=sensor.name,
                camera=camera,
                sensor_from_rig=_sensor_from_rig(spec, k, present[0]),
                role=sensor.role,
                folder=sensor.folder or "",
                source=source,
                sigma_deg=sensor.sigma_deg,
                sigma_m=sensor.sigma_m,
                camera_sigma_px=sensor.camera_sigma_px,
            )
            sensors.append(with_lit_circle(made, [probes[s.image] for s in groups[r, k]]))
        rigs.append(
            Rig(
                name=spec.name,
                sensors=tuple(sensors),
                fixed=spec.fixed,
                nominal=spec.nominal,
                antenna_m=_antenna(spec, present[0]),
                pairs=tuple(p for p in spec.pairs if set(p.sensors) <= {s.name for s in sensors}),
                synchronised=spec.synchronised,
            )
        )
    report.notes += [f"{some(names)}: {how}" for how, names in hows.items()]
    shots = tuple(
        replace(s, rig=renumber[s.rig, s.sensor][0], sensor=renumber[s.rig, s.sensor][1]) for s in survey.shots
    )
    kept = tuple(spec for r, spec in enumerate(survey.specs) if any(key[0] == r for key in groups))
    return tuple(rigs), replace(survey, specs=kept, shots=shots)


def _facts(shots: list[Shot], probes: Sequence[Probe], loose: bool) -> FileFacts:
    upright = _upright(shots, probes, loose)
    of = [probes[s.image] for s in shots]
    focal = [p.exif.focal_px for p in of if np.isfinite(p.exif.focal_px)]
    deep = [p.levels for p in of if p.levels != EIGHT_BIT]
    radii = [p.circles[0][2] for p in of if len(p.circles) == 1]
    return FileFacts(
        size=_size(of[0], upright),
        focal_px=float(np.median(focal)) if focal else float("nan"),
        upright=upright,
        levels=(min(low for low, _ in deep), max(high for _, high in deep)) if deep else EIGHT_BIT,
        loose=loose,
        radius_px=float(np.median(radii)) if 2 * len(radii) > len(of) else float("nan"),
    )


def _sensor_from_rig(spec: RigSpec, sensor: int, reference: int) -> np.ndarray | None:
    if sensor == reference:
        return np.eye(4)
    mine, first = spec.sensors[sensor].body_from_sensor, spec.sensors[reference].body_from_sensor
    return None if mine is None or first is None else np.linalg.inv(mine) @ first


def _antenna(spec: RigSpec, reference: int) -> tuple[float, float, float] | None:
    pose = spec.sensors[reference].body_from_sensor
    if spec.antenna_m is None or pose is None:
        return None
    return tuple((np.linalg.inv(pose) @ [*spec.antenna_m, 1.0])[:3].tolist())


def _scene(
    inputs: ScanInputs, pictures: ImageFiles, rigs: tuple[Rig, ...], survey: Survey, settings: ScanSettings,
    report: Report,
) -> Scene:  # fmt: skip
    given = [pictures.names[s.image] for s in survey.shots]
    safe = safe_names(given)
    order = sorted(range(len(safe)), key=lambda k: safe[k])
    shots, names = [survey.shots[k] for k in order], tuple(safe[k] for k in order)
    sources = tuple(pictures.files[s.image] for s in shots)
    exif = tuple(pictures.probes[s.image].exif for s in shots)
    sequences = tuple(sorted({s.sequence for s in shots} - {""}, key=natural))
    rows = _frame_rows(shots, sequences)
    sensors = tuple(s.sensor for s in shots)
    frames = Frames(
        rows=rows, sequences=sequences, names=sources, exif=exif, rigs=rigs, specs=survey.specs, sensors=sensors
    )
    priors = estimate_priors(frames, inputs.gnss, inputs.start or inputs.trajectory, inputs.times, settings)
    rows, priors_order = _in_time_order(rows, priors.time_s, report)
    if missing := sum(len(r.images) < len(rigs[r.rig].sensors) for r in rows):
        report.notes.append(f"{missing} of {len(rows)} frames lack the image of some camera")
    frame, steps, seen = np.zeros(len(shots), int), [], Counter[int]()
    for k, row in enumerate(rows):
        frame[list(row.images)] = k
        steps.append(seen[row.sequence])
        seen[row.sequence] += 1
    if renamed := sum(a != b for a, b in zip(given, safe)):
        report.notes.append(f"{renamed} images renamed (blanks, #, long names or formats that COLMAP does not take)")
    exposure = np.array([e.exposure for e in exif], float)
    return Scene(
        rigs=rigs,
        names=names,
        frame=frame,
        sensor=np.array([s.sensor for s in shots]),
        rig=np.array([r.rig for r in rows]),
        sequence=np.array([r.sequence for r in rows]),
        sequence_index=np.array(steps, int),
        time_s=priors.time_s[priors_order],
        world_from_rig=priors.world_from_rig[priors_order],
        position_sigma_m=priors.position_sigma_m[priors_order],
        section=np.full(len(rows), -1),
        sequences=sequences,
        origin=priors.origin,
        prior=priors.prior,
        started=priors.started,
        dropped=tuple(sorted(report.dropped, key=lambda d: d.name)),
        notes=(*report.notes, *priors.notes),
        guessed=sequences if survey.guessed and not inputs.tells_order() else (),
        sources=() if names == sources else sources,
        exposure=exposure if np.isfinite(exposure).any() else None,
    )


def safe_names(names: Sequence[str]) -> list[str]:
    """Names that COLMAP's pair lists and readers take: no blanks, no #, a suffix of both libraries, only printable
    characters, no part too long for file systems with the additions of the stages; unique."""
    taken: set[str] = set(names)
    out = []
    for name in names:
        safe = clean(re.sub(r"[\s#\\]", "_", name))
        suffix = PurePosixPath(safe).suffix
        if suffix.lower() not in KEPT_SUFFIXES:
            safe = safe[: -len(suffix)] + ".png"
        safe = "/".join(map(shortened, safe.split("/")))
        base, number = safe, 2
        while safe != name and safe in taken:
            path = PurePosixPath(base)
            safe = str(path.with_name(f"{path.stem}_{number}{path.suffix}"))
            number += 1
        taken.add(safe)
        out.append(safe)
    return out


def _frame_rows(shots: Sequence[Shot], sequences: tuple[str, ...]) -> tuple[FrameRow, ...]:
    frames: dict[tuple[int, int, str], list[int]] = {}
    for k, shot in enumerate(shots):
        sequence = sequences.index(shot.sequence) if shot.sequence else -1
        frames.setdefault((sequence, shot.rig, shot.key), []).append(k)
    ordered = sorted(frames, key=lambda f: (f[0], natural(f[2]), f[1]))
    return tuple(
        FrameRow(
            rig=rig,
            sequence=sequence,
            key=key,
            images=tuple(sorted(frames[sequence, rig, key], key=lambda k: shots[k].sensor)),
        )
        for sequence, rig, key in ordered
    )


def _in_time_order(
    rows: tuple[FrameRow, ...], time_s: np.ndarray, report: Report
) -> tuple[tuple[FrameRow, ...], np.ndarray]:
    """Frames of each pass by time if all times are known and contradict the names; else unchanged."""
    order = np.arange(len(rows))
    for sequence in sorted({r.sequence for r in rows} - {-1}):
        mine = np.array([k for k, r in enumerate(rows) if r.sequence == sequence])
        times = time_s[mine]
        if np.isfinite(times).all() and np.any(np.diff(times) < 0):
            order[mine] = mine[np.argsort(times, kind="stable")]
            report.notes.append("frames of a pass are ordered by time; their names are in another order")
    return tuple(rows[k] for k in order), order
