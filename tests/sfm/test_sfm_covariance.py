"""Predicted position sigmas against errors that really happen, and the final adjustment."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from moving_world import moving_world
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, true_frames

from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.adjustment.adjust import _solve, final_adjustment
from tiegraph.sfm.covariance import MOUNTING, position_sigma
from tiegraph.sfm.finish import _open_places
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.tuning import Tuning

import pycolmap  # isort: skip

TUNING = Tuning()


def _noisy(truth: pycolmap.Reconstruction, sigma_px: float, seed: int) -> pycolmap.Reconstruction:
    """The true model with other noise in its key points, adjusted again (poses and points)."""
    model = pycolmap.Reconstruction(truth)
    rng = np.random.default_rng(seed)
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        for k in range(image.num_points2D()):
            point = image.points2D[k]
            if point.has_point3D():
                true = image.project_point(model.point3D(point.point3D_id).xyz)
                point.xy = true + sigma_px * rng.standard_normal(2)
    return robust(model, intrinsics=False, rig=False)


def robust(model: pycolmap.Reconstruction, intrinsics: bool = True, rig: bool = True) -> pycolmap.Reconstruction:
    """The model adjusted as the final adjustment does it last."""
    fixed, free = () if rig else list(model.rigs), set(model.cameras) if intrinsics else set()
    _solve(model, fixed, free, True, None, TUNING.adjust)
    return model


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=2, frames=6, noise_px=0.0)


def test_a_sigma_covers_another_place_of_a_frame(world) -> None:
    told = position_sigma(_noisy(world[0], 0.5, 0), free_intrinsics=False, free_rig=False, tuning=TUNING)
    wide = told.covering({told.frame_ids[2]: np.array([0.0, 3.0, -4.0])})
    assert np.allclose(wide.sigma[2] ** 2, told.sigma[2] ** 2 + [0, 9, 16]) and wide.sigma[2, 0] == told.sigma[2, 0]
    assert np.array_equal(np.delete(wide.sigma, 2, 0), np.delete(told.sigma, 2, 0))
    assert np.allclose((wide.covariance - told.covariance)[6:9, 6:9], [[0, 0, 0], [0, 9, -12], [0, -12, 16]])
    assert wide.p90 > told.p90


@pytest.mark.slow
def test_predicted_sigma_is_the_scatter_of_many_adjustments(world) -> None:
    truth, scene = world
    true = true_frames(truth, scene)[:, :3, 3]
    squares, pairs = [], []
    predicted = None
    for seed in range(12):
        model = _noisy(truth, 0.5, seed)
        predicted = position_sigma(model, free_intrinsics=False, free_rig=False, tuning=TUNING)
        found = frame_poses(image_poses(model, scene), scene)[:, :3, 3]
        squares.append(np.sum((umeyama(found, true)(found) - true) ** 2, axis=1))
        aligned = umeyama(found, true)(found) - true
        pairs.append(aligned[1:] - aligned[:-1])
    actual = np.sqrt(np.mean(squares))
    expected = np.sqrt(np.mean(np.sum(predicted.sigma**2, axis=1)))
    shape = Shape.of(model, predicted, scene)
    np.testing.assert_allclose(shape.sigma, np.linalg.norm(predicted.sigma, axis=1), rtol=1e-6)
    near = float(np.median(np.linalg.norm(true[1:] - true[:-1], axis=1)))
    at = min(shape.between(3), key=lambda row: abs(np.log(row[0] / near)))
    assert at[1] == pytest.approx(np.sqrt(np.mean(np.sum(np.concatenate(pairs) ** 2, axis=1))), rel=0.4)
    assert shape.between(1000) == []
    assert 0.4 < predicted.pixel_sigma < 0.6
    assert expected == pytest.approx(actual, rel=0.25)


def test_a_shape_is_told_as_far_as_its_frames_followed() -> None:
    """What positions ask of the modes and the adjustment did not do is an error that stays."""
    rng = np.random.default_rng(0)
    modes, count = rng.standard_normal((3, 8, 3)), np.arange(8)
    place, rest = rng.standard_normal((8, 3)), np.full((8, 3), 1e-4)
    shape = Shape(index=count, place=place, modes=modes, rest=rest)
    best, known = np.array([1.5, -0.5, 0.2]), 0.01 * np.eye(3)
    step = np.einsum("m,mni->ni", best, modes)
    np.testing.assert_allclose(shape.coefficients(step), best, atol=1e-9)
    np.testing.assert_allclose(shape.step(count, best)[0], step, atol=1e-9)
    quarter = Similarity(2.0, Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.zeros(3))
    np.testing.assert_allclose(
        replace(shape, turn=np.diag([1.0, 4, 9])).moved(quarter).turn, np.diag([4, 1, 9]), atol=1e-9
    )
    followed = shape.told(np.zeros(3), known)
    assert followed.sigma == pytest.approx(np.sqrt(0.01 * np.sum(modes**2, axis=(0, 2)) + 3e-4))
    stayed = shape.told(best, known)
    off = np.sum(step**2, axis=1)
    assert stayed.sigma == pytest.approx(np.sqrt(0.01 * np.sum(modes**2, axis=(0, 2)) + off + 3e-4))


def _drawn(truth: pycolmap.Reconstruction, seed: int) -> pycolmap.Reconstruction:
    """Errors as key points have them: long tails, and half of each shared by a point's sightings in one camera."""
    model = pycolmap.Reconstruction(truth)
    rng = np.random.default_rng(seed)
    shared = {(p, c): 0.2 * rng.standard_normal(2) for p in truth.point3D_ids() for c in truth.cameras}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        for point in image.points2D:
            if point.has_point3D():
                own = 0.2 * rng.standard_normal(2) * (4.0 if rng.random() < 0.1 else 1.0)
                true = image.project_point(model.point3D(point.point3D_id).xyz)
                point.xy = true + own + shared[point.point3D_id, image.camera_id]
    return robust(model)


