"""Bags of ROS and files of poses: places, poses and pictures to the last digit; what is wrong is said by name."""

from __future__ import annotations

import os
import shutil
import sqlite3
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from scipy.spatial.transform import Rotation

import bag_world as world
from bag_world import FORMS, START_S
from said import refused, says
from tiegraph.errors import EngineMissing
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.priors.trajectory import read_trajectory
from tiegraph.scan.videos.bagfilms import KINDS, bgr, unread
from tiegraph.scene.bags import is_bag, open_bag, shown, split_topics
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.posefile import read_poses

COUNT = 5
TIMES = START_S + 0.123456789 + 0.5 * np.arange(COUNT)
LLH = np.array([[35.69 + 1e-5 * k, 139.77 - 2e-5 * k, 40.0 + 0.125 * k] for k in range(COUNT)])
TURNS = Rotation.from_euler("zyx", [[20.0 + 9 * k, 5, -3] for k in range(COUNT)], degrees=True)
PLACES = np.array([[1.5 * k, 0.2 * k * k, 0.1] for k in range(COUNT)])


def fixes(topic: str = "/gps/fix", **how: object) -> list[world.Row]:
    return [world.fix(topic, t, p, **how) for t, p in zip(TIMES, LLH)]


def odometry(topic: str = "/odom") -> list[world.Row]:
    return [world.odometry(topic, *row) for row in zip(TIMES, PLACES, TURNS.as_quat())]


# --- positions ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_fixes_have_the_time_of_their_header_and_the_sigmas_of_their_covariance(tmp_path: Path, form: str) -> None:
    rows = fixes(sigma_m=(0.02, 0.03, 0.05)) + [world.fix("/gps/fix", TIMES[0] + 0.1, (0, 0, 0), status=-1)]
    found = read_gnss(world.bag(tmp_path, form, rows))
    assert np.array_equal(found.lat_lon_height, LLH)
    np.testing.assert_allclose(found.time_s, TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.sigma_m, np.tile([0.02, 0.03, 0.05], (COUNT, 1)))
    assert "/gps/fix (sensor_msgs/NavSatFix, 6); 1 of them without a fix are left out" in found.notes[0]


def test_a_covariance_that_is_not_known_gives_no_sigma_and_a_header_without_a_stamp_the_receipt(tmp_path: Path) -> None:
    rows = [world.fix("/fix", 0.0, p) for p in LLH]
    rows = [world.Row(r.topic, r.kind, t, r.built) for r, t in zip(rows, TIMES)]
    found = read_gnss(world.bag(tmp_path, "ros1", rows))
    assert np.isnan(found.sigma_m).all()
    np.testing.assert_allclose(found.time_s, TIMES, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "form, packed",
    [
        ("ros1", (world.rosbag1.Writer.CompressionFormat.LZ4,)),
        ("ros1", (world.rosbag1.Writer.CompressionFormat.BZ2,)),
        ("sqlite", (CompressionMode.FILE, CompressionFormat.ZSTD)),
        ("sqlite", (CompressionMode.MESSAGE, CompressionFormat.ZSTD)),
        ("mcap", (CompressionMode.STORAGE, CompressionFormat.ZSTD)),
    ],
)
def test_compressed_bags_are_read(tmp_path: Path, form: str, packed: tuple) -> None:
    found = read_gnss(world.bag(tmp_path, form, fixes(), packed=packed))
    assert np.array_equal(found.lat_lon_height, LLH)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_of_several_topics_one_is_named(tmp_path: Path, form: str) -> None:
    more = [world.fix("/rtk/fix", t, p + [0, 0, 1]) for t, p in zip(TIMES, LLH)]
    path = world.bag(tmp_path, form, fixes() + more + odometry())
    for name in ("/rtk/fix", "rtk/fix"):
        assert np.array_equal(read_gnss(Path(f"{path}:{name}")).lat_lon_height, LLH + [0, 0, 1])
    for topic, words in (
        ("", r"2 topics of that kind: /gps/fix \(sensor_msgs/NavSatFix, 5\), /rtk/fix \(.*5\): name one"),
        (":/rkt/fix", r"has no topic /rkt/fix of sensor_msgs/NavSatFix; 2 topics of that kind"),
        (":/odom", r"topic /odom \(nav_msgs/Odometry, 5\) has no messages of sensor_msgs/Nav"),
        (":/gps/fix,/rtk/fix", "name one of them, such as"),
    ):
        with refused(words):
            read_gnss(Path(f"{path}{topic}"))


@pytest.mark.parametrize(
    "rows, words",
    [
        ([], "it is empty"),
        (fixes(status=-1), "none of the messages of /gps/fix .* has a fix"),
        (odometry(), r"no messages of sensor_msgs/NavSatFix; 1 topics in it: /odom \(nav_msgs/Odometry, 5\)"),
    ],
)
def test_bags_without_positions_say_what_is_there(tmp_path: Path, rows: list[world.Row], words: str) -> None:
    with refused(words):
        read_gnss(world.bag(tmp_path, "mcap", rows))


