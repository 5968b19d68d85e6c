"""Exports, opened by second readers: folders of programs, E57 by pye57, maps by PROJ, GDAL and a JSON schema."""

import errno
import json
import shutil
import sqlite3
import subprocess
import sys
import xml.etree.ElementTree as xml
from dataclasses import replace

import cv2
import e57
import numpy as np
import pycolmap
import pye57
import pyproj
import pytest
from PIL import Image
from pyopf.io import load
from pyopf.resolve import resolve
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import tiegraph
from export_world import FAR, FRAMES, LENSES, NORMAL, NOTHING, ORIGIN, SIZE, camera_of, finished, plane_depth, spot_near
from tiegraph.errors import EngineMissing, InputError, SettingsError
from tiegraph.export import exporters as lens
from tiegraph.export import maps
from tiegraph.export.exporters import in_thousandths
from tiegraph.export.survey import unique_names
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import apply, invert, rigid
from tiegraph.pipeline import export as glue
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scene.cloudchunks import open_cloud
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.posefile import read_poses
from tiegraph.scene.results import Cloud

pytestmark = pytest.mark.slow
IMAGES = 4 * FRAMES


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return finished(tmp_path_factory.mktemp("survey"))


@pytest.fixture(scope="module")
def fisheye(tmp_path_factory):
    return finished(tmp_path_factory.mktemp("fisheye"), ("OPENCV_FISHEYE", "OPENCV_FISHEYE"))


def exported(made, tmp_path, name, **more):
    assert made.project.export(tmp_path / name, name, **more) > 0
    return tmp_path / name


def flat(name: str) -> str:
    return name.replace("/", "_")


def to_crs(folder) -> np.ndarray:
    return np.array(json.loads((folder / "offset.json").read_text())["crs_from_local"])


def check_spots(made, folder, poses, cameras, names):
    """Spots of the exported images lie within a tenth of a pixel (95 %) of where exported camera, pose and point say;
    the poses lead back to those of the model in the CRS. ``names``: of the scene's images in the folder."""
    off, back = [], to_crs(folder)
    local = apply(np.linalg.inv(back), made.points + ORIGIN.shift_m)
    for image in made.model.images.values():
        name = names(image.name)
        camera, pose = cameras[name], invert(poses[name])
        centre = apply(back, poses[name][None, :3, 3])[0] - ORIGIN.shift_m
        assert np.abs(centre - image.projection_center()).max() < 1e-3
        grey = cv2.imread(str(folder / "images" / name), cv2.IMREAD_GRAYSCALE)
        assert grey.shape == (camera.height, camera.width)
        there = apply(pose, local)
        ahead = there[np.linalg.norm(there[:, :2], axis=1) < there[:, 2]]  # beyond, spots are stretched
        seen = np.asarray(camera.img_from_cam(ahead))
        for at in seen:
            if (np.linalg.norm(seen - at, axis=1) < 18).sum() == 1:  # no other spot near
                off.append(spot_near(grey, at) - at)
    off = [o for o in off if np.isfinite(o).all()]
    assert len(off) > 15 * IMAGES
    assert np.abs(np.mean(off, axis=0)).max() < 0.03
    assert np.percentile(np.linalg.norm(off, axis=1), 95) < 0.1


def camera_found(found) -> pycolmap.Camera:
    return pycolmap.Camera(model=found.model, width=found.size[0], height=found.size[1], params=list(found.params))


def check_started(made, folder, names, prefix="", model=""):
    """By the reader of start models."""
    start = read_start(folder / model)
    assert len(start.poses) == IMAGES and not start.notes
    poses = {n.removeprefix(prefix): p for n, p in start.poses.items()}
    cameras = {n.removeprefix(prefix): camera_found(c) for n, c in start.cameras.items()}
    check_spots(made, folder, poses, cameras, names)
    return poses, cameras


