"""What a start needs: the rigs in the units of the poses, and where each of COLMAP's frames stands."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.align import l1_mean_rotation
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.graph import parts
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, rig_from_sensor
from tiegraph.sfm.start.pathscale import PathScale, path_scale
from tiegraph.sfm.tuning.start import ScaleTuning, StartTuning
from tiegraph.sfm.verified import VerifiedMatches

ONE_CENTRE = 1e-6  # metres: shorter baselines are none


@dataclass(frozen=True)
class Start:
    """Roughly known poses, made fit for a mapper.

    ``rigs`` by index: those that may change have their extrinsics from the poses, those that must not have their own;
    ``world_from_rig`` (F, 4, 4) and ``cam_from_world`` (N, 4, 4), for images without a rig, in one unit; NaN = unknown.
    """

    rigs: dict[int, Rig]
    world_from_rig: np.ndarray
    cam_from_world: np.ndarray
    notes: tuple[str, ...] = ()


def start_from(
    cam_from_world: np.ndarray,
    scene: Scene,
    rigs: Mapping[int, Rig],
    held: Collection[int],
    verified: VerifiedMatches,
    tuning: StartTuning,
) -> Start | None:
    """A start from poses (N, 4, 4) of the images, NaN = unknown; ``held``: indices of rigs whose extrinsics stay.

    None if the length of the path against a held rig is not known: the poses may come from a model that did not see it.
    """
    most = tuning.max_lever_off
    fitted = {k: rig if k in held else rig_of_poses(scene, k, rig, cam_from_world, most) for k, rig in rigs.items()}
    scene = scene.with_(rigs=tuple(fitted.get(k, r) for k, r in enumerate(scene.rigs)))
    frames = frame_poses(cam_from_world, scene)
    found = length_of_path(frames, scene, held, verified, tuning.scale)
    if found is None:
        return Start(fitted, frames, cam_from_world)
    if not np.isfinite(found.scale):
        return None
    frames[:, :3, 3] *= found.scale
    images = cam_from_world.copy()
    images[:, :3, 3] *= found.scale
    note = f"its path made {found.scale:.3g} times as long, by {found.by}"
    return Start(
        rigs=fitted,
        world_from_rig=frames,
        cam_from_world=images,
        notes=(note,) if abs(found.scale - 1) > tuning.told_change else (),
    )


def length_of_path(
    world_from_rig: np.ndarray, scene: Scene, held: Collection[int], verified: VerifiedMatches, tuning: ScaleTuning
) -> PathScale | None:
    """What the path of frames (F, 4, 4) needs to be as long as the rigs (indices ``held``) that must not change say;
    None where there is nothing to compare it with: panoramas, loose photographs."""
    cam_from_rig = transforms.invert(rig_from_sensor(scene))
    if not held or np.nanmax(np.linalg.norm(cam_from_rig[:, :3, 3], axis=1), initial=0.0) < ONE_CENTRE:
        return None
    return path_scale(scene, cam_from_rig, world_from_rig, verified, tuning)


def largest_component(cam_from_world: np.ndarray, scene: Scene, rigs: Collection[int], pairs: np.ndarray) -> np.ndarray:
    """(N,) bool: images of the piece with most known poses that verified pairs (P, 2) and rigs hold together. What
    nothing ties to it would stay where a rough model had it, untested, and drift."""
    bound = np.isin(scene.rig[scene.frame], list(rigs))
    node = np.where(bound, scene.frame, scene.frames + np.arange(len(scene)))
    label = parts(node[pairs[:, 0]], node[pairs[:, 1]], scene.frames + len(scene))[node]
    known = np.isfinite(cam_from_world).all(axis=(1, 2))
    largest = np.bincount(label[known]).argmax() if known.any() else -1
    return label == largest


def rig_of_poses(scene: Scene, index: int, rig: Rig, cam_from_world: np.ndarray, max_lever_off: float) -> Rig:
    """The rig with the extrinsics that the poses show, averaged over the frames; a sensor that no frame shows beside
    the reference keeps its own, in the units of the others.

    ``max_lever_off``: share of a given lever arm that the poses may show it off; more, and it stays as given.
    """
    of = scene.rig[scene.frame] == index
    known = of & np.isfinite(cam_from_world).all(axis=(1, 2))
    reference = np.full(scene.frames, -1)
    first = np.flatnonzero(known & (scene.sensor == 0))
    reference[scene.frame[first]] = first
    shown: dict[int, np.ndarray] = {}
    for place in range(1, len(rig.sensors)):
        rows = np.flatnonzero(known & (scene.sensor == place))
        rows = rows[reference[scene.frame[rows]] >= 0]
        if len(rows):
            steps = cam_from_world[rows] @ transforms.invert(cam_from_world[reference[scene.frame[rows]]])
            shift = np.median(steps[:, :3, 3], axis=0)
            shown[place] = transforms.rigid(l1_mean_rotation(steps[:, :3, :3]), shift)
    units = _units(rig, shown)
    sensors = list(rig.sensors)
    for place, sensor in enumerate(rig.sensors):
        own = sensor.sensor_from_rig
        if place in shown and own is not None and _ran_off(shown[place], own, units, max_lever_off):
            shown[place] = transforms.rigid(shown[place][:3, :3], units * own[:3, 3])
        if place in shown:
            sensors[place] = replace(sensor, sensor_from_rig=shown[place])
        elif own is not None and place:
            sensors[place] = replace(sensor, sensor_from_rig=transforms.rigid(own[:3, :3], units * own[:3, 3]))
    return replace(rig, sensors=tuple(sensors))


def _ran_off(found: np.ndarray, given: np.ndarray, units: float, most: float) -> bool:
    """Whether a lever arm is unlike the given one: a camera with few ties (canal's up camera, three times too long)."""
    length = units * float(np.linalg.norm(given[:3, 3]))
    return length > 0 and float(np.linalg.norm(found[:3, 3] - units * given[:3, 3])) > most * length


def _units(rig: Rig, shown: Mapping[int, np.ndarray]) -> float:
    """Units of the poses of one of the rig's, by the median baseline."""
    ratios = []
    for place, found in shown.items():
        own = rig.sensors[place].sensor_from_rig
        length = 0.0 if own is None else float(np.linalg.norm(own[:3, 3]))
        if length > 0:
            ratios.append(float(np.linalg.norm(found[:3, 3])) / length)
    return float(np.median(ratios)) if ratios else 1.0


def place_frames(model: pycolmap.Reconstruction, scene: Scene, start: Start) -> int:
    """Set and register the frames of a model without poses; how many images that places."""
    first = np.cumsum([0] + [len(r.sensors) for r in scene.rigs])
    for frame_id, frame in list(model.frames.items()):
        names = [model.image(d.id).name for d in frame.image_ids]
        rows = [scene.image_index[n] for n in names if n in scene.image_index]
        if not rows:
            continue
        rig = model.rig(frame.rig_id)
        index = frame.rig_id - 1
        if index in start.rigs:
            place = rig.ref_sensor_id.id - 1 - int(first[index])
            extrinsics = start.rigs[index].sensors[place].sensor_from_rig
            reference = np.eye(4) if extrinsics is None else extrinsics
            pose = reference @ transforms.invert(start.world_from_rig[scene.frame[rows[0]]])
        else:
            pose = start.cam_from_world[rows[0]]
        if np.isfinite(pose).all():
            model.frame(frame_id).rig_from_world = rigid3d(pose)
            model.register_frame(frame_id)
    return int(model.num_reg_images())
