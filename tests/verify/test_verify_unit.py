"""A rough model in another unit than its rig: the lever arms are stretched to what pairs between cameras say."""

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.verify.prior import TOLERANCE_DEG, Prior, off_course_deg
from tiegraph.verify.unit import in_unit_of_rig, stretched

FRAMES = 8


def two_cameras(units: float, spoiled: bool = False):
    """A rig of two cameras 1 m apart, driven past points 8 to 20 m off, in a model of so many units a metre, its rig
    still in metres: pairs between the cameras of following frames, and what the program asks of them."""
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=100, height=100, params=[80.0, 50.0, 50.0])
    lever = transforms.rigid(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    rig = Rig("car", (Sensor("a", camera, np.eye(4), "side", "a"), Sensor("b", camera, lever, "side", "b")))
    frame, sensor = np.repeat(np.arange(FRAMES), 2), np.tile([0, 1], FRAMES)
    names = [f"{'ab'[s]}/{f}.jpg" for f, s in zip(frame, sensor)]
    order = np.argsort(names)
    scene = simple_scene(rig, [names[k] for k in order], frame[order], sensor[order], np.zeros(FRAMES, int),
                         np.arange(FRAMES))  # fmt: skip
    yaw = Rotation.from_euler("y", 4.0 * np.arange(FRAMES)[:, None], degrees=True).as_matrix()
    place = np.stack([0.1 * np.arange(FRAMES), np.zeros(FRAMES), 0.5 * np.arange(FRAMES)], axis=1)
    true, model = [], []
    for f, s in zip(scene.frame, scene.sensor):
        for out, scale in ((true, 1.0), (model, units)):
            body = transforms.rigid(yaw[f], scale * place[f])
            out.append([np.eye(4), lever][s] @ transforms.invert(body))
    points = np.random.default_rng(0).uniform((-6, -3, 8), (6, 3, 20), (60, 3))
    true, prior = np.stack(true), Prior(np.stack(model), np.tile(units * np.array([5.0, 20.0]), (len(scene), 1)))
    first, second = np.flatnonzero(scene.sensor == 0), np.flatnonzero(scene.sensor == 1)
    pairs = Pairs.make(np.repeat(first, FRAMES), np.tile(second, FRAMES), "offsets")

    def run_map(function, items, database, calibration, p: Prior) -> list[float]:
        return [share(i, j, p) for i, j in items]

    def share(i: int, j: int, p: Prior) -> float:
        seen = points[::-1] if spoiled else points
        rays = [transforms.apply(true[k], x) for k, x in ((i, points), (j, seen))]
        a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in rays)
        j_from_i = p.cam_from_world[j] @ transforms.invert(p.cam_from_world[i])
        return float(np.mean(off_course_deg(a, b, j_from_i, p.reach[i]) <= TOLERANCE_DEG))

    return scene, pairs, prior, run_map


def asked(world: tuple[Scene, Pairs, Prior, object]) -> tuple[np.ndarray, Prior, str, np.ndarray]:
    """Agreement before, the prior after, the note, agreement after."""
    scene, pairs, prior, run_map = world
    items = list(zip(pairs.i, pairs.j))
    before = np.array(run_map(None, items, "", None, prior))
    found, note = in_unit_of_rig(scene, pairs, before, "", prior, run_map)
    return before, found, note, np.array(run_map(None, items, "", None, found))


@pytest.mark.parametrize("units", [16.0, 0.2])
def test_a_model_in_another_unit_than_its_rig_is_found_out(units: float) -> None:
    before, _, note, after = asked(two_cameras(units))
    assert np.mean(before < 0.25) > 0.3
    assert np.mean(after < 0.25) < 0.05
    assert f"{units:.2g}"[0] in note and "lever arms" in note


def test_a_model_in_the_unit_of_its_rig_stays() -> None:
    world = two_cameras(1.0)
    before, found, note, _ = asked(world)
    assert (before > 0.9).all() and found is world[2] and note == ""


def test_false_pairs_stretch_nothing() -> None:
    world = two_cameras(1.0, spoiled=True)
    before, found, note, _ = asked(world)
    assert np.mean(before < 0.25) > 0.5 and found is world[2] and note == ""


def test_stretching_keeps_rotations_and_the_middle_of_a_frame() -> None:
    scene, _, prior, _ = two_cameras(1.0)
    far = stretched(prior, scene, 3.0)
    assert np.array_equal(far.cam_from_world[:, :3, :3], prior.cam_from_world[:, :3, :3])
    near, moved = (transforms.centre(p.cam_from_world) for p in (prior, far))
    for f in range(FRAMES):
        own = scene.frame == f
        assert np.allclose(near[own].mean(axis=0), moved[own].mean(axis=0))
        assert np.linalg.norm(np.diff(moved[own], axis=0)) == pytest.approx(
            3 * np.linalg.norm(np.diff(near[own], axis=0))
        )
