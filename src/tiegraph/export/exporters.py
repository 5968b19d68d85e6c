"""The formats by name, how each is written but for maps, and which images can stay as they are because its cameras can
say their lens.

OpenSfM's ``reconstruction.json`` is in east, north, up about ``reference_lla.json``. Its lengths count in the longer
side of an image, its pixels from the middle of the image; a shot's rotation (an angle-axis vector) and translation are
those of camera_from_world.
"""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.export import maps
from tiegraph.export.opf import opf
from tiegraph.export.survey import Exporter, Survey, unique_names, write_json, write_offset
from tiegraph.geometry.geodesy import ENU, Origin, geodetic_from_world, world_from_geodetic
from tiegraph.geometry.transforms import Similarity, invert, umeyama
from tiegraph.scene.colmapmodel import matrix, model_centres, sim3d
from tiegraph.scene.composed import same_lens
from tiegraph.scene.namedposes import TRANSFORMS
from tiegraph.scene.posefile import FREE_UNIT, write_tum
from tiegraph.scene.results import DepthMap, row_strips

Cameras = dict[int, pycolmap.Camera]
FISHEYE = "OPENCV_FISHEYE"
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
_RADIAL = {"SIMPLE_RADIAL": 1, "RADIAL": 2}  # radial terms, behind one focal length
_OFF_PX = 0.05  # a principal point this far from the middle, or an edge by unequal focal lengths, shows in no image


