"""Rolling shutters: found with an honest sigma, taken out of the key points, and not seen where there are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import Sightings, drawn, sighted

from near import off_after_similarity, rms
from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.rig import Rig, Sensor, Source
from tiegraph.scene.scene import Scene
from tiegraph.sfm.finish import FinishResult, Readout, find_readout, finish_model, rows_in_time
from tiegraph.sfm.motion import Lateness, Motion, at_one_instant
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.tuning import ShutterTuning, Tuning

FPS, FRAMES, READOUT_S = 10.0, 30, 0.02
TUNING, CONSTANTS = ShutterTuning(), Tuning()


def pose_at(time_s: float) -> np.ndarray:
    """world_from_camera (4, 4) of a telephone carried along a facade at 1.2 m/s: it sways by a degree."""
    yaw, pitch, roll = (a * np.sin(w * time_s + p) for a, w, p in ((1.0, 4.4, 0), (0.7, 6.9, 1), (0.5, 5.7, 2)))
    place = np.array([1.2 * time_s, 0.03 * np.sin(9 * time_s), 0.3 * np.sin(0.4 * time_s)])
    return transforms.rigid(orient(yaw + 5 * np.sin(0.3 * time_s), pitch, roll), place)


def walk(readout_s: float) -> tuple[pycolmap.Reconstruction, Scene]:
    """True poses and points, key points as a rolling shutter sees them with 0.3 px of noise."""
    rng = np.random.default_rng(3)
    camera = pycolmap.Camera(model="PINHOLE", width=800, height=600, params=[600.0, 600.0, 400.5, 300.0], camera_id=1)
    camera.has_prior_focal_length = True
    points = rng.uniform([-5, -4, 4], [1.2 * FRAMES / FPS + 5, 4, 9], (500, 3))
    times, rig = np.arange(FRAMES) / FPS, Rig("telephone", (Sensor("telephone", camera, np.eye(4)),))

    def sight(f: int, s: int) -> Sightings:
        rows = (transforms.invert(pose_at(f / FPS + readout_s * k)) for k in (-0.5, 0.0, 0.5))
        return sighted(camera, list(rows), points, rng)

    model, scene = drawn(rig, times, pose_at, points, sight)
    model.update_point_3d_errors()
    return model, scene


def finished(
    model: pycolmap.Reconstruction, scene: Scene, folder: Path, given_ms: float | None, tuning: Tuning = CONSTANTS
) -> FinishResult:
    """The stage's own finishing of the model, into ``folder``/0."""
    source = folder / "mapped"
    source.mkdir(parents=True)
    model.write(source)
    held = Held(cameras=(1,), readout_ms=given_ms)
    sigmas = 0 if given_ms == 0 else 100  # of frames: they tell that of the shutter
    request = FinishRequest(source, folder / "0", scene, tuning, held, covariance_frames=sigmas)
    return finish_model(request, lambda _: None)


def ate_mm(folder: Path) -> float:
    """Of the model in ``folder``/0, after the best similarity."""
    model = pycolmap.Reconstruction(folder / "0")
    found = np.array([model.image(f + 1).projection_center() for f in range(FRAMES)])
    true = np.array([pose_at(f / FPS)[:3, 3] for f in range(FRAMES)])
    return 1000 * rms(off_after_similarity(found, true))


def test_velocity_and_turn_are_those_of_the_way_and_not_across_a_gap() -> None:
    model, scene = walk(0.0)
    time = scene.time_s + np.where(np.arange(FRAMES) >= 20, 100.0, 0.0)
    whole, cut = (Motion(model, s, TUNING.max_gap_s) for s in (scene, scene.with_(time_s=time)))
    assert all(f + 1 in motion for motion in (whole, cut) for f in range(FRAMES))
    step = 1e-4
    for f in (5, 12, 25):
        before, after = pose_at(f / FPS - step), pose_at(f / FPS + step)
        velocity = (after[:3, 3] - before[:3, 3]) / (2 * step)
        turn = (after[:3, :3] - before[:3, :3]) @ pose_at(f / FPS)[:3, :3].T / (2 * step)
        true = np.concatenate([velocity, [turn[2, 1], turn[0, 2], turn[1, 0]]])
        near = 0.03 * float(np.linalg.norm(true))
        np.testing.assert_allclose(whole.rate(f + 1), true, rtol=0, atol=near)
        np.testing.assert_allclose(cut.rate(f + 1), true, rtol=0, atol=near)
    assert np.linalg.norm(cut.rate(20)[:3]) > 1.0  # at the gap itself: from its own side
    assert rows_in_time(model, scene, TUNING) is not None
    assert rows_in_time(model, scene.with_(time_s=np.full(FRAMES, np.nan)), TUNING) is None
    view = replace(scene.rigs[0].sensors[0], source=Source(panorama=(1, 0, 0, 0, 1, 0, 0, 0, 1)))
    views = replace(scene.rigs[0], sensors=(view,))
    assert rows_in_time(model, scene.with_(rigs=(views,)), TUNING) is None  # their rows are not the camera's


