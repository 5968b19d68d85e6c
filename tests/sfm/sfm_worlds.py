"""Synthetic surveys with truth for the tests of structure from motion."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from near import rms
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.colmapmodel import MAX_IMAGES, image_poses, matrix
from tiegraph.scene.control import Control, Marks
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.mapper import Source, SparseResult, reconstruct
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings, SparseSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fit import Evidence
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import Georeference, georeference


class World(NamedTuple):
    """The truth of a survey, and its scene."""

    truth: pycolmap.Reconstruction
    scene: Scene

    @property
    def centres(self) -> np.ndarray:
        """True places of the frames (F, 3)."""
        return frame_centres(self.truth, self.scene)

    def measured(self, noise_m: float, seed: int = 1, sigma_m: float | None = None) -> Scene:
        """The scene with the frames' positions, whose noise is stated if no other sigma is given."""
        off = noise_m * np.random.default_rng(seed).standard_normal((self.scene.frames, 3))
        return with_positions(self.scene, self.centres + off, noise_m if sigma_m is None else sigma_m)

    def placed_by(self, survey: Scene, given: Measurements | None = None, **settings: object) -> Georeference:
        """A model of the survey, which is the truth in another frame and unit, placed by what is measured."""
        model, settings = elsewhere(self.truth), GeorefSettings(**settings)
        return georeference(model, survey, settings, Tuning().world, given or Measurements())

    def error_m(self, model: pycolmap.Reconstruction) -> float:
        """Root mean square of the errors of frames that are in the world."""
        return rms(frame_centres(model, self.scene) - self.centres)


def make_world(
    path: Path, cameras: int = 3, frames: int = 8, noise_px: float = 0.3, points: int = 150, **lens: object
) -> World:
    """A database with one rig, its truth, and its scene (extrinsics exact, cameras as given, no positions).

    ``lens``: other ``camera_...`` options of COLMAP's synthetic data.
    """
    pycolmap.set_random_seed(3)
    pycolmap.logging.minloglevel = 2
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1,
        num_cameras_per_rig=cameras,
        num_frames_per_rig=frames,
        num_points3D=points,
        camera_has_prior_focal_length=True,
        sensor_from_rig_translation_stddev=0.3,
        sensor_from_rig_rotation_stddev=5.0,
        **lens,
    )
    path.unlink(missing_ok=True)
    with pycolmap.Database.open(path) as database:
        truth = pycolmap.synthesize_dataset(options, database)
        pycolmap.synthesize_noise(pycolmap.SyntheticNoiseOptions(point2D_stddev=noise_px), truth, database)
    return World(truth, scene_of(truth))


def scene_of(truth: pycolmap.Reconstruction) -> Scene:
    """The scene of a synthetic reconstruction of one rig; frames and sensors in COLMAP's order."""
    row = truth.rig(1)
    camera_ids = sorted(truth.cameras)
    extrinsics = {row.ref_sensor_id.id: np.eye(4)} | {s.id: matrix(p) for s, p in row.non_ref_sensors.items()}
    sensors = tuple(Sensor(f"cam{c}", truth.camera(c), extrinsics[c]) for c in camera_ids)
    images = sorted((truth.image(i) for i in truth.reg_image_ids()), key=lambda i: i.name)
    frame_ids = sorted({i.frame_id for i in images})
    frame = np.array([frame_ids.index(i.frame_id) for i in images])
    sensor = np.array([camera_ids.index(i.camera_id) for i in images])
    rig = Rig("rig", sensors, fixed=True)
    track = np.zeros(len(frame_ids))
    return simple_scene(rig, [i.name for i in images], frame, sensor, sequence=track, sequences=("pass",))


def without_extrinsics(scene: Scene) -> Scene:
    """The scene with a rig of unknown extrinsics."""
    rig = scene.rigs[0]
    sensors = tuple(replace(s, sensor_from_rig=np.eye(4) if k == 0 else None) for k, s in enumerate(rig.sensors))
    return scene.with_(rigs=(replace(rig, sensors=sensors, fixed=False),))


def with_positions(scene: Scene, positions_m: np.ndarray, sigma_m: float, prior: str = "gnss") -> Scene:
    """The scene with prior positions (F, 3) and one sigma."""
    poses = np.full((scene.frames, 4, 4), np.nan)
    poses[:, :3, 3] = positions_m
    return scene.with_(world_from_rig=poses, position_sigma_m=np.full((scene.frames, 3), sigma_m), prior=prior)


