"""Models made of others: merged, with other cameras, or with the images that hang on a rig.

Rigs with wide cameras (paper 004, sections 2 and 4): only these take part in structure from motion, the poses of the
others follow from the calibrated rig.

The cameras that make the clouds are close together, have a small field of view, and the projector's pattern that they
see moves with them: ties between their shots are few or false. A wide camera without the pattern ties all shots; the
pose of the others follows from its pose and the rig.

Only ``scan`` decides this: it keeps the dependent images out of ``scene.json``, so that no stage of the
network sees them, and writes the whole survey to ``whole.json``. ``georef`` adds them to the model again.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import count

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
    faults = ["the others depend on the rig, but it is nominal"] if rig.nominal else []
    for sensor in rig.sensors:
        if sensor.sensor_from_rig is None or not np.isfinite(sensor.sensor_from_rig).all():
            faults.append(f"{sensor.name} depends on the rig, but its pose relative to {wide} is unknown")
        elif sensor.role != WIDE and (sensor.camera is None or not sensor.camera.has_prior_focal_length):
            faults.append(f"{sensor.name} depends on the rig, but its lens is not calibrated")
    if faults:
        remedy = "calibrate the rig (`tiegraph calibrate`), or omit role = 'wide'"
        raise InputError(f"rig {rig.name!r}: {wide} is wide, so that {faults[0]}: {remedy}")


def with_hanging(model: pycolmap.Reconstruction, whole: Scene) -> pycolmap.Reconstruction:
    """A metric model of the images of wide cameras, with the dependent ones of their frames: posed by the rig, without
    observations. Ids of the model's cameras, images and frames stay; those of its points are new."""
    out, carry = pycolmap.Reconstruction(), carries(whole)
    cameras, ids = {k: k for k in model.cameras}, {k: k for k in sorted(model.reg_image_ids())}
    _add_rigs(out, model, cameras)
    made: dict[tuple[int, int], int] = {}  # cameras of dependent images by rig and sensor
    for number, rig in sorted(out.rigs.items()):
        for key, sensor in enumerate(whole.rigs[0].sensors):
            if sensor.role != WIDE:
                made[number, key] = max(out.cameras) + 1
                camera = pycolmap.Camera(**{**sensor.camera.todict(), "camera_id": made[number, key]})  # type: ignore[union-attr]
                out.add_camera(camera)
                rig.add_sensor(camera.sensor_id, rigid3d(np.asarray(sensor.sensor_from_rig)))
    free = count(max(model.images) + 1)

    def hung(images: Sequence[pycolmap.Image], rig_id: int) -> list[pycolmap.Image]:
        frames = [int(whole.frame[whole.image_index[i.name]]) for i in images]
        rows = np.flatnonzero(np.isin(whole.frame, frames) & ~carry).tolist()
        cameras_of = (made[rig_id, int(whole.sensor[k])] for k in rows)
        return [pycolmap.Image(name=whole.names[k], camera_id=c, image_id=next(free)) for k, c in zip(rows, cameras_of)]

    _add_frames(out, model, cameras, ids, hung)
    _add_points(out, model, ids)
    return out


def merged(models: Sequence[pycolmap.Reconstruction]) -> pycolmap.Reconstruction:
    """One model of the registered images of all, which must be in one frame and unit; ids of cameras, rigs, frames
    and images of the first model stay.

    Models that were adjusted separately have separate calibrations: each brings its own, under new ids.
    An image of an earlier model is left out of a later one, and so are points that then have less than two images.
    """
    out = pycolmap.Reconstruction()
    for model in models:
        there = {out.image(k).name for k in out.images}
        new = [k for k in sorted(model.reg_image_ids()) if model.image(k).name not in there]
        if new:
            free = max([*out.images, *model.images]) + 1
            ids = {k: k if k not in out.images else free + n for n, k in enumerate(new)}
            cameras = {k: k + max(out.cameras, default=0) for k in model.cameras}
            _add_rigs(out, model, cameras)
            _add_frames(out, model, cameras, ids)
            _add_points(out, model, ids)
    return out


