"""What holds a model and where it is weak; rolling shutters, found with an honest sigma or not seen."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from road_worlds import Sightings, drawn, sighted, write_database
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, true_frames, with_positions

from near import off_after_similarity, rms
from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.colmapmodel import Registration, model_rigs
from tiegraph.scene.graph import WeaklyTied
from tiegraph.scene.rig import Rig, Sensor, Source
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.sfm.finish import FinishResult, Readout, find_readout, finish_model, rows_in_time
from tiegraph.sfm.motion import Lateness, Motion, at_one_instant
from tiegraph.sfm.registrationreport import few_points, no_base, weakly_constrained
from tiegraph.sfm.rig.rig import place_as_given, ties_of, units_per_metre, unsupported_sensors
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.tuning import AdjustTuning, MappingTuning, ShutterTuning, Tuning
from tiegraph.sfm.tuning.rig import SupportTuning
from tiegraph.sfm.verified import ViewGraph

ENOUGH, SCALE = Tuning().adjust.enough_seen, Tuning().start.scale
TUNING = SupportTuning()


@pytest.fixture
def world(tmp_path):
    return make_world(tmp_path / "database.db")


@pytest.fixture
def everything(world):
    """All images are registered and see a hundred points."""
    return Registration(np.ones(len(world[1]), bool), np.full(len(world[1]), 100), 10)


def graph_of(scene, lonely: int):
    """Every image tied to its neighbours, but those of one sensor, of which a quarter have a single tie."""
    pairs = [(a, b) for a in range(len(scene)) for b in range(a + 1, min(a + 6, len(scene)))]
    pairs = [p for p in pairs if lonely not in scene.sensor[list(p)]]
    own = np.flatnonzero(scene.sensor == lonely)
    pairs += [(int(k), int(k) + 1) for k in own[: len(own) // 4]]
    ends = np.array(pairs)
    return SimpleNamespace(pairs=ends, degree=np.bincount(ends.ravel(), minlength=len(scene)))


def test_a_sensor_without_ties_is_found_and_its_ties_listed(world) -> None:
    scene = world[1]
    graph = graph_of(scene, lonely=2)
    assert unsupported_sensors(scene, graph, {0: "refined"}, TUNING) == (2,)
    assert unsupported_sensors(scene, graph, {0: "fixed"}, TUNING) == ()
    refused = ties_of(scene, graph, (2,))
    assert len(refused) == np.sum(scene.sensor == 2) // 4
    assert all(2 in scene.sensor[list(pair)] for pair in refused)


def test_scale_by_positions_and_by_baselines(world) -> None:
    truth, scene = world
    metric = with_positions(scene, 3.0 * true_frames(truth, scene)[:, :3, 3], 0.01)
    assert units_per_metre(truth, metric, SCALE) == pytest.approx(1 / 3, rel=0.02)
    assert units_per_metre(truth, scene, SCALE) == pytest.approx(1.0, rel=1e-6)


def test_its_place_is_as_given(world) -> None:
    truth, scene = world
    sensor = scene.rigs[0].sensors[1]
    moved = np.array(sensor.sensor_from_rig)
    moved[:3, 3] += 0.4
    sensors = (scene.rigs[0].sensors[0], replace(sensor, sensor_from_rig=moved), *scene.rigs[0].sensors[2:])
    given = scene.with_(rigs=(replace(scene.rigs[0], sensors=sensors),))
    metric = with_positions(given, true_frames(truth, scene)[:, :3, 3] / 2.0, 0.01)
    place_as_given(truth, metric, (1,), SCALE)
    found = model_rigs(truth, scene)[0].sensors
    assert np.allclose(found[1].sensor_from_rig[:3, :3], moved[:3, :3], atol=1e-9)
    assert np.allclose(found[1].sensor_from_rig[:3, 3], 2.0 * moved[:3, 3], rtol=0.02)
    assert np.allclose(transforms.centre(found[2].sensor_from_rig), transforms.centre(sensors[2].sensor_from_rig))


def test_what_little_holds_is_named() -> None:
    """Two cameras that see nothing together, ten frames: of cam1 the last four tie to each other only; a frame on few
    points; a whole camera that ties to no other is no island."""
    names = [f"cam{k}/{f:03d}.jpg" for f in range(10) for k in range(2)]
    sensors = tuple(Sensor(f"cam{k}", None, np.eye(4), "side") for k in range(2))
    frame, sensor = np.repeat(np.arange(10), 2), np.tile([0, 1], 10)
    scene = simple_scene(Rig("pair", sensors), names, frame, sensor, np.zeros(10), sequences=("way",))
    whole = SimpleNamespace(component=sensor.copy())
    seen = Registration(np.ones(20, bool), np.full(20, 100), 10)
    assert weakly_constrained(scene, whole, seen, (), ENOUGH) == []
    torn = SimpleNamespace(component=np.where((sensor == 1) & (frame > 5), 2, sensor))
    (said,) = weakly_constrained(scene, torn, seen, (), ENOUGH)
    assert said.startswith("4 images (cam1/006.jpg, cam1/007.jpg, cam1/008.jpg ...)") and "only the rig" in said
    half = np.where(sensor == 1, np.where(frame > 4, 2, 0), 0)  # as many as are left, which see what cam0 sees
    assert len(weakly_constrained(scene, SimpleNamespace(component=half), seen, (), ENOUGH)) == 1
    points = np.where(frame == 3, [5, 12] * 10, 100)
    found, weak = Registration(np.ones(20, bool), points, 10), (WeaklyTied((3,), 12), WeaklyTied((7, 8, 9), 31))
    by_rig, loose = weakly_constrained(scene, whole, found, weak, ENOUGH)
    assert by_rig.startswith("1 images see fewer than 10") and "cam0/003.jpg" in by_rig
    assert "place of 4 frames rests on fewer than 50 points that other frames see" in loose
    assert "(cam0/003.jpg: 12, cam0/007.jpg .. cam0/009.jpg (3 frames): 31)" in loose


@pytest.mark.slow
def test_frames_that_few_points_of_the_model_tie_to_the_rest(world, everything) -> None:
    """The last frames of a model see hardly any of the points that others see."""
    truth, scene = world
    assert few_points(truth, scene, everything, ENOUGH) == ()
    model, last = pycolmap.Reconstruction(truth), {scene.frames - 2, scene.frames - 1}
    tracks = [[(e.image_id, e.point2D_idx) for e in p.track.elements] for p in model.points3D.values()]
    for image_id, row in (end for track in tracks[30:] for end in track):
        image = model.image(image_id)
        if scene.frame[scene.image_index[image.name]] in last and image.point2D(row).has_point3D():
            model.delete_observation(image_id, row)
    weak = few_points(model, scene, everything, ENOUGH)
    assert {f for group in weak for f in group.frames} == last
    assert 0 < sum(group.points for group in weak) <= 60


@pytest.mark.slow
def test_points_of_two_images_hold_no_distance(world, everything) -> None:
    """A frame slides on the line to each of its neighbours without a residual, however many such points there are."""
    truth, scene = world
    model, last = pycolmap.Reconstruction(truth), scene.frames - 1
    frame = {i: scene.frame[scene.image_index[model.image(i).name]] for i in model.reg_image_ids()}
    for key in list(model.points3D):
        place, ends = model.point3D(key).xyz, [(e.image_id, e.point2D_idx) for e in model.point3D(key).track.elements]
        own, rest = ([e for e in ends if (frame[e[0]] == last) == side] for side in (True, False))
        if own and len(rest) > 2:
            model.delete_point3D(key)
            for part in ([own[0], rest[0]], rest[1:]):
                model.add_point3D(place, pycolmap.Track([pycolmap.TrackElement(*e) for e in part]))
    (weak,) = few_points(model, scene, everything, ENOUGH)
    assert weak.frames == (last,) and weak.points == 0


_WIDTH, _FOCAL = 1600, 1400.0


def _survey(folder: Path, step_m: float, turn_deg: float, flat: bool) -> tuple[Path, Scene]:
    """Photographs of a camera with a bent lens that steps and turns before points 8 to 30 m off, or all 20 m off."""
    rng = np.random.default_rng(1)
    given, true = (
        pycolmap.Camera(model=model, width=_WIDTH, height=1200, params=params)
        for model, params in (
            ("SIMPLE_PINHOLE", [1920.0, 800.0, 600.0]), ("SIMPLE_RADIAL", [_FOCAL, 800.0, 600.0, -0.03])
        )
    )  # fmt: skip
    depth = np.full(4000, 20.0) if flat else rng.uniform(8, 30, 4000)
    world = np.c_[rng.uniform(-2, 2, (4000, 2)), np.ones(4000)] * depth[:, None]

    def pose_at(number: float) -> np.ndarray:
        turn = Rotation.from_euler("y", turn_deg * number, degrees=True).as_matrix()
        return transforms.invert(transforms.rigid(turn, np.array([-step_m * number, 0.0, 0.0])))

    def sight(number: int, _: int) -> Sightings:
        return sighted(true, [transforms.invert(pose_at(number))] * 3, world, rng, far=np.inf, noise_px=0.5)

    model, scene = drawn(Rig("one", (Sensor("camera", given, np.eye(4)),)), np.arange(8.0), pose_at, world, sight)
    write_database(model, folder / "database.db", reach=8)
    return folder / "database.db", scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step_m", "turn_deg", "flat", "said"),
    [
        (0.0, 7.0, False, "rotated on the spot"),
        (0.0, 0.0, False, "nothing moves between the images"),
        (0.5, 7.0, False, ""),
        (1.5, 0.0, True, ""),  # a flight over a plane
        (0.2, 3.0, False, ""),
    ],
)
def test_a_turn_on_the_spot_is_told_from_steps(
    tmp_path: Path, step_m: float, turn_deg: float, flat: bool, said: str
) -> None:
    database, scene = _survey(tmp_path, step_m, turn_deg, flat)
    found = no_base(database, ViewGraph(database, scene, 15).pairs, scene, MappingTuning())
    assert said in found and bool(said) == bool(found)
    if turn_deg and said:
        times = re.search(r"focal length ([\d.]+) times", found)
        assert times is not None and float(times[1]) == pytest.approx(_FOCAL / _WIDTH, rel=0.1)


FPS, FRAMES, READOUT_S = 10.0, 30, 0.02
TUNING_SHUTTER, CONSTANTS = ShutterTuning(), Tuning()


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


@pytest.mark.slow
def test_velocity_and_turn_are_those_of_the_way_and_not_across_a_gap() -> None:
    model, scene = walk(0.0)
    time = scene.time_s + np.where(np.arange(FRAMES) >= 20, 100.0, 0.0)
    whole, cut = (Motion(model, s, TUNING_SHUTTER.max_gap_s) for s in (scene, scene.with_(time_s=time)))
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
    assert rows_in_time(model, scene, TUNING_SHUTTER) is not None
    assert rows_in_time(model, scene.with_(time_s=np.full(FRAMES, np.nan)), TUNING_SHUTTER) is None
    view = replace(scene.rigs[0].sensors[0], source=Source(panorama=(1, 0, 0, 0, 1, 0, 0, 0, 1)))
    views = replace(scene.rigs[0], sensors=(view,))
    assert rows_in_time(model, scene.with_(rigs=(views,)), TUNING_SHUTTER) is None  # their rows are not the camera's


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
    weak = Tuning(adjust=AdjustTuning(used_gain=0.5))
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
    assert found is not None and not found.there(TUNING_SHUTTER)
    assert found.gap_s == pytest.approx(1 / FPS) and found.gain < TUNING_SHUTTER.told_gain
    assert 0 < found.sigma < 0.001 and abs(found.seconds) < 4 * found.sigma
    assert not any("rolling" in n for n in finished(model, scene, tmp_path / "auto", None).notes)
    least = Readout(seconds=-0.02, sigma=0.003, gain=0.002, step=-0.01, gap_s=0.2)
    assert least.there(TUNING_SHUTTER) and str(least) == "-20.0 ms (sigma 3.0)"
    for change in ({"sigma": 0.0065}, {"gain": 0.0005}, {"seconds": 0.004, "sigma": 0.0001}, {"seconds": 0.2}):
        assert not replace(least, **change).there(TUNING_SHUTTER)
    assert not least.clear(CONSTANTS) and replace(least, gain=0.03).clear(CONSTANTS)
    assert not replace(least, gain=0.03, gap_s=0.5).clear(CONSTANTS)
    untimed = scene.with_(time_s=np.full(FRAMES, np.nan))
    notes = finished(model, untimed, tmp_path / "untimed", 20.0).notes
    assert any("readout_ms = 20 is not used: it needs frames of a pass with times" in n for n in notes)
