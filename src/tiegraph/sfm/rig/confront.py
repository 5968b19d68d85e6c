"""The rig as given against the images: what is said of it, and a model that gives way where it should."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import skew
from tiegraph.scene.evidence import LIMIT, Contradiction, Statement
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.constraints import PoseConstraints, SensorPrior
from tiegraph.sfm.model import model_rigs
from tiegraph.sfm.rig.linear import RigSystem, rig_system
from tiegraph.sfm.rig.priortest import Expected, Group, PriorTest, contradicted_priors, expected
from tiegraph.sfm.tuning import AdjustTuning, Tuning
from tiegraph.sfm.tuning.rig import RigTuning

_EXACTLY = 1e-6
GIVEN, IMAGES = "rig as given", "images"
_ONE_CAUSE = "the file of another rig, focal lengths or distortions unlike their calibration, or a torn model?"


def hear(
    model: pycolmap.Reconstruction, scene: Scene, index: int, metres_per_unit: float, tuning: Tuning
) -> PriorTest | None:
    """What the images of a model want otherwise of rig ``index``; None where too little tells.

    Of a rig whose geometry was measured: times, mountings, lenses. Of another, whose geometry the model found: times.
    """
    rig = scene.rigs[index]
    if len(rig.sensors) < 2 or not rig.known():
        return None
    measured = _measured(scene, index)
    lenses = _calibrated(model, scene, index) if measured else ()
    if measured:
        system = rig_system(model, scene, index, lenses, metres_per_unit, tuning)
    else:  # lengths of the model's rig are brought to metres, so that those of the system are
        found = [_scaled(s.sensor_from_rig, metres_per_unit) for s in model_rigs(model, scene)[index].sensors]
        sensors = tuple(replace(s, sensor_from_rig=p) for s, p in zip(rig.sensors, found))
        rigs = tuple(replace(r, sensors=sensors) if k == index else r for k, r in enumerate(scene.rigs))
        system = rig_system(model, scene.with_(rigs=rigs), index, lenses, metres_per_unit, tuning)
    if system is None:
        return None
    known = expected(rig, system.timed, tuning.rig)
    groups: list[Group] = [("times", -1)] if known.late_s > 0 or measured else []
    if measured:
        first = scene.first_sensor(index)
        groups += [("mount", k) for k in range(len(rig.sensors) - 1, -1, -1)]
        groups += [("lens", k) for k in range(len(rig.sensors)) if first + k + 1 in lenses]
    else:
        place, turn = ([s] * len(rig.sensors) for s in (tuning.rig.confront.loosely_m, tuning.rig.confront.loosely_deg))
        known = replace(known, place_m=place, turn_deg=turn)
    if not known.late_s:  # said to be synchronised: the images may say otherwise
        known = replace(known, late_s=expected(replace(rig, synchronised=False), system.timed, tuning.rig).late_s)
    return contradicted_priors(system, known, groups)


def hear_lens(model: pycolmap.Reconstruction, scene: Scene, index: int, tuning: Tuning) -> PriorTest | None:
    """The same of the calibration of a single camera, which is all that there is to contradict."""
    rig = scene.rigs[index]
    lenses = _calibrated(model, scene, index) if len(rig.sensors) == 1 and rig.measured() else ()
    if not lenses:
        return None
    alone = replace(rig, sensors=(replace(rig.sensors[0], sensor_from_rig=np.eye(4)),))
    rigs = tuple(alone if k == index else r for k, r in enumerate(scene.rigs))
    system = rig_system(model, scene.with_(rigs=rigs), index, lenses, 1.0, tuning)
    if system is None:
        return None
    system = system.only("lens")
    return contradicted_priors(system, expected(alone, system.timed, tuning.rig), [("lens", 0)])


def lever_sigmas(heard: PriorTest, scene: Scene, index: int) -> dict[int, float]:
    """Camera id -> sigma (m, root sum of squares) of its place against the reference, with times free unless said."""
    rig, system, tuning = scene.rigs[index], heard.system, heard.known.tuning
    first = scene.first_sensor(index)
    others = len(rig.sensors) - 1
    known = replace(
        expected(rig, system.timed, tuning),
        place_m=[_EXACTLY, *[tuning.prior_test.freed_m] * others],
        turn_deg=[_EXACTLY, *[tuning.prior_test.freed_deg] * others],
    )
    prior = known.sigma(system, (), times=True)
    prior[system.where("size")] = 0.0  # it is the size of these very levers
    sigma = system.solve(prior).sigma()
    out = {}
    for sensor in range(1, others + 1):
        at = [k for k in system.where("place") if system.keys[k][1] == sensor]
        out[first + sensor + 1] = float(np.linalg.norm(sigma[at]))
    return out


def open_times(heard: PriorTest, scene: Scene, index: int) -> list[str]:
    """A sentence on cameras of a rigid rig whose times the images leave open, which are then taken to fire together.

    At constant speed a camera's time and its place along the way are one unknown: all that is given beside the times is
    believed here. None of a rig that is said to be synchronised, nor where it moves nothing by more than is asked of
    a calibration.
    """
    rig, system, tuning = scene.rigs[index], heard.system, heard.known.tuning
    known = expected(rig, system.timed, tuning)
    if not known.late_s:
        return []
    sigma = system.solve(known.sigma(system, (), times=True)).sigma()
    late = {system.keys[k][1]: float(sigma[k]) for k in system.where("time")}
    names = [rig.sensors[k].name for k, s in late.items() if s * system.speed > LIMIT * tuning.confront.held_to_m]
    if not names:
        return []
    worst = max(late.values())
    said = f"{1000 * worst:.0f} ms" if system.timed else f"{worst:.0%} of the frame interval"
    return [
        f"rig {rig.name}: whether {', '.join(names)} fire{'s' if len(names) == 1 else ''} at the same time as "
        f"{rig.sensors[0].name} cannot be told by the images (to {said}, {worst * system.speed:.2g} m along the way): "
        "they are taken to; synchronised = true in the rig file says so"
    ]


def _measured(scene: Scene, index: int) -> bool:
    rig = scene.rigs[index]
    return rig.measured() or rig.soft()


def _scaled(pose: np.ndarray | None, factor: float) -> np.ndarray | None:
    return None if pose is None else transforms.rigid(pose[:3, :3], factor * pose[:3, 3])


def _calibrated(model: pycolmap.Reconstruction, scene: Scene, index: int) -> set[int]:
    """Ids of the rig's cameras whose calibration is the one that was given."""
    first = scene.first_sensor(index)
    out = set()
    for k, sensor in enumerate(scene.rigs[index].sensors):
        key = first + k + 1
        if sensor.camera is not None and key in model.cameras:
            if model.camera(key).model == sensor.camera.model and np.allclose(
                model.camera(key).params, sensor.camera.params
            ):
                out.add(key)
    return out


