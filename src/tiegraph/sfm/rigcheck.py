"""The rigs and calibrations of an adjusted model against the images: what contradicts them gives way, or is said."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.evidence import Statement
from tiegraph.scene.scene import Scene
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
from tiegraph.sfm.rig.rigevidence import RigEvidence, statements
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


@dataclass(frozen=True)
class _Rig:
    """Rig ``index`` of the scene, and what is asked of it."""

    scene: Scene
    index: int
    request: FinishRequest

    @property
    def name(self) -> str:
        return self.scene.rigs[self.index].name

    @property
    def ordered(self) -> bool:
        return self.index in self.request.held.ordered

    @property
    def fixed(self) -> bool:
        return self.index in self.request.held.fixed

    @property
    def measured(self) -> bool:
        return self.fixed or self.index in self.request.held.soft

    def prior_test(self, model: pycolmap.Reconstruction, metres_per_unit: float) -> PriorTest | None:
        """What the images of a model want otherwise of it."""
        return prior_test(model, self.scene, self.index, metres_per_unit, self.request.tuning)

    def lost(self, model: pycolmap.Reconstruction, changed: pycolmap.Reconstruction) -> tuple[int, ...]:
        """Images that lose their place in the changed model (``lost_images``)."""
        return lost_images(model, changed, self.scene, self.request.tuning.adjust.min_points)


def checked_rig(
    model: pycolmap.Reconstruction, mapped: pycolmap.Reconstruction, scene: Scene, request: FinishRequest
) -> Checked:
    """Rig diagnostics into its file; a rig that the images contradict gives way, unless it was ordered to stay: said
    so."""
    out = Checked(model)
    if not request.rough:
        _confront_single_lenses(out, scene, request)
    if not request.held.rigs:
        return out
    metres = 1 / units_per_metre(model, scene, request.tuning)
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
        rig = _Rig(scene, index, request)
        if index in relaxed:
            last[index] = _confront_relaxed(out, rig, test)
        else:
            _say_what_times_leave_open(out, rig, test)
            _confront_rigid(out, rig, test)
    out.ties += [_ties(_Rig(scene, index, request), free, last.get(index), metres) for index, free in relaxed.items()]
    offsets = {k: o for r in relaxed.values() for k, o in r.offsets.items()}
    out.tables["rig diagnostics"] = found.table(offsets, request.tuning.rig)
    return out


def _confront_single_lenses(out: Checked, scene: Scene, request: FinishRequest) -> None:
    """The calibrations of single cameras that were held."""
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
            _confront_rigid(out, _Rig(scene, index, request), test)


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
        rig = _Rig(scene, index, request)
        if scene.rigs[index].stitched():
            out.notes.append(
                f"the views of {rig.name} are cut from one picture and stay together: what scatters there is where the "
                "lenses were stitched, which is exact far away only"
            )
            continue
        if rig.ordered:
            out.contradictions.append(
                f"rig {rig.name} was ordered to stay as given (sparse.rig = fixed) and does; the images contradict it: "
                + "; ".join(found.notes)
            )
            continue
        free = _times_calibrated(out.model, mapped, rig, found, metres)
        lost = rig.lost(out.model, free.model)
        if lost:
            out.contradictions.append(_lost_note(scene, index, lost, found.notes))
            continue
        relaxed[index], out.model = free, free.model
        out.notes.append(_relaxed_note(scene, index, free, found))
    return relaxed


def _times_calibrated(
    model: pycolmap.Reconstruction, mapped: pycolmap.Reconstruction, rig: _Rig, found: RigDiagnostics, metres: float
) -> TimeCalibration:
    """The model adjusted with a time for each camera of a rig that moves."""
    held = rig.request.held
    freed = found.prior_tests[rig.index].freed if rig.index in found.prior_tests else ()
    # What the rigid adjustment threw out is wanted here: the points the mapper had.
    start = with_observations_of(model, mapped) if found.unstable or freed else model
    # What calibrated lenses do beyond their model looks like turned cameras; lenses that are adjusted do not.
    bent = not held.cameras and any(what == "mount" for what, _ in freed)
    believed = TrustedCalibration(
        metres_per_unit=metres,
        calibrated=rig.measured and not bent,
        constant_cameras=held.cameras,
        lenses_held=held.lenses_ordered,
    )
    return calibrate_times(start, rig.scene, rig.index, believed, rig.request.tuning, found.unstable)


def _say_what_times_leave_open(out: Checked, rig: _Rig, test: PriorTest) -> None:
    """Of a rigid rig: whether its cameras fire together, where it is held; else how well its levers are known."""
    if rig.fixed:
        out.notes += open_times(test, rig.scene, rig.index)
        return
    metres = test.system.metres_per_unit
    out.levers |= {k: v / metres for k, v in lever_sigmas(test, rig.scene, rig.index).items()}


def _confront_relaxed(out: Checked, rig: _Rig, test: PriorTest) -> PriorTest:
    """Say where the file of a relaxed rig contradicts the images, and return what they want otherwise: with its times
    free that may be other things than before, or none."""
    again = rig.prior_test(out.model, test.system.metres_per_unit)
    last = test if again is None else again
    _say(out, statements(last, rig.scene, rig.index), "")
    return last


def _confront_rigid(out: Checked, rig: _Rig, test: PriorTest) -> None:
    """Say where the file of a rigid rig contradicts the images; a turned or shifted camera of a held one is adjusted,
    unless images would lose their place by it."""
    refined = _refined(out.model, rig, test)
    # The test in a refined model, where the rest is no longer bent and the sigmas are better; else as it was
    again = None if refined is None else rig.prior_test(refined, test.system.metres_per_unit)
    last = again if again is not None and _mounts_freed(again) else test
    said = statements(last, rig.scene, rig.index, refined)
    followed = _followed(out.model, rig, refined) if said.contradictions else None
    if rig.ordered:
        how = "; held as given all the same (sparse.rig = fixed)"
    else:
        how = "" if followed is None else "; the images were followed, the other cameras held as given"
    _say(out, said, how)
    if followed is not None:
        out.model = followed
    if said.contradictions and rig.measured:
        _say_off(out, rig, last, followed is not None)


def _refined(model: pycolmap.Reconstruction, rig: _Rig, test: PriorTest) -> pycolmap.Reconstruction | None:
    """The model with the cameras that the images want elsewhere adjusted; None where none is, or none may be."""
    held = rig.request.held
    if not (_mounts_freed(test) and rig.fixed):
        return None
    fixed = [k + 1 for k in held.fixed]
    return refine(model, rig.scene, rig.index, test, fixed, held.cameras, rig.request.tuning.adjust)


def _mounts_freed(test: PriorTest) -> bool:
    return any(what == "mount" for what, _ in test.freed)


def _followed(
    model: pycolmap.Reconstruction, rig: _Rig, refined: pycolmap.Reconstruction | None
) -> pycolmap.Reconstruction | None:
    """The refined model, if it is to be taken."""
    if rig.ordered or refined is None or rig.lost(model, refined):
        return None
    return refined


def _say(out: Checked, said: RigEvidence, how: str) -> None:
    """Statements and contradictions into what is handed on; ``how`` the contradictions were dealt with."""
    out.statements += said.statements
    out.misfit = max(out.misfit, said.misfit)
    out.contradictions += [f"{line}{how}" for line in said.contradictions]


def _say_off(out: Checked, rig: _Rig, test: PriorTest, followed: bool) -> None:
    """How far off the mountings of a contradicted rig may be."""
    count, first = len(rig.scene.rigs[rig.index].sensors), rig.scene.first_sensor(rig.index)
    if count > 1:
        cameras = range(first + 1, first + count)
        off = mounting_errors(test, rig.scene, rig.index, cameras, rig.request.tuning.rig, followed, relaxed=False)
        out.off[rig.index + 1] = in_units(off, test.system.metres_per_unit)


def _ties(rig: _Rig, free: TimeCalibration, last: PriorTest | None, metres: float) -> RigConstraints:
    """What ties the cameras of a relaxed rig, with the errors of their mountings where these were measured."""
    if not rig.measured:
        return free.constraints
    off = mounting_errors(last, rig.scene, rig.index, free.constraints.cameras, rig.request.tuning.rig)
    return with_errors(free.constraints, in_units(off, metres))


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
