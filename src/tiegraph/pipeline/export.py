"""Glue of `tiegraph export --to NAME`: the survey, loaded once, with images, masks and depth in another format;
and the cloud."""

import io
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath

import cv2
import laspy
import numpy as np
import pycolmap

from tiegraph.dense.plan import CameraModel, ViewPlan
from tiegraph.dense.undistort import centred_pinhole, view_through, write_workspace
from tiegraph.errors import InputError, TiegraphError, choose
from tiegraph.export.exporters import EXPORTERS, depth_through, in_thousandths
from tiegraph.export.survey import OFFSET, Exporter, Survey, unique_names
from tiegraph.export.tiles3d import FILE as TREE
from tiegraph.export.tiles3d import Place, write_points
from tiegraph.geometry.stereo import Pinhole
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.limits import explained
from tiegraph.pipeline import files
from tiegraph.pipeline.dense import Pictures, depth_path, known_depth
from tiegraph.pipeline.mesh import FOLDER as MESH
from tiegraph.pipeline.mesh import write_mesh_tiles
from tiegraph.project.folder import must_be_empty
from tiegraph.project.run import Run
from tiegraph.project.stages import files_below, write_atomic
from tiegraph.project.stores import send, url_of
from tiegraph.scene.atomic import replacing, scratch_folder
from tiegraph.scene.cloudchunks import Station, write_e57
from tiegraph.scene.cloudfile import las_cloud
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.composed import with_cameras
from tiegraph.scene.copc import Node, copc_middle, copc_nodes
from tiegraph.scene.exif import orientation_of
from tiegraph.scene.names import inside
from tiegraph.scene.results import APART_SIGMAS, Cloud

_DEPTHS = "depths"
_RESULTS = ("report.html", "report.json", "report.pdf", "metrics.json", "accuracy.csv", "world.json", "cloud.copc.laz",
            "cloud.ply", "products", "mesh", "passes", "evaluate", "sparse/world")  # fmt: skip
_UP = rigid(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))  # a scanner has z up, a camera has y down
_SCAN = 10_000_000  # points of a scan of an E57 file: pye57 writes one from memory, about 0.5 GB


@dataclass(frozen=True)
class _Picture:
    """An image of the run and its export: its names there and in the folder, its camera there, the pinhole
    camera through which it is undistorted (None: unchanged), its mask and depth map in the folder ("" = none)."""

    source: str
    name: str
    camera: CameraModel
    pinhole: CameraModel | None
    mask: str = ""
    depth: str = ""


def needed(name: str) -> tuple[str, str]:
    """The artefact of a run that an export is made of, and the stage that makes it. Raises SettingsError for an unknown
    name."""
    clouds = dict.fromkeys(CLOUDS, ("cloud.laz", "cloud"))
    of = {"results": ("report.html", "report"), "dense": ("depth", "dense"), **clouds}
    choose("export", name, dict.fromkeys((*of, *EXPORTERS)))
    return of.get(name, ("sparse/world", "georef"))


def hand_out(run: Run, target: str | Path, name: str, camera: str = "") -> int:
    """Write what a program takes (a name of `tiegraph export --to`) into a folder, whole or not at all, or to a URL;
    its number of images, poses, cameras, points, depth maps or (results) files.

    Raises InputError for an unknown camera, a place that is not empty, a full disk, a world not on the Earth;
    EngineMissing without the library of a form or of a store.
    """
    url = url_of(target)
    if url and name == "results":  # as they are
        names = files_below(run.folder, _RESULTS)
        send(url, run.folder, names, run.reporter)
        return len(names)
    if url:
        with scratch_folder() as scratch:
            count, _ = _written(run, scratch / "made", name, camera)
            send(url, scratch / "made", files_below(scratch / "made", os.listdir(scratch / "made")), run.reporter)
        return count
    count, opened = _written(run, Path(target), name, camera)
    if opened:
        run.reporter.say(f"opened by: {opened.format(folder=target)}")
    return count


