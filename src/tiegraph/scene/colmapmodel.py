"""COLMAP's models: read from files of any origin (a damaged one is an error, never a hang), converted to arrays by the
scene's images and sensors; which images are registered, for all counts; how Ceres solves their adjustments.

A pose alone proves nothing: COLMAP registers a frame with all the cameras of its rig, also with those that see no point
at all (27 images of a drone rig over forest). An image is *registered* if it sees at least 10 points with residuals
below 4 px; one that has a pose but not these is *placed by the rig*, and is counted separately everywhere.
"""

import shutil
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError, reading
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.scene.atomic import regular, scratch_folder
from tiegraph.scene.names import check_text
from tiegraph.scene.results import Model
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning

# COLMAP: pair_id = 2147483647 * smaller image_id + larger image_id (colmap/util/types.h, kMaxNumImages).
MAX_IMAGES = 2147483647
_POSE = 7 * 8  # a quaternion and a translation
_OF_NUMBERS = frozenset("0123456789.+-eE \t\r")
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")


def is_model(folder: Path) -> bool:
    """Whether a folder contains a COLMAP model, binary or text."""
    return any((folder / f"images.{kind}").exists() for kind in ("bin", "txt"))


def read_model(folder: Path | str) -> Model:
    """The model of a folder. Raises InputError naming the damaged part."""
    folder = Path(folder)
    for name, end_of in _RECORDS.items():
        _check(folder / f"{name}.bin", end_of)
        _check(folder / f"{name}.txt", None)
    text = (folder / "images.txt").exists() and not (folder / "images.bin").exists()
    with reading(folder, "COLMAP model"):
        model = _read_text(folder) if text else Model(str(folder))
        for image in model.images.values():
            check_text(image.name, "image")  # read here: one that is not UTF-8 is an error of its own
    return model


def _read_text(folder: Path) -> Any:
    """The model of text files as other programs write them: names with blanks, which pycolmap would cut at the first,
    images without a line for points, of which it would read only every second one, and no points at all."""
    if not (folder / "cameras.txt").exists():
        raise InputError(f"{folder}: no cameras.txt; a model has cameras.txt, images.txt and, if any, points3D.txt")
    cameras = (folder / "cameras.txt").read_text("utf-8-sig", "replace").split("\n")
    known = {line.split()[0] for line in cameras if line.strip() and line[0] != "#"}
    names, lines = _image_lines(folder / "images.txt")
    lost = next((line.split() for line in lines[::2] if line.split()[8] not in known), None)
    if lost is not None:
        raise InputError(
            f"{folder / 'cameras.txt'}: no camera {lost[8]}, which images.txt has for {names[int(lost[0])]}"
        )
    with scratch_folder() as made:
        for name in ("rigs.txt", "cameras.txt", "frames.txt", "points3D.txt"):
            if (folder / name).exists():
                shutil.copyfile(folder / name, made / name)
        (made / "points3D.txt").touch()
        (made / "images.txt").write_text("\n".join([*lines, ""]), encoding="ascii")
        model = pycolmap.Reconstruction(made)
    for number, name in names.items():
        model.images[number].name = name
    return model


def _image_lines(path: Path) -> tuple[dict[int, str], list[str]]:
    """Name of each image by its id, and two lines per image with the id instead of the name."""
    names: dict[int, str] = {}
    lines: list[str] = []
    for number, line in enumerate(path.read_text("utf-8-sig", "surrogateescape").split("\n"), 1):
        count, where = len(line.split()), f"{path}, line {number}"
        if not count or line.startswith("#"):
            continue
        if _OF_NUMBERS.issuperset(line) and count % 3 == 0 and lines and not lines[-1]:
            lines[-1] = line
            continue
        *values, name = line.strip().split(None, 9)
        try:
            _, qw, qx, qy, qz, tx, ty, tz, _ = (float(v) for v in values)
        except ValueError:
            text = "neither an image (id, qw, qx, qy, qz, tx, ty, tz, camera, name; with decimal points) nor its points"
            raise InputError(f"{where}: {text}") from None
        if not 0 < qw * qw + qx * qx + qy * qy + qz * qz < np.inf or not np.isfinite(tx + ty + tz):
            raise InputError(f"{where}: {' '.join(values[1:8])} is no pose: a quaternion is not 0")
        if int(values[0]) in names or name in names.values():
            raise InputError(f"{where}: {name} or its number {values[0]} is listed twice")
        names[int(values[0])] = name
        lines += [" ".join([*values, values[0]]), ""]
    return names, lines


