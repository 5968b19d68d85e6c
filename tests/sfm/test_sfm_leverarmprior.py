"""What a rig's other cameras let expect of one that hardly shares a point with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world

from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.sfm.adjustment import leverarmprior
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import LeverArmTuning

import pycolmap  # isort: skip

RADIUS = 0.06
TUNING = LeverArmTuning()


def _looking(axis: np.ndarray) -> np.ndarray:
    """A rotation rig_from_sensor whose third column is the axis."""
    turn, _ = Rotation.align_vectors(np.atleast_2d(axis), [[0.0, 0, 1]])
    return turn.as_matrix()


def _rig(centres: np.ndarray, axes: np.ndarray) -> pycolmap.Rig:
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1))
    for k, (centre, axis) in enumerate(zip(centres, axes), start=2):
        turn = _looking(axis).T
        pose = rigid3d(np.vstack([np.column_stack([turn, -turn @ centre]), [0, 0, 0, 1]]))
        rig.add_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, k), pose)
    return rig


def _omnidirectional(noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres and axes of four cameras around the reference's vertical, and one that looks up; the rig's x is right."""
    angle = np.radians([72, 144, 216, 288])
    axes = np.array([*np.column_stack([np.sin(angle), np.zeros(4), np.cos(angle)]), [0.0, -1, 0]])
    middle = np.array([0.0, 0, -RADIUS])
    return middle + RADIUS * axes + noise * np.random.default_rng(0).standard_normal((5, 3)), axes


def test_an_up_camera_is_expected_as_far_out_as_the_ring() -> None:
    centres, axes = _omnidirectional(0.001)
    centres[4] += [0.05, -0.03, 0.04]  # as the images had it
    found, sigma = leverarmprior.expected_centres(_rig(centres, axes), TUNING)[6]
    assert np.linalg.norm(found - [0, -RADIUS, -RADIUS]) < 0.004
    assert 0.9 * RADIUS / 3 < sigma < 1.2 * RADIUS / 3


def test_nothing_is_expected_of_small_rigs_and_of_one_centre() -> None:
    centres, axes = _omnidirectional(0.0)
    assert leverarmprior.expected_centres(_rig(centres[:3], axes[:3]), TUNING) == {}
    assert leverarmprior.expected_centres(_rig(0 * centres, axes), TUNING) == {}


def test_cameras_anywhere_on_a_vehicle_are_expected_anywhere() -> None:
    rng = np.random.default_rng(1)
    _, axes = _omnidirectional(0.0)
    rigs = [_rig(rng.normal(0, 1.0, (5, 3)), axes) for _ in range(20)]
    sigmas = [s for rig in rigs for _, s in leverarmprior.expected_centres(rig, TUNING).values()]
    assert 0.7 < np.median(sigmas) < 1.4 and min(sigmas) > 0.2


def test_a_drawing_tells_where_a_camera_of_any_rig_is_though_not_how_large_it_is() -> None:
    rng = np.random.default_rng(2)
    _, axes = _omnidirectional(0.0)
    true = rng.normal(0, 1.0, (5, 3))
    turn = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    drawing = {k: 40.0 * turn @ c for k, c in enumerate(true, start=2)}
    centres = true + 0.002 * rng.standard_normal((5, 3))
    centres[4] += [0.9, -0.6, 0.7]  # as the images had it
    found, sigma = leverarmprior.expected_centres(_rig(centres, axes), TUNING, drawing)[6]
    assert np.linalg.norm(found - true[4]) < 0.02
    assert 0.05 < sigma < 0.3
    incomplete = {k: c for k, c in drawing.items() if k != 4}
    assert leverarmprior.expected_centres(_rig(centres, axes), TUNING, incomplete)[6][1] > 3 * sigma
    mirrored = {k: c * [1, 1, -1] for k, c in drawing.items()}
    assert leverarmprior.expected_centres(_rig(centres, axes), TUNING, mirrored)[6][1] > 3 * sigma


def test_what_a_rule_has_from_the_rig_itself_is_no_information() -> None:
    centres, axes = _omnidirectional(0.001)
    rig = _rig(centres, axes)
    drawing = {k: 3.0 * c for k, c in enumerate(centres, start=2)}
    keys, information = leverarmprior.information(rig, TUNING, drawing)
    assert keys == [2, 3, 4, 5, 6]
    stiff = np.linalg.eigvalsh(information)
    assert stiff[0] > -1e-6 * stiff[-1]
    bigger = centres.ravel() / np.linalg.norm(centres)
    assert bigger @ information @ bigger < 1e-9 * stiff[-1]  # its size is the model's
    alone = np.zeros(15)
    alone[-1] = 1.0
    assert alone @ information @ alone > 0.2 * stiff[-1]
    assert np.sum(stiff > 1e-6 * stiff[-1]) == 15 - 4


@pytest.mark.slow
def test_a_camera_that_the_images_place_stays(tmp_path: Path) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=6, frames=10, noise_px=0.2, points=300)
    _, sigma = leverarmprior.expected_centres(truth.rig(1), TUNING)[6]
    moved = np.linalg.norm(_centre(final_adjustment(truth, tuning=Tuning().adjust).model) - _centre(truth))
    assert moved < 0.05 * sigma


@pytest.mark.slow
def test_a_camera_that_the_images_leave_open_goes_where_it_is_expected(tmp_path: Path, monkeypatch) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=6, frames=10, noise_px=0.2, points=300)
    start = _hardly_seeing(truth)
    expected, sigma = leverarmprior.expected_centres(start.rig(1), TUNING)[6]
    far = np.linalg.norm(_centre(start) - expected)
    near = np.linalg.norm(_centre(final_adjustment(start, tuning=Tuning().adjust).model) - expected)
    monkeypatch.setattr(leverarmprior, "add_priors", lambda *arguments: [])
    without = np.linalg.norm(_centre(final_adjustment(start, tuning=Tuning().adjust).model) - expected)
    assert far > 1.5 * sigma and without > 0.8 * far
    assert near < 0.5 * far


def _centre(model: pycolmap.Reconstruction) -> np.ndarray:
    return next(p.inverse().translation for i, p in model.rig(1).non_ref_sensors.items() if i.id == 6)


def _hardly_seeing(truth: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The model whose last camera sees two points, from a place in the rig that is wrong."""
    model = pycolmap.Reconstruction(truth)
    own = sorted(i for i in model.reg_image_ids() if model.image(i).camera_id == 6)
    kept = [k for k, p in enumerate(model.image(own[0]).points2D) if p.has_point3D()][:2]
    for image_id in own:
        for k, point in enumerate(model.image(image_id).points2D):
            if point.has_point3D() and (image_id != own[0] or k not in kept):
                model.delete_observation(image_id, k)
    _, sigma = leverarmprior.expected_centres(model.rig(1), TUNING)[6]
    for identity, pose in model.rig(1).non_ref_sensors.items():
        if identity.id == 6:
            pose.translation = pose.translation + 2 * sigma * np.array([0.0, 0, 1])
    return model
