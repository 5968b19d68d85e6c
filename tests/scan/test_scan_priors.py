from pathlib import Path

import numpy as np
import pytest
from scan_worlds import data, exif_of, papers_rig, picture, scan
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.geometry.transforms import angle_deg, rigid
from tiegraph.scan.priors.times import time_in_name
from tiegraph.scan.priors.trajectory import read_trajectory
from tiegraph.scan.rigfiles.rigspec import AXES, orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import TimesTuning
from tiegraph.scene.cells import parse_time
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.posefile import write_tum
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import GnssTuning

TIMES = TimesTuning()
ORIGIN = make_origin(35.69, 139.77, 40.0, "ENU")
ENU = ScanSettings(crs="ENU")


def gnss_csv(path: Path, time_s: np.ndarray, enu: np.ndarray, sigma: float = 0.05) -> Path:
    llh = geodetic_from_world(enu, ORIGIN)
    rows = [f"{t:.3f},{a:.10f},{o:.10f},{h:.4f},{sigma}" for t, (a, o, h) in zip(time_s, llh)]
    path.write_text("time,lat,lon,height,sigma\n" + "\n".join(rows) + "\n")
    return path


def times_csv(path: Path, frames: int, passes: tuple[str, ...] = ("up",), start: float = 100.0) -> Path:
    rows = [f"{p},{k:06d},{start + 1000 * n + k}" for n, p in enumerate(passes) for k in range(frames)]
    path.write_text("pass,frame,time\n" + "\n".join(rows) + "\n")
    return path


def in_enu(scene: Scene) -> np.ndarray:
    """(F, 3) positions of a scene in the ENU frame of these tests, metres."""
    assert scene.origin is not None
    out = np.full((scene.frames, 3), np.nan)
    known = np.isfinite(scene.world_from_rig[:, 0, 3])
    out[known] = world_from_geodetic(geodetic_from_world(scene.world_from_rig[known, :3, 3], scene.origin), ORIGIN)
    return out


# --- the GNSS table --------------------


@pytest.mark.parametrize(
    "text",
    [
        "time,lat,lon,height,sigma\n10,35,139,40,0.1\n11,35.001,139.001,41,0.1\n",
        "Time (s);Latitude [deg];Longitude [deg];Altitude (m);Accuracy\n10;35;139;40;0.1\n11;35.001;139.001;41;0.1\n",
        "# made by a receiver\n# t lat long elevation sigma_m\n10 35 139 40 0.1\n11 35.001 139.001 41 0.1\n",
        "\ufefftimestamp\tlat_deg\tlng\talt\tstd\n10\t35\t139\t40\t0.1\n\n11\t35.001\t139.001\t41\t0.1\n",
        "q,height,lon,lat,time,sigma_h,sigma_v\n1,40,139,35,1970-01-01T00:00:10Z,0.1,0.2\n"
        "1,41,139.001,35.001,1970-01-01 00:00:11.0,0.1,0.2\n",
        "date,time,lat,lon,height,sde,sdn,sdu\n1970/01/01,00:00:10.0,35,139,40,.1,.1,.2\n1970/01/01,00:00:11.0,35.001,139.001,41,.1,.1,.2\n",
    ],
)  # fmt: skip
def test_gnss_tables_of_many_shapes(tmp_path: Path, text: str) -> None:
    path = tmp_path / "g.csv"
    path.write_text(text)
    gnss = read_gnss(path, GnssTuning())
    assert gnss.time_s.tolist() == [10, 11]
    assert gnss.lat_lon_height.tolist() == [[35, 139, 40], [35.001, 139.001, 41]]
    assert gnss.sigma_m == pytest.approx(np.array([[0.1, 0.1, 0.2]] * 2))
    assert len(gnss.notes) == 1 and gnss.notes[0].startswith("g.csv: columns read: ")
    assert ("; passed over, though it may count: q (a fix: 2 of '1')" in gnss.notes[0]) == (text[0] == "q")