def _check(path: Path, end_of: Callable[[bytes, int], int] | None) -> None:
    """Raise InputError for an unreadable file, or one whose records do not fill it.

    pycolmap trusts the numbers in a file: in one that is cut off it reads past the end for minutes, or requests
    more memory than there is.
    """
    if not path.exists():
        return
    try:
        regular(path, None)
        data = path.read_bytes() if end_of else b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if end_of is None:
        return
    try:
        at = 8
        for _ in range(_U64.unpack_from(data)[0]):
            at = end_of(data, at)
    except (struct.error, LookupError, OverflowError, ValueError):  # past the end, no end of a name, no such camera
        at = -1
    if at != len(data):
        raise InputError(f"{path}: the file is cut off or damaged; make the model again")


# Each: the end of the record that begins at a place in a file (colmap/scene/reconstruction_io_binary.cc).


def _camera(data: bytes, at: int) -> int:
    model = struct.unpack_from("<i", data, at + 4)[0]
    return at + 24 + 8 * _parameters()[model]  # id, model, width, height


@cache
def _parameters() -> dict[int, int]:
    """Number of parameters of each camera model by its id."""
    models = [m for m in pycolmap.CameraModelId.__members__.values() if int(m) >= 0]
    return {int(m): len(pycolmap.Camera.create_from_model_id(1, m, 1.0, 1, 1).params) for m in models}


def _image(data: bytes, at: int) -> int:
    at = data.index(b"\0", at + 4 + _POSE + 4) + 1  # id, pose, camera id, name
    return at + 8 + 24 * _U64.unpack_from(data, at)[0]  # x, y, point id


def _point(data: bytes, at: int) -> int:
    return at + 51 + 8 * _U64.unpack_from(data, at + 43)[0]  # id, x, y, z, colour, error, length; image, index


def _rig(data: bytes, at: int) -> int:
    count = _U32.unpack_from(data, at + 4)[0]  # id, number of sensors
    at += 8
    for k in range(count):
        at += 8  # type, id
        if k > 0:  # the first is the reference
            at += 1 + _POSE * bool(data[at])
    return at


def _frame(data: bytes, at: int) -> int:
    return at + 12 + _POSE + 16 * _U32.unpack_from(data, at + 8 + _POSE)[0]  # id, rig, pose, count; sensor, image


_RECORDS = {"rigs": _rig, "cameras": _camera, "frames": _frame, "images": _image, "points3D": _point}


def matrix(transform: pycolmap.Rigid3d) -> np.ndarray:
    """(4, 4) of a COLMAP rigid transform."""
    return np.vstack([transform.matrix(), [0.0, 0.0, 0.0, 1.0]])


def rigid3d(target_from_source: np.ndarray) -> pycolmap.Rigid3d:
    """COLMAP rigid transform of (4, 4)."""
    turn = pycolmap.Rotation3d(transforms.quaternion_xyzw(target_from_source[:3, :3]))
    return pycolmap.Rigid3d(turn, np.asarray(target_from_source[:3, 3], float))


def add_rig(
    model: pycolmap.Reconstruction, cameras: Sequence[pycolmap.Camera], sensor_from_rig: Sequence[pycolmap.Rigid3d]
) -> None:
    """Give a model its rig 1: camera k has the id k + 1, the first is the reference."""
    rig = pycolmap.Rig(rig_id=1)
    for number, camera in enumerate(cameras):
        own = deepcopy(camera)
        own.camera_id = number + 1
        model.add_camera(own)
        if number == 0:
            rig.add_ref_sensor(own.sensor_id)
        else:
            rig.add_sensor(own.sensor_id, sensor_from_rig[number])
    model.add_rig(rig)


def sim3d(similarity: Similarity) -> pycolmap.Sim3d:
    """COLMAP's form of a similarity."""
    rotation = pycolmap.Rotation3d(transforms.quaternion_xyzw(similarity.rotation))
    return pycolmap.Sim3d(similarity.scale, rotation, np.asarray(similarity.translation, float))


