"""Glue of scan: what a user hands over becomes a scene and a folder of images."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiegraph.odometry.cameras import cameras_of
from tiegraph.pipeline.foundrig import rig_of_run
from tiegraph.pipeline.inputs import check_against, control_file, target_marks
from tiegraph.pipeline.odometry import followed
from tiegraph.pipeline.videos import photographs
from tiegraph.project.inputs import FOLLOW
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scan.cameras import start_cameras
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scan.scan import ScanInputs, build_scene, prepare_image, probe_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.bags import source_of
from tiegraph.scene.hanging import carrying
from tiegraph.scene.images import search_images
from tiegraph.scene.names import clean_names
from tiegraph.scene.rig import Sensor
from tiegraph.text import acts, composed


def scan(run: Run) -> Outcome:
    """Open every image once, sort them into rigs, frames and passes, and lay the usable ones below images/."""
    given, settings, tuning = run.inputs, run.settings.scan, run.settings.tuning.scan
    root, said_of_images, cameras = photographs(run)
    files, passed_over = search_images(root)
    names = clean_names(files)  # from here on: only their opening needs the names that the file system has
    run.reporter.total(2 * len(names))
    probes = run.map(probe_image, [root / f for f in files], run.settings.tuning.scene.images)
    known = rig_of_run(given.rig)
    inputs = ScanInputs(
        images=root,
        rig=given.rig,
        rig_text=None if known is None else known.text,
        camera=given.camera,
        gnss=given.gnss,
        trajectory=None if given.trajectory == FOLLOW else given.trajectory,
        start=None if given.start is None else read_start(given.start),
        times=given.times,
        video=root != source_of(given.images),
        cameras=start_cameras(root, cameras, names),
    )
    scene = build_scene(inputs, names, probes, settings, tuning)
    carrying(scene)
    told = check_against(run, scene)  # wrong files are better said now than after hours
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
        told = (*told, *target_marks(run, scene, file, most=run.settings.tuning.targets.looked_at).notes)
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
