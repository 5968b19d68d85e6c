"""The sense of rotation and the roll of a rig, against synthetic and real images."""

import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from boat_world import Result, boat, ring
from tiegraph.features.preview import Preview, PreviewMatch, extract_preview, match_previews
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning
from tiegraph.features.tuning import Tuning as FeaturesTuning
from tiegraph.geometry import transforms
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.rig import check
from tiegraph.network.rig import synchronisation as rigsync
from tiegraph.network.rig.axes import predicted_shift
from tiegraph.network.rig.check import check_rig, check_rigs, orders
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS, TUNING = CandidatesSettings(), Tuning()
DATA = Path(os.environ.get("TIEGRAPH_DATA", "../shared/data"))


def changed(rig: Rig, change: np.ndarray) -> Rig:
    pose = transforms.rigid(change, np.zeros(3))
    back = np.linalg.inv(pose)
    return replace(rig, sensors=tuple(replace(s, sensor_from_rig=pose @ s.sensor_from_rig @ back) for s in rig.sensors))


def axes(rig: Rig) -> np.ndarray:
    return np.stack([s.optical_axis() for s in rig.sensors])


@pytest.mark.parametrize("mirror, roll", [(False, 0), (True, 0), (False, 90), (True, 270), (False, 180)])
def test_wrong_presets_are_corrected(mirror: bool, roll: int) -> None:
    turn = Rotation.from_euler("z", roll, degrees=True).as_matrix() @ np.diag([-1.0 if mirror else 1.0, 1, 1])
    world = boat((10, 10), (2.0, 2.0))
    scene = world.scene.with_(rigs=(changed(ring(), turn),))
    checked, notes = check_rigs(scene, find_passes(scene), MatchCache(world.match, len(scene)), SETTINGS, TUNING)
    # The camera that looks up shares nothing with the others: what hangs on it alone cannot be told.
    assert np.allclose(axes(checked.rigs[0])[:5], axes(ring())[:5], atol=1e-6)
    assert ("corrected" in notes[0]) == (mirror or roll > 0)
    if not mirror and not roll:
        assert "agree" in notes[0]


def test_a_calibrated_rig_is_told_of_and_kept() -> None:
    world = boat((10, 10), (2.0, 2.0))
    rig = replace(changed(ring(), np.diag([-1.0, 1, 1])), fixed=True)
    outcome = check_rig(rig, find_passes(world.scene), MatchCache(world.match, len(world.scene)), SETTINGS, TUNING)
    assert not outcome.changed and outcome.rig is rig
    assert "mirrored" in outcome.note and "kept" in outcome.note


@pytest.mark.parametrize("against", [0, 1])
def test_few_votes_that_chance_may_cast_correct_nothing(against: int, monkeypatch) -> None:
    """Six pairs that all move as in a mirrored rig prove one; five and one the other way do not (t = 2, 7 tries)."""
    wrong, places = changed(ring(), np.diag([-1.0, 1, 1])), np.arange(6)
    shift = predicted_shift(ring(), 0, 1) * np.where(places < against, -1.0, 1.0)[:, None]
    votes = check._Votes(np.zeros(6, int), np.ones(6, int), shift, np.full(6, np.nan), np.full((2, 6, 6), np.nan))
    monkeypatch.setattr(check, "_collect", lambda *_: votes)
    outcome = check_rig(wrong, (), MatchCache(lambda pairs: [], 0), SETTINGS, TUNING)
    assert outcome.changed == (not against)
    assert ("mirrored" in outcome.note) == (not against) and ("fit its axes badly" in outcome.note) == bool(against)


def test_too_few_matches_are_said() -> None:
    world = boat((10,), (2.0,))
    cache = MatchCache(lambda pairs: [Result(3) for _ in pairs], len(world.scene))
    outcome = check_rig(ring(), find_passes(world.scene), cache, SETTINGS, TUNING)
    assert not outcome.changed and "could not be checked" in outcome.note


