"""Which given values of a rig the images contradict (times, mountings, lenses), by comparison of hypotheses.

A late camera, a rotated camera and a wrong focal length all make images disagree with a rig, and each can absorb part
of the effect of another. So the hypotheses compete: of all groups of unknowns the one that explains most for its
number of parameters is freed (Bayesian information criterion: Schwarz 1978), then the next in addition, until none
explains more than chance. Gains are divided by the ratio of the points' scatter to that of independent errors.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import skew
from tiegraph.scene.colmapmodel import model_rigs
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.constraints import PoseConstraints, sensor_priors
from tiegraph.sfm.rig.linear import RigSolution, RigSystem, rig_system
from tiegraph.sfm.tuning import AdjustTuning, Tuning
from tiegraph.sfm.tuning.rig import RigTuning

Group = tuple[str, int]  # "times" (-1), "mount" or "lens" of a sensor
TIMES: Group = ("times", -1)


@dataclass(frozen=True)
class Expected:
    """Prior sigmas of a rig's unknowns: ``mount`` (S, 2) of each sensor's place (m) and rotation (deg), ``late_s`` of
    times (s); those of freed values are in ``tuning``."""

    rig: Rig
    mount: np.ndarray
    late_s: float
    tuning: RigTuning

    def mounts(self, freed: Collection[Group]) -> np.ndarray:
        """(S, 2) sigmas of places and rotations, some of which are freed."""
        free = np.array([("mount", k) in freed for k in range(len(self.mount))])
        bounds = self.tuning.prior_test
        return np.where(free[:, None], np.maximum(self.mount, [bounds.freed_m, bounds.freed_deg]), self.mount)

    def sigma(self, system: RigSystem, freed: Collection[Group] = ()) -> np.ndarray:
        """(K,) of the system's unknowns; 0 = held."""
        out, mount = np.zeros(len(system.keys)), self.mounts(freed)
        for k, (what, sensor, axis) in enumerate(system.keys):
            if what == "place":
                out[k] = mount[sensor, 0]
            elif what == "turn":
                out[k] = np.radians(mount[sensor, 1])
            elif what == "time":
                out[k] = self.late_s if TIMES in freed else 0.0
            elif ("lens", sensor) in freed:
                camera = self.rig.sensors[sensor].camera
                assert camera is not None
                out[k] = self.tuning.prior_test.freed_lens * (camera.mean_focal_length() if axis < 4 else 1.0)
        return out


def _expected(rig: Rig, timed: bool, tuning: RigTuning, least: tuple[float, float] | None = None) -> Expected:
    """Prior sigmas from a rig file; ``timed``: frames have times, otherwise times are counted in frame intervals;
    ``least``: place (m) and rotation (deg) of a calibrated rig unless its file gives larger ones."""
    given = [[s.sigma_m or 0.0, s.sigma_deg or 0.0] for s in rig.sensors]
    least = least or (tuning.prior_test.given_m, tuning.prior_test.given_deg)
    return Expected(rig=rig, mount=np.maximum(given, least), late_s=_late(rig, timed, tuning), tuning=tuning)


def _late(rig: Rig, timed: bool, tuning: RigTuning) -> float:
    """Sigma of the delay of its cameras relative to the reference."""
    one = rig.synchronised or all(s.source is not None and s.source.rendered for s in rig.sensors)
    return 0.0 if one else tuning.late_s if timed else tuning.prior_test.unknown_share


def times_open(scene: Scene, timed: bool, tuning: RigTuning) -> dict[int, float]:
    """Camera id -> sigma of its delay relative to the reference, for cameras not given as synchronised."""
    out = {}
    for index, rig in enumerate(scene.rigs):
        late, first = _late(rig, timed, tuning), scene.first_sensor(index) + 1
        out |= {first + k: late for k in range(1, len(rig.sensors)) if late > 0}
    return out


@dataclass(frozen=True)
class PriorTest:
    """The groups that the images contradict, worst first, each with the solution in which it is free."""

    freed: tuple[Group, ...]
    solution: RigSolution
    system: RigSystem
    known: Expected
    beyond: tuple[int, ...] = ()  # sensors that would move too far for one step of an adjustment: they stay held

    def solve(self, freed: Collection[Group]) -> RigSolution:
        """The solution in which these groups are free."""
        return self.system.solve(self.known.sigma(self.system, freed))

    def until(self, group: Group) -> RigSolution:
        """The solution with this group and those freed before it: groups freed later absorb part of the same effect."""
        return self.solve(self.freed[: self.freed.index(group) + 1])

    def times(self, solution: RigSolution) -> dict[int, tuple[float, float]]:
        """Sensor of the rig -> its delay relative to the reference and sigma."""
        sigma, system = solution.sigma(), self.system
        return {system.keys[k][1]: (float(solution.value[k]), float(sigma[k])) for k in system.where("time")}

    def times_s(self) -> dict[int, tuple[float, float]]:
        """The same, if times were freed."""
        return self.times(self.solution) if TIMES in self.freed else {}

    def times_alone_s(self) -> dict[int, tuple[float, float]]:
        """The same with everything else as given."""
        return self.times(self.solve((TIMES,)))

    def out_of_reach(self) -> tuple[int, ...]:
        """The sensors with a freed value beyond the range in which it was freed."""
        sigma = self.known.sigma(self.system, self.freed)
        of = [k for group in self.freed for k in _members(self.system, group)]
        return tuple(sorted({self.system.keys[k][1] for k in of if abs(self.solution.value[k]) > LIMIT * sigma[k]}))

    def late(self) -> bool:
        """Whether a camera certainly fires at another time than its reference, by a visible amount."""
        tuning, speed = self.known.tuning, self.system.speed
        least = LIMIT * tuning.prior_test.held_to_m
        times = self.times_s().values()
        return any(abs(t) > LIMIT * sigma and abs(t) * speed > least for t, sigma in times)

    def mounts_freed(self) -> bool:
        """Whether the images contradict a mounting."""
        return any(what == "mount" for what, _ in self.freed)