@pytest.mark.parametrize(
    "text",
    [
        "image,lat,lat_ref,lon,lon_ref,height\na.jpg,33.5,S,70.25,W,40\n",
        "image,lat,n/s,lon,e/w,alt\na.jpg,33.5,s,70.25,w,40\n",
        "SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\n"
        "a.jpg,\"33 deg 30' 0.00\"\" S\",\"70 deg 15' 0.00\"\" W\",40\n",
        "image;lat;lon;height\na.jpg;S33.5;70.25 W;40\n",
        "image;lat;lon;height\na.jpg;33°30'0\"S;70°15'W;40\n",
    ],
)  # fmt: skip
def test_the_half_of_the_earth_may_be_a_letter(tmp_path: Path, text: str) -> None:
    path = tmp_path / "g.csv"
    path.write_text(text)
    gnss = read_gnss(path, GnssTuning())
    assert gnss.lat_lon_height == pytest.approx(np.array([[-33.5, -70.25, 40.0]]))
    assert len(gnss.notes) == 1 and "passed over" not in gnss.notes[0]


def test_lengths_have_the_unit_of_their_header(tmp_path: Path) -> None:
    path = tmp_path / "g.csv"
    path.write_text("image,lat,lon,height (ft),sigma_h (mm),sigma_v (cm)\na.jpg,33.5,70.25,100,12,3\n")
    gnss = read_gnss(path, GnssTuning())
    assert gnss.lat_lon_height[0, 2] == pytest.approx(30.48)
    assert "height [ft], sigma_h [mm] (horizontal sigma), sigma_v [cm] (vertical sigma)" in gnss.notes[0]
    assert gnss.sigma_m == pytest.approx(np.array([[0.012, 0.012, 0.03]]))


def test_another_letter_is_an_error_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "g.csv"
    path.write_text("image,lat,lat_ref,lon,height\na.jpg,33.5,E,70.25,40\n")
    with pytest.raises(InputError, match="g.csv, line 2: lat_ref 'E' is not N or S"):
        read_gnss(path, GnssTuning())


@pytest.mark.parametrize(("pitch", "heading"), [(-90, np.nan), (4, 120), (359.5, 120)])
def test_the_yaw_of_a_tilted_camera_is_no_heading(tmp_path: Path, pitch: float, heading: float) -> None:
    path = tmp_path / "g.csv"
    path.write_text(f"image,lat,lon,height,yaw,pitch,roll\na.jpg,33.5,70.25,40,120,{pitch},0\n")
    gnss = read_gnss(path, GnssTuning())
    np.testing.assert_equal(gnss.heading_deg, [heading])
    said = "yaw, pitch, roll: cameras tilted by up to 90 degrees: these angles are passed over"
    assert (said in gnss.notes[0]) == (pitch == -90)


@pytest.mark.parametrize(
    "text, message",
    [
        ("time,lat,height\n1,2,3\n", "no column lon; found: time, lat, height"),
        ("lat,lon,height\n1,2,3\n", r"no column time \(or image\)"),
        ("1,2,3,4\n5,6,7,8\n", "line 1: no header says what .* such as time,lat,lon,height"),
        ("", "no rows"),
        ("time,lat,lon,height\n1,nan,2,3\n", "none of 1 rows"),
        ("time,lat,lon,height\n1,139,35,3\n", "lat and lon look exchanged"),
    ],
)
def test_gnss_tables_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "g.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_gnss(path, GnssTuning())


def test_bad_rows_are_left_out_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "g.csv"
    path.write_text(
        "time,lat,lon,height\n3,35,139,1\n1,35,139,2\n2,,139,3\n2,95,139,3\n2,0,0,0\n1,35,139,9\nx,35,139,1\n"
    )
    gnss = read_gnss(path, GnssTuning())
    assert gnss.time_s.tolist() == [1, 3] and gnss.lat_lon_height[:, 2].tolist() == [2, 1]
    assert any("4 of 7 rows left out" in n and "(line 4, 5, 6, 8)" in n for n in gnss.notes)
    assert any("not in time order" in n for n in gnss.notes) and any("1 rows have the time" in n for n in gnss.notes)


