"""Profiles and volumes of a finished map, single shots, and two epochs of one place: files that open, errors named."""

import csv
import json
import shutil
import xml.etree.ElementTree as xml
from pathlib import Path

import cv2
import laspy
import numpy as np
import pycolmap
import pyproj
import pytest
from scipy.spatial.transform import Rotation

import terrain_world as world
import tiegraph
from clouds_world import ground
from said import refused
from tiegraph.api import Project
from tiegraph.cli.main import main
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.pipeline.clouds import compare_epochs, compare_passes
from tiegraph.pipeline.dense import depth_path, lasting, plan_of, read_depth
from tiegraph.pipeline.evaluate import evaluate
from tiegraph.pipeline.shots import shot_views
from tiegraph.project.run import Run
from tiegraph.project.settings import merged
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.cloudfile import read_cloud, write_cloud
from tiegraph.scene.results import Cloud
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene

pytestmark = pytest.mark.slow
EAST, NORTH, UP = 388800.0, 3951200.0, 40.0  # of the lower left corner of the map
SHAPE = (100, 120)
BOX = [(5, 4), (15, 4), (15, 14), (5, 14)]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder whose map is a slanted plane, seen in all but a corner."""
    x, y = world.places(SHAPE)
    w = (0.1 * x + 0.2 * y).astype(np.float32)
    w[:20, :20] = np.nan
    sigma = np.where(np.isfinite(w), np.float32(0.02), np.nan)
    folder = tmp_path_factory.mktemp("measure") / "run"
    return world.as_run(folder, dsm=w, sigma=sigma, dtm=w, dtm_sigma=sigma)


def ring(vertices, shift=(EAST, NORTH)):
    return [[a + shift[0], b + shift[1]] for a, b in (*vertices, vertices[0])]


def polygon(path, coordinates, crs="EPSG:32654"):
    """A GeoJSON file of a polygon in a CRS ("" = as RFC 7946 has it)."""
    data = {"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}}]}
    data["features"][0]["geometry"] = {"type": "Polygon", "coordinates": [coordinates]}
    if crs:
        data["crs"] = {"type": "name", "properties": {"name": crs}}
    path.write_text(json.dumps(data))
    return path


def measured(run, tmp_path, *more, file=None):
    file = file or polygon(tmp_path / "heap.geojson", ring(BOX))
    out = tmp_path / "volume.json"
    out.unlink(missing_ok=True)
    assert main(["volume", str(run), "--polygon", str(file), "-o", str(out), *more]) == 0
    return json.loads(out.read_text())["polygons"]


def refusal(capsys, *arguments):
    assert main([str(a) for a in arguments]) == 2
    return capsys.readouterr().err


def test_a_profile_is_exact_on_a_plane(run, tmp_path):
    out = tmp_path / "profile.csv"
    places = [f"{EAST + 2},{NORTH + 1}", f"{EAST + 20.3},{NORTH + 11.7}", f"{EAST + 10},{NORTH + 18}"]
    assert main(["profile", str(run), "--line", *places, "-o", str(out)]) == 0
    rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(out.open())]
    x, y = np.array([(r["east_m"] - EAST, r["north_m"] - NORTH) for r in rows]).T
    w = 0.1 * x + 0.2 * y + UP
    np.testing.assert_allclose([r["dsm_m"] for r in rows], w, atol=2e-4)
    np.testing.assert_allclose([r["dtm_m"] for r in rows], w, atol=2e-4)
    assert {r["dsm_sigma_m"] for r in rows} == {0.02}
    length = np.hypot(18.3, 10.7) + np.hypot(10.3, 6.3)
    assert rows[-1]["distance_m"] == pytest.approx(length, abs=1e-3) and len(rows) >= length / world.PIXEL
    assert np.hypot(x - 20.3, y - 11.7).min() < 1e-3  # a vertex is a row
    svg = out.with_suffix(".svg").read_bytes()
    assert xml.fromstring(svg).tag.endswith("svg") and b"2026" not in svg
    assert main(["profile", str(run), "--line", *places, "-o", str(tmp_path / "again.csv")]) == 0
    assert (tmp_path / "again.svg").read_bytes() == svg


def test_a_profile_is_a_layer_of_points_for_gis(run, tmp_path):
    pyogrio = pytest.importorskip("pyogrio")
    line = ["--line", f"{EAST + 2},{NORTH + 1}", f"{EAST + 20.3},{NORTH + 11.7}"]
    for name in ("profile.csv", "layer.gpkg"):
        assert main(["profile", str(run), *line, "-o", str(tmp_path / name)]) == 0
    rows = list(csv.DictReader((tmp_path / "profile.csv").open()))
    meta, _, shapes, columns = pyogrio.raw.read(tmp_path / "layer.gpkg", layer="profile")
    assert "32654" in meta["crs"] and (tmp_path / "layer.svg").exists() and len(shapes) == len(rows)
    for name, values in zip(meta["fields"], columns):
        np.testing.assert_array_equal(values, [float(row[name]) for row in rows])
    places = np.array([np.frombuffer(s[5:21]) for s in shapes])
    np.testing.assert_allclose(places, [(float(r["east_m"]), float(r["north_m"])) for r in rows], atol=1e-4)


def test_a_profile_says_nothing_where_nothing_was_seen(run, tmp_path):
    line = tmp_path / "line.geojson"
    ends = [[EAST - 1, NORTH + 19], [EAST + 10, NORTH + 19]]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32654"}}
    line.write_text(json.dumps({"type": "LineString", "coordinates": ends, "crs": crs}))
    out = tmp_path / "profile.csv"
    assert main(["profile", str(run), "--line", str(line), "-o", str(out)]) == 0
    known = {float(r["distance_m"]) for r in csv.DictReader(out.open()) if r["dsm_m"]}
    assert min(known) == pytest.approx(1 + 4, abs=0.5)


def test_volumes_over_a_level_are_those_of_the_plane(run, tmp_path, capsys):
    (found,) = measured(run, tmp_path, "--base", "40")
    assert found["area"] == pytest.approx(100) and found["seen"] == 1 and found["unit"] == "m"
    assert found["net"]["value"] == pytest.approx((0.1 * 10 + 0.2 * 9) * 100, rel=1e-3) == found["cut"]["value"]
    text = capsys.readouterr().out
    assert (
        "cut 280.0" in text
        and "m3" in text
        and "base: level at 40.000" in text
        and "accuracy of the survey in the world" in text
    )
    (found,) = measured(run, tmp_path, "--surface", "dtm")
    assert abs(found["net"]["value"]) < 0.01 and "slope 22.4%" in found["base"]
    (found,) = measured(run, tmp_path, "--base", str(run))
    assert abs(found["net"]["value"]) < 0.02 < found["net"]["sigma"]


def test_a_polygon_may_be_in_degrees_a_table_a_geopackage_or_a_drawing(run, tmp_path):
    to_degrees = pyproj.Transformer.from_crs(32654, 4326, always_xy=True)
    degrees = [list(to_degrees.transform(*place)) for place in ring(BOX)]
    files = [polygon(tmp_path / "degrees.geojson", degrees, crs="")]
    table = tmp_path / "table.csv"
    table.write_text("east,north\n" + "".join(f"{a},{b}\n" for a, b in ring(BOX)))
    files.append(table)
    raw = pytest.importorskip("pyogrio.raw")
    two = tmp_path / "two.gpkg"
    meta, _, shapes, _ = raw.read(polygon(tmp_path / "a.geojson", ring(BOX)))
    raw.write(two, np.array([*shapes, *shapes]), [], [], driver="GPKG", geometry_type="Polygon", crs=meta["crs"])
    files.append(two)
    drawing = tmp_path / "drawing.dxf"  # which has no CRS, and closed lines for polygons
    line = {"type": "LineString", "coordinates": ring(BOX)}
    meta, _, shapes, _ = raw.read(json.dumps({"type": "Feature", "properties": {}, "geometry": line}).encode())
    raw.write(drawing, shapes, [], [], driver="DXF", geometry_type="LineString", crs="EPSG:32654")
    files.append(drawing)
    counted = []
    for file in files:
        found = measured(run, tmp_path, "--base", "40", file=file)
        counted.append(len(found))
        assert [f["cut"]["value"] for f in found] == pytest.approx([280] * len(found), rel=1e-3)
    assert counted == [1, 1, 2, 1]


def test_what_cannot_be_measured_is_said_with_its_remedy(run, tmp_path, capsys):
    def volume(vertices, *more, crs="EPSG:32654", shift=(EAST, NORTH)):
        file = polygon(tmp_path / "p.geojson", ring(vertices, shift), crs)
        return refusal(capsys, "volume", run, "--polygon", file, *more)

    assert "crosses itself" in volume([(5, 5), (15, 15), (15, 5), (5, 15)])
    outside = volume([(5, 5), (50, 5), (5, 15)])
    assert "lies outside: the map reaches from 388800.00 to 388824.00 east" in outside
    assert "WGS 84 / UTM zone 10N" in (other := volume(BOX, crs="EPSG:32610")) and "save it in that CRS" in other
    assert "heights are known on" in volume([(0.2, 16.2), (3.8, 16.2), (3.8, 19.8), (0.2, 19.8)], "--base", "40")
    assert "no ground was seen" in volume([(0.2, 17.9), (1.8, 17.9), (1.8, 19.8), (0.2, 19.8)])
    assert "give plane, lowest, a height" in volume(BOX, "--base", "plan")
    (tmp_path / "empty.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    assert "has no polygon" in refusal(capsys, "volume", run, "--polygon", tmp_path / "empty.geojson")
    assert "is no file" in refusal(capsys, "volume", run, "--polygon", tmp_path / "none.gpkg")
    out = ("-o", tmp_path / "p.csv")
    assert "lies outside" in refusal(capsys, "profile", run, "--line", "-3,4", "-5,6", *out)
    assert "give two places" in refusal(capsys, "profile", run, "--line", "3,4", *out)
    assert not (tmp_path / "p.csv").exists()


def test_a_run_without_a_map_says_how_to_make_one(tmp_path, capsys):
    folder = world.as_run(tmp_path / "run")
    (folder / "products" / "map" / "dsm.tif").unlink()
    file = polygon(tmp_path / "p.geojson", ring(BOX))
    for arguments in (("profile", folder, "--line", "0,0", "1,1"), ("volume", folder, "--polygon", file)):
        assert "--products.make map" in refusal(capsys, *arguments)


def test_lengths_without_scale_are_in_units(tmp_path, capsys):
    folder = world.as_run(tmp_path / "run", origin=None, scale="none")
    table = tmp_path / "p.csv"
    table.write_text("\n".join(f"{a + 100},{b + 200}" for a, b in [(20, 20), (29, 20), (29, 26)]))
    assert main(["volume", str(folder), "--polygon", str(table), "--base", "-5"]) == 0
    assert "units3" in capsys.readouterr().out
    out = tmp_path / "profile.csv"
    assert main(["profile", str(folder), "--line", "110,210", "120,210", "-o", str(out)]) == 0
    assert out.read_text().startswith("distance_units,") and csv.DictReader(out.open()).__next__()["dtm_units"] == ""


SIZE, FOCAL = (240, 180), 220.0
PLACES = {"a": (0.0, 0, 0), "b": (0.075, 0, 0), "c": (0, 0.075, 0)}


def plane(folder: Path, shots: int) -> None:
    """A textured plane 0.7 m before three cameras."""
    rng = np.random.default_rng(2)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (700, 700)).astype(np.float32), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    for name, place in PLACES.items():
        (folder / name).mkdir(parents=True)
        for k in range(shots):
            x = place[0] + 0.1 * k + (u - SIZE[0] / 2) / FOCAL * 0.7
            y = place[1] + (v - SIZE[1] / 2) / FOCAL * 0.7
            at = [((w + 0.6) / 0.002).astype(np.float32) for w in (x, y)]
            image = cv2.remap(texture, at[0], at[1], cv2.INTER_CUBIC) + rng.normal(0, 1.5, x.shape)
            cv2.imwrite(str(folder / name / f"{k:03d}.png"), np.clip(image, 0, 255).astype(np.uint8))


def opened(folder: Path, shots: int, calibrated: bool = True, wide: str = "") -> Project:
    """A survey of the plane with a fixed rig."""
    plane(folder / "images", shots)
    params = [FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2]
    camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=params)
    camera.has_prior_focal_length = True
    lens, role = camera if calibrated else None, {wide: "wide"}
    poses = {n: rigid(np.eye(3), -np.array(p)) for n, p in PLACES.items()}
    sensors = tuple(Sensor(n, lens, p, role=role.get(n, "side"), folder=n) for n, p in poses.items())
    write_rig_toml(Rig("head", sensors, fixed=True), folder / "rig.toml")
    return tiegraph.open(folder / "images", folder / "out", rig=folder / "rig.toml", pool="serial")


def test_each_shot_becomes_a_metric_cloud(tmp_path):
    project = opened(tmp_path, 2)
    files = project.shots(0.5, 1.2)
    assert len(files) == 2 and all(f.exists() for f in files)
    cloud = read_cloud(files[0])
    assert len(cloud) > 5000
    assert abs(np.median(cloud.xyz_m[:, 2]) - 0.7) < 0.003
    assert np.median(np.abs(cloud.xyz_m[:, 2] - 0.7)) < 0.01
    assert (cloud.sigma_m > 0).all() and cloud.views.min() >= 2
    before = files[0].stat().st_mtime_ns
    assert project.shots(0.5, 1.2) == files and files[0].stat().st_mtime_ns == before  # finished shots stay
    far = read_cloud(project.shots(0.9, 1.2)[0])  # another question has another answer
    assert np.median(far.xyz_m[:, 2]) > 0.85


def test_a_rig_without_calibration_is_refused(tmp_path):
    with refused("intrinsics are unknown"):
        opened(tmp_path / "side", 1, calibrated=False).shots(0.5, 1.2)
    with refused("a depends on the rig, but its lens is not calibrated"):
        opened(tmp_path / "wide", 1, calibrated=False, wide="b").run("scan")
    assert not (tmp_path / "wide" / "out" / "scene.json").exists()


def test_a_workspace_needs_depth_maps_and_an_empty_folder(tmp_path):
    project = opened(tmp_path, 1)
    with refused("dense"):
        project.export(tmp_path / "workspace")
    (tmp_path / "out" / "depth").mkdir(parents=True)
    with refused("not empty"):
        project.export(tmp_path / "images")


def world_of(out: Path, shots: int, turn: np.ndarray, metric: bool = True) -> None:
    """What georef leaves: the shots ``turn``-ed and moved by 0.1 m each, without a CRS."""
    scene = Scene.from_json((out / "scene.json").read_text())
    model = pycolmap.Reconstruction()
    params = [FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2]
    for camera_id in range(1, 1 + len(PLACES)):
        camera = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=params, camera_id=camera_id)
        model.add_camera_with_trivial_rig(camera)
    for k, name in enumerate(scene.names):
        frame = int(scene.frame[k])
        if frame >= shots:
            continue
        world_from_rig = rigid(turn, np.array([0.1 * frame, 2.0, 3.0]))
        pose = np.asarray(scene.sensor_of(k).sensor_from_rig) @ invert(world_from_rig)
        image = pycolmap.Image(name=name, camera_id=1 + int(scene.sensor[k]), image_id=k + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    (out / "sparse/world").mkdir(parents=True, exist_ok=True)
    model.write(str(out / "sparse/world"))
    world = {"scale_source": "rig baseline" if metric else "none", "origin": None}
    (out / "world.json").write_text(json.dumps(world))


def test_shots_with_a_pose_become_laz_in_the_world(tmp_path):
    project = opened(tmp_path, 2)
    own = read_cloud(project.shots(0.5, 1.2)[0])
    with refused("no poses in the world yet"):
        project.posed_shots(tmp_path / "posed")
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    world_of(tmp_path / "out", 2, turn, metric=False)
    with refused("has no scale, but shots are in metres"):
        project.posed_shots(tmp_path / "posed")
    world_of(tmp_path / "out", 1, turn)
    (file,) = project.posed_shots(tmp_path / "posed")
    cloud = read_cloud(file)
    assert len(cloud) == len(own) and file.suffix == ".laz"
    off = cloud.xyz_m - (own.xyz_m @ turn.T + (0, 2, 3))
    assert 0 < np.abs(off).max() < 1e-3
    np.testing.assert_allclose(cloud.normal, own.normal @ turn.T, atol=1e-5)
    np.testing.assert_allclose(cloud.sigma_m, own.sigma_m)
    np.testing.assert_array_equal(cloud.views, own.views)
    with refused("give a new folder"):
        project.posed_shots(tmp_path / "posed")


def test_only_a_wide_camera_is_in_the_scene_and_only_the_others_in_a_shot(tmp_path):
    project = opened(tmp_path, 2, wide="b").run("scan")
    assert project.scene().names == ("b/000.png", "b/001.png")
    every = Scene.from_json((tmp_path / "out" / "whole.json").read_text())
    assert len(every) == 6 and [s.name for s in every.rigs[0].sensors] == ["b", "a", "c"]
    assert all((tmp_path / "out" / "images" / name).exists() for name in every.names)
    np.testing.assert_array_equal(every.rigs[0].sensors[0].sensor_from_rig, np.eye(4))
    views = shot_views(every, 1)
    assert [v.name for v in views] == ["a/001.png", "c/001.png"]
    np.testing.assert_allclose([invert(v.cam_from_world)[:3, 3] for v in views], [(-0.075, 0, 0), (-0.075, 0.075, 0)])
    assert project.receipt("scan")["counts"]["hanging"] == 4


ORIGIN = Origin(lat_deg=35.7, lon_deg=139.7, height_m=37.0, crs="EPSG:32654", shift_m=(382300.0, 3951500.0, 30.0))


def survey(folder: Path, xyz: np.ndarray, shift=(0.0, 0, 0), placed_m: float | None = 0.004, crs="EPSG:32654") -> Path:
    """A run folder of a cloud; its world has its own shift and a placement good to ``placed_m``."""
    at = tuple(a + b for a, b in zip(ORIGIN.shift_m, shift))
    origin = Origin(**{**ORIGIN.__dict__, "shift_m": at, "crs": crs})
    world = {"scale_source": "positions", "origin": None, "placement_error": None}
    if placed_m is not None:
        covariance = np.diag([0, 0, 0, placed_m**2, placed_m**2, placed_m**2, 0.0])
        error = {"middle": [0, 0, 0], "covariance": covariance.tolist()}
        world |= {"origin": origin.to_dict(), "placement_error": error}
    model = pycolmap.synthesize_dataset(pycolmap.SyntheticDatasetOptions())
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), np.array([0, 0, 30.0])))
    (folder / "sparse" / "world").mkdir(parents=True)
    model.write(folder / "sparse" / "world")
    (folder / "world.json").write_text(json.dumps(world))
    cloud = Cloud(
        xyz_m=xyz - shift,
        rgb=np.zeros((len(xyz), 3), np.uint8),
        normal=np.zeros((len(xyz), 3), np.float32),
        sigma_m=np.full(len(xyz), 0.003, np.float32),
        views=np.zeros(len(xyz), np.uint8),
        origin=None if placed_m is None else origin,
    )
    write_cloud(cloud, folder / "cloud.laz", 0.01)
    return folder


def test_a_box_that_grew_by_5_cm(tmp_path: Path, capsys) -> None:
    first = survey(tmp_path / "a", ground(30_000, 0))
    second = survey(tmp_path / "b", ground(30_000, 1, box_m=0.05), shift=(100.0, -200, 10))
    assert main(["compare", "--epochs", str(first), str(second), "-o", str(tmp_path / "out")]) == 0
    assert "changes" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "changes.json").read_text())
    (row,) = list(csv.reader((tmp_path / "out" / "changes.csv").open()))[1:]
    assert float(row[1]) == pytest.approx(382300, abs=0.5) and float(row[2]) == pytest.approx(3951500, abs=0.5)
    assert float(row[6]) == pytest.approx(0.05, abs=0.01) and 12 < float(row[5]) < 20
    assert result["areas_and_volumes"]["gain_m3"] == pytest.approx(0.8, abs=0.25)
    # of 400 m2 16 changed; both placements (4 mm) and points (3 mm) are in the level of detection
    lod = result["differences"]["level of detection m"]
    assert 1.96 * np.sqrt(2 * 0.004**2 + 2 * 0.003**2) < lod < 0.02
    las = laspy.read(tmp_path / "out" / "changes.laz")
    assert set(las.point_format.extra_dimension_names) == {"distance_m", "lod_m", "significant"}
    away = np.abs(np.asarray(las.xyz)[:, :2] - [382300, 3951500]).max(axis=1)
    assert np.nanmean(np.asarray(las["significant"])[away > 3.5]) < 0.08
    assert np.nanmean(np.asarray(las["significant"])[away < 1.3]) > 0.9
    assert las.header.parse_crs().to_epsg() == 32654
    assert (tmp_path / "out" / "changes.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        f"changes.{e}" for e in ("csv", "json", "laz", "png")
    ]
    with refused("exists already"):
        compare_epochs((first, second), tmp_path / "out")


def test_a_shift_of_the_whole_survey_is_within_its_sigma_or_registered(tmp_path: Path) -> None:
    flat, bumpy = ground(20_000, 0), ground(20_000, 1)
    for cloud in (flat, bumpy):
        cloud[:, 2] += np.sin(cloud[:, 0]) + np.cos(cloud[:, 1])  # else it slides
    first = survey(tmp_path / "a", flat, placed_m=0.05)
    second = survey(tmp_path / "b", bumpy + [0, 0, 0.06], placed_m=0.05)
    found = compare_epochs((first, second), tmp_path / "placed")
    assert found["changes"]["rows"] == [] and found["differences"]["median m"] == pytest.approx(0.05, abs=0.02)
    loose = [survey(tmp_path / n, xyz, placed_m=None) for n, xyz in (("c", flat), ("d", bumpy + [0, 0, 0.06]))]
    with refused("c: its place on the Earth is not known.*--register rigid"):
        compare_epochs((loose[0], loose[1]), tmp_path / "loose")
    found = compare_epochs((loose[0], loose[1]), tmp_path / "registered", register="rigid")
    rows = {name: (value, sigma) for name, value, sigma in found["registration"]["rows"]}
    value, sigma = rows["shift in z at the middle, m"]
    assert value == pytest.approx(-0.06, abs=0.005) and 0 < sigma < 0.005
    assert abs(found["differences"]["median m"]) < 0.005 and found["changes"]["rows"] == []


def test_a_survey_in_another_frame_is_laid_on_the_first_by_its_shape(tmp_path: Path) -> None:
    hills = np.random.default_rng(3).uniform(-9, 9, (25, 2))
    clouds = [ground(20_000, seed) for seed in (0, 1)]
    for cloud in clouds:
        away = np.linalg.norm(cloud[:, None, :2] - hills, axis=2)
        cloud[:, 2] += np.sum(1.5 * np.exp(-(away**2) / 2), axis=1)
    turn = Rotation.from_euler("zyx", [70, 20, 10], degrees=True).as_matrix()
    first = survey(tmp_path / "a", clouds[0], placed_m=None)
    second = survey(tmp_path / "b", clouds[1] @ turn.T + [300.0, -80, 12], placed_m=None)
    with refused("--coarse starts a registration: add --register rigid"):
        compare_epochs((first, second), tmp_path / "out", coarse=True)
    with refused("do not overlap"):
        compare_epochs((first, second), tmp_path / "out", register="rigid")
    found = compare_epochs((first, second), tmp_path / "out", register="rigid", coarse=True)
    assert abs(found["differences"]["median m"]) < 0.005 and 0 < found["differences"]["significant %"] < 12
    rows = {row[0]: row[1] for row in found["registration"]["rows"]}
    assert rows["coarse start: points near the reference, %"] > 80 and "start by their shapes" in found["notes"][0]


def test_what_cannot_be_compared_is_said_and_nothing_written(tmp_path: Path) -> None:
    first = survey(tmp_path / "a", ground(500, 0))
    (tmp_path / "none").mkdir()
    with refused("none: it has no cloud.laz: run it to the stage cloud"):
        compare_epochs((first, tmp_path / "none"), tmp_path / "out")
    elsewhere = survey(tmp_path / "b", ground(500, 0), shift=(5000.0, 0, 0))
    moved = survey(tmp_path / "c", ground(500, 0) + [5000.0, 0, 0])
    with refused(r"c/cloud.laz \(EPSG:32654 by its header\): the cloud .* do not meet"):
        compare_epochs((first, moved), tmp_path / "out")
    with refused("a depth of -1 m does not fit: give .* to .* m"):
        compare_epochs((first, elsewhere), tmp_path / "out", depth_m=-1.0)
    assert not (tmp_path / "out").exists()
    found = compare_epochs((first, elsewhere), tmp_path / "out", depth_m=9.5)
    assert found["cylinders"]["depth_m"] == 9.5
    (first / "tiegraph.toml").write_text(f'[run]\nimages = "{tmp_path}"\n[tuning.evaluate.m3c2]\nleast_points = 1000\n')
    other = compare_epochs((first, elsewhere), tmp_path / "tuned", depth_m=9.5)
    assert found["differences"]["compared %"] > 50 and other["differences"]["compared %"] == 0


def test_passes_of_one_run_and_its_evaluation_by_a_cloud(finished, tmp_path: Path, capsys) -> None:
    folder = finished.after("cloud", tmp_path / "run")
    assert main(["compare", "--passes", str(folder), "-o", str(tmp_path / "passes")]) == 0
    assert "common errors of both do not show" in capsys.readouterr().out
    found = json.loads((tmp_path / "passes" / "changes.json").read_text())
    assert abs(found["differences"]["median m"]) < 0.05 and found["differences"]["core points"] > 100
    shutil.copyfile(folder / "cloud.laz", tmp_path / "reference.laz")
    asked = {"reference_cloud": tmp_path / "reference.laz", "alignment": "none"}
    evaluate(Run(folder, None, merged({"evaluate": asked})))  # type: ignore[arg-type]
    figures = {m["name"]: m["value"] for m in json.loads((folder / "metrics.json").read_text())["metrics"]}
    assert abs(figures["m3c2_median"]) < 1e-6 and figures["ghosts"] == 0
    made = sorted(p.name for p in (folder / "evaluate").iterdir() if p.is_file())  # scratch goes with the whole stage
    assert made == ["distances.laz", "m3c2.laz", "m3c2.png"]
    tables = json.loads((folder / "metrics.json").read_text())["tables"]
    assert "cloud against reference, M3C2" in tables and "cloud against reference" in tables
    # the stage cloud has compared the passes for the report, at fewer core points
    agreement = json.loads((folder / "passes" / "agreement.json").read_text())
    assert tables["one pass against the other, M3C2"]["rows"][0][0] == "all"
    assert figures["passes_median"] == pytest.approx(agreement["found"]["all"]["median m"])
    assert figures["passes_median"] == pytest.approx(found["differences"]["median m"], abs=0.005)
    layers = json.loads((folder / "metrics.json").read_text())["accuracy"]["figures"]
    assert sum(f["key"] == "shape.passes" and f["measured"] > 0 and not f["independent"] for f in layers) == 1


def test_what_stood_in_one_pass_only_is_not_in_the_cloud(finished, tmp_path: Path) -> None:
    """A board before the wall, in the depth map of one image; the map itself keeps it."""
    folder = finished.after("dense", tmp_path / "run")
    run = Run(folder, None, merged({}))  # type: ignore[arg-type]
    name = next(n for n, plan in sorted(plan_of(run).images.items()) if len(plan.elsewhen) >= 2)
    before = _standing(run, name)
    path = depth_path(folder, name)
    with np.load(path) as columns:
        changed = dict(columns)
    known = np.isfinite(changed["depth_m"])
    changed["depth_m"] = np.where(known, 0.88 * changed["depth_m"], np.nan).astype(np.float32)
    np.savez_compressed(path, **changed)
    assert before > 0.97 * known.sum() and _standing(run, name) < 0.5 * before
    assert np.isfinite(read_depth(name, folder).depth_m).sum() == known.sum()


def _standing(run: Run, name: str) -> int:
    settings, plans = run.settings, plan_of(run).images
    kept = lasting(name, folder=run.folder, plans=plans, settings=settings.dense, tuning=settings.tuning.dense)
    return int(np.isfinite(kept.depth_m).sum())


def test_the_poses_of_a_run_without_a_cloud_are_compared(finished, tmp_path: Path, capsys) -> None:
    folder = finished.after("georef", tmp_path / "run")
    there = sorted(folder.iterdir())
    shutil.copytree(folder / "sparse" / "world", tmp_path / "poses")
    assert main(["evaluate", str(folder), str(tmp_path / "poses")]) == 0
    said = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines() if line.startswith("ate_"))
    assert float(said["ate_se3_rmse"]) < 1e-6
    assert sorted(folder.iterdir()) == there
    shutil.rmtree(folder / "sparse" / "world")
    assert main(["evaluate", str(folder), str(tmp_path / "poses")]) == 2
    assert "run `tiegraph georef" in capsys.readouterr().err


def test_one_pass_has_nothing_to_compare_with(finished, tmp_path: Path) -> None:
    folder = finished.after("cloud", tmp_path / "run")
    shutil.rmtree(folder / "depth")
    with refused("depth maps of 0 passes, but two are needed: run it to the stage dense"):
        compare_passes(Run(folder, None, merged({})), tmp_path / "out")  # type: ignore[arg-type]
