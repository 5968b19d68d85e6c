"""The mapper's own copy of the database: rigs, frames and priors as this run wants them, the user's file untouched."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tiegraph.scene.colmapmodel import MAX_IMAGES
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import held_out_frames, rigid3d
from tiegraph.sfm.tuning.world import FixTuning

# All a mapper reads besides rigs, frames and priors, and which rows of it some images need.
_COPIED = {
    "cameras": "",
    "images": "WHERE image_id IN wanted",
    "keypoints": "WHERE image_id IN wanted",
    "two_view_geometries": f"WHERE pair_id / {MAX_IMAGES} IN wanted AND pair_id % {MAX_IMAGES} IN wanted",
}


def write_working_copy(
    source: Path,
    target: Path,
    scene: Scene,
    with_rig: Mapping[int, Rig],
    positions: FixTuning | None,
    refused: Sequence[tuple[int, int]] = (),
    only: np.ndarray | None = None,
) -> None:
    """Copy what a mapper needs of ``source`` to a new database ``target``.

    ``with_rig`` maps rig indices to the rigs to constrain by; images of other rigs, and of sensors whose extrinsics are
    unknown there, become frames of their own. ``positions``: write the scene's prior positions (world metres) for the
    mapper, all but the held-out ones; None: it gets none. ``refused`` are pairs of scene indices whose ties the mapper
    must not see. ``only``: scene indices of the images to copy, None = all. Descriptors and raw matches, most of the
    bytes, stay behind.
    """
    target.unlink(missing_ok=True)
    pycolmap.Database.open(target).close()  # COLMAP makes the tables
    connection = sqlite3.connect(target)
    try:
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("ATTACH DATABASE ? AS source", (str(source),))
        with connection:
            connection.execute("CREATE TEMP TABLE wanted (image_id INTEGER PRIMARY KEY)")
            chosen = None if only is None else {scene.names[k] for k in only.tolist()}
            rows = connection.execute("SELECT image_id, name FROM source.images").fetchall()
            ids = [(number,) for number, name in rows if chosen is None or name in chosen]
            connection.executemany("INSERT INTO wanted VALUES (?)", ids)
            for table, where in _COPIED.items():
                part = "" if only is None else where
                connection.execute(f"INSERT INTO {table} SELECT * FROM source.{table} {part}")
            names = {name: image_id for image_id, name in connection.execute("SELECT image_id, name FROM images")}
            gone = [sorted(names.get(scene.names[k], 0) for k in pair) for pair in refused]
            connection.executemany(
                "DELETE FROM two_view_geometries WHERE pair_id = ?", [(MAX_IMAGES * low + high,) for low, high in gone]
            )
    finally:
        connection.close()
    with pycolmap.Database.open(target) as database, pycolmap.DatabaseTransaction(database):
        images = _scene_images(database, scene)
        _update_cameras(database, scene, images)
        _write_rigs(database, scene, images, with_rig)
        if positions is not None:
            _write_positions(database, scene, images, positions)


def _scene_images(database: pycolmap.Database, scene: Scene) -> dict[int, pycolmap.Image]:
    """Images of the database by scene index; one whose name the scene does not have is left out of every frame."""
    found = {scene.image_index.get(image.name): image for image in database.read_all_images()}
    return {index: image for index, image in sorted((k, i) for k, i in found.items() if k is not None)}


def _update_cameras(database: pycolmap.Database, scene: Scene, images: dict[int, pycolmap.Image]) -> None:
    """The scene's cameras: what the previews found of a guessed focal length is a better start than the guess."""
    for k, camera_id in {int(scene.sensor_key[k]): image.camera_id for k, image in images.items()}.items():
        camera = copy(scene.all_sensors[k].camera)
        if camera is not None:
            camera.camera_id = camera_id
            database.update_camera(camera)


def _write_rigs(
    database: pycolmap.Database, scene: Scene, images: dict[int, pycolmap.Image], with_rig: Mapping[int, Rig]
) -> None:
    """One rig and its frames for each constrained rig; one rig a camera, one frame an image for everything else."""
    camera_of = {int(scene.sensor_key[k]): image.camera_id for k, image in images.items()}
    first_key = np.cumsum([0] + [len(r.sensors) for r in scene.rigs])
    bound: set[int] = set()
    for index, rig in with_rig.items():
        known = [s for s, sensor in enumerate(rig.sensors) if sensor.sensor_from_rig is not None]
        cameras = {s: camera_of[key] for s in known if (key := int(first_key[index]) + s) in camera_of}
        if cameras:
            database.write_rig(_colmap_rig(index + 1, rig, cameras), use_rig_id=True)
            bound |= set(cameras.values())
    for camera in sorted({image.camera_id for image in images.values()} - bound):
        row = pycolmap.Rig(rig_id=len(scene.rigs) + camera)  # ids above those of the constrained rigs
        row.add_ref_sensor(_sensor_id(camera))
        database.write_rig(row, use_rig_id=True)
    members: dict[tuple[int, int], list[pycolmap.Image]] = {}
    for k, image in images.items():
        if image.camera_id in bound:
            frame = int(scene.frame[k])
            members.setdefault((frame + 1, int(scene.rig[frame]) + 1), []).append(image)
        else:
            members[scene.frames + image.image_id, len(scene.rigs) + image.camera_id] = [image]
    for (frame_id, rig_id), of_frame in members.items():
        group = pycolmap.Frame(frame_id=frame_id, rig_id=rig_id)
        for image in of_frame:
            group.add_data_id(image.data_id)
        database.write_frame(group, use_frame_id=True)