def test_missing_gnss_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_gnss(tmp_path / "no.csv", GnssTuning())


@pytest.mark.parametrize(
    "text, seconds",
    [
        ("12.5", 12.5),
        ("01:00:01.5", 3601.5),
        ("2023-09-15T10:00:00.25+09:00", 1694739600.25),
        ("2023/09/15 01:00:00", 1694739600.0),
        ("soon", np.nan),
    ],
)
def test_times_are_read(text: str, seconds: float) -> None:
    assert parse_time(text) == pytest.approx(seconds, nan_ok=True)


@pytest.mark.parametrize(
    "stem, seconds",
    [("1557539956.400135", 1557539956.400135), ("cam_1557539956400135", 1557539956.400135),
     ("1557539956400", 1557539956.4), ("1557539956400135123", 1557539956.400135), ("IMG_20230915_010000", 1694739600.0),
     ("20230915010000500", 1694739600.5),
     ("000123", np.nan), ("9999999999", np.nan), ("IMG_20239915_010000", np.nan)],
)  # fmt: skip
def test_times_in_names(stem: str, seconds: float) -> None:
    assert time_in_name(stem) == pytest.approx(seconds, abs=1e-5, nan_ok=True)


# --- positions of frames --------------------


def test_positions_are_interpolated_and_gaps_stay_empty(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 10)
    t = np.array([99.5, 100.5, 101.5, 102.5, 106.5, 107.5])
    gnss = gnss_csv(tmp_path / "g.csv", t, np.stack([2 * t, -t, 0 * t + 3], axis=1))
    scene = scan(images, ENU, gnss=gnss, times=times_csv(tmp_path / "t.csv", 10))
    want = np.arange(100.0, 110.0)
    got = in_enu(scene)
    known = np.isfinite(got[:, 0])
    assert np.flatnonzero(known).tolist() == [0, 1, 2, 7]
    assert got[known] == pytest.approx(np.stack([2 * want, -want, 0 * want + 3], axis=1)[known], abs=1e-3)
    assert (
        np.allclose(scene.position_sigma_m[known], [0.05, 0.05, 0.1]) and np.isnan(scene.position_sigma_m[~known]).all()
    )
    assert scene.prior == "gnss" and scene.has_positions() and not scene.has_orientations()
    assert any("6 of 10 frames have no position" in n for n in scene.notes)
    assert np.allclose(scene.time_s, want)
    wide = scan(images, ScanSettings(crs="ENU", max_gap_s=10), gnss=gnss, times=tmp_path / "t.csv")
    assert np.isfinite(in_enu(wide)[:, 0]).sum() == 8  # the frames at 108 and 109 s are outside, not in a gap


def test_gnss_by_image_name_and_the_default_accuracy(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 3)
    llh = geodetic_from_world(np.array([[0.0, 0, 0], [5, 0, 0]]), ORIGIN)
    rows = [f"up/cam0/00000{k}.jpg,{a:.9f},{o:.9f},{h:.4f}" for k, (a, o, h) in enumerate(llh)]
    (tmp_path / "g.csv").write_text("image,lat,lon,alt\n" + "\n".join(rows) + "\nelse.jpg,35,139,1\n")
    scene = scan(images, ENU, gnss=tmp_path / "g.csv")
    assert in_enu(scene)[:2] == pytest.approx(np.array([[0, 0, 0], [5, 0, 0]]), abs=1e-3)
    assert np.allclose(scene.position_sigma_m[:2], [5, 5, 10]) and np.isnan(scene.position_sigma_m[2]).all()
    assert any("1 rows name images that are not here, such as else.jpg" in n for n in scene.notes)
    (tmp_path / "g.csv").write_text("image,lat,lon,alt\nelse.jpg,35,139,1\n")
    with pytest.raises(InputError, match="none of its images is here: else.jpg"):
        scan(images, gnss=tmp_path / "g.csv")


