"""A rigid, synchronised rig is called so; a late camera is named, timed and relaxed; a loose one is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from moving_world import moving_world

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.rig import Source
from tiegraph.sfm import rigcheck
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.rig.diagnostics import RigDiagnostics, rig_diagnostics
from tiegraph.sfm.rig.resections import (
    COLUMNS,
    Resections,
    SensorDiagnostics,
    median_at_least,
    resect_all,
    sensor_diagnostics,
)
from tiegraph.sfm.rig.timecalibration import TimeCalibration, TrustedCalibration, calibrate_times, lost_images
from tiegraph.sfm.rig.timeoffset import moved_in_time, rig_motion
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import RigTuning

LATE_S = 0.04
RIG = RigTuning()
MAX_RATIO = RIG.diagnostics.max_ratio


def _rigid(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    return final_adjustment(model, [1], [1, 2, 3], tuning=Tuning().adjust).model


@pytest.mark.slow
def test_a_good_rig_scatters_as_expected() -> None:
    model, scene = moving_world()
    found = rig_diagnostics(_rigid(model), scene, 1.0, Tuning())
    assert found.moving == () and found.notes == []
    assert [h.name for h in found.sensors] == ["cam0", "cam1", "cam2"]
    for h in found.sensors:
        assert 0.5 < h.scatter_ratio < 2.0
        assert 0.0005 < h.place_m.scatter < 0.05 and 0.002 < h.turn_deg.scatter < 0.2
    assert all(len(row) == len(COLUMNS) for row in found.rows)


def test_the_bound_of_a_median_holds_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    for draws in (5, 9, 18, 50):
        above = [
            median_at_least(rng.chisquare(6, draws), RIG.diagnostics.chance) > 5.348 for _ in range(2000)
        ]  # the median of chi2 of 6
        assert 0.005 < np.mean(above) <= 0.05
    assert median_at_least(np.full(4, 99.0), RIG.diagnostics.chance) == 0.0, "four frames tell nothing"
    assert median_at_least(np.arange(1.0, 10), RIG.diagnostics.chance) == 2.0, (
        "one of nine may lie below by chance, two not"
    )


def _scattered(frames: int, times: float, seed: int) -> SensorDiagnostics:
    """Health of a camera whose frames scatter ``times`` their expected sigma."""
    _, scene = moving_world(frames=max(frames, 2))
    rng = np.random.default_rng(seed)
    sigma = np.array([0.01] * 3 + [0.002] * 3)  # m, rad
    off = times * sigma * rng.standard_normal((frames, 6))
    rows = np.array([scene.image_index[f"cam1/{f:03d}.jpg"] for f in range(frames)])
    found = Resections(
        image=rows, points=np.full(frames, 40), rms_px=np.full(frames, 0.5), shift_m=off[:, :3],
        turn_deg=np.degrees(off[:, 3:]), sigma_m=np.tile(sigma[:3], (frames, 1)),
        sigma_deg=np.degrees(np.tile(sigma[3:], (frames, 1))), covariance=np.tile(np.diag(sigma**2), (frames, 1, 1)),
        rig_pose=np.tile(np.eye(4), (frames, 1, 1)),
    )  # fmt: skip
    return sensor_diagnostics(found, scene, RIG.diagnostics)[0]


@pytest.mark.slow
def test_few_frames_do_not_make_a_camera_loose() -> None:
    """A scatter just above the bound is chance in nine frames and a finding in two hundred."""
    few, many = (_scattered(frames, 1.3 * MAX_RATIO, 0) for frames in (9, 200))
    assert few.scatter_ratio > MAX_RATIO > few.sure_ratio and few.rigid(RIG.diagnostics)
    assert many.scatter_ratio > many.sure_ratio > MAX_RATIO and not many.rigid(RIG.diagnostics)
    assert not _scattered(9, 4 * MAX_RATIO, 0).rigid(RIG.diagnostics), "what is far out is found in nine frames too"
    assert all(_scattered(9, MAX_RATIO, seed).rigid(RIG.diagnostics) for seed in range(10))


def test_a_relaxed_model_that_loses_images_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model, scene = moving_world(frames=6)
    free = pycolmap.Reconstruction(model)
    poor = scene.image_index["cam2/003.jpg"]
    image = free.find_image_with_name(scene.names[poor])
    for row, point in enumerate(image.points2D):
        if point.has_point3D():
            free.delete_observation(image.image_id, row)
    assert lost_images(model, free, scene, 10) == (poor,) and lost_images(free, model, scene, 10) == ()
    found = RigDiagnostics([], (), (0,), ["camera cam2 is not rigid"], True, {})
    monkeypatch.setattr(rigcheck, "rig_diagnostics", lambda *_: found)
    request = rigcheck.FinishRequest(
        tmp_path, tmp_path, scene.to_json(), Tuning(), rigcheck.Held(rigs=(0,), fixed=(0,))
    )
    for relaxed, kept in ((free, model), (pycolmap.Reconstruction(model), None)):
        monkeypatch.setattr(rigcheck, "calibrate_times", lambda *_, to=relaxed: TimeCalibration(to, {}, ""))
        checked = rigcheck.checked_rig(model, model, scene, request)
        assert found.notes[0] in checked.notes
        assert checked.model is (kept or relaxed)
        said = [line for line in checked.contradictions if "stays rigid" in line and scene.names[poor] in line]
        assert bool(said) == (kept is model)
    views = [replace(s, source=Source(panorama=True)) for s in scene.rigs[0].sensors]
    scene = replace(scene, rigs=(replace(scene.rigs[0], sensors=tuple(views)),))
    monkeypatch.setattr(rigcheck, "calibrate_times", None)  # views of one picture have one time
    checked = rigcheck.checked_rig(model, model, scene, request)
    assert not checked.contradictions and any("stitched" in note for note in checked.notes)


@pytest.mark.slow
def test_a_loose_camera_is_named() -> None:
    model, scene = moving_world(loose_deg=(0, 0, 0.2), points=1500)
    found = rig_diagnostics(_rigid(model), scene, 1.0, Tuning())
    assert found.moving == (0,)
    assert any("cam2 does not keep its place" in note and "not rigid" in note for note in found.notes)


@pytest.mark.slow
def test_a_camera_that_comes_off_is_named_and_let_go() -> None:
    """At 2 degrees the adjustment throws its sightings out: that gives it away."""
    model, scene = moving_world(loose_deg=(0, 0, 2.0), points=1500)
    found = rig_diagnostics(_rigid(model), scene, 1.0, Tuning(), model)
    assert found.moving == (0,) and 2 in found.unstable


@pytest.mark.slow
def test_resection_finds_the_lateness_of_one_camera() -> None:
    """Of three cameras one is late: in the true model it stands off by its offset times the speed."""
    model, scene = moving_world(late_s=(0, 0, LATE_S), points=1500)
    found = resect_all(model, scene, 1.0, Tuning())
    assert {h.name for h in sensor_diagnostics(found, scene, RIG.diagnostics)} == {"cam0", "cam1", "cam2"}
    poses = transforms.invert(image_poses(model, scene)[: scene.frames])  # cam0 is the rig
    motion = rig_motion(poses, scene)
    assert motion.timed
    own = found.where(scene.sensor_key[found.image] == 2)
    columns = motion.columns(scene.frame[own.image])
    moved = moved_in_time(own.residual(), own.covariance, columns)
    assert moved == pytest.approx(LATE_S * columns, rel=0.25)
    left = own.residual() - moved  # a constant: what the two others were dragged along by
    assert np.abs(left - np.median(left, axis=0))[:, :3].max() < 0.1 * LATE_S * np.abs(columns).max()


@pytest.mark.slow
def test_a_late_camera_is_relaxed() -> None:
    model, scene = moving_world(late_s=(0, 0, LATE_S), points=1500)
    rigid = _rigid(model)
    found = rig_diagnostics(rigid, scene, 1.0, Tuning())
    assert found.moving == (0,) and any("not synchronised" in note for note in found.notes)
    relaxed = calibrate_times(rigid, scene, 0, TrustedCalibration(1.0, True, [1, 2, 3]), Tuning())
    assert relaxed.offsets[2].offset_s == pytest.approx(LATE_S, rel=0.15)
    assert abs(relaxed.offsets[1].offset_s) < 0.1 * LATE_S
    assert relaxed.model.compute_mean_reprojection_error() < 0.9 * rigid.compute_mean_reprojection_error()
    assert relaxed.model.num_reg_images() == len(scene)
    # in the relaxed model the late camera stands where it really was: ahead, by up to 0.14 m at the end
    poses = image_poses(relaxed.model, scene)
    last = [scene.image_index[f"cam{s}/017.jpg"] for s in (0, 2)]
    apart = transforms.apply(poses[last[0]], transforms.centre(poses[last[1]])[None])[0]
    assert apart[2] - 0.1 == pytest.approx(LATE_S * 0.4 * 8.5, abs=0.04)


@pytest.mark.slow
def test_a_relaxed_calibrated_rig_keeps_its_rotations_though_the_lenses_are_not_as_told() -> None:
    """Distortion that the calibration leaves out must not turn the cameras; the offset is found all the same."""
    model, scene = moving_world(late_s=(0, 0, LATE_S), points=1500)
    for image_id in model.reg_image_ids():
        for point in model.image(image_id).points2D:
            ray = (point.xy - [400, 300]) / 400
            point.xy = point.xy + 400 * ray * 0.004 * (ray @ ray) + [0.6 * (ray[0] ** 2), 0.0]
    relaxed = calibrate_times(_rigid(model), scene, 0, TrustedCalibration(1.0, True, [1, 2, 3]), Tuning())
    assert relaxed.offsets[2].offset_s == pytest.approx(LATE_S, rel=0.25)
    poses = image_poses(relaxed.model, scene)
    for s in (1, 2):
        given = scene.rigs[0].sensors[s].sensor_from_rig
        turned = [
            float(transforms.angle_deg(poses[scene.image_index[f"cam{s}/{f:03d}.jpg"]][:3, :3]
                  @ poses[scene.image_index[f"cam0/{f:03d}.jpg"]][:3, :3].T, given[:3, :3]))
            for f in range(scene.frames)
        ]  # fmt: skip
        assert np.median(turned) < 0.2  # of it the car's own turn in the offset: 3 deg/s x 40 ms = 0.12 deg
