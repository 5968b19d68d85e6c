"""Rig diagnostics in words and rows: which cameras keep their place, which fire at another time, which sit loose."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import image_poses, model_rigs, observations
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.rig.confront import prior_test
from tiegraph.sfm.rig.priortest import PriorTest
from tiegraph.sfm.rig.resections import Resections, SensorDiagnostics, resect_all, sensor_diagnostics, table_rows
from tiegraph.sfm.rig.timeoffset import TimeOffset, moved_in_time, rig_motion
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import DiagnosticsTuning, RigTuning, TimeOffsetTuning


@dataclass(frozen=True)
class RigDiagnostics:
    """Rows of the health file, health of each camera, rigs (scene indices) whose cameras do not move as one."""

    rows: list[list[Any]]
    sensors: tuple[SensorDiagnostics, ...]
    moving: tuple[int, ...]
    notes: list[str]
    timed: bool
    unstable: dict[int, float]  # sensor key -> scatter of its rotation, deg
    prior_tests: Mapping[int, PriorTest] = field(default_factory=dict)  # by rig: what the images want otherwise

    def table(self, offsets: Mapping[int, TimeOffset], tuning: RigTuning) -> dict:
        """Table of the receipt; ``offsets`` by sensor key, of relaxed rigs."""
        rows = [
            [
                h.name,
                h.frames,
                *(round(v, 4) for v in (h.place_m.size, h.place_m.scatter, h.place_m.expected)),
                *(round(v, 3) for v in (h.turn_deg.size, h.turn_deg.scatter, h.turn_deg.expected)),
                round(h.scatter_px, 2),
                round(h.scatter_ratio, 1),
                round(h.sure_ratio, 1),
                round(1000 * offsets[h.sensor].offset_s, 1) if h.sensor in offsets and self.timed else None,
                "" if h.rigid(tuning.diagnostics) else "outside its band",
            ]
            for h in self.sensors
        ]
        columns = [
            "camera", "frames", "off m", "scatter m", "expected m", "turned deg", "scatter deg", "expected deg",
            "scatter px", "scatter / expected", "at least", "time offset ms", "verdict",
        ]  # fmt: skip
        return {"columns": columns, "rows": rows}


def rig_diagnostics(
    model: pycolmap.Reconstruction,
    scene: Scene,
    metres_per_unit: float,
    tuning: Tuning,
    before: pycolmap.Reconstruction | None = None,
) -> RigDiagnostics:
    """Resect every camera against its rig, test its priors by the images, and judge what comes out.

    ``before``: the model before its adjustment. A camera that sits loose loses most of its sightings there.
    """
    found = resect_all(model, scene, metres_per_unit, tuning)
    health = sensor_diagnostics(found, scene, tuning.rig.diagnostics)
    tests = {
        k: j for k in range(len(scene.rigs)) if (j := prior_test(model, scene, k, metres_per_unit, tuning)) is not None
    }
    late = _late(tests, health, scene, tuning.rig.time_offset)
    rig_of = np.concatenate([[k] * len(r.sensors) for k, r in enumerate(scene.rigs)]) if scene.rigs else np.zeros(0)
    in_time = _in_time(found, model, scene, tests, metres_per_unit)
    scattered = {h.sensor: h for h in sensor_diagnostics(in_time, scene, tuning.rig.diagnostics)}
    still = {k for k, h in scattered.items() if h.rigid(tuning.rig.diagnostics)}
    torn = _torn_off(before, model, scene, tuning.rig.diagnostics)
    torn = {k: v for k, v in torn.items() if k not in still or not _explained(tests, scene, k)}
    moving, notes, loose = {int(rig_of[k]) for k in (*late, *torn)}, [], dict(torn)
    for key in torn:
        name = scene.all_sensors[key].name
        why = "it sits loose, fires apart, or the model is torn there"
        notes.append(f"most sightings of camera {name} contradict the rig: {why}")
    notes += [_late_note(scene, key, *late[key], tests[int(rig_of[key])], key in torn) for key in late]
    for h in (scattered[h.sensor] for h in health):
        scatter = (
            f"against the rig by {h.place_m.scatter:.3f} m and {h.turn_deg.scatter:.2f} deg ({h.scatter_px:.1f} px), "
            f"{h.scatter_ratio:.1f} x the expected, at least {h.sure_ratio:.1f} x by its {h.frames} frames"
        )
        if not h.rigid(tuning.rig.diagnostics):
            moving.add(int(rig_of[h.sensor]))
            loose[h.sensor] = h.turn_deg.scatter
            why = "(not rigid, not synchronised, or the model is torn there)"
            notes.append(f"camera {h.name} does not keep its place in the rig {why}: it scatters {scatter}")
        elif h.sure_ratio > tuning.rig.diagnostics.max_ratio:
            notes.append(f"camera {h.name} scatters {scatter}: too little to be seen, nothing is made of it")
    if len(loose) > 1:
        notes.append("of several cameras that scatter, the one with the largest ratio is the cause: they share points")
    timed = all(j.system.timed for j in tests.values())
    return RigDiagnostics(
        rows=table_rows(found, scene),
        sensors=health,
        moving=tuple(sorted(moving)),
        notes=notes,
        timed=timed,
        unstable=loose,
        prior_tests=tests,
    )


def _late(
    tests: Mapping[int, PriorTest], health: Sequence[SensorDiagnostics], scene: Scene, tuning: TimeOffsetTuning
) -> dict[int, tuple[float, float]]:
    """Sensor key -> time after the reference and sigma, where it surely fires apart and that can be seen."""
    expected = {h.sensor: h.place_m.expected for h in health}
    out = {}
    first = 0
    for index, rig in enumerate(scene.rigs):
        for sensor, (time, sigma) in tests[index].times_s().items() if index in tests else ():
            moves = abs(time) * tests[index].system.speed
            if abs(time) > tuning.sigmas * sigma and moves > tuning.min_effect * expected.get(first + sensor, 0.0):
                out[first + sensor] = (time, sigma)
        first += len(rig.sensors)
    return out


def _late_note(scene: Scene, key: int, time: float, sigma: float, test: PriorTest, torn: bool) -> str:
    unit, factor = ("ms", 1000.0) if test.system.timed else ("% of the frame interval", 100.0)
    name = scene.all_sensors[key].name
    name += ", where the model may be torn," if torn else " is not synchronised: it"
    return (
        f"camera {name} stands off its place in the rig along the motion, by up to "
        f"{abs(time) * test.system.speed:.2f} m, as if it fired {factor * time:+.0f} +- {factor * sigma:.0f} {unit} "
        "after the first"
    )


def _explained(tests: Mapping[int, PriorTest], scene: Scene, key: int) -> bool:
    """Whether times, or a mounting or lens other than given, say why a camera's sightings contradict the rig."""
    first = 0
    for index, rig in enumerate(scene.rigs):
        if first <= key < first + len(rig.sensors):
            freed = tests[index].freed if index in tests else ()
            return any(what == "times" or sensor == key - first for what, sensor in freed)
        first += len(rig.sensors)
    return False