# --- poses ----------------------------------------------------------------------------------------------------------


def as_path(topic: str) -> list[world.Row]:
    """A path that grows, as SLAM sends it."""
    poses = list(zip(TIMES, PLACES, TURNS.as_quat()))
    return [world.path(topic, TIMES[k] + 0.01, poses[: k + 1]) for k in range(COUNT)]


def as_poses(topic: str) -> list[world.Row]:
    return [world.pose(topic, *row) for row in zip(TIMES, PLACES, TURNS.as_quat())]


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("made", [odometry, as_poses, as_path])
def test_poses_have_their_quaternions_in_order(tmp_path: Path, form: str, made) -> None:
    found = read_trajectory(world.bag(tmp_path, form, made("/slam")))
    np.testing.assert_allclose(found.poses[:, :3, 3], PLACES, atol=1e-12)
    off = (Rotation.from_matrix(found.poses[:, :3, :3]) * TURNS.inv()).magnitude()
    assert off.max() < 1e-9 < 0.3 < TURNS.magnitude().min()
    np.testing.assert_allclose(found.time_s, TIMES, rtol=0, atol=1e-6)
    assert "poses of /slam" in found.notes[0] and ("base_link in 'odom'" in found.notes[0]) == (made is odometry)


@pytest.mark.slow
def test_poses_that_cannot_be_are_refused_with_their_number(tmp_path: Path) -> None:
    at = TIMES[1] + 0.1
    for name, rows, words in (
        ("run", [*as_poses("/p"), world.pose("/p", at, (1, 2, 3), (0, 0, 0, 2.0))], "the quaternion .* has length 2"),
        ("lost", [*as_poses("/p"), world.pose("/p", at, (np.nan, 2, 3), (0, 0, 0, 1.0))], "not a finite number"),
    ):
        with refused(f"{name}.bag, line 3: {words}"):
            read_trajectory(world.bag(tmp_path, "ros1", rows, name=name))
    for name, rows, words in (
        ("two", as_poses("/a") + odometry(), r"2 topics of that kind: /a \(geom.*5\), /odom \(nav_msgs/Odometry, 5\)"),
        ("none", [world.path("/way", START_S, [])], "none.bag: no poses"),
    ):
        with refused(words):
            read_trajectory(world.bag(tmp_path, "ros1", rows, name=name))


# --- pictures -------------------------------------------------------------------------------------------------------

SMOOTH = cv2.resize(np.random.default_rng(3).integers(20, 235, (4, 6, 3), dtype=np.uint8), (96, 64))


def mosaic(pattern: str) -> np.ndarray:
    """What a sensor with a colour filter, named row by row from the first pixel, sees of SMOOTH (BGR)."""
    channel = np.array([["bgr".index(c) for c in row] for row in (pattern[:2], pattern[2:])])
    y, x = np.mgrid[: SMOOTH.shape[0], : SMOOTH.shape[1]]
    return np.take_along_axis(SMOOTH, channel[y % 2, x % 2][..., None], axis=2)[..., 0]


def decoded(folder: Path, row: world.Row) -> np.ndarray | None:
    with open_bag(world.bag(folder, "ros1", [row])) as bag:
        message, _ = next(bag.messages(bag.only(KINDS, ())))
        assert unread(message) == ""
        return bgr(message)


GREY = cv2.cvtColor(SMOOTH, cv2.COLOR_BGR2GRAY)


@pytest.mark.parametrize(
    "encoding, pixels, truth, off",
    [
        ("bgr8", SMOOTH, SMOOTH, 0),
        ("rgb8", SMOOTH[..., ::-1], SMOOTH, 0),
        ("bgra8", np.dstack([SMOOTH, GREY]), SMOOTH, 0),
        ("mono8", GREY, np.dstack([GREY] * 3), 0),
        ("mono16", GREY.astype("<u2") * 256 + 255, np.dstack([GREY] * 3), 0),
        ("bayer_rggb8", mosaic("rggb"), SMOOTH, 12),
        ("bayer_bggr8", mosaic("bggr"), SMOOTH, 12),
        ("bayer_gbrg8", mosaic("gbrg"), SMOOTH, 12),
        ("bayer_grbg8", mosaic("grbg"), SMOOTH, 12),
    ],
)
def test_encodings_become_the_colours_they_stand_for(tmp_path: Path, encoding, pixels, truth, off) -> None:
    found = decoded(tmp_path, world.image("/image", START_S, pixels, encoding, padding=5))
    assert found.shape == truth.shape
    inside = np.s_[2:-2, 2:-2]
    assert np.abs(found[inside].astype(int) - truth[inside]).max() <= off