def registered_images(reconstruction: pycolmap.Reconstruction, scene: Scene) -> Iterator[tuple[int, pycolmap.Image]]:
    """Each image with a pose that the scene knows by its name, and its index there."""
    for image_id in reconstruction.reg_image_ids():
        image = reconstruction.image(image_id)
        if image.name in scene.image_index:
            yield scene.image_index[image.name], image


def image_poses(reconstruction: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """cam_from_world (N, 4, 4) of the scene's images, model units; NaN = not registered. Images go by name."""
    poses = np.full((len(scene), 4, 4), np.nan)
    for index, image in registered_images(reconstruction, scene):
        poses[index] = matrix(image.cam_from_world())
    return poses


def model_centres(reconstruction: pycolmap.Reconstruction) -> np.ndarray:
    """(K, 3) projection centres of the images that have a pose."""
    return np.array([i.projection_center() for i in reconstruction.images.values() if i.has_pose]).reshape(-1, 3)


def observations(reconstruction: pycolmap.Reconstruction, scene: Scene) -> np.ndarray:
    """(N,) i8: model points that each image of the scene sees. Of a finished model ask ``registration``."""
    counts = np.zeros(len(scene), int)
    for index, image in registered_images(reconstruction, scene):
        counts[index] = image.num_points3D
    return counts


def tracks(reconstruction: pycolmap.Reconstruction, scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (P, 3), model units, and their observations: image (M,) scene index, point (M,) row."""
    ids = list(reconstruction.points3D)
    xyz = np.array([reconstruction.points3D[k].xyz for k in ids]).reshape(-1, 3)
    row = {k: n for n, k in enumerate(ids)}
    seen: list[tuple[int, int]] = []
    for index, image in registered_images(reconstruction, scene):
        seen += [(index, row[p.point3D_id]) for p in image.get_observation_points2D()]
    both = np.array(seen, int).reshape(-1, 2)
    return xyz, both[:, 0], both[:, 1]


def sensor_id(camera_id: int) -> pycolmap.sensor_t:
    """COLMAP's identity of a camera as a sensor of a rig."""
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)


def model_rigs(reconstruction: pycolmap.Reconstruction, scene: Scene) -> tuple[Rig, ...]:
    """The scene's rigs with the cameras and extrinsics of a model (its units); others stay as given."""
    out = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        numbers = range(first + 1, first + 1 + len(rig.sensors))
        cameras = [reconstruction.cameras[k] if k in reconstruction.cameras else None for k in numbers]
        sensors = [replace(s, camera=c or s.camera) for s, c in zip(rig.sensors, cameras)]
        held = reconstruction.rigs[index + 1] if index + 1 in reconstruction.rigs else None
        ids = [sensor_id(k) for k in numbers]
        if held is not None and held.is_ref_sensor(ids[0]):
            for k in range(1, len(sensors)):
                if held.has_sensor_from_rig(ids[k]):
                    sensors[k] = replace(sensors[k], sensor_from_rig=matrix(held.sensor_from_rig(ids[k])))  # type: ignore[arg-type]
        out.append(replace(rig, sensors=tuple(sensors)))
    return tuple(out)


BY_RIG = "placed by the rig"  # the name of the others in tables
_ASKED = 100  # points of an image that are tested; of more, some that are spread evenly
LEFT_OUT = "left out: "  # begin of the reason for an image that had a wrong position


@dataclass(frozen=True)
class Registration:
    """For each image of a scene (N,): whether it has a pose in the model, how many points it sees with small
    residuals, and the least number of these."""

    placed: np.ndarray  # (N,) bool
    points: np.ndarray  # (N,) i8
    min_points: int

    @property
    def registered(self) -> np.ndarray:
        """(N,) bool: it has a pose confirmed by points."""
        return self.placed & (self.points >= self.min_points)

    @property
    def by_rig(self) -> np.ndarray:
        """(N,) bool: it has a pose, from the other cameras of its rig or from very few points."""
        return self.placed & (self.points < self.min_points)


def registration(model: Any, scene: Scene, tuning: RegisteredTuning) -> Registration:
    """Of the images of a scene in a ``pycolmap.Reconstruction``; images go by name."""
    found = agreeing_points(model, tuning)
    placed = np.array([name in found for name in scene.names], bool)
    return Registration(placed, np.array([found.get(name, 0) for name in scene.names], int), tuning.min_points)


def agreeing_points(model: Any, tuning: RegisteredTuning) -> dict[str, int]:
    """By name of each image with a pose in a ``pycolmap.Reconstruction``: its points with small residuals."""
    return {i.name: _agreeing(model, i, tuning) for i in model.images.values() if i.has_pose}


def _agreeing(model: Any, image: Any, tuning: RegisteredTuning) -> int:
    rows = image.get_observation_point2D_idxs()
    asked = [image.point2D(rows[k]) for k in np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(int)]
    if not asked:
        return 0
    pose = image.cam_from_world().matrix()
    local = np.array([model.points3D[p.point3D_id].xyz for p in asked]) @ pose[:, :3].T + pose[:, 3]
    ahead = local[:, 2] > 0
    place = np.asarray(model.cameras[image.camera_id].img_from_cam(local[ahead]), float)
    off = np.linalg.norm(place - np.array([p.xy for p in asked])[ahead], axis=1)
    return round(float(np.sum(off < tuning.agree_px)) / len(asked) * len(rows))  # NaN counts as disagreement


# COLMAP replaces the sparse factorisation by an iterative solver at 1000 images, rig or not. Factorised are
# the frames, and in surveys each sees few others: a corridor of 2000 images in 500 frames took five times the time of
# one of 1000 (benchmarks/sfm/README.md). Above this number the fill-in of loose collections might not fit into memory.
MOST_FRAMES = 10_000
# Ceres adds up the parts of its threads in the order they come (github.com/ceres-solver/ceres-solver/issues/664): with
# two, no run is like another. One thread gives every run and every machine's number of cores the same sums. (Costs
# written in Python would wait for each other anyway: the thread that solves holds the interpreter's lock.)
THREADS = 1


def options_of(
    iterations: int, tolerance: float | None = None, robust_px: float | None = None, **refine: bool
) -> pycolmap.BundleAdjustmentOptions:
    """Options of an adjustment with reproducible bits: at most ``iterations``, until the cost changes by a relative
    amount less than ``tolerance``, with Cauchy's loss of scale ``robust_px``, if these are given;
    ``refine_...``: parameters adjusted that COLMAP would hold, or the other way round."""
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, **refine)
    if robust_px is not None:
        _change(options, loss_function_type=pycolmap.LossFunctionType.CAUCHY, loss_function_scale=robust_px)
    limits = {} if tolerance is None else {"function_tolerance": tolerance}
    _change(options, {"max_num_iterations": iterations, **limits})
    repeatable(options)
    return options