def test_swapped_stereo_cameras_are_found() -> None:
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[500.0, 320.0, 240.0])
    right = transforms.rigid(np.eye(3), np.array([-0.5, 0, 0]))
    left = transforms.rigid(np.eye(3), np.array([0.5, 0, 0]))
    scene = simple_scene(
        Rig("stereo", (Sensor("a", camera, np.eye(4)), Sensor("b", camera, left)), nominal=True),
        [f"{s}/{k}.jpg" for s in "ab" for k in range(10)],
        np.tile(np.arange(10), 2),
        np.repeat([0, 1], 10),
        np.zeros(10),
        sequences=("all",),
    )
    # b stands right of a: things move to the left from a to b.
    cache = MatchCache(lambda pairs: [Result(80, np.eye(3), np.array([-0.05, 0.0])) for _ in pairs], len(scene))
    checked, notes = check_rigs(scene, find_passes(scene), cache, SETTINGS, TUNING)
    assert np.allclose(checked.rigs[0].sensors[1].sensor_from_rig, right)
    assert "corrected" in notes[0]


def test_rigs_without_poses_are_left_alone() -> None:
    world = boat((4,), (2.0,), ring(5))
    bare = Rig("rig", tuple(Sensor(s.name, s.camera) for s in ring().sensors))
    scene = world.scene.with_(rigs=(bare,))
    checked, notes = check_rigs(scene, find_passes(scene), MatchCache(world.match, len(scene)), SETTINGS, TUNING)
    assert notes == () and checked.rigs[0] is bare


def swapped(rig: Rig, order: list[int]) -> Rig:
    """The rig file with the poses of its cameras in another order."""
    poses = [rig.sensors[k].sensor_from_rig @ np.linalg.inv(rig.sensors[order[0]].sensor_from_rig) for k in order]
    return replace(rig, sensors=tuple(replace(s, sensor_from_rig=p) for s, p in zip(rig.sensors, poses)))


ORDERS = [[0, 2, 1, 3, 4, 5], [0, 2, 4, 1, 3, 5], [1, 0, 2, 3, 4, 5], [3, 0, 2, 1, 4, 5]]


def relative(rig: Rig) -> np.ndarray:
    """Angles of the side cameras' axes to those of the first one, about the vertical."""
    ahead = axes(rig)[:5]
    return np.degrees(np.arctan2(np.cross(ahead[0], ahead)[:, 1], ahead @ ahead[0]))


@pytest.mark.parametrize("order", ORDERS)
def test_cameras_in_another_order_are_put_right(order: list[int]) -> None:
    world = boat((10, 10), (2.0, 2.0))
    scene = world.scene.with_(rigs=(swapped(ring(), order),))
    checked, notes = check_rigs(scene, find_passes(scene), MatchCache(world.match, len(scene)), SETTINGS, TUNING)
    turn = relative(checked.rigs[0]) - relative(ring())
    assert np.allclose((turn + 180) % 360 - 180, 0, atol=1e-6)
    assert "corrected; check the rig file" in notes[0] and "correlation of matches and axes" in notes[0]
    assert ("tie as if they were swapped" in notes[0]) == (order in (ORDERS[0], ORDERS[2]))
    assert world.asked <= 300


def test_a_new_reference_camera_takes_poses_and_antenna_along() -> None:
    world = boat((10, 10), (2.0, 2.0))
    rig = replace(swapped(ring(), [1, 0, 2, 3, 4, 5]), antenna_m=(0.5, -1.0, 2.0))
    pose = transforms.rigid(Rotation.from_euler("y", 30, degrees=True).as_matrix(), np.array([5.0, 6, 7]))
    poses = np.tile(pose, (world.scene.frames, 1, 1))
    poses[3, :3, :3] = np.nan  # a position alone
    scene = world.scene.with_(rigs=(rig,), world_from_rig=poses)
    checked, _ = check_rigs(scene, find_passes(scene), MatchCache(world.match, len(scene)), SETTINGS, TUNING)
    new = checked.rigs[0]
    assert np.allclose(new.sensors[0].sensor_from_rig, np.eye(4))
    # Where the antenna and the camera that stays (cam2) are in the world does not change.
    old_in_world, new_in_world = (
        transforms.apply(p, np.array([r.antenna_m])) for p, r in ((pose, rig), (checked.world_from_rig[0], new))
    )
    assert np.allclose(old_in_world, new_in_world)
    stays = [
        p @ transforms.invert(r.sensors[2].sensor_from_rig) for p, r in ((pose, rig), (checked.world_from_rig[0], new))
    ]
    assert np.allclose(*stays)
    assert np.allclose(checked.world_from_rig[3, :3, 3], (5, 6, 7)) and np.isnan(checked.world_from_rig[3, 0, 0])