@pytest.mark.slow
def test_compressed_pictures_and_what_is_none(tmp_path: Path) -> None:
    found = decoded(tmp_path / "a", world.compressed("/image/compressed", START_S, SMOOTH))
    assert np.array_equal(found, SMOOTH)
    jpeg = decoded(tmp_path / "b", world.compressed("/image/compressed", START_S, SMOOTH, "jpg"))
    assert 0 < np.abs(jpeg.astype(int) - SMOOTH).mean() < 4
    short = world.image("/image", START_S, SMOOTH[:, :, 0], "bgr8")  # a third of its bytes
    assert decoded(tmp_path / "c", short) is None
    for row in (
        world.image("/depth", START_S, np.ones((8, 8), np.uint16), "16UC1"),
        world.compressed("/depth/compressedDepth", START_S, SMOOTH, form="16UC1; compressedDepth png"),
    ):
        with open_bag(world.bag(tmp_path, "ros1", [row], name=row.kind.replace("/", "_"))) as bag:
            assert unread(next(bag.messages(bag.topics[0]))[0])


# --- what is no bag -------------------------------------------------------------------------------------------------


def cut(path: Path, form: str) -> Path:
    """The bag as a copy that was broken off leaves it."""
    file = path if form == "ros1" else next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))
    file.write_bytes(file.read_bytes()[: int(0.6 * file.stat().st_size)])
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    "form, tool", [("ros1", "rosbag reindex"), ("sqlite", "sqlite3 .recover"), ("mcap", "mcap recover")]
)
def test_bags_that_are_cut_off_say_how_they_are_mended(tmp_path: Path, form: str, tool: str) -> None:
    path = cut(world.bag(tmp_path, form, [r for k in range(30) for r in fixes(f"/gps{k}/fix")]), form)
    with refused(f"run.*: cannot be read as a ROS bag .*`{tool}"):
        read_gnss(Path(f"{path}:/gps0/fix"))


def test_a_count_of_messages_that_are_not_there_is_no_crash(tmp_path: Path) -> None:
    folder = world.bag(tmp_path, "sqlite", fixes() + odometry())
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM messages WHERE topic_id = (SELECT id FROM topics WHERE name = '/gps/fix')")
    with refused(r"should have /gps/fix \(sensor_msgs/NavSatFix, 5\), and has none"):
        read_gnss(folder)
    (folder / "metadata.yaml").write_text("nothing: 1")
    with refused("cannot be read as a ROS bag .*`ros2 bag reindex` may repair it"):
        read_gnss(folder)


def unindexed(path: Path) -> None:
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    path.write_bytes(data)


def test_files_that_are_no_bags_are_named(tmp_path: Path) -> None:
    for name, data in (("a.bag", b""), ("b.bag", b"time,lat,lon\n"), ("c.mcap", b"x" * 99), ("d.db3", b"y" * 99)):
        (tmp_path / name).write_bytes(data)
    unindexed(world.bag(tmp_path, "ros1", fixes()))
    os.mkfifo(tmp_path / "pipe.bag")
    next(world.bag(tmp_path, "sqlite", fixes(), name="two").glob("*.db3")).unlink()
    for name, words in (
        *((name, f"{name}: cannot be read as a ROS bag") for name in ("a.bag", "b.bag", "c.mcap", "d.db3")),
        ("run.bag", "Bag is not indexed.*`rosbag reindex`"),
        ("pipe.bag", "pipe.bag: cannot be read .*a named pipe"),
        ("two", "two: cannot be read .*missing"),
    ):
        with refused(words):
            read_gnss(tmp_path / name)


def test_without_rosbags_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = world.bag(tmp_path, "ros1", fixes())
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(EngineMissing, match=r"run.bag: .*pip install 'tiegraph\[ros\]'"):
        read_gnss(path)


# --- names ----------------------------------------------------------------------------------------------------------


def test_a_topic_is_named_behind_its_bag(tmp_path: Path) -> None:
    path = world.bag(tmp_path, "ros1", fixes())
    assert split_topics(Path(f"{path}:/a/b,c")) == (path, ("/a/b", "/c"))
    assert shown(path, "/a/b") == "run.bag:/a/b" and is_bag(Path(f"{path}:/a"))
    (tmp_path / "positions.csv").write_text("x")
    for plain in ("run.bag", "none.bag:/a", "positions.csv:/a", "run.bag:"):
        assert split_topics(tmp_path / plain) == (tmp_path / plain, ())
    odd = Path(shutil.copy(path, tmp_path / "run:1.bag"))
    assert split_topics(odd) == (odd, ()) and split_topics(Path(f"{odd}:/a")) == (odd, ("/a",))


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