def test_frames_without_times_and_times_that_do_not_overlap(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 3)
    gnss = gnss_csv(tmp_path / "g.csv", np.arange(5.0), np.zeros((5, 3)))
    with pytest.raises(InputError, match="the frames have none.*--times"):
        scan(images, gnss=gnss)
    with pytest.raises(InputError, match=r"0.00 ... 4.00 s do not overlap the frames' 100.00 ... 102.00 s"):
        scan(images, gnss=gnss, times=times_csv(tmp_path / "t.csv", 3))


@pytest.mark.parametrize(
    "text, message",
    [
        ("name,when\na,1\n", "found the columns name, when; expected time and image"),
        ("frame,time\n0,1\n", "2 passes: add a column pass"),
        ("pass,frame,time\nup,0,soon\n", "line 2: 'soon' is no time"),
        ("image,time\nx.jpg,1\n", "none of its 1 rows names an image"),
    ],
)
def test_times_files_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, 2)
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        scan(images, times=tmp_path / "t.csv")


def test_times_by_image_and_frames_in_time_order(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 3)
    (tmp_path / "t.csv").write_text("image,time\nup/cam0/000000.jpg,30\nup/cam1/000001.jpg,20\nup/cam0/000002.jpg,10\n")
    scene = scan(images, times=tmp_path / "t.csv")
    assert scene.time_s.tolist() == [10, 20, 30] and scene.sequence_index.tolist() == [0, 1, 2]
    assert scene.names[int(np.flatnonzero(scene.frame == 0)[0])] == "up/cam0/000002.jpg"
    assert any("ordered by time" in n for n in scene.notes)


def test_times_from_file_names_reach_the_gnss(tmp_path: Path) -> None:
    t = 1694739600.0 + np.arange(4)
    for k in range(4):
        picture(tmp_path / "in" / "cam0" / f"{t[k]:.3f}.jpg")
        picture(tmp_path / "in" / "cam1" / f"{t[k]:.3f}.jpg")
    gnss = gnss_csv(tmp_path / "g.csv", t, np.stack([t - t[0], 0 * t, 0 * t], axis=1))
    scene = scan(tmp_path / "in", ENU, gnss=gnss)
    assert in_enu(scene)[:, 0] == pytest.approx([0, 1, 2, 3], abs=1e-3)


def test_positions_from_exif(tmp_path: Path) -> None:
    llh = geodetic_from_world(np.array([[0.0, 0, 0], [30, 10, 2], [60, 0, 4]]), ORIGIN)
    for k, (a, o, h) in enumerate(llh):
        picture(tmp_path / f"IMG_{k}.jpg", exif=exif_of(lat=a, lon=o, alt=h))
    picture(tmp_path / "IMG_9.jpg")
    scene = scan(tmp_path, ScanSettings(crs="EPSG:6677"))
    got = in_enu(scene)
    assert np.linalg.norm(got[:3] - [[0, 0, 0], [30, 10, 2], [60, 0, 4]], axis=1).max() < 0.05
    assert np.isnan(got[3]).all() and scene.prior == "exif"
    assert np.allclose(scene.position_sigma_m[:3], [5, 5, 10])
    assert scene.origin is not None and scene.origin.crs == "EPSG:6677"


@pytest.mark.parametrize(("others", "taken"), [(400.0, False), (2.0, True)])
def test_a_height_of_nought_among_others_is_none(tmp_path: Path, others: float, taken: bool) -> None:
    for k in range(5):
        picture(
            tmp_path / f"IMG_{k}.jpg", exif=exif_of(lat=35.0, lon=139 + 1e-4 * k, alt=0.0 if k == 2 else others + k)
        )
    scene = scan(tmp_path, ScanSettings(crs="ENU"))
    heights = scene.world_from_rig[:, 2, 3]
    assert (np.ptp(heights) < 10) and any("1 positions have no height" in n for n in scene.notes) != taken
    assert (scene.position_sigma_m[2, 2] > 50) != taken