def _in_time(
    found: Resections,
    model: pycolmap.Reconstruction,
    scene: Scene,
    tests: Mapping[int, PriorTest],
    metres: float,
) -> Resections:
    """The resections less what the motion does to cameras that fire apart: what is left is how loose they sit."""
    if not any(j.times_s() for j in tests.values()):
        return found
    poses = frame_poses(image_poses(model, scene), scene.with_(rigs=model_rigs(model, scene)))
    poses[:, :3, 3] *= metres
    columns = rig_motion(poses, scene).columns(scene.frame[found.image])
    shift, turn = found.shift_m.copy(), found.turn_deg.copy()
    for key in np.unique(scene.sensor_key[found.image]):
        rows = scene.sensor_key[found.image] == key
        moved = moved_in_time(found.residual()[rows], found.covariance[rows], columns[rows])
        shift[rows] -= moved[:, :3]
        turn[rows] -= np.degrees(moved[:, 3:])
    return replace(found, shift_m=shift, turn_deg=turn)


def _torn_off(
    before: pycolmap.Reconstruction | None, after: pycolmap.Reconstruction, scene: Scene, tuning: DiagnosticsTuning
) -> dict[int, float]:
    """Sensors of rigs that lost more than half of their sightings in the adjustment, and far more than the others."""
    if before is None:
        return {}
    counts = np.zeros((2, len(scene.all_sensors)))
    for row, model in zip(counts, (before, after)):
        np.add.at(row, scene.sensor_key, observations(model, scene))
    several = np.concatenate([[len(r.sensors) > 1] * len(r.sensors) for r in scene.rigs])
    there = several & (counts[0] >= tuning.min_sightings)
    kept = np.where(there, counts[1] / np.maximum(counts[0], 1), np.nan)
    if not there.any():
        return {}
    usual = float(np.nanmax(kept))
    least = min(tuning.min_kept, tuning.min_kept * usual)
    return {int(k): tuning.torn_deg for k in np.flatnonzero(there & (kept < least))}
