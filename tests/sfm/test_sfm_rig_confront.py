"""A rig as given against the images: cameras that fire apart, sit turned or have another lens are told apart."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import INTERVAL_S, LATE_S, Drive, driving_world, with_sync
from sfm_worlds import make_world

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.rig import rig_from_dict, rig_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.finish import FinishResult, finish_model
from tiegraph.sfm.rig.confront import PriorTest, open_times, prior_test
from tiegraph.sfm.rig.diagnostics import statements
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.rig import PriorTestTuning, RigTuning
from tiegraph.sfm.world.scale import rig_scale

CASES = {
    "as given": Drive(frames=16),
    "late": Drive(frames=16, late_s=LATE_S),
    "turned": Drive(frames=16, bent=(2, 0.5)),
    "zoomed": Drive(frames=16, zoom=(2, 1.01)),
    "3 % larger": Drive(frames=16, longer=1.03),
}


@cache
def _rigid(case: str) -> tuple[pycolmap.Reconstruction, Scene]:
    model, scene = driving_world(CASES[case])
    return final_adjustment(model, [1], range(1, 7), tuning=Tuning().adjust).model, scene


def _test(model: pycolmap.Reconstruction, scene: Scene, tuning: Tuning | None = None) -> PriorTest:
    test = prior_test(model, scene, 0, 1.0, tuning or Tuning())
    assert test is not None
    return test


WANTED = (
    ("as given", None), ("late", ("times", -1)), ("turned", ("mount", 2)), ("zoomed", ("lens", 2)), ("3 % larger", None)
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("case", "first"), WANTED)
def test_what_the_images_want_otherwise_is_told_apart(case: str, first: tuple[str, int] | None) -> None:
    model, scene = _rigid(case)
    test = _test(model, scene)
    if first is None:
        assert test.freed == ()  # a rig whose size alone is wrong contradicts no image
        assert statements(test, scene, 0).statements == ()
        return
    assert test.freed[0] == first
    if case == "late":
        late = [test.times_s()[s][0] for s in range(1, 6)]
        assert np.corrcoef(late, LATE_S[1:])[0, 1] > 0.95
        assert 0.7 * max(LATE_S) < max(late) < 2.5 * max(LATE_S)  # a first step from where all was bent
    else:
        said = statements(test, scene, 0).contradictions
        assert len(said) >= 1 and all("cam2" in line for line in said)


@pytest.mark.slow
def test_times_that_the_images_leave_open_are_said() -> None:
    """Six cameras that see each other's surfaces tell their times; one of them without such ties does not."""
    model, scene = _rigid("as given")
    assert open_times(_test(model, scene), scene.rigs[0]) == []
    test = _test(_without_shared_points(model, camera=4), scene)
    (said,) = open_times(test, scene.rigs[0])
    assert "whether cam3 fires" in said and "ms" in said and "synchronised = true" in said
    assert open_times(test, with_sync(scene).rigs[0]) == []


def _without_shared_points(model: pycolmap.Reconstruction, camera: int) -> pycolmap.Reconstruction:
    """Points that this camera and others see are left to the others."""
    out = pycolmap.Reconstruction(model)
    for key in list(out.point3D_ids()):
        seen = [(e.image_id, e.point2D_idx) for e in out.point3D(key).track.elements]
        own = [e for e in seen if out.image(e[0]).camera_id == camera]
        if own and len(own) < len(seen):
            for image, at in own:
                if out.exists_point3D(key):
                    out.delete_observation(image, at)
    return out


@pytest.mark.slow
def test_what_one_step_cannot_tell_is_said_without_figures() -> None:
    """A model 128 times too long (PandaSet, standing): cameras "turned by 4522 deg" and "829 m off"."""
    model, scene = _rigid("turned")
    near = PriorTestTuning(freed_deg=0.05, freed_lens=0.001)
    test = _test(model, scene, Tuning(rig=RigTuning(prior_test=near)))
    assert test.beyond == (2,) and test.freed == ()
    said = statements(test, scene, 0)
    assert said.statements == () and len(said.contradictions) == 1 and "(cam2)" in said.contradictions[0]


@pytest.mark.slow
def test_a_camera_that_stands_elsewhere_widens_the_scale_of_its_rig() -> None:
    """A file whose right camera is 40 mm too low; as given nothing is widened."""
    model, scene = _rigid("as given")
    rig = scene.rigs[0]
    pose = rig.sensors[1].sensor_from_rig
    assert pose is not None
    lever = float(np.linalg.norm(transforms.centre(pose)))
    moved = pose.copy()
    moved[:3, 3] -= pose[:3, :3] @ [0.0, 0.04, 0.0]
    sensors = tuple(replace(s, sensor_from_rig=moved) if k == 1 else s for k, s in enumerate(rig.sensors))
    wrong = scene.with_(rigs=(replace(rig, sensors=sensors, synchronised=True),))
    test = _test(model, wrong)
    assert ("mount", 1) in test.freed
    assert statements(test, wrong, 0).misfit == pytest.approx(0.04 / lever / np.sqrt(5), rel=0.4)
    assert statements(_test(model, scene), scene, 0).misfit == 0