@dataclass(frozen=True)
class RigEvidence:
    """Statements on each camera of a rig, the sentences where two of them cannot both be right, and ``misfit``: by how
    much of its lever arm a camera stands elsewhere than given, where that is contradicted (root mean square of all)."""

    statements: tuple[Statement, ...]
    contradictions: tuple[str, ...]
    misfit: float = 0.0


def statements(
    heard: PriorTest, scene: Scene, index: int, refined: pycolmap.Reconstruction | None = None
) -> RigEvidence:
    """Place, turn, lens of each camera and times: as given, and by the images.

    ``refined``: a model adjusted with the freed mountings, which says better how far they are off than a first step.
    """
    rig, system = scene.rigs[index], heard.system
    rows: list[Statement] = []
    lines: list[str] = []
    off, elsewhere = np.zeros(len(rig.sensors)), set()
    if heard.beyond and len(rig.sensors) == 1:
        lines.append(
            f"camera {rig.sensors[0].name}: the images contradict its calibration by more than can be told: the focal "
            "length or distortion of another lens, zoom or image size?"
        )
    elif heard.beyond:
        names = ", ".join(rig.sensors[k].name for k in heard.beyond)
        lines.append(f"rig {rig.name}: the images contradict it by more than can be told apart ({names}): {_ONE_CAUSE}")
    for sensor, camera in enumerate(rig.sensors):
        if ("mount", sensor) in heard.freed:
            for pair in _mounting(heard, scene, index, sensor, refined):
                rows += pair
                found = _sentence(pair, f"camera {camera.name} is mounted otherwise than the rig file says, or moved")
                lines += found
                elsewhere |= {camera.name} if found else set()
                if found and pair[0].unit == "m":
                    off[sensor] = abs(pair[1].value)
        if ("lens", sensor) in heard.freed:
            pair = _focal(heard, scene, index, sensor)
            rows += pair
            lines += _sentence(pair, f"camera {camera.name} has another lens than its calibration says, or zoomed")
    if len(elsewhere) > 1:  # one cause: a bent model says little of which camera it is
        lines.append(
            f"rig {rig.name}: {len(elsewhere)} of its {len(rig.sensors)} cameras stand otherwise than its file says: "
            f"{_ONE_CAUSE}"
        )
    if rig.synchronised:
        for sensor, (late, sigma) in heard.times_s().items():
            unit = "ms" if system.timed else "% of the frame interval"
            factor = 1000.0 if system.timed else 100.0
            name, held_to = f"time of {rig.sensors[sensor].name}", heard.known.tuning.confront.held_to_time
            pair = (
                Statement(
                    quantity=name, source="rig file (synchronised)", value=0.0, sigma=held_to, unit=unit, used=True
                ),
                Statement(quantity=name, source=IMAGES, value=factor * late, sigma=factor * sigma, unit=unit),
            )
            rows += pair
            lines += _sentence(pair, "the cameras do not fire at one instant")
    return RigEvidence(tuple(rows), tuple(lines), _misfit(off, rig))


