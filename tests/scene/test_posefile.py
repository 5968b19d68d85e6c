"""Files of poses: which column is which, and what no trajectory can be, said with file and line."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from said import refused, says
from tiegraph.geometry.transforms import rigid
from tiegraph.scene.posefile import read_poses

W_FIRST = [0, 1, 2, 3, 7, 4, 5, 6]
EUROC = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
START_NS = 1_403_636_580_838_555_648


def drive(frames: int = 20, turn_deg: float = 60.0, start_deg: float = 10.0) -> np.ndarray:
    """(F, 8) TUM rows of a level body that drives forward along an arc, 1 m and 1 s a frame."""
    yaw = np.radians(start_deg + np.linspace(0, turn_deg, frames))
    position = np.cumsum(np.stack([np.cos(yaw), np.sin(yaw), np.zeros(frames)], axis=1), axis=0)
    turn = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_quat()
    return np.column_stack([100 + np.arange(frames), position, turn])


def poses_of(rows: np.ndarray) -> np.ndarray:
    return rigid(Rotation.from_quat(rows[:, 4:]).as_matrix(), rows[:, 1:4])


def text_of(rows: np.ndarray, header: str = "", delimiter: str = " ", times: Sequence[object] = ()) -> str:
    lines = [[f"{v:.9f}" for v in row] for row in rows]
    lines = [[str(t), *cells[1:]] for t, cells in zip(times, lines)] if times else lines
    return "\n".join([header] * bool(header) + [delimiter.join(cells) for cells in lines]) + "\n"


def written(folder: Path, rows: np.ndarray, *how: str, **more: object) -> Path:
    path = folder / "a.tum"
    path.write_text(text_of(rows, *how, **more))
    return path


NANOSECONDS = [START_NS + k * 10**9 for k in range(20)]


AXES = [*(f"position.{c}" for c in "xyz"), *(f"orientation.{c}" for c in "xyzw")]
FIELDS = ",".join(["%time", *(f"field.pose.{axis}" for axis in AXES)])


@pytest.mark.parametrize(
    "header, order, delimiter",
    [
        ("", range(8), " "),
        ("# timestamp tx ty tz qx qy qz qw", range(8), " "),
        ("# time x y z qx qy qz qw", range(8), ","),
        ("# time x y z qw qx qy qz", W_FIRST, " "),
        ("timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z", W_FIRST, ","),
        ("time,pos_x,pos_y,pos_z,quat_w,quat_x,quat_y,quat_z", W_FIRST, ","),
        (FIELDS, range(8), ","),
        (EUROC.replace("[ns]", "[s]"), W_FIRST, ","),
        # unusual words
        ("# ts px py pz rw rx ry rz", W_FIRST, " "),
        ("#timestamp, tx, ty, tz, rot_w, rot_x, rot_y, rot_z", W_FIRST, ","),
        ("time x y z ow ox oy oz", W_FIRST, " "),
        ("Time [s],Pos X [m],Pos Y [m],Pos Z [m],Quat W,Quat X,Quat Y,Quat Z", W_FIRST, ","),
        ("t,px,py,pz,w,x,y,z", W_FIRST, ","),
    ],
)
def test_a_header_says_which_column_is_which(tmp_path: Path, header: str, order: list, delimiter: str) -> None:
    rows = drive()
    found = read_poses(written(tmp_path, rows[:, list(order)], header, delimiter))
    np.testing.assert_allclose(found.poses, poses_of(rows), atol=1e-7)
    np.testing.assert_allclose(found.time_s, rows[:, 0], atol=1e-6)
    assert [("w first" in n) for n in found.notes if "columns read" not in n] == [True] * (list(order) == W_FIRST)
    assert [("qw" in n) for n in found.notes if "columns read" in n] == [True] * bool(header)


@pytest.mark.parametrize(
    ("header", "more"),
    [(EUROC, 0), (EUROC + ",v_RS_R_x [m s^-1],b_w_RS_S_x [rad s^-1]", 2), ("", 0), ("", 9)],  # 17 columns
)
def test_euroc(tmp_path: Path, header: str, more: int) -> None:
    rows = drive()
    table = np.hstack([rows[:, W_FIRST], np.full((20, more), 0.01)])
    found = read_poses(written(tmp_path, table, header, ",", times=NANOSECONDS))
    np.testing.assert_allclose(found.poses, poses_of(rows), atol=1e-7)
    np.testing.assert_allclose(found.time_s - START_NS * 1e-9, np.arange(len(rows)), atol=1e-5)
    assert says(found.notes, "w first" if header else "EuRoC's table, quaternions with w first")


@pytest.mark.parametrize("turn_deg", [30.0, 90.0, -200.0])
def test_w_first_without_a_header_is_not_read_as_x_first(tmp_path: Path, turn_deg: float) -> None:
    rows = drive(turn_deg=turn_deg)
    np.testing.assert_allclose(read_poses(written(tmp_path, rows)).poses, poses_of(rows), atol=1e-7)
    with refused(r"a.tum, line 1: the order .* not sure: .*'# time x y z qw qx qy qz'"):
        read_poses(written(tmp_path, rows[:, W_FIRST]))


@pytest.mark.parametrize("order, words", [(list(range(8)), "w last"), (W_FIRST, "w first")])
@pytest.mark.parametrize("delimiter", [",", ";"])
def test_the_path_tells_the_order_between_commas(tmp_path: Path, order: list, words: str, delimiter: str) -> None:
    """By the direction of motion, and by a start without a turn."""
    drives, starts = drive(), drive(4, 1)
    starts[0] = [99, 0, 0, 0, 0, 0, 0, 1]
    for rows in (drives, starts):
        found = read_poses(written(tmp_path, rows[:, order], delimiter=delimiter))
        np.testing.assert_allclose(found.poses, poses_of(rows), atol=1e-7)
        assert len(found.notes) == 1 and f"quaternions with {words}: " in found.notes[0]


def test_an_order_that_nothing_tells_is_asked_for(tmp_path: Path) -> None:
    straight, wild = drive(30, 0.0), drive(40)
    rng = np.random.default_rng(5)
    wild[:, 1:4], wild[:, 4:] = rng.normal(0, 5, (40, 3)), Rotation.random(40, random_state=6).as_quat()
    for rows, order in product((straight, wild), (list(range(8)), W_FIRST)):
        with refused("a.tum, line 1: the order .* not sure: .*give it in a first line '# time"):
            read_poses(written(tmp_path, rows[:, order], delimiter=","))


def test_formats_whose_path_speaks_against_them_are_refused(tmp_path: Path) -> None:
    rows, header = drive(), "# time x y z qx qy qz qw"
    with refused("a.tum, line 1: .*EuRoC's table has w first, but with w last the body moves"):
        read_poses(written(tmp_path, rows, delimiter=",", times=NANOSECONDS))
    wrong = read_poses(written(tmp_path, rows[:, W_FIRST], header))
    assert says(wrong.notes, "is the header right about the order")
    right = read_poses(written(tmp_path, rows, header))
    assert right.notes == ("a.tum: columns read: time, x, y, z, qx, qy, qz, qw",)


def test_tum_with_nanoseconds_as_orb_slam_writes_it(tmp_path: Path) -> None:
    rows = drive()
    found = read_poses(written(tmp_path, rows, times=[f"{t}.000000" for t in NANOSECONDS]))
    np.testing.assert_allclose(found.poses, poses_of(rows), atol=1e-7)
    assert not found.notes


def test_a_header_that_is_not_understood_is_not_passed_over(tmp_path: Path) -> None:
    with refused("line 1: a header of other columns, '# time x y z q0 q1 q2 q3'; name them as"):
        read_poses(written(tmp_path, drive()[:, W_FIRST], "# time x y z q0 q1 q2 q3"))
    said = "# made by a program in the year 2024 again"  # as many words as columns
    assert len(read_poses(written(tmp_path, drive(), said)).poses) == 20


def test_other_ways_to_move_are_left_alone(tmp_path: Path) -> None:
    """A lawnmower that never turns, one that flies ahead, a hand that sways, a platform that stands."""
    rng = np.random.default_rng(1)
    rows = drive(40, 170)
    level = rows.copy()
    level[:, 4:] = [0, 0, 0, 1]
    sways = rows.copy()
    sways[:, 1:4] += rng.normal(0, 0.3, (40, 3))
    stands = rows.copy()
    stands[:, 1:4] = 0
    stands[:, 4:] = Rotation.from_euler("z", np.linspace(0, 350, 40)[:, None], degrees=True).as_quat()
    for table in (level, sways, stands):
        np.testing.assert_allclose(read_poses(written(tmp_path, table)).poses, poses_of(table), atol=1e-7)


def changed(row: int, column: int, value: float) -> np.ndarray:
    rows = drive()
    rows[row, column] = value
    return rows


ONE_TIME = drive()
ONE_TIME[:, 0] = 5
SAME = np.repeat(drive(1), 6, axis=0)
SAME[:, 0] = range(6)
ZERO = np.zeros((6, 8))
ZERO[:, 0], ZERO[:, 4] = range(6), 1
ZERO[1:, 1] = range(1, 6)


@pytest.mark.parametrize(
    "rows, message",
    [
        (changed(3, 1, 1e308), r"line 4: the position \(1e\+308, .* leave that pose out"),
        (changed(3, 2, 5e6), "line 4: the position .* 5e.03 km from the others"),
        (changed(3, 3, np.nan), "line 4: not a finite number"),
        (changed(3, 3, np.inf), "line 4: not a finite number"),
        (changed(3, 0, 1e300), "line 4: the time 1e.300 is none"),
        (changed(3, 5, 1e308), "line 4: the quaternion qx qy qz qw has length inf"),
        (changed(3, slice(4, 8), 0), "line 4: the quaternion qx qy qz qw has length 0"),
        (ONE_TIME, "line 2: all 20 rows have the time 5.00 s"),
        (SAME, "line 1: all 6 poses are the same"),
        (ZERO, "line 1: the order of the quaternions is not sure: the first pose is at zero with 1 0 0 0"),
        (drive()[:, :7], "line 1: 7 columns; expected 8"),
        (np.hstack([drive(), drive()[:, :1]]), "line 1: 9 columns; expected 8"),
        (b"\xff\xfe0\x00 \x00", "line 1: 1 columns; expected 8"),
        (b"\x89PNG\r\n\x1a\n\0", "is no text"),
        (b"", "no rows; give the trajectory"),
        (b"# time x y z qx qy qz qw\n", "no rows; give the trajectory"),
        (b"0 0 0 0 0 0 0 x\n", "line 1: not all cells are numbers"),
        (b"0 0 0 0 0 0 0 nan\n", "line 1: not a finite number"),
        (b"# x\n0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0\n", "line 3: 7 columns"),
        (b"time,east,north,up,roll,pitch,yaw,v\n0,1,2,3,4,5,6,7\n", "line 1: a header of other columns"),
        (b"# time x y z qx qy qz qw\n0 1 2 3 0 0 0 1 9\n", "line 2: 9 columns; expected 8"),
        (b"0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 0 1\n", "line 2: 9 cells below a header of 8"),
        (b"1 0 0 0 0 2 0 0 0 0 1 0\n", "line 1: .*not a rotation"),
        (b"-1 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: .* not a rotation"),
        (b"1e200 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: .* not a rotation"),
        (b"1 0 0 0 0 1 0 0 0 0 1 0\n" * 3, "line 1: all 3 poses are the same"),
    ],
)
def test_what_no_trajectory_can_be(tmp_path: Path, rows: np.ndarray | bytes, message: str) -> None:
    path = tmp_path / "a.tum"
    path.write_bytes(rows if isinstance(rows, bytes) else text_of(rows).encode())
    with refused(message, str(path)):
        read_poses(path)


def test_rows_out_of_order_and_doubled_times_are_said(tmp_path: Path) -> None:
    rows = drive()
    rows[[4, 5]] = rows[[5, 4]]
    rows[9, 0] = rows[8, 0]
    found = read_poses(written(tmp_path, rows))
    assert len(found.poses) == 19 and (np.diff(found.time_s) > 0).all()
    assert "a.tum, line 6: rows are not in time order" in found.notes[0]
    assert "a.tum, line 10: 1 rows have the time of another row" in found.notes[1]
