"""Sigmas of models whose rig was let go of: the ties of a camera share its time and the error of its mounting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from driving_world import LATE_S, Drive, driving_world
from moving_world import moving_world
from scipy.spatial.transform import Rotation

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scene.colmapmodel import image_poses, rigid3d
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment import adjust
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.constraints import PoseConstraints
from tiegraph.sfm.adjustment.jacobians import Layout, RigConstraint, RigConstraints
from tiegraph.sfm.adjustment.timecost import TimeOffsetPriors
from tiegraph.sfm.covariance import position_sigma
from tiegraph.sfm.rig.confront import mounting_errors, prior_test
from tiegraph.sfm.rig.timecalibration import TrustedCalibration, calibrate_times, with_errors
from tiegraph.sfm.tuning import Tuning

TUNING = Tuning()


def test_ties_of_a_camera_know_nothing_of_the_error_they_share() -> None:
    """All second frames off by the same constants, in the axes of their first ones: no tie is strained."""
    model, _ = moving_world(frames=4)
    ids = sorted(model.reg_frame_ids())
    held = np.array([0.1, *[0.01] * 3, *[0.001] * 3])
    moment = np.diag(np.array([0.1, *[0.03] * 3, *[0.001] * 3]) ** 2)
    late, place, turn = 0.02, np.array([0.1, -0.2, 0.3]), np.array([0.01, 0.02, -0.03])
    ties, shift = [], {}
    for a, b in ((ids[0], ids[1]), (ids[2], ids[3])):
        axes = model.frame(a).rig_from_world.rotation.matrix().T
        moves = np.kron(np.eye(2), axes) @ np.hstack([np.arange(6.0)[:, None], np.eye(6)])
        ties.append(RigConstraint(a, b, 0.002, 0.0003, 7, moves))
        shift[b] = moves @ np.concatenate([[late], place, turn])
    layout = Layout(model, False, False, [RigConstraints(tuple(ties), (7,), held[None], moment)])
    assert layout.size == 6 * len(ids) + 7
    together = np.zeros(layout.size)
    for b, moved in shift.items():
        together[layout.frame[b] + np.arange(6)] = moved
    alone = together.copy()
    together[layout.constant[7] + np.arange(7)] = [late, *place, *turn]
    tied = layout.tied()
    assert together @ tied @ together < 1e-9 * (alone @ tied @ alone)
    curvature, scatter = layout.held()
    assert curvature.diagonal()[-7:] == pytest.approx(1 / held**2)
    # by three times more than the adjustment held it to, the place pulls nine times as hard (variance)
    assert (scatter.diagonal() / curvature.diagonal().clip(1e-300))[-6:] == pytest.approx([9] * 3 + [1] * 3)


def _misread(model: pycolmap.Reconstruction, scene: Scene, place_m: float, turn_deg: float, seed: int) -> Scene:
    """A file whose cameras stand off by so much, in the model and in the scene that is returned."""
    rng, sensors = np.random.default_rng(seed), [scene.rigs[0].sensors[0]]
    for k, sensor in enumerate(scene.rigs[0].sensors[1:], 2):
        turn = Rotation.from_rotvec(np.radians(turn_deg) * rng.standard_normal(3)).as_matrix()
        pose = transforms.rigid(turn, place_m * rng.standard_normal(3)) @ sensor.sensor_from_rig
        model.rig(1).set_sensor_from_rig(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, k), rigid3d(pose))
        sensors.append(replace(sensor, sensor_from_rig=pose))
    return scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(sensors)),))


def _actual(model: pycolmap.Reconstruction, scene: Scene, true: Sequence[np.ndarray], drive: Drive) -> float:
    """Median error of all images, each at its own time, after the best similarity, metres on the road; ``true``:
    extrinsics of the cameras."""
    there = []
    for frame, sensor in zip(scene.frame, scene.sensor):
        rig = drive.pose_at(scene.time_s[frame] + drive.late_s[sensor])
        there.append(transforms.centre(true[sensor] @ transforms.invert(rig)))
    here = transforms.centre(image_poses(model, scene))
    return float(np.median(np.linalg.norm(umeyama(here, np.stack(there))(here) - there, axis=1)))


def _stated(model: pycolmap.Reconstruction, ties: RigConstraints) -> float:
    """Median sigma of the images' places."""
    return position_sigma(model, False, False, [ties], tuning=TUNING).median


@pytest.mark.slow
def test_positions_of_a_relaxed_rig_are_known_as_well_as_its_file_is_right() -> None:
    """Files that are off by what calibrations are held to: over two of them sigma and error agree; as the adjustment
    held them, without their errors, it would be too sure."""
    held_to = TUNING.rig.confront
    stated, actual = np.zeros((2, 2)), np.zeros(2)
    for seed in range(2):
        drive = Drive(late_s=LATE_S, frames=16, seed=5 + seed)
        model, scene = driving_world(drive)
        true = [np.asarray(s.sensor_from_rig) for s in scene.rigs[0].sensors]
        scene = _misread(model, scene, held_to.held_to_m, held_to.held_to_deg, seed)
        cameras = sorted(model.cameras)
        rigid = final_adjustment(model, [1], cameras, tuning=TUNING.adjust).model
        found = calibrate_times(rigid, scene, 0, TrustedCalibration(1.0, True, cameras, lenses_held=True), TUNING)
        test = prior_test(found.model, scene, 0, 1.0, TUNING)
        moment = mounting_errors(test, scene, 0, found.constraints.cameras, TUNING.rig)
        for row, ties in enumerate((found.constraints, with_errors(found.constraints, moment))):
            stated[row, seed] = _stated(found.model, ties)
        actual[seed] = _actual(found.model, scene, true, drive)
    held, whole = np.median(stated / actual, axis=1)
    assert 0.5 < whole < 2 and held < 0.7 * whole, (stated, actual)


def test_times_of_a_refused_trial_do_not_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lenses with distortion are tried; where they gain nothing, the times are those of the model that stays."""
    model, _ = moving_world(frames=4)
    before = np.array([0.03, *[0.001] * 6])
    soft = PoseConstraints(time_offsets=TimeOffsetPriors([], {2: before.copy()}, np.ones(7)))

    def solve(trial: pycolmap.Reconstruction, *given: object) -> None:
        soft.time_offsets.unknowns[2] += 0.01

    monkeypatch.setattr(adjust, "_solve", solve)
    for gain, kept in ((0.0, before), (0.5, before + 0.01)):
        costs = iter((1.0 - gain, 1.0))
        monkeypatch.setattr(adjust, "robust_cost", lambda *_, costs=costs: next(costs))
        _, note = adjust._with_doubted(model, (), set(), {1, 2, 3}, soft, TUNING.adjust)
        assert bool(note) == (gain > 0)
        np.testing.assert_allclose(soft.time_offsets.unknowns[2], kept)
