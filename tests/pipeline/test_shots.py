"""Single shots from folder to clouds: `Project.shots` and what it refuses."""

import json
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

import tiegraph
from said import refused
from tiegraph.api import Project
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.pipeline.shots import shot_views
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene

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


@pytest.mark.slow
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


@pytest.mark.slow
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