@pytest.mark.parametrize("world", ["made", "fisheye"])
def test_nerfstudio(world, request, tmp_path):
    made = request.getfixturevalue(world)
    folder = exported(made, tmp_path, "nerfstudio")
    poses, cameras = check_started(made, folder, flat, "images/")
    data = json.loads((folder / "transforms.json").read_text())
    assert data["camera_model"] == {"made": "OPENCV", "fisheye": "OPENCV_FISHEYE"}[world]
    assert np.array(data["applied_transform"]).tolist() == np.eye(4)[:3].tolist()
    source = made.project.folder / "images"
    for frame in data["frames"]:
        name = frame["file_path"].removeprefix("images/")
        original = next(n for n in made.scene.names if flat(n) == name)
        copy = folder / "images" / name  # both lenses are nerfstudio's own
        assert copy.read_bytes() == (source / original).read_bytes() and not copy.samefile(source / original)
        mask = np.array(Image.open(folder / frame["mask_path"])).astype(bool)
        depth = cv2.imread(str(folder / frame["depth_file_path"]), cv2.IMREAD_ANYDEPTH)
        assert mask.shape == depth.shape == (frame["h"], frame["w"]) and depth.dtype == np.uint16
        if all(part in name for part in NOTHING):
            assert mask.all() and not depth.any()
            continue
        assert not mask[:, :39].any() and mask[:, 41:].all()
        u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
        rays = np.asarray(cameras[name].cam_ray_from_img(np.stack([u, v], axis=-1).reshape(-1, 2)))
        true = plane_depth(invert(poses[name]), rays / rays[:, 2:]).reshape(depth.shape)
        known = (depth > 0) & (true < 30)
        assert known.mean() > 0.6
        assert np.median(np.abs(depth[known] / 1000 / true[known] - 1)) < 0.002
    points = pycolmap.Reconstruction()
    points.import_PLY(str(folder / data["ply_file_path"]))
    said = np.array(sorted(p.xyz.tolist() for p in points.points3D.values()))
    assert np.allclose(said, sorted(p.xyz.tolist() for p in made.model.points3D.values()), atol=1e-5)


def test_nerfstudio_undistorts_what_it_does_not_know(tmp_path):
    made = finished(tmp_path, ("FULL_OPENCV", "OPENCV_FISHEYE"))
    shutil.rmtree(made.project.folder / "depth")  # before `dense`
    shutil.rmtree(made.project.folder / "refine")
    folder = exported(made, tmp_path, "nerfstudio")
    data = json.loads((folder / "transforms.json").read_text())
    assert not {"mask_path", "depth_file_path"} & data["frames"][0].keys()
    _, cameras = check_started(made, folder, flat, "images/")
    assert {c.model_name for c in cameras.values()} == {"OPENCV"}  # one model a file: the fisheye's too


@pytest.mark.parametrize("name, names", [("colmap", str), ("gsplat", flat), ("openmvs", flat)])
def test_folders_of_colmap(made, tmp_path, name, names):
    folder = exported(made, tmp_path, name)
    sparse = folder / ("sparse" if name == "openmvs" else "sparse/0")
    check_started(made, folder, names, model=sparse.relative_to(folder))
    text = pycolmap.Reconstruction()
    text.read_text(str(sparse))
    model = text
    if name != "openmvs":
        model = pycolmap.Reconstruction(str(sparse))
        assert model.num_points3D() == text.num_points3D()
    assert (sparse / "images.bin").exists() == (name != "openmvs")
    assert {c.model_name for c in model.cameras.values()} == {"PINHOLE"}
    assert len(model.frames) == 2 * FRAMES and len(model.rigs) == 1  # frames and rig stay
    assert model.num_points3D() > 0.6 * made.model.num_points3D()
    assert model.compute_mean_reprojection_error() < 1e-3
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() < 1e-3
    for image in model.images.values():
        camera = model.camera(image.camera_id)
        assert (camera.principal_point_x, camera.principal_point_y) == (camera.width / 2, camera.height / 2)
        observed = np.array([p.xy for p in image.get_observation_points2D()])
        assert (observed >= 0).all() and (observed <= [camera.width, camera.height]).all()
        stem = image.name.rsplit(".", 1)[0]
        mask = cv2.imread(str(folder / "masks" / (f"{stem}.mask.png" if name == "openmvs" else f"{image.name}.png")), 0)
        assert mask.shape == (camera.height, camera.width) and set(np.unique(mask)) <= {0, 255}
        assert mask.all() == all(part in image.name for part in NOTHING)


def test_images_of_pinhole_cameras_are_copied(tmp_path):
    made = finished(tmp_path, ("PINHOLE", "PINHOLE"))
    turned = tmp_path / "images" / made.scene.names[0]
    pixels = cv2.imread(str(turned))
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.open(turned).save(turned, exif=exif, quality=98)
    folder = exported(made, tmp_path, "gsplat")
    names = [(folder / "images" / flat(n), tmp_path / "images" / n) for n in made.scene.names]
    same = [copy.read_bytes() == own.read_bytes() for copy, own in names]
    assert same == [False] + [True] * (IMAGES - 1)  # what EXIF would turn is written anew
    assert not any(copy.is_symlink() or copy.samefile(own) for copy, own in names)
    again = cv2.imread(str(folder / "images" / flat(made.scene.names[0])))
    assert np.abs(again.astype(int) - pixels).mean() < 1
    check_started(made, folder, flat)


