"""Aspect and decentring of lenses, which the mappers' cameras do not have, in the final adjustment."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from sfm_worlds import make_world

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import matrix, read_model
from tiegraph.sfm.adjustment import lens
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.tuning import Tuning

import pycolmap  # isort: skip

TRUE = (1.002, 4e-4, -5e-4)  # fx / fy, p1, p2


def _camera(of: pycolmap.Camera, aspect: float, p1: float, p2: float) -> tuple[pycolmap.Camera, pycolmap.Camera]:
    """A true camera OPENCV in place of another, and what a mapper with RADIAL takes it for."""
    focal, x, y = of.mean_focal_length(), of.principal_point_x, of.principal_point_y
    made = []
    for model, params in (
        ("OPENCV", [focal * aspect**0.5, focal / aspect**0.5, x, y, -0.03, 0.004, p1, p2]),
        ("RADIAL", [focal, x, y, -0.03, 0.004]),
    ):
        camera = pycolmap.Camera(model=model, width=of.width, height=of.height, params=params)
        camera.camera_id = of.camera_id
        made.append(camera)
    return made[0], made[1]


def _put(model: pycolmap.Reconstruction, key: int, camera: pycolmap.Camera) -> None:
    own = model.camera(key)
    own.model = camera.model
    own.params = camera.params


def _world(folder: Path, frames: int = 12) -> tuple[pycolmap.Reconstruction, pycolmap.Reconstruction]:
    """Truth with lenses of aspect and decentring, and the start a mapper with RADIAL gives."""
    truth, _ = make_world(folder / "database.db", cameras=2, frames=frames, noise_px=0.0, points=500)
    rng = np.random.default_rng(0)
    both = {k: _camera(copy.copy(c), *TRUE) for k, c in truth.cameras.items()}
    for key, (true, _) in both.items():
        _put(truth, key, true)
    for image_id in truth.reg_image_ids():
        image = truth.image(image_id)
        for point in image.points2D:
            if point.has_point3D():
                exact = image.project_point(truth.point3D(point.point3D_id).xyz)
                point.xy = exact + 0.1 * rng.standard_normal(2)
    start = pycolmap.Reconstruction(truth)
    for key, (_, radial) in both.items():
        _put(start, key, radial)
    return truth, start


def _turned_deg(a: pycolmap.Reconstruction, b: pycolmap.Reconstruction) -> float:
    """Largest difference between the rotations of the rigs' cameras."""
    pairs = [
        (p, dict(b.rig(k).non_ref_sensors.items())[s]) for k, r in a.rigs.items() for s, p in r.non_ref_sensors.items()
    ]
    return max(float(transforms.angle_deg(matrix(p)[:3, :3], matrix(q)[:3, :3])) for p, q in pairs)


def test_an_extended_camera_projects_as_before(tmp_path) -> None:
    _, start = _world(tmp_path, frames=4)
    wide = lens.extended(start, [1])
    assert wide.camera(1).model.name == "OPENCV" and wide.camera(2).model.name == "RADIAL"
    assert start.camera(1).model.name == "RADIAL"
    rays = np.array([[0.3, -0.2, 1.0], [-0.5, 0.4, 1.0]])
    assert wide.camera(1).img_from_cam(rays) == pytest.approx(start.camera(1).img_from_cam(rays))


@pytest.mark.parametrize("model", ["RADIAL", "SIMPLE_RADIAL"])
def test_free_radial_cameras_get_all_terms(tmp_path, model: str) -> None:
    """With one radial term the second is taken up by the focal length."""
    truth, start = _world(tmp_path)
    for key, camera in start.cameras.items() if model == "SIMPLE_RADIAL" else ():
        _put(
            start, key, pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=camera.params[:4])
        )
    found = final_adjustment(start, tuning=Tuning().adjust).model
    for key in truth.cameras:
        assert found.camera(key).model.name == "OPENCV"
        assert found.camera(key).mean_focal_length() == pytest.approx(truth.camera(key).mean_focal_length(), rel=0.005)
    held = final_adjustment(start, (), [1], tuning=Tuning().adjust).model
    assert held.camera(1).model.name == model and held.camera(2).model.name == "OPENCV"


def test_a_model_takes_another_s_cameras_with_their_models(tmp_path) -> None:
    """Parameters alone made a file that no one can read, after an hour of 4020 images."""
    _, start = _world(tmp_path, frames=4)
    wide = lens.extended(start, [1])
    lens.take_cameras(start, wide)
    (tmp_path / "model").mkdir()
    start.write(tmp_path / "model")
    read = read_model(tmp_path / "model")
    assert read.camera(1).model.name == "OPENCV" and read.camera(2).model.name == "RADIAL"
    assert np.array_equal(read.camera(1).params, wide.camera(1).params)


@pytest.mark.slow
def test_the_final_adjustment_finds_aspect_and_decentring_and_the_rig_gains(tmp_path, monkeypatch) -> None:
    truth, start = _world(tmp_path)
    found = final_adjustment(start, tuning=Tuning().adjust).model
    camera = found.camera(2)
    assert camera.model.name == "OPENCV"
    assert camera.focal_length_x / camera.focal_length_y == pytest.approx(TRUE[0], abs=5e-4)
    assert camera.params[6:] == pytest.approx(TRUE[1:], abs=2.5e-4)
    monkeypatch.setattr(lens, "extensible", lambda *_: [])
    radial = final_adjustment(start, tuning=Tuning().adjust).model
    assert radial.camera(2).model.name == "RADIAL"
    assert _turned_deg(found, truth) < 0.5 * _turned_deg(radial, truth)


def test_priors_are_those_of_a_lens() -> None:
    tuning = Tuning().adjust.lens
    expected = lens.covariance(500.0, tuning)
    ratio = np.array([1, -1, 0, 0, 0, 0, 0, 0]) / 500
    assert np.sqrt(ratio @ expected @ ratio) == pytest.approx(tuning.aspect)
    assert np.sqrt(expected[7, 7]) == tuning.decentring
    assert np.linalg.eigvalsh(expected).min() > 0


@pytest.mark.slow
def test_cameras_of_other_models_and_believed_ones_stay(tmp_path) -> None:
    _, start = _world(tmp_path)
    kept = final_adjustment(start, constant_cameras=[1], tuning=Tuning().adjust).model
    assert kept.camera(1).model.name == "RADIAL"
    assert lens.extensible(start, [1, 2], ("PINHOLE",)) == []
