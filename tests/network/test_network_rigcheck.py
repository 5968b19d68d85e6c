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
from network_steps import context_of
from tiegraph.features.preview import Preview, PreviewMatch, extract_preview, match_previews
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning
from tiegraph.features.tuning import Tuning as FeaturesTuning
from tiegraph.geometry import transforms
from tiegraph.network import rigcheck as check
from tiegraph.network import synchronisation as rigsync
from tiegraph.network.axes import predicted_shift
from tiegraph.network.passes import MatchCache
from tiegraph.network.rigcheck import check_rig, check_rigs, orders
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


def looked_at(scene: Scene, match, rig: Rig | None = None) -> tuple[Scene, str]:
    """The scene and what is said of it, after a look at its rig, or at another one in its place."""
    scene = scene if rig is None else scene.with_(rigs=(rig,))
    checked, notes = check_rigs(context_of(scene, match))
    return checked, "\n".join(notes)


@pytest.mark.parametrize("mirror, roll", [(False, 0), (True, 0), (False, 90), (True, 270), (False, 180)])
def test_wrong_presets_are_corrected(mirror: bool, roll: int) -> None:
    turn = Rotation.from_euler("z", roll, degrees=True).as_matrix() @ np.diag([-1.0 if mirror else 1.0, 1, 1])
    world = boat((10, 10), (2.0, 2.0))
    checked, said = looked_at(world.scene, world.match, changed(ring(), turn))
    # The camera that looks up shares nothing with the others: what hangs on it alone cannot be told.
    assert np.allclose(axes(checked.rigs[0])[:5], axes(ring())[:5], atol=1e-6)
    assert ("corrected" in said) == (mirror or roll > 0) != ("agree" in said)


@pytest.mark.parametrize("against", [0, 1])
def test_few_votes_that_chance_may_cast_correct_nothing(against: int, monkeypatch) -> None:
    """Six pairs that all move as in a mirrored rig prove one; five and one the other way do not (t = 2, 7 tries)."""
    wrong, places = changed(ring(), np.diag([-1.0, 1, 1])), np.arange(6)
    shift = predicted_shift(ring(), 0, 1) * np.where(places < against, -1.0, 1.0)[:, None]
    votes = check._Votes(np.zeros(6, int), np.ones(6, int), shift, np.full(6, np.nan), np.full((2, 6, 6), np.nan))
    monkeypatch.setattr(check, "_collect", lambda *_: votes)
    outcome = check_rig(context_of(boat((2,), (2.0,)).scene, lambda pairs: []), wrong, ())
    assert (outcome.rig is not wrong) == (not against)
    assert ("mirrored" in outcome.note) == (not against) and ("fit its axes badly" in outcome.note) == bool(against)


def test_too_few_matches_are_said_and_rigs_without_poses_left_alone() -> None:
    scene = boat((10,), (2.0,)).scene
    rig, context = ring(), context_of(scene, lambda pairs: [Result(3)] * len(pairs))
    outcome = check_rig(context, rig, context.passes)
    assert outcome.rig is rig and "could not be checked" in outcome.note
    world = boat((4,), (2.0,), ring(5))
    bare = Rig("rig", tuple(Sensor(s.name, s.camera) for s in ring().sensors))
    checked, said = looked_at(world.scene, world.match, bare)
    assert said == "" and checked.rigs[0] is bare


