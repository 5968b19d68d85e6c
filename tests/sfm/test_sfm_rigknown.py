"""What is known of a rig beside the images: given with a sigma, or expected of its other cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world

from near import baselines_m
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import model_rigs, rigid3d
from tiegraph.scene.rig import SensorPair
from tiegraph.sfm.adjustment import constraints, leverarmprior
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.constraints import rig_priors
from tiegraph.sfm.adjustment.leverarmprior import _CentresCost, centres_of
from tiegraph.sfm.rig.rig import held_by_mapper, rig_modes
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import LeverArmTuning, RigTuning


def test_pair_residuals_are_in_sigmas() -> None:
    turn = transforms.rigid(Rotation.from_euler("y", 40, degrees=True).as_matrix(), np.zeros(3))
    second = turn @ transforms.rigid(np.eye(3), -np.array([0.3, 0, 0.4]))  # centre at (0.3, 0, 0.4)
    poses = [np.array(rigid3d(p).params) for p in (np.eye(4), second)]
    pair = constraints.PairPrior(1, (1, 2), 0.48, 0.01, np.radians(39.0), np.radians(0.5))
    np.testing.assert_allclose(constraints.pair_residuals(*poses, pair), [2.0, 2.0], atol=1e-9)


def _with_sigma(scene, sigma_deg, sigma_m, shift_m=0.0, pairs=()):
    rig = scene.rigs[0]
    sensors = [rig.sensors[0]]
    for s in rig.sensors[1:]:
        pose = np.array(s.sensor_from_rig)
        pose[0, 3] += shift_m
        sensors.append(replace(s, sensor_from_rig=pose, sigma_deg=sigma_deg, sigma_m=sigma_m))
    return scene.with_(rigs=(replace(rig, fixed=False, sensors=tuple(sensors), pairs=pairs),))


def test_modes() -> None:
    _, scene = moving_world(frames=4)
    assert rig_modes(_with_sigma(scene, 0.1, 0.01), "auto") == {0: "soft"}
    assert rig_modes(_with_sigma(scene, 0.0, 0.0), "auto") == {0: "refined"}  # no sigma, no calibration
    assert held_by_mapper(_with_sigma(scene, 0.1, 0.01), {0: "soft"}, RigTuning()) == (0,)
    assert held_by_mapper(_with_sigma(scene, 3.0, 0.01), {0: "soft"}, RigTuning()) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_m", "least", "most"), [(0.0005, 0.02, 0.04), (0.05, 0.0, 0.012)])
def test_a_wrong_lever_is_kept_or_left_by_its_sigma(sigma_m: float, least: float, most: float) -> None:
    """The given levers are 3 cm off: with half a millimetre of sigma they stay, with 5 cm the images decide."""
    model, scene = moving_world(frames=12)
    wrong = _with_sigma(scene, 0.5, sigma_m, shift_m=0.03)
    known = rig_priors(model, wrong, [0], RigTuning())
    assert len(known.sensors) == 2
    adjusted = final_adjustment(model, [], [1, 2, 3], known, tuning=Tuning().adjust)
    found, true = model_rigs(adjusted.model, scene)[0], scene.rigs[0]
    centres = [np.array([transforms.centre(s.sensor_from_rig) for s in rig.sensors]) for rig in (found, true)]
    assert least <= np.linalg.norm(centres[0] - centres[1], axis=1).max() <= most


@pytest.mark.slow
def test_a_pair_sets_baseline_and_axis() -> None:
    model, scene = moving_world(frames=12)
    pair = SensorPair(("cam1", "cam2"), 0.83, 0.0002, 90.3, 0.002)
    known = rig_priors(model, _with_sigma(scene, 0.5, 0.05, pairs=(pair,)), [0], RigTuning())
    assert len(known.pairs) == 1
    rig = model_rigs(final_adjustment(model, [], [1, 2, 3], known, tuning=Tuning().adjust).model, scene)[0]
    assert baselines_m(rig)[1, 2] == pytest.approx(0.83, abs=0.005)
    assert rig.axis_angles_deg()[1, 2] == pytest.approx(90.3, abs=0.05)


RADIUS = 0.06
TUNING = LeverArmTuning()


def _rig(centres: np.ndarray, axes: np.ndarray) -> pycolmap.Rig:
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1))
    for k, (centre, axis) in enumerate(zip(centres, axes), start=2):
        turn = Rotation.align_vectors(np.atleast_2d(axis), [[0.0, 0, 1]])[0].as_matrix().T  # from a camera along it
        pose = rigid3d(transforms.rigid(turn, -turn @ centre))
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


def test_cameras_anywhere_are_expected_anywhere_and_small_rigs_expect_nothing() -> None:
    rng = np.random.default_rng(1)
    _, axes = _omnidirectional(0.0)
    rigs = [_rig(rng.normal(0, 1.0, (5, 3)), axes) for _ in range(20)]
    sigmas = [s for rig in rigs for _, s in leverarmprior.expected_centres(rig, TUNING).values()]
    assert 0.7 < np.median(sigmas) < 1.4 and min(sigmas) > 0.2
    centres, axes = _omnidirectional(0.0)
    assert leverarmprior.expected_centres(_rig(centres[:3], axes[:3]), TUNING) == {}
    assert leverarmprior.expected_centres(_rig(0 * centres, axes), TUNING) == {}


def test_a_drawing_tells_where_a_camera_of_any_rig_is_though_not_how_large_it_is() -> None:
    rng = np.random.default_rng(2)
    _, axes = _omnidirectional(0.0)
    true = rng.normal(0, 1.0, (5, 3))
    turn = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    drawing = {k: 40.0 * turn @ c for k, c in enumerate(true, start=2)}
    centres = true + 0.002 * rng.standard_normal((5, 3))
    centres[4] += [0.9, -0.6, 0.7]  # as the images had it
    found, sigma = leverarmprior.expected_centres(_rig(centres, axes), TUNING, drawing)[6]
    assert np.linalg.norm(found - true[4]) < 0.02 and 0.05 < sigma < 0.3
    incomplete = {k: c for k, c in drawing.items() if k != 4}
    mirrored = {k: c * [1, 1, -1] for k, c in drawing.items()}
    for other in (incomplete, mirrored):
        assert leverarmprior.expected_centres(_rig(centres, axes), TUNING, other)[6][1] > 3 * sigma


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
def test_a_camera_goes_where_it_is_expected_only_if_the_images_leave_it_open(tmp_path: Path, monkeypatch) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=6, frames=10, noise_px=0.2, points=300)
    _, sigma = leverarmprior.expected_centres(truth.rig(1), TUNING)[6]
    moved = np.linalg.norm(_centre(final_adjustment(truth, tuning=Tuning().adjust).model) - _centre(truth))
    assert moved < 0.05 * sigma
    start = _hardly_seeing(truth)
    expected, sigma = leverarmprior.expected_centres(start.rig(1), TUNING)[6]
    far = np.linalg.norm(_centre(start) - expected)
    near = np.linalg.norm(_centre(final_adjustment(start, tuning=Tuning().adjust).model) - expected)
    monkeypatch.setattr(leverarmprior, "add_priors", lambda *arguments: [])
    monkeypatch.setattr(leverarmprior, "bring_back", lambda *arguments: False)
    without = np.linalg.norm(_centre(final_adjustment(start, tuning=Tuning().adjust).model) - expected)
    assert far > 1.5 * sigma and without > 0.8 * far and near < 0.5 * far


@pytest.mark.slow
def test_only_a_camera_that_ties_to_itself_alone_starts_from_where_its_rig_has_it(tmp_path: Path) -> None:
    """The up camera of the example's second section stood 3.4 m away in a rig of 0.06 m."""
    truth, _ = make_world(tmp_path / "database.db", cameras=6, frames=4, points=200)
    far = np.array([0.0, 3.0, 0.0])
    for model, back in ((pycolmap.Reconstruction(truth), False), (_hardly_seeing(truth), True)):
        expected = leverarmprior.expected_centres(model.rig(1), TUNING)[6][0]
        for identity, pose in model.rig(1).non_ref_sensors.items():
            if identity.id == 6:
                pose.translation = -pose.rotation.matrix() @ (expected + far)
        assert not leverarmprior.bring_back(model, {1}, {}, Tuning().adjust), "a rig that is fixed stays"
        assert leverarmprior.bring_back(model, (), {}, Tuning().adjust) == back
        np.testing.assert_allclose(_centre(model), expected + (not back) * far, atol=1e-9)


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


