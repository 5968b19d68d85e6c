"""Sensors with too few ties to determine their own calibration: their place in the rig stays as given.

A camera that looks at sky and bridge decks has few true ties and some false ones. Refined with the rig it diverges:
on ``canal`` the up camera's focal length by a factor of four and its place by 24 m, and no residual shows it.
"""

from collections.abc import Mapping

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses, matrix, rigid3d, sensor_id
from tiegraph.scene.scene import Scene
from tiegraph.sfm.database import ViewGraph
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import SupportTuning


def unsupported_sensors(
    scene: Scene, graph: ViewGraph, modes: Mapping[int, str], tuning: SupportTuning
) -> tuple[int, ...]:
    """Keys of sensors of refined rigs most of whose images have fewer than two verified pairs; never a reference."""
    out = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        if modes.get(index) == "refined":
            for place in range(1, len(rig.sensors)):
                degree = graph.degree[scene.sensor_key == first + place]
                if len(degree) and np.mean(degree >= tuning.min_ties) < tuning.min_share:
                    out.append(first + place)
    return tuple(out)


def ties_of(scene: Scene, graph: ViewGraph, sensors: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Verified pairs (scene indices) with an image of these sensors."""
    of = np.isin(scene.sensor_key, sensors)
    rows = of[graph.pairs[:, 0]] | of[graph.pairs[:, 1]]
    return tuple((int(a), int(b)) for a, b in graph.pairs[rows])


def place_as_given(model: pycolmap.Reconstruction, scene: Scene, sensors: tuple[int, ...], tuning: Tuning) -> None:
    """Set the extrinsics of sensors without observations as given, lengths in the model's units."""
    scale = units_per_metre(model, scene, tuning)
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        held = model.rigs[index + 1] if index + 1 in model.rigs else None
        for place, sensor in enumerate(rig.sensors):
            identity = sensor_id(first + place + 1)
            if first + place in sensors and place and held is not None and held.has_sensor_from_rig(identity):
                extrinsics = np.array(sensor.sensor_from_rig, float)
                extrinsics[:3, 3] *= scale
                held.set_sensor_from_rig(identity, rigid3d(extrinsics))


def units_per_metre(model: pycolmap.Reconstruction, scene: Scene, tuning: Tuning) -> float:
    """Model units per metre: from prior positions far enough apart, else from the median baseline
    of the rig, else 1."""
    centre = transforms.centre(image_poses(model, scene))
    position = scene.world_from_rig[scene.frame, :3, 3]
    sigma = np.nan_to_num(np.nanmax(scene.position_sigma_m, axis=1, initial=0.0))[scene.frame]
    known = np.flatnonzero(np.isfinite(centre).all(axis=1) & np.isfinite(position).all(axis=1) & (scene.sensor == 0))
    support, least = tuning.rig.support, tuning.start.scale
    rng = np.random.default_rng(0)
    if len(known) >= least.least_positions:
        a, b = rng.choice(known, (2, support.pairs))
        apart = np.linalg.norm(position[a] - position[b], axis=1)
        far = apart > support.position_sigmas * np.maximum(sigma[a] + sigma[b], least.least_noise_m)
        if far.sum() >= least.least_distances:
            return float(np.median(np.linalg.norm(centre[a] - centre[b], axis=1)[far] / apart[far]))
    return _by_baselines(model, scene)


def _by_baselines(model: pycolmap.Reconstruction, scene: Scene) -> float:
    ratios = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        held = model.rigs[index + 1] if index + 1 in model.rigs else None
        for key, sensor in enumerate(rig.sensors, start=first + 1):
            identity = sensor_id(key)
            found = held.sensor_from_rig(identity) if held and held.has_sensor_from_rig(identity) else None
            if found is not None and sensor.sensor_from_rig is not None:
                given = np.linalg.norm(transforms.centre(sensor.sensor_from_rig))
                if given > 0:
                    ratios.append(float(np.linalg.norm(matrix(found)[:3, 3]) / given))
    return float(np.median(ratios)) if ratios else 1.0