def test_bundler(made, tmp_path):
    folder = exported(made, tmp_path, "bundler")
    lines = iter((folder / "bundle.out").read_text().splitlines()[1:])
    names = (folder / "list.txt").read_text().split()
    images, points = (int(n) for n in next(lines).split())
    assert images == len(names) == IMAGES
    views, back = [], to_crs(folder)
    for name in names:
        focal, k1, k2 = (float(v) for v in next(lines).split())
        assert k1 == k2 == 0
        pose = np.array([[float(v) for v in next(lines).split()] for _ in range(4)])
        views.append((focal, pose[:3], pose[3], cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)))
    off = []
    for _ in range(points):
        xyz = np.array([float(v) for v in next(lines).split()])
        next(lines)
        count, *rest = next(lines).split()
        assert np.abs(apply(back, xyz[None]) - ORIGIN.shift_m - made.points).max(axis=1).min() < 1e-6
        for number, _, x, y in np.array(rest, float).reshape(int(count), 4):
            focal, turn, shift, grey = views[int(number)]
            there = turn @ xyz + shift
            at = -focal * there[:2] / there[2]
            assert np.abs(at - [x, y]).max() < 1e-3
            found = spot_near(grey, at * [1, -1] + np.array(grey.shape[::-1]) / 2)
            off.append(found * [1, -1] - np.array([1, -1]) * grey.shape[::-1] / 2 - at)
    off = np.array(off)[np.isfinite(off).all(axis=1)]
    assert len(off) > 100 and np.percentile(np.linalg.norm(off, axis=1), 95) < 0.1


@pytest.mark.parametrize("world", ["made", "fisheye"])
def test_opensfm(world, request, tmp_path):
    made = request.getfixturevalue(world)
    folder = exported(made, tmp_path, "opensfm")
    check_started(made, folder, flat)
    (data,) = json.loads((folder / "reconstruction.json").read_text())
    place = json.loads((folder / "reference_lla.json").read_text())
    assert data["reference_lla"] == place
    back = to_crs(folder)
    said = np.array([p["coordinates"] for p in data["points"].values()])
    true = np.array([made.model.points3D[int(k)].xyz for k in data["points"]])
    assert np.abs(apply(back, said) - ORIGIN.shift_m - true).max() < 1e-3
    _, *tracks = (line.split("\t") for line in (folder / "tracks.csv").read_text().splitlines())
    assert len(tracks) == sum(i.num_points3D for i in made.model.images.values())
    for name, point, _, x, y, *_ in tracks[::20]:  # of the links: where the model has them
        image = next(i for i in made.model.images.values() if flat(i.name) == name)
        at = next(p.xy for p in image.points2D if p.point3D_id == int(point))
        assert np.allclose((at - np.array(SIZE) / 2) / max(SIZE), [float(x), float(y)], atol=1e-6)
    # East, north, up about the place, by PROJ itself
    geodetic = pyproj.Transformer.from_crs(ORIGIN.crs, "EPSG:4979", always_xy=True).transform(*apply(back, said).T)
    about = f"+lon_0={place['longitude']!r} +lat_0={place['latitude']!r} +h_0={place['altitude']!r}"
    steps = ("+proj=unitconvert +xy_in=deg +xy_out=rad", "+proj=cart", f"+proj=topocentric {about}")
    level = pyproj.Transformer.from_pipeline("+proj=pipeline " + " ".join(f"+step {step}" for step in steps))
    assert np.abs(np.stack(level.transform(*geodetic), axis=-1) - said).max() < 0.01  # the CRS's scale: 4 in 10000


