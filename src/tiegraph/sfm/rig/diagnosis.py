"""Rig health in words and rows: which cameras keep their place, which fire at another time, which sit loose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, image_poses, model_rigs, observations
from tiegraph.sfm.rig.health import SensorHealth, resect_all, sensor_health, table_rows
from tiegraph.sfm.rig.sync import TimeOffset, rig_motion, time_offset

MIN_SIGHTINGS = 200  # of a camera in all its images, to judge what an adjustment left of them
MIN_KEPT = 0.6
TORN_DEG = 1.0  # by which a camera with too few sightings left to be measured is let go


@dataclass(frozen=True)
class Diagnosis:
    """Rows of the health file, health of each camera, rigs (scene indices) whose cameras do not move as one."""

    rows: list[list[Any]]
    health: tuple[SensorHealth, ...]
    moving: tuple[int, ...]
    notes: list[str]
    timed: bool
    loose: dict[int, float]  # sensor key -> scatter of its rotation, deg

    def table(self, offsets: Mapping[int, TimeOffset]) -> dict:
        """Table of the receipt; ``offsets`` by sensor key, of relaxed rigs."""
        rows = [
            [
                h.name,
                h.frames,
                *(round(v, 4) for v in (float(np.linalg.norm(h.shift_m)), h.scatter_m, h.expected_m)),
                *(round(v, 3) for v in (h.turn_deg, h.scatter_deg, h.expected_deg)),
                round(h.scatter_px, 2),
                round(h.scatter_ratio, 1),
                round(h.sure_ratio, 1),
                round(1000 * offsets[h.sensor].offset_s, 1) if h.sensor in offsets and self.timed else None,
            ]
            for h in self.health
        ]
        columns = [
            "camera", "frames", "off m", "scatter m", "expected m", "turned deg", "scatter deg", "expected deg",
            "scatter px", "scatter / expected", "at least", "time offset ms",
        ]  # fmt: skip
        return {"columns": columns, "rows": rows}


def diagnose(
    model: pycolmap.Reconstruction, scene: Scene, metres_per_unit: float, before: pycolmap.Reconstruction | None = None
) -> Diagnosis:
    """Resect every camera against its rig and judge what comes out.

    ``before``: the model before its adjustment. A camera that sits loose loses most of its sightings there.
    """
    found = resect_all(model, scene, metres_per_unit)
    health = sensor_health(found, scene)
    poses = frame_poses(image_poses(model, scene), scene.with_(rigs=model_rigs(model, scene)))
    poses[:, :3, 3] *= metres_per_unit
    motion = rig_motion(poses, scene)
    rig_of = np.concatenate([[k] * len(r.sensors) for k, r in enumerate(scene.rigs)]) if scene.rigs else np.zeros(0)
    moving, notes, loose = set(), [], _torn_off(before, model, scene)
    for key in loose:
        moving.add(int(rig_of[key]))
        name = scene.all_sensors[key].name
        notes.append(f"camera {name} is not rigid or not synchronised: most of its sightings contradict the rig")
    for h in health:
        own = found.where(scene.sensor_key[found.image] == h.sensor)
        late = time_offset(own.residual(), own.covariance, motion.columns(scene.frame[own.image]))
        if late is not None and late.there(h.expected_m):
            moving.add(int(rig_of[h.sensor]))
            how = f"it stands off its place in the rig along the motion, by up to {late.moves_m:.2f} m"
            notes.append(f"camera {h.name} is not synchronised: {how}")
        elif not h.rigid():
            moving.add(int(rig_of[h.sensor]))
            loose[h.sensor] = h.scatter_deg
            notes.append(
                f"camera {h.name} is not rigid or not synchronised: it scatters against the rig by {h.scatter_m:.3f} m "
                f"and {h.scatter_deg:.2f} deg ({h.scatter_px:.1f} px), {h.scatter_ratio:.1f} x the expected, at least "
                f"{h.sure_ratio:.1f} x by its {h.frames} frames"
            )
    if len(loose) > 1:
        notes.append("of several cameras that scatter, the one with the largest ratio is the cause: they share points")
    return Diagnosis(table_rows(found, scene), health, tuple(sorted(moving)), notes, motion.timed, loose)


def _torn_off(before: pycolmap.Reconstruction | None, after: pycolmap.Reconstruction, scene: Scene) -> dict[int, float]:
    """Sensors of rigs that lost more than half of their sightings in the adjustment, and far more than the others."""
    if before is None:
        return {}
    counts = np.zeros((2, len(scene.all_sensors)))
    for row, model in zip(counts, (before, after)):
        np.add.at(row, scene.sensor_key, observations(model, scene))
    several = np.concatenate([[len(r.sensors) > 1] * len(r.sensors) for r in scene.rigs])
    there = several & (counts[0] >= MIN_SIGHTINGS)
    kept = np.where(there, counts[1] / np.maximum(counts[0], 1), np.nan)
    if not there.any():
        return {}
    usual = float(np.nanmax(kept))
    return {int(k): TORN_DEG for k in np.flatnonzero(there & (kept < min(MIN_KEPT, MIN_KEPT * usual)))}
