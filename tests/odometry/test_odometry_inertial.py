"""An inertial unit: its file, what is learnt of it, and its residuals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry.odometry_world import measured, stereo, truth, unit_axes
from odometry.test_odometry_covariance import KEYFRAMES, world_of
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.odometry.adjust import adjust
from tiegraph.odometry.inertial import Inertial, TurnPrior, UpPrior
from tiegraph.odometry.tuning import InertialTuning, Tuning
from tiegraph.scene.imufile import read_imu

BIAS = (0.02, -0.01, 0.015)
FRAMES = 40


def learnt(axes=None):
    """A unit that was shown the true turns of a drive, with a noise of half a hundredth of a degree."""
    unit = Inertial(measured(FRAMES, BIAS), {f: f / 10 for f in range(FRAMES)}, axes, InertialTuning())
    rng = np.random.default_rng(1)
    for frame in range(FRAMES - 1):
        noise = Rotation.from_rotvec(rng.normal(0, 1e-4, 3)).as_matrix()
        unit.learn(frame, frame + 1, noise @ turned(frame, frame + 1))
    return unit


def turned(first, second):
    return truth(second)[:3, :3].T @ truth(first)[:3, :3]


@pytest.mark.slow
def test_axes_and_bias_are_found_and_the_turn_is_as_good_as_its_sigma():
    unit = learnt()
    assert unit.known
    assert 1e-3 < np.radians(transforms.angle_deg(unit.rig_from_imu, unit_axes().T)) < 4 * unit.axes_sigma_rad
    assert 1e-5 < np.abs(unit.bias - BIAS).max() < 2e-3
    rotation, sigma = unit.turn(0, 20)
    off = np.radians(transforms.angle_deg(rotation, turned(0, 20)))
    assert 1e-5 < off < 3 * sigma < 0.05


@pytest.mark.slow
def test_up_is_found_while_the_head_sways():
    unit = learnt(unit_axes().T)
    for frame in (5, 20, 30):
        found, sigma = unit.up(frame)
        off = np.arccos(found @ truth(frame)[2, :3])
        assert 1e-4 < off < 3 * sigma < 0.5
    assert unit.up(FRAMES + 100) is None


@pytest.mark.slow
def test_a_turn_about_one_axis_tells_nothing():
    unit = Inertial(measured(FRAMES, BIAS), {f: f / 10 for f in range(FRAMES)}, None, InertialTuning())
    for frame in range(FRAMES - 1):
        vector = Rotation.from_matrix(turned(frame, frame + 1)).as_rotvec()
        unit.learn(frame, frame + 1, Rotation.from_rotvec([0, vector[1] + 0.01 * frame, 0]).as_matrix())
    assert not unit.known and unit.turn(0, 1) is None and unit.up(10) is None


@pytest.mark.slow
def test_a_turn_prior_holds_the_turn_and_not_the_way():
    world, _ = world_of(stereo(), 2)
    first, last = KEYFRAMES - 2, KEYFRAMES - 1
    known = Rotation.from_rotvec([0.004, -0.003, 0.005]).as_matrix() @ between(world, first, last)[:3, :3]
    way = between(world, first, last)[:3, 3]
    for sigma, low, high in ((1e-7, 0, 1e-4), (10.0, 5e-3, 1)):
        moved, _ = world_of(stereo(), 2)
        adjusted(moved, ([TurnPrior(first, last, known, sigma)], ()))
        made = between(moved, first, last)
        assert low <= np.radians(transforms.angle_deg(made[:3, :3], known)) < high
        assert np.linalg.norm(made[:3, 3] - way) < 0.1


@pytest.mark.slow
def test_an_up_prior_holds_the_lean_and_not_the_heading():
    world, poses = world_of(stereo(), 2)
    last = KEYFRAMES - 1
    in_world = np.array([0, -1.0, 0])
    tilted = Rotation.from_rotvec([0.005, 0.0, 0.0]).as_matrix() @ poses[-1][:3, :3] @ in_world
    adjusted(world, ((), [UpPrior(last, tilted, in_world, 1e-4)]))
    made = world.keyframes[last].rig_from_world[:3, :3]
    assert np.linalg.norm(made @ in_world - tilted) < 3e-4
    heading = Rotation.from_matrix(made @ poses[-1][:3, :3].T).as_rotvec() @ tilted
    assert abs(heading) < 2e-3


def adjusted(world, priors):
    tuning = Tuning().map
    numbers = list(range(KEYFRAMES))
    adjust(world, numbers, [0], tuning, loss_px=1.0, iterations=50, priors=priors)


def between(world, first, second):
    poses = [world.keyframes[k].rig_from_world for k in (first, second)]
    return poses[1] @ transforms.invert(poses[0])


# --- the file -------------------------------------------------------------------------------------------------------

HEAD = "time,gx,gy,gz,ax,ay,az"
ROWS = [f"{k / 10},0.1,0,0,0,0,9.8" for k in range(20)]


def written(tmp_path, rows, head=HEAD):
    path = tmp_path / "imu.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def test_tables_with_other_names_are_read(tmp_path):
    plain = read_imu(written(tmp_path, ROWS))
    head = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y,w_RS_S_z,a_RS_S_x [m s^-2],a_RS_S_y,a_RS_S_z"
    rows = [f"{k * 10**8},0.1,0,0,0,0,9.8" for k in range(20)]
    euroc = read_imu(written(tmp_path, rows, head))
    assert np.allclose(plain.time_s, euroc.time_s) and plain.time_s[1] == 0.1
    assert (plain.rate == euroc.rate).all() and (plain.force == euroc.force).all() and plain.rate[3, 0] == 0.1


@pytest.mark.parametrize(
    ("rows", "head", "said"),
    [
        (ROWS, "time,gx,gy,ax,ay,az,b", "no column 'gz'.*form is time,gx"),
        ([*ROWS[:4], "0.4,x,0,0,0,0,9.8", *ROWS[5:]], HEAD, "line 6: a value is missing"),
        ([*ROWS, "0.5,0,0,0,0,0,9.8"], HEAD, "line 22: time 0.5.* increase"),
        ([*ROWS, "3,90,0,0,0,0,9.8"], HEAD, "line 22: a rate of 90 rad/s: are these degrees"),
        ([r.replace("9.8", "1.0") for r in ROWS], HEAD, "length of 1,.*not g"),
        (ROWS[:3], HEAD, "3 rows"),
    ],
)
def test_wrong_tables_are_refused_with_their_line(tmp_path, rows, head, said):
    with pytest.raises(InputError, match=said):
        read_imu(written(tmp_path, rows, head))