def _add_rigs(out: pycolmap.Reconstruction, model: pycolmap.Reconstruction, cameras: dict[int, int]) -> None:
    """Add the cameras and rigs of a model; ``cameras``: new ids by old ones."""

    def sensor(old: pycolmap.sensor_t) -> pycolmap.sensor_t:
        return pycolmap.sensor_t(old.type, cameras[old.id])

    for old, new in cameras.items():
        out.add_camera(pycolmap.Camera(**{**model.camera(old).todict(), "camera_id": new}))
    first = max(out.rigs, default=0)
    for number, rig in sorted(model.rigs.items()):
        copy = pycolmap.Rig(rig_id=first + number)
        copy.add_ref_sensor(sensor(rig.ref_sensor_id))
        for old, pose in rig.non_ref_sensors.items():
            copy.add_sensor(sensor(old), pose)
        out.add_rig(copy)


def _add_frames(
    out: pycolmap.Reconstruction,
    model: pycolmap.Reconstruction,
    cameras: dict[int, int],
    ids: dict[int, int],
    more: Callable[[Sequence[pycolmap.Image], int], list[pycolmap.Image]] = lambda images, rig_id: [],
) -> None:
    """Add the frames of some images; ``cameras``, ``ids``: new ids of cameras and images by old ones; ``more`` images
    of a frame by its images and their rig."""
    rigs = max(out.rigs) - max(model.rigs)
    taken = max([*out.frames, *model.frames])
    for number in sorted({model.image(k).frame_id for k in ids}):
        old = model.frame(number)
        taken += number in out.frames
        frame = pycolmap.Frame(frame_id=taken if number in out.frames else number, rig_id=old.rig_id + rigs)
        own = [model.image(d.id) for d in old.data_ids if d.id in ids]
        images = [
            pycolmap.Image(
                name=i.name,
                camera_id=cameras[i.camera_id],
                image_id=ids[i.image_id],
                keypoints=[p.xy for p in i.points2D],
            )
            for i in own
        ] + more(own, old.rig_id)
        for image in images:
            frame.add_data_id(image.data_id)
        frame.rig_from_world = old.rig_from_world
        out.add_frame(frame)
        for image in images:
            image.frame_id = frame.frame_id
            out.add_image(image)
        out.register_frame(frame.frame_id)


def _add_points(out: pycolmap.Reconstruction, model: pycolmap.Reconstruction, ids: dict[int, int]) -> None:
    for _, point in sorted(model.points3D.items()):
        track = [
            pycolmap.TrackElement(ids[e.image_id], e.point2D_idx) for e in point.track.elements if e.image_id in ids
        ]
        if len(track) > 1:
            number = out.add_point3D(point.xyz, pycolmap.Track(track), point.color)
            out.points3D[number].error = point.error


def moved_pixels(at: np.ndarray, camera: pycolmap.Camera, other: pycolmap.Camera) -> np.ndarray:
    """Pixels (N, 2) of one camera converted to another at the same pose; NaN = outside its view."""
    if not len(at):
        return np.zeros((0, 2))
    return np.asarray(other.img_from_cam(np.asarray(camera.cam_ray_from_img(at)))).reshape(-1, 2)


def with_cameras(
    model: pycolmap.Reconstruction, cameras: Mapping[int, pycolmap.Camera], names: Mapping[str, str]
) -> pycolmap.Reconstruction:
    """A copy with other ``cameras`` by their ids and other ``names`` of images; those without one stay unchanged.

    Key points move along; observations that then lie outside the image are left out, and points with less than two.
    """
    result = pycolmap.Reconstruction(model)
    for key, camera in cameras.items():
        own = result.cameras[key]
        own.model = camera.model
        own.params, own.width, own.height = camera.params.tolist(), camera.width, camera.height
    for image in result.images.values():
        image.name = names.get(image.name, image.name)
    same = {k for k, camera in result.cameras.items() if repr(camera) == repr(model.camera(k))}
    for key in sorted(k for k in result.reg_image_ids() if result.image(k).camera_id not in same):
        image = result.image(key)
        old, new = model.camera(image.camera_id), result.camera(image.camera_id)
        moved = moved_pixels(np.array([p.xy for p in image.points2D], float).reshape(-1, 2), old, new)
        inside = np.all((moved >= 0) & (moved <= [new.width, new.height]), axis=1)  # NaN is not
        for k, (point, xy) in enumerate(zip(image.points2D, np.nan_to_num(moved, nan=0, posinf=0, neginf=0))):
            point.xy = xy
            if not inside[k] and point.has_point3D():
                result.delete_observation(key, k)
    return result


def same_lens(camera: pycolmap.Camera, model: str, params: list[float]) -> pycolmap.Camera:
    """The camera in another camera model, its pixels unchanged."""
    own = deepcopy(camera)
    own.model = pycolmap.CameraModelId.__members__[model]
    own.params = params
    return own