def prior_test(
    model: pycolmap.Reconstruction, scene: Scene, index: int, metres_per_unit: float, tuning: Tuning
) -> PriorTest | None:
    """The values of rig ``index`` that the images of a model contradict; None if nothing is given, or if there are too
    few observations.

    For a rig with measured geometry: times, mountings, lenses. For a rig whose geometry was derived from the model:
    times. For a single camera: its calibration.
    """
    rig, count, least = scene.rigs[index], len(scene.rigs[index].sensors), None
    measured = rig.measured() or (rig.soft() and count > 1)
    lenses = _calibrated(model, scene, index) if measured else set()
    if count == 1:
        found, least = [np.eye(4)], (0.0, 0.0)
    elif measured:
        found = [s.sensor_from_rig for s in rig.sensors]
    else:  # the extrinsics of the model's rig are converted to metres, which gives a system in metres
        found = [s.sensor_from_rig for s in model_rigs(model, scene)[index].scaled(metres_per_unit).sensors]
        least = tuning.rig.nominal_m, tuning.rig.nominal_deg
    if not (lenses if count == 1 else rig.known()):
        return None
    sensors = [replace(s, sensor_from_rig=f) for s, f in zip(rig.sensors, found)]
    if least is not None:  # the sigmas of the file are not those of these extrinsics
        sensors = [replace(s, sigma_m=None, sigma_deg=None) for s in sensors]
    tested = replace(rig, sensors=tuple(sensors))
    scene = scene.with_(rigs=tuple(tested if k == index else r for k, r in enumerate(scene.rigs)))
    system = rig_system(model, scene, index, lenses, metres_per_unit, tuning)
    if system is None:
        return None
    known = _expected(tested, system.timed, tuning.rig, least)
    groups = [TIMES] if count > 1 and (known.late_s > 0 or measured) else []
    if not known.late_s:  # given as synchronised: the images may still contradict that
        known = replace(known, late_s=_late(replace(rig, synchronised=False), system.timed, tuning.rig))
    groups += [("mount", k) for k in range(count - 1, -1, -1)] if measured and count > 1 else []
    first = scene.first_sensor(index) + 1
    return _contradicted(system, known, [*groups, *(("lens", k) for k in range(count) if first + k in lenses)])


def _calibrated(model: pycolmap.Reconstruction, scene: Scene, index: int) -> set[int]:
    """Ids of the rig's cameras with an unchanged given calibration."""
    out = set()
    for key, sensor in enumerate(scene.rigs[index].sensors, start=scene.first_sensor(index) + 1):
        given, own = sensor.camera, model.camera(key) if key in model.cameras else None
        if given is not None and own is not None and own.model == given.model:
            out |= {key} if np.allclose(own.params, given.params) else set()
    return out


def _contradicted(system: RigSystem, known: Expected, candidates: Collection[Group]) -> PriorTest:
    """Free groups among ``candidates`` as long as the images demand it."""
    bounds = known.tuning.prior_test
    freed: list[Group] = []
    now = system.solve(known.sigma(system))
    while True:
        best: tuple[float, Group, RigSolution] | None = None
        for group in (g for g in candidates if g not in freed):
            then = system.solve(known.sigma(system, [*freed, group]))
            if then.gain - now.gain < bounds.clear * system.observations / 2:
                continue
            criterion = _criterion(system, then, now, group)
            if criterion > bounds.strong and (best is None or criterion > best[0]):
                best = criterion, group, then
        if best is None:
            return _within_reach(PriorTest(freed=tuple(freed), solution=now, system=system, known=known))
        _, group, now = best
        freed.append(group)
        for group in freed[:-1]:  # groups that the newest one explains as well
            less = [g for g in freed if g != group]
            then = system.solve(known.sigma(system, less))
            if _criterion(system, now, then, group) < bounds.strong:
                freed, now = less, then