def _written(run: Run, target: Path, name: str, camera: str) -> tuple[int, str]:
    """The number of things in a new folder, and how to open it ({folder} = where it is)."""
    must_be_empty(target)
    write = {"results": _results, "dense": _workspace, **CLOUDS}.get(name, partial(_program, name=name, camera=camera))
    try:
        with replacing(target.absolute()) as made:
            made.mkdir()
            return write(run, made)
    except (OSError, RuntimeError) as error:
        told = explained(error, target) or InputError(f"{target}: cannot be written: {error}; choose another folder")
        raise error if isinstance(error, TiegraphError) else told from error
    finally:
        run.close()


def _program(run: Run, made: Path, name: str, camera: str) -> tuple[int, str]:
    exporter = EXPORTERS[name]
    if camera and exporter.lens is not None:
        raise InputError(f"--camera {camera}: only trajectories (--to tum, --to kitti) are of one camera")
    survey = _survey(run)
    if exporter.lens is not None:
        survey = _with_pictures(run, survey, exporter, made)
    return exporter.write(replace(survey, camera=camera), made), exporter.opened


def _results(run: Run, made: Path) -> tuple[int, str]:
    names = files_below(run.folder, _RESULTS)
    for name in names:
        _copy(run.folder / name, made / name)
    return len(names), ""


def _workspace(run: Run, made: Path) -> tuple[int, str]:
    """The depth maps as a dense workspace of COLMAP."""
    model, load = files.load_model(run.path("sparse", "world")), partial(known_depth, folder=run.folder)
    return write_workspace(made, model, run.path("images"), load, run.settings.dense), ""


def _e57(run: Run, made: Path) -> tuple[int, str]:
    """The cloud, each point in the scan of the frame that saw it from nearest, and the images."""
    path, origin = run.path("cloud.laz"), files.world_origin(run.folder)
    model = files.load_model(run.path("sparse", "world"))
    pictures = Pictures(run.folder, Pictures.of(run).plans, run.settings.dense)
    frame = [model.find_image_with_name(view.name).frame_id for view in pictures.views]
    names = {key: view.name for key, view in zip(frame[::-1], pictures.views[::-1])}  # of a frame: its first image's
    with files.reading(path), laspy.open(path) as reader, scratch_folder(made) as scratch:
        parts = []
        for part in reader.chunk_iterator(_SCAN):
            cloud = las_cloud(part, reader.header, origin)
            rows = np.zeros(len(cloud), [("frame", "<i8"), ("xyz", "<f8", 3), ("rgb", "u1", 3)])
            rows["frame"], rows["xyz"], rows["rgb"] = _seen_from(cloud, pictures, frame), cloud.xyz_m, cloud.rgb
            parts.append(scratch / f"{len(parts)}.npy")
            np.save(parts[-1], rows[np.argsort(rows["frame"], kind="stable")])
        stored = [np.load(part, mmap_mode="r") for part in parts]
        shown = _shown(pictures, [names[key] for key in frame])
        count = write_e57(_scans(stored, model, names), made / "cloud.e57", origin, shown)
    _say_crs(run, made)
    return count, "CloudCompare, {folder}/cloud.e57"


def _seen_from(cloud: Cloud, pictures: Pictures, frame: Sequence[int]) -> np.ndarray:
    """(N,) the frame of the nearest image whose depth map has a point; -1: none has."""
    found, nearest = np.full(len(cloud), -1), np.full(len(cloud), np.inf)
    for key, view in zip(frame, pictures.views):
        near = view.inside(view.project(cloud.xyz_m[::100])[0]).any()  # or the image looks elsewhere
        own = known_depth(view.name, pictures.folder) if near else None
        if own is None:
            continue
        xy, z = view.project(cloud.xyz_m)
        there = np.flatnonzero(view.inside(xy) & (z < nearest))
        column, row = np.minimum(xy[there].astype(int), np.array(view.size) - 1).T
        sigma = np.hypot(own.sigma_m[row, column], np.nan_to_num(cloud.sigma_m[there]))
        apart = np.abs(own.depth_m[row, column] - z[there])
        there = there[apart <= APART_SIGMAS * sigma + z[there] / view.focal]
        found[there], nearest[there] = key, z[there]
    return found