@pytest.mark.parametrize("crs", ["ENU", "auto"])
def test_a_survey_on_both_sides_of_180_degrees_is_one_place(tmp_path: Path, crs: str) -> None:
    for k in range(4):
        picture(
            tmp_path / f"IMG_{k}.jpg", exif=exif_of(lat=-16.8, lon=(179.9997 + 0.0002 * k + 180) % 360 - 180, alt=5)
        )
    scene = scan(tmp_path, ScanSettings(crs=crs))
    assert scene.origin is not None and abs(scene.origin.lon_deg) > 179.999
    steps = np.diff(scene.world_from_rig[:, :3, 3], axis=0)
    assert np.abs(scene.world_from_rig[:, :2, 3]).max() < 150
    assert np.linalg.norm(steps, axis=1) == pytest.approx(np.full(3, 21.3), abs=0.05)  # 0.0002 deg at 16.8 south


# --- trajectories --------------------


def drive(frames: int, turn_deg: float = 60.0) -> np.ndarray:
    """(F, 4, 4) world_from_body of a level body (x forward, y left, z up) on an arc from the origin, 1 m a frame."""
    yaw = np.radians(np.linspace(0, turn_deg, frames))
    step = np.stack([np.cos(yaw), np.sin(yaw), 0.02 * np.sin(4 * yaw)], axis=1)
    position = np.cumsum(step, axis=0) - step[0]
    return rigid(Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix(), position)


def test_tum_files_are_written_and_read(tmp_path: Path) -> None:
    poses = drive(5)
    write_tum(tmp_path / "a.tum", np.arange(5.0), poses)
    again = read_trajectory(tmp_path / "a.tum")
    assert np.allclose(again.poses, poses, atol=1e-8) and again.time_s.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    "text, message",
    [
        ("0 1 2 3\n", "line 1: 4 columns; expected 8"),
        ("# x\n0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0\n", "line 3: 7 columns"),
        ("0 0 0 0 0 0 0 x\n", "line 1: not all cells are numbers"),
        ("0 0 0 0 0 0 0 nan\n", "line 1: not a finite number"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0\n", "line 2: the quaternion.*length 0"),
        ("1 0 0 0 0 2 0 0 0 0 1 0\n", "line 1: .*not a rotation"),
        ("# nothing\n", "no rows; give the trajectory"),
    ],
)
def test_trajectories_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(InputError, match=message):
        read_trajectory(tmp_path / "a.tum")


def test_one_trajectory_as_long_as_the_pass(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 5)
    poses = drive(5)
    write_tum(tmp_path / "a.tum", 50 + np.arange(5.0), poses)
    scene = scan(images, trajectory=tmp_path / "a.tum")
    assert scene.prior == "trajectory" and np.allclose(scene.world_from_rig, poses, atol=1e-8)
    assert scene.time_s.tolist() == [50, 51, 52, 53, 54] and np.isnan(scene.position_sigma_m).all()
    assert any("'cam0' (x right, y down, z forward)" in n for n in scene.notes)


def test_kitti_poses_by_frame(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 4)
    np.savetxt(tmp_path / "poses.txt", drive(4)[:, :3].reshape(4, 12))
    assert np.allclose(scan(images, trajectory=tmp_path / "poses.txt").world_from_rig, drive(4), atol=1e-8)
    np.savetxt(tmp_path / "poses.txt", drive(5)[:, :3].reshape(5, 12))
    with pytest.raises(InputError, match="5 poses for 4 frames, and nothing says which"):
        scan(images, trajectory=tmp_path / "poses.txt")


def test_a_trajectory_by_time_is_interpolated(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 4)
    t = np.array([99.5, 100.5, 101.5, 102.5])
    write_tum(tmp_path / "a.tum", t, rigid(np.tile(np.eye(3), (4, 1, 1)), np.stack([t, t, t], axis=1)))
    scene = scan(images, trajectory=tmp_path / "a.tum", times=times_csv(tmp_path / "t.csv", 4))
    assert scene.world_from_rig[:3, 0, 3] == pytest.approx([100, 101, 102]) and np.isnan(scene.world_from_rig[3, 0, 3])
    with pytest.raises(InputError, match="do not overlap"):
        scan(images, trajectory=tmp_path / "a.tum", times=times_csv(tmp_path / "t.csv", 4, start=900))