def _pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.append(Rotation.random(random_state=seed).as_quat(), 5 * rng.standard_normal(3))


def test_the_cost_of_centres_has_its_value_and_its_derivatives() -> None:
    poses, root = [_pose(k) for k in range(3)], np.random.default_rng(0).standard_normal((5, 9))
    rotation = Rotation.from_quat(np.array(poses)[:, :4])
    centres = -rotation.inv().apply(np.array(poses)[:, 4:])
    np.testing.assert_allclose(centres_of(np.array(poses))[0], centres, atol=1e-12)

    def value(flat: np.ndarray, jacobians: list | None = None) -> np.ndarray:
        out = np.zeros(5)
        assert _CentresCost(root).Evaluate(list(flat.reshape(3, 7)), out, jacobians)
        return out

    at, jacobians = np.concatenate(poses), [np.zeros(5 * 7) for _ in poses]
    np.testing.assert_allclose(value(at, jacobians), root @ centres.ravel())
    numeric = np.mean([approx_fprime(at, value, sign * 1e-6) for sign in (1, -1)], axis=0)
    np.testing.assert_allclose(np.hstack([j.reshape(5, 7) for j in jacobians]), numeric, atol=1e-6)


def test_a_residual_of_constant_blocks_does_not_end_the_process() -> None:
    """Ceres asks it once, and for no Jacobians; beside it there is something to solve."""
    pyceres = pytest.importorskip("pyceres")
    problem, summary = pyceres.Problem(), pyceres.SolverSummary()
    blocks, free, cost = [_pose(k) for k in range(2)], np.zeros(1), _CentresCost(np.ones((1, 6)))
    before, prior = [b.copy() for b in blocks], pyceres.factors.NormalPrior(np.full(1, 3.0), np.eye(1))
    problem.add_residual_block(cost, None, blocks)
    for block in blocks:
        problem.set_parameter_block_constant(block)
    problem.add_residual_block(prior, None, [free])
    pyceres.solve(pyceres.SolverOptions(), problem, summary)
    assert free[0] == pytest.approx(3, abs=1e-4) and all((a == b).all() for a, b in zip(before, blocks))
