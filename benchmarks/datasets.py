"""The benchmark data sets: what a user has (images, rig, GNSS, times) and what only the evaluation sees (truth).

The files a user would have to write are made in a work folder, from the data's own calibration and sensors. Truth
(poses, reference cloud) never goes into them, with the one exception that the data set's notes name.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError, choose
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, world_from_geodetic
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import Rig, Sensor

_REPOSITORY = Path(__file__).resolve().parents[1]
_EXAMPLE = _REPOSITORY / "examples" / "canal"


@dataclass(frozen=True)
class Mark:
    """A surveyed point seen in an image: its surveyed place (3,) metres and the pixel where it was clicked.

    ``turned``: the image's EXIF orientation; the pixel is that of the upright image.
    """

    image: str
    surveyed_m: tuple[float, float, float]
    xy_px: tuple[float, float]
    turned: int = 1

    def pixel(self, camera: pycolmap.Camera) -> np.ndarray:
        """(2,) in the image of a camera, which is wider than high unless the image was made upright."""
        x, y = self.xy_px
        if self.turned not in (6, 8) or camera.width < camera.height:
            return np.array([x, y])
        return np.array([y, camera.height - x] if self.turned == 6 else [camera.width - y, x])


@dataclass(frozen=True)
class Dataset:
    """One survey. Paths are None where the user has no such file.

    ``cam_from_world``: image name -> (4, 4), true pose; the rotation is NaN where only positions are known.
    ``truth_origin``: where the truth's world (east, north, up) is on the Earth, None = nowhere.
    ``cameras``: image folder -> calibrated camera, for competitors that are given the same calibration as tiegraph.
    """

    name: str
    images: Path
    cam_from_world: Mapping[str, np.ndarray]
    rig: Path | str | None = None
    gnss: Path | None = None
    trajectory: Path | None = None
    times: Path | None = None
    gcp: Path | None = None
    truth_origin: Origin | None = None
    reference_cloud: Path | None = None
    marks: tuple[Mark, ...] = ()
    cameras: Mapping[str, pycolmap.Camera] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def files(self, *more: str) -> dict[str, Path | str]:
        """What a user gives beside the images, by the name of its option, where there is something; ``more``: gcp."""
        names = ("rig", "gnss", "trajectory", "times", *more)
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def options(self, *more: str) -> list[str]:
        """The same as words of a command line."""
        return [word for name, value in self.files(*more).items() for word in (f"--{name}", str(value))]

    def run(self, folder: Path, until: str) -> None:
        """Run tiegraph with all of this to a stage, into a run folder."""
        command = [sys.executable, "-m", "tiegraph.cli.main", "run", str(self.images), "-o", str(folder)]
        subprocess.run([*command, *self.options(), "--until", until], check=True, stdout=subprocess.DEVNULL)

    def centres_m(self) -> dict[str, np.ndarray]:
        """True projection centres (3,) by image name."""
        return {name: pose_centre(pose) for name, pose in self.cam_from_world.items()}


def pose_centre(cam_from_world: np.ndarray) -> np.ndarray:
    """Projection centre (3,); a pose without rotation holds minus the centre as its translation."""
    if np.isnan(cam_from_world[:3, :3]).any():
        return -cam_from_world[:3, 3]
    return transforms.centre(cam_from_world)


def _position_only(centre_m: np.ndarray) -> np.ndarray:
    return transforms.rigid(np.full((3, 3), np.nan), -np.asarray(centre_m, float))


def data_root() -> Path:
    """Folder of the data sets: TIEGRAPH_DATA, else ``../shared/data`` beside the repository."""
    return Path(os.environ.get("TIEGRAPH_DATA", _REPOSITORY.parent / "shared" / "data")).resolve()


def load(name: str, work: Path) -> Dataset:
    """The data set ``name``; the user's files are written to ``work``/``name``. ``canal@FOLDER`` is a canal as
    `canal_generator` of the data sets renders it.

    Raises SettingsError for an unknown name and InputError if its folder is not there.
    """
    if name.startswith("canal@"):
        made = work / "canal"
        made.mkdir(parents=True, exist_ok=True)
        return _canal(Path(name.partition("@")[2]).resolve(), made)
    loader: Callable[[Path, Path], Dataset] = choose("data set", name, LOADERS)  # type: ignore[assignment]
    folder = data_root() / _FOLDERS[name]
    if name == "canal_demo" and not folder.is_dir():
        folder, loader = _EXAMPLE, _example
    if not folder.is_dir():
        raise InputError(f"data set {name!r}: no folder {folder}; set TIEGRAPH_DATA to the folder of the data sets")
    made = work / name
    made.mkdir(parents=True, exist_ok=True)
    return loader(folder, made)


# -------------------------------------------------------------------------------------------------- canal (rendered)


def _canal(folder: Path, work: Path) -> Dataset:
    nominal = json.loads((folder / "sensors" / "rig_nominal.json").read_text())
    cam_from_body = {
        name: transforms.from_quaternion_wxyz(pose["cam_from_body_qwxyz"], pose["cam_from_body_t"])
        for name, pose in nominal.items()
    }
    reference = transforms.invert(cam_from_body["cam0"])
    sensors = tuple(
        Sensor(name, None, pose @ reference, role="up" if name == "cam5" else "side", folder=name)
        for name, pose in sorted(cam_from_body.items())
    )
    meta = json.loads((folder / "gt" / "meta.json").read_text())["origin"]
    return Dataset(
        name=folder.name,
        images=folder / "images",
        cam_from_world=_poses_of_colmap_text(folder / "gt" / "colmap" / "images.txt"),
        rig=write_rig(Rig("ring", sensors, nominal=True), work),
        gnss=folder / "sensors" / "gnss.csv",
        times=_canal_times(folder, work),
        truth_origin=Origin(meta["lat"], meta["lon"], meta["height"]),
        reference_cloud=folder / "gt" / "lidar.laz",
        notes=(
            "rendered; nominal rig, no intrinsics, GNSS with outages, lever arm unknown (1.1 m)",
            "times from the stamps of the visual odometry, one a frame; its poses are not used",
        ),
    )


def _example(folder: Path, work: Path) -> Dataset:
    """``canal_demo`` as tiegraph ships it: the same images, sensors and truth, without odometry and the whole LiDAR."""
    (spec,) = read_rig_file(folder / "rig.toml", RigTuning())
    poses = {s.name: s.body_from_sensor for s in spec.sensors}
    sensors = tuple(
        Sensor(s.name, None, transforms.invert(poses[s.name]) @ poses["cam0"], role=s.role, folder=s.name)
        for s in spec.sensors
    )
    meta = json.loads((folder / "truth" / "meta.json").read_text())["origin"]
    return Dataset(
        name="canal_demo",
        images=folder / "images",
        cam_from_world=_poses_of_colmap_text(folder / "truth" / "colmap" / "images.txt"),
        rig=write_rig(Rig("ring", sensors, nominal=True), work),
        gnss=folder / "gnss_float.csv",
        times=folder / "times.csv",
        truth_origin=Origin(meta["lat"], meta["lon"], meta["height"]),
        reference_cloud=folder / "truth" / "reference.laz",
        notes=("rendered; nominal rig, no intrinsics, GNSS with outages, lever arm unknown (1.1 m)",),
    )


def _canal_times(folder: Path, work: Path) -> Path:
    """One row an image frame: the stamps of ``sensors/vo_<pass>.tum`` in the order of the frames."""
    rows: list[tuple[str, float]] = []
    for track in sorted(p.name for p in (folder / "images").iterdir()):
        stamps = np.loadtxt(folder / "sensors" / f"vo_{track}.tum", usecols=0)
        frames = sorted(p.name for p in (folder / "images" / track / "cam0").iterdir())
        if len(stamps) != len(frames):
            raise InputError(f"{folder}: pass {track} has {len(frames)} frames and {len(stamps)} stamps")
        rows += [(f"{track}/cam0/{frame}", stamp) for frame, stamp in zip(frames, stamps, strict=True)]
    return _write_times(rows, work)


def _poses_of_colmap_text(path: Path) -> dict[str, np.ndarray]:
    poses = {}
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 10 and not line.startswith("#"):
            numbers = np.array(words[1:8], float)
            poses[words[9]] = transforms.from_quaternion_wxyz(numbers[:4], numbers[4:])
    return poses


# ------------------------------------------------------------------------------------------------------- PandaSet

_PANDASET_SENSORS = (
    "front_camera", "front_left_camera", "left_camera", "back_camera", "right_camera", "front_right_camera",
)  # fmt: skip
_PANDASET_GNSS_SIGMA_M = 0.5  # none is given; that of a car receiver with inertial aid in a street


def _pandaset(folder: Path, work: Path) -> Dataset:
    world_from_cam, stamps, cameras, truth = {}, {}, {}, {}
    for name in _PANDASET_SENSORS:
        place = folder / "camera" / name
        world_from_cam[name] = _pandaset_poses(place / "poses.json")
        stamps[name] = np.array(json.loads((place / "timestamps.json").read_text()))
        k = json.loads((place / "intrinsics.json").read_text())
        cameras[name] = _pinhole(k["width"], k["height"], [k["fx"], k["fy"], k["cx"], k["cy"]])
        for image in sorted(place.glob("*.jpg")):
            truth[f"{name}/{image.name}"] = transforms.invert(world_from_cam[name][int(image.stem)])
    front = stamps["front_camera"]
    instant = front[1:2]  # the car hardly moves yet, so that interpolation between the stamps costs nothing
    at = {n: transforms.interpolate(stamps[n], world_from_cam[n], instant)[0] for n in _PANDASET_SENSORS}
    sensors = tuple(
        Sensor(n, cameras[n], transforms.invert(at[n]) @ at["front_camera"], folder=n) for n in _PANDASET_SENSORS
    )
    frames = sorted(p.name for p in (folder / "camera" / "front_camera").glob("*.jpg"))
    return Dataset(
        name="pandaset",
        images=folder / "camera",
        cam_from_world=truth,
        rig=write_rig(Rig("car", sensors), work),
        gnss=_pandaset_gnss(folder, work),
        times=_write_times([(f"front_camera/{f}", front[int(Path(f).stem)]) for f in frames], work),
        reference_cloud=folder / "lidar" / "static_reference_8cm.npz",
        cameras=cameras,
        notes=(
            "rig extrinsics are those of the vehicle at one instant, from the camera poses there",
            "cameras fire -50 .. +31 ms from the front camera: the effective rig wanders by 2-11 cm along the track",
            "lens distortion neither corrected nor given",
            "true poses come from the same GNSS/INS as the GNSS track (they agree within 4 cm)",
        ),
    )


def _pandaset_poses(path: Path) -> np.ndarray:
    data = json.loads(path.read_text())
    q_wxyz = np.array([[pose["heading"][axis] for axis in "wxyz"] for pose in data])
    return transforms.from_quaternion_wxyz(q_wxyz, [[pose["position"][axis] for axis in "xyz"] for pose in data])


def _pandaset_gnss(folder: Path, work: Path) -> Path:
    fixes = json.loads((folder / "meta" / "gps.json").read_text())
    stamps = json.loads((folder / "meta" / "timestamps.json").read_text())
    sigma = f"{_PANDASET_GNSS_SIGMA_M:.3f}"
    path = work / "gnss.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", "lat", "lon", "height", "sigma_h", "sigma_v"])
        for stamp, fix in zip(stamps, fixes, strict=True):
            place = [f"{fix['lat']:.10f}", f"{fix['long']:.10f}", f"{fix['height']:.4f}"]
            writer.writerow([f"{stamp:.6f}", *place, sigma, sigma])
    return path


# ---------------------------------------------------------------------------------------------------------- KITTI


def _kitti(folder: Path, work: Path) -> Dataset:
    projections = np.loadtxt(folder / "calib.txt").reshape(-1, 3, 4)
    world_from_left = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    width, height = _image_size(folder / "image_l" / "000000.jpg")
    cameras, sensors, truth = {}, [], {}
    for name, p in zip(("image_l", "image_r"), projections, strict=True):
        cameras[name] = _pinhole(width, height, [p[0, 0], p[1, 1], p[0, 2], p[1, 2]])
        # P = K [I | t] with t the translation of cam_from_left (rectified: no rotation).
        cam_from_left = transforms.rigid(np.eye(3), np.linalg.solve(p[:, :3], p[:, 3]))
        sensors.append(Sensor(name, cameras[name], cam_from_left, folder=name))
        for image in sorted((folder / name).glob("*.jpg")):
            pose = world_from_left[int(image.stem)]
            truth[f"{name}/{image.name}"] = cam_from_left @ transforms.invert(
                transforms.rigid(_nearest_rotation(pose[:, :3]), pose[:, 3])
            )
    return Dataset(
        name="kitti_stereo",
        images=folder,
        cam_from_world=truth,
        rig=write_rig(Rig("stereo", tuple(sensors), fixed=True), work),
        cameras=cameras,
        notes=("rectified grey stereo pair; scale only from the 0.54 m baseline",),
    )


def _nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix that was printed with few digits."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ vt


# -------------------------------------------------------------------------------------------------------- Strecha


def _strecha(folder: Path, work: Path) -> Dataset:
    truth, cameras = {}, {}
    for image in sorted((folder / "images").glob("*.jpg")):
        rows = (folder / "gt_dense_cameras" / f"{image.name}.camera").read_text().splitlines()
        numbers = [np.array(row.split(), float) for row in rows if row.strip()]
        k, rotation, centre, size = np.stack(numbers[:3]), np.stack(numbers[4:7]), numbers[7], numbers[8]
        # The file's rotation is world_from_cam and the calibration is that of the full-size photograph.
        cam_from_world = transforms.invert(transforms.rigid(_nearest_rotation(rotation), centre))
        truth[image.name] = cam_from_world
        width, height = _image_size(image)
        half = width / size[0]
        cameras[""] = _pinhole(width, height, [k[0, 0] * half, k[1, 1] * half, k[0, 2] * half, k[1, 2] * half])
    rig = Rig("photographs", (Sensor("camera", cameras[""]),))
    return Dataset(
        name=folder.name,
        images=folder / "images",
        cam_from_world=truth,
        rig=write_rig(rig, work),
        cameras=cameras,
        notes=("calibration of the 3072x2048 photographs, halved", "no scale and no position is known to the method"),
    )


# ------------------------------------------------------------------------------------------------------- Oppaiyama


def _oppaiyama(folder: Path, work: Path) -> Dataset:
    images = sorted((folder / "images").glob("*.jpg"))
    truth, origin = exif_truth({image.name: image for image in images})
    return Dataset(
        name="oppaiyama",
        images=folder / "images",
        cam_from_world=truth,
        truth_origin=origin,
        marks=_marks(folder / "gcp_list.txt", {image.name for image in images}),
        notes=(
            "loose telephone photographs; GPS is read from their EXIF by the method itself",
            "truth is that same EXIF GPS (metres off, repeated over many photographs): a check for blunders only",
            "four surveyed points 2 m apart, rounded to 0.1 m, at one height: the marks test the rays, not the place",
        ),
    )


def _marks(path: Path, images: set[str]) -> tuple[Mark, ...]:
    rows = [line.split() for line in path.read_text().splitlines()[1:] if line.strip()]
    marks = []
    for east, north, height, x, y, image in rows:
        if image in images:
            marks.append(Mark(image, (float(east), float(north), float(height)), (float(x), float(y))))
    return tuple(marks)


def exif_truth(images: Mapping[str, Path]) -> tuple[dict[str, np.ndarray], Origin]:
    """The positions in the EXIF data of images as poses without rotations, and where their world is."""
    fixes = {name: fix for name, path in images.items() if (fix := _exif_position(path)) is not None}
    lat, lon, height = np.mean(list(fixes.values()), axis=0)
    origin = Origin(float(lat), float(lon), float(height))
    enu_m = world_from_geodetic(np.array(list(fixes.values())), origin)
    return {name: _position_only(p) for name, p in zip(fixes, enu_m, strict=True)}, origin


def _exif_position(path: Path) -> tuple[float, float, float] | None:
    from PIL import Image

    with Image.open(path) as image:
        gps = image.getexif().get_ifd(0x8825)
    if 2 not in gps or 4 not in gps:
        return None
    angles = [float(d) + float(m) / 60 + float(s) / 3600 for d, m, s in (gps[2], gps[4])]
    signs = [-1 if gps.get(1) == "S" else 1, -1 if gps.get(3) == "W" else 1]
    return angles[0] * signs[0], angles[1] * signs[1], float(gps.get(6, 0.0))


# ------------------------------------------------------------------------------------------------------- shared


def _pinhole(width: int, height: int, params: list[float]) -> pycolmap.Camera:
    camera = pycolmap.Camera(model="PINHOLE", width=int(width), height=int(height), params=params)
    camera.has_prior_focal_length = True
    return camera


def _image_size(path: Path) -> tuple[int, int]:
    from PIL import Image

    with Image.open(path) as image:
        return image.size


def _write_times(rows: list[tuple[str, float]], work: Path) -> Path:
    path = work / "times.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["image", "time"])
        writer.writerows((name, f"{stamp:.6f}") for name, stamp in rows)
    return path


def write_rig(rig: Rig, work: Path) -> Path:
    """The rig as ``rig.toml`` below ``work``."""
    from tiegraph.scan.rigfiles.rigspec import write_rig_toml

    path = work / "rig.toml"
    write_rig_toml(rig, path)
    return path


# --------------------------------------------------------------------------- parts of close-range sets, known poses


_DINO_VIEWS = 40  # neighbours on the hemisphere
_KITCHEN_FRAMES = 60  # the first


def _dino(folder: Path, work: Path) -> Dataset:
    truth = {}
    for line in (folder / "dino_par.txt").read_text().splitlines():
        name, *numbers = line.split()
        if len(numbers) == 21:
            v = np.array(numbers, float)
            truth[Path(name).stem + ".jpg"] = transforms.rigid(v[9:18].reshape(3, 3), v[18:])
    centres = {n: pose_centre(p) for n, p in truth.items()}
    middle = centres[sorted(centres)[len(centres) // 2]]
    near = sorted(centres, key=lambda n: float(np.linalg.norm(centres[n] - middle)))[:_DINO_VIEWS]
    truth = {n: truth[n] for n in sorted(near)}
    return Dataset(
        name="dino_part", images=linked({n: folder / n for n in truth}, work), cam_from_world=truth,
        notes=("40 neighbouring views; no calibration given",),
    )  # fmt: skip


def _kitchen(folder: Path, work: Path) -> Dataset:
    truth, files = {}, {}
    for image in sorted(folder.glob("frame-*.color.jpg"))[:_KITCHEN_FRAMES]:
        name = image.name.replace(".color", "")
        truth[name] = transforms.invert(np.loadtxt(folder / image.name.replace(".color.jpg", ".pose.txt")))
        files[name] = image
    return Dataset(
        name="rgbd_part", images=linked(files, work), cam_from_world=truth,
        notes=("first 60 frames; no calibration given; poses of KinectFusion: good to centimetres",),
    )  # fmt: skip


def _ring(folder: Path, work: Path) -> Dataset:
    truth, files = {}, {}
    for path in sorted(folder.glob("extrinsics_camera*.txt")):
        number = path.stem.removeprefix("extrinsics_camera")
        pose = np.loadtxt(path).reshape(3, 4)
        truth[f"camera{number}.jpg"] = transforms.invert(transforms.rigid(pose[:, :3], pose[:, 3]))
        files[f"camera{number}.jpg"] = folder / f"image_camera{number}.jpg"
    return Dataset(
        name="ring", images=linked(files, work), cam_from_world=truth,
        notes=("one capture of twelve cameras as loose photographs; no calibration given",),
    )  # fmt: skip


def linked(files: Mapping[str, Path], folder: Path) -> Path:
    """The folder ``images`` below ``folder`` with links to files under these names."""
    for name, source in files.items():
        place = folder / "images" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.unlink(missing_ok=True)
        place.symlink_to(source)
    return folder / "images"


LOADERS: dict[str, Callable[[Path, Path], Dataset]] = {
    "canal_demo": _canal,
    "canal": _canal,
    "canal_480": _canal,
    "canal_1200": _canal,
    "pandaset": _pandaset,
    "kitti_stereo": _kitti,
    "fountain-P11": _strecha,
    "Herz-Jesus-P8": _strecha,
    "Herz-Jesus-P25": _strecha,
    "oppaiyama": _oppaiyama,
    "dino_part": _dino,
    "rgbd_part": _kitchen,
    "ring": _ring,
}
_FOLDERS = {
    "canal_demo": "canal_demo",
    "canal": "canal",
    "canal_480": "canal_480",  # these two are rendered (README.md)
    "canal_1200": "canal_1200",
    "pandaset": "pandaset",
    "kitti_stereo": "kitti_stereo/KITTI_sequence_1",
    "fountain-P11": "strecha/fountain-P11",
    "Herz-Jesus-P8": "strecha/Herz-Jesus-P8",
    "Herz-Jesus-P25": "strecha/Herz-Jesus-P25",
    "oppaiyama": "oppaiyama",
    "dino_part": "dino",
    "rgbd_part": "rgbd_250",
    "ring": "robovision_rig12/2016_10_24__17_43_02",  # the first capture
}