def flu_rig(folder: Path) -> str:
    path = folder / "rig.toml"
    path.write_text(
        'axes = "flu"\nantenna_m = [0.9, 0.6, 0.3]\n[[sensors]]\nname = "cam0"\nposition_m = [0.1, 0, 0.2]\n'
        'yaw_pitch_roll_deg = [30, -5, 0]\n[[sensors]]\nname = "cam1"\nyaw_pitch_roll_deg = [100, 0, 0]\n'
    )
    return str(path)


def test_a_trajectory_of_the_body_becomes_one_of_the_first_camera(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 6)
    body = drive(6)
    write_tum(tmp_path / "a.tum", np.arange(6.0), body)
    scene = scan(images, rig=flu_rig(tmp_path), trajectory=tmp_path / "a.tum")
    body_from_cam0 = rigid(orient(30, -5, 0, "flu"), np.array([0.1, 0, 0.2]))
    assert np.allclose(scene.world_from_rig, body @ body_from_cam0, atol=1e-8)
    assert scene.rigs[0].antenna_m == pytest.approx(np.linalg.inv(body_from_cam0)[:3] @ [0.9, 0.6, 0.3, 1])
    assert any("body frame of rig.toml" in n for n in scene.notes)


def test_odometry_of_each_pass_is_never_in_one_world(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, 5)
    (tmp_path / "vo").mkdir()
    for name in ("up", "down"):
        write_tum(tmp_path / "vo" / f"vo_{name}.tum", np.arange(5.0), drive(5))
    scene = scan(images, trajectory=tmp_path / "vo")
    assert scene.prior == "odometry" and scene.has_orientations() and not scene.measured_positions().any()
    assert scene.pose_world().tolist() == [0] * 5 + [1] * 5
    assert any("each pass in a world of its own" in n for n in scene.notes)
    shifted = drive(5)
    shifted[:, 0, 3] += 7
    write_tum(tmp_path / "vo" / "vo_down.tum", np.arange(5.0), shifted)
    scene = scan(images, trajectory=tmp_path / "vo")
    assert scene.prior == "trajectory" and set(scene.pose_world()) == {0} and scene.measured_positions().all()


def test_folders_without_a_trajectory_for_a_pass(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, 2)
    (tmp_path / "vo").mkdir()
    with pytest.raises(InputError, match="none of its files"):
        scan(images, trajectory=tmp_path / "vo")
    for name in ("a", "b"):
        write_tum(tmp_path / "vo" / f"{name}.tum", np.arange(2.0), drive(2))
    with pytest.raises(InputError, match=r"\(a.tum, b.tum\) has the name of a pass in its own \(down, up\)"):
        scan(images, trajectory=tmp_path / "vo")
    with pytest.raises(InputError, match="no such file or folder"):
        scan(images, trajectory=tmp_path / "nowhere")


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_odometry_laid_on_gnss_gives_poses_in_the_world(tmp_path: Path, scale: float) -> None:
    """Two passes, each odometry in its own world and scale, GNSS off the body, an outage in the middle."""
    frames = 12
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, frames)
    (tmp_path / "vo").mkdir()
    rng = np.random.default_rng(3)
    truth, times, positions = {}, [], []
    for n, name in enumerate(("up", "down")):
        body = drive(frames, 80)
        turn = rigid(Rotation.from_euler("z", 40 + 150 * n, degrees=True).as_matrix(), np.array([20.0 * n, 5, 2]))
        truth[name] = turn @ body
        odometry = body.copy()
        odometry[:, :3, 3] *= scale
        time_s = 100 + 1000 * n + np.arange(frames, dtype=float)
        write_tum(tmp_path / "vo" / f"{name}.tum", time_s, odometry)
        antenna = (truth[name] @ [0.9, 0.6, 0.3, 1])[:, :3] + rng.normal(0, 0.02, (frames, 3))
        open_sky = np.r_[0:4, 8:12]
        times.append(time_s[open_sky])
        positions.append(antenna[open_sky])
    gnss = gnss_csv(tmp_path / "g.csv", np.concatenate(times), np.concatenate(positions))
    scene = scan(images, ENU, rig=flu_rig(tmp_path), gnss=gnss, trajectory=tmp_path / "vo")
    assert scene.prior == "gnss" and np.isfinite(scene.world_from_rig).all()
    assert np.isfinite(scene.position_sigma_m[:, 0]).sum() == scene.measured_positions().sum() == 16
    body_from_cam0 = rigid(orient(30, -5, 0, "flu"), np.array([0.1, 0, 0.2]))
    for name in ("up", "down"):
        rows = scene.sequence == scene.sequences.index(name)
        want = truth[name] @ body_from_cam0
        error = angle_deg(scene.world_from_rig[rows, :3, :3], want[:, :3, :3])
        assert 0 < error.max() < 1.0
        miss = np.linalg.norm(in_enu(scene)[rows] - (truth[name] @ [0.9, 0.6, 0.3, 1])[:, :3], axis=1)
        assert 0 < miss[4:8].max() < 0.15
        assert 0 < miss[:4].max() < 0.15


