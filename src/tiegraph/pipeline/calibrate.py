"""Glue of pattern calibration: from a folder of images of a board to a rig file, with notes.

There is no run folder: the results are a rig.toml and, beside it, a folder with the same for other programs and a
summary. Neither may exist before.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.calibrate import board as boards
from tiegraph.calibrate import summary
from tiegraph.calibrate.adjust import Adjusted, adjust_robustly, start
from tiegraph.calibrate.judge import Verdict, judge, relative_focal_sigma
from tiegraph.calibrate.settings import CalibrateSettings
from tiegraph.errors import InputError
from tiegraph.project.pool import map_items, open_pool
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import VerbTunings
from tiegraph.project.stages import write_atomic
from tiegraph.scan.assign import match_frames
from tiegraph.scan.folders import guess_layout
from tiegraph.scan.prepare import Report, usable_images
from tiegraph.scan.rigfiles.camerafile import MODELS
from tiegraph.scan.rigfiles.rigspec import rig_config, rig_toml
from tiegraph.scene.atomic import must_be_new
from tiegraph.scene.composed import WIDE
from tiegraph.scene.decoding import Levels, eight_bit, opened, turned
from tiegraph.scene.images import Probe, probe_image, search_images
from tiegraph.scene.names import clean_names
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.text import meant, one_line

_FOLDER = "_calibration"  # beside the rig.toml: its name without suffix, and this


def calibrate(
    images: Path,
    board: str,
    out: Path,
    settings: CalibrateSettings,
    pool: str = "local",
    reporter: Reporter | None = None,
    tunings: VerbTunings | None = None,
) -> Verdict:
    """Calibrate the cameras whose images of a board lie below a folder; writes ``out`` and a folder beside it.

    Raises InputError for a board, images or outputs that cannot be used, and ReconstructionError for views that
    contradict each other or leave a focal length open; then nothing is written.
    """
    reporter, tunings = reporter or Reporter("quiet"), tunings or VerbTunings()
    folder = _folder_beside(out)
    pattern = boards.read_board(board)
    cameras, files, found = _read_folder(images, settings, pool, reporter, tunings)
    check_wide(settings.wide, [c.name for c in cameras])
    with reporter.stage("corners"):
        reporter.total(len(files))
        corners = _map(pool, reporter, _corners, files, pattern)
    views = tuple(
        boards.View(camera=f.camera, instant=f.instant, name=f.name, corners=numbers, xy=xy)
        for f, (numbers, xy) in zip(files, corners)
        if len(numbers)
    )
    seen = boards.Observations(pattern, cameras, views)
    unread, read = [], {view.name for view in views}
    for number, camera in enumerate(cameras):
        names = [f.name for f in files if f.camera == number and f.name not in read]
        if names:
            unread.append(f"{camera.name}: no board in {len(names)} of {camera.count} images: {', '.join(names)}")
    boards.check_views(seen)
    done = adjust_robustly(seen, start(seen), settings.board_sigma)
    verdict = judge(done)
    constants = [f"constants changed: {tunings.changed()}"] if tunings.changed() else []
    notes = (board, *constants, *found, *unread)
    _write(out, done, verdict, notes, _rig(done, verdict, settings.wide))
    left_out = (f"left out: {name}: {why}" for name, why in done.left_out)
    scale = () if len(cameras) == 1 else (summary.lengths(done),)
    written = f"written: {out}", f"summary: {folder / 'summary.md'}"
    for text in (*unread, *left_out, *verdict.advice, *scale, *written):
        reporter.say(text)
    return verdict


@dataclass(frozen=True)
class _File:
    """One image: its path, camera's and instant's number, name, and how its pixels are read."""

    path: Path
    camera: int
    instant: int
    name: str
    upright: bool
    levels: Levels


def _read_folder(
    images: Path, settings: CalibrateSettings, pool: str, reporter: Reporter, tunings: VerbTunings
) -> tuple[tuple[boards.CameraImages, ...], tuple[_File, ...], tuple[str, ...]]:
    """Cameras and files below a folder, in the layouts that ``scan`` reads, and notes."""
    tuning, report = tunings.scan, Report()
    found, passed_over = search_images(images)
    names = clean_names(found)
    boards.check_count(images, len(names))
    paths = [Path(images, f) for f in found]
    with reporter.stage("images"):
        reporter.total(len(paths))
        probes = _map(pool, reporter, probe_image, paths)
    usable = usable_images(names, probes, report)
    layout = guess_layout(usable.names, *usable.facts(), settings.layout, tuning.folders)
    why = "" if layout.order.loose else f": {layout.order.why}"
    report.notes.append(f"layout: {len(layout.folders)} camera(s){why}")
    kept = [k for k, place in zip(usable.images, layout.places) if place is not None]
    folder = {k: place.folder for k, place in zip(usable.images, layout.places) if place is not None}
    sequence = {k: place.sequence for k, place in zip(usable.images, layout.places) if place is not None}
    report.drop([names[k] for k in usable.images if k not in folder], "outside the camera folders")
    if len(layout.folders) == 1 and settings.layout == "auto":
        boards.check_one_camera([names[k] for k in kept])
    owned = [[k for k in kept if folder[k] == f] for f in layout.folders]
    upright = [len({probes[k].exif.orientation for k in own}) == 1 for own in owned]
    models = _models(settings.model, [f or "camera" for f in layout.folders])
    cameras = []
    for f, model, own, up in zip(layout.folders, models, owned, upright):
        size = _one_size(f, [names[k] for k in own], [probes[k] for k in own], up)
        cameras.append(boards.CameraImages(f or "camera", f, model, size, count=len(own)))
    instants = _instants(names, owned, sequence, settings.frames)
    files = tuple(
        _File(path=paths[k], camera=c, instant=instants[k], name=names[k], upright=upright[c], levels=probes[k].levels)
        for c, own in enumerate(owned)
        for k in own
    )
    dropped = (f"{d.name}: {d.reason}" for d in report.dropped)
    return tuple(cameras), files, (*passed_over, *report.notes, *dropped)


def _one_size(folder: str, names: Sequence[str], probes: Sequence[Probe], upright: bool) -> tuple[int, int]:
    sizes = [p.upright_size() if upright else (p.width, p.height) for p in probes]
    (usual, _), *others = Counter(sizes).most_common()
    if others:
        odd = next(k for k, size in enumerate(sizes) if size != usual)
        raise InputError(
            f"{names[odd]} has {sizes[odd][0]} x {sizes[odd][1]} pixels, but most images of {folder or 'the camera'} "
            f"have {usual[0]} x {usual[1]}: a calibration holds for one size. Put each camera's images into a folder "
            "of its own (cam0/, cam1/), and remove cropped or reduced ones"
        )
    return usual


def _models(words: Sequence[str], names: Sequence[str]) -> list[str]:
    """The camera model of each camera. Raises InputError for an unknown model or camera."""
    shared, own = "OPENCV", {}
    for word in words:
        name, _, model = word.rpartition("=")
        if model.upper() not in MODELS:
            raise InputError(f"--model {word}: no camera model {model!r}{meant(model.upper(), MODELS, 0.5)}")
        if name and name not in names:
            raise InputError(f"--model {word}: no camera {name!r}; found are {', '.join(names)}")
        if name:
            own[name] = model.upper()
        else:
            shared = model.upper()
    return [own.get(name, shared) for name in names]


def _instants(
    names: Sequence[str], owned: Sequence[Sequence[int]], sequence: dict[int, str], how: str
) -> dict[int, int]:
    """The number of the instant of each image. Raises InputError if the names of a rig do not give it."""
    if len(owned) == 1:
        return {k: number for number, k in enumerate(owned[0])}
    for kind in ("name", "number") if how == "auto" else (how,):
        label = _labels(names, owned, sequence, kind)
        cameras = Counter(one for images in owned for one in {label[k] for k in images})
        if how != "auto" or max(cameras.values()) > 1:
            break
    else:
        raise InputError(
            f"the names of the images do not show which were taken at one instant (as {names[owned[0][0]]} and "
            f"{names[owned[1][0]]}): give them equal names, or give --frames order if their order shows it"
        )
    for images in owned:
        twice = [one for one, count in Counter(label[k] for k in images).items() if count > 1]
        if twice:
            both = ", ".join(names[k] for k in images if label[k] == twice[0])
            raise InputError(f"two images of one camera at one instant: {both}: keep one, or give --frames name")
    order = {one: number for number, one in enumerate(sorted(set(label.values())))}
    return {k: order[one] for k, one in label.items()}


def _labels(
    names: Sequence[str], owned: Sequence[Sequence[int]], sequence: dict[int, str], how: str
) -> dict[int, tuple[str, str]]:
    """Pass and frame of each image, as ``scan`` matches them."""
    out: dict[int, tuple[str, str]] = {}
    for one in sorted(set(sequence.values())):
        own = {c: [k for k in images if sequence[k] == one] for c, images in enumerate(owned)}
        stems = {c: [Path(names[k]).stem for k in images] for c, images in own.items() if images}
        keys, _ = match_frames(stems, how)
        out |= {k: (one, key) for c in stems for k, key in zip(own[c], keys[c])}
    return out


def _map(pool: str, reporter: Reporter, function: object, items: Sequence, *args: object) -> list:
    executor, workers = open_pool(pool)
    with executor:
        return map_items(executor, workers, function, items, args, reporter.advance)  # type: ignore[arg-type]


def _corners(file: _File, board: boards.Board) -> boards.Corners:
    found = opened(file.path.read_bytes(), file.path.suffix)
    pixels = eight_bit(found.pixels(), file.levels)
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), cv2.COLOR_RGB2GRAY)
    return boards.detect(np.ascontiguousarray(turned(grey, found.orientation) if file.upright else grey), board)


def _folder_beside(out: Path) -> Path:
    """The folder beside a rig file. Raises InputError if one of them exists, or ``out`` is no TOML file."""
    if out.suffix.lower() != ".toml":
        raise InputError(f"-o {out}: the rig is written as TOML: give a name that ends in .toml")
    folder = out.with_name(out.stem + _FOLDER)
    for path in (out, folder):
        must_be_new(out, path)
    return folder


def _write(out: Path, done: Adjusted, verdict: Verdict, said: Sequence[str], rig: Rig) -> None:
    board, *notes = said
    folder = out.with_name(out.stem + _FOLDER)
    names = [c.name for c in done.seen.cameras]
    files = [f"camera{k}" for k in range(len(names))]  # folders may have several levels
    for k, stem in enumerate(files):
        text = summary.opencv_yaml(done.state.cameras[k])
        if text is None:
            notes.append(f"no OpenCV YAML of {names[k]}: OpenCV has no model {done.state.cameras[k].model.name}")
        else:
            write_atomic(folder / f"{stem}.yaml", text)
        write_atomic(folder / f"{stem}_residuals.png", summary.residual_picture(done, k))
    chain = summary.kalibr_yaml(done.state.cameras, done.state.sensor_from_rig)
    if chain is None:
        notes.append("no camchain.yaml: Kalibr has no such camera model")
    else:
        write_atomic(folder / "camchain.yaml", chain)
    pictures = {name: f"{stem}_residuals.png" for name, stem in zip(names, files)}
    write_atomic(folder / "rig_config.json", rig_config([rig]))
    write_atomic(folder / "summary.md", summary.summary(done, verdict, board, notes, pictures))
    comment = f"Calibrated by tiegraph with the board {one_line(board)}: {len(done.seen.views)} views, sigma of a " \
              f"corner {done.sigma_px:.3f} px.\nLengths come from the size of its squares."  # fmt: skip
    write_atomic(out, rig_toml(rig, comment))


def check_wide(wide: Sequence[str], cameras: Sequence[str]) -> None:
    """Raise InputError for a wide camera that is none of the rig's, or for a rig of no other."""
    for name in wide:
        if name not in cameras:
            raise InputError(f"--wide {name}: no such camera; there are {', '.join(cameras)}")
    if wide and set(wide) == set(cameras):
        raise InputError(f"--wide {' '.join(wide)}: that is every camera: omit --wide, then all are used alike")


def _rig(done: Adjusted, verdict: Verdict, wide: Sequence[str]) -> Rig:
    sensors = []
    for k, (images, camera) in enumerate(zip(done.seen.cameras, done.state.cameras)):
        turn, place = summary.rig_sigmas(verdict.precision, k) if k else (None, None)
        sensors.append(
            Sensor(
                name=images.name,
                camera=camera,
                sensor_from_rig=done.state.sensor_from_rig[k],
                role=WIDE if images.name in wide else "side",
                folder=images.folder,
                sigma_deg=turn,
                sigma_m=place,
                camera_sigma_px=relative_focal_sigma(done, verdict.precision, k) * camera.mean_focal_length(),
            )
        )
    return Rig("rig" if len(sensors) > 1 else "camera", tuple(sensors), synchronised=len(sensors) > 1)
