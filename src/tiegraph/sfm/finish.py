"""What a mapped model still needs, inside a child process: adjustment, rig health, colours, sigmas, files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.atomic import claim
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjust import final_adjustment, free_cameras
from tiegraph.sfm.covariance import PositionSigma, position_sigma
from tiegraph.sfm.jacobians import Tie
from tiegraph.sfm.placement.settle import Settled, settle
from tiegraph.sfm.rig import soft
from tiegraph.sfm.rig.diagnosis import Diagnosis, diagnose
from tiegraph.sfm.rig.given import drawings, given_geometry
from tiegraph.sfm.rig.health import COLUMNS
from tiegraph.sfm.rig.relax import Relaxed, lost_images, relax, with_sightings_of
from tiegraph.sfm.rig.support import place_as_given, units_per_metre
from tiegraph.text import known_to

HEALTH_FILE = "rig_health.csv"


@dataclass(frozen=True)
class FinishRequest:
    """What the finishing of one model needs, in picklable form."""

    folder: Path
    target: Path
    images: Path | None  # None = no colours
    fixed: tuple[int, ...]  # rig indices whose extrinsics stay
    constant_cameras: tuple[int, ...]
    all_constant: bool
    covariance_frames: int  # 0: no sigmas wanted
    scene: str  # JSON
    alone: tuple[int, ...] = ()  # keys of sensors placed by the rig as given
    soft: tuple[int, ...] = ()  # rig indices whose extrinsics are known with a sigma
    rigs: tuple[int, ...] = ()  # rig indices the model was made with
    database: Path | None = None  # None: the place of frames is not tested
    refused: tuple[tuple[int, int], ...] = ()
    preview: np.ndarray | None = None  # (F, 4, 4) world_from_rig of the frames in a rough model
    scratch: Path | None = None  # None: below ``folder``
    rough: bool = False  # as the mapper left it


@dataclass(frozen=True)
class Finished:
    """What the finishing of a model has to say of it."""

    sigma: PositionSigma | None
    notes: list[str]
    tables: dict[str, dict] = field(default_factory=dict)
    dropped: list[tuple[str, str]] = field(default_factory=list)  # images left out for their place


def finish_model(request: FinishRequest, send: Callable[[Any], None]) -> Finished:
    """Final adjustment, rig health, colours and position sigmas of one model; writes it to its target folder."""
    scene = Scene.from_json(request.scene)
    model = read_model(request.folder)
    settled = _settled(model, scene, request)
    model, notes = settled.model, settled.notes
    mapped = model
    try:
        if not request.rough:
            model, mapped = _adjusted(model, scene, request, notes), model
    except (RuntimeError, ValueError) as error:
        notes.append(f"the final adjustment failed, the mapper's own stays: {error}")
    claim(request.target)
    request.target.mkdir(parents=True, exist_ok=True)
    model, tables, ties = _checked_rig(model, mapped, scene, request, notes)
    if request.alone:
        place_as_given(model, scene, request.alone)
    try:
        if request.images is not None:
            model.extract_colors_for_all_images(request.images)
    except (RuntimeError, ValueError) as error:
        notes.append(f"the points have no colours: {error}")
    model.write(request.target)
    if settled.table is not None:
        tables["placement"] = settled.table
    sigma = _sigma(model, scene, request, notes, ties)
    if sigma is not None:
        names = {k + 1: s.name for k, s in enumerate(scene.all_sensors)}
        tables |= sigma.tables(names)
        notes += _open_notes(sigma, names)
    return Finished(sigma, notes, tables, settled.dropped)


def _settled(model: pycolmap.Reconstruction, scene: Scene, request: FinishRequest) -> Settled:
    if request.database is None:
        return Settled(model)
    # COLMAP asks for a folder of images, though points need none.
    source = (request.database, request.images or request.folder, request.refused)
    rigs = {k: scene.rigs[k] for k in request.rigs}
    try:
        return settle(
            pycolmap.Reconstruction(model),
            scene,
            source,
            rigs,
            request.scratch or request.folder / "placement",
            request.preview,
            frozenset(request.alone),
        )
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        return Settled(model, [f"the place of the frames could not be tested: {error}"])


def _adjusted(
    model: pycolmap.Reconstruction, scene: Scene, request: FinishRequest, notes: list[str]
) -> pycolmap.Reconstruction:
    known = given_geometry(model, scene, ())
    fixed = [k + 1 for k in request.fixed]
    if request.soft and soft.available():
        scale = 1 / units_per_metre(model, scene)
        model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.zeros(3)))
        known = given_geometry(model, scene, request.soft)
    elif request.soft:
        fixed += [k + 1 for k in request.soft]
        notes.append("the rig's sigmas are not used, its extrinsics stay as mapped: the package pyceres is missing")
    adjustment = final_adjustment(model, fixed, request.constant_cameras, known)
    notes.append(adjustment.note)
    return adjustment.model


def _checked_rig(
    model: pycolmap.Reconstruction,
    mapped: pycolmap.Reconstruction,
    scene: Scene,
    request: FinishRequest,
    notes: list[str],
) -> tuple[pycolmap.Reconstruction, dict[str, dict], list[Tie]]:
    """Rig health into its file; a rig that moves is relaxed where that can be done, and said so."""
    if not request.rigs:
        return model, {}, []
    metres = 1 / units_per_metre(model, scene)
    try:
        found = diagnose(model, scene, metres, mapped)
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        notes.append(f"the rig could not be checked: {error}")
        return model, {}, []
    with (request.target / HEALTH_FILE).open("w", newline="") as stream:
        csv.writer(stream).writerows([COLUMNS, *found.rows])
    notes += found.notes
    relaxed: dict[int, Relaxed] = {}
    for index in found.moving:
        if not soft.available():
            notes.append("it stays rigid in the model: relaxing it needs the package pyceres")
            break
        calibrated = index in request.fixed or index in request.soft
        # What the rigid adjustment threw out is wanted here: the points the mapper had.
        start = with_sightings_of(model, mapped) if found.loose else model
        free = relax(start, scene, index, (metres, calibrated), request.constant_cameras, found.loose)
        lost = lost_images(model, free.model, scene)
        if lost:
            notes.append(_lost_note(scene, index, lost))
            continue
        relaxed[index], model = free, free.model
        notes.append(_relaxed_note(scene, index, free, found))
    table = found.table({k: o for r in relaxed.values() for k, o in r.offsets.items()})
    return model, {"rig health": table}, [t for r in relaxed.values() for t in r.ties]


def _lost_note(scene: Scene, index: int, lost: Sequence[int]) -> str:
    names = ", ".join(scene.names[k] for k in lost[:3]) + (" ..." if len(lost) > 3 else "")
    return (
        f"rig {scene.rigs[index].name} stays rigid all the same: relaxed, fewer images would have a place by points; "
        f"{len(lost)} would lose theirs ({names})"
    )


def _relaxed_note(scene: Scene, index: int, relaxed: Relaxed, found: Diagnosis) -> str:
    rig = scene.rigs[index]
    unit = "ms" if found.timed else "% of the frame interval"
    factor = 1000.0 if found.timed else 100.0
    times = ", ".join(
        f"{scene.all_sensors[k].name} {factor * o.offset_s:+.0f} {unit} ({o.moves_m:.2f} m at top speed)"
        for k, o in relaxed.offsets.items()
    )
    return (
        f"rig {rig.name} relaxed: each camera has its own time, estimated from the motion against "
        f"{rig.sensors[0].name}: {times}; {relaxed.note}"
    )


def _open_notes(sigma: PositionSigma, names: Mapping[int, str]) -> list[str]:
    return [
        f"the lever arm of {names.get(camera, camera)} is "
        f"{known_to(share, 1.0, f'{100 * share:.0f} % of its length only')}, for hardly a point ties it to the other "
        "cameras; measured and given in a rig file it would place its images"
        for camera, share in sigma.open_mountings().items()
    ]


def _sigma(
    model: pycolmap.Reconstruction, scene: Scene, request: FinishRequest, notes: list[str], ties: Collection[Tie]
) -> PositionSigma | None:
    frames = model.num_reg_frames()
    if frames > request.covariance_frames:
        if request.covariance_frames > 0:
            notes.append(f"position sigmas not computed: {frames} frames, more than sparse.covariance_frames")
        return None
    try:
        free = free_cameras(model) - set(request.constant_cameras)
        rigs = set(model.rigs) - {k + 1 for k in request.fixed}
        return position_sigma(model, free, rigs, ties, drawings(model, scene))
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        notes.append(f"position sigmas could not be computed: {error}")
        return None
