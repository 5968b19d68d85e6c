"""Keyframes and points adjusted together by pycolmap's bundle adjustment; cameras and rig are held."""

from collections.abc import Collection, Sequence

import numpy as np
import pycolmap

from tiegraph.odometry.tuning import MapTuning
from tiegraph.odometry.worldmap import Observations, WorldMap
from tiegraph.scene.colmapmodel import add_rig, matrix, rigid3d
from tiegraph.scene.solver import all_images, options_of

_RIG = 1


def adjust(
    world: WorldMap, numbers: Sequence[int], held: Collection[int], tuning: MapTuning, loss_px: float, iterations: int
) -> None:
    """Adjust keyframes but those held, with all points that two observations of them see; forget what then is off."""
    seen = world.observations(numbers)
    points, row, count = np.unique(seen.point, return_inverse=True, return_counts=True)
    usable = ~np.isnan(world.xyz[seen.point, 0]) & (count[row] >= 2)
    free = [k for k in numbers if k not in held]
    if not usable.any() or not free:
        return
    model, ids = _build(world, numbers, seen.where(usable))
    _solve(model, [k + 1 for k in numbers if k in held], loss_px, iterations)
    for k in free:
        pose = model.frame(k + 1).rig_from_world
        assert pose is not None
        world.move(k, matrix(pose))
    world.xyz[list(ids)] = [model.point3D(number).xyz for number in ids.values()]
    world.forget(seen, usable & (world.errors_px(seen) > tuning.outlier_px))


def _build(
    world: WorldMap, numbers: Sequence[int], seen: Observations
) -> tuple[pycolmap.Reconstruction, dict[int, int]]:
    """COLMAP's model, in which a keyframe's number + 1 is its frame's; number of a point in the map -> in the model."""
    model = pycolmap.Reconstruction()
    add_rig(model, world.cameras.models, world.cameras.rigid)
    image_of: dict[tuple[int, int], int] = {}
    row = np.zeros(len(seen.point), int)
    for number in numbers:
        frame = pycolmap.Frame(frame_id=number + 1, rig_id=_RIG)
        frame.rig_from_world = rigid3d(world.keyframes[number].rig_from_world)
        images = []
        for camera in np.unique(seen.camera[seen.keyframe == number]).tolist():
            at = np.flatnonzero((seen.keyframe == number) & (seen.camera == camera))
            row[at] = np.arange(len(at))
            key = image_of[number, camera] = len(image_of) + 1
            image = pycolmap.Image(name=str(key), keypoints=seen.xy[at], camera_id=camera + 1, image_id=key)
            image.frame_id = number + 1
            frame.add_data_id(image.data_id)
            images.append(image)
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(number + 1)
    order = np.argsort(seen.point, kind="stable")
    images_of = [image_of[k, c] for k, c in zip(seen.keyframe[order].tolist(), seen.camera[order].tolist())]
    elements = [pycolmap.TrackElement(i, r) for i, r in zip(images_of, row[order].tolist())]
    points, first = np.unique(seen.point[order], return_index=True)
    ends = [*first[1:].tolist(), len(elements)]
    ids = {
        point: model.add_point3D(world.xyz[point], pycolmap.Track(elements[a:b]), np.zeros(3, np.uint8))
        for point, a, b in zip(points.tolist(), first.tolist(), ends)
    }
    return model, ids


def _solve(model: pycolmap.Reconstruction, held: Collection[int], loss_px: float, iterations: int) -> None:
    options = options_of(
        iterations,
        1e-4,  # relative change of the cost at which Ceres stops: the next keyframe adjusts the same again
        loss_px,
        refine_focal_length=False,
        refine_extra_params=False,
        refine_principal_point=False,
        refine_sensor_from_rig=False,
    )
    config = all_images(model)
    for frame in held:
        config.set_constant_rig_from_world_pose(frame)
    pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
