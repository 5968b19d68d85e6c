"""Rig diagnostics: which cameras are rigid in the rig, which fire at another time, and which are loose; statements of
rig file and images on the rig.

The matches between two cameras are compared with the model, and with the matches within each camera. A mapper that
holds a rig splits the points that contradict it, or leaves them out: the rest of two cameras that fire at different
times fits to a tenth of a pixel, and only their verified matches still show it (rendered vehicle, 0.5 m apart along
the path: 46 and 65 % of the matches between them agree with the model in two runs, 99 % of the matches within each
camera).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import observations
from tiegraph.scene.evidence import LIMIT, Contradiction, Statement
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.jacobians import Layout
from tiegraph.sfm.covariance import Linearised
from tiegraph.sfm.rig.confront import TIMES, Group, PriorTest
from tiegraph.sfm.rig.linear import deviations
from tiegraph.sfm.systematic import Stray, strays_of
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import DiagnosticsTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, rays_meet

OFFSET = "time offset ms"
GIVEN, IMAGES = "rig as given", "images"
_ONE_CAUSE = (
    "is it the file of another rig, do focal lengths or distortions differ from their calibration, or is the model "
    "torn?"
)
MATCHES = ["camera", "camera", "image pairs", "agree between %", "agree within %", "verdict"]


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
    seen = Linearised(model, Layout(model, False, False), {}, tuning, tuning.rig.most_points)
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
    tuning: Tuning,
) -> list[int]:
    """Keys of sensors of rigs that lost more than half of their observations in the adjustment, and far more than the
    others, unless a contradiction between images and rig explains it."""
    counts = np.zeros((2, len(scene.all_sensors)))
    for row, model in zip(counts, (before, after)):
        np.add.at(row, scene.sensor_key, observations(model, scene))
    there = _mounted(scene) & (counts[0] >= tuning.adjust.min_images * tuning.adjust.min_points)
    if not there.any():
        return []
    kept = np.where(there, counts[1] / np.maximum(counts[0], 1), np.nan)
    least = tuning.rig.diagnostics.min_kept * min(1.0, float(np.nanmax(kept)))
    return [k for k in np.flatnonzero(there & (kept < least)).tolist() if not _explained(tests, scene, k)]


def _mounted(scene: Scene) -> np.ndarray:
    """(S,) bool of sensor keys: one of several cameras of a rig, not a view of a stitched image."""
    return np.concatenate([[len(r.sensors) > 1 and not r.stitched()] * len(r.sensors) for r in scene.rigs])


def _explained(tests: Mapping[int, PriorTest], scene: Scene, key: int) -> bool:
    """Whether times, or a mounting or lens other than given, explain why a camera's observations contradict the rig."""
    index = int(scene.rig[scene.frame[np.flatnonzero(scene.sensor_key == key)[0]]])
    freed = tests[index].freed if index in tests else ()
    return TIMES in freed or any(sensor == key - scene.first_sensor(index) for _, sensor in freed)


def camera_matches(
    verified: VerifiedMatches, seen: ImageObservations, scene: Scene, tuning: DiagnosticsTuning
) -> tuple[list[list[Any]], list[str]]:
    """Rows of ``MATCHES`` on the pairs of cameras of one rig with enough pairs of images, compared with the poses of a
    model: the share of the matches between the two that agree, and the smaller share within each. One sentence on the
    pairs whose matches ask for another rig or other times, with the worst named; not for views of a panorama."""
    explained = rays_meet(verified, seen)
    told = explained[:, 1] > 0
    rows, explained = verified.pairs[told], explained[told]
    cameras = np.sort(scene.sensor_key[rows], axis=1).reshape(-1, 2)
    rigs = scene.rig[scene.frame[rows]].reshape(-1, 2)
    share: dict[tuple[int, int], tuple[int, float]] = {}
    for pair in np.unique(cameras[rigs[:, 0] == rigs[:, 1]], axis=0):
        of = (cameras == pair).all(axis=1)
        if of.sum() >= tuning.min_pairs:
            agree, all_ = explained[of].sum(axis=0)
            share[int(pair[0]), int(pair[1])] = (int(of.sum()), float(agree / all_))
    names = [s.name for s in scene.all_sensors]
    stitched = [rig.stitched() for rig in scene.rigs for _ in rig.sensors]
    table: list[list[Any]] = []
    bad: list[tuple[float, tuple[int, int], float]] = []
    for (a, b), (count, between) in share.items():
        if a == b or (a, a) not in share or (b, b) not in share:
            continue
        own = min(share[a, a][1], share[b, b][1])
        contradicted = 1 - between > max(tuning.contradicted, tuning.times * (1 - own))
        verdict = "contradicts the model" if contradicted else ""
        table.append([names[a], names[b], count, round(100 * between, 1), round(100 * own, 1), verdict])
        if contradicted and not stitched[a]:
            bad.append((between, (a, b), own))
    if not bad:
        return table, []
    between, (a, b), own = min(bad, key=lambda one: one[0])
    others = f" (and {len(bad) - 1} more)" if len(bad) > 1 else ""
    return table, [
        f"ties between {names[a]} and {names[b]}{others}: {between:.0%} of the matches agree with the model, but "
        f"{own:.0%} of those within each camera; cameras of the rig fire at different times, or are mounted "
        "differently from the model"
    ]


