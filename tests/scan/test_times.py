"""Times of frames by file, name and EXIF; trajectories of a body and poses by image, as poses of frames."""

from __future__ import annotations

import json
import re
import shutil
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from scan_worlds import (
    Survey,
    data,
    exif_of,
    flu_rig,
    gnss_csv,
    in_enu,
    papers_rig,
    picture,
    scan,
    times_csv,
    two_cameras_rig,
)
from scipy.spatial.transform import Rotation

from said import refused, says
from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, rigid
from tiegraph.scan.priors.times import time_in_name
from tiegraph.scan.priors.trajectory import read_trajectory
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.posefile import write_tum
from tiegraph.scene.scene import Scene

START = 1714564800.0  # 2024-05-01 12:00:00 UTC
STEP_DEG = 10 / 111_000  # 10 m to the north, which is the speed a second


def iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat()


def flight(folder: Path, start: float = START, sub: str = "") -> Path:
    """Five photographs, one a second."""
    for k in range(5):
        stamp = datetime.fromtimestamp(start + k, timezone.utc).strftime("%Y:%m:%d %H:%M:%S")
        picture(folder / f"{k}.jpg", exif=exif_of(time=stamp, **({"subsec": sub} if sub else {})))
    return folder


def track(path: Path, times: list[str], head: str = "time") -> Path:
    rows = (f"{t},{35.69 + STEP_DEG * (k - 2):.9f},139.77,40,0.02\n" for k, t in enumerate(times))
    path.write_text(f"{head},lat,lon,height,sigma\n" + "".join(rows))
    return path


def moved(scene: Scene) -> np.ndarray:
    return np.diff(scene.world_from_rig[:, 1, 3])