def _scans(parts: Sequence[np.ndarray], model: pycolmap.Reconstruction, names: Mapping[int, str]) -> Iterator[Station]:
    """A scan of each frame that has points, and of the points that no frame has, part by part; ``parts`` are sorted."""
    for key, name in sorted(names.items(), key=lambda item: item[1]):
        own = [part[slice(*np.searchsorted(part["frame"], [key, key + 1]))] for part in parts]
        rig_from_world = model.frame(key).rig_from_world
        if sum(map(len, own)) and rig_from_world is not None:
            rows = np.concatenate(own)
            yield name, invert(matrix(rig_from_world)) @ _UP, rows["xyz"], rows["rgb"]
    for number, part in enumerate(parts, 1):
        rows = np.array(part[: np.searchsorted(part["frame"], 0)])
        if len(rows):
            middle = rigid(np.eye(3), np.round(rows["xyz"].mean(axis=0)))
            yield f"tiegraph {number}", middle, rows["xyz"], rows["rgb"]


def _shown(pictures: Pictures, names: Sequence[str]) -> Iterator[tuple[Pinhole, bytes, str]]:
    """Camera and JPEG of each image that is there, and the name of its frame."""
    for k, view in enumerate(pictures.views):
        if (pictures.folder / "images" / view.name).is_file():
            jpeg = cv2.imencode(".jpg", pictures.picture(k)[0][..., ::-1])[1].tobytes()
            yield view, jpeg, names[k]


def _potree(run: Run, made: Path) -> tuple[int, str]:
    with files.reading(run.path(files.CLOUD)), laspy.open(run.path(files.CLOUD)) as reader:
        count = reader.header.point_count
    _copy(run.path(files.CLOUD), made / files.CLOUD)
    _say_crs(run, made)
    return count, "Potree (1.8 or later): Potree.loadPointCloud('{folder}/cloud.copc.laz', 'cloud', ...)"


def _say_crs(run: Run, made: Path) -> None:
    """Beside coordinates that are those of the CRS already."""
    origin = files.world_origin(run.folder)
    said = {"crs": None if origin is None else origin.crs, "unit": files.world_unit(run.folder)}
    write_atomic(made / OFFSET, json.dumps({**said, "crs_from_local": np.eye(4).tolist()}))


def _tiles(run: Run, made: Path) -> tuple[int, str]:
    """The cloud as a tree of tiles, and beside it the mesh, if there is one."""
    path, origin = run.path(files.CLOUD), files.world_origin(run.folder)
    with files.reading(path):
        place = Place.about(copc_middle(path, origin), origin)

    def nodes() -> Iterator[Node]:
        with files.reading(path):
            yield from copc_nodes(path, origin)

    count = write_points(nodes(), place, made / "cloud")
    there = [made / "cloud"]
    if run.path(MESH, "mesh.glb").exists():
        write_mesh_tiles(run, place, made / MESH)
        there.append(made / MESH)
    trees = ", ".join(f"{{folder}}/{folder.name}/{TREE}" for folder in there)
    lost = " (the world is not on the Earth: the tiles are in its own axes, without a place)" if origin is None else ""
    return count, f"CesiumJS, Cesium3DTileset.fromUrl of {trees}{lost}"


CLOUDS = {"e57": _e57, "3dtiles": _tiles, "potree": _potree}
"""What is written of the cloud, by name: the number of its points, and how to open it ({folder} = where it is)."""


def _survey(run: Run) -> Survey:
    ties = []
    if run.path("match.npz").exists():
        pairs, names = files.pairs_of(run, "match.npz").kept(), files.checked(run).names
        ties = [(names[i], names[j], int(n)) for i, j, n in zip(pairs.i, pairs.j, pairs.inliers)]
    return Survey(
        scene=files.whole(run),
        model=files.load_model(run.path("sparse", "world")),
        unit=files.world_unit(run.folder),
        origin=files.world_origin(run.folder),
        error=files.placement_error(run.folder),
        ties=ties,
    )


