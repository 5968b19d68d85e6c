"""The model bent to where its images, positions and control points have it together: they against drift and bending."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, rms_length, umeyama
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import adjusted_to
from tiegraph.sfm.adjustment.constraints import PlacePrior
from tiegraph.sfm.adjustment.rigpriors import of_one_shot, rig_priors
from tiegraph.sfm.tuning import Tuning

_FIRM = 1e-6  # of the extent of the frames: a place held by less than that is no sum of squares that can be solved


@dataclass(frozen=True)
class ConstantParameters:
    """What an adjustment must leave as it is: COLMAP ids of rigs with calibrated extrinsics, and of such cameras;
    ``soft``: indices in the scene of rigs whose extrinsics are known with a sigma."""

    rigs: Collection[int] = ()
    cameras: Collection[int] = ()
    soft: Collection[int] = ()


def bent(
    world: pycolmap.Reconstruction,
    scene: Scene,
    steps: tuple[np.ndarray, np.ndarray],
    held: ConstantParameters,
    tuning: Tuning,
) -> pycolmap.Reconstruction:
    """A copy of a model whose frames of the scene have moved by ``steps`` (F, 3) and sigmas (F, 3) of these, in the
    world, and all else has followed them as the images have it."""
    step, sigma = steps[0], np.maximum(steps[1], _FIRM * _extent(world))
    places: dict[int, PlacePrior] = {}
    for index, name in enumerate(scene.names):
        image, frame = world.find_image_with_name(name), scene.frame[index]
        pose = None if image is None else world.frame(image.frame_id).rig_from_world
        if image is None or pose is None or image.frame_id in places:
            continue
        centre = transforms.centre(matrix(pose))
        places[image.frame_id] = PlacePrior(image=image.image_id, place=centre + step[frame], sigma=sigma[frame])
    ties = of_one_shot(world, scene, tuning.rig)
    known = rig_priors(world, scene, held.soft, tuning.rig.priors)
    known = replace(known, relative_poses=ties, places=tuple(places.values()))
    return adjusted_to(world, held.rigs, held.cameras, known, tuning=tuning.adjust)


def _extent(model: pycolmap.Reconstruction) -> float:
    """Root mean square distance of the images from their middle."""
    centres = np.array([model.image(k).projection_center() for k in model.reg_image_ids()])
    return rms_length(centres - centres.mean(axis=0))


def similarity_to(before: pycolmap.Reconstruction, after: pycolmap.Reconstruction, first: Similarity) -> Similarity:
    """The similarity from the model as mapped to the world that comes closest to the adjusted one."""
    names = [i for i in before.reg_image_ids() if i in after.images and after.image(i).has_pose]
    a = np.array([before.image(i).projection_center() for i in names])
    b = np.array([after.image(i).projection_center() for i in names])
    moved = umeyama(first(a), b)
    return Similarity(moved.scale * first.scale, moved.rotation @ first.rotation, moved(first.translation[None])[0])