def test_a_heading_column_gives_level_rotations(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 2, 3)
    llh = geodetic_from_world(np.array([[0.0, 0, 0], [0, 5, 0], [0, 10, 0]]), ORIGIN)
    rows = [
        f"{100 + k},{a:.9f},{o:.9f},{h:.3f},{heading}" for k, ((a, o, h), heading) in enumerate(zip(llh, (350, 90, 10)))
    ]
    (tmp_path / "g.csv").write_text("time,lat,lon,height,heading\n" + "\n".join(rows) + "\n")
    scene = scan(images, ENU, rig=flu_rig(tmp_path), gnss=tmp_path / "g.csv", times=times_csv(tmp_path / "t.csv", 3))
    body = scene.world_from_rig[:, :3, :3] @ orient(30, -5, 0, "flu").T
    assert body[1, :, 0] == pytest.approx([1, 0, 0], abs=1e-6)  # heading 90: forward is east
    assert body[0, :, 0] == pytest.approx([np.sin(np.radians(350)), np.cos(np.radians(350)), 0], abs=1e-6)
    assert body[:, :, 2] == pytest.approx(np.tile([0, 0, 1.0], (3, 1)), abs=1e-6)
    assert np.linalg.det(AXES["flu"]) == pytest.approx(1)


def test_canal_gnss_and_odometry() -> None:
    """Real-looking sensors: outages under the bridge, single fixes, drifting odometry per pass."""
    sensors = data("canal_demo", "sensors")
    scene = scan(data("canal_demo", "images"), rig="ladybug5", gnss=sensors / "gnss.csv", trajectory=sensors)
    known = np.isfinite(scene.position_sigma_m[:, 0])
    assert 8 <= known.sum() <= 12 and np.isfinite(scene.world_from_rig).all()
    assert scene.origin is not None and scene.origin.crs == "EPSG:32654"
    assert np.ptp(scene.world_from_rig[:, :3, 3], axis=0).max() < 40  # m: the boat stays on its canal


def test_a_pass_without_a_trajectory_and_what_a_file_says_of_itself_is_noted(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, 5)
    (tmp_path / "vo").mkdir()
    write_tum(tmp_path / "vo" / "vo_up.tum", np.arange(5.0), drive(5))
    write_tum(tmp_path / "vo" / "vo_dwn.tum", np.arange(5.0), drive(5))
    notes = scan(images, trajectory=tmp_path / "vo").notes
    assert any("no trajectory of pass down: none of the other files than vo_up.tum" in n for n in notes)
    rows = (tmp_path / "vo" / "vo_up.tum").read_text().splitlines()
    (tmp_path / "vo" / "vo_up.tum").write_text("\n".join([rows[0], rows[2], rows[1], *rows[3:], rows[-1]]))
    notes = scan(images, trajectory=tmp_path / "vo").notes
    assert any("vo_up.tum, line 3: rows are not in time order" in n for n in notes)
    assert any("vo_up.tum, line 7: 1 rows have the time of another row" in n for n in notes)