def test_opf(made, tmp_path):
    folder = exported(made, tmp_path, "opf")
    command = [sys.executable, "-m", "opf_tools.opf2colmap", folder / "project.opf", "--out-dir", folder / "sparse"]
    (folder / "sparse").mkdir()
    subprocess.run(command, check=True, capture_output=True)  # Pix4D's own converter
    _, cameras = check_started(made, folder, flat, model="sparse")
    assert any(c.params[4] for c in cameras.values())  # one lens stays, the other has no square pixels
    project = resolve(load(folder / "project.opf"))
    (frame,) = project.scene_reference_frame_objs
    assert pyproj.CRS(frame.crs.definition).to_epsg() == 32654 and not frame.base_to_canonical.swap_xy
    assert (frame.base_to_canonical.shift + ORIGIN.shift_m == 0).all()
    found, given = project.calibration.calibrated_cameras, project.input_cameras
    assert len(given.captures) == 2 * FRAMES and {s.name for s in given.sensors} == {"cam0", "cam1"}
    (relative,) = (s.rig_relatives for s in found.sensors if s.rig_relatives)
    turn = Rotation.from_euler("XYZ", relative.rotation_angles_deg, degrees=True).as_matrix()
    mount = matrix(made.model.rig(1).sensor_from_rig(made.model.camera(2).sensor_id))  # y down, as OPF's rigs
    assert np.allclose(invert(rigid(turn, relative.translation)), mount, atol=1e-9)
    by_id, uri = {c.id: c for c in found.cameras}, {c.id: c.uri for c in project.camera_list.cameras}
    for capture in given.captures:
        assert [flat("cam0") in uri[capture.reference_camera_id], len(capture.cameras)] == [True, 2]
        index = made.scene.image_index[
            next(n for n in made.scene.names if f"images/{flat(n)}" in uri[capture.cameras[0].id])
        ]
        assert capture.time.timestamp() == pytest.approx(made.scene.time_s[made.scene.frame[index]])
        assert all(c.id in by_id for c in capture.cameras)
    tracks = project.calibration.tracks.nodes[0]
    xyz = apply(tracks.matrix, np.asarray(tracks.position, float)) @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    assert all(np.abs(made.points - at).max(axis=1).min() < 1e-5 for at in xyz)
    assert tracks.matches.point_index_ranges.total_count() == len(tracks.matches.camera_ids) > 100
    assert len(xyz) == len(tracks.color) and len(xyz) > 0.6 * made.model.num_points3D()


def test_opf_of_worlds_without_a_crs_and_with_north_first(tmp_path):
    for name, origin in (("free", None), ("japan", replace(ORIGIN, crs="EPSG:6677"))):
        folder = tmp_path / name
        finished(folder, origin=origin).project.export(folder / "opf", "opf")
        (frame,) = resolve(load(folder / "opf" / "project.opf")).scene_reference_frame_objs
        crs, swapped = pyproj.CRS(frame.crs.definition), frame.base_to_canonical.swap_xy
        assert [a.direction for a in crs.axis_info][:2] == (["north", "east"] if swapped else ["east", "north"])
        assert swapped == (name == "japan") and crs.is_engineering == (name == "free")


@pytest.mark.parametrize("world", ["made", "fisheye"])
def test_metashape(world, request, tmp_path):
    made = request.getfixturevalue(world)
    folder = exported(made, tmp_path, "metashape")
    start = read_start(folder / "cameras.xml")  # labels have no ending
    full = {flat(n).rpartition(".")[0]: flat(n) for n in made.scene.names}
    cameras = {full[n]: camera_found(c) for n, c in start.cameras.items()}
    check_spots(made, folder, {full[n]: p for n, p in start.poses.items()}, cameras, flat)
    assert {c.model_name for c in cameras.values()} == {"OPENCV" if world == "made" else "OPENCV_FISHEYE"}
    source = made.project.folder / "images"
    assert all((folder / "images" / flat(n)).read_bytes() == (source / n).read_bytes() for n in made.scene.names)


@pytest.mark.parametrize("camera", ["", "cam1"])
def test_trajectories(made, tmp_path, camera):
    true = {}
    for image in made.model.images.values():
        index = made.scene.image_index[image.name]
        pose = made.model.frame(image.frame_id).rig_from_world if not camera else image.cam_from_world()
        if not camera or f"/{camera}/" in image.name:
            true[int(made.scene.frame[index])] = invert(matrix(pose))
    tum = exported(made, tmp_path, "tum", camera=camera)
    kitti = exported(made, tmp_path, "kitti", camera=camera)
    for number, name in enumerate(("down", "up")):
        poses = np.array([true[number * FRAMES + k] for k in range(FRAMES)])
        times = made.scene.time_s[number * FRAMES : (number + 1) * FRAMES]
        found = read_poses(tum / f"{name}.tum")
        assert np.allclose(found.poses, poses, atol=1e-7) and np.allclose(found.time_s, times, atol=1e-6)
        assert np.allclose(read_poses(kitti / name / "poses.txt").poses, poses, atol=1e-7)
        assert np.allclose(np.loadtxt(kitti / name / "times.txt"), times, atol=1e-6)
    assert np.allclose(to_crs(tum)[:3, 3], ORIGIN.shift_m)


