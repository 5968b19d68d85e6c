"""References are read, matched and brought into the world of the run."""

import json
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pycolmap
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from said import refused, says
from tiegraph.evaluate import reference
from tiegraph.evaluate.reference import ModelPoses, ReferencePoses
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.survey import Products, evaluate_survey
from tiegraph.evaluate.trajectory import evaluate_trajectory
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry import geodesy, transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.cloudchunks import points_of
from tiegraph.scene.colmapmodel import registration
from tiegraph.scene.results import Cloud, Metric, metrics_to_dict
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.tuning import RegisteredTuning

FRAMES = 12
TUNING = Tuning()
GAP_S = TUNING.trajectory.max_gap_s
TURN = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # a camera looking along x, z up


def rig_poses() -> np.ndarray:
    s = 2.0 * np.arange(FRAMES)
    heading = Rotation.from_rotvec(np.outer(0.02 * s, [0, 0, 1])).as_matrix()
    return transforms.rigid(heading @ TURN, np.column_stack([s, np.sin(s / 5), 0 * s + 2]))


def make_scene(times: bool = False) -> Scene:
    beside = transforms.rigid(np.eye(3), [-0.5, 0, 0])
    rig = Rig("pair", (Sensor("cam0", None, np.eye(4)), Sensor("cam1", None, beside)))
    names = [f"up/cam{c}/{f:04d}.jpg" for c in range(2) for f in range(FRAMES)]
    time_s = 100.0 + np.arange(FRAMES) if times else np.full(FRAMES, np.nan)
    frame, sensor = np.tile(np.arange(FRAMES), 2), np.repeat([0, 1], FRAMES)
    return simple_scene(rig, names, frame, sensor, np.zeros(FRAMES), sequences=("up",), time_s=time_s)