def _finish(model: pycolmap.Reconstruction, scene: Scene, folder: Path, held: Held) -> FinishResult:
    (folder / "mapped").mkdir()
    model.write(folder / "mapped")
    request = FinishRequest(folder / "mapped", folder / "0", scene, Tuning(), held)
    return finish_model(request, lambda _: None)


def _finished(case: str, folder: Path, **more: object) -> tuple[FinishResult, pycolmap.Reconstruction, Scene]:
    model, scene = driving_world(CASES[case])
    finished = _finish(model, scene, folder, Held({0: "fixed"}, cameras=tuple(range(1, 7)), **more))
    return finished, pycolmap.Reconstruction(folder / "0"), scene


def _scale_off(model: pycolmap.Reconstruction, drive: Drive, metres_per_unit: float = 1.0) -> float:
    """By how much a scale is off on the way of the reference camera, as a share."""
    frames = (0, drive.frames - 1)
    found = np.diff([model.image(1 + 6 * f).projection_center() for f in frames], axis=0)
    true = np.diff([drive.pose_at(INTERVAL_S * f)[:3, 3] for f in frames], axis=0)
    return abs(metres_per_unit * float(np.linalg.norm(found) / np.linalg.norm(true)) - 1)


@pytest.mark.slow
def test_a_turned_camera_is_said_and_followed_the_others_stay(tmp_path: Path) -> None:
    finished, model, _ = _finished("turned", tmp_path)
    assert any("turn of cam2" in line for line in finished.contradictions)
    assert _scale_off(model, CASES["turned"]) < 0.004
    assert "given values and images compared" in finished.tables


@pytest.mark.slow
def test_what_the_user_orders_is_obeyed_and_the_contradiction_said(tmp_path: Path) -> None:
    finished, model, scene = _finished("late", tmp_path, ordered=True, lenses_ordered=True)
    assert any("as requested" in line and "fire at different times" in line for line in finished.contradictions)
    for identity, pose in model.rigs[1].non_ref_sensors.items():
        given = scene.rigs[0].sensors[identity.id - 1].sensor_from_rig
        np.testing.assert_allclose(pose.matrix(), given[:3], atol=1e-9)
    for key, camera in model.cameras.items():
        np.testing.assert_array_equal(camera.params, scene.rigs[0].sensors[key - 1].camera.params)


@pytest.mark.slow
def test_cameras_that_fire_apart_no_longer_set_the_scale(tmp_path: Path) -> None:
    finished, model, scene = _finished("late", tmp_path)
    assert any("has its own time" in note for note in finished.notes) and finished.contradictions == []
    found = rig_scale(model, image_poses(model, scene), scene, Tuning().world.scale)
    assert _scale_off(model, CASES["late"], found.metres_per_unit) < min(0.015, 3.3 * found.sigma)


def test_a_rig_said_to_be_synchronised_keeps_that_in_its_file() -> None:
    scene = with_sync(driving_world(Drive(frames=2))[1])
    assert rig_from_dict(rig_to_dict(scene.rigs[0])).synchronised
    assert not rig_from_dict({k: v for k, v in rig_to_dict(scene.rigs[0]).items() if k != "synchronised"}).synchronised


@pytest.mark.parametrize(
    ("wrong", "said"), [(1.0, ""), (1.02, "another lens than its calibration"), (1.3, "by so much that")]
)
def test_the_calibration_of_a_single_camera_is_confronted_too(tmp_path: Path, wrong: float, said: str) -> None:
    truth, scene = make_world(tmp_path / "database.db", cameras=1, frames=8, points=300)
    sensor = scene.rigs[0].sensors[0]
    given = pycolmap.Camera(sensor.camera.todict())
    given.params = [wrong * given.params[0], *given.params[1:]]
    rig = replace(scene.rigs[0], sensors=(replace(sensor, camera=given),))
    truth.camera(1).params = given.params
    finished = _finish(truth, scene.with_(rigs=(rig,)), tmp_path, Held(cameras=(1,)))
    assert [said in line for line in finished.contradictions] == ([True] if said else [])
    assert ("given values and images compared" in finished.tables) == (wrong == 1.02)
    np.testing.assert_array_equal(pycolmap.Reconstruction(tmp_path / "0").camera(1).params, given.params)  # as ordered
