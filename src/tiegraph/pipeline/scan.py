"""Glue of scan: the user's inputs become a scene and a folder of images."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.odometry.cameras import cameras_of
from tiegraph.pipeline.foundrig import rig_of_run
from tiegraph.pipeline.inputs import check_against, control_file, target_marks
from tiegraph.pipeline.odometry import followed
from tiegraph.project.inputs import FOLLOW
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.project.stores import not_fetched
from tiegraph.scan.cameras import start_cameras
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scan.recording import Recording
from tiegraph.scan.rigfiles.cameraread import FoundCamera
from tiegraph.scan.scan import ScanInputs, build_scene, prepare_image, probe_image
from tiegraph.scan.settings import ScanSettings, video_offsets
from tiegraph.scan.videos import video as film
from tiegraph.scan.videos import videooffset
from tiegraph.scan.videos.bagfilms import BagFilm, bag_films, find_bags, fixes_notes
from tiegraph.scan.videos.videotime import CREATION_APART_S, VideoClock, video_clock
from tiegraph.scene.bags import source_of, split_topics
from tiegraph.scene.composed import carrying
from tiegraph.scene.images import find_images, find_videos, has_images, search_images
from tiegraph.scene.names import clean_names
from tiegraph.scene.rig import Sensor
from tiegraph.scene.scene import Scene
from tiegraph.text import acts, composed


def scan(run: Run) -> Outcome:
    """Open every image once, sort them into rigs, frames and passes, and lay the usable ones below images/."""
    given, settings, tuning = run.inputs, run.settings.scan, run.settings.tuning.scan
    root, said_of_images, cameras = photographs(run)
    files, passed_over = search_images(root)
    names = clean_names(files)  # from here on: only their opening needs the file system's names
    run.reporter.total(2 * len(names))
    probes = run.map(probe_image, [root / f for f in files])
    known = rig_of_run(given.rig)
    inputs = ScanInputs(
        images=root,
        rig=given.rig,
        rig_text=None if known is None else known.text,
        camera=given.camera,
        gnss=given.gnss,
        trajectory=given.poses,
        start=None if given.start is None else read_start(given.start),
        times=given.times,
        video=root != source_of(given.images),
        cameras=start_cameras(root, cameras, names),
    )
    scene = build_scene(inputs, names, probes, settings, tuning)
    carrying(scene)
    told = check_against(run, scene)  # wrong files are better reported now than after hours
    if given.trajectory == FOLLOW:
        cameras_of(scene.rigs)  # so is a rig that cannot be followed
    file_of = dict(zip(names, files))
    todo: dict[str, list[tuple[str, Sensor]]] = {}  # a panorama is read once for all its views
    for k, name in enumerate(scene.names):
        todo.setdefault(file_of[scene.source_name(k)], []).append((name, scene.sensor_of(k)))
    run.map(_prepare_item, todo.items(), root, run.path("images"), settings)
    if given.trajectory == FOLLOW:
        found_path, said = followed(run, scene)
        scene = build_scene(replace(inputs, trajectory=found_path), names, probes, settings, tuning)
        told = (*told, *said)
    file = control_file(run)
    if file is not None:
        told = (*told, *target_marks(run, scene, file, most=run.settings.tuning.targets.looked_at)[1])
    whole, scene = scene, carrying(scene)
    if whole is not scene:
        write_atomic(run.path("whole.json"), whole.to_json())
    write_atomic(run.path("scene.json"), scene.to_json())
    counts = {"found": len(names), "images": len(scene), "frames": scene.frames, "passes": len(scene.sequences)}
    placed = int(np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1).sum())
    hanging = {} if whole is scene else {"hanging": len(whole) - len(scene)}
    return Outcome(
        {**counts, "cameras": len(whole.all_sensors), "positions": placed, **hanging},
        dropped=tuple((d.name, d.reason) for d in scene.dropped),
        notes=(
            *said_of_images,
            *(() if known is None else known.said),
            *_unreadable_names(names, files),
            *passed_over,
            *not_fetched(source_of(given.images)),
            *scene.notes,
            *told,
        ),
    )


def _unreadable_names(names: Sequence[str], files: Sequence[str]) -> list[str]:
    odd = [n for n, f in zip(names, files) if any(map(acts, f))]
    twins = [n for n, f in zip(names, files) if n != composed(f) and n not in odd]
    texts = {
        "have names with control characters or bytes that are not UTF-8 (an archive of another system?): such a "
        "byte is written as %XX here": odd,
        "have the names of others but for the normal form of Unicode (NFC, NFD; copied twice?): numbered here": twins,
    }
    return [f"{len(of)} images {text}, as in {of[0]}" for text, of in texts.items() if of]


def _prepare_item(
    item: tuple[str, list[tuple[str, Sensor]]], source: Path, target: Path, settings: ScanSettings
) -> None:
    found, images = item
    for name, sensor in images:
        if not (target / name).exists():
            prepare_image(source / found, target / name, sensor, settings)


@dataclass(frozen=True)
class _Video:
    """A recording after its first reading, and its start time."""

    recording: Recording
    folder: str
    clock: VideoClock = VideoClock()
    width: int = 0  # 0: cannot be decoded
    height: int = 0
    fps: float = 0.0
    offset_s: float = 0.0  # to be added to its stamps to get those of its rig's first
    camera: FoundCamera | None = None  # from a bag

    @property
    def name(self) -> str:
        return self.recording.name


@dataclass(frozen=True)
class _Job:
    """Pictures to take: the sharpest of each stretch, or those at numbered stamps."""

    video: _Video
    target: Path
    numbers: tuple[int, ...] | None = None
    stamps_s: tuple[float, ...] = ()


def photographs(run: Run) -> tuple[Path, tuple[str, ...], dict[str, FoundCamera]]:
    """The folder of images, the user's own or of the pictures taken from the videos and bags in it; notes on their
    origin; and cameras by the folder below it whose images they took.

    Raises InputError if start times of a rig's videos are undecided, for fewer than two pictures, and as ``bag_films``.
    """
    images, asked = split_topics(run.inputs.images)
    found = [] if asked else find_videos(images)
    bags = find_bags(images)
    if asked and not bags:
        raise InputError(f"{run.inputs.images}: no bag there that could have topics")
    if not found and not bags:
        return images, (), {}
    if has_images(images):
        what = "videos and bags" if bags else "videos"
        note = f"{len(found) + len(bags)} {what} beside the images are left out: give them in a folder of their own"
        return images, (note,), {}
    settings = run.settings.scan
    folder = run.path("images") / ".video"
    items, left_out = _films(found, bags, images, asked)
    if run.inputs.gnss is None:
        left_out += [note for bag in bags for note in fixes_notes(bag)]
    run.reporter.total(2 * len(items))
    videos = run.map(_look, items, settings)
    videos, groups, said = _in_time(run, videos)
    first = [_Job(videos[g[0]], folder / videos[g[0]].folder) for g in groups]
    taken = run.map(_take, first, settings.video_fps)
    others = []
    for video, of_first in ((videos[k], p) for g, p in zip(groups, taken) for k in g[1:]):
        stamps_s = tuple(s - video.offset_s for s in of_first.stamps_s)
        others.append(_Job(video, folder / video.folder, of_first.numbers, stamps_s=stamps_s))
    beside = run.map(_take, others, settings.video_fps)
    notes = [p.said for p in (*taken, *beside)] + said + [_apart(j, p) for j, p in zip(others, beside)]
    if not has_images(folder) or len(find_images(folder)) < 2:
        raise InputError(f"{images}: at least 2 pictures are needed: {'; '.join(notes)}")
    clocks = list(dict.fromkeys(v.clock.note for v in videos if v.width))  # of several tracks, once
    late = _at_once([(videos[g[0]], p) for g, p in zip(groups, taken) if p.stamps_s], CREATION_APART_S)
    said = filter(None, left_out + notes + clocks + _unknown_starts(videos, groups) + late)
    return folder, tuple(said), {v.folder: v.camera for v in videos if v.camera is not None}


def _films(
    videos: Sequence[Path], bags: Sequence[Path], root: Path, asked: Sequence[str]
) -> tuple[list[tuple[Recording, str]], list[str]]:
    """The recordings in videos and bags, each with the folder for its pictures; and notes on topics left out."""
    names = [b.name if b == root else b.relative_to(root).as_posix() for b in (*videos, *bags)]
    folders = film.picture_folders(names)
    items, notes = [r for v, f in zip(videos, folders) for r in film.recordings_of(v, f)], []
    for bag, folder in zip(bags, folders[len(videos) :]):
        films, said = bag_films(bag, folder, asked)
        items += films
        notes += said
    return items, notes


def _at_once(recorded: Sequence[tuple[_Video, film.Pictures]], least_s: float) -> list[str]:
    """A note if recordings of known clocks overlap in time, as chapters do that all have the time of the first."""
    spans = sorted(
        (v.clock.start_s + p.stamps_s[0], v.clock.start_s + p.stamps_s[-1], v.name, v.folder)
        for v, p in recorded
        if v.clock.known
    )
    for (_, end, name, _), (begin, _, later, folder) in zip(spans, spans[1:]):
        if begin < end - least_s:
            return [
                f"{name} and {later} were recorded at the same time by their clocks, for {end - begin:.0f} s: if one "
                f"camera took both, one of them is wrong: --scan.video-offset {folder}=SECONDS"
            ]
    return []


def _unknown_starts(videos: Sequence[_Video], groups: Sequence[tuple[int, ...]]) -> list[str]:
    """A note on several recordings that all count from zero."""
    lost = [videos[g[0]] for g in groups if videos[g[0]].width and not videos[g[0]].clock.known]
    told = [v for v in lost if v.offset_s]
    if len(lost) < 2 or len(told) >= len(lost) - 1:
        return []
    names = " and ".join(v.name for v in lost[:2])
    return [
        f"{len(lost)} videos, such as {names}, each count from their own start: positions by time would put them on "
        f"top of each other; --scan.video-offset {lost[1].folder}=SECONDS gives the start of each, or --times"
    ]


def _look(item: tuple[Recording, str], settings: ScanSettings) -> _Video:
    recording, folder = item
    try:
        film.check_film(recording)
    except OSError:
        return _Video(recording, folder)
    with film.open_film(recording) as opened:
        frame = next(opened.frames(), None)
        if frame is None:
            return _Video(recording, folder)
        height, width = frame[1].shape[:2]
        camera, said = None, ""
        if isinstance(opened, BagFilm):
            clock = opened.clock(video_offsets(settings.video_offset).all_s)
            camera, said = opened.camera((width, height))
        else:
            clock = video_clock(recording.file, settings)
        clock = replace(clock, note="; ".join(filter(None, (clock.note, said))))
        found = _Video(recording, folder, clock, width=width, height=height, fps=opened.fps)
        return replace(found, camera=camera)


def _in_time(run: Run, videos: Sequence[_Video]) -> tuple[list[_Video], list[tuple[int, ...]], list[str]]:
    """The videos with their offsets, those of a rig on the clock of its first, the groups of them, and notes."""
    groups = _groups(run, videos)
    told = videooffset.offsets_given([v.folder for v in videos], run.settings.scan)
    out = [replace(v, offset_s=told.get(k, 0.0)) for k, v in enumerate(videos)]
    lenses = {k for k, v in enumerate(videos) if film.is_of_lens(v.recording)} - told.keys()  # of one recording
    stamped = {  # topics whose stamps are of one clock
        k: videos[k].clock.start_s - videos[g[0]].clock.start_s
        for g in groups
        for k in g[1:]
        if videos[g[0]].clock.shared and videos[k].clock.shared
    }
    asked = {k: g[0] for g in groups for k in g[1:] if k not in told.keys() | lenses | stamped.keys()}
    moving = sorted({*asked, *asked.values()})
    curves = dict(zip(moving, run.map(_curve, [videos[k] for k in moving])))
    pairs = [(curves[first], curves[k]) for k, first in asked.items()]
    offsets = dict(zip(asked, run.map(_offset_of, pairs)))
    notes = []
    for group in groups:
        first = out[group[0]]
        for k in group[1:]:
            how = "the lenses of one recording" if k in lenses else "by --scan.video-offset"
            if k in stamped and k not in told:
                out[k], how = replace(out[k], offset_s=stamped[k]), "by the stamps of their messages"
            if k in asked:
                found = offsets[k]
                if found.refused:
                    raise InputError(
                        f"{out[k].name}: the motion of its pictures does not show when it began after {first.name}, "
                        f"whose rig it is of: {found.refused}. Give --scan.video-offset {out[k].folder}=SECONDS (0 if "
                        "they began together), or --scan.layout sequence if they are passes of one camera"
                    )
                out[k] = replace(out[k], offset_s=found.seconds)
                sigma = f"{1e3 * found.sigma_s:.1f} ms"
                how = f"sigma {sigma}, by the motion of the pictures in the {found.shared_s:.1f} s that both show"
            notes.append(f"{out[k].name} begins {out[k].offset_s:+.4f} s after {first.name} ({how})")
            if k not in lenses:  # the fixes that correct a clock are in the file of one lens only
                by_clock = out[k].clock.start_s - first.clock.start_s
                apart = abs(by_clock - out[k].offset_s) > CREATION_APART_S
                if first.clock.known and out[k].clock.known and apart:
                    said = f"by its own clock it would begin {by_clock:+.0f} s after: that of the first is used"
                    notes.append(f"{out[k].name}: {said}")
        # The videos of a group go onto one clock: that of the first whose start is known.
        first = out[group[0]]
        lead = next((out[k] for k in group if out[k].clock.known), first)
        begin = lead.clock.start_s - (0.0 if lead is first else lead.offset_s) + first.offset_s
        for k in group:
            late = 0.0 if k == group[0] else out[k].offset_s
            clock = replace(out[k].clock, start_s=begin + late, known=lead.clock.known, utc=lead.clock.utc)
            out[k] = replace(out[k], clock=clock)
    return out, groups, notes


def _groups(run: Run, videos: Sequence[_Video]) -> list[tuple[int, ...]]:
    """Numbers of the videos that a rig recorded together; the first is the one of its first camera."""
    good = [k for k, v in enumerate(videos) if v.width]
    alone: list[tuple[int, ...]] = [(k,) for k, v in enumerate(videos) if not v.width]
    if not good:
        return alone
    films = [videooffset.Film(videos[k].folder, videos[k].width, videos[k].height) for k in good]
    rig, known = run.inputs.rig, rig_of_run(run.inputs.rig)
    text = None if known is None else known.text
    try:
        together = videooffset.films_together(films, rig, text, run.settings.scan, run.settings.tuning.scan)
    except InputError as error:
        broken = ", ".join(v.name for v in videos if not v.width)
        raise InputError(f"{error}" + (f"; {broken} cannot be decoded" if broken else "")) from None
    return [tuple(good[f] for f in g) for g in together] + alone


def _curve(video: _Video) -> videooffset.MotionCurve:
    with film.open_film(video.recording) as opened:
        return videooffset.motion_curve(opened.frames())


def _offset_of(curves: tuple[videooffset.MotionCurve, videooffset.MotionCurve]) -> videooffset.Offset:
    return videooffset.find_offset(*curves)


def _take(job: _Job, per_second: float) -> film.Pictures:
    video = job.video
    if job.numbers is None:
        choice = film.sharpest(per_second)
    else:
        choice = film.nearest(job.numbers, job.stamps_s, film.NEAREST_STEPS / video.fps)
    return film.take_pictures(video.recording, job.target, choice, video.clock)


def _apart(job: _Job, taken: film.Pictures) -> str:
    """Time offset of another camera's pictures from the instants of the first's."""
    if job.numbers is None or not taken.stamps_s:
        return ""
    wanted = dict(zip(job.numbers, job.stamps_s))
    off = np.abs([s - wanted[n] for n, s in zip(taken.numbers, taken.stamps_s)])
    lacking = len(job.numbers) - len(taken.numbers)
    more = f"; {lacking} of {len(job.numbers)} instants are not in it" if lacking else ""
    return (
        f"{job.video.name}: its pictures lie {1e3 * np.median(off):.1f} ms from the instants of the first camera's, at "
        f"most {1e3 * np.max(off):.1f} ms{more}"
    )


def describe(scene: Scene) -> list[str]:
    """What a scan found, in lines for people."""
    lines = [
        f"{len(scene)} images in {scene.frames} frames; passes: "
        f"{', '.join(scene.sequences) or 'none (loose photographs)'}"
    ]
    for rig in scene.rigs:
        for sensor in rig.sensors:
            camera, seen = sensor.camera, "no image"
            if camera:
                focal = f"f = {camera.mean_focal_length():.0f} px"
                seen = f"{camera.width} x {camera.height}, {camera.model.name}, {focal}"
            lines.append(f"  {rig.name}/{sensor.name} ({sensor.role}): {seen}")
    lines += [f"  . {note}" for note in scene.notes]
    lines += [f"  left out: {d.name}: {d.reason}" for d in scene.dropped]
    return lines