@dataclass(frozen=True)
class RigEvidence:
    """Statements on each camera of a rig, sentences on those that contradict each other, and ``misfit``: the
    contradicted deviations of the cameras relative to their lever arms (root mean square of all)."""

    statements: tuple[Statement, ...]
    contradictions: tuple[str, ...]
    misfit: float = 0.0


@dataclass(frozen=True)
class _Pair:
    """One quantity of a sensor as given and from the images, and the sentence for a contradiction of both."""

    sensor: int
    given: Statement
    found: Statement
    culprit: str

    def contradiction(self) -> list[str]:
        """The sentence, if they contradict each other."""
        sigmas = abs(self.given.value - self.found.value) / float(np.hypot(self.given.sigma, self.found.sigma))
        return [Contradiction(self.given, self.found, sigmas).text(self.culprit)] if sigmas > LIMIT else []


def _pair(
    sensor: int,
    quantity: str,
    unit: str,
    source: str,
    given: tuple[float, float],
    found: tuple[float, float],
    culprit: str,
) -> _Pair:
    """``given`` by a source and ``found`` by the images: value and sigma."""
    each = ((source, given, True), (IMAGES, found, False))
    own, other = (
        Statement(quantity=quantity, source=name, value=float(v), sigma=float(s), unit=unit, used=used)
        for name, (v, s), used in each
    )
    return _Pair(sensor=sensor, given=own, found=other, culprit=culprit)


def statements(
    test: PriorTest, scene: Scene, index: int, refined: pycolmap.Reconstruction | None = None
) -> RigEvidence:
    """Place, rotation, lens of each camera and times: as given, and from the images.

    ``refined``: a model adjusted with the freed mountings; its deviations are more accurate than those of a first
    step.
    """
    rig = scene.rigs[index]
    mounted: list[_Pair] = []
    pairs: list[_Pair] = []
    for sensor in range(len(rig.sensors)):
        if ("mount", sensor) in test.freed:
            own = _mounting(test, scene, index, sensor, refined)
            mounted += own
            pairs += own
        if ("lens", sensor) in test.freed:
            pairs.append(_focal(test, scene, index, sensor))
    elsewhere = [p for p in mounted if p.contradiction()]
    times = _times(test, rig) if rig.synchronised else []
    return RigEvidence(
        statements=tuple(s for p in (*pairs, *times) for s in (p.given, p.found)),
        contradictions=(
            *_beyond_telling(test, rig),
            *(line for p in pairs for line in p.contradiction()),
            *_one_cause({p.sensor for p in elsewhere}, rig),
            *(line for p in times for line in p.contradiction()),
        ),
        misfit=_misfit({p.sensor: abs(p.found.value) for p in elsewhere if p.found.unit == "m"}, rig),
    )


def _beyond_telling(test: PriorTest, rig: Rig) -> list[str]:
    """Sentences on deviations so large that no figure is given."""
    if not test.beyond:
        return []
    if len(rig.sensors) == 1:
        return [
            f"camera {rig.sensors[0].name}: the images contradict its calibration by so much that no figure can be "
            "given: is it the focal length or distortion of another lens, zoom or image size?"
        ]
    names = ", ".join(rig.sensors[k].name for k in test.beyond)
    return [f"rig {rig.name}: the images contradict it by so much that no figures can be given ({names}): {_ONE_CAUSE}"]