def test_what_an_export_refuses(made, tmp_path):
    project = made.project
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    with pytest.raises(InputError, match="not empty"):
        project.export(tmp_path / "full", "tum")
    with pytest.raises(SettingsError, match="unknown export 'nerfstudo'.*nerfstudio"):
        project.export(tmp_path / "a", "nerfstudo")
    with pytest.raises(InputError, match="--camera front: no pose is of it; there are cam0, cam1"):
        project.export(tmp_path / "b", "tum", camera="front")
    with pytest.raises(InputError, match="only trajectories"):
        project.export(tmp_path / "c", "colmap", camera="cam0")
    with pytest.raises(InputError, match="georef"):
        tiegraph.open(tmp_path, tmp_path / "none").export(tmp_path / "d", "colmap")


def test_an_image_that_is_gone_is_named(tmp_path):
    made = finished(tmp_path)
    (tmp_path / "images" / made.scene.names[3]).unlink()
    for name in ("nerfstudio", "colmap"):  # copied, undistorted
        with pytest.raises(InputError, match=f"{made.scene.names[3]} is gone"):
            made.project.export(tmp_path / name, name)
        assert not (tmp_path / name).exists()


def test_names_are_unique_without_folder_suffix_and_case():
    names = ["a/b 1.jpg", "a_b_1.png", "A/B_1.jpg", "x.y/ü.tif"]
    made = unique_names(names, {"x.y/ü.tif": ".jpg"})
    assert list(made.values()) == ["a_b_1.jpg", "a_b_1_2.png", "A_B_1_3.jpg", "x_y_ü.jpg"]


def test_which_images_stay():
    cameras = {k: camera_of(name) for k, name in enumerate(LENSES)}
    assert {LENSES_OF[k] for k in lens.opencv(cameras)} == {"OPENCV", "SIMPLE_RADIAL", "PINHOLE"}
    assert [c.model_name for c in lens.opencv({3: cameras[3]}).values()] == ["OPENCV_FISHEYE"]
    wide = cameras[4]
    assert list(lens.pinholes(cameras)) == list(lens.centred(cameras)) == [4]
    wide.principal_point_x += 1
    assert not lens.centred({4: wide}) and lens.pinholes({4: wide})


LENSES_OF = tuple(LENSES)


def test_depth_is_in_millimetres_where_these_hold_it():
    near, far = np.array([[0.0, 1.2346]]), np.array([[0.0, 70.0]])
    assert in_thousandths(near, "m").tolist() == [[0, 1235]] and in_thousandths(near, "m").dtype == np.uint16
    for depth, unit in ((far, "m"), (near, "units")):
        assert in_thousandths(depth, unit).dtype == np.float32


