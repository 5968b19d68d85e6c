"""The user's inputs, checked before anything is made: by themselves, and against the images of a scan.

Refused before anything is made or stored: impossible values in a table, a rig, a pose file, a position or a CRS,
with file, line, value and remedy. Doubts are notes. Checks that need the images are made at
``scan``. Coded targets of a control point file are searched for in the images.
"""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pycolmap

from tiegraph.errors import InputError, SettingsError, UnreadableArtefact
from tiegraph.geometry.geodesy import ENU, check_vertical, parse_crs
from tiegraph.masks.sources import read_model
from tiegraph.pipeline.files import read_image, scanned
from tiegraph.pipeline.foundrig import rig_of_run
from tiegraph.project.inputs import check_files, check_path
from tiegraph.project.run import Run, status
from tiegraph.project.settings import Settings
from tiegraph.project.stages import Stage
from tiegraph.scan.cameras import read_camera
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scan.priors.trajectory import read_trajectory
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.rigfiles.rigspec import preset_sizes
from tiegraph.scan.views import PRESET
from tiegraph.scene.bags import is_bag, source_of
from tiegraph.scene.control import TargetMark, image_lookup, locate, locate_bars
from tiegraph.scene.exif import orientation_of
from tiegraph.scene.gcp import GcpFile, read_gcps
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.namedposes import has_named_poses
from tiegraph.scene.names import found_by, on_disk
from tiegraph.scene.pairs import pair_lines, read_pair_list
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly
from tiegraph.targets.marks import OTHERS, Seen, find_targets, likely_family, marks_of
from tiegraph.targets.tuning import Tuning


def check_given(stages: Sequence[Stage], run: Run) -> None:
    """Refuse wrong inputs and settings before a stage runs and before they are stored; makes nothing.

    If the scan is up to date, files that only name its images are compared with it, because it will not run again.
    Raises InputError and SettingsError, naming option, path and remedy.
    """
    given, settings = run.inputs, run.settings
    given.check()
    for option, path, kind in (
        ("--gnss", given.gnss, "file"),
        ("--times", given.times, "file"),
        ("--trajectory", given.poses, "file or folder"),
        ("--start", given.start, "file or folder"),
    ):
        if path is not None:
            check_path(option, source_of(path), "file or folder" if is_bag(path) else kind)
    check_files(settings)
    if settings.scan.crs.lower() not in ("auto", ENU.lower()):
        parse_crs(settings.scan.crs)
        check_vertical(settings.scan.crs)
    if "file" in settings.candidates.sources and settings.candidates.pairs_file is None:
        raise SettingsError("candidates.sources has 'file', but candidates.pairs_file names none")
    _read_settings(settings)
    if status(stages[:1], run)[0][1]:
        _read_inputs(run)
    else:
        with suppress(UnreadableArtefact):  # then it is made again
            check_against(run, scanned(run))


def _read_settings(settings: Settings) -> None:
    """Read the files of settings that need no image, for the errors this raises: most stages read them hours later."""
    if settings.georef.gcp is not None:
        read_gcps(settings.georef.gcp, settings.georef.marks)
    elif settings.georef.marks is not None:
        raise InputError(f"--marks {settings.georef.marks}: marks of no points; give the points by --gcp")
    if settings.candidates.pairs_file is not None:
        pair_lines(settings.candidates.pairs_file)
    if settings.masks.model is not None:
        read_model(settings.masks.model)
    if settings.evaluate.reference is not None:
        from tiegraph.evaluate.reference import check_reference  # loads the engine

        check_reference(settings.evaluate.reference)
    if settings.evaluate.reference_cloud is not None:
        from tiegraph.scene.cloudchunks import check_cloud  # laspy, a tenth of a second

        check_cloud(settings.evaluate.reference_cloud)


