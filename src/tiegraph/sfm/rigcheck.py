"""Tests of rigs and calibrations of an adjusted model against the images: contradicted values are adjusted or
reported."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import image_poses, observations
from tiegraph.scene.evidence import Statement
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import adjusted_to, final_adjustment
from tiegraph.sfm.adjustment.fewpoints import take_poses
from tiegraph.sfm.adjustment.rigpriors import rig_priors
from tiegraph.sfm.consistency import MatchSource
from tiegraph.sfm.motion import Lateness, Motion, at_one_instant, let_go
from tiegraph.sfm.rig.confront import in_units, lens_prior_test, mounting_errors, open_times, prior_test, refine
from tiegraph.sfm.rig.diagnostics import RigDiagnostics, rig_diagnostics, torn_off
from tiegraph.sfm.rig.priortest import PriorTest
from tiegraph.sfm.rig.rigevidence import RigEvidence, statements
from tiegraph.sfm.rig.support import units_per_metre
from tiegraph.sfm.tuning import Tuning


@dataclass(frozen=True)
class Held:
    """How rigs (scene indices) and cameras (COLMAP ids) are held by given values."""

    rigs: tuple[int, ...] = ()  # that the model was made with
    fixed: tuple[int, ...] = ()  # rigs whose extrinsics stay
    soft: tuple[int, ...] = ()  # rigs whose extrinsics are known with a sigma
    ordered: tuple[int, ...] = ()  # rigs that the user wants as given, whatever the images show
    unsupported: tuple[int, ...] = ()  # keys of sensors placed by the rig as given
    cameras: tuple[int, ...] = ()  # whose calibration stays
    lenses_ordered: bool = False  # by the user
    readout_ms: float | None = None  # of a rolling shutter; None: to be estimated


@dataclass(frozen=True)
class FinishRequest:
    """The input of finishing one model, in picklable form."""

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
    """A model whose rigs were tested against the images, and the findings."""

    model: pycolmap.Reconstruction
    tables: dict[str, dict] = field(default_factory=dict)
    off: dict[int, np.ndarray] = field(default_factory=dict)  # rig id -> of mountings (``misplaced``)
    contradictions: list[str] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)
    late: dict[int, float] = field(default_factory=dict)  # camera id -> delay of those that fire at another time
    notes: list[str] = field(default_factory=list)
    misfit: float = 0.0  # of the lever arms as given, where they are contradicted: a share


@dataclass(frozen=True)
class _Rig:
    """Rig ``index`` of the scene with the data of its tests."""

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

    def prior_test(self, model: pycolmap.Reconstruction, metres_per_unit: float, wide: float = 1.0) -> PriorTest | None:
        """The given values that the images of a model contradict; ``wide``: as in ``adjusted``."""
        return prior_test(model, self.scene, self.index, metres_per_unit, _wider(self.request.tuning, wide))

    def lost(self, model: pycolmap.Reconstruction, changed: pycolmap.Reconstruction) -> tuple[int, ...]:
        """Images that lose their place in the changed model, if that has fewer images in total.

        An image counts if it sees enough points; without them it would still have a place from the rig.
        """
        least = self.request.tuning.adjust.min_points
        before, after = (
            np.isfinite(image_poses(m, self.scene)).all(axis=(1, 2)) & (observations(m, self.scene) >= least)
            for m in (model, changed)
        )
        return tuple(np.flatnonzero(before & ~after).tolist()) if after.sum() < before.sum() else ()

    def adjusted(
        self, model: pycolmap.Reconstruction, doubted: Sequence[int] = (), wide: float = 1.0
    ) -> pycolmap.Reconstruction:
        """A model adjusted with all given values of its rigs and lenses; ``wide``: factor on the tolerance for the
        errors of observations."""
        held, tuning = self.request.held, _wider(self.request.tuning, wide)
        known = rig_priors(model, self.scene, held.soft, tuning.rig.priors)
        fixed = [k + 1 for k in held.fixed]
        return final_adjustment(model, fixed, held.cameras, known, doubted, tuning=tuning.adjust).model

    def nearly(self, model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
        """The same for a model that is nearly adjusted."""
        held, tuning = self.request.held, self.request.tuning
        known = rig_priors(model, self.scene, held.soft, tuning.rig.priors)
        return adjusted_to(model, [k + 1 for k in held.fixed], held.cameras, known, tuning=tuning.adjust)


def _wider(tuning: Tuning, wide: float) -> Tuning:
    """For a model that is still far from its images: the tolerance for errors of observations is larger by this
    factor."""
    if wide == 1:
        return tuning
    own = tuning.adjust
    more = {"robust_px": wide * own.robust_px, "filter_px": wide * own.filter_px, "robust_rounds": 1}
    more["tolerance"] = 100 * own.tolerance  # another adjustment follows
    return tuning.model_copy(update={"adjust": own.model_copy(update=more)})


def checked_rig(
    model: pycolmap.Reconstruction, mapped: pycolmap.Reconstruction, scene: Scene, request: FinishRequest
) -> Checked:
    """The model after rigs and calibrations were tested against the images. Contradicted values are adjusted, or
    reported only if the user wants them held."""
    out = Checked(model)
    if not request.rough:
        _confront_single_lenses(out, scene, request)
    if not request.held.rigs:
        return out
    metres = 1 / units_per_metre(model, scene, request.tuning)
    try:
        tests = {k: t for k in range(len(scene.rigs)) if (t := _Rig(scene, k, request).prior_test(model, metres))}
        torn = torn_off(mapped, model, scene, tests, request.tuning.rig.diagnostics)
        for index, test in tests.items():
            rig = _Rig(scene, index, request)
            last = _with_times(out, mapped, rig, test) if test.late() else test
            if rig.fixed:
                out.notes += open_times(last, scene, index)
            _confront(out, rig, last, follow=last is test)
        found = rig_diagnostics(out.model, scene, torn, metres, request.tuning)
        _let_go_of_loose(out, scene, request, found)
    except (RuntimeError, ValueError) as error:
        out.notes.append(f"the rig could not be checked: {error}")
        return out
    timed = all(t.system.timed for t in tests.values())
    late_ms = {k - 1: round(1000 * late, 1) for k, late in out.late.items() if timed}
    out.tables["rig diagnostics"] = found.table(scene, metres, late_ms)
    return out


def _confront_single_lenses(out: Checked, scene: Scene, request: FinishRequest) -> None:
    """Test the held calibrations of single cameras."""
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        held = len(rig.sensors) == 1 and first + 1 in request.held.cameras
        try:
            test = lens_prior_test(out.model, scene, index, request.tuning) if held else None
        except (RuntimeError, ValueError) as error:
            out.notes.append(f"the calibration of {rig.sensors[0].name} could not be checked: {error}")
            continue
        if test is not None:
            _confront(out, _Rig(scene, index, request), test)


def _with_times(out: Checked, mapped: pycolmap.Reconstruction, rig: _Rig, test: PriorTest) -> PriorTest:
    """The model with each camera of a rig at its own time, into ``out``, and the contradictions that remain;
    unchanged if the user wants that, or if fewer images would have a place."""
    scene, held, tuning = rig.scene, rig.request.held, rig.request.tuning
    first = scene.first_sensor(rig.index) + 1
    said = f"rig {rig.name}: its cameras fire at different times"
    if rig.ordered:
        told = "it was held as requested (sparse.rig = fixed)"
        out.contradictions.append(f"{said}; it was {told}: {_times_text(rig, test, test.times_s())}")
        return test
    # Lens errors of a calibrated rig must not be absorbed by its times.
    doubted = held.cameras if rig.measured and not held.lenses_ordered else ()
    model, last, wide, near = out.model, test, tuning.rig.late_wide, False
    late = {k: (0.0, 0.0) for k in test.times_alone_s()}
    steps = late
    for _ in range(tuning.rig.late_rounds):
        late = {k: (late[k][0] + last.system.damped * step, sigma) for k, (step, sigma) in steps.items()}
        seconds = {first + k: time for k, (time, _) in late.items()}
        start = pycolmap.Reconstruction(mapped)
        take_poses(start, model)
        motion = Motion(model, scene, tuning.shutter.max_gap_s)
        start = at_one_instant(start, model, motion, Lateness(seconds))
        model = rig.nearly(start) if near else rig.adjusted(start, doubted if wide == 1 else (), wide)
        again = rig.prior_test(model, test.system.metres_per_unit, wide)
        if again is None:
            return test
        last, steps, near = again, again.times_alone_s(), wide == 1
        if all(abs(step) < sigma for step, sigma in steps.values()):
            if near:
                break
            wide = 1.0
    turned = _refined(mapped, rig, test)  # a camera mounted differently may look late
    left = [mapped.compute_num_observations() - m.compute_num_observations() for m in (turned or mapped, model)]
    if turned is not None and left[0] < tuning.mapping.clearly_fewer * left[1]:
        return test
    if lost := rig.lost(out.model, model):
        out.contradictions.append(_lost_note(scene, rig.index, lost, [said]))
        return test
    out.model, out.late = model, out.late | seconds
    out.notes.append(f"{said}: each has its own time in the model, {_times_text(rig, last, late)}")
    return last


def _times_text(rig: _Rig, test: PriorTest, times: Mapping[int, tuple[float, float]]) -> str:
    """Delays of cameras (by their index in the rig) relative to the first, with sigmas."""
    factor, unit = (1000.0, "ms") if test.system.timed else (100.0, "% of the frame interval")
    sensors = rig.scene.rigs[rig.index].sensors
    each = [
        f"{sensors[k].name} {factor * late:+.0f} +- {factor * sigma:.0f} {unit} "
        f"({abs(late) * test.system.speed:.2f} m at top speed)"
        for k, (late, sigma) in times.items()
    ]
    return f"after {sensors[0].name}: {', '.join(each)}"


def _let_go_of_loose(out: Checked, scene: Scene, request: FinishRequest, found: RigDiagnostics) -> None:
    """Cameras that are not rigid in a rig leave it, unless fewer images would have a place then."""
    out.notes += found.notes(scene)
    loose = [k for k in found.loose if scene.sensor[scene.sensor_key == k].any()]  # all but references
    rigs = {int(scene.rig[scene.frame[scene.sensor_key == k][0]]) for k in loose}
    if not loose:
        return
    rig = _Rig(scene, min(rigs), request)
    names = ", ".join(scene.all_sensors[k].name for k in loose)
    if rigs & set(request.held.ordered):
        out.contradictions.append(f"{names} stay in the rig as requested (sparse.rig = fixed), but are not rigid in it")
        return
    free = rig.adjusted(let_go(out.model, {k + 1 for k in loose}, scene))
    if lost := rig.lost(out.model, free):
        out.contradictions.append(_lost_note(scene, rig.index, lost, found.notes(scene)))
        return
    out.model = free
    out.notes.append(f"{names}: released from the rig, because their places in it differ from shot to shot")


def _confront(out: Checked, rig: _Rig, test: PriorTest, follow: bool = True) -> None:
    """Report where the images contradict the file of a rig; a contradicted mounting of a held rig is adjusted, unless
    images would lose their place by it."""
    refined = _refined(out.model, rig, test) if follow else None
    # The test in a refined model, where the rest is no longer bent and the sigmas are better; else the first test
    again = None if refined is None else rig.prior_test(refined, test.system.metres_per_unit)
    last = again if again is not None and _mounts_freed(again) else test
    said = statements(last, rig.scene, rig.index, refined)
    followed = _followed(out.model, rig, refined) if said.contradictions else None
    if rig.ordered:
        how = "; they are held as given nevertheless (sparse.rig = fixed)"
    else:
        how = "" if followed is None else "; these cameras were adjusted by the images, the others are held as given"
    _say(out, said, how)
    if followed is not None:
        out.model = followed
    if said.contradictions and rig.measured:
        _say_off(out, rig, last, followed is not None)


def _refined(model: pycolmap.Reconstruction, rig: _Rig, test: PriorTest) -> pycolmap.Reconstruction | None:
    """The model with the contradicted mountings adjusted; None if there are none, or none may be adjusted."""
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
    """The refined model, if it is to be used."""
    if rig.ordered or refined is None or rig.lost(model, refined):
        return None
    return refined


def _say(out: Checked, said: RigEvidence, how: str) -> None:
    """Add statements and contradictions to the findings; ``how``: what was done about the contradictions."""
    out.statements += said.statements
    out.misfit = max(out.misfit, said.misfit)
    out.contradictions += [f"{line}{how}" for line in said.contradictions]


def _say_off(out: Checked, rig: _Rig, test: PriorTest, followed: bool) -> None:
    """Record how far the mountings of a contradicted rig may be off."""
    count, first = len(rig.scene.rigs[rig.index].sensors), rig.scene.first_sensor(rig.index)
    if count > 1:
        cameras = range(first + 1, first + count)
        off = mounting_errors(test, rig.scene, rig.index, cameras, rig.request.tuning.rig, followed)
        out.off[rig.index + 1] = in_units(off, test.system.metres_per_unit)


def _lost_note(scene: Scene, index: int, lost: Sequence[int], why: Sequence[str]) -> str:
    names = ", ".join(scene.names[k] for k in lost[:3]) + (" ..." if len(lost) > 3 else "")
    return (
        f"rig {scene.rigs[index].name} stays as given although the images contradict it, because fewer images would "
        f"be registered otherwise: {len(lost)} would be lost ({names}). The contradictions: {'; '.join(why)}"
    )
