"""Images that no mapper placed, or that lie in a model of their own, are asked again: by all their verified matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.graph import parts
from tiegraph.sfm.model import rigid3d
from tiegraph.sfm.placement.repair import Repair, around, fits, place_images


@dataclass(frozen=True)
class Unit:
    """Images that are placed together: those of a frame whose rig the model knows, else one alone."""

    images: tuple[int, ...]
    frame: int
    bound: bool


def register_missing(work: Repair, image_ids: dict[int, int]) -> list[tuple[int, int]]:
    """Place what is missing in the model by its verified matches with what is there; (scene index, points) of each.

    One round: what is placed helps the others only after the points were made anew. ``image_ids``: COLMAP's, by scene
    index. The model gets the images with their key points, without observations.
    """
    lost = {frame for frame, _ in work.left_out}
    units = [u for u in missing(work, tied_images(work)) if u.frame not in lost]
    if not units:
        return []
    here = around(work, work.seen())
    out = []
    for unit in units:
        found = place_images(work, unit.images, here.seen)
        if (
            found is None
            or not found.holds(work.tuning.resection)
            or (unit.bound and not fits(work, unit.images, found.pose, here))
        ):
            continue
        register(work, unit, found.pose, image_ids)
        out += [(k, found.inliers) for k in unit.images]
    return out


def tied_images(work: Repair) -> set[int]:
    """Images with a verified pair."""
    return set(np.unique(work.verified.pairs).tolist()) if len(work.verified.pairs) else set()


def tied_elsewhere(work: Repair) -> set[int]:
    """Images that verified pairs tie to each other and none, however long the way, to the model: a survey or a section
    of their own."""
    pairs = work.verified.pairs
    part = parts(pairs[:, 0], pairs[:, 1], len(work.scene))
    there = {work.scene.image_index.get(work.model.image(i).name, -1) for i in work.model.reg_image_ids()}
    own = {int(part[k]) for k in there if k >= 0}
    return {k for k in tied_images(work) if int(part[k]) not in own}


def missing(work: Repair, among: set[int]) -> list[Unit]:
    """What is not in the model, but for units none of whose images is ``among`` some."""
    scene, model = work.scene, work.model
    there = {scene.image_index.get(model.image(i).name, -1) for i in model.reg_image_ids()}
    units: dict[tuple[int, int], list[int]] = {}
    for k in range(len(scene)):
        if k in there or int(scene.sensor_key[k]) + 1 not in model.cameras:
            continue
        frame = int(scene.frame[k])
        units.setdefault((frame, -1) if _bound(work, k) else (frame, k), []).append(k)
    return [Unit(tuple(images), frame, alone < 0) for (frame, alone), images in units.items() if among & set(images)]


def _bound(work: Repair, image: int) -> bool:
    row = int(work.scene.rig[work.scene.frame[image]]) + 1
    identity = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, int(work.scene.sensor_key[image]) + 1)
    return row in work.model.rigs and work.model.rigs[row].has_sensor(identity)


def register(work: Repair, unit: Unit, world_from_rig: np.ndarray, image_ids: dict[int, int]) -> None:
    """Put a unit into the model; the numbers are those of the mapper's database (``sfm/database.py``)."""
    scene, model = work.scene, work.model
    camera = int(scene.sensor_key[unit.images[0]]) + 1
    if unit.bound:
        frame_id, rig_id = unit.frame + 1, int(scene.rig[unit.frame]) + 1
    else:
        frame_id, rig_id = scene.frames + image_ids[unit.images[0]], len(scene.rigs) + camera
    if rig_id not in model.rigs:
        row = pycolmap.Rig(rig_id=rig_id)
        row.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera))
        model.add_rig(row)
    images = []
    for k in unit.images:
        image = pycolmap.Image(
            name=scene.names[k],
            camera_id=int(scene.sensor_key[k]) + 1,
            image_id=image_ids[k],
            keypoints=work.verified.xy[k],
        )
        image.frame_id = frame_id
        images.append(image)
    if frame_id not in model.frames:
        frame = pycolmap.Frame(frame_id=frame_id, rig_id=rig_id)
        for image in images:
            frame.add_data_id(image.data_id)
        model.add_frame(frame)
    model.frame(frame_id).rig_from_world = rigid3d(_in_model(work, unit, world_from_rig))
    for image in images:
        if image.image_id not in model.images:
            model.add_image(image)
    model.register_frame(frame_id)


def _in_model(work: Repair, unit: Unit, world_from_rig: np.ndarray) -> np.ndarray:
    """rig_from_world of COLMAP's frame: its rig frame is that of its reference, which may not be the scene's."""
    rig_from_world = transforms.invert(world_from_rig)
    if not unit.bound:
        return rig_from_world
    index = int(work.scene.rig[unit.frame])
    first = sum(len(r.sensors) for r in work.scene.rigs[:index])
    reference = work.model.rigs[index + 1].ref_sensor_id.id - 1 - first
    extrinsics = work.scene.rigs[index].sensors[reference].sensor_from_rig
    return rig_from_world if reference == 0 or extrinsics is None else extrinsics @ rig_from_world
