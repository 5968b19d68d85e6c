"""Which given values of a rig the images contradict (times, mountings, lenses), by comparison of models.

A late camera, a rotated camera and a wrong focal length all make images disagree with a rig, and each can absorb part
of the effect of another. So the hypotheses compete: of all groups of unknowns the one that explains most for its
number of parameters is freed (Bayesian information criterion: Schwarz 1978), then the next in addition, until none
explains more than chance. Gains are divided by the ratio of the points' scatter to that of independent errors.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.rig.linear import RigSolution, RigSystem
from tiegraph.sfm.tuning.rig import RigTuning

Group = tuple[str, int]  # "times" (-1), "mount" or "lens" of a sensor


@dataclass(frozen=True)
class Expected:
    """Prior sigmas of a rig's unknowns: of each sensor's place (m) and rotation (deg), of times (s); those of freed
    values are in ``tuning``."""

    place_m: Sequence[float]
    turn_deg: Sequence[float]
    late_s: float
    focal_px: Sequence[float]
    tuning: RigTuning

    def sigma(self, system: RigSystem, freed: Collection[Group] = (), times: bool = False) -> np.ndarray:
        """(K,) of the system's unknowns; 0 = held. ``times``: times are free as if their group were among the freed."""
        out, free = np.zeros(len(system.keys)), self.tuning.prior_test
        for k, (what, sensor, axis) in enumerate(system.keys):
            mount = ("mount", sensor) in freed
            if what == "place":
                out[k] = max(free.freed_m if mount else 0.0, self.place_m[sensor])
            elif what == "turn":
                out[k] = np.radians(max(free.freed_deg if mount else 0.0, self.turn_deg[sensor]))
            elif what == "time":
                out[k] = self.late_s if times or ("times", -1) in freed else 0.0
            elif ("lens", sensor) in freed:
                out[k] = free.freed_lens * (self.focal_px[sensor] if axis < 4 else 1.0)
        return out


def expected(rig: Rig, timed: bool, tuning: RigTuning) -> Expected:
    """Prior sigmas from a rig file; ``timed``: frames have times, otherwise times are counted in frame intervals."""
    place = [max(s.sigma_m or 0.0, tuning.prior_test.given_m) for s in rig.sensors]
    turn = [max(s.sigma_deg or 0.0, tuning.prior_test.given_deg) for s in rig.sensors]
    focal = [1.0 if s.camera is None else s.camera.mean_focal_length() for s in rig.sensors]
    return Expected(place_m=place, turn_deg=turn, late_s=_late(rig, timed, tuning), focal_px=focal, tuning=tuning)


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
    beyond: tuple[int, ...] = ()  # sensors that would move too far for one step of an adjustment: nothing is freed

    def until(self, group: Group) -> RigSolution:
        """The solution with this group and those freed before it: groups freed later absorb part of the same effect."""
        return self.system.solve(self.known.sigma(self.system, self.freed[: self.freed.index(group) + 1]))

    def times_s(self) -> dict[int, tuple[float, float]]:
        """Sensor of the rig -> its delay relative to the reference and sigma, if times were freed."""
        return self._times(self.solution) if ("times", -1) in self.freed else {}

    def times_alone_s(self) -> dict[int, tuple[float, float]]:
        """The same with everything else as given."""
        return self._times(self.system.solve(self.known.sigma(self.system, (), times=True)))

    def _times(self, solution: RigSolution) -> dict[int, tuple[float, float]]:
        sigma, system = solution.sigma(), self.system
        return {system.keys[k][1]: (float(solution.value[k]), float(sigma[k])) for k in system.where("time")}

    def open_s(self, rig: Rig) -> dict[int, float]:
        """Sensor of the rig -> sigma of its delay, s, where that moves it by more than the tolerance of a place: at
        constant speed a delay and a shift along the path are the same. All given values except the times are trusted.
        """
        tuning, system = self.known.tuning, self.system
        known, least = expected(rig, system.timed, tuning), LIMIT * tuning.confront.held_to_m
        times = self._times(system.solve(known.sigma(system, (), times=True))) if known.late_s else {}
        return {k: sigma for k, (_, sigma) in times.items() if sigma * system.speed > least}

    def late(self) -> bool:
        """Whether a camera certainly fires at another time than its reference, by a visible amount."""
        tuning, speed = self.known.tuning, self.system.speed
        least = LIMIT * tuning.confront.held_to_m
        times = self.times_s().values()
        return any(abs(t) > tuning.late_sigmas * sigma and abs(t) * speed > least for t, sigma in times)


def contradicted_priors(system: RigSystem, known: Expected, candidates: Collection[Group]) -> PriorTest:
    """Free groups among ``candidates`` as long as the images demand it."""
    bounds = known.tuning.prior_test
    freed: list[Group] = []
    now = system.solve(known.sigma(system, ()))
    while True:
        best: tuple[float, Group, RigSolution] | None = None
        for group in (g for g in candidates if g not in freed):
            then = system.solve(known.sigma(system, [*freed, group]))
            gain = then.gain - now.gain
            if gain < bounds.clear * system.observations / 2:
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
    """The same; nothing freed if a value exceeds its freed range, because the system is not linear there."""
    sigma = found.known.sigma(found.system, found.freed)
    of = [k for group in found.freed for k in _members(found.system, group)]
    sensors = sorted({found.system.keys[k][1] for k in of if abs(found.solution.value[k]) > LIMIT * sigma[k]})
    if not sensors:
        return found
    return replace(found, freed=(), beyond=tuple(sensors))


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