def test_a_calibrated_rig_in_another_order_is_told_of_and_kept() -> None:
    world = boat((10, 10), (2.0, 2.0))
    rig = replace(swapped(ring(), ORDERS[0]), fixed=True)
    outcome = check_rig(rig, find_passes(world.scene), MatchCache(world.match, len(world.scene)), SETTINGS, TUNING)
    assert not outcome.changed and outcome.rig is rig
    assert "cam1 and cam2 tie as if they were swapped" in outcome.note and "it is calibrated and kept" in outcome.note


def test_many_cameras_are_put_right_by_swaps() -> None:
    rig = ring(9, up=False)
    angle = rig.axis_angles_deg()
    evidence = np.tile(np.maximum(0, np.cos(np.radians(angle))), (2, 1, 1))
    assert orders(rig, evidence, TUNING.rig.order) == []
    (found, *_) = orders(swapped(rig, [0, 1, 6, 3, 4, 5, 2, 7, 8]), evidence, TUNING.rig.order)
    assert found.place == (0, 1, 6, 3, 4, 5, 2, 7, 8) and found.fit > 0.85
    assert orders(rig, np.full_like(evidence, np.nan), TUNING.rig.order) == []


def lagging(late: dict[int, int], frames: int = 20, flow: float = 0.06) -> tuple[Scene, MatchCache]:
    """A ring whose neighbours match best in the same moment; things move by ``flow`` of the image a frame."""
    world = boat((frames,), (1.5,))
    scene = world.scene
    step, sensor = scene.sequence_index[scene.frame], scene.sensor
    moment = step - np.array([late.get(int(s), 0) for s in sensor])

    def match(pairs: np.ndarray) -> list[Result]:
        out = []
        for i, j in pairs.tolist():
            turn = (sensor[j] - sensor[i]) % 5
            if turn not in (1, 4) or 5 in (sensor[i], sensor[j]):
                out.append(Result(9))
                continue
            apart = moment[j] - moment[i]
            sign = -1 if turn == 1 else 1
            out.append(Result(int(9 + 50 * 0.7 ** abs(apart)), None, np.array([sign * 0.7 + flow * apart, 0.0])))
        return out

    return scene, MatchCache(match, len(scene))


@pytest.mark.parametrize("late", [{2: 1}, {2: 4}, {0: -3}, {1: 2, 3: -2}, {4: 6}])
def test_cameras_that_run_late_are_named_with_the_figure(late: dict[int, int]) -> None:
    scene, cache = lagging(late)
    _, notes = check_rigs(scene, find_passes(scene), cache, SETTINGS, TUNING)
    said = [n for n in notes if "ties as if it ran" in n]
    assert len(said) == len(late)
    for camera, lag in late.items():
        frames = f"{abs(lag)} frame{'s' if abs(lag) > 1 else ''} {'late' if lag > 0 else 'early'}"
        assert any(n.startswith(f"pass there0: cam{camera} ties as if it ran {frames}") for n in said)


def test_cameras_in_step_are_looked_at_in_the_same_frame_only() -> None:
    scene, cache = lagging({})
    _, notes = check_rigs(scene, find_passes(scene), cache, SETTINGS, TUNING)
    assert not any("ties as if it ran" in n for n in notes)
    assert len(cache) <= 300


