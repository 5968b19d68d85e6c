"""Tests of rigs and calibrations of an adjusted model against the images: contradicted values are adjusted or
reported."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import image_poses, observations
from tiegraph.scene.evidence import Statement
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import adjusted_to, final_adjustment, take_poses, thinned
from tiegraph.sfm.adjustment.constraints import PoseConstraints, rig_priors
from tiegraph.sfm.model import Findings
from tiegraph.sfm.motion import Lateness, Motion, at_one_instant, let_go
from tiegraph.sfm.rig.confront import PriorTest, mounting_errors, open_times, prior_test, refine
from tiegraph.sfm.rig.diagnostics import RigDiagnostics, rig_diagnostics, statements, torn_off
from tiegraph.sfm.rig.rig import units_per_metre
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import MatchSource


@dataclass(frozen=True)
class Held:
    """How the given values of rigs (scene indices) and cameras (COLMAP ids) are used."""

    modes: Mapping[int, str] = field(default_factory=dict)  # of the rigs that the model was made with (``rig_modes``)
    ordered: bool = False  # the user wants the rigs as given, whatever the images show
    unsupported: tuple[int, ...] = ()  # keys of sensors placed by the rig as given
    cameras: tuple[int, ...] = ()  # whose calibration stays
    lenses_ordered: bool = False  # by the user
    readout_ms: float | None = None  # of a rolling shutter; None: to be estimated

    def fixed(self) -> list[int]:
        """COLMAP ids of the rigs whose extrinsics stay."""
        return [k + 1 for k, mode in self.modes.items() if mode == "fixed"]


@dataclass(frozen=True)
class FinishRequest:
    """The input of finishing one model."""

    folder: Path
    target: Path
    scene: Scene
    tuning: Tuning
    held: Held
    images: Path | None = None  # None = no colours
    matched: MatchSource | None = None  # None: the place of frames is not tested
    covariance_frames: int = 0  # 0: no sigmas wanted
    rough: bool = False  # as the mapper left it

    def known(self, model: pycolmap.Reconstruction) -> PoseConstraints:
        """The values of rig files that are known with a sigma."""
        soft = [k for k, mode in self.held.modes.items() if mode == "soft"]
        return rig_priors(model, self.scene, soft, self.tuning.rig)

    def adjusted(
        self, model: pycolmap.Reconstruction, doubted: Sequence[int] = (), wide: float = 1.0
    ) -> pycolmap.Reconstruction:
        """A model adjusted with all given values of its rigs and lenses; ``wide``: factor on the tolerance for the
        errors of observations."""
        held, tuning = self.held, _wider(self.tuning, wide).adjust
        return final_adjustment(model, held.fixed(), held.cameras, self.known(model), doubted, tuning=tuning).model

    def lost(self, model: pycolmap.Reconstruction, changed: pycolmap.Reconstruction) -> list[str]:
        """Names of the images that lose their place in the changed model, if that has fewer images in total.

        An image counts if it sees enough points; without them it would still have a place from the rig.
        """
        before, after = (
            np.isfinite(image_poses(m, self.scene)).all(axis=(1, 2))
            & (observations(m, self.scene) >= self.tuning.adjust.min_points)
            for m in (model, changed)
        )
        return [self.scene.names[k] for k in np.flatnonzero(before & ~after)] if after.sum() < before.sum() else []


@dataclass(kw_only=True)
class Checked(Findings):
    """A model whose rigs were tested against the images, and the findings."""

    model: pycolmap.Reconstruction
    off: dict[int, np.ndarray] = field(default_factory=dict)  # rig id -> of mountings (``misplaced``)
    statements: list[Statement] = field(default_factory=list)
    late: dict[int, float] = field(default_factory=dict)  # camera id -> delay of those that fire at another time
    misfit: float = 0.0  # of the lever arms as given, where they are contradicted: a share


def _wider(tuning: Tuning, wide: float) -> Tuning:
    """For a model that is still far from its images: the tolerance for errors of observations is larger by this
    factor."""
    if wide == 1:
        return tuning
    own = tuning.adjust
    more = {"robust_px": wide * own.robust_px, "filter_px": wide * own.filter_px, "robust_rounds": 1}
    more["tolerance"] = own.rough_tolerance
    return tuning.model_copy(update={"adjust": own.model_copy(update=more)})


def checked_rig(out: Checked, mapped: pycolmap.Reconstruction, request: FinishRequest) -> Checked:
    """The model after rigs and calibrations were tested against the images. Contradicted values are adjusted, or
    reported only if the user wants them held."""
    scene, held = request.scene, request.held
    if request.rough:
        return out
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        if len(rig.sensors) == 1 and first + 1 in held.cameras:
            try:
                if test := prior_test(out.model, scene, index, 1.0, request.tuning):
                    _confront(out, request, index, test)
            except (RuntimeError, ValueError) as error:
                out.notes.append(f"the calibration of {rig.sensors[0].name} could not be checked: {error}")
    if not held.modes:
        return out
    model, metres = out.model, 1 / units_per_metre(out.model, scene, request.tuning.start.scale)
    several = [k for k, rig in enumerate(scene.rigs) if len(rig.sensors) > 1]
    try:
        tests = {k: test for k in several if (test := prior_test(model, scene, k, metres, request.tuning))}
        torn = torn_off(mapped, model, scene, tests, request.tuning)
        for index, test in tests.items():
            last = _with_times(out, mapped, request, index, test) if test.late() else test
            if held.modes.get(index) == "fixed":
                out.notes += open_times(last, scene.rigs[index])
            _confront(out, request, index, last, follow=last is test)
        found = rig_diagnostics(out.model, scene, torn, metres, request.tuning)
        _let_go_of_loose(out, request, found)
    except (RuntimeError, ValueError) as error:
        out.notes.append(f"the rig could not be checked: {error}")
        return out
    timed = all(t.system.timed for t in tests.values())
    late_ms = {k - 1: round(1000 * late, 1) for k, late in out.late.items() if timed}
    out.tables["rig diagnostics"] = found.table(scene, metres, late_ms)
    return out


def _with_times(
    out: Checked, mapped: pycolmap.Reconstruction, request: FinishRequest, index: int, test: PriorTest
) -> PriorTest:
    """The model with each camera of a rig at its own time, into ``out``, and the contradictions that remain;
    unchanged if the user wants that, or if fewer images would have a place."""
    scene, held, tuning = request.scene, request.held, request.tuning
    rig, first = scene.rigs[index], scene.first_sensor(index) + 1
    said = f"rig {rig.name}: its cameras fire at different times"
    if held.ordered:
        told = "it was held as requested (sparse.rig = fixed)"
        out.contradictions.append(f"{said}; it was {told}: {_times_text(rig, test, test.times_s())}")
        return test
    # Lens errors of a calibrated rig must not be absorbed by its times.
    measured = held.modes.get(index) in ("fixed", "soft")
    doubted = held.cameras if measured and not held.lenses_ordered else ()
    # The first rounds, with a wide tolerance, use few points: they only bring the times near.
    model, last, wide, near = out.model, test, tuning.rig.late_wide, False
    late = {k: (0.0, 0.0) for k in test.times_alone_s()}
    steps, few = late, thinned(mapped, tuning.adjust.few_points)
    for _ in range(10):  # at most, until each step is below its sigma
        late = {k: (late[k][0] + last.system.damped * step, sigma) for k, (step, sigma) in steps.items()}
        seconds = {first + k: time for k, (time, _) in late.items()}
        start = pycolmap.Reconstruction(mapped if wide == 1 else few)
        take_poses(start, model)
        motion = Motion(model, scene, tuning.shutter.max_gap_s)
        start = at_one_instant(start, model, motion, Lateness(seconds))
        if near:
            model = adjusted_to(start, held.fixed(), held.cameras, request.known(start), tuning=tuning.adjust)
        else:
            model = request.adjusted(start, doubted if wide == 1 else (), wide)
        again = prior_test(model, scene, index, test.system.metres_per_unit, _wider(tuning, wide))
        if again is None:
            return test
        last, steps, near = again, again.times_alone_s(), wide == 1
        if all(abs(step) < sigma for step, sigma in steps.values()):
            if near:
                break
            wide = 1.0
    turned = _refined(mapped, request, index, test)  # a camera mounted differently may look late
    left = [mapped.compute_num_observations() - m.compute_num_observations() for m in (turned or mapped, model)]
    if turned is not None and left[0] < tuning.mapping.clearly_fewer * left[1]:
        return test
    if lost := request.lost(out.model, model):
        out.contradictions.append(_lost_note(rig, lost, [said]))
        return test
    out.model, out.late = model, out.late | seconds
    out.notes.append(f"{said}: each has its own time in the model, {_times_text(rig, last, late)}")
    return last


def _times_text(rig: Rig, test: PriorTest, times: Mapping[int, tuple[float, float]]) -> str:
    """Delays of cameras (by their index in the rig) relative to the first, with sigmas."""
    factor, unit = (1000.0, "ms") if test.system.timed else (100.0, "% of the frame interval")
    each = [
        f"{rig.sensors[k].name} {factor * late:+.0f} +- {factor * sigma:.0f} {unit} "
        f"({abs(late) * test.system.speed:.2f} m at top speed)"
        for k, (late, sigma) in times.items()
    ]
    return f"after {rig.sensors[0].name}: {', '.join(each)}"


def _let_go_of_loose(out: Checked, request: FinishRequest, found: RigDiagnostics) -> None:
    """Cameras that are not rigid in a rig leave it, unless fewer images would have a place then."""
    scene, notes = request.scene, found.notes(request.scene)
    out.notes += notes
    loose = [k for k in found.loose if scene.sensor[scene.sensor_key == k].any()]  # all but references
    if not loose:
        return
    names = ", ".join(scene.all_sensors[k].name for k in loose)
    if request.held.ordered:
        out.contradictions.append(f"{names} stay in the rig as requested (sparse.rig = fixed), but are not rigid in it")
        return
    free = request.adjusted(let_go(out.model, {k + 1 for k in loose}, scene))
    if lost := request.lost(out.model, free):
        index = min(int(scene.rig[scene.frame[scene.sensor_key == k][0]]) for k in loose)
        out.contradictions.append(_lost_note(scene.rigs[index], lost, notes))
        return
    out.model = free
    out.notes.append(f"{names}: released from the rig, because their places in it differ from shot to shot")


def _confront(out: Checked, request: FinishRequest, index: int, test: PriorTest, follow: bool = True) -> None:
    """Report where the images contradict the file of a rig; a contradicted mounting of a held rig is adjusted, unless
    images would lose their place by it."""
    scene, held, tuning = request.scene, request.held, request.tuning
    rig = scene.rigs[index]
    refined = _refined(out.model, request, index, test) if follow else None
    # The test in a refined model, where the rest is no longer bent and the sigmas are better; else the first test
    metres = test.system.metres_per_unit
    again = None if refined is None else prior_test(refined, scene, index, metres, tuning)
    last = again if again is not None and again.mounts_freed() else test
    said = statements(last, scene, index, refined)
    use = bool(said.contradictions) and refined is not None and not held.ordered
    followed = refined if use and refined is not None and not request.lost(out.model, refined) else None
    how = "" if followed is None else "; these cameras were adjusted by the images, the others are held as given"
    if held.ordered and index in held.modes:
        how = "; they are held as given nevertheless (sparse.rig = fixed)"
    out.statements += said.statements
    out.misfit = max(out.misfit, said.misfit)
    out.contradictions += [f"{line}{how}" for line in said.contradictions]
    out.model = out.model if followed is None else followed
    if said.contradictions and held.modes.get(index) in ("fixed", "soft"):
        out.off[index + 1] = mounting_errors(last, rig, tuning.rig, followed is not None)


def _refined(
    model: pycolmap.Reconstruction, request: FinishRequest, index: int, test: PriorTest
) -> pycolmap.Reconstruction | None:
    """The model with the contradicted mountings adjusted; None if there are none, or none may be adjusted."""
    held = request.held
    if not test.mounts_freed() or held.modes.get(index) != "fixed":
        return None
    return refine(model, request.scene, index, test, held.fixed(), held.cameras, request.tuning.adjust)


def _lost_note(rig: Rig, lost: Sequence[str], why: Sequence[str]) -> str:
    names = ", ".join(lost[:3]) + (" ..." if len(lost) > 3 else "")
    return (
        f"rig {rig.name} stays as given although the images contradict it, because fewer images would be registered "
        f"otherwise: {len(lost)} would be lost ({names}). The contradictions: {'; '.join(why)}"
    )