def opencv(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Cameras that OPENCV or OPENCV_FISHEYE can say, all in one of the two: a file of nerfstudio has one model. Where
    both occur the fisheye lenses are left out."""
    found = opencv_each(cameras)
    kinds = {camera.model_name for camera in found.values()}
    return {k: c for k, c in found.items() if len(kinds) == 1 and len(found) == len(cameras) or c.model_name != FISHEYE}


def brown(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Cameras with square pixels that OPENCV can say."""
    found = opencv_each(cameras)
    return {key: own for key, own in found.items() if own.model_name == "OPENCV" and _uneven(own) < _OFF_PX}


def opencv_each(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Cameras that OPENCV or OPENCV_FISHEYE can say, each by itself."""
    return {key: own for key, camera in cameras.items() if (own := _opencv(camera)) is not None}


def _opencv(camera: pycolmap.Camera) -> pycolmap.Camera | None:
    name, params = camera.model_name, [float(p) for p in camera.params]
    if name in ("OPENCV", FISHEYE):
        return camera
    if name in _PINHOLES or name in _RADIAL:
        radial = params[-_RADIAL[name] :] if name in _RADIAL else []
        return same_lens(camera, "OPENCV", [*_without_distortion(camera), *radial, *[0.0] * (4 - len(radial))])
    return None


def _without_distortion(camera: pycolmap.Camera) -> list[float]:
    return [camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y]


def pinholes(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Cameras without distortion, as PINHOLE."""
    flat = {key: camera for key, camera in cameras.items() if camera.model_name in _PINHOLES}
    return {key: same_lens(camera, "PINHOLE", _without_distortion(camera)) for key, camera in flat.items()}


def centred(cameras: Mapping[int, pycolmap.Camera]) -> Cameras:
    """Those of them with square pixels and the principal point in the middle."""

    def off(camera: pycolmap.Camera) -> float:
        aside, below = camera.principal_point_x - camera.width / 2, camera.principal_point_y - camera.height / 2
        return max(abs(aside), abs(below), _uneven(camera))

    return {key: camera for key, camera in pinholes(cameras).items() if off(camera) < _OFF_PX}


def _uneven(camera: pycolmap.Camera) -> float:
    """How far off (pixels) an edge is if its pixels are taken for square."""
    return float(abs(camera.focal_length_x / camera.focal_length_y - 1) * camera.height / 2)


_POINTS = "sparse_pc.ply"
_OPENCV = ("k1", "k2", "p1", "p2")
_TERMS = {FISHEYE: ("k1", "k2", "k3", "k4"), "OPENCV": _OPENCV}  # behind the focal lengths and the principal point
_LARGEST = 65535  # of a depth map of 16 bits
_STEP_M = 100.0  # between places that tell how the axes of the CRS lie: the Earth is flat to a millimetre there
_LOOSE = "photographs"  # that belong to no pass


def colmap(survey: Survey, target: Path, folder: str, forms: tuple[str, ...]) -> int:
    """COLMAP's model in a folder of ``target``, in the forms binary and text; the number of images."""
    (target / folder).mkdir(parents=True)
    for form in forms:
        getattr(survey.model, f"write_{form}")(str(target / folder))
    write_offset(survey, target)
    return len(survey.images())


def bundler(survey: Survey, target: Path) -> int:
    """``bundle.out`` (v0.3) and ``list.txt``; the number of images. Its cameras look along -z with y up, pixels count
    from the middle of the image."""
    images, model = survey.images(), survey.model
    number = {image.image_id: k for k, image in enumerate(images)}
    lines = ["# Bundle file v0.3", f"{len(images)} {len(model.points3D)}"]
    for image in images:
        pose = matrix(image.cam_from_world())[:3] * [[1], [-1], [-1]]
        lines.append(f"{model.camera(image.camera_id).mean_focal_length()!r} 0 0")
        lines += [" ".join(repr(float(v)) for v in row) for row in (*pose[:, :3], pose[:, 3])]
    for _, point in sorted(model.points3D.items()):
        views = []
        for element in point.track.elements:
            image = model.image(element.image_id)
            camera, (x, y) = model.camera(image.camera_id), image.points2D[element.point2D_idx].xy
            place = f"{x - camera.width / 2:.4f} {camera.height / 2 - y:.4f}"
            views.append(f"{number[element.image_id]} {element.point2D_idx} {place}")
        lines += [" ".join(repr(float(v)) for v in point.xyz), " ".join(map(str, point.color))]
        lines.append(" ".join([str(len(views)), *views]))
    (target / "bundle.out").write_text("\n".join([*lines, ""]), encoding="ascii")
    (target / "list.txt").write_text("".join(f"images/{image.name}\n" for image in images), encoding="utf-8")
    write_offset(survey, target)
    return len(images)


def nerfstudio(survey: Survey, target: Path) -> int:
    """Write ``transforms.json`` and the points; the number of frames."""
    frames = []
    for image in survey.images():
        camera = survey.model.camera(image.camera_id)
        values = [float(v) for v in camera.params]
        pose = invert(matrix(image.cam_from_world()))
        pose[:3, 1:3] *= -1  # to OpenGL's camera
        frame: dict[str, Any] = {"file_path": f"images/{image.name}", "w": camera.width, "h": camera.height}
        frame |= dict(zip(("fl_x", "fl_y", "cx", "cy", *_TERMS.get(camera.model_name, _OPENCV)), values))
        frame |= {"transform_matrix": pose.tolist(), "colmap_im_id": image.image_id}
        for key, files in (("mask_path", survey.masks), ("depth_file_path", survey.depths)):
            if image.name in files:
                frame[key] = files[image.name]
        frames.append(frame)
    kinds = {c.model_name for c in survey.model.cameras.values()}
    data = {
        "camera_model": FISHEYE if FISHEYE in kinds else "OPENCV",
        "applied_transform": np.eye(4)[:3].tolist(),  # to the world of the survey: none
        "ply_file_path": _POINTS,
        "frames": frames,
    }
    survey.model.export_PLY(str(target / _POINTS))
    write_json(target / TRANSFORMS, data)
    write_offset(survey, target)
    return len(frames)


def depth_through(camera: pycolmap.Camera, depth: DepthMap | None) -> np.ndarray:
    """Depth (H, W) f4 along the optical axis as an image of the camera sees it, world units, 0 = none: nerfstudio wants
    one for every frame, of the size of its image."""
    out = np.zeros((camera.height, camera.width), np.float32)
    if depth is None:
        return out
    height, width = depth.depth_m.shape
    known = np.nan_to_num(depth.depth_m, nan=0.0)
    for rows in row_strips(out.shape):
        u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(rows.start, rows.stop) + 0.5)
        rays = np.asarray(camera.cam_ray_from_img(np.stack([u, v], axis=-1).reshape(-1, 2)))
        with np.errstate(all="ignore"):  # no ray, or one behind
            at = (rays / rays[:, 2:]) @ depth.K.T
            x, y = np.floor(at[:, 0]), np.floor(at[:, 1])
        there = (rays[:, 2] > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        values = np.zeros(len(rays), np.float32)
        values[there] = known[y[there].astype(int), x[there].astype(int)]
        out[rows] = values.reshape(u.shape)
    return out


def in_thousandths(depth: np.ndarray, unit: str) -> np.ndarray:
    """Depth (H, W) in thousandths, as nerfstudio's unit of depth is: millimetres as u2 where these hold it, else f4."""
    scaled = 1000 * depth
    if unit != "m" or scaled.max(initial=0) > _LARGEST:
        return scaled.astype(np.float32)
    return np.rint(scaled).astype(np.uint16)


def opensfm(survey: Survey, target: Path) -> int:
    """Write the reconstruction and its place on the Earth, if the world is there; the number of shots."""
    local_from_world, model = Similarity(), pycolmap.Reconstruction(survey.model)
    data: dict[str, Any] = {}
    if survey.origin is not None:
        local_from_world, place = _level(model_centres(model).mean(axis=0), survey.origin)
        model.transform(sim3d(local_from_world))
        data["reference_lla"] = {"latitude": place.lat_deg, "longitude": place.lon_deg, "altitude": place.height_m}
        write_json(target / "reference_lla.json", data["reference_lla"])
    data["cameras"] = {f"camera {key}": _camera(camera) for key, camera in sorted(model.cameras.items())}
    data["shots"] = {i.name: _shot(survey, model.image(i.image_id)) for i in survey.images()}
    points = sorted(model.points3D.items())
    data["points"] = {str(k): {"coordinates": p.xyz.tolist(), "color": p.color.tolist()} for k, p in points}
    write_json(target / "reconstruction.json", [data])
    write_json(target / "camera_models.json", data["cameras"])
    (target / "tracks.csv").write_text("\n".join(_tracks(survey, model)) + "\n", encoding="utf-8")
    write_offset(survey, target, local_from_world.inverse())
    return len(data["shots"])


def _tracks(survey: Survey, model: pycolmap.Reconstruction) -> Iterator[str]:
    """Lines of ``tracks.csv``, from which its dense matcher takes the range of depths: image, point, key point, x, y,
    size (not known here), colour, classes (none)."""
    yield "OPENSFM_TRACKS_VERSION_v2"
    for image in survey.images():
        camera = model.camera(image.camera_id)
        longer, middle = max(camera.width, camera.height), np.array([camera.width, camera.height]) / 2
        for number, point in enumerate(image.points2D):
            if point.has_point3D():
                x, y = (point.xy - middle) / longer
                colour = model.points3D[point.point3D_id].color
                yield "\t".join(map(str, (image.name, point.point3D_id, number, x, y, 1 / longer, *colour, -1, -1)))


def _level(middle: np.ndarray, origin: Origin) -> tuple[Similarity, Origin]:
    """From the world to east, north, up about a place of it (3,), by a rigid motion; and that place.

    The axes of a CRS are turned against these by the convergence of its meridians."""
    lat, lon, height = geodetic_from_world(middle[None], origin)[0]
    place = Origin(lat_deg=float(lat), lon_deg=float(lon), height_m=float(height), crs=ENU)
    around = middle + _STEP_M * np.concatenate([np.eye(3), -np.eye(3)])
    return umeyama(around, world_from_geodetic(geodetic_from_world(around, origin), place), with_scale=False), place


def _camera(camera: pycolmap.Camera) -> dict[str, Any]:
    fx, fy, cx, cy, *rest = (float(v) for v in camera.params)
    longer = max(camera.width, camera.height)
    return {
        "projection_type": "fisheye_opencv" if camera.model_name == FISHEYE else "brown",
        "width": camera.width,
        "height": camera.height,
        "focal_x": fx / longer,
        "focal_y": fy / longer,
        "c_x": (cx - camera.width / 2) / longer,
        "c_y": (cy - camera.height / 2) / longer,
        **dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), 0.0),
        **dict(zip(_TERMS.get(camera.model_name, ()), rest)),
    }


