"""Rows of COLMAP's database by COLMAP's own objects: cameras, rigs, frames, images, priors, written in this place only.

Features and matches are the rows of ``scene.colmapdatabase``.

Ids: image_id = scene index + 1, camera_id = sensor key + 1, rig_id = rig index + 1, frame_id = frame + 1. Rows are
written here and not by ``pycolmap.apply_rig_config``, which identifies rigs by folder prefix and so would make one rig
of each pass.

COLMAP 4.2's mappers, incremental and global, give no model at all when one sensor of a rig lacks its extrinsics. Such a
sensor is therefore written as a rig of its own (rig_id = number of rigs + camera_id) and each of its images as a frame
of its own (frame_id = number of frames + image_id); without a rig all but the reference sensor are.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph import limits
from tiegraph.errors import InputError
from tiegraph.scene.atomic import remove, replacing
from tiegraph.scene.colmapdatabase import copy_verified, explained
from tiegraph.scene.colmapmodel import rigid3d, sensor_id
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.wideviews import is_fisheye

DATABASE_BYTES = 1 << 20  # of the tables and indices of an empty database and of its log, an upper bound
_IMAGE_BYTES = 4096  # of an image's rows, its frame's and its prior's, in file and log, an upper bound


def create_database(path: Path, scene: Scene) -> None:
    """Write a new database with the cameras, rigs, frames, images and position priors of a scene.

    Sensors of unknown extrinsics are rigs of their own (see above). The file appears whole or not at all. Raises
    sensor without a camera or a full disk.
    """
    cameras = []
    for key, sensor in enumerate(scene.all_sensors):
        if sensor.camera is None:
            raise InputError(f"sensor {sensor.name!r} has no camera: no image of it was found, remove it from the rig")
        cameras.append(_camera(sensor.camera, key + 1))
    try:
        with replacing(path) as temporary:
            limits.need_room(path, DATABASE_BYTES + _IMAGE_BYTES * len(scene))  # COLMAP would end the process
            with writing(temporary) as database:
                for camera in cameras:
                    database.write_camera(camera, use_camera_id=True)
                keys = (scene.sensor_key + 1).tolist()
                images = {}
                for k, name in enumerate(scene.names):
                    images[k] = pycolmap.Image(name=name, camera_id=keys[k], image_id=k + 1)
                    database.write_image(images[k], use_image_id=True)
                _write_frames(database, scene, images, dict(enumerate(scene.rigs)))
                _write_positions(database, scene, images, scene.world_from_rig[:, :3, 3], scene.position_sigma_m**2)
            remove(path)
    except InputError:
        raise
    except (RuntimeError, ValueError, OSError) as error:
        raise explained(path, error) from error


def _camera(given: pycolmap.Camera, camera_id: int) -> pycolmap.Camera:
    """A camera under COLMAP's id. The guessed focal length of a fisheye lens counts as known: COLMAP verifies no pair
    of images without one, because a fundamental matrix says nothing of such a lens."""
    camera = copy(given)
    camera.camera_id = camera_id
    camera.has_prior_focal_length |= is_fisheye(camera)
    return camera


def write_working_copy(
    source: Path,
    target: Path,
    scene: Scene,
    with_rig: Mapping[int, Rig],
    positions: tuple[np.ndarray, np.ndarray] | None,
    refused: Sequence[tuple[int, int]] = (),
    only: np.ndarray | None = None,
) -> None:
    """Copy the data for a mapper from ``source`` to a new database ``target``.

    ``with_rig`` maps rig indices to the rigs to constrain by; images of other rigs, and of sensors whose extrinsics are
    unknown there, become frames of their own. ``positions``: prior positions (F, 3) of the frames and their variances
    (F, 3), world metres, NaN = none, for the mapper; None: it gets none. ``refused`` are pairs of scene indices whose
    ties the mapper must not see. ``only``: scene indices of the images to copy, None = all. Descriptors and raw
    matches, most of the bytes, stay behind.
    """
    names = None if only is None else {scene.names[k] for k in only.tolist()}
    copy_verified(source, target, names, [(scene.names[i], scene.names[j]) for i, j in refused])
    with writing(target) as database:
        # Images of the database by scene index; one whose name the scene lacks is left out of every frame
        found = {scene.image_index.get(image.name): image for image in database.read_all_images()}
        images = {index: image for index, image in sorted((k, i) for k, i in found.items() if k is not None)}
        # The focal length by the previews is a better initial value than the guess.
        for key, camera_id in {int(scene.sensor_key[k]): image.camera_id for k, image in images.items()}.items():
            if (camera := scene.all_sensors[key].camera) is not None:
                database.update_camera(_camera(camera, camera_id))
        _write_frames(database, scene, images, with_rig)
        if positions is not None:
            _write_positions(database, scene, images, *positions)


def _write_frames(
    database: pycolmap.Database, scene: Scene, images: dict[int, pycolmap.Image], with_rig: Mapping[int, Rig]
) -> None:
    """One rig and its frames for each constrained rig; one rig a camera, one frame an image for everything else."""
    camera_of = {int(scene.sensor_key[k]): image.camera_id for k, image in images.items()}
    bound: set[int] = set()
    for index, rig in with_rig.items():
        known = [s for s, sensor in enumerate(rig.sensors) if not s or sensor.sensor_from_rig is not None]
        cameras = {s: camera_of[key] for s in known if (key := scene.first_sensor(index) + s) in camera_of}
        if cameras:
            database.write_rig(_colmap_rig(index + 1, rig, cameras), use_rig_id=True)
            bound |= set(cameras.values())
    for camera in sorted({image.camera_id for image in images.values()} - bound):
        row = pycolmap.Rig(rig_id=len(scene.rigs) + camera)  # ids above those of the constrained rigs
        row.add_ref_sensor(sensor_id(camera))
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
    """COLMAP's rig of the sensors that have images; without images of the reference, the next sensor replaces it."""
    row = pycolmap.Rig(rig_id=rig_id)
    first, *others = sorted(cameras)
    row.add_ref_sensor(sensor_id(cameras[first]))
    reference = np.asarray(rig.sensors[first].sensor_from_rig) if first else np.eye(4)
    for s in others:
        extrinsics = np.asarray(rig.sensors[s].sensor_from_rig)
        row.add_sensor(sensor_id(cameras[s]), rigid3d(extrinsics @ np.linalg.inv(reference)))
    return row