def test_a_full_disk_is_named_and_leaves_nothing(made, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tiegraph.export.exporters.write_tum", full)
    with pytest.raises(InputError, match="No space left on device.*choose another output folder"):
        made.project.export(tmp_path / "a", "tum")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def made_e57(tmp_path_factory):
    """A survey with a cloud on its plane, with a tenth of the points far from it, where no depth map has them."""
    found = finished(tmp_path_factory.mktemp("survey"))
    rng = np.random.default_rng(0)
    count = 5000
    xy = rng.uniform([-4, -4], [8, 4], (count, 2))
    xyz = np.c_[xy, FAR - xy @ NORMAL[:2]]
    xyz[::10] = rng.uniform(-200, 200, (count // 10, 3))
    cloud = Cloud(
        xyz_m=np.round(xyz, 3),
        rgb=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        normal=np.tile(np.array([0, 0, 1], np.float32), (count, 1)),
        sigma_m=np.full(count, 0.01, np.float32),
        views=np.full(count, 3, np.uint8),
        origin=ORIGIN,
    )
    write_cloud(cloud, found.project.folder / "cloud.laz")
    return found, cloud


def scans_of(file, **how):
    """(xyz, rgb) of each scan, by pye57."""
    for k in range(file.scan_count):
        scan = file.read_scan(k, colors=True, ignore_missing_fields=True, **how)
        xyz, rgb = (
            np.stack([scan[n + c] for c in axes], axis=1)
            for n, axes in (("cartesian", "XYZ"), ("color", ("Red", "Green", "Blue")))
        )
        yield xyz, rgb


@pytest.mark.parametrize("part", [10_000_000, 2000])
def test_the_cloud_comes_back_to_the_millimetre(made_e57, tmp_path, monkeypatch, part):
    made, cloud = made_e57
    monkeypatch.setattr(glue, "_SCAN", part)
    path = tmp_path / "e57" / "cloud.e57"
    assert made.project.export(tmp_path / "e57", "e57") == len(cloud)
    xyz, rgb = (np.concatenate(of) for of in zip(*scans_of(pye57.E57(str(path)))))
    away, nearest = cKDTree(cloud.xyz_m + ORIGIN.shift_m).query(xyz)
    assert away.max() < 0.001 and (rgb == cloud.rgb[nearest]).all() and len(np.unique(nearest)) == len(cloud)
    assert np.abs(e57.read_points(str(path)).points - xyz).max() < 1e-5  # another library, in Rust
    said = json.loads((tmp_path / "e57" / "offset.json").read_text())
    assert said["crs"] == "EPSG:32654" and said["crs_from_local"] == np.eye(4).tolist()
    again = np.concatenate([part.xyz for part in open_cloud(path).parts()])
    assert np.abs(again - xyz).max() < 1e-9


@pytest.fixture(scope="module")
def stations(made_e57, tmp_path_factory):
    """(survey, cloud, file of E57)"""
    folder = tmp_path_factory.mktemp("stations") / "e57"
    made_e57[0].project.export(folder, "e57")
    return *made_e57, pye57.E57(str(folder / "cloud.e57"))


def test_each_frame_is_a_scan_of_the_points_it_saw_from_nearest(stations):
    made, cloud, file = stations
    own = list(scans_of(file, transform=False))
    least = np.full(len(cloud), np.inf)  # depth in the nearest image
    for image in made.model.images.values():
        there = apply(matrix(image.cam_from_world()), cloud.xyz_m)
        at = np.asarray(image.camera.img_from_cam(there))
        inside = (there[:, 2] > 0.5) & (at > 0).all(axis=1) & (at < SIZE).all(axis=1)
        least = np.minimum(least, np.where(inside, there[:, 2], np.inf))
    least[::10] = np.inf
    count, close = 0, []
    for k, (xyz, _) in enumerate(own):
        header = file.get_header(k)
        assert header["name"].value().endswith(" (EPSG:32654)")
        box = [[header["cartesianBounds"][f"{c}{e}"].value() for c in "xyz"] for e in ("Minimum", "Maximum")]
        assert np.abs([xyz.min(axis=0), xyz.max(axis=0)] - np.array(box)).max() < 1e-4
        if header["name"].value().startswith("tiegraph"):
            continue
        first = made.model.find_image_with_name(header["name"].value().split()[0])
        frame = made.model.frame(first.frame_id)
        pose = rigid(Rotation.from_quat(np.roll(header.rotation, -1)).as_matrix(), header.translation - ORIGIN.shift_m)
        axes = (matrix(frame.rig_from_world) @ pose)[:3, :3]  # right, forward and up are x, z and -y of the camera
        assert np.abs(axes - [[1, 0, 0], [0, 0, -1], [0, 1, 0]]).max() < 1e-9
        assert np.abs(pose[:3, 3] - invert(matrix(frame.rig_from_world))[:3, 3]).max() < 1e-6
        number = cKDTree(cloud.xyz_m).query(apply(pose, xyz))[1]
        assert (number % 10 > 0).all() and (xyz[:, 1] > 0).all()
        depths = [
            apply(matrix(made.model.image(d.id).cam_from_world()), cloud.xyz_m[number])[:, 2] for d in frame.data_ids
        ]
        close.append(np.abs(np.array(depths) - least[number]).min(axis=0) < 1e-6)
        count += len(xyz)
    assert len(close) > FRAMES and np.mean(np.concatenate(close)) > 0.8  # the others are masked, or have no depth there
    assert count > 0.8 * np.isfinite(least).sum()


def test_pictures_of_e57_show_the_spots_where_the_points_are(stations):
    made, _, file = stations
    scans = {file.data3d[k]["guid"].value(): file.get_header(k)["name"].value() for k in range(file.scan_count)}
    pictures, off = file.root["images2D"], []
    assert pictures.childCount() == IMAGES
    for k in range(IMAGES):
        said = pictures[k]
        pinhole, name = said["pinholeRepresentation"], said["name"].value()
        blob = np.zeros(pinhole["jpegImage"].byteCount(), np.uint8)
        pinhole["jpegImage"].read(blob, 0, len(blob))
        grey = cv2.imdecode(blob, cv2.IMREAD_GRAYSCALE)
        assert grey.shape == (pinhole["imageHeight"].value(), pinhole["imageWidth"].value())
        turn = Rotation.from_quat([said["pose"]["rotation"][c].value() for c in "xyzw"]).as_matrix()
        place = np.array([said["pose"]["translation"][c].value() for c in "xyz"])
        image = made.model.find_image_with_name(name)
        assert np.abs(place - ORIGIN.shift_m - image.projection_center()).max() < 1e-6
        if said.isDefined("associatedData3DGuid"):
            assert scans[said["associatedData3DGuid"].value()][:4] == name[:4]
        there = (made.points + ORIGIN.shift_m - place) @ turn  # the camera looks along -z, y is up
        there = there[there[:, 2] < -0.5]
        size = np.array([pinhole["pixelWidth"].value(), pinhole["pixelHeight"].value()])
        middle = np.array([pinhole["principalPointX"].value(), pinhole["principalPointY"].value()])
        seen = middle + there[:, :2] / -there[:, 2:] * [1, -1] * pinhole["focalLength"].value() / size
        for at in seen:
            if (np.linalg.norm(seen - at, axis=1) < 18).sum() == 1:
                off.append(spot_near(grey, at) - at)
    off = np.array([o for o in off if np.isfinite(o).all()])
    assert len(off) > 15 * IMAGES and np.percentile(np.linalg.norm(off, axis=1), 95) < 0.1


def test_what_is_missing_is_named(made_e57, tmp_path, monkeypatch):
    project = made_e57[0].project
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    with pytest.raises(InputError, match="not empty"):
        project.export(tmp_path / "full", "e57")
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(EngineMissing, match=r"pip install 'tiegraph\[e57\]'"):
        project.export(tmp_path / "none", "e57")
    assert not (tmp_path / "none").exists()
    (project.folder / "cloud.laz").rename(project.folder / "away.laz")
    with pytest.raises(InputError, match=r"cloud.laz is not there yet: run\(until='cloud'\) makes it"):
        project.export(tmp_path / "none", "e57")
    (project.folder / "away.laz").rename(project.folder / "cloud.laz")


POSITION = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
SHAPES = [
    {"properties": {"type": {"const": "Point"}, "coordinates": POSITION}},
    {
        "properties": {
            "type": {"const": "LineString"},
            "coordinates": {"type": "array", "items": POSITION, "minItems": 2},
        }
    },
    {
        "properties": {
            "type": {"const": "Polygon"},
            "coordinates": {"type": "array", "items": {"type": "array", "items": POSITION, "minItems": 4}},
        }
    },
]
FEATURE = {
    "required": ["type", "geometry", "properties"],
    "properties": {"type": {"const": "Feature"}, "geometry": {"oneOf": SHAPES}, "properties": {"type": "object"}},
}
SCHEMA = {  # RFC 7946, as far as these layers go
    "type": "object",
    "required": ["type", "features"],
    "properties": {"type": {"const": "FeatureCollection"}, "features": {"type": "array", "items": FEATURE}},
}


def layer(folder, name) -> list[dict]:
    import jsonschema

    data = json.loads((folder / f"{name}.geojson").read_text())
    jsonschema.validate(data, SCHEMA)
    return data["features"]


def check_cameras(made, rows):
    """Rows of (place in the CRS, properties)."""
    assert len(rows) == len(made.model.images) == 4 * FRAMES
    for place, said in rows:
        image = made.model.find_image_with_name(said["name"])
        assert np.abs(place - ORIGIN.shift_m - image.projection_center()).max() < 1e-3
        axis = image.cam_from_world().rotation.matrix()[2]
        heading, pitch = np.radians([said["heading_deg"], said["pitch_deg"]])
        told = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)])
        assert np.abs(told - axis).max() < 1e-4
        frame = int(made.scene.frame[made.scene.image_index[said["name"]]])
        assert said["time_s"] == pytest.approx(made.scene.time_s[frame]) and said["points"] == image.num_points3D
        assert (said["pass"], said["camera"]) == tuple(said["name"].split("/")[:2])
        assert 0.034 < said["sigma_m"] < 0.036  # three times two centimetres


