"""Which way is up in a model, and that it is drawn so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import UpTuning, levelled, up_vector

TUNING = UpTuning()
LEVEL = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)  # world_from_cam of a level camera that looks north


def _up(turns, cameras=1):
    """What images of ``cameras`` cameras, turned (N, 3, 3) world_from_cam and frame by frame, say of up."""
    frames = len(turns) // cameras
    poses = transforms.rigid(np.swapaxes(turns, 1, 2), np.zeros((len(turns), 3)))
    return up_vector(poses, np.repeat(np.arange(frames), cameras), TUNING)


def _off_deg(up):
    return np.degrees(np.arccos(min(1.0, up.direction[2])))


@pytest.mark.parametrize(("yaws", "ring"), [((80, -80), True), ((0, 180), True), ((0, 10), False), ((0, 60), False)])
def test_cameras_all_round_say_which_way_is_up(yaws: tuple[float, float], ring: bool) -> None:
    """Two that look away from each other do; of a stereo pair that drives in a circle only the x axes do."""
    for size in (0.0, 12.0):
        up = _up([
            Rotation.from_euler("ZXZ", [30.0 * f, size * (-1) ** (f // 2), yaws[k]], degrees=True).as_matrix() @ LEVEL
            for f in range(12) for k in range(2)
        ], cameras=2)  # fmt: skip
        assert up is not None and up.ring == ring and up.tilt and up.direction[2] > 0.99
        if ring:
            assert up.sigma_deg == pytest.approx(max(size, 3.0), rel=0.1)


def _held(headings_deg, pitch_deg, roll_deg, rng):
    """Photographs (N, 3, 3) world_from_cam: all pitched alike, rolled with a sigma."""
    rolls = roll_deg * rng.standard_normal(len(headings_deg))
    angles = [[h, pitch_deg, 0.0] for h in headings_deg]
    turned = Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix() @ LEVEL
    return turned @ Rotation.from_euler("z", rolls[:, None], degrees=True).as_matrix()


@pytest.mark.parametrize("pitch_deg", [25.0, 60.0, -50.0], ids=["up a facade", "up at a bridge", "down at a find"])
def test_photographs_held_level_say_which_way_is_up_however_they_are_pitched(pitch_deg: float) -> None:
    rng = np.random.default_rng(3)
    up = _up(_held(rng.uniform(-60, 60, 30), pitch_deg, 4.0, rng))
    assert up.tilt and not up.ring
    assert _off_deg(up) < min(4.0, 1.5 * up.sigma_deg) and 3.0 <= up.sigma_deg < 9.0


def test_photographs_of_one_heading_tell_the_roll_only_and_those_held_anyhow_nothing() -> None:
    rng = np.random.default_rng(4)
    facade = _up(_held(rng.uniform(-4, 4, 30), 10.0, 2.0, rng))
    assert not facade.tilt and 8 < _off_deg(facade) < 12 and facade.sigma_deg == TUNING.lone_sigma_deg
    assert _up(_held([0.0, 180.0] * 10, -90.0, 1.0, rng)) is None  # lines of a drone, to and fro
    assert _up(_held(rng.uniform(-180, 180, 30), -90.0, 1.0, rng)) is None  # straight down, or straight up?
    assert _up(Rotation.random(40, random_state=5).as_matrix()) is None


@pytest.mark.parametrize(("headings_deg", "pitch_deg", "most_deg"), [
    (np.linspace(-60, 60, 20), 30.0, 0.5), (np.tile([0.0, 180.0], 10), -90.0, 0.5),
    (np.tile([0.0, 180.0], 10), -60.0, 0.5), (np.linspace(-180, 180, 20), -90.0, 0.5),
    (np.linspace(-4, 4, 20), 10.0, 10.5),
], ids=["up a facade", "lines of a drone", "its camera pitched", "straight down, turning", "tops alone"])  # fmt: skip
def test_a_model_is_drawn_from_above_whatever_its_frame(headings_deg, pitch_deg: float, most_deg: float) -> None:
    turns = _held(headings_deg, pitch_deg, 0.2, np.random.default_rng(6))
    places = np.column_stack([np.arange(20.0), np.arange(20) % 3, np.zeros(20)])
    anyhow = transforms.rigid(Rotation.random(random_state=1).as_matrix(), np.array([3.0, -1, 2]))
    poses = transforms.invert(transforms.rigid(turns, places)) @ anyhow
    plan = levelled(np.concatenate([poses, np.full((1, 4, 4), np.nan)]), np.arange(21))
    assert np.linalg.det(plan[:3, :3]) == pytest.approx(1)
    up = (plan @ transforms.invert(anyhow))[2, :3]
    assert np.degrees(np.arccos(min(1.0, up[2]))) < most_deg
    drawn = transforms.apply(plan, transforms.centre(poses))
    assert np.ptp(drawn[:, 0]) > 5 * np.ptp(drawn[:, 1]) and drawn.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
