"""A model whose cameras are no longer bolted together: each image a frame of its own."""

from collections.abc import Collection

import pycolmap

from tiegraph.scene.scene import Scene


def per_camera_frames(
    model: pycolmap.Reconstruction, rig_ids: Collection[int], scene: Scene
) -> pycolmap.Reconstruction:
    """A copy of a model in which the images of these rigs stand alone, where they stood; ids as without a rig."""
    out = pycolmap.Reconstruction(model)
    poses = {i: out.image(i).cam_from_world() for i in out.reg_image_ids()}
    sensors = len(scene.rigs)
    rigs = [_rig_copied(r) for k, r in out.rigs.items() if k not in rig_ids]
    frames = [_copied(f) for f in out.frames.values() if f.rig_id not in rig_ids]
    cameras: set[int] = set()
    for image in out.images.values():
        if out.frame(image.frame_id).rig_id not in rig_ids:
            continue
        cameras.add(image.camera_id)
        frame = pycolmap.Frame(frame_id=scene.frames + image.image_id, rig_id=sensors + image.camera_id)
        frame.add_data_id(image.data_id)
        if image.image_id in poses:
            frame.rig_from_world = poses[image.image_id]
        frames.append(frame)
    for camera in sorted(cameras):
        row = pycolmap.Rig(rig_id=sensors + camera)
        row.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera))
        rigs.append(row)
    out.set_rigs_and_frames(rigs, frames)
    return out


def _copied(frame: pycolmap.Frame) -> pycolmap.Frame:
    out = pycolmap.Frame(frame_id=frame.frame_id, rig_id=frame.rig_id)
    for identity in frame.data_ids:
        out.add_data_id(identity)
    if frame.has_pose():
        out.rig_from_world = frame.rig_from_world
    return out


def _rig_copied(rig: pycolmap.Rig) -> pycolmap.Rig:
    out = pycolmap.Rig(rig_id=rig.rig_id)
    out.add_ref_sensor(rig.ref_sensor_id)
    for sensor, pose in rig.non_ref_sensors.items():
        out.add_sensor(sensor, pose)
    return out