def _with_pictures(run: Run, survey: Survey, exporter: Exporter, target: Path) -> Survey:
    model, lens = survey.model, exporter.lens
    assert lens is not None
    own = {key: CameraModel.of(camera) for key, camera in model.cameras.items()}
    kept = lens(dict(model.cameras.items()))
    pinholes = {key: centred_pinhole(c, run.settings.dense) for key, c in own.items() if key not in kept}
    cameras = {key: pinhole.to_pycolmap() for key, pinhole in pinholes.items()}
    camera_of = {image.name: image.camera_id for image in survey.images()}
    names = _names(camera_of, pinholes, exporter)
    has_masks = any(_mask(run.folder, name).exists() for name in camera_of)
    has_depth = exporter.depth and any(depth_path(run.folder, name).exists() for name in camera_of)
    pictures = []
    for source, name in names.items():
        stem, camera = str(PurePosixPath(name).with_suffix("")), camera_of[source]
        mask = exporter.mask.format(name=name, stem=stem) if has_masks else ""
        depth = f"{_DEPTHS}/{stem}" if has_depth else ""
        pictures.append(_Picture(source, name, own[camera], pinhole=pinholes.get(camera), mask=mask, depth=depth))
    with run.reporter.stage("export"):
        run.reporter.total(len(pictures))
        depths = run.map(_write_picture, pictures, run.folder, target, survey.unit)
    return replace(
        survey,
        model=with_cameras(model, {**kept, **cameras}, names),
        names={name: source for source, name in names.items()},
        masks={p.name: p.mask for p in pictures if p.mask},
        depths={p.name: depth for p, depth in zip(pictures, depths) if depth},
    )


def _names(camera_of: Mapping[str, int], pinholes: Mapping[int, CameraModel], exporter: Exporter) -> dict[str, str]:
    """Names in the folder by those in the run. An undistorted image keeps its suffix if OpenCV writes such files."""
    if not exporter.flat:
        return {name: name for name in camera_of}
    suffix = {name: PurePosixPath(name).suffix for name in camera_of}
    changed = {n: ".jpg" for n, s in suffix.items() if camera_of[n] in pinholes and not cv2.haveImageWriter(f"x{s}")}
    return unique_names(list(camera_of), changed)


def _mask(folder: Path, name: str) -> Path:
    """The last mask of an image in the run."""
    final = files.mask_path(folder / files.FINAL, name)
    return final if final.exists() else files.mask_path(folder, name)


def _write_picture(picture: _Picture, folder: Path, target: Path, unit: str) -> str:
    """Write an image, its mask and its depth map below ``target``; the name of the depth map's file, "" = none.

    An image with an EXIF rotation is written again: the model refers to the pixels as they are stored."""
    images, image, mask = folder / "images", inside(target / "images", picture.name), _mask(folder, picture.source)
    if not (images / picture.source).is_file():
        raise InputError(f"{images / picture.source} is gone: restore the images of the survey")
    use = None
    if picture.pinhole is not None:
        masks = mask.parents[len(PurePosixPath(picture.source).parts) - 1] if picture.mask else None
        seen = view_through(picture.pinhole, ViewPlan(picture.source, picture.camera, np.eye(4)), images, masks)
        use = seen.mask
        _write_image(image, seen.image_bgr)
    elif orientation_of(images / picture.source) > 1:
        _write_image(image, files.read_image(images / picture.source, cv2.IMREAD_COLOR))
    else:
        _copy(images / picture.source, image)
    if picture.mask and use is None and mask.exists():
        _copy(mask, inside(target, picture.mask))
    elif picture.mask:
        whole_image = np.ones((picture.camera.height, picture.camera.width), bool)
        files.save_png(inside(target, picture.mask), whole_image if use is None else use)
    return _write_depth(picture, folder, target, unit) if picture.depth else ""


def _copy(source: Path, target: Path) -> None:
    """A copy and no link: a tool that changes an image in place must not change the survey's, or the user's."""
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def _write_image(path: Path, bgr: np.ndarray) -> None:
    kind = path.suffix if cv2.haveImageWriter(path.name) else ".jpg"
    write_atomic(path, cv2.imencode(kind.lower(), bgr)[1].tobytes())


def _write_depth(picture: _Picture, folder: Path, target: Path, unit: str) -> str:
    path = depth_path(folder, picture.source)
    camera = (picture.pinhole or picture.camera).to_pycolmap()
    values = in_thousandths(depth_through(camera, files.load_map(path) if path.exists() else None), unit)
    if values.dtype == np.uint16:
        name = f"{picture.depth}.png"
        write_atomic(inside(target, name), cv2.imencode(".png", values)[1].tobytes())
        return name
    name, buffer = f"{picture.depth}.npy", io.BytesIO()
    np.save(buffer, values)
    write_atomic(inside(target, name), buffer.getvalue())
    return name