def _shot(survey: Survey, image: pycolmap.Image) -> dict[str, Any]:
    pose, time_s = matrix(image.cam_from_world()), survey.scene.time_s[survey.scene.frame[survey.index(image)]]
    shot: dict[str, Any] = {
        "rotation": Rotation.from_matrix(pose[:3, :3]).as_rotvec().tolist(),
        "translation": pose[:3, 3].tolist(),
        "camera": f"camera {image.camera_id}",
        "orientation": 1,
    }
    return shot if np.isnan(time_s) else {**shot, "capture_time": float(time_s)}


def metashape(survey: Survey, target: Path) -> int:
    """``cameras.xml`` of one chunk in the coordinates of the folder, and the points; the number of cameras. Pixels
    count from the middle of the image; p1 and p2 are exchanged against OpenCV."""
    root = xml.Element("document", version="1.5.0")
    chunk = xml.SubElement(root, "chunk", label="tiegraph", enabled="true")
    sensors, cameras = xml.SubElement(chunk, "sensors"), xml.SubElement(chunk, "cameras")
    images = survey.images()
    for key in sorted({image.camera_id for image in images}):
        camera = survey.model.camera(key)
        fx, fy, cx, cy, *rest = (float(v) for v in camera.params)
        kind, terms = (
            ("fisheye", _TERMS[FISHEYE]) if camera.model_name == FISHEYE else ("frame", ("k1", "k2", "p2", "p1"))
        )
        size = {"width": str(camera.width), "height": str(camera.height)}
        sensor = xml.SubElement(sensors, "sensor", id=str(key), label=f"camera {key}", type=kind)
        xml.SubElement(sensor, "resolution", size)
        adjusted = xml.SubElement(sensor, "calibration", {"type": kind, "class": "adjusted"})
        xml.SubElement(adjusted, "resolution", size)
        values = {"f": fy, "b1": fx - fy, "cx": cx - camera.width / 2, "cy": cy - camera.height / 2}
        for name, value in {**values, **dict(zip(terms, rest))}.items():
            xml.SubElement(adjusted, name).text = repr(value)
    for number, image in enumerate(images):
        said = {"id": str(number), "sensor_id": str(image.camera_id), "label": image.name.rpartition(".")[0]}
        pose = invert(matrix(image.cam_from_world()))
        xml.SubElement(xml.SubElement(cameras, "camera", said), "transform").text = " ".join(
            map(repr, pose.ravel().tolist())
        )
    xml.indent(root)
    xml.ElementTree(root).write(target / "cameras.xml", encoding="utf-8", xml_declaration=True)
    survey.model.export_PLY(str(target / _POINTS))
    write_offset(survey, target)
    return len(images)


