"""A rigid, synchronised rig is called so; a loose camera is named and let go; a late one is named and timed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import INTERVAL_S, LATE_S, Drive, driving_world, moving_world

from near import off_after_similarity
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.rig import Source
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.covariance import position_sigma
from tiegraph.sfm.motion import Lateness, Motion, at_one_instant, in_their_time, let_go
from tiegraph.sfm.rig.confront import times_open
from tiegraph.sfm.rig.diagnostics import RigDiagnostics, rig_diagnostics, torn_off
from tiegraph.sfm.rigcheck import Checked, FinishRequest, Held, _let_go_of_loose, checked_rig
from tiegraph.sfm.tuning import Tuning

LATE = 0.04
TUNING = Tuning()


def _rigid(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    return final_adjustment(model, [1], list(model.cameras), tuning=TUNING.adjust).model


def _checked(
    model: pycolmap.Reconstruction, scene: Scene, rigid: pycolmap.Reconstruction | None = None, **more: object
) -> Checked:
    """``rigid``: the model adjusted with a rigid rig."""
    held = Held(**{"modes": {0: "fixed"}, "cameras": tuple(model.cameras), "lenses_ordered": True} | more)
    request = FinishRequest(Path("nowhere"), Path("nowhere"), scene, TUNING, held)
    return checked_rig(Checked(model=rigid or _rigid(model)), model, request)


def test_a_good_rig_keeps_its_places() -> None:
    model, scene = moving_world(points=1500)
    found = _checked(model, scene)
    assert found.notes == [] and found.contradictions == [] and found.late == {}
    rows = found.tables["rig diagnostics"]["rows"]
    assert [row[0] for row in rows] == ["cam0", "cam1", "cam2"]
    assert all(row[3] < 0.1 and row[4] is None and row[5] == "" for row in rows)


@pytest.mark.slow
def test_a_loose_camera_is_named_with_its_size_and_let_go() -> None:
    model, scene = moving_world(loose_deg=(0, 0, 0.2), points=1500)
    rigid = _rigid(model)
    found = rig_diagnostics(rigid, scene, (), 1.0, TUNING)
    assert set(found.loose) == {2} and "cam2 is not rigid" in found.notes(scene)[0]
    assert 0.1 < np.degrees(found.strays[2].turn) < 0.4  # of the frames that the adjustment did not throw out
    checked = _checked(model, scene, rigid)
    assert any("cam2: released from the rig" in note for note in checked.notes)
    alone = [checked.model.image(i) for i in checked.model.reg_image_ids() if checked.model.image(i).camera_id == 3]
    assert len(alone) == scene.frames and all(i.frame.rig_id == 4 for i in alone)
    assert checked.model.compute_mean_reprojection_error() < 0.8 * rigid.compute_mean_reprojection_error()


@pytest.mark.slow
def test_a_camera_that_comes_off_is_named() -> None:
    """At 2 degrees the adjustment throws its sightings out: that gives it away."""
    model, scene = moving_world(loose_deg=(0, 0, 2.0), points=1500)
    rigid = _rigid(model)
    torn = torn_off(model, rigid, scene, {}, TUNING.rig.diagnostics)
    assert 2 in torn and torn_off(model, model, scene, {}, TUNING.rig.diagnostics) == []
    assert 2 in rig_diagnostics(rigid, scene, torn, 1.0, TUNING).loose


def test_a_camera_is_not_let_go_where_images_would_lose_their_place(tmp_path: Path) -> None:
    model, scene = moving_world(frames=6)
    for k in range(6):
        image = model.find_image_with_name(f"cam2/{k:03d}.jpg")
        for row in image.get_observation_point2D_idxs()[10:]:
            model.delete_observation(image.image_id, row)
    poor = model.find_image_with_name("cam2/003.jpg")
    for row in poor.get_observation_point2D_idxs():
        poor.points2D[row].xy = poor.points2D[row].xy + np.random.default_rng(row).normal(0, 50, 2)
    request = FinishRequest(tmp_path, tmp_path, scene, TUNING, Held({0: "fixed"}, cameras=(1, 2, 3)))
    out = Checked(model=model)
    _let_go_of_loose(out, request, RigDiagnostics({}, {2: "it strays"}))
    assert out.model is model and any("stays as given" in c and "cam2/" in c for c in out.contradictions)
    ordered = replace(request, held=replace(request.held, ordered=True))
    _let_go_of_loose(out, ordered, RigDiagnostics({}, {2: "it strays"}))
    assert out.model is model and "as requested" in out.contradictions[-1]


@pytest.mark.slow
def test_views_of_one_picture_have_one_time_and_stay_together() -> None:
    model, scene = moving_world(loose_deg=(0, 0, 0.2), late_s=(0, 0, LATE), points=1500)
    views = [replace(s, source=Source(panorama=(1, 0, 0, 0, 1, 0, 0, 0, 1))) for s in scene.rigs[0].sensors]
    found = _checked(model, scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(views)),)))
    assert found.late == {} and not any("not held" in note for note in found.notes)


@pytest.mark.slow
def test_a_late_camera_has_its_time() -> None:
    model, scene = moving_world(late_s=(0, 0, LATE), points=1500)
    rigid = _rigid(model)
    found = _checked(model, scene, rigid)
    assert found.late[3] == pytest.approx(LATE, rel=0.05) and abs(found.late[2]) < 0.05 * LATE
    assert any("fire at different times" in n and "cam2 +40" in n for n in found.notes) and not found.contradictions
    assert found.tables["rig diagnostics"]["rows"][2][4] == pytest.approx(1000 * LATE, rel=0.05)
    released = in_their_time(found.model, Motion(found.model, scene, 3.0), Lateness(found.late), scene)
    # the late camera stands where it really was: ahead, by up to 0.14 m at the end
    poses = image_poses(released, scene)
    last = [scene.image_index[f"cam{s}/017.jpg"] for s in (0, 2)]
    apart = transforms.apply(poses[last[0]], transforms.centre(poses[last[1]])[None])[0]
    assert apart[2] - 0.1 == pytest.approx(LATE * 0.4 * 8.5, abs=0.01)
    told = _checked(model, scene, rigid, ordered=True)
    assert told.late == {} and any("held as requested" in c and "cam2 +" in c for c in told.contradictions)


@pytest.mark.slow
def test_a_calibrated_rig_keeps_its_rotations_though_the_lenses_are_not_as_told() -> None:
    """Distortion that the calibration leaves out must not turn the cameras; the offset is found all the same."""
    model, scene = moving_world(late_s=(0, 0, LATE), points=1500)
    for image_id in model.reg_image_ids():
        for point in model.image(image_id).points2D:
            ray = (point.xy - [400, 300]) / 400
            point.xy = point.xy + 400 * ray * 0.004 * (ray @ ray) + [0.6 * (ray[0] ** 2), 0.0]
    found = _checked(model, scene, lenses_ordered=False)
    assert found.late[3] == pytest.approx(LATE, rel=0.25)
    for sensor, pose in zip(scene.rigs[0].sensors[1:], found.model.rigs[1].non_ref_sensors.values()):
        np.testing.assert_allclose(pose.matrix(), sensor.sensor_from_rig[:3], atol=1e-9)


@pytest.mark.slow
def test_images_of_late_cameras_stand_where_they_were_and_know_how_well() -> None:
    """Six cameras that a lidar fires, over two drives: all images right to millimetres, and sigma and error agree."""
    stated, actual = [], []
    for drive in (Drive(late_s=LATE_S, frames=16), Drive(late_s=LATE_S, frames=16, gain=3.0, weave_deg=4.0)):
        mapped, scene = driving_world(drive)
        found = _checked(mapped, scene)
        late = np.array([found.late[k] for k in range(2, 7)])
        assert np.abs(late - LATE_S[1:]).max() < 0.003
        motion = Motion(found.model, scene, 3.0)
        placed = in_their_time(found.model, motion, Lateness(found.late), scene)
        there = []
        for frame, sensor in zip(scene.frame, scene.sensor):
            rig = drive.pose_at(INTERVAL_S * frame + drive.late_s[sensor])
            there.append(transforms.centre(scene.rigs[0].sensors[sensor].sensor_from_rig @ transforms.invert(rig)))
        here = transforms.centre(image_poses(placed, scene))
        actual.append(float(np.median(np.linalg.norm(off_after_similarity(here, np.stack(there)), axis=1))))
        times = motion, times_open(scene, True, TUNING.rig)
        stated.append(position_sigma(found.model, False, False, times=times, tuning=TUNING).median)
    assert max(actual) < 0.006
    assert 0.4 < np.median(np.array(stated) / actual) < 2.5, (stated, actual)


def test_key_points_and_images_go_to_one_instant_and_back() -> None:
    """The reprojection error of the one is that of the other, and cameras let go stand where they stood."""
    model, scene = moving_world(late_s=(0, 0, LATE), points=800)
    motion, late = Motion(model, scene, 3.0), Lateness({3: LATE})
    moved, placed = at_one_instant(model, model, motion, late), in_their_time(model, motion, late, scene)
    for one in (model, moved, placed):
        one.update_point_3d_errors()
    errors = [m.compute_mean_reprojection_error() for m in (model, moved, placed)]
    assert errors[0] > 1.5 * errors[1] and errors[1] == pytest.approx(errors[2], rel=1e-3)
    assert placed.num_reg_images() == len(scene) and placed.num_reg_frames() == 2 * scene.frames
    free = let_go(model, {3}, scene)
    np.testing.assert_allclose(image_poses(free, scene), image_poses(model, scene), atol=1e-12)
    assert free.num_reg_frames() == 2 * scene.frames and not free.rig(1).has_sensor(
        pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 3)
    )
