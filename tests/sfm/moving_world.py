"""A rig on a road, with every sighting made at the time its camera really fires."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

INTERVAL_S = 0.5


def pose_at(time_s: float) -> np.ndarray:
    """world_from_rig (4, 4): starts at rest, gathers speed to 4 m/s, turning a little; camera axes (z forward)."""
    along = 0.2 * time_s**2
    yaw = 3.0 * time_s
    return transforms.rigid(orient(yaw, 0, 0), np.array([0.02 * time_s**2, 0.0, along]))


def moving_world(
    late_s: Sequence[float] = (0.0, 0.0, 0.0),
    loose_deg: Sequence[float] = (0.0, 0.0, 0.0),
    frames: int = 18,
    readout_s: float = 0.0,
    points: int = 2500,
) -> tuple[pycolmap.Reconstruction, Scene]:
    """Model as a mapper with a rigid rig would start it (true points and frames), and its calibrated scene.

    ``points``: half of them are beside the road. ``readout_s``: from the first row of an image to the last; the middle
    one is seen at the camera's time.
    """
    rng = np.random.default_rng(5)
    camera = pycolmap.Camera(model="PINHOLE", width=800, height=600, params=[400.0, 400.0, 400.0, 300.0])
    yaws, levers = (0.0, -45.0, 45.0), ([0.0, 0, 0], [-0.4, 0, 0.1], [0.4, 0, 0.1])
    places = [transforms.invert(transforms.rigid(orient(y, 0, 0), np.array(c))) for y, c in zip(yaws, levers)]
    rig = Rig("car", tuple(Sensor(f"cam{k}", camera, p) for k, p in enumerate(places)), fixed=True)
    model, street = _empty(camera, places), _points(rng, points)
    tracks: dict[int, list[tuple[int, int]]] = {}
    for f in range(frames):
        frame = pycolmap.Frame(frame_id=f + 1, rig_id=1)
        images = []
        for s in range(3):
            image = pycolmap.Image(name=f"cam{s}/{f:03d}.jpg", camera_id=s + 1, image_id=1 + 3 * f + s)
            image.frame_id = f + 1
            turn = transforms.rigid(_turn(np.radians(loose_deg[s]) * rng.standard_normal(3)), np.zeros(3))
            time_s = INTERVAL_S * f + late_s[s]
            rows_s = time_s + readout_s * np.array([-0.5, 0.0, 0.5])
            poses = [turn @ places[s] @ transforms.invert(pose_at(t)) for t in rows_s]
            seen, xy = sighted(camera, poses, street, rng)
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in xy])
            for row, point in enumerate(seen):
                tracks.setdefault(int(point), []).append((image.image_id, row))
            frame.add_data_id(image.data_id)
            images.append(image)
        frame.rig_from_world = rigid3d(transforms.invert(pose_at(INTERVAL_S * f)))
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(f + 1)
    for point, elements in tracks.items():
        if len(elements) > 2:
            model.add_point3D(street[point], pycolmap.Track([pycolmap.TrackElement(*e) for e in elements]))
    return model, _scene(rig, frames)


def _turn(vector: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


def _empty(camera: pycolmap.Camera, places: Sequence[np.ndarray]) -> pycolmap.Reconstruction:
    model = pycolmap.Reconstruction()
    row = pycolmap.Rig(rig_id=1)
    for s, place in enumerate(places):
        own = copy(camera)
        own.camera_id = s + 1
        model.add_camera(own)
        identity = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, s + 1)
        row.add_ref_sensor(identity) if s == 0 else row.add_sensor(identity, rigid3d(place))
    model.add_rig(row)
    return model


def _points(rng: np.random.Generator, count: int) -> np.ndarray:
    sides = rng.uniform([-9, -2, -5], [9, 2, 45], (count, 3))
    return sides[np.abs(sides[:, 0]) > 4]


def sighted(
    camera: pycolmap.Camera, poses: Sequence[np.ndarray], points: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points in view and where: ``poses`` of the first, the middle and the last row, even motion between them."""
    local = transforms.apply(poses[1], points)
    ahead = np.flatnonzero((local[:, 2] > 1) & (local[:, 2] < 16))
    first, xy, last = (camera.img_from_cam(transforms.apply(pose, points[ahead])) for pose in poses)
    moved = last - first
    late = (xy[:, 1] / camera.height - 0.5) / (1 - moved[:, 1] / camera.height)
    xy = xy + late[:, None] * moved
    inside = ((xy > 0) & (xy < [camera.width, camera.height])).all(axis=1)
    return ahead[inside], xy[inside] + 0.3 * rng.standard_normal((inside.sum(), 2))


def _scene(rig: Rig, frames: int) -> Scene:
    table = sorted((f"cam{s}/{f:03d}.jpg", f, s) for f in range(frames) for s in range(3))
    names, frame, sensor = zip(*table)
    time = INTERVAL_S * np.arange(frames)
    return simple_scene(
        rig, list(names), np.array(frame), np.array(sensor), np.zeros(frames), sequences=("road",), time_s=time
    )


def write_database(model: pycolmap.Reconstruction, path: Path, reach: int = 3) -> None:
    """A matched database of a model: all its images, true matches between frames up to ``reach`` apart."""
    path.unlink(missing_ok=True)
    point = {i: {int(p.point3D_id): k for k, p in enumerate(model.image(i).points2D) if p.has_point3D()}
             for i in model.reg_image_ids()}  # fmt: skip
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for camera in model.cameras.values():
            database.write_camera(camera, use_camera_id=True)
        for rig in model.rigs.values():
            database.write_rig(rig, use_rig_id=True)
        for image in model.images.values():
            fresh = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=image.image_id)
            database.write_image(fresh, use_image_id=True)
            xy = np.array([p.xy for p in image.points2D], np.float32)
            database.write_keypoints(image.image_id, xy)
        for frame in model.frames.values():
            database.write_frame(frame, use_frame_id=True)
        for a in sorted(point):
            for b in (b for b in point if a < b and abs(model.image(a).frame_id - model.image(b).frame_id) <= reach):
                shared = sorted(set(point[a]) & set(point[b]))
                if len(shared) >= 15:
                    matches = np.array([(point[a][p], point[b][p]) for p in shared], np.uint32)
                    database.write_matches(a, b, matches)
                    geometry = pycolmap.TwoViewGeometry(
                        config=pycolmap.TwoViewGeometryConfiguration.CALIBRATED, inlier_matches=matches
                    )
                    database.write_two_view_geometry(a, b, geometry)