def _read_inputs(run: Run) -> None:
    given, tuning = run.inputs, run.settings.tuning.scan.rig
    named = given.rig is not None and given.rig.strip().lower() != PRESET and not preset_sizes(given.rig, tuning)
    if named and rig_of_run(given.rig) is None:
        read_rig_file(str(given.rig), tuning)
    if given.camera is not None:
        read_camera(given.camera)
    poses = given.poses
    if poses is not None and (poses.is_file() or is_bag(poses) or has_named_poses(poses)):
        read_trajectory(poses)
    if given.start is not None:
        read_start(given.start)
    if given.gnss is not None:
        read_gnss(given.gnss, run.settings.scan.heights_m)


def check_against(run: Run, scene: Scene) -> tuple[str, ...]:
    """Notes on control points and the pair list for the images of a scan. Raises InputError if they do not fit."""
    file = control_file(run)
    notes: tuple[str, ...] = ()
    if file is not None and file.points:
        crs, heights = run.settings.scan.crs, run.settings.scan.heights_m
        notes = locate(file, scene, crs, orientation=orientations(run, scene, file), heights_m=heights).notes
    elif file is not None:
        locate_bars(file, scene, orientation=orientations(run, scene, file))
        notes = file.notes
    path = run.settings.candidates.pairs_file
    return notes if path is None else (*notes, *read_pair_list(path, scene)[1])


def orientations(run: Run, scene: Scene, file: GcpFile) -> dict[int, int]:
    """By EXIF, of the images that a file marks, by scene index; those that are no files of the user are left out."""
    root, lookup = source_of(run.inputs.images), image_lookup(scene)
    images = {k for mark in file.marks if (k := found_by(lookup, mark.image)) is not None}
    found = {k: on_disk(root, scene.source_name(k)) for k in sorted(images)}
    return {k: orientation_of(path) for k, path in found.items() if path is not None}


def control_file(run: Run) -> GcpFile | None:
    """The control point file of the settings, unchanged; None without one."""
    settings = run.settings
    path = settings.georef.gcp
    if path is None:
        return None
    if not path.exists():
        raise InputError(f"--gcp {path}: no such file")
    return read_gcps(path, settings.georef.marks)


def target_marks(
    run: Run, scene: Scene, file: GcpFile, model: pycolmap.Reconstruction | None = None, most: int | None = None
) -> tuple[tuple[TargetMark, ...], tuple[str, ...]]:
    """Marks of the file's coded targets in the prepared images, ``most`` of them or all, by the cameras of a model if
    there is one; and notes.

    Raises InputError if none of them is seen in any image, with the family that is, if there is one.
    """
    named = file.targets
    if not named:
        return (), ()
    tuning = run.settings.tuning.targets
    families = sorted({t.family for t in named.values()})
    images = evenly(len(scene), len(scene) if most is None else most).tolist()
    found = run.map(_search, [run.path("images", scene.names[k]) for k in images], families, tuning)
    seen = dict(zip(images, found))
    if not any(s.target in named.values() for one in found for s in one) and len(images) == len(scene):
        _say_family(run, scene, file, families, tuning)
    cameras = {} if model is None else {i.name: i.camera for i in model.images.values()}
    return marks_of(seen, named, lambda k: cameras.get(scene.names[k]), scene.names)


def _search(path: Path, families: Sequence[str], tuning: Tuning) -> list[Seen]:
    return find_targets(read_image(path), families, tuning)


def _say_family(run: Run, scene: Scene, file: GcpFile, families: Sequence[str], tuning: Tuning) -> None:
    """Raise InputError: no target is seen; with the families that are."""
    images = evenly(len(scene), 12).tolist()
    others = [f for f in OTHERS if f not in families]
    found = run.map(_search, [run.path("images", scene.names[k]) for k in images], others, tuning)
    likely = likely_family([s for one in found for s in one])
    first = next(iter(file.targets))
    remedy = f"but of {likely}: is that the family?" if likely else (
        f"and of no other family; a side of {tuning.least_side_px:g} px and a white margin are needed"
    )  # fmt: skip
    raise InputError(
        f"--gcp {file.path}: none of its {len(file.targets)} coded targets, such as {first}, is seen in any of "
        f"{len(scene)} images, {remedy}"
    )
