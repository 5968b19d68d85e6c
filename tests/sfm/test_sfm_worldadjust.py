"""The model bent to where images, positions and control points have it together."""

from __future__ import annotations

import numpy as np
import pytest
from sfm_worlds import make_world, true_frames, with_positions

from tiegraph.geometry.align import umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world import georeferencing, worldadjust
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georeferencing import georeference_model
from tiegraph.sfm.world.worldadjust import ConstantParameters

TUNING = Tuning()


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=2, frames=24, noise_px=1.0, points=30)


def test_frames_go_where_they_are_sent(world) -> None:
    truth, scene = world
    step = np.outer(np.sin(np.pi * np.arange(scene.frames) / scene.frames), [0.0, 0.0, 0.4])
    made = worldadjust.bent(truth, scene, (step, np.full_like(step, 0.001)), ConstantParameters(), TUNING)
    gone = np.sum((_centres(made, scene) - _centres(truth, scene)) * step) / np.sum(step**2)
    assert 0.99 < gone < 1.01 and made.num_points3D() > 0.5 * truth.num_points3D()


@pytest.mark.parametrize(("sigma_m", "least", "most"), [(0.002, 0.9, 1.02), (5.0, -0.01, 0.05)])
def test_positions_bend_a_model_by_as_much_as_they_are_better(world, sigma_m, least, most) -> None:
    """The images are as sure of the largest mode of the shape as its sigma says, and are off by two of these."""
    truth, scene = world
    known = georeferencing._shape(truth, scene, ConstantParameters(), TUNING)
    curve = 2 * known.modes[0]
    noise = sigma_m * np.random.default_rng(0).standard_normal(curve.shape)
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3] + curve + noise, sigma_m)
    found, placed = georeference_model(truth, survey, GeorefSettings(antenna="ignored"), TUNING)
    off = umeyama(_centres(placed, scene), _centres(truth, scene))(_centres(placed, scene)) - _centres(truth, scene)
    assert least < np.sum(off * curve) / np.sum(curve**2) < most
    ratio = np.median(found.uncertainty.shape.sigma) / np.median(known.sigma)
    assert (0.05 < ratio < 0.5) if sigma_m < 1 else (0.9 < ratio < 1.01), "the sigma says how much they told"


def test_of_further_models_the_shape_is_computed(world) -> None:
    truth, scene = world
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3], 0.05)
    settings = GeorefSettings(adjust="yes", antenna="ignored")
    known = georeferencing._shape(truth, survey, ConstantParameters(), TUNING)
    by = [georeference_model(truth, survey, settings, TUNING, Measurements(shape=s))[0] for s in (known, None)]
    np.testing.assert_allclose(by[0].uncertainty.shape.sigma, by[1].uncertainty.shape.sigma, rtol=1e-6)
    never = georeference_model(truth, survey, GeorefSettings(adjust="no"), TUNING)[0]
    assert never.uncertainty.shape is None and not never.adjusted


def _centres(model, scene) -> np.ndarray:
    return frame_poses(image_poses(model, scene), scene)[:, :3, 3]