def test_swapped_stereo_cameras_are_found() -> None:
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[500.0, 320.0, 240.0])
    right, left = (transforms.rigid(np.eye(3), np.array([x, 0, 0])) for x in (-0.5, 0.5))
    rig = Rig("stereo", (Sensor("a", camera, np.eye(4)), Sensor("b", camera, left)), nominal=True)
    names, frame, sensor = (
        [f"{s}/{k}.jpg" for s in "ab" for k in range(10)],
        np.tile(np.arange(10), 2),
        np.repeat([0, 1], 10),
    )
    scene = simple_scene(rig, names, frame, sensor, np.zeros(10), sequences=("all",))
    # b stands right of a: things move to the left from a to b.
    checked, said = looked_at(scene, lambda pairs: [Result(80, np.eye(3), np.array([-0.05, 0.0]))] * len(pairs))
    assert np.allclose(checked.rigs[0].sensors[1].sensor_from_rig, right) and "corrected" in said


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
    checked, said = looked_at(world.scene, world.match, swapped(ring(), order))
    turn = relative(checked.rigs[0]) - relative(ring())
    assert np.allclose((turn + 180) % 360 - 180, 0, atol=1e-6)
    assert "corrected; check the rig file" in said and "correlation of matches and axes" in said
    assert ("match as if they were swapped" in said) == (order in (ORDERS[0], ORDERS[2]))
    assert world.asked <= 300


def test_a_new_reference_camera_takes_poses_and_antenna_along() -> None:
    world = boat((10, 10), (2.0, 2.0))
    rig = replace(swapped(ring(), [1, 0, 2, 3, 4, 5]), antenna_m=(0.5, -1.0, 2.0))
    pose = transforms.rigid(Rotation.from_euler("y", 30, degrees=True).as_matrix(), np.array([5.0, 6, 7]))
    poses = np.tile(pose, (world.scene.frames, 1, 1))
    poses[3, :3, :3] = np.nan  # a position alone
    checked, _ = looked_at(world.scene.with_(world_from_rig=poses), world.match, rig)
    new = checked.rigs[0]
    assert np.allclose(new.sensors[0].sensor_from_rig, np.eye(4))
    # Where the antenna and the camera that stays (cam2) are in the world does not change.
    both = (pose, rig), (checked.world_from_rig[0], new)
    assert np.allclose(*(transforms.apply(p, np.array([r.antenna_m])) for p, r in both))
    assert np.allclose(*(p @ transforms.invert(r.sensors[2].sensor_from_rig) for p, r in both))
    assert np.allclose(checked.world_from_rig[3, :3, 3], (5, 6, 7)) and np.isnan(checked.world_from_rig[3, 0, 0])


SWAP = "cam1 and cam2 match as if they were swapped"
WRONG = {"mirrored": changed(ring(), np.diag([-1.0, 1, 1])), SWAP: swapped(ring(), ORDERS[0])}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_calibrated_rig_is_told_of_and_kept(wrong: str) -> None:
    world, rig = boat((10, 10), (2.0, 2.0)), replace(WRONG[wrong], fixed=True)
    context = context_of(world.scene, world.match)
    outcome = check_rig(context, rig, context.passes)
    assert outcome.rig is rig
    assert all(words in outcome.note for words in (wrong, "it is calibrated", "not changed"))


def test_many_cameras_are_put_right_by_swaps() -> None:
    rig = ring(9, up=False)
    angle = rig.axis_angles_deg()
    evidence = np.tile(np.maximum(0, np.cos(np.radians(angle))), (2, 1, 1))
    assert orders(rig, evidence, TUNING.verdict) == []
    (found, *_) = orders(swapped(rig, [0, 1, 6, 3, 4, 5, 2, 7, 8]), evidence, TUNING.verdict)
    assert found.place == (0, 1, 6, 3, 4, 5, 2, 7, 8) and found.fit > 0.85
    assert orders(rig, np.full_like(evidence, np.nan), TUNING.verdict) == []


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


def ran(lag: int) -> str:
    return f"seems to run {abs(lag)} frame{'s' if abs(lag) > 1 else ''} {'late' if lag > 0 else 'early'}"