@pytest.mark.slow
def test_sigma_is_right_for_errors_with_tails_that_tracks_share(tmp_path) -> None:
    """Rig and intrinsics unknown: root mean squares over the draws agree within 0.8-1.25."""
    truth, scene = make_world(tmp_path / "database.db", cameras=2, frames=6, noise_px=0.0)
    true = true_frames(truth, scene)[:, :3, 3]
    actual, predicted = [], []
    for seed in range(24):
        model = _drawn(truth, seed)
        found = frame_poses(image_poses(model, scene), scene)[:, :3, 3]
        actual.append(np.sum((umeyama(found, true)(found) - true) ** 2))
        predicted.append(np.sum(position_sigma(model, tuning=TUNING).sigma ** 2))
    ratio = float(np.sqrt(np.mean(actual) / np.mean(predicted)))
    assert 0.8 < ratio < 1.25, ratio


def test_points_that_are_not_quite_at_their_minimum_say_nothing_of_the_frames(world) -> None:
    """An adjustment stops where points that few rays hold may still slide along them (sigma of the boat: 19 fold)."""
    truth, _ = world
    model = _noisy(truth, 0.5, 1)
    before = position_sigma(model, free_intrinsics=False, free_rig=False, tuning=TUNING)
    middle = np.mean([image.projection_center() for image in model.images.values()], axis=0)
    for key in sorted(model.point3D_ids())[::8]:
        point = model.point3D(key)
        point.xyz = point.xyz + 0.02 * (point.xyz - middle)
    after = position_sigma(model, free_intrinsics=False, free_rig=False, tuning=TUNING)
    expected = before.median * after.pixel_sigma / before.pixel_sigma  # their residuals widen that of a pixel
    assert after.median == pytest.approx(expected, rel=0.15)


@pytest.mark.slow
def test_interior_orientation_tells_sigmas_and_correlations(world) -> None:
    truth, _ = world
    found = position_sigma(_drawn(truth, 3), tuning=TUNING)
    assert {row[0] for row in found.interior} == set(truth.cameras)
    assert all(row[3] > 0 for row in found.interior)
    assert all(row[4] is None or 0.7 <= abs(row[4]) <= 1 for row in found.interior)
    assert set(found.mounting) == {2} and 0 < found.mounting[2].sigma_deg < 1
    assert 0 < found.mounting[2].sigma < 0.1 * np.linalg.norm(found.mounting[2].centre)
    assert not found.open_mountings(TUNING.sigma)
    tables = found.tables({1: "left"})
    assert tables["interior orientation"]["rows"][0][0] == "left" and tables[MOUNTING]["rows"][0][0] == 2
    assert position_sigma(truth_noisy(truth), False, False, tuning=TUNING).interior == ()