def _colmap_rig(rig_id: int, rig: Rig, cameras: dict[int, int]) -> pycolmap.Rig:
    """COLMAP's rig of the sensors that have images; without images of the reference, the next sensor takes its part."""
    row = pycolmap.Rig(rig_id=rig_id)
    first, *others = sorted(cameras)
    row.add_ref_sensor(_sensor_id(cameras[first]))
    reference = np.asarray(rig.sensors[first].sensor_from_rig)
    for s in others:
        extrinsics = np.asarray(rig.sensors[s].sensor_from_rig)
        row.add_sensor(_sensor_id(cameras[s]), rigid3d(extrinsics @ np.linalg.inv(reference)))
    return row


def _write_positions(
    database: pycolmap.Database, scene: Scene, images: dict[int, pycolmap.Image], tuning: FixTuning
) -> None:
    """Position priors on reference images. COLMAP knows no lever arm: its length widens the sigma instead."""
    held_out = held_out_frames(scene, tuning)
    prior_id = 0
    for k, image in images.items():
        frame = int(scene.frame[k])
        position = scene.world_from_rig[frame, :3, 3]
        if scene.sensor[k] != 0 or held_out[frame] or not np.isfinite(position).all():
            continue
        sigma = np.where(np.isfinite(s := scene.position_sigma_m[frame]), s, tuning.unknown_sigma_m)
        antenna = scene.rigs[scene.rig[frame]].antenna_m
        arm = 0.0 if antenna is None or scene.prior == "trajectory" else float(np.linalg.norm(antenna))
        prior_id += 1
        prior = pycolmap.PosePrior(
            pose_prior_id=prior_id,
            corr_data_id=image.data_id,
            position=position,
            position_covariance=np.diag(sigma**2 + arm**2),
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        database.write_pose_prior(prior, use_pose_prior_id=True)


def _sensor_id(camera_id: int) -> pycolmap.sensor_t:
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)


class ViewGraph:
    """What the database holds of each image: key points, verified pairs, and the component it is in."""

    def __init__(
        self, database_path: Path, scene: Scene, min_matches: int, refused: Sequence[tuple[int, int]] = ()
    ) -> None:
        """Read the counts; indices are the scene's, -1 in ``component`` = no verified pair but ``refused`` ones."""
        connection = sqlite3.connect(f"{database_path.absolute().as_uri()}?mode=ro", uri=True)
        try:
            names = dict(connection.execute("SELECT image_id, name FROM images"))
            rows = dict(connection.execute("SELECT image_id, rows FROM keypoints"))
            pairs = connection.execute("SELECT pair_id, rows FROM two_view_geometries WHERE rows > 0").fetchall()
        finally:
            connection.close()
        index = {image_id: scene.image_index.get(name, -1) for image_id, name in names.items()}
        count = len(scene)
        self.features = np.zeros(count, int)
        for image_id, number in rows.items():
            if index.get(image_id, -1) >= 0:
                self.features[index[image_id]] = number
        table = np.array([(*_pair(pair_id), inliers) for pair_id, inliers in pairs], int).reshape(-1, 3)
        table = table[table[:, 2] >= min_matches]
        ends = np.array([[index.get(a, -1), index.get(b, -1)] for a, b, _ in table], int).reshape(-1, 2)
        away = {(min(pair), max(pair)) for pair in refused}
        inside = (ends >= 0).all(axis=1) & np.array([(min(e), max(e)) not in away for e in ends.tolist()], bool)
        self.pairs, self.inliers = ends[inside], table[inside, 2]
        self.degree = np.bincount(self.pairs.ravel(), minlength=count)
        graph = coo_matrix((np.ones(len(self.pairs)), self.pairs.T), shape=(count, count))
        labels = connected_components(graph, directed=False)[1]
        self.component = np.where(self.degree > 0, labels, -1)

    @property
    def components(self) -> list[int]:
        """Sizes of the components of images with verified pairs, largest first."""
        return sorted(np.bincount(self.component[self.component >= 0]).tolist(), reverse=True)


def _pair(pair_id: int) -> tuple[int, int]:
    return pair_id // MAX_IMAGES, pair_id % MAX_IMAGES
