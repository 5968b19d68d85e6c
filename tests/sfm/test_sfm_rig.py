"""The rig of a model: found from frames mapped without one, and a given one that the images contradict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world, write_database
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, run_sparse, without_extrinsics

from tiegraph.geometry import transforms
from tiegraph.geometry.align import l1_mean_rotation
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig, Source
from tiegraph.sfm.registrationreport import rig_doubts
from tiegraph.sfm.rig.diagnostics import camera_matches
from tiegraph.sfm.rig.rig import derive_rig
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.placement import AgreementTuning
from tiegraph.sfm.tuning.rig import CameraMatchesTuning, DeriveTuning
from tiegraph.sfm.verified import image_observations, read_verified


def test_l1_mean_ignores_a_third_of_outliers() -> None:
    rng = np.random.default_rng(0)
    true = Rotation.random(random_state=1)
    good = Rotation.from_rotvec(np.radians(0.3) * rng.standard_normal((20, 3))) * true
    bad = Rotation.from_rotvec(np.radians(60) * rng.standard_normal((10, 3))) * true
    mean = l1_mean_rotation(np.concatenate([good.as_matrix(), bad.as_matrix()]))
    assert 0 < transforms.angle_deg(mean, true.as_matrix()) < 0.4


def test_a_camera_that_moves_against_the_rig_is_left_out(tmp_path) -> None:
    """The truth with trivial frames, one camera shaken by 4 degrees: the others make the rig, it does not."""
    truth, scene = make_world(tmp_path / "database.db", cameras=3, frames=8)
    rng, shaken, model = np.random.default_rng(0), max(truth.cameras), pycolmap.Reconstruction()
    for camera in truth.cameras.values():
        model.add_camera_with_trivial_rig(camera)
    for i in truth.reg_image_ids():
        image, pose = truth.image(i), truth.image(i).cam_from_world()
        if image.camera_id == shaken:
            turn = Rotation.from_rotvec(np.radians(4) * rng.standard_normal(3)).as_matrix()
            pose = rigid3d(transforms.rigid(turn, np.zeros(3))) * pose
        fresh = pycolmap.Image(name=image.name, camera_id=image.camera_id, image_id=i)
        model.add_image_with_trivial_frame(fresh, pose)
    rig, said = derive_rig(without_extrinsics(scene), 0, [model], DeriveTuning())
    assert rig is not None and f"; left out: cam{shaken}: " in said and "not rigid" in said
    assert "extrinsics of 2 of 3 cameras" in said and rig.sensors[2].sensor_from_rig is None
    found = rig.sensors[1].sensor_from_rig
    np.testing.assert_allclose(found, scene.rigs[0].sensors[1].sensor_from_rig, atol=1e-6)


def test_too_few_frames_give_no_rig(tmp_path) -> None:
    truth, scene = make_world(tmp_path / "database.db", cameras=2, frames=2)
    rig, said = derive_rig(without_extrinsics(scene), 0, [truth], DeriveTuning())
    assert rig is None and "only 2 frames" in said


@pytest.mark.parametrize("late_s", [0.0, 0.6])
def test_two_cameras_that_fire_apart_are_told_by_their_matches(late_s: float, tmp_path: Path) -> None:
    model, scene = moving_world(late_s=(0.0, 0.0, late_s), frames=12, points=1500)
    write_database(model, tmp_path / "database.db")
    verified, seen = read_verified(tmp_path / "database.db", scene), image_observations(model, scene, AgreementTuning())
    rows, said = camera_matches(verified, seen, scene, CameraMatchesTuning())
    by = {(row[0], row[1]): row[3:] for row in rows}
    assert not by["cam0", "cam1"][2] and min(by["cam0", "cam1"][:2]) > 95
    assert by["cam0", "cam2"][2] == ("contradicts the model" if late_s else "")
    assert (by["cam0", "cam2"][0] < 70) == (late_s > 0)
    assert len(said) == (late_s > 0)
    assert all("cam2" in line and "fire at different times" in line for line in said)
    views = [replace(s, source=Source(panorama=True)) for s in scene.rigs[0].sensors]
    stitched = replace(scene, rigs=(replace(scene.rigs[0], sensors=tuple(views)),))
    assert camera_matches(verified, seen, stitched, CameraMatchesTuning())[1] == []
    alone = verified.where(scene.sensor[verified.pairs[:, 0]] == scene.sensor[verified.pairs[:, 1]])
    assert camera_matches(alone, seen, scene, CameraMatchesTuning()) == ([], []), "without ties they have no opinion"


def test_what_a_contradicted_rig_leaves_is_said() -> None:
    model, scene = moving_world(frames=2)
    assert rig_doubts(model, scene, [0], 6, 6, Tuning()) == []
    (few,) = rig_doubts(model, scene, [0], 3, 6, Tuning())
    assert "rig car was held as given" in few and "3 of 6" in few and "sparse.rig" in few
    assert rig_doubts(model, scene, [], 3, 6, Tuning()) == [], "a rig that is adjusted or absent is not the cause"
    camera = model.camera(3)
    camera.params = camera.params + np.array([0, 0, 400 * np.tan(np.radians(5.0)), 0])
    (turned,) = rig_doubts(model, scene, [0], 6, 6, Tuning())
    assert "camera cam2" in turned and "5.0 deg" in turned and "rig car" in turned
    assert rig_doubts(model, scene, [], 6, 6, Tuning()) == []


def _turned(rig: Rig) -> Rig:
    """Its last camera 10 degrees off."""
    *others, last = rig.sensors
    assert last.sensor_from_rig is not None
    off = transforms.rigid(orient(10.0, 0, 0), np.zeros(3)) @ last.sensor_from_rig
    return replace(rig, sensors=(*others, replace(last, sensor_from_rig=off)))


def _swapped(rig: Rig) -> Rig:
    """Its left camera where the right one is."""
    a, b, c = rig.sensors
    places = (c.sensor_from_rig, b.sensor_from_rig)
    return replace(rig, sensors=(a, *(replace(s, sensor_from_rig=p) for s, p in zip((b, c), places))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "frames", "points", "named"),
    [(_turned, 12, 2500, "camera cam2 is mounted differently"), (_swapped, 6, 1500, "rig car")],
)
def test_a_rig_that_contradicts_the_images_is_named(wrong, frames, points, named, tmp_path: Path) -> None:
    model, scene = moving_world(frames=frames, points=points)
    write_database(model, tmp_path / "database.db")
    result = run_sparse(tmp_path, scene.with_(rigs=(wrong(scene.rigs[0]),)), covariance_frames=0)
    assert any("contradict" in said and named in said for said in result.remarks.contradictions)
    lost = {name for name, _ in result.remarks.dropped}
    assert len(lost) == len(scene) - len(result.models[0].images), "every image that is lost has its reason"