@pytest.mark.slow
def test_key_points_go_to_where_the_middle_row_sees_them() -> None:
    model, scene = walk(READOUT_S)
    assert 0.8 < model.compute_mean_reprojection_error()
    out = at_one_instant(model, model, Motion(model, scene, 3.0), Lateness({}, READOUT_S))
    out.update_point_3d_errors()
    assert 0.36 < out.compute_mean_reprojection_error() < 0.40  # 0.3 px in both coordinates
    again = at_one_instant(out, model, Motion(model, scene, 3.0), Lateness({}, -READOUT_S))
    moved = [a.xy - b.xy for a, b in zip(again.image(3).points2D, model.image(3).points2D)]
    assert 0 < np.abs(moved).max() < 0.1  # the row itself has moved a little


@pytest.mark.slow
def test_a_shutter_is_found_and_taken_out(tmp_path: Path) -> None:
    model, scene = walk(READOUT_S)
    found = finished(model, scene, tmp_path / "auto", None)
    told = next(n for n in found.notes if n.startswith("rolling shutter of ")).split()
    seconds, sigma = float(told[3]) / 1000, float(told[6].strip("),")) / 1000
    assert 0 < sigma < 0.0005 and abs(seconds - READOUT_S) < 3 * sigma
    given = finished(model, scene, tmp_path / "given", 1000 * READOUT_S)
    assert any("20 ms as given" in n for n in given.notes)
    weak = Tuning(shutter=ShutterTuning(used_gain=0.5))
    left = finished(model, scene, tmp_path / "told", None, weak)
    assert any("would explain the images better" in n and "--sparse.readout-ms 2" in n for n in left.notes)
    finished(model, scene, tmp_path / "global", 0)
    true, scene = walk(0.0)
    finished(true, scene, tmp_path / "true", 0)
    bent, best = ate_mm(tmp_path / "global"), ate_mm(tmp_path / "true")
    assert ate_mm(tmp_path / "told") == pytest.approx(bent) and 0.2 < best < 1.5 and bent > 3 * best
    assert all(ate_mm(tmp_path / name) < 1.5 * best for name in ("auto", "given"))


@pytest.mark.slow
def test_a_global_shutter_stays_one(tmp_path: Path) -> None:
    model, scene = walk(0.0)
    found = find_readout(model, scene, (), CONSTANTS)
    assert found is not None and not found.there(TUNING)
    assert found.gap_s == pytest.approx(1 / FPS) and found.gain < TUNING.told_gain
    assert 0 < found.sigma < 0.001 and abs(found.seconds) < 4 * found.sigma
    assert not any("rolling" in n for n in finished(model, scene, tmp_path / "auto", None).notes)
    least = Readout(seconds=-0.02, sigma=0.003, gain=0.002, step=-0.01, gap_s=0.2)
    assert least.there(TUNING) and str(least) == "-20.0 ms (sigma 3.0)"
    for change in ({"sigma": 0.005}, {"gain": 0.0005}, {"seconds": 0.004, "sigma": 0.0001}, {"seconds": 0.2}):
        assert not replace(least, **change).there(TUNING)
    assert not least.clear(TUNING) and replace(least, gain=0.03).clear(TUNING)
    assert not replace(least, gain=0.03, gap_s=0.5).clear(TUNING)
    untimed = scene.with_(time_s=np.full(FRAMES, np.nan))
    notes = finished(model, untimed, tmp_path / "untimed", 20.0).notes
    assert any("readout_ms = 20 is not used: it needs frames of a pass with times" in n for n in notes)
