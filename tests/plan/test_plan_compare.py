"""Planned against reached compares like with like."""

import numpy as np
import pycolmap
import pytest

from tiegraph.plan.tables import comparison
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.sfm.covariance import PointSigma, PositionSigma, SharedErrors
from tiegraph.sfm.shape import Shape

PLAN = {"stations": [{}], "path": {"position_shape_sigma_median_m": 0.002, "place_world_sigma_median_m": 0.03}}


def test_it_is_said_in_a_sentence():
    run = {"position_shape_sigma_median_m": 0.003, "place_world_sigma_median_m": 0.04, "ate_m": 0.01}
    table = comparison(PLAN, run)
    assert "known to 3 mm where 2 mm were planned" in table.sentence
    assert any("ATE" in row[0] for row in table.rows)
    table = comparison(PLAN, {**run, "relaxed": 1.0})
    assert "each camera by itself" in table.sentence
    assert not any("ATE" in row[0] for row in table.rows)


def test_a_camera_that_is_off_as_a_whole_keeps_its_path():
    """Two cameras of six frames each; the second one's place is unknown to 1, the noise of each position is 0.01."""
    model = pycolmap.Reconstruction()
    rng = np.random.default_rng(1)
    for camera in (1, 2):
        made = pycolmap.Camera(model="PINHOLE", width=100, height=100, params=[100, 100, 50, 50], camera_id=camera)
        model.add_camera_with_trivial_rig(made)
        for k in range(6):
            image = pycolmap.Image(name=f"{camera}/{k}", camera_id=camera, image_id=10 * camera + k)
            pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), -np.array([k, *rng.normal(0, 1, 2)]))
            model.add_image_with_trivial_frame(image, pose)
    ids = tuple(sorted(model.reg_frame_ids()))
    second = np.repeat([model.image(f).camera_id == 2 for f in ids], 3)
    covariance = 1e-4 * np.eye(36) + np.outer(second, second) * np.kron(np.ones((12, 12)), np.eye(3))
    none = PointSigma((), np.zeros((0, 3)))
    sigma = PositionSigma(ids, np.ones((12, 3)), 1.0, none, SharedErrors(1.0, ()), covariance=covariance)
    names = sorted(model.image(f).name for f in ids)
    sensors = tuple(Sensor(str(c), model.camera(c), np.eye(4), folder=str(c)) for c in (1, 2))
    scene = simple_scene(Rig("pair", sensors), names, np.tile(np.arange(6), 2), np.repeat([0, 1], 6), np.zeros(6))
    shape = Shape.of(model, sigma, scene)
    assert shape.sizes()["p90"] > 1
    path = shape.of_path()
    assert path.index.tolist() == list(range(6))
    assert path.of_path() is None
    assert path.sizes()["median"] == pytest.approx(0.01 * np.sqrt(3 * (18 - 7) / 18), rel=0.15)
