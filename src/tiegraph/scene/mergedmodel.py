"""Several COLMAP models of one world in one model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pycolmap


def merged(models: Sequence[pycolmap.Reconstruction]) -> pycolmap.Reconstruction:
    """One model of the registered images of all, which must stand in one frame and unit; ids of cameras, rigs, frames
    and images of the first model stay.

    Models that were adjusted apart calibrated their cameras and rigs apart: each brings its own, under ids of its own.
    An image that an earlier model has is left out of a later one, and so are points that then lack two images.
    """
    import pycolmap

    out = pycolmap.Reconstruction()
    for model in models:
        _add(out, model)
    return out


def _add(out: pycolmap.Reconstruction, model: pycolmap.Reconstruction) -> None:
    there = {out.image(k).name for k in out.images}
    new = [k for k in sorted(model.reg_image_ids()) if model.image(k).name not in there]
    if not new:
        return
    ids = {k: k if k not in out.images else max(max(out.images), max(model.images)) + 1 + n for n, k in enumerate(new)}
    cameras = {k: k + max(out.cameras, default=0) for k in model.cameras}
    _add_rigs(out, model, cameras)
    _add_frames(out, model, cameras, ids)
    _add_points(out, model, ids)


def _add_rigs(out: pycolmap.Reconstruction, model: pycolmap.Reconstruction, cameras: dict[int, int]) -> None:
    import pycolmap

    for old, new in cameras.items():
        fields = model.camera(old).todict()
        out.add_camera(pycolmap.Camera(**{**fields, "camera_id": new}))
    first = max(out.rigs, default=0)
    for number, rig in sorted(model.rigs.items()):
        copy = pycolmap.Rig(rig_id=first + number)
        copy.add_ref_sensor(_sensor(rig.ref_sensor_id, cameras))
        for sensor, pose in rig.non_ref_sensors.items():
            copy.add_sensor(_sensor(sensor, cameras), pose)
        out.add_rig(copy)


def _add_frames(
    out: pycolmap.Reconstruction, model: pycolmap.Reconstruction, cameras: dict[int, int], ids: dict[int, int]
) -> None:
    import pycolmap

    rigs = max(out.rigs) - max(model.rigs)
    taken = max([*out.frames, *model.frames])
    for number in sorted({model.image(k).frame_id for k in ids}):
        old = model.frame(number)
        taken += number in out.frames
        frame = pycolmap.Frame(frame_id=taken if number in out.frames else number, rig_id=old.rig_id + rigs)
        images = [model.image(d.id) for d in old.data_ids if d.id in ids]
        for image in images:
            sensor = _sensor(image.data_id.sensor_id, cameras)
            frame.add_data_id(pycolmap.data_t(sensor, ids[image.image_id]))
        frame.rig_from_world = old.rig_from_world
        out.add_frame(frame)
        for image in images:
            copy = pycolmap.Image(
                name=image.name, camera_id=cameras[image.camera_id], image_id=ids[image.image_id],
                keypoints=[p.xy for p in image.points2D],
            )  # fmt: skip
            copy.frame_id = frame.frame_id
            out.add_image(copy)
        out.register_frame(frame.frame_id)


def _add_points(out: pycolmap.Reconstruction, model: pycolmap.Reconstruction, ids: dict[int, int]) -> None:
    import pycolmap

    for _, point in sorted(model.points3D.items()):
        track = [e for e in point.track.elements if e.image_id in ids]
        if len(track) < 2:
            continue
        elements = [pycolmap.TrackElement(ids[e.image_id], e.point2D_idx) for e in track]
        number = out.add_point3D(point.xyz, pycolmap.Track(elements), point.color)
        out.points3D[number].error = point.error


def _sensor(sensor: pycolmap.sensor_t, cameras: dict[int, int]) -> pycolmap.sensor_t:
    import pycolmap

    return pycolmap.sensor_t(sensor.type, cameras[sensor.id])
