"""Rig diagnostics: which cameras are rigid in the rig, which fire at another time, and which are loose.

The matches between two cameras are compared with the model, and with the matches within each camera. A mapper that
holds a rig splits the points that contradict it, or leaves them out: the rest of two cameras that fire at different
times fits to a tenth of a pixel, and only their verified matches still show it (rendered vehicle, 0.5 m apart along
the path: 46 and 65 % of the matches between them agree with the model in two runs, 99 % of the matches within each
camera).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

from tiegraph.scene.colmapmodel import observations
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.jacobians import Layout
from tiegraph.sfm.covariance import Linearised
from tiegraph.sfm.rig.priortest import PriorTest
from tiegraph.sfm.systematic import Stray, strays_of
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import CameraMatchesTuning, DiagnosticsTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, rays_meet

OFFSET = "time offset ms"


@dataclass(frozen=True)
class RigDiagnostics:
    """Movement of each camera (sensor keys) of a rig from shot to shot; ``loose``: the cameras that are not rigid,
    and why."""

    strays: Mapping[int, Stray]
    loose: Mapping[int, str]

    def notes(self, scene: Scene) -> list[str]:
        """A sentence on each loose camera."""
        said = "is not rigid in the rig"
        return [
            f"camera {scene.all_sensors[key].name} {said}: {why} (it is not fixed, or the model is torn there)"
            for key, why in self.loose.items()
        ]

    def table(self, scene: Scene, metres_per_unit: float, late_ms: Mapping[int, float]) -> dict:
        """Table of the receipt; ``late_ms`` by sensor key."""
        rows: list[list[Any]] = []
        for key, stray in sorted(self.strays.items()):
            said = "not rigid" if key in self.loose else ""
            place, turn = round(metres_per_unit * stray.place, 4), round(float(np.degrees(stray.turn)), 3)
            rows.append([scene.all_sensors[key].name, place, turn, round(stray.px, 2), late_ms.get(key), said])
        return {"columns": ["camera", "strays m", "strays deg", "strays px", OFFSET, "verdict"], "rows": rows}


def rig_diagnostics(
    model: pycolmap.Reconstruction, scene: Scene, torn: Collection[int], metres_per_unit: float, tuning: Tuning
) -> RigDiagnostics:
    """Movement of the cameras of rigs from shot to shot, in a model whose cameras have their times; ``torn``: sensor
    keys (``torn_off``). Raises ValueError for a model without redundancy."""
    seen = Linearised(model, Layout(model, False, False), {}, tuning, tuning.rig.system.most_points)
    strays = strays_of(model, seen.weighed, np.flatnonzero(_mounted(scene)) + 1)
    found = {k - 1: stray for k, stray in strays.items()}
    loose = dict.fromkeys(torn, "most of its observations contradict the rig")
    worst = max(found, key=lambda k: found[k].gain, default=-1)  # the others move with it: they share points
    least = tuning.rig.diagnostics.min_scatter_px
    if worst >= 0 and found[worst].gain > LIMIT**2 / 2 and found[worst].px > least:
        stray = found[worst]
        size = f"{metres_per_unit * stray.place:.3f} m and {np.degrees(stray.turn):.2f} deg ({stray.px:.1f} px)"
        loose.setdefault(worst, f"it moves from shot to shot by {size}")
    return RigDiagnostics(found, loose)


def torn_off(
    before: pycolmap.Reconstruction,
    after: pycolmap.Reconstruction,
    scene: Scene,
    tests: Mapping[int, PriorTest],
    tuning: DiagnosticsTuning,
) -> list[int]:
    """Keys of sensors of rigs that lost more than half of their observations in the adjustment, and far more than the
    others, unless a contradiction between images and rig explains it."""
    counts = np.zeros((2, len(scene.all_sensors)))
    for row, model in zip(counts, (before, after)):
        np.add.at(row, scene.sensor_key, observations(model, scene))
    there = _mounted(scene) & (counts[0] >= tuning.min_sightings)
    if not there.any():
        return []
    kept = np.where(there, counts[1] / np.maximum(counts[0], 1), np.nan)
    least = min(tuning.min_kept, tuning.min_kept * float(np.nanmax(kept)))
    return [k for k in np.flatnonzero(there & (kept < least)).tolist() if not _explained(tests, scene, k)]


def _mounted(scene: Scene) -> np.ndarray:
    """(S,) bool of sensor keys: one of several cameras of a rig, not a view of a stitched image."""
    return np.concatenate([[len(r.sensors) > 1 and not r.stitched()] * len(r.sensors) for r in scene.rigs])


def _explained(tests: Mapping[int, PriorTest], scene: Scene, key: int) -> bool:
    """Whether times, or a mounting or lens other than given, explain why a camera's observations contradict the rig."""
    index = int(scene.rig[scene.frame[np.flatnonzero(scene.sensor_key == key)[0]]])
    freed = tests[index].freed if index in tests else ()
    return any(what == "times" or sensor == key - scene.first_sensor(index) for what, sensor in freed)


