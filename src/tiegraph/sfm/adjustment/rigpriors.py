"""Values of a rig file with a sigma, as residuals of the final adjustment (paper 001: fixed baselines and axes)."""

from collections.abc import Collection

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.constraints import PairPrior, PoseConstraints, RelativePosePrior, SensorPrior
from tiegraph.sfm.adjustment.leverarmprior import NominalGeometry
from tiegraph.sfm.tuning.rig import RigPriorTuning, RigTuning


def rig_priors(
    model: pycolmap.Reconstruction, scene: Scene, rigs: Collection[int], tuning: RigPriorTuning
) -> PoseConstraints:
    """Priors of the rigs (scene indices) of a metric model, and of nominal rigs of any model.

    Sensors without a sigma in a rig where others have one stay as given.
    """
    sensors: list[SensorPrior] = []
    pairs: list[PairPrior] = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        if index in rigs and index + 1 in model.rigs:
            sensors += _sensors(model.rigs[index + 1], rig, index, first, tuning)
            pairs += _pairs(rig, index, first, tuning)
    return PoseConstraints(sensors=sensors, pairs=pairs, nominal=nominal_geometry(model, scene))


def of_one_shot(model: pycolmap.Reconstruction, scene: Scene, tuning: RigTuning) -> tuple[RelativePosePrior, ...]:
    """Constraints between the images of one frame of the scene that are separate frames of a metric model.

    Cameras that fire at different times are at the place the motion had reached when they fired. Bending the path
    over its length changes nothing there. Without this constraint an adjustment with positions took PandaSet, whose
    back camera shares few points with the others, from 22 to 59 mm.
    """
    turn, shift = np.radians(tuning.held_deg), tuning.held_m
    covariance = np.diag([turn**2] * 3 + [shift**2] * 3)
    first: dict[int, int] = {}
    tied: dict[int, RelativePosePrior] = {}
    for index in np.argsort(scene.sensor, kind="stable"):
        image = model.find_image_with_name(scene.names[index])
        if image is None or not image.has_pose or image.frame_id in tied:
            continue
        reference = model.image(first.setdefault(int(scene.frame[index]), image.image_id))
        if reference.frame_id != image.frame_id:
            poses = (model.frame(i.frame_id).rig_from_world for i in (reference, image))
            a, b = (matrix(p) for p in poses if p is not None)
            tied[image.frame_id] = RelativePosePrior(
                first=reference.image_id,
                second=image.image_id,
                second_from_first=b @ transforms.invert(a),
                covariance=covariance,
            )
    return tuple(tied.values())


def nominal_geometry(model: pycolmap.Reconstruction, scene: Scene) -> dict[int, NominalGeometry]:
    """Centres of the cameras of nominal rigs, by rig id and camera id, in the frame of the model's
    reference, metres."""
    out: dict[int, NominalGeometry] = {}
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        if rig.nominal and index + 1 in model.rigs:
            reference = rig.sensors[model.rigs[index + 1].ref_sensor_id.id - 1 - first].sensor_from_rig
            out[index + 1] = {
                first + k + 1: transforms.centre(s.sensor_from_rig @ transforms.invert(reference))
                for k, s in enumerate(rig.sensors)
                if s.sensor_from_rig is not None and reference is not None
            }
    return out


def _sensors(row: pycolmap.Rig, rig: Rig, index: int, first: int, tuning: RigPriorTuning) -> list[SensorPrior]:
    reference = row.ref_sensor_id.id - 1 - first
    base = rig.sensors[reference].sensor_from_rig
    if base is None:
        return []
    only_pairs = not any(s.soft() for s in rig.sensors[1:])
    out = []
    for place, sensor in enumerate(rig.sensors):
        if place == reference or sensor.sensor_from_rig is None:
            continue
        relative = sensor.sensor_from_rig @ transforms.invert(base)
        sigma_deg, sigma_m = sensor.sigma_deg or 0.0, sensor.sigma_m or 0.0
        if only_pairs:
            sigma_deg, sigma_m = tuning.free_deg, tuning.free_m
        turn, shift = np.radians(max(sigma_deg, tuning.least_deg)), max(sigma_m, tuning.least_m)
        covariance = np.diag([turn**2] * 3 + [shift**2] * 3)
        out.append(
            SensorPrior(rig_id=index + 1, camera_id=first + place + 1, sensor_from_rig=relative, covariance=covariance)
        )
    return out


def _pairs(rig: Rig, index: int, first: int, tuning: RigPriorTuning) -> list[PairPrior]:
    out = []
    for pair in rig.pairs:
        cameras = (first + rig.index(pair.sensors[0]) + 1, first + rig.index(pair.sensors[1]) + 1)
        angle = None if pair.axis_deg is None else float(np.radians(pair.axis_deg))
        turn = float(np.radians(max(pair.axis_sigma_deg or 0.0, tuning.least_deg)))
        length = max(pair.baseline_sigma_m or 0.0, tuning.least_m)
        out.append(
            PairPrior(
                rig_id=index + 1,
                cameras=cameras,
                length=pair.baseline_m,
                length_sigma=length,
                angle_rad=angle,
                angle_sigma_rad=turn,
            )
        )
    return out