@pytest.mark.parametrize("late", [{}, {2: 1}, {2: 4}, {0: -3}, {1: 2, 3: -2}, {4: 6}])
def test_cameras_that_run_late_are_named_with_the_figure(late: dict[int, int]) -> None:
    """Of cameras in step nothing is said, and they are looked at in the same frame only."""
    scene, cache = lagging(late)
    _, said = looked_at(scene, cache)
    assert said.count("seems to run") == len(late) and (late or len(cache) <= 300)
    assert all(f"pass there0: cam{camera} {ran(lag)}" in said for camera, lag in late.items())


def test_evidence_without_fitting_motion_is_no_lag(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a camera sees two frames after another is no lag while things jump between them as the axes say now."""
    monkeypatch.setattr(rigsync, "_odd", lambda *_: True)
    scene, cache = lagging({2: 2})
    assert "cam2 seems to run 2" in looked_at(scene, cache)[1]
    late = np.where(scene.sensor == 2, 2, 0)

    def now(pairs: np.ndarray) -> list[Result]:
        shift = [np.array([0.06 * (late[j] - late[i]), 0.0]) for i, j in pairs.tolist()]
        return [r if r.shift is None else replace(r, shift=r.shift + s) for r, s in zip(cache._match(pairs), shift)]

    assert "seems to run" not in looked_at(scene, now)[1]


DEMO_CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=480, height=360, params=[0.48 * 480, 240, 180])


@cache
def _preview(path: Path) -> Preview:
    return extract_preview(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), None, PreviewSettings(), FeaturesTuning())


@cache
def _matched(a: Path, b: Path) -> PreviewMatch:
    return match_previews(_preview(a), _preview(b), DEMO_CAMERA, DEMO_CAMERA, PreviewSettings(), PreviewTuning())


def canal_demo() -> tuple[Scene, MatchCache]:
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
    frames = sorted({(n.split("/")[0], n.split("/")[2]) for n in names})
    place = {f: k for k, f in enumerate(frames)}
    tracks = sorted({f[0] for f in frames})
    frame = np.array([place[n.split("/")[0], n.split("/")[2]] for n in names])
    sensor = np.array([int(n.split("/")[1][3:]) for n in names])
    track = np.array([tracks.index(f[0]) for f in frames])
    step = np.array([int(f[1].split(".")[0]) for f in frames])
    scene = simple_scene(rig, names, frame, sensor, track, step, sequences=tuple(tracks))

    def match(pairs: np.ndarray) -> list:
        return [_matched(folder / "images" / names[i], folder / "images" / names[j]) for i, j in pairs.tolist()]

    return scene, MatchCache(match, len(scene))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda rig: rig, ""),
        (lambda rig: changed(rig, np.diag([-1.0, 1, 1])), "mirrored: it was corrected"),
        (lambda rig: swapped(rig, ORDERS[0]), SWAP),
    ],
    ids=["right", "mirrored", "swapped"],
)
def test_real_images_tell_a_wrong_rig(wrong, words: str) -> None:
    scene, cache = canal_demo()
    truth = scene.rigs[0]
    checked, said = looked_at(scene, cache, wrong(truth))
    assert np.allclose(axes(checked.rigs[0]), axes(truth), atol=1e-6)
    assert words in said and ("mirrored: it was corrected" in said) == words.startswith("mirrored")


@pytest.mark.slow
@pytest.mark.parametrize("camera, late", [(0, 2), (1, -2)])
def test_real_images_tell_a_camera_that_runs_late(camera: int, late: int) -> None:
    scene, cache = canal_demo()
    step, track = scene.sequence_index[scene.frame], scene.sequence[scene.frame]
    at = np.arange(len(scene))
    for k in np.flatnonzero(scene.sensor == camera):
        own = (scene.sensor == camera) & (track == track[k]) & (step == np.clip(step[k] - late, 0, step.max()))
        at[k] = np.flatnonzero(own)[0]
    lagged = MatchCache(lambda pairs: cache._match(at[pairs]), len(scene))
    _, said = looked_at(scene, lagged)
    assert said.count("seems to run") == 1 and f"cam{camera} {ran(late)}" in said
