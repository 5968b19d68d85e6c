"""COLMAP's database: written from the scene with our own ids, filled in transactions, checked after each stage.

Ids: image_id = scene index + 1, camera_id = sensor key + 1, rig_id = rig index + 1, frame_id = frame + 1. Rows are
written here and not by ``pycolmap.apply_rig_config``, which tells rigs apart by folder prefix and so would make one rig
of each pass.

COLMAP 4.2's mappers, incremental and global, give no model at all when one sensor of a rig lacks its extrinsics. Such a
sensor is therefore written as a rig of its own (rig_id = number of rigs + camera_id) and each of its images as a frame
of its own (frame_id = number of frames + image_id); without a rig all but the reference sensor are.

The file is in SQLite's WAL mode: what was committed survives the SIGKILL of its writer.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph import limits
from tiegraph.errors import InputError, TiegraphError, UnreadableArtefact
from tiegraph.geometry import transforms
from tiegraph.scene.atomic import replacing
from tiegraph.scene.colmapmodel import MAX_IMAGES
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

_LOCK_S = 60.0
DATABASE_BYTES = 1 << 20  # of the tables and indices of an empty database and of its log, generously
_IMAGE_BYTES = 4096  # of an image's rows, its frame's and its prior's, in file and log, generously

Features = tuple[int, np.ndarray, np.ndarray]


def create_database(path: Path, scene: Scene, with_rig: bool = True) -> None:
    """Write a new database with the cameras, rigs, frames, images and position priors of a scene.

    ``with_rig=False``: no two images share a frame. With a rig, those of unknown extrinsics stand alone (see above).
    The file appears whole or not at all. Raises InputError for a sensor without a camera or a full disk.
    """
    for sensor in scene.all_sensors:
        if sensor.camera is None:
            raise InputError(f"sensor {sensor.name!r} has no camera: no image of it was found, take it off the rig")
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".tmp")
    _remove(temporary)
    limits.need_room(temporary, DATABASE_BYTES + _IMAGE_BYTES * len(scene))  # COLMAP would end the process
    try:
        with pycolmap.Database.open(temporary) as database, pycolmap.DatabaseTransaction(database):
            _write_rigs(database, scene, with_rig)
            _write_images(database, scene, with_rig)
            for prior in position_priors(scene):
                database.write_pose_prior(prior, use_pose_prior_id=True)
        _remove(path)
        os.replace(temporary, path)
    except (RuntimeError, ValueError, OSError) as error:
        raise _explained(path, error) from error
    finally:
        _remove(temporary)


def _write_rigs(database: pycolmap.Database, scene: Scene, with_rig: bool) -> None:
    key = 0
    for index, rig in enumerate(scene.rigs):
        row = pycolmap.Rig(rig_id=index + 1)
        row.add_ref_sensor(_sensor_id(key))
        alone = []
        for place, sensor in enumerate(rig.sensors):
            camera = copy(sensor.camera)
            assert camera is not None  # checked by create_database
            camera.camera_id = key + 1
            database.write_camera(camera, use_camera_id=True)
            if place > 0 and with_rig and sensor.sensor_from_rig is not None:
                row.add_sensor(_sensor_id(key), pycolmap.Rigid3d(np.asarray(sensor.sensor_from_rig, float)[:3]))
            elif place > 0:
                alone.append(pycolmap.Rig(rig_id=len(scene.rigs) + key + 1))
                alone[-1].add_ref_sensor(_sensor_id(key))
            key += 1
        for each in (row, *alone):
            database.write_rig(each, use_rig_id=True)


def _write_images(database: pycolmap.Database, scene: Scene, with_rig: bool) -> None:
    keys = scene.sensor_key
    frame_id, rig_id = scene.frame.astype(int) + 1, scene.rig[scene.frame].astype(int) + 1
    for k, name in enumerate(scene.names):
        image = pycolmap.Image(name=name, camera_id=int(keys[k]) + 1, image_id=k + 1)
        database.write_image(image, use_image_id=True)
        if scene.sensor[k] > 0 and not (with_rig and scene.sensor_of(k).sensor_from_rig is not None):
            frame_id[k], rig_id[k] = scene.frames + k + 1, len(scene.rigs) + keys[k] + 1
    for members in _groups(frame_id):
        frame = pycolmap.Frame(frame_id=int(frame_id[members[0]]), rig_id=int(rig_id[members[0]]))
        for k in members:
            frame.add_data_id(pycolmap.data_t(_sensor_id(int(keys[k])), int(k) + 1))
        database.write_frame(frame, use_frame_id=True)


def _groups(label: np.ndarray) -> list[np.ndarray]:
    """Indices of equal labels, in the order of the labels."""
    order = np.argsort(label, kind="stable")
    return [g for g in np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if len(g)]


def position_priors(scene: Scene) -> list[pycolmap.PosePrior]:
    """One position prior (camera centre, world metres) for each frame with a prior position, at most one a frame.

    It belongs to the frame's reference image: one GNSS fix on six images would count six times in the adjustment. When
    that image was left out, another stands in if its centre is known: by the full prior pose, or because it lies closer
    to the rig's origin than the position's sigma. An unknown sigma stays NaN (COLMAP then takes its own).
    """
    priors = []
    for members in _groups(scene.frame):
        frame = int(scene.frame[members[0]])
        if not np.isfinite(scene.world_from_rig[frame, :3, 3]).all():
            continue
        image, position_m = _prior_image(scene, frame, sorted(members.tolist(), key=lambda k: scene.sensor[k]))
        if image is None:
            continue
        prior = pycolmap.PosePrior(pose_prior_id=frame + 1)
        prior.corr_data_id = pycolmap.data_t(_sensor_id(int(scene.sensor_key[image])), image + 1)
        prior.position = position_m
        prior.position_covariance = np.diag(scene.position_sigma_m[frame] ** 2)
        prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.CARTESIAN
        priors.append(prior)
    return priors


def _prior_image(scene: Scene, frame: int, members: list[int]) -> tuple[int | None, np.ndarray]:
    world_from_rig = scene.world_from_rig[frame]
    sigma_m = scene.position_sigma_m[frame]
    for k in members:
        if scene.sensor[k] == 0:
            return k, world_from_rig[:3, 3]
        sensor_from_rig = scene.sensor_of(k).sensor_from_rig
        if sensor_from_rig is None:
            continue
        centre_m = transforms.centre(sensor_from_rig)
        if np.isfinite(world_from_rig[:3, :3]).all():
            return k, transforms.apply(world_from_rig, centre_m[None])[0]
        if np.linalg.norm(centre_m) < np.nanmax(np.append(sigma_m, 0.0)):
            return k, world_from_rig[:3, 3]
    return None, world_from_rig[:3, 3]


def write_features(path: Path, batch: Sequence[Features]) -> None:
    """Write (scene index, keypoints (K, 4) f4, descriptors (K, 128) u1) of several images in one transaction.

    Images written before are replaced. Raises InputError when the disk is full; images of earlier batches stay.
    """
    keypoints, descriptors = [], []
    sift = int(pycolmap.FeatureExtractorType.SIFT)
    for index, points, vectors in batch:
        points, vectors = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(vectors)
        if points.ndim != 2 or points.shape[1] != 4 or vectors.shape != (len(points), 128) or vectors.dtype != np.uint8:
            raise ValueError(f"image {index}: keypoints {points.shape}, descriptors {vectors.shape} {vectors.dtype}")
        keypoints.append((index + 1, len(points), 4, points.tobytes()))
        descriptors.append((index + 1, sift, len(points), 128, vectors.tobytes()))
    with transaction(path) as cursor:
        cursor.executemany("INSERT OR REPLACE INTO keypoints (image_id, rows, cols, data) VALUES (?,?,?,?)", keypoints)
        cursor.executemany(
            "INSERT OR REPLACE INTO descriptors (image_id, type, rows, cols, data) VALUES (?,?,?,?,?)", descriptors
        )


def feature_counts(path: Path) -> dict[int, int]:
    """Number of features by scene index, of the images whose key points and descriptors are both in and agree."""
    with reading(path) as cursor:
        rows = cursor.execute(
            "SELECT k.image_id - 1, k.rows FROM keypoints k JOIN descriptors d USING (image_id) WHERE k.rows = d.rows"
        )
        return dict(rows.fetchall())


def images_with_features(path: Path) -> set[int]:
    """Scene indices of the images whose features are in (also those with none found)."""
    return set(feature_counts(path))


def lost_features(path: Path, scene: Scene, wanted: Iterable[int]) -> list[tuple[str, str]]:
    """(image name, reason) of the wanted images without features in the database, or with none found."""
    counts = feature_counts(path)
    lost = []
    for k in sorted(wanted):
        if k not in counts:
            lost.append((scene.names[k], "no features were written"))
        elif counts[k] == 0:
            lost.append((scene.names[k], "no features were found (blank, blurred or fully masked image)"))
    return lost


def clear_matches(path: Path) -> None:
    """Delete all matches and two-view geometries; features stay."""
    with transaction(path) as cursor:
        cursor.execute("DELETE FROM matches")
        cursor.execute("DELETE FROM two_view_geometries")


def write_anew(path: Path) -> None:
    """Write the file again as if its rows had come one after another: equal rows make equal bytes, whatever the order
    in which COLMAP's threads finished, interruptions, and rows that were deleted.

    No log is left beside it. Raises InputError when the disk has no room for the second copy, and TiegraphError when
    another program reads the file; it then stays as it was.
    """
    with replacing(path) as temporary:
        with _opened(path) as connection:
            # Else the log would stay, to be played into the new file.
            connection.execute("PRAGMA journal_mode = DELETE")
            connection.execute("VACUUM INTO ?", (str(temporary),))
        with _opened(temporary) as connection:
            connection.execute("PRAGMA schema_version = 1")  # it counts how often this was done


def pair_ids(pairs: Pairs) -> np.ndarray:
    """(P,) COLMAP's ids of pairs of scene indices."""
    return (pairs.i.astype(np.int64) + 1) * MAX_IMAGES + pairs.j + 1