def _change(options: pycolmap.BundleAdjustmentOptions, solver: Mapping[str, Any] | None = None, **ceres: Any) -> None:
    """Set options of Ceres and of its solver; pycolmap returns copies of them."""
    own = options.ceres
    inner = own.solver_options
    for name, value in (solver or {}).items():
        setattr(inner, name, value)
    own.solver_options = inner
    for name, value in ceres.items():
        setattr(own, name, value)
    options.ceres = own


def all_images(model: pycolmap.Reconstruction) -> pycolmap.BundleAdjustmentConfig:
    """An adjustment of all images that have a pose."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    return config


def factorised(options: pycolmap.BundleAdjustmentOptions, frames: int, images: int) -> None:
    """Make an adjustment of so many frames and images factorise, unless it is too large, and always the same sums."""
    if frames <= MOST_FRAMES:
        most = max(options.ceres.max_num_images_direct_sparse_cpu_solver, images)
        _change(options, max_num_images_direct_sparse_cpu_solver=most)
    repeatable(options)


def repeatable(options: pycolmap.BundleAdjustmentOptions) -> None:
    """Make an adjustment give the same bits each time, and on a machine with a GPU those of one without."""
    _change(options, {"num_threads": THREADS}, use_gpu=False)


def undamped(options: pycolmap.BundleAdjustmentOptions) -> None:
    """Make an adjustment of a model that was adjusted before begin with whole steps: few suffice at any length."""
    # Ceres' own 1e4 damps what single observations hardly tell and all together do: where positions want a long model
    # to lie, and how it bends
    _change(options, {"initial_trust_region_radius": 1e7})