def _within_reach(found: PriorTest) -> PriorTest:
    """The same. If a value exceeds its freed range nothing is freed, because the system is not linear there, except for
    times that the images demand: the test is made again with each camera at its own time."""
    sensors = found.out_of_reach()
    if not sensors:
        return found
    timed = replace(found, freed=(TIMES,), solution=found.solve((TIMES,)), beyond=sensors)
    use = TIMES in found.freed and not timed.out_of_reach()
    return timed if use else replace(timed, freed=(), solution=found.solution)


def _criterion(system: RigSystem, more: RigSolution, less: RigSolution, group: Group) -> float:
    """By how much a free group explains the images better than chance (BIC)."""
    # Variance of the unknowns over that of independent errors (median); at least 1
    formal = np.diag(more.formal)
    free = formal > 0
    gain = (more.gain - less.gain) / max(float(np.median(np.diag(more.covariance)[free] / formal[free])), 1.0)
    return float(gain - len(_members(system, group)) * np.log(system.observations))


def _members(system: RigSystem, group: Group) -> np.ndarray:
    kinds = {"times": ("time",), "mount": ("place", "turn"), "lens": ("lens",)}[group[0]]
    return np.array([k for k, key in enumerate(system.keys) if key[0] in kinds and group[1] in (-1, key[1])], int)


def open_times(test: PriorTest, rig: Rig) -> list[str]:
    """A sentence on the cameras of a rig whose firing times the images do not determine, all other values being
    trusted; they are taken as synchronised. At constant speed a delay and a shift along the path are the same."""
    system, tuning = test.system, test.known.tuning
    known = _expected(rig, system.timed, tuning)
    times = test.times(system.solve(known.sigma(system, (TIMES,)))) if known.late_s else {}
    late = {k: sigma for k, (_, sigma) in times.items() if sigma * system.speed > LIMIT * tuning.prior_test.held_to_m}
    if not late:
        return []
    names, worst = [rig.sensors[k].name for k in late], max(late.values())
    said = f"{1000 * worst:.0f} ms" if system.timed else f"{worst:.0%} of the frame interval"
    return [
        f"rig {rig.name}: the images do not show whether {', '.join(names)} fire{'s' if len(names) == 1 else ''} at "
        f"the same time as {rig.sensors[0].name} (sigma {said}, {worst * system.speed:.2g} m along the path): the "
        "cameras are assumed to be synchronised; synchronised = true in the rig file confirms it"
    ]


def mounting_errors(test: PriorTest, rig: Rig, tuning: RigTuning, followed: bool = False) -> np.ndarray:
    """(6S, 6S) mean products of the deviations of the S cameras beside the reference from a measured rig: place (model
    units) and rotation (rad) of each relative to the reference, along the axes of the rig.

    Estimated from the images, where calibrations have the sigmas they are held to and contradicted values are free.
    ``followed``: the model follows the images, and values that they do not contradict have their given sigmas.
    """
    system, count = test.system, len(rig.sensors)
    held = _expected(rig, system.timed, tuning, (tuning.prior_test.held_to_m, tuning.prior_test.held_to_deg))
    units = np.repeat([1 / system.metres_per_unit, 1.0], 3)
    if test.beyond:
        sigma = held.mounts([("mount", k) for k in range(count)])[1:] * [1.0, np.pi / 180]
        return np.diag((np.repeat(sigma, 3, axis=1) * units).ravel() ** 2)
    known = _expected(rig, system.timed, tuning) if followed else held
    solution = system.solve(known.sigma(system, test.freed))
    centres = transforms.centre(np.stack([s.sensor_from_rig for s in rig.sensors if s.sensor_from_rig is not None]))
    rows, reference = np.zeros((count - 1, 6, len(system.keys))), system.mounting(0)
    for own, k in zip(rows, range(1, count)):
        own[:, system.mounting(k)], own[:, reference] = np.eye(6), -np.eye(6)
        own[:3, reference[3:]] += skew(centres[k])  # its rotation moves the others
    flat, moment = (units[:, None] * rows).reshape(-1, len(system.keys)), solution.covariance
    if not followed:
        moment = moment + np.outer(solution.value, solution.value)
    return np.asarray(flat @ moment @ flat.T)


def refine(
    model: pycolmap.Reconstruction,
    scene: Scene,
    index: int,
    test: PriorTest,
    fixed: Sequence[int],
    constant_cameras: Collection[int],
    tuning: AdjustTuning,
) -> pycolmap.Reconstruction:
    """The model adjusted with the freed mountings of a rigid rig, starting from the given ones; the others are held.
    If the reference itself is wrong, all the others are free relative to it.

    ``fixed``: COLMAP ids of the other fixed rigs.
    """
    rig, units = scene.rigs[index], 1 / test.system.metres_per_unit
    freed = [("mount", k) for k in range(len(rig.sensors))] if ("mount", 0) in test.freed else test.freed
    sigma = _expected(rig, test.system.timed, test.known.tuning).mounts(freed) * [units, 1.0]
    priors = sensor_priors(model.rigs[index + 1], rig.scaled(units), scene.first_sensor(index), sigma)
    others = [k for k in fixed if k != index + 1]
    return final_adjustment(model, others, constant_cameras, PoseConstraints(sensors=priors), tuning=tuning).model