def make_model(scene: Scene, missing: int = 0) -> pycolmap.Reconstruction:
    """The scene's images at their true poses, the first ``missing`` frames of cam1 left out; each sees 12 points of its
    own but the last of cam1, which sees 9."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    for k, name in enumerate(scene.names):
        if scene.sensor[k] == 1 and scene.frame[k] < missing:
            continue
        pose = scene.sensor_of(k).sensor_from_rig @ transforms.invert(rig_poses()[scene.frame[k]])
        xy = np.stack([np.linspace(50, 500, 12), np.full(12, 200.0)], axis=1)
        image = pycolmap.Image(name=name, camera_id=1, image_id=k + 1, keypoints=xy)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
        local = 5 * np.column_stack([camera.cam_from_img(xy), np.ones(12)])
        for row, point in enumerate(transforms.apply(transforms.invert(pose), local)):
            if k < len(scene) - 1 or row < 9:
                model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, row)]))
    return model


def write_tum(path: Path, time_s: np.ndarray, poses: np.ndarray) -> Path:
    q = transforms.quaternion_xyzw(poses[:, :3, :3])
    np.savetxt(path, np.column_stack([time_s, poses[:, :3, 3], q]), fmt="%.9f", header="time pose")
    return path


def a_cloud() -> Cloud:
    rng = np.random.default_rng(0)
    xyz = np.column_stack([rng.uniform(0, 30, 20000), np.full(20000, 8.0), rng.uniform(0, 6, 20000)])
    zero = np.zeros(len(xyz), np.float32)
    return Cloud(xyz, np.zeros((len(xyz), 3), np.uint8), np.zeros((len(xyz), 3), np.float32), zero, zero)


@pytest.mark.parametrize("binary", [True, False])
def test_a_colmap_model_is_matched_by_name(tmp_path: Path, binary: bool) -> None:
    scene = make_scene()
    truth = make_model(scene)
    (truth.write_binary if binary else truth.write_text)(tmp_path)
    model = reference.model_poses(make_model(scene, missing=3), scene)
    assert model.placed.sum() == 2 * FRAMES - 3 and np.allclose(model.world_from_rig, rig_poses())
    assert np.linalg.norm(model.world_from_camera[-1, :3, 3] - rig_poses()[-1, :3, 3]) == pytest.approx(0.5)
    match, said = reference.match_poses(reference.read_reference_poses(tmp_path), model, scene, GAP_S)
    assert len(match) == 21 and "21 placed of 24" in said
    assert set(match.parts["pass and camera"]) == {"up cam0", "up cam1"}
    assert np.allclose(match.estimate, match.reference, atol=1e-6)


@pytest.mark.parametrize("times", [True, False])
def test_tum_by_time_or_in_order_with_other_body_axes(tmp_path: Path, times: bool) -> None:
    scene = make_scene(times)
    body = rig_poses() @ transforms.rigid(TURN.T, np.zeros(3))  # the vehicle's axes: x forward, z up
    write_tum(tmp_path / "rig_up.tum", 100.0 + np.arange(FRAMES), body)
    model = reference.model_poses(make_model(scene), scene)
    match, said = reference.match_poses(reference.read_reference_poses(tmp_path), model, scene, GAP_S)
    assert len(match) == FRAMES and ("by time" if times else "in order") in said
    assert np.allclose(match.estimate, match.reference, atol=1e-5)


def test_poses_with_times_are_of_no_pass_at_another_time(tmp_path: Path) -> None:
    """A file that ends half-way, with as many poses as the second pass has frames: those are not its poses."""
    whole, half = make_scene(times=True), FRAMES // 2
    order = {"sequence": np.repeat([0, 1], half), "sequence_index": np.tile(np.arange(half), 2)}
    scene = replace(whole, sequences=("up", "down"), **order)
    path = write_tum(tmp_path / "half.tum", whole.time_s[:half], rig_poses()[:half])
    model = reference.model_poses(make_model(scene), scene)
    match, said = reference.match_poses(reference.read_reference_poses(path), model, scene, GAP_S)
    assert "up by time; down at none of its times" in said and set(match.parts["pass"]) == {"up"}
    assert len(match) == half and np.allclose(match.estimate, match.reference, atol=1e-5)


def test_unusable_references_say_why(tmp_path: Path) -> None:
    scene = make_scene()
    model = reference.model_poses(make_model(scene), scene)
    (tmp_path / "empty").mkdir()
    for name, data in (("cut", b"nonsense"), ("bare", bytes(8))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "images.bin").write_bytes(data)
    for name, words in (
        ("empty", "neither a COLMAP model"),
        ("none", "no such reference"),
        ("cut", "images.bin: the file is cut off"),
        ("bare", "not a readable COLMAP model"),
    ):
        with refused(words):
            reference.read_reference_poses(tmp_path / name)
    for text, words in (
        ("# time\n1 2 3\n", r"bad.tum, line 2: 3 columns; expected"),
        ("# nothing\n", "no rows; give the traj"),
    ):
        (tmp_path / "bad.tum").write_text(text)
        with refused(words):
            reference.read_tum(tmp_path / "bad.tum")
    short = write_tum(tmp_path / "short.tum", np.arange(5.0), rig_poses()[:5])
    other = ReferencePoses({}, {"other": reference.read_tum(short)}, tmp_path)
    for poses, words in (
        (reference.read_reference_poses(short), "5 poses for 12 frames"),
        (other, "only 0 poses"),
    ):
        with refused(words):
            reference.match_poses(poses, model, scene, GAP_S)


def test_local_metres_become_world_metres() -> None:
    world = geodesy.make_origin(35.6965, 139.7695, 37.0)
    local = Origin(35.6965, 139.7695, 37.0)
    points = np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 5]])
    moved = reference.to_world(points, local, world)
    assert 99.9 < np.linalg.norm(moved[1] - moved[0]) < 100.1
    assert np.allclose(reference.to_world(moved, world, local), points, atol=1e-4)


def made(scene: Scene, model: pycolmap.Reconstruction, cloud: Cloud | None = None, **more: object) -> Products:
    images = registration(model, scene, RegisteredTuning())
    return Products(model=model, images=images, cloud=None if cloud is None else points_of(cloud.xyz_m), **more)


def test_a_survey_is_evaluated_whole(tmp_path: Path) -> None:
    scene = make_scene()
    make_model(scene).write_text(tmp_path)
    las = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    las.xyz = a_cloud().xyz_m
    las.write(tmp_path / "lidar.laz")
    given = {"reference": tmp_path, "reference_cloud": tmp_path / "lidar.laz"}
    settings = EvaluateSettings(**given, range_m=100, distances_m=(0.02, 0.1))
    products = made(scene, make_model(scene, missing=3), a_cloud(), scratch=tmp_path)
    data = evaluate_survey(scene, products, settings, TUNING).metrics
    values = {m["name"]: m["value"] for m in data["metrics"]}
    assert values["registered_images"] == pytest.approx(100 * 20 / 24) and values["ate_sim3_rmse"] < 1e-6
    assert 0.001 < values["backprojection_rmse"] < 0.1 and values["fscore_0.02m"] > 99
    assert values["images_by_rig"] == pytest.approx(100 / 24)
    assert says(data["notes"], "round")
    bare = evaluate_survey(scene, made(scene, make_model(scene)), EvaluateSettings(), TUNING).metrics
    assert [m["name"] for m in bare["metrics"]] == ["registered_images", "images_by_rig"]


def test_absolute_error_in_a_common_crs(tmp_path: Path) -> None:
    """A model in UTM beside a reference in local metres: the absolute error is that of the model, not of the frames."""
    place = (35.6965, 139.7695, 37.0)
    world, local, scene = geodesy.make_origin(*place), Origin(*place), make_scene()
    write_tum(tmp_path / "up.tum", np.arange(FRAMES), rig_poses())
    inside = reference.to_world(rig_poses()[:, :3, 3], local, world)
    poses = transforms.rigid(rig_poses()[:, :3, :3], inside + [0.2, 0, 0])
    found = ModelPoses(poses[scene.frame], poses)
    match, _ = reference.match_poses(reference.read_reference_poses(tmp_path), found, scene, GAP_S)
    match = reference.poses_to_world(match, local, world)
    result = evaluate_trajectory(match, (2.0,), TUNING.trajectory, same_frame=True)
    assert result.absolute.rmse_m == pytest.approx(0.2, abs=1e-3)
    settings = EvaluateSettings(reference=tmp_path / "up.tum", reference_origin=place)
    data = evaluate_survey(scene, made(scene, make_model(scene), origin=world), settings, TUNING).metrics
    assert "absolute_rmse" in [m["name"] for m in data["metrics"]]


def test_a_cloud_whose_header_names_no_crs_is_in_that_of_the_run(tmp_path: Path) -> None:
    """Coordinates of the run's own files; beside local metres about an origin, a CRS in the header holds; a geoid."""
    world = geodesy.make_origin(35.6965, 139.7695, 37.0)
    assert world.crs.startswith("EPSG") and any(world.shift_m)
    scene, xyz = make_scene(), a_cloud().xyz_m + np.array(world.shift_m)

    def judged(name: str, xyz: np.ndarray, crs: str | None, **how: object) -> dict:
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.offsets, header.scales = np.floor(xyz.mean(axis=0)), np.full(3, 1e-3)
        if crs is not None:
            header.add_crs(pyproj.CRS(crs))
        las = laspy.LasData(header)
        las.xyz = xyz
        las.write(tmp_path / name)
        settings = EvaluateSettings(reference_cloud=tmp_path / name, range_m=100, distances_m=(0.1,), **how)
        products = made(scene, make_model(scene), a_cloud(), origin=world, scratch=tmp_path)
        return evaluate_survey(scene, products, settings, TUNING).metrics

    for crs, how in ((None, {}), (world.crs, {"reference_origin": (35.0, 139.0, 0.0)})):
        data = judged("reference.las", xyz, crs, **how)
        assert {m["name"]: m["value"] for m in data["metrics"]}["cloud_to_cloud_median"] < 0.002
        assert any("no CRS in its header" in note for note in data["notes"]) == (crs is None)
    with refused("37 m apart: is one above the ellipsoid, the other above a geoid.*shift"):
        judged("geoid.las", xyz - [0, 0, 37], world.crs)


def test_metrics_survive_json() -> None:
    data = metrics_to_dict([Metric("a", float("nan"), "m", "low"), Metric("b", np.float64(2), "m", "low", 1.0)])
    assert data["metrics"][0]["value"] is None and data["metrics"][0]["target"] is None
    back = json.loads(json.dumps(data, allow_nan=False))
    assert back == data and (back["metrics"][1]["value"], back["metrics"][1]["target"]) == (2.0, 1.0)


def test_the_rendered_canal_matches_itself(data_root: Path) -> None:
    folder = data_root / "canal_demo" / "gt"
    if not folder.exists():
        pytest.skip("canal_demo is not there")
    assert len(reference.read_reference_poses(folder / "colmap").by_image) == 120
    time_s, body = reference.read_tum(folder / "rig_up.tum")
    assert len(time_s) == 10 and np.all(np.isfinite(body))
