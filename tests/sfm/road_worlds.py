"""A rig on a road with truth: each sighting is made at the time its camera, or its row, really fires."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

# Of a vehicle with six cameras: places (x right, y down, z forward, metres), yaw in degrees and focal length.
PLACES = (
    [0, 0, 0],
    [-0.65, 0.27, 0.67],
    [-0.54, 0.22, -0.3],
    [0.02, 0.15, -1.1],
    [0.69, 0.27, -0.26],
    [0.6, 0.22, 0.63],
)
YAWS = (0.0, -57.0, -91.0, 179.0, 89.0, 58.0)
FOCAL_PX = (600.0, 300.0, 300.0, 300.0, 300.0, 300.0)
LATE_S = (0.0, -0.011, -0.031, -0.050, 0.031, 0.011)  # as the lidar's sweep fires them
INTERVAL_S = 0.1  # of that vehicle

Sightings = tuple[np.ndarray, np.ndarray]  # rows of the points in view (K,), where they are in the picture (K, 2)


def drawn(
    rig: Rig, time_s: np.ndarray, pose_at: Callable, points: np.ndarray, sight: Callable[[int, int], Sightings]
) -> tuple[pycolmap.Reconstruction, Scene]:
    """Model of true frames and points with the rig as given, and its scene; ``pose_at``: world_from_rig (4, 4) at a
    time, ``sight``: of a frame and a sensor."""
    model, row, count = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1), len(rig.sensors)
    for s, sensor in enumerate(rig.sensors):
        own = copy(sensor.camera)
        own.camera_id = s + 1
        model.add_camera(own)
        identity = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, s + 1)
        row.add_ref_sensor(identity) if s == 0 else row.add_sensor(identity, rigid3d(sensor.sensor_from_rig))
    model.add_rig(row)
    tracks: dict[int, list[pycolmap.TrackElement]] = {}
    for f, at in enumerate(time_s):
        frame, images = pycolmap.Frame(frame_id=f + 1, rig_id=1), []
        for s, sensor in enumerate(rig.sensors):
            image = pycolmap.Image(name=f"{sensor.name}/{f:03d}.jpg", camera_id=s + 1, image_id=1 + count * f + s)
            image.frame_id = f + 1
            seen, xy = sight(f, s)
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(p) for p in xy])
            for k, point in enumerate(seen.tolist()):
                tracks.setdefault(point, []).append(pycolmap.TrackElement(image.image_id, k))
            frame.add_data_id(image.data_id)
            images.append(image)
        frame.rig_from_world = rigid3d(transforms.invert(pose_at(at)))
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
        model.register_frame(f + 1)
    for point, track in tracks.items():
        if len(track) > 2:
            model.add_point3D(points[point], pycolmap.Track(track))
    table = sorted((f"{q.name}/{f:03d}.jpg", f, s) for f in range(len(time_s)) for s, q in enumerate(rig.sensors))
    names, frames, sensors = zip(*table)
    scene = simple_scene(
        rig, list(names), np.array(frames), np.array(sensors), 0 * time_s, sequences=("road",), time_s=time_s
    )
    return model, scene


def sighted(
    camera: pycolmap.Camera, poses: Sequence[np.ndarray], points: np.ndarray, rng: np.random.Generator, **how: float
) -> Sightings:
    """Points in view and where: ``poses`` of the first, the middle and the last row, even motion between them.

    ``how``: ``far`` units at most, ``noise_px``, and the ``share`` of them that is found."""
    local = transforms.apply(poses[1], points)
    ahead = np.flatnonzero((local[:, 2] > 1) & (local[:, 2] < how.get("far", 16)))
    first, xy, last = (camera.img_from_cam(transforms.apply(pose, points[ahead])) for pose in poses)
    moved = last - first
    late = (xy[:, 1] / camera.height - 0.5) / (1 - moved[:, 1] / camera.height)
    xy = xy + late[:, None] * moved
    inside = ((xy > 0) & (xy < [camera.width, camera.height])).all(axis=1)
    if "share" in how:
        inside &= rng.random(len(ahead)) < how["share"]
    return ahead[inside], xy[inside] + how.get("noise_px", 0.3) * rng.standard_normal((inside.sum(), 2))


def moving_world(
    late_s: Sequence[float] = (0.0, 0.0, 0.0),
    loose_deg: Sequence[float] = (0.0, 0.0, 0.0),
    frames: int = 18,
    points: int = 2500,
) -> tuple[pycolmap.Reconstruction, Scene]:
    """Three cameras that start at rest and gather speed to 4 m/s, turning a little, two frames a second: the model as
    a mapper with a rigid rig would start it, and its calibrated scene. ``points``: half of them are beside the road."""
    rng = np.random.default_rng(5)
    camera = pycolmap.Camera(model="PINHOLE", width=800, height=600, params=[400.0, 400.0, 400.0, 300.0])
    yaws, levers = (0.0, -45.0, 45.0), ([0.0, 0, 0], [-0.4, 0, 0.1], [0.4, 0, 0.1])
    places = [transforms.invert(transforms.rigid(orient(y, 0, 0), np.array(c))) for y, c in zip(yaws, levers)]
    rig = Rig("car", tuple(Sensor(f"cam{k}", camera, p) for k, p in enumerate(places)), fixed=True)
    sides = rng.uniform([-9, -2, -5], [9, 2, 45], (points, 3))
    street, times = sides[np.abs(sides[:, 0]) > 4], 0.5 * np.arange(frames)

    def pose_at(time_s: float) -> np.ndarray:
        return transforms.rigid(orient(3.0 * time_s, 0, 0), np.array([0.02 * time_s**2, 0.0, 0.2 * time_s**2]))

    def sight(f: int, s: int) -> Sightings:
        turn = Rotation.from_rotvec(np.radians(loose_deg[s]) * rng.standard_normal(3)).as_matrix()
        pose = transforms.rigid(turn, np.zeros(3)) @ places[s] @ transforms.invert(pose_at(times[f] + late_s[s]))
        return sighted(camera, [pose] * 3, street, rng)

    return drawn(rig, times, pose_at, street, sight)


@dataclass(frozen=True)
class Drive:
    """What is true of the vehicle with six cameras, and what the rig file says otherwise."""

    late_s: Sequence[float] = (0.0,) * 6
    speed: float = 5.0  # m/s
    gain: float = 0.0  # m/s2
    weave_deg: float = 1.0  # of the heading, once in 3 s: nobody drives straight as a die
    frames: int = 24
    bent: tuple[int, float] = (0, 0.0)  # camera, degrees by which it is turned (to the right) and the file does not say
    longer: float = 1.0  # true levers over given ones
    zoom: tuple[int, float] = (0, 1.0)  # camera, true focal length over the given one
    seed: int = 5

    def pose_at(self, time_s: float) -> np.ndarray:
        """world_from_rig (4, 4)."""
        along = self.speed * time_s + 0.5 * self.gain * time_s**2
        heading = np.radians(self.weave_deg) * np.sin(2 * np.pi * time_s / 3)
        aside = -self.speed * np.radians(self.weave_deg) * 3 / (2 * np.pi) * np.cos(2 * np.pi * time_s / 3)
        return transforms.rigid(orient(float(np.degrees(heading)), 0, 0), np.array([aside, 0.0, along]))


def driving_world(drive: Drive) -> tuple[pycolmap.Reconstruction, Scene]:
    """Model of the true frames with the rig and the lenses as given, for an adjustment to start from; its scene."""
    rng = np.random.default_rng(drive.seed)
    sensors, lenses, true = [], [], []
    for s, (place, yaw, f) in enumerate(zip(np.array(PLACES, float), YAWS, FOCAL_PX)):
        camera, zoom = (
            pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[z * f, z * f, 320.0, 240.0])
            for z in (1.0, drive.zoom[1] if s == drive.zoom[0] else 1.0)
        )
        turn = drive.bent[1] if s == drive.bent[0] else 0.0
        sensors.append(Sensor(f"cam{s}", camera, transforms.invert(transforms.rigid(orient(yaw, 0, 0), place))))
        true.append(transforms.invert(transforms.rigid(orient(yaw + turn, 0, 0), drive.longer * place)))
        lenses.append(zoom)
    end = float(drive.pose_at(INTERVAL_S * drive.frames)[2, 3])
    points = rng.uniform([-16, -5, -25], [16, 2, end + 25], (int(15 * (end + 40)), 3))
    points = points[np.abs(points[:, 0]) > 4]

    def sight(f: int, s: int) -> Sightings:
        pose = true[s] @ transforms.invert(drive.pose_at(INTERVAL_S * f + drive.late_s[s]))
        return sighted(lenses[s], [pose] * 3, points, rng, far=22, noise_px=0.4, share=0.6)

    rig = Rig("car", tuple(sensors), fixed=True)
    return drawn(rig, INTERVAL_S * np.arange(drive.frames), drive.pose_at, points, sight)


def with_sync(scene: Scene) -> Scene:
    """The same survey with a rig whose file says that its cameras fire at one instant."""
    return scene.with_(rigs=(replace(scene.rigs[0], synchronised=True),))


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
            database.write_keypoints(image.image_id, np.array([p.xy for p in image.points2D], np.float32))
        for frame in model.frames.values():
            database.write_frame(frame, use_frame_id=True)
        for a in sorted(point):
            for b in (b for b in point if a < b and abs(model.image(a).frame_id - model.image(b).frame_id) <= reach):
                shared = sorted(set(point[a]) & set(point[b]))
                if len(shared) >= 15:
                    matches = np.array([(point[a][p], point[b][p]) for p in shared], np.uint32)
                    database.write_matches(a, b, matches)
                    kind = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                    geometry = pycolmap.TwoViewGeometry(config=kind, inlier_matches=matches)
                    database.write_two_view_geometry(a, b, geometry)