def true_frames(truth: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """world_from_rig (F, 4, 4) of the truth."""
    poses = image_poses(truth, scene)
    reference = [np.flatnonzero((scene.frame == f) & (scene.sensor == 0))[0] for f in range(scene.frames)]
    return transforms.invert(poses[reference])


def drop_pairs(path: Path, gone: Callable[[int, int], bool]) -> None:
    """Verified pairs of a database go, of whose two images (COLMAP's numbers) that is so."""
    with sqlite3.connect(path) as db:
        for (pair,) in db.execute("SELECT pair_id FROM two_view_geometries").fetchall():
            if gone(*divmod(pair, MAX_IMAGES)):
                db.execute("DELETE FROM two_view_geometries WHERE pair_id = ?", (pair,))


def frame_centres(model: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """Places of the frames (F, 3) in a model."""
    return frame_poses(image_poses(model, scene), scene)[:, :3, 3]


def elsewhere(truth: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The truth in another frame and unit (0.37 of its own), as a mapper would give it."""
    model = pycolmap.Reconstruction(truth)
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_quat()
    model.transform(pycolmap.Sim3d(0.37, pycolmap.Rotation3d(turn), np.array([5.0, -3.0, 2.0])))
    return model


def seen_anew(truth: pycolmap.Reconstruction, place: Callable[..., np.ndarray]) -> pycolmap.Reconstruction:
    """The true model with other key points: ``place`` of an image, the number of a point and its exact pixel."""
    model = pycolmap.Reconstruction(truth)
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        for point in image.points2D:
            if point.has_point3D():
                exact = image.project_point(model.point3D(point.point3D_id).xyz)
                point.xy = place(image, point.point3D_id, exact)
    return model


def part_of(truth: pycolmap.Reconstruction, frames: range, noise: float, rng: np.random.Generator):
    """The truth of some frames; each point is off by as much as its rays let it."""
    model = pycolmap.Reconstruction(truth)
    for number, frame_id in enumerate(sorted(model.frames)):
        if number not in frames:
            model.deregister_frame(frame_id)
    for number in model.point3D_ids():
        model.point3D(number).xyz += noise * rng.standard_normal(3)
    return model


def run_sparse(
    folder: Path, scene: Scene, source: dict | None = None, shared: SceneTuning | None = None, **settings: object
) -> SparseResult:
    """The engine on the database of a folder; ``source``: what it is told besides (images, coarse model, ...)."""
    given = Source(**{"database": folder / "database.db", "images": None} | (source or {}))
    own, shared = SparseSettings(**settings), shared or SceneTuning()
    return reconstruct(given, folder / "sparse", scene, own, Tuning(), shared, folder / "log.txt")


def lone_scene(count: int, sensor: Sensor | None = None, **more: object) -> Scene:
    """Frames of one camera; without ``sequences`` they are photographs."""
    rig = Rig("lone", (sensor or Sensor("cam0", None, np.eye(4), "side"),))
    order = np.arange(count)
    if "sequences" in more:
        more = {"sequence": 0 * order} | more
    return simple_scene(rig, [f"{k:03d}.jpg" for k in order], order, 0 * order, **more)


def control_of(truth: pycolmap.Reconstruction, scene: Scene) -> Control:
    """Six points of the truth as surveyed points, their observations as marks; the last two are check points."""
    count, sigma = 6, 0.005
    ids = sorted(truth.points3D, key=lambda k: -truth.points3D[k].track.length())[:count]
    rows = [
        (n, scene.image_index[truth.image(e.image_id).name], truth.image(e.image_id).points2D[e.point2D_idx].xy)
        for n, k in enumerate(ids)
        for e in truth.points3D[k].track.elements[:6]
    ]
    rng = np.random.default_rng(0)
    place = np.array([truth.points3D[k].xyz for k in ids]) + sigma * rng.standard_normal((count, 3))
    point, image, xy = (np.array(column) for column in zip(*rows))
    marks = Marks(point, image, xy, np.arange(len(rows)) + 2, np.full(len(rows), np.nan))
    names, check = tuple(f"P{k}" for k in range(count)), np.arange(count) >= count - 2
    return Control(names, place, np.full((count, 3), sigma), check, marks, Origin(35.0, 139.0, 40.0))


def level_poses(place_m: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """world_from_camera (K, 4, 4) of a level camera that looks ahead (x right, y down, z forward)."""
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    across = np.cross([0.0, 0.0, -1.0], ahead)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return transforms.rigid(np.stack([across, np.cross(ahead, across), ahead], axis=2), place_m)


def evidence_of(place: np.ndarray, position: np.ndarray, sigma: float, **more: object) -> Evidence:
    """Cameras at places of a model, unturned, with a position each, of which nothing else is known."""
    count = len(place)
    given = {
        "frame": np.arange(count), "pose": transforms.rigid(np.eye(3), place), "speed": np.zeros((count, 4, 4)),
        "position": position, "sigma": np.full((count, 3), sigma), "orientation": np.full((count, 3, 3), np.nan),
        "modes": np.zeros((count, 3, 0)), "antenna": np.zeros(3),
    }  # fmt: skip
    return Evidence(**given | more)