def tum(survey: Survey, target: Path) -> int:
    """``<pass>.tum``; the number of poses."""
    said = [] if survey.unit == "m" else [FREE_UNIT]
    paths = list(_paths(survey))
    for name, time_s, poses in paths:
        write_tum(target / f"{name}.tum", time_s, poses, said)
    write_offset(survey, target)
    return sum(len(poses) for _, _, poses in paths)


def kitti(survey: Survey, target: Path) -> int:
    """``<pass>/poses.txt``, twelve numbers a pose, and ``<pass>/times.txt``; the number of poses."""
    paths = list(_paths(survey))
    for name, time_s, poses in paths:
        (target / name).mkdir()
        np.savetxt(target / name / "poses.txt", poses[:, :3].reshape(-1, 12), "%.12g")
        np.savetxt(target / name / "times.txt", time_s, "%.6f")
    write_offset(survey, target)
    return sum(len(poses) for _, _, poses in paths)


def _paths(survey: Survey) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Names, time_s (T,), world_from_body (T, 4, 4) of the passes that have poses. Where the time of a frame is
    unknown, all of a pass count from 0.

    Raises InputError for a camera that no pose is of.
    """
    scene, pose = survey.scene, np.full((survey.scene.frames, 4, 4), np.nan)
    cameras = {scene.sensor_of(survey.index(image)).name for image in survey.images()}
    if survey.camera and survey.camera not in cameras:
        raise InputError(f"--camera {survey.camera}: no pose is of it; there are {', '.join(sorted(cameras))}")
    for image in survey.images():
        index = survey.index(image)
        if not survey.camera:
            rig_from_world = survey.model.frame(image.frame_id).rig_from_world
            assert rig_from_world is not None  # it has a pose
            pose[scene.frame[index]] = invert(matrix(rig_from_world))
        elif scene.sensor_of(index).name == survey.camera:
            pose[scene.frame[index]] = invert(matrix(image.cam_from_world()))
    names = unique_names([*scene.sequences, _LOOSE], {})
    for number, name in [*enumerate(scene.sequences), (-1, _LOOSE)]:
        frames = scene.in_order((scene.sequence == number) & np.isfinite(pose[:, 0, 0]))
        if len(frames):
            times = scene.time_s[frames]
            times = times if np.isfinite(times).all() else np.arange(len(frames), dtype=float)
            yield names[name], times, pose[frames]


_SPARSE = partial(colmap, folder="sparse/0", forms=("binary", "text"))
EXPORTERS = {
    "nerfstudio": Exporter(
        nerfstudio, "ns-train splatfacto --data {folder} nerfstudio-data --load-3D-points True", opencv, depth=True
    ),
    "colmap": Exporter(
        _SPARSE,
        "colmap gui --import_path {folder}/sparse/0 --image_path {folder}/images",
        pinholes,
        flat=False,
    ),
    "gsplat": Exporter(_SPARSE, "python simple_trainer.py default --data_dir {folder} --data_factor 1", centred),
    "openmvs": Exporter(
        partial(colmap, folder="sparse", forms=("text",)),  # which InterfaceCOLMAP reads
        "InterfaceCOLMAP -w {folder} -i {folder} -o scene.mvs",
        pinholes,
        mask="masks/{stem}.mask.png",
    ),
    "bundler": Exporter(bundler, "meshlab: Import Bundler, {folder}/bundle.out", centred),
    "opensfm": Exporter(opensfm, "opensfm undistort {folder}", opencv),
    "opf": Exporter(opf, "PIX4Dmatic or rerun_open_photogrammetry_format: {folder}/project.opf", brown),
    "metashape": Exporter(
        metashape, "Metashape: add {folder}/images, then Import Cameras, {folder}/cameras.xml", opencv_each
    ),
    "tum": Exporter(tum, "evo_traj tum {folder}/*.tum"),
    "kitti": Exporter(kitti, "evo_traj kitti {folder}/*/poses.txt"),
    "geojson": Exporter(maps.geojson, "QGIS: drag {folder}/*.geojson into the map"),
    "gpkg": Exporter(maps.gpkg, "QGIS: drag {folder}/survey.gpkg into the map"),
}