def test_evidence_without_fitting_motion_is_no_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a camera sees two frames after another is no lag while things jump between them as the axes say now."""
    monkeypatch.setattr(rigsync, "_odd", lambda *_: True)
    scene, cache = lagging({2: 2})
    assert any(
        "cam2 ties as if it ran 2" in n for n in check_rigs(scene, find_passes(scene), cache, SETTINGS, TUNING)[1]
    )
    late = np.where(scene.sensor == 2, 2, 0)

    def now(pairs: np.ndarray) -> list[Result]:
        shift = [np.array([0.06 * (late[j] - late[i]), 0.0]) for i, j in pairs.tolist()]
        return [r if r.shift is None else replace(r, shift=r.shift + s) for r, s in zip(cache._match(pairs), shift)]

    notes = check_rigs(scene, find_passes(scene), MatchCache(now, len(scene)), SETTINGS, TUNING)[1]
    assert not any("ties as if it ran" in n for n in notes)


DEMO_CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=480, height=360, params=[0.48 * 480, 240, 180])


@cache
def _preview(path: Path) -> Preview:
    return extract_preview(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), None, PreviewSettings(), FeaturesTuning())


@cache
def _matched(a: Path, b: Path) -> PreviewMatch:
    return match_previews(_preview(a), _preview(b), DEMO_CAMERA, DEMO_CAMERA, PreviewSettings(), PreviewTuning())


def canal_demo(mirrored: bool) -> tuple[Scene, MatchCache]:
    folder = DATA / "canal_demo"
    if not (folder / "images").is_dir():
        pytest.skip(f"{folder} not there")
    names = sorted(p.relative_to(folder / "images").as_posix() for p in (folder / "images").rglob("*.jpg"))
    table = json.loads((folder / "sensors" / "rig_nominal.json").read_text())
    poses = [
        transforms.from_quaternion_wxyz(np.array(p["cam_from_body_qwxyz"]), np.array(p["cam_from_body_t"]))
        for _, p in sorted(table.items())
    ]
    from_rig = [p @ np.linalg.inv(poses[0]) for p in poses]
    sensors = [Sensor(f"cam{k}", DEMO_CAMERA, from_rig[k], "up" if k == 5 else "side") for k in range(6)]
    rig = Rig("ladybug5", tuple(sensors), nominal=True)
    if mirrored:
        rig = changed(rig, np.diag([-1.0, 1, 1]))
    frames = sorted({(n.split("/")[0], n.split("/")[2]) for n in names})
    place = {f: k for k, f in enumerate(frames)}
    tracks = sorted({f[0] for f in frames})
    scene = simple_scene(
        rig,
        names,
        np.array([place[n.split("/")[0], n.split("/")[2]] for n in names]),
        np.array([int(n.split("/")[1][3:]) for n in names]),
        np.array([tracks.index(f[0]) for f in frames]),
        np.array([int(f[1].split(".")[0]) for f in frames]),
        sequences=tuple(tracks),
    )

    def match(pairs: np.ndarray) -> list:
        return [_matched(folder / "images" / names[i], folder / "images" / names[j]) for i, j in pairs.tolist()]

    return scene, MatchCache(match, len(scene))


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_real_images_tell_a_mirrored_preset(mirrored: bool) -> None:
    scene, cache = canal_demo(mirrored)
    truth = canal_demo(False)[0].rigs[0]
    checked, notes = check_rigs(scene, find_passes(scene), cache, SETTINGS, TUNING)
    assert np.allclose(axes(checked.rigs[0]), axes(truth), atol=1e-6)
    assert ("mirrored: corrected" in notes[0]) == mirrored


@pytest.mark.slow
@pytest.mark.parametrize("camera, late", [(0, 2), (1, -2), (3, 1)])
def test_real_images_tell_a_camera_that_runs_late(camera: int, late: int) -> None:
    scene, cache = canal_demo(False)
    step, track = scene.sequence_index[scene.frame], scene.sequence[scene.frame]
    at = np.arange(len(scene))
    for k in np.flatnonzero(scene.sensor == camera):
        own = (scene.sensor == camera) & (track == track[k]) & (step == np.clip(step[k] - late, 0, step.max()))
        at[k] = np.flatnonzero(own)[0]
    lagged = MatchCache(lambda pairs: cache._match(at[pairs]), len(scene))
    notes = check_rigs(scene, find_passes(scene), lagged, SETTINGS, TUNING)[1]
    frames = f"{abs(late)} frame{'s' if abs(late) > 1 else ''} {'late' if late > 0 else 'early'}"
    assert sum("ties as if it ran" in n for n in notes) == 1
    assert any(f"cam{camera} ties as if it ran {frames}" in n for n in notes)


@pytest.mark.slow
def test_real_images_tell_swapped_cameras() -> None:
    scene, cache = canal_demo(False)
    wrong = scene.with_(rigs=(swapped(scene.rigs[0], ORDERS[0]),))
    checked, notes = check_rigs(wrong, find_passes(scene), cache, SETTINGS, TUNING)
    assert np.allclose(axes(checked.rigs[0]), axes(scene.rigs[0]), atol=1e-6)
    assert "cam1 and cam2 tie as if they were swapped" in notes[0]
