"""Synthetic surveys with truth for the tests of structure from motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses, matrix
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene


def make_world(
    path: Path, cameras: int = 3, frames: int = 8, noise_px: float = 0.3, points: int = 150, **lens: object
) -> tuple[pycolmap.Reconstruction, Scene]:
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
    return truth, scene_of(truth)


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