def _write_positions(
    database: pycolmap.Database,
    scene: Scene,
    images: dict[int, pycolmap.Image],
    positions: np.ndarray,
    variances: np.ndarray,
) -> None:
    """The position priors of frames, each on its reference image: one GNSS fix on six images would count six times in
    the adjustment. An unknown variance stays NaN: COLMAP then takes its own."""
    for k, image in images.items():
        frame = int(scene.frame[k])
        if scene.sensor[k] != 0 or not np.isfinite(positions[frame]).all():
            continue
        prior = pycolmap.PosePrior(
            pose_prior_id=frame + 1,
            corr_data_id=image.data_id,
            position=positions[frame],
            position_covariance=np.diag(variances[frame]),
            coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
        )
        database.write_pose_prior(prior, use_pose_prior_id=True)


def write_ties(path: Path, keypoints: Iterable[np.ndarray], ties: PreviewMatches, used: np.ndarray) -> None:
    """Write the key points (K, 2) pixels of image after image, and the ``used`` (T,) ties as verified matches."""
    with writing(path) as database:
        for k, xy in enumerate(keypoints):
            database.write_keypoints(k + 1, np.ascontiguousarray(xy, np.float32))
        for t in np.flatnonzero(used):
            i, j = int(ties.i[t]) + 1, int(ties.j[t]) + 1
            matches = ties.of(int(t)).astype(np.uint32)
            database.write_matches(i, j, matches)
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
            geometry.inlier_matches = matches
            database.write_two_view_geometry(i, j, geometry)


def read_cache(path: Path, min_matches: int) -> pycolmap.DatabaseCache:
    """All images of a database, and its verified pairs of so many matches, as COLMAP's mappers want them."""
    with pycolmap.Database.open(path) as database:
        wanted = pycolmap.DatabaseCacheOptions(min_num_matches=min_matches, load_all_images=True)
        return pycolmap.DatabaseCache.create(database, wanted)


def sizes(path: Path) -> tuple[int, int]:
    """Number of frames and of images of a database."""
    with pycolmap.Database.open(path) as database:
        return database.num_frames(), database.num_images()


@contextmanager
def writing(path: Path) -> Iterator[pycolmap.Database]:
    """A database, opened or made anew by COLMAP, in one transaction."""
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        yield database