def test_geojson_is_in_degrees_and_leads_back_to_the_crs(made, tmp_path):
    assert made.project.export(tmp_path / "out", "geojson") == 4 * FRAMES
    to_crs = pyproj.Transformer.from_crs("EPSG:4326", ORIGIN.crs, always_xy=True)
    cameras = layer(tmp_path / "out", "cameras")
    check_cameras(made, [(np.array(to_crs.transform(*f["geometry"]["coordinates"])), f["properties"]) for f in cameras])
    views = layer(tmp_path / "out", "views")
    assert len(views) == len(cameras)
    for view in views:
        image = made.model.find_image_with_name(view["properties"]["name"])
        (ring,), camera = view["geometry"]["coordinates"], image.camera
        world = np.array([to_crs.transform(*c) for c in ring]) - ORIGIN.shift_m
        assert ring[0] == ring[-1] and 4 <= len(ring) <= 6
        local = world @ image.cam_from_world().rotation.matrix().T + image.cam_from_world().translation
        corners = local[np.linalg.norm(local, axis=1) > 0.01]
        away = corners[:, 2] / view["properties"]["distance_m"]  # less where no point is as far from the camera
        assert len(corners) >= 2 and 0.9 < away.min() <= away.max() < 1.001
        pixels = camera.img_from_cam(corners)
        off = np.minimum(np.abs(pixels), np.abs(pixels - [camera.width, camera.height]))
        assert off.max() < 0.5  # each is a corner of the image
    ties = layer(tmp_path / "out", "ties")
    assert [t["properties"]["matches"] for t in ties] == [50, 20, 10]
    assert (ties[0]["properties"]["a"], ties[0]["properties"]["b"]) == made.scene.names[:2]
    at = {f["properties"]["name"]: f["geometry"]["coordinates"] for f in cameras}
    assert all(t["geometry"]["coordinates"] == [at[t["properties"][k]] for k in "ab"] for t in ties)