def _one_cause(sensors: Collection[int], rig: Rig) -> list[str]:
    """A sentence for several deviating cameras: a bent model hardly shows which camera it is."""
    if len(sensors) < 2:
        return []
    many = f"{len(sensors)} of its {len(rig.sensors)} cameras"
    return [f"rig {rig.name}: {many} are mounted differently from its file: {_ONE_CAUSE}"]


def _times(test: PriorTest, rig: Rig) -> list[_Pair]:
    """The firing times of the cameras of a rig that is given as synchronised."""
    timed, held_to = test.system.timed, test.known.tuning.prior_test.held_to_time
    unit, factor = ("ms", 1000.0) if timed else ("% of the frame interval", 100.0)
    source, culprit = "rig file (synchronised)", "the cameras do not fire at one instant"
    return [
        _pair(
            k, f"time of {rig.sensors[k].name}", unit, source, (0.0, held_to), (factor * late, factor * sigma), culprit
        )
        for k, (late, sigma) in test.times_s().items()
    ]


def _misfit(off_m: Mapping[int, float], rig: Rig) -> float:
    """Root mean square of the deviations of the cameras of a rig relative to their lever arms, metres by sensor."""
    if not off_m:
        return 0.0
    poses = np.stack([np.eye(4) if s.sensor_from_rig is None else s.sensor_from_rig for s in rig.sensors])
    lever = np.linalg.norm(transforms.centre(poses), axis=1)
    lever[0] = np.median(lever[1:])  # the reference has no lever arm
    off = np.array([off_m.get(k, 0.0) for k in range(len(lever))])
    return float(np.sqrt(np.sum((off / np.maximum(lever, 1e-3)) ** 2) / (len(lever) - 1)))


def _mounting(
    test: PriorTest, scene: Scene, index: int, sensor: int, refined: pycolmap.Reconstruction | None
) -> list[_Pair]:
    """Place and rotation along the axis with the largest deviation, as given (0) and from the images, in the frame of
    the rig."""
    system, camera, held_to = test.system, scene.rigs[index].sensors[sensor], test.known.tuning.prior_test
    solution = test.until(("mount", sensor))
    sigma = solution.sigma()
    out = []
    culprit = f"camera {camera.name} is mounted differently from the rig file, or was moved"
    culprit += _or_late(test, ("mount", sensor))
    found = {} if refined is None else deviations(refined, scene, index, system.metres_per_unit)
    for what, given, factor, unit in (
        ("place", max(camera.sigma_m or 0.0, held_to.held_to_m), 1.0, "m"),
        ("turn", max(camera.sigma_deg or 0.0, held_to.held_to_deg), 180 / np.pi, "deg"),
    ):
        at = [k for k in system.where(what) if system.keys[k][1] == sensor]
        values = factor * np.array([found.get(system.keys[k], solution.value[k]) for k in at])
        wide = np.hypot(factor * sigma[at], given)
        axis = int(np.argmax(np.abs(values) / wide))
        name = f"{what} of {camera.name} ({('right', 'down', 'forward')[axis]})"
        own = values[axis], factor * sigma[at][axis]
        out.append(_pair(sensor, name, unit, GIVEN, (0.0, given), own, culprit))
    return out


def _or_late(test: PriorTest, group: Group) -> str:
    """A remark on times, if these would explain at least half as much as the freed values."""
    none, own, late = (test.solve(freed).gain for freed in ((), (group,), (TIMES,)))
    alike = late - none > (own - none) / 2
    return "; or cameras fire at different times, which has nearly the same effect here" if alike else ""


def _focal(test: PriorTest, scene: Scene, index: int, sensor: int) -> _Pair:
    """The calibrated focal length."""
    system, camera, held_to = test.system, scene.rigs[index].sensors[sensor], test.known.tuning.prior_test
    assert camera.camera is not None
    at = next(k for k in system.where("lens") if system.keys[k][1:] == (sensor, 0))
    focal = float(camera.camera.mean_focal_length())
    solution = test.until(("lens", sensor))
    given, found = (focal, held_to.held_to_lens * focal), (focal + solution.value[at], solution.sigma()[at])
    culprit = f"camera {camera.name} has another lens than its calibration, or was zoomed"
    culprit += _or_late(test, ("lens", sensor))
    return _pair(sensor, f"focal length of {camera.name}", "px", "calibration", given, found, culprit)
