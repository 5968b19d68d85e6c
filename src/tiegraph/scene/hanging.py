"""Rigs with wide cameras (paper 004, sections 2 and 4): only these take part in structure from motion, the poses of the
others follow from the calibrated rig.

The cameras that make the clouds are close together, have a small field of view, and the projector's pattern that they
see moves with them: ties between their shots are few or false. A wide camera without the pattern ties all shots; the
pose of the others follows from its pose and the rig.

Only ``scan`` decides this: it keeps the dependent images out of ``scene.json``, so that no stage of the
network sees them, and writes the whole survey to ``whole.json``. ``georef`` adds them to the model again.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene

WIDE = "wide"


def wide_first(roles: Sequence[str]) -> list[int]:
    """The order of the sensors of a rig: the wide ones first, because the reference must have poses."""
    return sorted(range(len(roles)), key=lambda k: roles[k] != WIDE)


def carries(scene: Scene) -> np.ndarray:
    """(N,) bool: the image takes part in structure from motion: of a wide camera, or of a rig without one."""
    wide = np.array([any(s.role == WIDE for s in r.sensors) for r in scene.rigs], bool)[scene.rig[scene.frame]]
    return scene.of_role(WIDE) | ~wide


def carrying(scene: Scene) -> Scene:
    """The survey without the dependent images and their cameras; frames without a wide image are removed too.

    Raises InputError for a survey whose dependent cameras get no poses: with another rig beside, or with cameras that
    are not calibrated.
    """
    own = carries(scene)
    if own.all():
        return scene
    if len(scene.rigs) > 1:
        raise InputError(
            f"rig {scene.rigs[0].name!r} has a camera with role = 'wide', and the survey has {len(scene.rigs)} rigs or "
            "cameras of other kinds: run them separately, or omit the role"
        )
    rig = scene.rigs[0]
    _check(rig)
    sensors = tuple(s for s in rig.sensors if s.role == WIDE)
    names = {s.name for s in sensors}
    pairs = tuple(p for p in rig.pairs if set(p.sensors) <= names)
    part = scene.only(np.flatnonzero(own))
    lost = scene.frames - part.frames
    said = f"{sum(~own)} images of {', '.join(s.name for s in rig.sensors if s.role != WIDE)} get poses by the rig: "
    said += f"structure from motion uses only {', '.join(s.name for s in sensors)} (role wide)"
    said += f"; {lost} frames lack a wide image and get no pose" if lost else ""
    return part.with_(rigs=(replace(rig, sensors=sensors, pairs=pairs),), notes=(*scene.notes, said))


def _check(rig: Rig) -> None:
    """Raise InputError for a rig that cannot give poses to dependent cameras."""
    wide = next(s.name for s in rig.sensors if s.role == WIDE)
    if rig.sensors[0].role != WIDE:
        raise ValueError("a rig's wide cameras come first")
    remedy = "calibrate the rig (`tiegraph calibrate`), or omit role = 'wide'"
    if rig.nominal:
        raise InputError(
            f"rig {rig.name!r}: {wide} is wide, so that the others depend on the rig, but it is nominal: {remedy}"
        )
    for sensor in rig.sensors:
        if sensor.sensor_from_rig is None or not np.isfinite(sensor.sensor_from_rig).all():
            raise InputError(
                f"rig {rig.name!r}: {wide} is wide, so that {sensor.name} depends on the rig, but its pose relative to "
                f"{wide} is unknown: {remedy}"
            )
        if sensor.role != WIDE and (sensor.camera is None or not sensor.camera.has_prior_focal_length):
            raise InputError(
                f"rig {rig.name!r}: {wide} is wide, so that {sensor.name} depends on the rig, but its lens is not "
                f"calibrated: {remedy}"
            )


def with_hanging(model: pycolmap.Reconstruction, whole: Scene) -> pycolmap.Reconstruction:
    """A metric model of the images of wide cameras, with the dependent ones of their frames: posed by the rig, without
    observations. Ids of the model's cameras, images and frames stay; those of its points are new."""
    out, cameras = pycolmap.Reconstruction(), {}
    for camera in model.cameras.values():
        out.add_camera(camera)
    for number, old in sorted(model.rigs.items()):
        copy = pycolmap.Rig(rig_id=number)
        copy.add_ref_sensor(old.ref_sensor_id)
        for sensor_id, pose in old.non_ref_sensors.items():
            copy.add_sensor(sensor_id, pose)
        for key, sensor in enumerate(whole.rigs[0].sensors):
            if sensor.role != WIDE:
                made = pycolmap.Camera(**{**sensor.camera.todict(), "camera_id": max(out.cameras) + 1})  # type: ignore[union-attr]
                out.add_camera(made)
                copy.add_sensor(made.sensor_id, rigid3d(np.asarray(sensor.sensor_from_rig)))
                cameras[number, key] = made
        out.add_rig(copy)
    _add_images(out, model, whole, cameras)
    for _, point in sorted(model.points3D.items()):
        number = out.add_point3D(point.xyz, point.track, point.color)
        out.points3D[number].error = point.error
    return out


def _add_images(
    out: pycolmap.Reconstruction,
    model: pycolmap.Reconstruction,
    whole: Scene,
    cameras: dict[tuple[int, int], pycolmap.Camera],
) -> None:
    """The frames of a model with all their images; ``cameras``: by rig and sensor those of dependent images."""
    carry, free = carries(whole), max(model.images) + 1
    for number, old in model.frames.items():
        frame = pycolmap.Frame(frame_id=number, rig_id=old.rig_id)
        own = [model.image(d.id) for d in old.data_ids if d.id in model.images]
        of = {int(whole.frame[whole.image_index[i.name]]) for i in own}
        for image in own:
            frame.add_data_id(image.data_id)
        hung = [int(k) for k in np.flatnonzero(np.isin(whole.frame, list(of)) & ~carry)]
        images = [
            pycolmap.Image(
                name=i.name, camera_id=i.camera_id, image_id=i.image_id, keypoints=[p.xy for p in i.points2D]
            )
            for i in own
        ]
        for k in hung:
            camera = cameras[old.rig_id, int(whole.sensor[k])]
            frame.add_data_id(pycolmap.data_t(camera.sensor_id, free))
            images.append(pycolmap.Image(name=whole.names[k], camera_id=camera.camera_id, image_id=free))
            free += 1
        frame.rig_from_world = old.rig_from_world
        out.add_frame(frame)
        for image in images:
            image.frame_id = number
            out.add_image(image)
        out.register_frame(number)