def test_gpkg_is_in_the_crs_and_has_styles(made, tmp_path):
    raw = pytest.importorskip("pyogrio.raw")
    assert made.project.export(tmp_path / "out", "gpkg") == 4 * FRAMES
    path = tmp_path / "out" / maps.FILE
    meta, _, shapes, columns = raw.read(path, layer="cameras")
    assert pyproj.CRS.from_user_input(meta["crs"]) == pyproj.CRS.from_user_input(ORIGIN.crs)
    places = [np.frombuffer(shape[5:29], "<f8") for shape in shapes]  # WKB of a point with height
    names = list(meta["fields"])
    check_cameras(made, [(p, dict(zip(names, row))) for p, row in zip(places, zip(*columns))])
    meta, _, shapes, columns = raw.read(path, layer="ties")
    assert dict(zip(meta["fields"], columns))["matches"].tolist() == [50, 20, 10]
    with sqlite3.connect(path) as data:
        rows = data.execute(
            "SELECT f_table_name, f_geometry_column, styleQML, useAsDefault FROM layer_styles"
        ).fetchall()
        geometry = dict(data.execute("SELECT table_name, column_name FROM gpkg_geometry_columns").fetchall())
    assert {row[0] for row in rows} == set(geometry) == {"cameras", "views", "ties"}
    for name, column, style, default in rows:
        assert column == geometry[name] and default == 1
        root = xml.fromstring(style.split("\n", 1)[1])
        assert root.tag == "qgis" and root.find("renderer-v2/symbols/symbol/layer") is not None


def test_a_world_without_crs_is_in_degrees_too(tmp_path):
    made = finished(tmp_path, origin=Origin(35.0, 139.0, 12.0))
    made.project.export(tmp_path / "map", "geojson")
    zero = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    for feature in layer(tmp_path / "map", "cameras"):
        centre = made.model.find_image_with_name(feature["properties"]["name"]).projection_center()
        there = np.array(zero.transform(*feature["geometry"]["coordinates"]))
        assert np.linalg.norm(there - zero.transform(139.0, 35.0, 12.0)) == pytest.approx(
            np.linalg.norm(centre), abs=1e-3
        )


def test_what_a_map_refuses(tmp_path, monkeypatch, made):
    free = finished(tmp_path, origin=None)
    for name in ("geojson", "gpkg"):
        with pytest.raises(InputError, match="not on the Earth"):
            free.project.export(tmp_path / name, name)
    monkeypatch.setitem(__import__("sys").modules, "pyogrio", None)
    with pytest.raises(EngineMissing, match="pip install"):
        made.project.export(tmp_path / "none", "gpkg")
    assert not (tmp_path / "none").exists()