@contextmanager
def transaction(path: Path, beside: Path | None = None) -> Iterator[sqlite3.Cursor]:
    """A cursor in one write transaction: committed at the end, undone by any error. SQLite's errors are explained.

    ``beside``: another database, whose tables are ``beside.<table>``.
    """
    with _opened(path) as connection:
        cursor = connection.cursor()
        if beside is not None:
            cursor.execute("ATTACH ? AS beside", (str(beside),))
        cursor.execute("BEGIN IMMEDIATE")
        try:
            yield cursor
            cursor.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                cursor.execute("ROLLBACK")
            raise


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Cursor]:
    """A cursor for reading."""
    with _opened(path) as connection:
        yield connection.cursor()


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    if not path.is_file():
        raise InputError(f"database {path} does not exist: run the features stage first")
    try:
        connection = sqlite3.connect(path, timeout=_LOCK_S, isolation_level=None)
        try:
            connection.execute("PRAGMA synchronous=NORMAL")
            yield connection
        finally:
            connection.close()
    except sqlite3.Error as error:
        raise _explained(path, error) from error


def _explained(path: Path, error: Exception) -> TiegraphError:
    text = str(error)
    told = limits.explained(error, path.parent) or limits.explained_text(text, path.parent)
    if told is not None:
        return type(told)(f"{path} cannot be written: {told}")
    if (
        "disk I/O" in text or "factory" in text or "readonly" in text or "unable to open" in text
    ):  # all that COLMAP says of its reason
        return InputError(f"{path} cannot be written ({text}): is the disk full or the folder read-only?")
    if "locked" in text:
        return TiegraphError(f"{path} is in use by another program ({text}): close it and run again")
    if "malformed" in text or "not a database" in text:
        return UnreadableArtefact(path, text)
    return TiegraphError(f"{path}: {text}")


def _remove(path: Path) -> None:
    # A log left beside a replaced database would be played into the new one.
    for suffix in ("", "-wal", "-shm", "-journal"):
        Path(f"{path}{suffix}").unlink(missing_ok=True)


def _sensor_id(key: int) -> pycolmap.sensor_t:
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, key + 1)