def _misfit(off: np.ndarray, rig: Rig) -> float:
    """Root mean square of the shares of their lever arms that the S cameras of a rig are off by (S,), metres."""
    if not off.any():
        return 0.0
    poses = np.stack([np.eye(4) if s.sensor_from_rig is None else s.sensor_from_rig for s in rig.sensors])
    lever = np.linalg.norm(transforms.centre(poses), axis=1)
    lever[0] = np.median(lever[1:])  # the reference's own is nothing
    return float(np.sqrt(np.sum((off / np.maximum(lever, 1e-3)) ** 2) / (len(lever) - 1)))


def mounting_errors(
    heard: PriorTest | None,
    scene: Scene,
    index: int,
    cameras: Sequence[int],
    tuning: RigTuning,
    followed: bool = False,
    relaxed: bool = True,
) -> np.ndarray:
    """(6S, 6S) mean products of how far S ``cameras`` (keys) beside the reference are off what a measured rig gives:
    place (m) and turn (rad) of each against the reference, along the axes of the rig.

    By the images, where a calibration is known as well as it is held to and what contradicts them is free; without
    images, as well as it is held to. ``followed``: the model stands where the images want it, and what they do not
    contradict is as well known as it was given. ``relaxed``: cameras have times of their own; of a rigid rig a time is
    a place along the way.
    """
    rig, bounds = scene.rigs[index], tuning.confront
    given = np.stack([np.eye(4) if s.sensor_from_rig is None else s.sensor_from_rig for s in rig.sensors])
    place = np.maximum([s.sigma_m or 0.0 for s in rig.sensors], bounds.held_to_m)
    turn = np.maximum([s.sigma_deg or 0.0 for s in rig.sensors], bounds.held_to_deg)
    sensors = np.array(cameras, int) - scene.first_sensor(index)
    if heard is None or heard.beyond:
        worse = (0.0, 0.0) if heard is None else (tuning.prior_test.freed_m, tuning.prior_test.freed_deg)
        sigma = [np.maximum(place, worse[0]), np.radians(np.maximum(turn, worse[1]))]
        return np.diag(np.repeat(np.stack(sigma, axis=1)[sensors].ravel(), 3) ** 2)
    system = heard.system
    known = expected(rig, system.timed, tuning)
    if not followed:
        known = replace(known, place_m=place.tolist(), turn_deg=turn.tolist())
    solution = system.solve(known.sigma(system, heard.freed, times=relaxed))
    rows = np.zeros((len(sensors), 6, len(system.keys)))
    reference = _unknowns(system, 0)
    for own, k in zip(rows, sensors.tolist()):
        own[:, _unknowns(system, k)], own[:, reference] = np.eye(6), -np.eye(6)
        own[:3, reference[3:]] += skew(transforms.centre(given[k]))  # turned, it swings the others
    flat, moment = rows.reshape(-1, len(system.keys)), solution.covariance
    if not followed:
        moment = moment + np.outer(solution.value, solution.value)
    return np.asarray(flat @ moment @ flat.T)


