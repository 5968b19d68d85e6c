"""Registered is what sees points and agrees with them; what only its rig places is counted apart."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from tiegraph.scene.registered import registration
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.scene.tuning import RegisteredTuning


def _model(pixels_off: list[np.ndarray]) -> pycolmap.Reconstruction:
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
    scene = simple_scene(Rig("r", (Sensor("c"),)), [f"{k}.jpg" for k in range(6)], np.arange(6), np.zeros(6))
    found = registration(_model(off), scene, RegisteredTuning())
    assert found.placed.tolist() == [True] * 5 + [False]
    assert found.registered.tolist() == [True, False, False, False, True, False]
    assert found.by_rig.tolist() == [False, True, True, True, False, False]
    assert found.points[:4].tolist() == [10, 9, 0, 9] and found.points[4] == pytest.approx(300, abs=5)


def test_points_behind_a_camera_do_not_agree() -> None:
    model = _model([np.full(30, 0.1)])
    for point in model.points3D.values():
        point.xyz = -point.xyz
    scene = simple_scene(Rig("r", (Sensor("c"),)), ["0.jpg"], np.arange(1), np.zeros(1))
    found = registration(model, scene, RegisteredTuning())
    assert not found.registered.any() and found.by_rig.all() and found.points[0] == 0


def test_what_counts_as_registered_is_in_reach() -> None:
    model = _model([np.full(10, 3.9), np.full(9, 0.1)])
    scene = simple_scene(Rig("r", (Sensor("c"),)), ["0.jpg", "1.jpg"], np.arange(2), np.zeros(2))
    assert registration(model, scene, RegisteredTuning()).registered.tolist() == [True, False]
    assert registration(model, scene, RegisteredTuning(min_points=9)).registered.tolist() == [True, True]
    strict = registration(model, scene, RegisteredTuning(min_points=9, agree_px=3.0))
    assert strict.registered.tolist() == [False, True] and strict.by_rig.tolist() == [True, False]