@pytest.mark.parametrize("sub", ["", "25"])
def test_whole_seconds_of_cameras_widen_the_sigma_along_the_way(tmp_path: Path, sub: str) -> None:
    times = [iso(START + k - 2) for k in range(10)]
    scene = scan(flight(tmp_path / "in", sub=sub), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    along = 0.02 if sub else 10 / np.sqrt(3)  # a time cut to whole seconds is late by 0 to 1 s
    # the grid is turned by 0.7 degrees
    np.testing.assert_allclose(scene.position_sigma_m, [[0.02, along, 0.04]] * 5, atol=0.06)
    said = [n for n in scene.notes if "have whole seconds, in which the receiver moved 5.8 m" in n]
    assert len(said) == (not sub)


@pytest.mark.parametrize("weeks", [1024, 2048])
def test_a_log_1024_weeks_back_is_brought_forward(tmp_path: Path, weeks: int) -> None:
    times = [iso(START + 0.5 + k - 2 - weeks * 604800) for k in range(10)]
    scene = scan(flight(tmp_path / "in", sub="50"), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    assert any(f"its dates lie {weeks} weeks before the frames'" in n for n in scene.notes)


def test_times_of_day_beside_dated_frames(tmp_path: Path) -> None:
    midnight = START + 43200
    times = [iso(midnight + k - 4)[11:19] for k in range(10)]  # 23:59:56 to 00:00:05
    scene = scan(flight(tmp_path / "in", midnight - 2), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05) and scene.time_s[0] == midnight - 2


@pytest.mark.parametrize("first", [-2, 1], ids=["frames cross midnight", "frames begin after it"])
@pytest.mark.parametrize("week", [False, True])
def test_rows_and_frames_pass_midnight_at_different_rows(tmp_path: Path, first: int, week: bool) -> None:
    images, turn = papers_rig(tmp_path / "in", ("up",), 1, 6), 604800 if week else 86400

    def clock(k: int) -> str:
        return str(k % turn) if week else iso(k % turn)[11:19]

    name = "gps_sow" if week else "time"
    rows = "".join(f"{k:06d}.jpg,{clock(first + k)}\n" for k in range(6))
    (tmp_path / "t.csv").write_text(f"image,{name}\n{rows}")
    gnss = track(tmp_path / "g.csv", [clock(k) for k in range(-10, 12)], name)
    scene = scan(images, gnss=gnss, times=tmp_path / "t.csv")
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    (tmp_path / "a.tum").write_text(
        f"{name} x y z qx qy qz qw\n" + "".join(f"{clock(k)} 0 {10 * k} 0 0 0 0 1\n" for k in range(-10, 12))
    )
    scene = scan(images, trajectory=tmp_path / "a.tum", times=tmp_path / "t.csv")
    np.testing.assert_allclose(scene.world_from_rig[:, 1, 3], 10.0 * (first + np.arange(6)), atol=1e-6)
    assert any("a.tum: columns read: " in n for n in scene.notes)


def test_names_below_the_folder_in_which_exiftool_was_called(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 3)
    rows = "".join(f"./in/up/cam0/{k:06d}.jpg,{35.69 + STEP_DEG * k:.9f},139.77,40\n" for k in range(3))
    (tmp_path / "g.csv").write_text("SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\n" + rows)
    assert moved(scan(images, gnss=tmp_path / "g.csv")) == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize(
    "text", ["000000.jpg;12:00:00,5\n000001.jpg;12:00:01,5\n", "000000.jpg 43200.5\n000001.jpg 43201.5\n"]
)
def test_times_without_a_header(tmp_path: Path, text: str) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 2)
    (tmp_path / "t.csv").write_text(text)
    scene = scan(images, times=tmp_path / "t.csv")
    assert scene.time_s.tolist() == [43200.5, 43201.5]
    assert says(scene.notes, "no header; by its cells the columns are image, time")


FRAMES = 8  # of ``one_pass``


def times_text(*lines: str, frames: int = FRAMES) -> str:
    return "\n".join(["pass,frame,time", *(f"up,{k:06d},{100 + k}" for k in range(frames)), *lines]) + "\n"


def scan_times(survey: Survey, folder: Path, text: str) -> Scene:
    (folder / "t.csv").write_text(text)
    return survey.scan(times=folder / "t.csv")


@pytest.mark.parametrize(
    "text, words",
    [
        (times_text().replace("up", "down"), r"line 2: none of its 8 rows.*\(down/0\).*the passes here are up"),
        (times_text("up,3,500"), r"line 10: up/3 has the time 500 s, but 103 s in line 5: keep the right one"),
        (times_text("up,8,nan"), r"line 10: 'nan' is no time"),
        (times_text("up,8,inf"), r"line 10: 'inf' is no time"),
        (times_text("up,8,1e308"), r"line 10: '1e308' is no time.*leave out rows without"),
        (times_text("up,8,1,5"), r"line 10: 4 cells below a header of 3"),
        (re.sub(r",\d+\n", ",7\n", times_text()), r"line 2: all 8 frames have the time 7 s: write the time of each"),
        ("image,time\nup/cam0/000001.jpg,1\nup/cam0/000001.jpg,2\n", r"line 3: up/cam0/000001.jpg has the time 2 s"),
        ("frame,time,time\n1,1,2\n", "the column 'time' 2 times"),
    ],
)  # fmt: skip
def test_times_that_cannot_be_meant(one_pass: Survey, tmp_path: Path, text: str, words: str) -> None:
    with refused(words, "t.csv"):
        scan_times(one_pass, tmp_path, text)


@pytest.mark.parametrize(
    "text, words",
    [
        (times_text("down,000001,5"), r"line 10: 1 of 9 rows name frames or images that are not here, such as down/1"),
        (times_text("up,99,500"), r"line 10: 1 of 9 rows .* such as up/99"),
        (times_text("up,3,103"), r"line 10: up/3 is listed twice, with one time"),
        ("image,time\nup/cam0/000001.jpg,1\nup/cam1/000001.jpg,31\nup/cam0/000002.jpg,40\n",
         r"line 2, 3: images of one frame are 30.00 s apart"),
    ],
)  # fmt: skip
def test_times_that_are_said(one_pass: Survey, tmp_path: Path, text: str, words: str) -> None:
    scene = scan_times(one_pass, tmp_path, text)
    assert says(scene.notes, words) and np.isfinite(scene.time_s).any(), scene.notes


def test_good_times_say_nothing(one_pass: Survey, two_passes: Survey, tmp_path: Path) -> None:
    for text in (times_text(), times_text().replace("up,", ",")):
        scene = scan_times(one_pass, tmp_path, text)
        assert scene.time_s.tolist() == [100.0 + k for k in range(FRAMES)]
        assert [n for n in scene.notes if "t.csv" in n] == ["t.csv: columns read: pass, frame, time"]
    rows = [f"{p},{k},{t + k}\n" for p, t in (("up", 0), ("down", 90000)) for k in range(3)]
    both = "pass,frame,time\n" + "".join(rows)
    assert not says(scan_times(two_passes, tmp_path, both).notes, "t.csv(?!: columns read)")
    scene = scan_times(two_passes, tmp_path, both + "sideways,0,1\n")
    assert says(scene.notes, r"line 8: 1 of 7 rows .* such as sideways/0")


def test_a_pass_whose_folders_have_no_name(one_pass: Survey, tmp_path: Path) -> None:
    bare = Survey(one_pass.images / "up")
    scene = scan_times(bare, tmp_path, times_text())
    assert scene.sequences == ("all",) and says(scene.notes, "line 2: pass 'up' is taken as the only pass here")
    with refused("the passes here are all"):
        scan_times(bare, tmp_path, times_text("down,0,500"))


@pytest.mark.parametrize(
    "names, exif, words",
    [
        ("{k}.jpg", {"time": "2024:01:01 10:00:00"}, "EXIF: all 3 frames.* the same, 2024-01-01 10:00:00: not used"),
        ("20240101_100000_{k}.jpg", {}, "file names: all 3 frames.* the same, 2024-01-01 10:00:00: not used"),
    ],
)
def test_one_time_for_all_photographs_is_not_used(tmp_path: Path, names: str, exif: dict, words: str) -> None:
    for k in range(3):
        picture(tmp_path / names.format(k=k), exif=exif_of(**exif))
    scene = scan(tmp_path)
    assert says(scene.notes, words) and np.isnan(scene.time_s).all()


@pytest.mark.parametrize(
    "text, message",
    [
        ("name,when\na,1\n", "found the columns name, when; expected time and image"),
        ("frame,time\n0,1\n", "2 passes: add a column pass"),
        ("pass,frame,time\nup,0,soon\n", "line 2: 'soon' is no time"),
        ("image,time\nx.jpg,1\n", "none of its 1 rows names an image"),
    ],
)
def test_times_files_that_cannot_be_used(two_passes: Survey, tmp_path: Path, text: str, message: str) -> None:
    with refused(message):
        scan_times(two_passes, tmp_path, text)


def test_times_by_image_and_frames_in_time_order(tmp_path: Path) -> None:
    survey = Survey(papers_rig(tmp_path / "in", ("up",), 2, 3))
    rows = "up/cam0/000000.jpg,30\nup/cam1/000001.jpg,20\nup/cam0/000002.jpg,10\n"
    scene = scan_times(survey, tmp_path, f"image,time\n{rows}")
    assert scene.time_s.tolist() == [10, 20, 30] and scene.sequence_index.tolist() == [0, 1, 2]
    assert scene.names[int(np.flatnonzero(scene.frame == 0)[0])] == "up/cam0/000002.jpg"
    assert says(scene.notes, "ordered by time")


@pytest.mark.parametrize(
    "stem, seconds",
    [("1557539956.400135", 1557539956.400135), ("cam_1557539956400135", 1557539956.400135),
     ("1557539956400", 1557539956.4), ("1557539956400135123", 1557539956.400135), ("IMG_20230915_010000", 1694739600.0),
     ("20230915010000500", 1694739600.5),
     ("000123", np.nan), ("9999999999", np.nan), ("IMG_20239915_010000", np.nan)],
)  # fmt: skip
def test_times_in_names(stem: str, seconds: float) -> None:
    assert time_in_name(stem) == pytest.approx(seconds, abs=1e-5, nan_ok=True)


def drive(frames: int, turn_deg: float = 60.0) -> np.ndarray:
    """(F, 4, 4) world_from_body of a level body (x forward, y left, z up) on an arc from the origin, 1 m a frame."""
    yaw = np.radians(np.linspace(0, turn_deg, frames))
    step = np.stack([np.cos(yaw), np.sin(yaw), 0.02 * np.sin(4 * yaw)], axis=1)
    position = np.cumsum(step, axis=0) - step[0]
    return rigid(Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix(), position)


def test_one_trajectory_as_long_as_the_pass(one_pass: Survey, tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", 50 + np.arange(8.0), drive(8))
    scene = one_pass.scan(trajectory=tmp_path / "a.tum")
    assert scene.prior == "trajectory" and np.allclose(scene.world_from_rig, drive(8), atol=1e-8)
    assert scene.time_s.tolist() == list(range(50, 58)) and np.isnan(scene.position_sigma_m).all()
    assert says(scene.notes, r"'cam0' \(x right, y down, z forward\)")


def test_kitti_poses_by_frame(one_pass: Survey, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "poses.txt", drive(8)[:, :3].reshape(8, 12))
    assert np.allclose(one_pass.scan(trajectory=tmp_path / "poses.txt").world_from_rig, drive(8), atol=1e-8)
    np.savetxt(tmp_path / "poses.txt", drive(9)[:, :3].reshape(9, 12))
    with refused("9 poses for 8 frames, and no times or names assign them"):
        one_pass.scan(trajectory=tmp_path / "poses.txt")


def test_a_trajectory_by_time_is_interpolated(one_pass: Survey, tmp_path: Path) -> None:
    t = 99.5 + np.arange(4)
    write_tum(tmp_path / "a.tum", t, rigid(np.tile(np.eye(3), (4, 1, 1)), np.stack([t, t, t], axis=1)))
    scene = one_pass.scan(trajectory=tmp_path / "a.tum", times=times_csv(tmp_path / "t.csv", 8))
    assert scene.world_from_rig[:3, 0, 3] == pytest.approx([100, 101, 102])
    assert np.isnan(scene.world_from_rig[3:, 0, 3]).all()
    with refused("do not overlap"):
        one_pass.scan(trajectory=tmp_path / "a.tum", times=times_csv(tmp_path / "t.csv", 8, start=900))


BODY_FROM_CAM0 = rigid(orient(30, -5, 0, "flu"), np.array([0.1, 0, 0.2]))  # as ``flu_rig`` says
ANTENNA = [0.9, 0.6, 0.3, 1]


def test_a_trajectory_of_the_body_becomes_one_of_the_first_camera(one_pass: Survey, tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", np.arange(8.0), drive(8))
    scene = one_pass.scan(rig=flu_rig(tmp_path), trajectory=tmp_path / "a.tum")
    assert np.allclose(scene.world_from_rig, drive(8) @ BODY_FROM_CAM0, atol=1e-8)
    assert scene.rigs[0].antenna_m == pytest.approx(np.linalg.inv(BODY_FROM_CAM0)[:3] @ ANTENNA)
    assert says(scene.notes, "body frame of rig.toml")


@pytest.fixture
def vo(tmp_path: Path) -> Path:
    """A folder of odometry."""
    (tmp_path / "vo").mkdir()
    return tmp_path / "vo"


def test_odometry_of_each_pass_is_never_in_one_world(two_passes: Survey, vo: Path) -> None:
    for name in ("up", "down"):
        write_tum(vo / f"vo_{name}.tum", np.arange(3.0), drive(3))
    scene = two_passes.scan(trajectory=vo)
    assert scene.prior == "odometry" and scene.has_orientations() and not scene.measured_positions().any()
    assert scene.pose_world().tolist() == [0] * 3 + [1] * 3
    assert says(scene.notes, "each pass in its own world")
    shifted = drive(3)
    shifted[:, 0, 3] += 7
    write_tum(vo / "vo_down.tum", np.arange(3.0), shifted)
    scene = two_passes.scan(trajectory=vo)
    assert scene.prior == "trajectory" and set(scene.pose_world()) == {0} and scene.measured_positions().all()


def test_folders_without_a_trajectory_for_a_pass(two_passes: Survey, vo: Path) -> None:
    with refused("none of its files"):
        two_passes.scan(trajectory=vo)
    for name in ("a", "b"):
        write_tum(vo / f"{name}.tum", np.arange(2.0), drive(2))
    with refused(r"\(a.tum, b.tum\) contains the name of a pass \(down, up\)"):
        two_passes.scan(trajectory=vo)
    with refused("no such file or folder"):
        two_passes.scan(trajectory=vo / "nowhere")


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_odometry_laid_on_gnss_gives_poses_in_the_world(tmp_path: Path, vo: Path, scale: float) -> None:
    """Two passes, each odometry in its own world and scale, GNSS off the body, an outage in the middle."""
    frames, open_sky = 12, np.r_[0:4, 8:12]
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, frames)
    rng = np.random.default_rng(3)
    truth, times, positions = {}, [], []
    for n, name in enumerate(("up", "down")):
        body = drive(frames, 80)
        turn = rigid(Rotation.from_euler("z", 40 + 150 * n, degrees=True).as_matrix(), np.array([20.0 * n, 5, 2]))
        truth[name] = turn @ body
        body[:, :3, 3] *= scale
        time_s = 100 + 1000 * n + np.arange(frames, dtype=float)
        write_tum(vo / f"{name}.tum", time_s, body)
        times.append(time_s[open_sky])
        positions.append(((truth[name] @ ANTENNA)[:, :3] + rng.normal(0, 0.02, (frames, 3)))[open_sky])
    gnss = gnss_csv(tmp_path / "g.csv", np.concatenate(times), np.concatenate(positions))
    scene = scan(images, ScanSettings(crs="ENU"), rig=flu_rig(tmp_path), gnss=gnss, trajectory=vo)
    assert scene.prior == "gnss" and np.isfinite(scene.world_from_rig).all()
    assert np.isfinite(scene.position_sigma_m[:, 0]).sum() == scene.measured_positions().sum() == 16
    for name in ("up", "down"):
        rows = scene.sequence == scene.sequences.index(name)
        want = truth[name] @ BODY_FROM_CAM0
        assert 0 < angle_deg(scene.world_from_rig[rows, :3, :3], want[:, :3, :3]).max() < 1.0
        miss = np.linalg.norm(in_enu(scene)[rows] - (truth[name] @ ANTENNA)[:, :3], axis=1)
        assert 0 < miss[4:8].max() < 0.15 and 0 < miss[:4].max() < 0.15


@pytest.mark.slow
def test_canal_gnss_and_odometry() -> None:
    """Real-looking sensors: outages under the bridge, single fixes, drifting odometry per pass."""
    sensors = data("canal_demo", "sensors")
    scene = scan(data("canal_demo", "images"), rig="ladybug5", gnss=sensors / "gnss.csv", trajectory=sensors)
    known = np.isfinite(scene.position_sigma_m[:, 0])
    assert 8 <= known.sum() <= 12 and np.isfinite(scene.world_from_rig).all()
    assert scene.origin.crs == "EPSG:32654"
    assert np.ptp(scene.world_from_rig[:, :3, 3], axis=0).max() < 40  # m: the boat stays on its canal


def test_a_pass_without_a_trajectory_and_what_a_file_says_of_itself_is_noted(two_passes: Survey, vo: Path) -> None:
    for name in ("up", "dwn"):
        write_tum(vo / f"vo_{name}.tum", np.arange(3.0), drive(3))
    notes = two_passes.scan(trajectory=vo).notes
    assert says(notes, "no trajectory of pass down: no file besides vo_up.tum")
    rows = (vo / "vo_up.tum").read_text().splitlines()
    (vo / "vo_up.tum").write_text("\n".join([rows[0], rows[2], rows[1], *rows[3:], rows[-1]]))
    notes = two_passes.scan(trajectory=vo).notes
    assert says(notes, "vo_up.tum, line 3: rows are not in time order")
    assert says(notes, "vo_up.tum, line 5: 1 rows have the time of another row")


def truth(canal: Path) -> dict[str, np.ndarray]:
    """world_from_camera of the canal's images, by COLMAP's text format: id, qw qx qy qz, tx ty tz, camera, name."""
    out = {}
    for line in (canal / "truth" / "colmap" / "images.txt").read_text().splitlines():
        cells = line.split()
        if line and not line.startswith("#") and len(cells) == 10:
            w, x, y, z = (float(v) for v in cells[1:5])
            camera = rigid(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(cells[5:8], float))
            out[cells[9]] = np.linalg.inv(camera)
    return out


def same(scene: Scene, expected: dict[str, np.ndarray]) -> int:
    """How many frames have the poses of the rig's first camera."""
    names = [f"{scene.sequences[s]}/cam0/{k:06d}.jpg" for s, k in zip(scene.sequence, scene.sequence_index)]
    found = {n: pose for n, pose in zip(names, scene.world_from_rig) if n in expected}
    for name, pose in found.items():
        np.testing.assert_allclose(pose, expected[name], rtol=0, atol=1e-6)
    return len(found)


def transforms(poses: dict[str, np.ndarray], prefix: str = "./images/", **more: object) -> str:
    """As nerfstudio writes it: camera to world, x right, y up, z backward."""
    to_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [{"file_path": prefix + n, "transform_matrix": (p @ to_opengl).tolist()} for n, p in poses.items()]
    return json.dumps({"camera_model": "OPENCV", "w": 64, "h": 48, "frames": frames, **more})


@pytest.mark.slow
def test_a_colmap_model_is_a_trajectory(canal: Path) -> None:
    scene = scan(canal / "images", rig=str(canal / "rig.toml"), trajectory=canal / "truth" / "colmap")
    assert scene.prior == "trajectory" and same(scene, truth(canal)) == 20
    assert says(scene.notes, "colmap: the trajectory is read as poses of 120 images by their names")
    assert not says(scene.notes, "body frame")


@pytest.mark.slow
def test_a_transforms_json_gives_the_same_poses(canal: Path, tmp_path: Path) -> None:
    poses = truth(canal)
    (tmp_path / "transforms.json").write_text(transforms(poses))
    for path in (tmp_path / "transforms.json", tmp_path):
        assert same(scan(canal / "images", rig=str(canal / "rig.toml"), trajectory=path), poses) == 20
    name = "up/cam0/000000.jpg"
    found = read_trajectory(tmp_path)
    np.testing.assert_allclose(found.poses[found.names.index(f"./images/{name}")], poses[name], atol=1e-9)
    as_written = np.array(json.loads((tmp_path / "transforms.json").read_text())["frames"][0]["transform_matrix"])
    assert angle_deg(as_written[:3, :3], poses[next(iter(poses))][:3, :3]) > 179  # OpenGL's axes are not ours


def test_a_frame_without_its_first_camera_has_the_pose_by_another(tmp_path: Path) -> None:
    """By the rig's geometry; frames and images that lack are said."""
    images, rig_toml = papers_rig(tmp_path / "in", ("up",), 2, 3), two_cameras_rig(tmp_path)
    on_rig = scan(images, rig=rig_toml).rigs[0].sensors[1].sensor_from_rig
    assert np.linalg.norm(on_rig[:3, 3]) == pytest.approx(0.5)
    turns = [Rotation.from_euler("xyz", [5 * k, 10, 0], degrees=True).as_matrix() for k in range(3)]
    rig = [rigid(turn, np.array([k, 2.0, 3])) for k, turn in enumerate(turns)]
    poses = {"cam0/000000": rig[0], "cam1/000001": rig[1] @ np.linalg.inv(on_rig), "cam0/9": rig[2]}
    (tmp_path / "transforms.json").write_text(transforms({f"up/{n}.jpg": p for n, p in poses.items()}))
    scene = scan(images, rig=rig_toml, trajectory=tmp_path / "transforms.json")
    np.testing.assert_allclose(scene.world_from_rig[:2], rig[:2], atol=1e-9)
    assert np.isnan(scene.world_from_rig[2]).any()
    assert says(scene.notes, "2 images by their names; 1 of 3 frames have none")
    assert says(scene.notes, "1 of 3 poses are of images that are not here, such as ./images/up/cam0/9.jpg")


@pytest.mark.parametrize("written", ["images/a_{}.jpg", "a_{}.jpg", "./train/a_{}", "../x/images/a_{}.jpg"])
def test_names_as_programs_write_them(tmp_path: Path, written: str) -> None:
    images = tmp_path / "in"
    for k in range(4):
        picture(images / f"a_{k}.jpg")
    poses = {written.format(k): rigid(np.eye(3), np.array([k, 0.0, 0])) for k in range(4)}
    (tmp_path / "t.json").write_text(transforms(poses, prefix=""))
    scene = scan(images, ScanSettings(layout="loose"), trajectory=tmp_path / "t.json")
    assert scene.world_from_rig[:, 0, 3].tolist() == [0, 1, 2, 3]


def frame(**changed: object) -> dict:
    return {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist(), **changed}


def turned(*frames: object) -> str:
    return json.dumps({"frames": list(frames)})


MIRROR = np.diag([1.0, 1, -1, 1]).tolist()


@pytest.mark.parametrize(
    "text, words",
    [
        ("", r"line 1: no JSON"),
        (transforms({"a": np.eye(4)})[:-30], r"line 1: no JSON .*is the file cut off\?"),
        ("[1, 2]", "no list 'frames'"),
        ('{"frames": 3}', "no list 'frames'"),
        ('{"frames": []}', "no image has a pose"),
        (turned(3), "frame 0: no file_path"),
        (turned(frame(), frame(file_path="")), "frame 1: no file_path"),
        (turned(frame(transform_matrix=[[1, 2], [3, 4]])), r"frame 0 \(a.jpg\): transform_matrix is no 4 x 4"),
        (turned(frame(transform_matrix="x")), r"frame 0 \(a.jpg\): transform_matrix is no 4 x 4"),
        (turned(frame(transform_matrix=(2 * np.eye(4)).tolist())), r"frame 0 \(a.jpg\): .*scaled, or mirrored"),
        (turned(frame(transform_matrix=MIRROR)), r"frame 0 \(a.jpg\): .*scaled, or mirrored"),
        (turned(frame(), frame(transform_matrix=[[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]])), "frame 1: a.jpg has an"),
        (turned(frame(), frame(file_path="b.jpg")), "all 2 poses are the same"),
    ],
)  # fmt: skip
def test_a_transforms_json_that_is_none(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with refused(words, "transforms.json"):
        read_trajectory(tmp_path / "transforms.json")


def test_poses_of_other_images_are_refused(one_pass: Survey, tmp_path: Path) -> None:
    poses = {f"{k}.png": rigid(np.eye(3), np.array([k, 0.0, 0])) for k in range(3)}
    (tmp_path / "t.json").write_text(transforms(poses))
    with refused(r"t.json: none of its 3 images is here: ./images/0.png .*like up/cam0/000000.jpg"):
        one_pass.scan(trajectory=tmp_path / "t.json")


def test_the_folder_above_a_model_says_where_it_is(one_pass: Survey, canal: Path, tmp_path: Path) -> None:
    shutil.copytree(canal / "truth" / "colmap", tmp_path / "sparse" / "0")
    with refused(r"--trajectory .*/sparse: no poses in it; .*/sparse/0 has some: give that path"):
        one_pass.scan(trajectory=tmp_path / "sparse")


@pytest.mark.parametrize("cut", [10, 400, 3000])
def test_a_damaged_model_is_a_named_error(canal: Path, tmp_path: Path, cut: int) -> None:
    shutil.copytree(canal / "truth" / "colmap", tmp_path / "model")
    images = tmp_path / "model" / "images.txt"
    images.write_text(images.read_text()[:cut])
    try:
        assert 0 < len(read_trajectory(tmp_path / "model")) < 120
    except InputError as error:
        assert "model" in str(error)