@dataclass(frozen=True)
class CameraMatches:
    """Two cameras (keys, from 0) of one rig, the number of image pairs with a verdict, the shares of matches that
    agree (between the two, and the smaller one within each), and whether the matches between them ask for another rig
    or other times."""

    first: int
    second: int
    pairs: int
    between: float
    own: float
    contradicted: bool


def camera_matches(
    verified: VerifiedMatches, seen: ImageObservations, scene: Scene, tuning: CameraMatchesTuning
) -> list[CameraMatches]:
    """All pairs of cameras of one rig with enough pairs of images, compared with the poses of a model."""
    explained = rays_meet(verified, seen)
    told = explained[:, 1] > 0
    rows, explained = verified.pairs[told], explained[told]
    cameras = np.sort(scene.sensor_key[rows], axis=1).reshape(-1, 2)
    rigs = scene.rig[scene.frame[rows]].reshape(-1, 2)
    share = {}
    for pair in np.unique(cameras[rigs[:, 0] == rigs[:, 1]], axis=0):
        of = (cameras == pair).all(axis=1)
        if of.sum() >= tuning.min_pairs:
            agree, all_ = explained[of].sum(axis=0)
            share[int(pair[0]), int(pair[1])] = (int(of.sum()), float(agree / all_))
    out = []
    for (a, b), (count, between) in share.items():
        if a != b and (a, a) in share and (b, b) in share:
            own = min(share[a, a][1], share[b, b][1])
            contradicted = 1 - between > max(tuning.contradicted, tuning.times * (1 - own))
            out.append(
                CameraMatches(first=a, second=b, pairs=count, between=between, own=own, contradicted=contradicted)
            )
    return out


def matches_table(found: Sequence[CameraMatches], scene: Scene) -> dict:
    """Table of the receipt, its own verdict in the last column."""
    names = [s.name for s in scene.all_sensors]
    columns = ["camera", "camera", "image pairs", "agree between %", "agree within %", "verdict"]
    rows = [
        [names[t.first], names[t.second], t.pairs, round(100 * t.between, 1), round(100 * t.own, 1),
         "contradicts the model" if t.contradicted else ""]
        for t in found
    ]  # fmt: skip
    return {"columns": columns, "rows": rows}


def matches_sentence(found: Sequence[CameraMatches], scene: Scene) -> list[str]:
    """One sentence on all contradicting pairs, with the worst named; none if nothing contradicts. Not for views of a
    panorama."""
    stitched = [rig.stitched() for rig in scene.rigs for _ in rig.sensors]
    bad = sorted((t for t in found if t.contradicted and not stitched[t.first]), key=lambda t: t.between)
    if not bad:
        return []
    names = [s.name for s in scene.all_sensors]
    worst, rest = bad[0], len(bad) - 1
    others = f" (and {rest} more)" if rest else ""
    return [
        f"ties between {names[worst.first]} and {names[worst.second]}{others}: {worst.between:.0%} of the matches "
        f"agree with the model, but {worst.own:.0%} of those within each camera; cameras of the rig fire at different "
        "times, or are mounted differently from the model"
    ]