def truth_noisy(truth: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The world with half a pixel of noise."""
    return _noisy(truth, 0.5, 0)


def test_unknown_intrinsics_and_rig_widen_the_sigmas(world) -> None:
    truth, _ = world
    model = _noisy(truth, 0.5, 0)
    known, free = position_sigma(model, False, False, tuning=TUNING), position_sigma(model, tuning=TUNING)
    assert known.median < free.median < 50 * known.median
    assert free.median <= free.p90


@pytest.mark.parametrize("others", [1, 9])
def test_a_frame_whose_points_no_two_others_see_has_an_unknown_distance(others: int) -> None:
    """Along a straight path: across it two rays tell, along it nothing; it is named, its neighbours behind it."""
    model, scene = moving_world(frames=10)
    for key, point in list(model.points3D.items()) if others == 1 else []:
        xyz, seen = np.array(point.xyz), [(e.image_id, e.point2D_idx) for e in point.track.elements]
        own = [e for e in seen if e[0] > 27]
        same = [e for e in seen if len(own) == 1 and e[0] < 28 and (own[0][0] - e[0]) % 3 == 0]
        if own:
            model.delete_point3D(key)
        if own and same:
            two = own[0], same[key % len(same)]
            model.add_point3D(xyz, pycolmap.Track([pycolmap.TrackElement(*e) for e in two]))
    model = _noisy(model, 0.3, 0)
    sigma = position_sigma(model, free_intrinsics=False, free_rig=False, tuning=TUNING)
    said = _open_places(Shape.of(model, sigma, scene), scene, TUNING.sigma)
    x, _, along = sigma.sigma[-1]
    if others == 9:
        assert along < 0.003 and said == []
    else:
        assert 0.1 < along < 3 and x < 0.2 * along
        assert "(sigma 0." in said[0] and ": cam0/009.jpg: " in said[0]


def test_two_frames_have_no_sigma(tmp_path) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=1, frames=2)
    with pytest.raises(ValueError, match="at least 3 frames"):
        position_sigma(truth, tuning=TUNING)


def test_final_adjustment_finds_the_principal_point(tmp_path) -> None:
    """A principal point assumed 8 px off its place: the mappers keep it, the final adjustment finds it."""
    truth, scene = make_world(tmp_path / "database.db", cameras=2, frames=12, noise_px=0.2)
    wrong = pycolmap.Reconstruction(truth)
    camera = wrong.camera(1)
    right = copy.copy(camera).params
    camera.principal_point_x += 8
    before = wrong.compute_mean_reprojection_error()
    wrong.update_point_3d_errors()
    result = final_adjustment(wrong, tuning=TUNING.adjust)
    assert "principal points moved" in result.note
    found = result.model.camera(1)
    assert abs(found.principal_point_x - right[1]) < 2.0
    assert result.model.compute_mean_reprojection_error() < max(before, 1.0)
    kept = final_adjustment(wrong, constant_cameras=[1], tuning=TUNING.adjust).model.camera(1)
    assert kept.principal_point_x == camera.principal_point_x


def test_a_camera_with_impossible_intrinsics_keeps_its_own_and_the_rest_is_adjusted(tmp_path, monkeypatch) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=2, frames=12, noise_px=0.2)
    asked = []

    def impossible(before, after, cameras, tuning):
        asked.append(set(cameras))
        return 2 if 2 in cameras else None

    monkeypatch.setattr("tiegraph.sfm.adjustment.adjust.impossible_camera", impossible)
    result = final_adjustment(truth, tuning=TUNING.adjust)
    assert asked[1] == asked[0] - {2} != set() and "camera 2 keeps its intrinsics" in result.note
    assert (result.model.camera(2).params == truth.camera(2).params).all()
    assert result.model.camera(2).model == truth.camera(2).model
    assert result.model.camera(1).mean_focal_length() != truth.camera(1).mean_focal_length()
