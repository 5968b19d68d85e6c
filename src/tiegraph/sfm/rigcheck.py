"""The rigs and calibrations of an adjusted model against the images: what contradicts them gives way, or is said."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.evidence import Statement
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment import constraints
from tiegraph.sfm.adjustment.jacobians import RigConstraints
from tiegraph.sfm.placement.doubtful import MatchSource
from tiegraph.sfm.rig.confront import (
    in_units,
    lens_prior_test,
    lever_sigmas,
    mounting_errors,
    open_times,
    prior_test,
    refine,
)
from tiegraph.sfm.rig.diagnostics import RigDiagnostics, rig_diagnostics
from tiegraph.sfm.rig.priortest import PriorTest
from tiegraph.sfm.rig.resections import COLUMNS
from tiegraph.sfm.rig.rigevidence import statements
from tiegraph.sfm.rig.support import units_per_metre
from tiegraph.sfm.rig.timecalibration import (
    TimeCalibration,
    TrustedCalibration,
    calibrate_times,
    lost_images,
    with_errors,
    with_observations_of,
)
from tiegraph.sfm.tuning import Tuning

DIAGNOSTICS_FILE = "rig_diagnostics.csv"


@dataclass(frozen=True)
class Held:
    """How rigs (scene indices) and cameras (COLMAP ids) are held by what was given."""

    rigs: tuple[int, ...] = ()  # that the model was made with
    fixed: tuple[int, ...] = ()  # rigs whose extrinsics stay
    soft: tuple[int, ...] = ()  # rigs whose extrinsics are known with a sigma
    ordered: tuple[int, ...] = ()  # rigs that the user wants as given, whatever the images say
    unsupported: tuple[int, ...] = ()  # keys of sensors placed by the rig as given
    cameras: tuple[int, ...] = ()  # whose calibration stays
    lenses_ordered: bool = False  # by the user
    readout_ms: float | None = None  # of a rolling shutter; None: to be estimated


@dataclass(frozen=True)
class FinishRequest:
    """What the finishing of one model needs, in picklable form."""

    folder: Path
    target: Path
    scene: str  # JSON
    tuning: Tuning
    held: Held
    images: Path | None = None  # None = no colours
    matched: MatchSource | None = None  # None: the place of frames is not tested
    preview: np.ndarray | None = None  # (F, 4, 4) world_from_rig of the frames in a rough model
    covariance_frames: int = 0  # 0: no sigmas wanted
    rough: bool = False  # as the mapper left it


@dataclass
class Checked:
    """A model whose rigs were confronted with the images, and what came out."""

    model: pycolmap.Reconstruction
    tables: dict[str, dict] = field(default_factory=dict)
    ties: list[RigConstraints] = field(default_factory=list)  # of relaxed rigs
    off: dict[int, np.ndarray] = field(default_factory=dict)  # rig id -> of mountings of rigid ones (``misplaced``)
    contradictions: list[str] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)
    levers: dict[int, float] = field(default_factory=dict)  # camera id -> sigma with its time free, model units
    notes: list[str] = field(default_factory=list)
    misfit: float = 0.0  # of the lever arms as given, where they are contradicted: a share


def checked_rig(
    model: pycolmap.Reconstruction, mapped: pycolmap.Reconstruction, scene: Scene, request: FinishRequest
) -> Checked:
    """Rig diagnostics into its file; a rig that the images contradict gives way, unless it was ordered to stay: said
    so."""
    out = Checked(model)
    if not request.rough:
        _single_lenses(out, scene, request)
    if not request.held.rigs:
        return out
    metres = 1 / units_per_metre(model, scene, request.tuning.rig.support)
    try:
        found = rig_diagnostics(model, scene, metres, request.tuning, mapped)
    except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
        out.notes.append(f"the rig could not be checked: {error}")
        return out
    with (request.target / DIAGNOSTICS_FILE).open("w", newline="") as stream:
        csv.writer(stream).writerows([COLUMNS, *found.rows])
    out.notes += found.notes
    relaxed = _relaxed(out, mapped, scene, request, found, metres)
    last: dict[int, PriorTest] = {}
    for index, test in found.prior_tests.items():
        if index not in relaxed and index in request.held.fixed:
            out.notes += open_times(test, scene, index)
        elif index not in relaxed:
            out.levers |= {k: v / metres for k, v in lever_sigmas(test, scene, index).items()}
        last[index] = _confronted(out, scene, request, index, test, index in relaxed)
    for index, free in relaxed.items():
        ties_of = free.constraints
        if _measured(index, request):
            off = mounting_errors(last.get(index), scene, index, ties_of.cameras, request.tuning.rig)
            ties_of = with_errors(ties_of, in_units(off, metres))
        out.ties.append(ties_of)
    offsets = {k: o for r in relaxed.values() for k, o in r.offsets.items()}
    out.tables["rig diagnostics"] = found.table(offsets, request.tuning.rig)
    return out


def _single_lenses(out: Checked, scene: Scene, request: FinishRequest) -> None:
    """Confront the calibrations of single cameras that were held with the images."""
    first = 0
    for index, rig in enumerate(scene.rigs):
        held = len(rig.sensors) == 1 and first + 1 in request.held.cameras
        first += len(rig.sensors)
        try:
            test = lens_prior_test(out.model, scene, index, request.tuning) if held else None
        except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
            out.notes.append(f"the calibration of {rig.sensors[0].name} could not be checked: {error}")
            continue
        if test is not None:
            _confronted(out, scene, request, index, test, False)


def _relaxed(
    out: Checked,
    mapped: pycolmap.Reconstruction,
    scene: Scene,
    request: FinishRequest,
    found: RigDiagnostics,
    metres: float,
) -> dict[int, TimeCalibration]:
    """Relax the rigs that move, into ``out.model``; what stays rigid though it moves is a contradiction."""
    relaxed: dict[int, TimeCalibration] = {}
    for index in found.moving:
        name = scene.rigs[index].name
        if index in request.held.ordered:
            out.contradictions.append(
                f"rig {name} was ordered to stay as given (sparse.rig = fixed) and does; the images contradict it: "
                + "; ".join(found.notes)
            )
            continue
        if not constraints.available():
            why = "it stays rigid in the model: relaxing it needs the package pyceres"
            out.contradictions.append(f"rig {name} does not move as one ({'; '.join(found.notes)}); {why}")
            break
        freed = found.prior_tests[index].freed if index in found.prior_tests else ()
        # What the rigid adjustment threw out is wanted here: the points the mapper had.
        start = with_observations_of(out.model, mapped) if found.unstable or freed else out.model
        # What calibrated lenses do beyond their model looks like turned cameras; lenses that are adjusted do not.
        bent = not request.held.cameras and any(what == "mount" for what, _ in freed)
        calibrated = _measured(index, request) and not bent
        believed = TrustedCalibration(
            metres_per_unit=metres,
            calibrated=calibrated,
            constant_cameras=request.held.cameras,
            lenses_held=request.held.lenses_ordered,
        )
        free = calibrate_times(start, scene, index, believed, request.tuning, found.unstable)
        lost = lost_images(out.model, free.model, scene, request.tuning.adjust.min_points)
        if lost:
            out.contradictions.append(_lost_note(scene, index, lost, found.notes))
            continue
        relaxed[index], out.model = free, free.model
        out.notes.append(_relaxed_note(scene, index, free, found))
    return relaxed


def _measured(index: int, request: FinishRequest) -> bool:
    return index in request.held.fixed or index in request.held.soft


def _confronted(
    out: Checked, scene: Scene, request: FinishRequest, index: int, test: PriorTest, relaxed: bool
) -> PriorTest:
    """Say where the file of a measured rig contradicts the images, and return what they want otherwise in the end; a
    turned or shifted camera may be adjusted."""
    metres = test.system.metres_per_unit
    if relaxed:  # with its times free, other things may be left to say, or none
        again = prior_test(out.model, scene, index, metres, request.tuning)
        test = test if again is None else again
    refined = None
    bent = any(what == "mount" for what, _ in test.freed)
    if bent and not relaxed and index in request.held.fixed and constraints.available():
        fixed = [k + 1 for k in request.held.fixed]
        refined = refine(out.model, scene, index, test, fixed, request.held.cameras, request.tuning.adjust)
    if refined is not None:  # where the rest is no longer bent by it, the sigmas are better
        again = prior_test(refined, scene, index, metres, request.tuning)
        if again is not None and any(what == "mount" for what, _ in again.freed):
            test = again
    said = statements(test, scene, index, refined)
    out.statements += said.statements
    out.misfit = max(out.misfit, said.misfit)
    if not said.contradictions:
        return test
    how, followed = "", False
    if index in request.held.ordered:
        how = "; held as given all the same (sparse.rig = fixed)"
    elif refined is not None and not lost_images(out.model, refined, scene, request.tuning.adjust.min_points):
        out.model, followed = refined, True
        how = "; the images were followed, the other cameras held as given"
    out.contradictions += [f"{line}{how}" for line in said.contradictions]
    count, first = len(scene.rigs[index].sensors), scene.first_sensor(index)
    if count > 1 and not relaxed and _measured(index, request):
        cameras = range(first + 1, first + count)
        off = mounting_errors(test, scene, index, cameras, request.tuning.rig, followed, relaxed=False)
        out.off[index + 1] = in_units(off, metres)
    return test


def _lost_note(scene: Scene, index: int, lost: Sequence[int], why: Sequence[str]) -> str:
    names = ", ".join(scene.names[k] for k in lost[:3]) + (" ..." if len(lost) > 3 else "")
    return (
        f"rig {scene.rigs[index].name} stays rigid all the same: relaxed, fewer images would have a place by points; "
        f"{len(lost)} would lose theirs ({names}); the images contradict it: {'; '.join(why)}"
    )


def _relaxed_note(scene: Scene, index: int, relaxed: TimeCalibration, found: RigDiagnostics) -> str:
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