def in_units(moment: np.ndarray, metres_per_unit: float) -> np.ndarray:
    """``mounting_errors`` with places in units of the model."""
    scale = np.tile(np.repeat([1 / metres_per_unit, 1.0], 3), len(moment) // 6)
    return np.asarray(moment * np.outer(scale, scale))


def _unknowns(system: RigSystem, sensor: int) -> np.ndarray:
    """(6,) indices of a camera's place and turn."""
    at = [k for what in ("place", "turn") for k in system.where(what) if system.keys[k][1] == sensor]
    return np.array(at, int)


def _mounting(
    heard: PriorTest, scene: Scene, index: int, sensor: int, refined: pycolmap.Reconstruction | None
) -> list[tuple[Statement, Statement]]:
    """Of place and turn the axis that is off most, as given (0) and by the images, in the frame of the rig."""
    system, camera, held_to = heard.system, scene.rigs[index].sensors[sensor], heard.known.tuning.confront
    solution = heard.until(("mount", sensor))
    sigma = solution.sigma()
    out = []
    found = None if refined is None else _moved(refined, scene, index, sensor, system.metres_per_unit)
    for what, given, factor, unit in (
        ("place", max(camera.sigma_m or 0.0, held_to.held_to_m), 1.0, "m"),
        ("turn", max(camera.sigma_deg or 0.0, held_to.held_to_deg), 180 / np.pi, "deg"),
    ):
        at = [k for k in system.where(what) if system.keys[k][1] == sensor]
        values = factor * solution.value[at] if found is None else found[what]
        wide = np.hypot(factor * sigma[at], given)
        axis = int(np.argmax(np.abs(values) / wide))
        name = f"{what} of {camera.name} ({('right', 'down', 'forward')[axis]})"
        own = float(factor * sigma[at][axis])
        out.append(
            (
                Statement(quantity=name, source=GIVEN, value=0.0, sigma=given, unit=unit, used=True),
                Statement(quantity=name, source=IMAGES, value=float(values[axis]), sigma=own, unit=unit),
            )
        )
    return out


def _moved(
    model: pycolmap.Reconstruction, scene: Scene, index: int, sensor: int, metres_per_unit: float
) -> dict[str, np.ndarray]:
    """How a camera of the model's rig stands off the file: place (m) and turn (deg) in the rig frame."""
    rig = model_rigs(model, scene)[index]
    own, given = rig.sensors[sensor].sensor_from_rig, scene.rigs[index].sensors[sensor].sensor_from_rig
    assert own is not None and given is not None
    there, told = transforms.invert(_scaled_pose(own, metres_per_unit)), transforms.invert(given)
    turned = np.degrees(Rotation.from_matrix(there[:3, :3] @ told[:3, :3].T).as_rotvec())
    return {"place": there[:3, 3] - told[:3, 3], "turn": turned}


def _scaled_pose(pose: np.ndarray, factor: float) -> np.ndarray:
    return transforms.rigid(pose[:3, :3], factor * pose[:3, 3])


def _focal(heard: PriorTest, scene: Scene, index: int, sensor: int) -> tuple[Statement, Statement]:
    system, camera = heard.system, scene.rigs[index].sensors[sensor]
    assert camera.camera is not None
    at = next(k for k in system.where("lens") if system.keys[k][1:] == (sensor, 0))
    focal = float(camera.camera.mean_focal_length())
    name = f"focal length of {camera.name}"
    solution = heard.until(("lens", sensor))
    own = float(solution.sigma()[at])
    return (
        Statement(
            quantity=name,
            source="calibration",
            value=focal,
            sigma=heard.known.tuning.confront.held_to_lens * focal,
            unit="px",
            used=True,
        ),
        Statement(quantity=name, source=IMAGES, value=focal + float(solution.value[at]), sigma=own, unit="px"),
    )


def _sentence(pair: tuple[Statement, Statement], culprit: str) -> list[str]:
    first, second = pair
    sigmas = abs(first.value - second.value) / float(np.hypot(first.sigma, second.sigma))
    return [Contradiction(first, second, sigmas).text(culprit)] if sigmas > LIMIT else []


def refine(
    model: pycolmap.Reconstruction,
    scene: Scene,
    index: int,
    heard: PriorTest,
    fixed: Sequence[int],
    constant_cameras: Collection[int],
    tuning: AdjustTuning,
) -> pycolmap.Reconstruction:
    """The model adjusted with the freed mountings of a rigid rig about what is given, the others held.

    ``fixed``: COLMAP ids of the other rigs that stay. Needs pyceres.
    """
    known = expected(scene.rigs[index], heard.system.timed, heard.known.tuning)
    priors = _priors(scene, index, known, heard)
    others = [k for k in fixed if k != index + 1]
    return final_adjustment(model, others, constant_cameras, PoseConstraints(sensors=priors), tuning=tuning).model


def _priors(scene: Scene, index: int, known: Expected, heard: PriorTest) -> list[SensorPrior]:
    """The file's extrinsics; where the reference itself is the one that is off, all the others are free against it."""
    rig, units = scene.rigs[index], 1 / heard.system.metres_per_unit
    first = scene.first_sensor(index)
    every = ("mount", 0) in heard.freed
    out = []
    for k, sensor in enumerate(rig.sensors):
        if k == 0 or sensor.sensor_from_rig is None:
            continue
        free = every or ("mount", k) in heard.freed
        place = (known.tuning.prior_test.freed_m if free else known.place_m[k]) * units
        turn = np.radians(known.tuning.prior_test.freed_deg if free else known.turn_deg[k])
        covariance = np.diag([turn**2] * 3 + [place**2] * 3)
        out.append(
            SensorPrior(
                rig_id=index + 1,
                camera_id=first + k + 1,
                sensor_from_rig=_scaled_pose(sensor.sensor_from_rig, units),
                covariance=covariance,
            )
        )
    return out
