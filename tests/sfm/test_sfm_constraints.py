"""Rig geometry given with a sigma: the costs, and that an adjustment minds them as far as their sigma says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from moving_world import moving_world
from scipy.spatial.transform import Rotation

from near import baselines_m
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import model_rigs, rigid3d
from tiegraph.scene.rig import SensorPair
from tiegraph.sfm.adjustment import constraints
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.rigpriors import rig_priors
from tiegraph.sfm.rig.rig import held_by_mapper, rig_modes
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import RigPriorTuning, RigTuning


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
    assert held_by_mapper(_with_sigma(scene, 0.1, 0.01).rigs[0], "soft", RigTuning())
    assert not held_by_mapper(_with_sigma(scene, 3.0, 0.01).rigs[0], "soft", RigTuning())


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_m", "least", "most"), [(0.0005, 0.02, 0.04), (0.05, 0.0, 0.012)])
def test_a_wrong_lever_is_kept_or_left_by_its_sigma(sigma_m: float, least: float, most: float) -> None:
    """The given levers are 3 cm off: with half a millimetre of sigma they stay, with 5 cm the images decide."""
    model, scene = moving_world(frames=12)
    wrong = _with_sigma(scene, 0.5, sigma_m, shift_m=0.03)
    known = rig_priors(model, wrong, [0], RigPriorTuning())
    assert len(known.sensors) == 2
    adjusted = final_adjustment(model, [], [1, 2, 3], known, tuning=Tuning().adjust)
    found, true = model_rigs(adjusted.model, scene)[0], scene.rigs[0]
    off = [abs(np.linalg.norm(transforms.centre(f.sensor_from_rig) - transforms.centre(t.sensor_from_rig)))
           for f, t in zip(found.sensors[1:], true.sensors[1:])]  # fmt: skip
    assert least <= max(off) <= most


@pytest.mark.slow
def test_a_pair_sets_baseline_and_axis() -> None:
    model, scene = moving_world(frames=12)
    pair = SensorPair(("cam1", "cam2"), 0.83, 0.0002, 90.3, 0.002)
    known = rig_priors(model, _with_sigma(scene, 0.5, 0.05, pairs=(pair,)), [0], RigPriorTuning())
    assert len(known.pairs) == 1
    rig = model_rigs(final_adjustment(model, [], [1, 2, 3], known, tuning=Tuning().adjust).model, scene)[0]
    assert baselines_m(rig)[1, 2] == pytest.approx(0.83, abs=0.005)
    assert rig.axis_angles_deg()[1, 2] == pytest.approx(90.3, abs=0.05)
