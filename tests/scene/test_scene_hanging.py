"""Which images carry structure from motion, which hang on the rig, and which count as registered in a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from said import refused
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.scene.colmapmodel import image_poses, tracks
from tiegraph.scene.hanging import carries, carrying, with_hanging
from tiegraph.scene.registered import registration
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.tuning import RegisteredTuning


def lens(camera_id: int = 1) -> pycolmap.Camera:
    camera = pycolmap.Camera(
        model="PINHOLE", width=100, height=80, params=[90 + camera_id, 90, 50, 40], camera_id=camera_id
    )
    camera.has_prior_focal_length = True
    return camera


def survey(frames: int = 3, missing: tuple[str, ...] = (), **changes: object) -> Scene:
    """A wide camera and two that hang on it."""
    places = {"wide": np.eye(4), "a": rigid(np.eye(3), np.array([-0.1, 0, 0])), "b": rigid(np.eye(3), np.ones(3))}
    roles = {"wide": "wide", "a": "side", "b": "up"}
    sensors = tuple(Sensor(n, lens(k + 1), p, role=roles[n], folder=n) for k, (n, p) in enumerate(places.items()))
    rows = sorted(
        (f"{s}/{f:02d}.png", f, k) for k, s in enumerate(places) for f in range(frames) if f"{s}{f}" not in missing
    )
    names, frame, sensor = zip(*rows)
    return simple_scene(Rig("head", sensors, **changes), list(names), np.array(frame), np.array(sensor))


def with_sensor(scene: Scene, place: int, **changes: object) -> Scene:
    sensors = list(scene.rigs[0].sensors)
    sensors[place] = replace(sensors[place], **changes)
    return scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(sensors)),))


def test_only_wide_images_carry():
    scene = survey(missing=("wide1",))
    part = carrying(scene)
    assert part.names == ("wide/00.png", "wide/02.png") and part.frames == 2
    assert [s.name for s in part.rigs[0].sensors] == ["wide"]
    assert carries(scene).sum() == 2 and len(scene) == 8
    said = part.notes[-1]
    assert "6 images of a, b hang on the rig" in said and "1 frames lack a wide image" in said
    assert carrying(part) is part
    alike = with_sensor(scene, 0, role="side")
    assert carrying(alike) is alike and carries(alike).all()


@pytest.mark.parametrize(
    "scene, what",
    [
        (with_sensor(survey(), 1, sensor_from_rig=None), "a hangs on the rig, but its place against wide is unknown"),
        (with_sensor(survey(), 2, camera=None), "b hangs on the rig, but its lens is not calibrated"),
        (survey(nominal=True), "but it is nominal: calibrate the rig"),
    ],
)
def test_nothing_hangs_on_a_rig_that_is_not_calibrated(scene, what):
    with refused(what):
        carrying(scene)


def test_a_second_rig_beside_is_refused():
    scene = survey()
    both = scene.with_(rigs=(*scene.rigs, Rig("other", (Sensor("x", lens()),))), rig=np.array([0, 0, 1]))
    with refused("has 2 rigs or cameras of other kinds: run them apart"):
        carrying(both.with_(sensor=np.where(both.frame == 2, 0, both.sensor)))


def model_of(scene: Scene, poses: np.ndarray) -> pycolmap.Reconstruction:
    """Of the images that carry, one frame each, with two points seen by all."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens())
    for k, name in enumerate(scene.names):
        image = pycolmap.Image(name=name, camera_id=1, image_id=k + 1, keypoints=np.full((3, 2), 7.0 + k))
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(poses[k][:3]))
    for row in (0, 2):
        track = pycolmap.Track([pycolmap.TrackElement(k + 1, row) for k in range(len(scene))])
        model.add_point3D(np.array([row, 1.0, 5]), track)
    return model


def test_hanging_images_stand_where_the_rig_places_them(tmp_path):
    scene = survey(missing=("b0",))
    part = carrying(scene)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    poses = np.array([rigid(turn, np.array([k, 2.0, 3.0])) for k in range(3)])
    with_hanging(model_of(part, poses), scene).write(tmp_path)
    found = pycolmap.Reconstruction(tmp_path)
    assert found.num_reg_images() == len(scene) == 8 and found.num_reg_frames() == 3
    placed = image_poses(found, scene)
    for k, name in enumerate(scene.names):
        sensor = scene.sensor_of(k)
        np.testing.assert_allclose(placed[k], sensor.sensor_from_rig @ poses[scene.frame[k]], atol=1e-12, err_msg=name)
    b = found.find_image_with_name("b/01.png")
    assert b.num_points3D == 0 and found.camera(b.camera_id).params[0] == 93
    xyz, image, _ = tracks(found, scene)
    assert len(xyz) == 2 and {scene.names[k] for k in image} == set(part.names)
    np.testing.assert_allclose(invert(placed[scene.image_index["a/01.png"]])[:3, 3], placed_a(poses[1]), atol=1e-12)


def placed_a(pose: np.ndarray) -> np.ndarray:
    return (invert(pose) @ np.array([0.1, 0, 0, 1]))[:3]


def alone(count: int) -> Scene:
    """Photographs of one camera."""
    return simple_scene(Rig("r", (Sensor("c"),)), [f"{k}.jpg" for k in range(count)], np.arange(count), np.zeros(count))


def seen_off(pixels_off: list[np.ndarray]) -> pycolmap.Reconstruction:
    """One image for each array: as many points as it is long, seen so far off where they are."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240], camera_id=1)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for k, off in enumerate(pixels_off):
        xy = np.stack([np.linspace(50, 600, len(off)), np.full(len(off), 200.0)], axis=1)
        local = 5 * np.column_stack([camera.cam_from_img(xy), np.ones(len(off))]) if len(off) else np.zeros((0, 3))
        seen = xy + np.stack([off, 0 * off], axis=1)
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1, keypoints=seen)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
        for row, point in enumerate(local):
            model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, row)]))
    return model


def test_an_image_counts_if_it_sees_points_that_agree() -> None:
    off = [
        np.full(10, 3.9),
        np.full(9, 0.1),  # one too few
        np.zeros(0),  # none at all: a camera of a rig over forest
        np.r_[np.full(9, 0.5), np.full(40, 4.1)],  # a camera moved to its given place: its points lie elsewhere
        np.r_[np.full(300, 0.5), np.full(100, 30.0)],  # more than are looked at one by one
    ]
    found = registration(seen_off(off), alone(6), RegisteredTuning())
    assert found.placed.tolist() == [True] * 5 + [False]
    assert found.registered.tolist() == [True, False, False, False, True, False]
    assert found.by_rig.tolist() == [False, True, True, True, False, False]
    assert found.points[:4].tolist() == [10, 9, 0, 9] and found.points[4] == pytest.approx(300, abs=5)


def test_points_behind_a_camera_do_not_agree() -> None:
    model = seen_off([np.full(30, 0.1)])
    for point in model.points3D.values():
        point.xyz = -point.xyz
    found = registration(model, alone(1), RegisteredTuning())
    assert not found.registered.any() and found.by_rig.all() and found.points[0] == 0


def test_what_counts_as_registered_is_in_reach() -> None:
    model, scene = seen_off([np.full(10, 3.9), np.full(9, 0.1)]), alone(2)
    assert registration(model, scene, RegisteredTuning()).registered.tolist() == [True, False]
    assert registration(model, scene, RegisteredTuning(min_points=9)).registered.tolist() == [True, True]
    strict = registration(model, scene, RegisteredTuning(min_points=9, agree_px=3.0))
    assert strict.registered.tolist() == [False, True] and strict.by_rig.tolist() == [True, False]
