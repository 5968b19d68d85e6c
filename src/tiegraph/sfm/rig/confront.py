"""The rig as given tested against the images, and the model adjusted where the images contradict the rig."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import skew
from tiegraph.scene.colmapmodel import model_rigs
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.constraints import PoseConstraints, SensorPrior
from tiegraph.sfm.rig.linear import RigSystem, rig_system
from tiegraph.sfm.rig.priortest import Expected, Group, PriorTest, contradicted_priors, expected
from tiegraph.sfm.tuning import AdjustTuning, Tuning
from tiegraph.sfm.tuning.rig import RigTuning


def prior_test(
    model: pycolmap.Reconstruction, scene: Scene, index: int, metres_per_unit: float, tuning: Tuning
) -> PriorTest | None:
    """The values of rig ``index`` that the images of a model contradict; None if there are too few observations.

    For a rig with measured geometry: times, mountings, lenses. For a rig whose geometry was derived from the model:
    times.
    """
    rig = scene.rigs[index]
    if len(rig.sensors) < 2 or not rig.known():
        return None
    measured = _measured(scene, index)
    lenses = _calibrated(model, scene, index) if measured else ()
    if measured:
        system = rig_system(model, scene, index, lenses, metres_per_unit, tuning)
    else:  # the extrinsics of the model's rig are converted to metres, which gives a system in metres
        found = model_rigs(model, scene)[index].scaled(metres_per_unit).sensors
        sensors = tuple(replace(s, sensor_from_rig=f.sensor_from_rig) for s, f in zip(rig.sensors, found))
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
    if not known.late_s:  # given as synchronised: the images may still contradict that
        known = replace(known, late_s=expected(replace(rig, synchronised=False), system.timed, tuning.rig).late_s)
    return contradicted_priors(system, known, groups)


def lens_prior_test(model: pycolmap.Reconstruction, scene: Scene, index: int, tuning: Tuning) -> PriorTest | None:
    """The same test for the calibration of a single camera, the only given value that images can contradict there."""
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


def open_times(test: PriorTest, scene: Scene, index: int) -> list[str]:
    """A sentence on the cameras of a rig whose firing times the images do not determine; they are taken as
    synchronised."""
    rig, system, late = scene.rigs[index], test.system, test.open_s(scene.rigs[index])
    if not late:
        return []
    names, worst = [rig.sensors[k].name for k in late], max(late.values())
    said = f"{1000 * worst:.0f} ms" if system.timed else f"{worst:.0%} of the frame interval"
    return [
        f"rig {rig.name}: the images do not show whether {', '.join(names)} fire{'s' if len(names) == 1 else ''} at "
        f"the same time as {rig.sensors[0].name} (sigma {said}, {worst * system.speed:.2g} m along the path): the "
        "cameras are assumed to be synchronised; synchronised = true in the rig file confirms it"
    ]


def _measured(scene: Scene, index: int) -> bool:
    rig = scene.rigs[index]
    return rig.measured() or rig.soft()


def _calibrated(model: pycolmap.Reconstruction, scene: Scene, index: int) -> set[int]:
    """Ids of the rig's cameras with an unchanged given calibration."""
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


def mounting_errors(
    test: PriorTest | None,
    scene: Scene,
    index: int,
    cameras: Sequence[int],
    tuning: RigTuning,
    followed: bool = False,
) -> np.ndarray:
    """(6S, 6S) mean products of the deviations of S ``cameras`` (keys) beside the reference from a measured rig:
    place (m) and rotation (rad) of each relative to the reference, along the axes of the rig.

    Estimated from the images, where calibrations have the sigmas they are held to and contradicted values are free;
    without images, from these sigmas. ``followed``: the model follows the images, and values that they do not
    contradict have their given sigmas.
    """
    rig, bounds = scene.rigs[index], tuning.confront
    given = np.stack([np.eye(4) if s.sensor_from_rig is None else s.sensor_from_rig for s in rig.sensors])
    place = np.maximum([s.sigma_m or 0.0 for s in rig.sensors], bounds.held_to_m)
    turn = np.maximum([s.sigma_deg or 0.0 for s in rig.sensors], bounds.held_to_deg)
    sensors = np.array(cameras, int) - scene.first_sensor(index)
    if test is None or test.beyond:
        worse = (0.0, 0.0) if test is None else (tuning.prior_test.freed_m, tuning.prior_test.freed_deg)
        sigma = [np.maximum(place, worse[0]), np.radians(np.maximum(turn, worse[1]))]
        return np.diag(np.repeat(np.stack(sigma, axis=1)[sensors].ravel(), 3) ** 2)
    system = test.system
    known = expected(rig, system.timed, tuning)
    if not followed:
        known = replace(known, place_m=place.tolist(), turn_deg=turn.tolist())
    solution = system.solve(known.sigma(system, test.freed))
    rows = np.zeros((len(sensors), 6, len(system.keys)))
    reference = _unknowns(system, 0)
    for own, k in zip(rows, sensors.tolist()):
        own[:, _unknowns(system, k)], own[:, reference] = np.eye(6), -np.eye(6)
        own[:3, reference[3:]] += skew(transforms.centre(given[k]))  # its rotation moves the others
    flat, moment = rows.reshape(-1, len(system.keys)), solution.covariance
    if not followed:
        moment = moment + np.outer(solution.value, solution.value)
    return np.asarray(flat @ moment @ flat.T)


def in_units(moment: np.ndarray, metres_per_unit: float) -> np.ndarray:
    """``mounting_errors`` with places in model units."""
    scale = np.tile(np.repeat([1 / metres_per_unit, 1.0], 3), len(moment) // 6)
    return np.asarray(moment * np.outer(scale, scale))


def _unknowns(system: RigSystem, sensor: int) -> np.ndarray:
    """(6,) indices of a camera's place and rotation."""
    at = [k for what in ("place", "turn") for k in system.where(what) if system.keys[k][1] == sensor]
    return np.array(at, int)


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

    ``fixed``: COLMAP ids of the other fixed rigs.
    """
    known = expected(scene.rigs[index], test.system.timed, test.known.tuning)
    priors = _priors(scene, index, known, test)
    others = [k for k in fixed if k != index + 1]
    return final_adjustment(model, others, constant_cameras, PoseConstraints(sensors=priors), tuning=tuning).model


def _priors(scene: Scene, index: int, known: Expected, test: PriorTest) -> list[SensorPrior]:
    """The file's extrinsics as priors; if the reference itself is wrong, all the others are free relative to it."""
    rig, units = scene.rigs[index], 1 / test.system.metres_per_unit
    first = scene.first_sensor(index)
    every = ("mount", 0) in test.freed
    out = []
    for k, sensor in enumerate(rig.scaled(units).sensors):
        if k == 0 or sensor.sensor_from_rig is None:
            continue
        free = every or ("mount", k) in test.freed
        place = (known.tuning.prior_test.freed_m if free else known.place_m[k]) * units
        turn = np.radians(known.tuning.prior_test.freed_deg if free else known.turn_deg[k])
        covariance = np.diag([turn**2] * 3 + [place**2] * 3)
        out.append(
            SensorPrior(
                rig_id=index + 1,
                camera_id=first + k + 1,
                sensor_from_rig=sensor.sensor_from_rig,
                covariance=covariance,
            )
        )
    return out
