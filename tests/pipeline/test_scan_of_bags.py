"""The scan stage on bags of ROS: topics are cameras, headers are clocks, and positions and poses meet them by time."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import bag_world as world
import recording_world
import tiegraph
from bag_world import START_S
from said import refused
from tiegraph.api import Project
from tiegraph.cli.main import main
from tiegraph.scan.videos.bagfilms import find_bags
from tiegraph.scene.exif import read_exif

pytestmark = pytest.mark.slow
SIZE = (160, 120)
TIMES = START_S + 0.2 * np.arange(20)  # four seconds, five pictures each
APART_S = 0.013  # of the second camera behind the first
K = (150.0, 151.0, 79.0, 61.0)


def picture(number: int, seed: int = 0) -> np.ndarray:
    """A texture with a bright patch whose grey is the number."""
    out = np.random.default_rng(seed).integers(0, 120, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    out[40:80, 50:110] = 10 * number + 20
    return out


def number_of(file: Path) -> int:
    return round((float(np.mean(cv2.imread(str(file))[50:70, 60:100])) - 20) / 10)


def camera(topic: str = "/left/image_raw", late_s: float = 0.0, kind: str = "raw") -> list[world.Row]:
    """Twenty pictures; how late each is received changes."""
    made = world.image if kind == "raw" else world.compressed
    received = (TIMES + np.array([0.15, 0.05] * 10)).tolist()
    pictures = [picture(k, seed=len(topic)) for k in range(len(TIMES))]
    return [made(topic, t + late_s, p, received_s=r) for t, p, r in zip(TIMES, pictures, received)]


def fixes(topic: str = "/gps/fix") -> list[world.Row]:
    """Ten fixes a second, 3 m/s to the north."""
    times = START_S + 0.1 * np.arange(-5, 50)
    return [world.fix(topic, t, (35 + 3 * (t - START_S) / 110_946, 139.0, 40.0), (0.02, 0.02, 0.05)) for t in times]


def scanned(images: Path, out: Path, **inputs: object) -> Project:
    return tiegraph.open(images, out, pool="serial", **inputs).run("scan")


def said(project: Project, words: str) -> bool:
    return any(words in note for note in project.receipt("scan")["notes"])


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_topics_of_a_bag_are_the_cameras_of_a_rig(tmp_path: Path, form: str) -> None:
    rows = camera() + camera("/right/image_raw/compressed", APART_S, "jpeg") + fixes()
    path = world.bag(tmp_path / "in", form, rows)
    project = scanned(tmp_path / "in", tmp_path / "out", gnss=path)
    scene = project.scene()
    assert [s.name for s in scene.all_sensors] == ["left", "right"]
    assert (scene.sequences, scene.frames, len(scene)) == (("run",), 8, 16)
    for frame in range(scene.frames):
        files = [tmp_path / "out" / "images" / scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
        one, other = (number_of(f) for f in files)
        assert one == other
        with Image.open(files[0]) as left, Image.open(files[1]) as right:
            times = [read_exif(f, f.size).time_s for f in (left, right)]
        np.testing.assert_allclose(times, [TIMES[one], TIMES[one] + APART_S], rtol=0, atol=2e-6)
        assert abs(scene.time_s[frame] - np.mean(times)) < 1e-5
    north = scene.world_from_rig[:, 1, 3]
    np.testing.assert_allclose(north - north[0], 3 * (scene.time_s - scene.time_s[0]), rtol=5e-4, atol=1e-3)
    assert north[-1] - north[0] > 9
    np.testing.assert_allclose(scene.position_sigma_m, np.tile([0.02, 0.02, 0.05], (8, 1)))
    assert said(project, "right/image_raw/compressed begins +0.0130 s after")
    assert said(project, ":/left/image_raw (by the stamps of their messages)")
    assert said(project, "pictures lie 13.0 ms from the instants")
    assert said(project, "begins at 2024-05-01 12:00:00 UTC by the stamp of its first message, which was received")
    assert not said(project, "has positions")


def test_a_bag_itself_and_topics_of_it_are_images(tmp_path: Path) -> None:
    poses = [
        world.odometry("/odom", t, (k, 0, 0), Rotation.from_euler("z", 5 * k, degrees=True).as_quat())
        for k, t in enumerate(TIMES)
    ]
    path = world.bag(tmp_path, "mcap", camera() + camera("/right/image_raw") + fixes() + poses)
    project = scanned(path, tmp_path / "out")
    assert len(project.scene()) == 16
    assert said(project, f"run has positions, /gps/fix (sensor_msgs/NavSatFix, 55): --gnss {path}:/gps/fix")
    one = Path(f"{path}:/right/image_raw")
    rig = tmp_path / "rig.toml"
    rig.write_text('axes = "flu"\n[[sensors]]\nname = "right"\nyaw_pitch_roll_deg = [0, 0, 0]\n')
    project = scanned(one, tmp_path / "one", trajectory=Path(f"{path}:/odom"), rig=str(rig))
    scene = project.scene()
    assert (len(scene), [s.name for s in scene.all_sensors]) == (8, ["right"])
    shown = [number_of(tmp_path / "one" / "images" / n) for n in scene.names]
    np.testing.assert_allclose(scene.world_from_rig[:, 0, 3], shown, atol=1e-5)
    ahead = scene.world_from_rig[:, :3, 2]
    np.testing.assert_allclose(np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])), 5.0 * np.array(shown), atol=1e-4)
    assert said(project, "poses of /odom (nav_msgs/Odometry, 20): base_link in 'odom'")
    assert tiegraph.open(one, tmp_path / "one", pool="serial").status()[0][1] == ""
    other = tiegraph.open(Path(f"{path}:/left/image_raw"), tmp_path / "one", pool="serial")
    assert "the image folder" in other.status()[0][1]
    assert other.run("scan").scene().names[0] == "run/left/left_000000.jpg"


def test_what_is_no_camera_of_its_own_is_left_out(tmp_path: Path) -> None:
    depth = [world.image("/depth/image", t, np.ones((24, 32), np.uint16), "16UC1") for t in TIMES]
    rows = camera("/forward/image_raw") + camera("/forward/image_raw/compressed", kind="jpeg") + depth
    project = scanned(world.bag(tmp_path, "ros1", rows), tmp_path / "out")
    assert len(project.scene()) == 8 and len(project.scene().all_sensors) == 1
    assert said(project, "run.bag:/forward/image_raw/compressed: left out: as /forward/image_raw is")
    assert said(project, "run.bag:/depth/image: left out: encoding 16UC1")
    with refused("no topic with pictures: only.bag:/depth/image: left out: encoding 16UC1"):
        scanned(world.bag(tmp_path, "ros1", depth, name="only"), tmp_path / "none")


def test_two_topics_of_one_camera_are_asked_about(tmp_path: Path) -> None:
    rows = camera("/left/image_raw") + camera("/left/image_rect_color") + camera("/right/image_raw", APART_S)
    path = world.bag(tmp_path / "in", "sqlite", rows)
    words = r"/left/image_raw \(sensor_msgs/Image, 20\) and /left/image_rect_color .* are of one camera"
    with refused(f"{words}.*run:/left/image_raw,/right/image_raw"):
        scanned(tmp_path / "in", tmp_path / "out")
    for images in (path, tmp_path / "in"):  # both or a folder
        chosen = Path(f"{images}:/left/image_rect_color,/right/image_raw")
        assert len(scanned(chosen, tmp_path / f"of_{images.name}").scene()) == 16
    with refused(r"has no topic /lft/image_raw of .*; 3 topics of that kind: /left/image_raw"):
        scanned(Path(f"{path}:/lft/image_raw"), tmp_path / "out2")


def test_bags_are_passes_of_one_rig(tmp_path: Path) -> None:
    for k, name in enumerate(("up", "down")):
        shifted = [world.Row(r.topic, r.kind, r.received_s, r.built) for r in camera(late_s=100.0 * k)]
        world.bag(tmp_path / "in", "ros1", shifted + camera("/right/image_raw", 100.0 * k), name=name)
    scene = scanned(tmp_path / "in", tmp_path / "out").scene()
    assert (scene.sequences, len(scene.rigs), len(scene.all_sensors), len(scene)) == (("down", "up"), 1, 2, 32)
    assert np.ptp(scene.time_s) > 99


def test_a_bag_and_the_tracks_of_a_video_lie_in_one_folder(tmp_path: Path) -> None:
    one, other = (recording_world.film(tmp_path / f"{k}.mp4", level=k) for k in (20, 150))
    world.bag(tmp_path / "in", "ros1", camera() + camera("/right/image_raw", APART_S))
    recording_world.two_tracks(tmp_path / "in" / "shot.insv", one, other)
    project = scanned(tmp_path / "in", tmp_path / "out")
    folders = {n.rpartition("/")[0] for n in project.scene().names}
    assert folders == {"run/left", "run/right", "shot/fisheye0", "shot/fisheye1"}
    assert said(project, "run.bag:/right/image_raw begins +0.0130 s after run.bag:/left/image_raw (by the stamps")
    assert said(project, "shot.insv, track 2 begins +0.0000 s after shot.insv, track 1 (the lenses of one recording)")


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_the_calibration_of_a_bag_is_a_start(tmp_path: Path, form: str) -> None:
    d = (-0.2, 0.05, 0.001, -0.001, 0.0)
    infos = [
        world.camera_info("/left/camera_info", SIZE, K, d),
        world.camera_info("/right/camera_info", SIZE, K, d, p=(140, 0, 80, 0, 0, 140, 60, 0, 0, 0, 1, 0)),
    ]
    rows = infos + camera() + camera("/right/image_rect_color", APART_S)
    scene = scanned(world.bag(tmp_path, form, rows), tmp_path / "out").scene()
    left, right = (s.camera for s in scene.all_sensors)
    rays = np.array([[x, y, 1.0] for x in (-0.4, 0.0, 0.35) for y in (-0.3, 0.0, 0.25)])
    truth = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), intrinsics(K), np.array(d))[0][:, 0] + 0.5
    off = np.abs(left.img_from_cam(rays) - truth).max()
    assert 0 < off < 1.0 and left.has_prior_focal_length  # RADIAL has no tangential terms, and one focal length
    assert np.allclose(right.img_from_cam(rays), 140 * rays[:, :2] + (80.5, 60.5), atol=1e-6)
    assert all(0 < s.camera_sigma_px < 3 for s in scene.all_sensors)


def intrinsics(k: tuple[float, ...]) -> np.ndarray:
    return np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1.0]])


@pytest.mark.parametrize(
    "info, words",
    [
        ((SIZE, (0, 0, 0, 0)), "a camera that was not calibrated"),
        (((320, 240), K), "of images of 320 x 240, not 160 x 120"),
        ((SIZE, K, (), "plumb_bob", (0.0,) * 12, 2), "binning_x = 2"),
        ((SIZE, K, (0.1,) * 4, "odd"), "distortion_model odd"),
        ((SIZE, (1.0, 1.0, 80, 60)), "left/camera_info: "),
    ],
)
def test_a_calibration_that_cannot_be_used_is_said(tmp_path: Path, info: tuple, words: str) -> None:
    rows = [world.camera_info("/left/camera_info", *info), *camera()]
    project = scanned(world.bag(tmp_path, "ros1", rows), tmp_path / "out")
    notes = project.receipt("scan")["notes"]
    assert any("run.bag:/left/camera_info" in n and words in n for n in notes), notes
    assert not project.scene().all_sensors[0].camera.has_prior_focal_length


def test_pictures_without_stamps_and_broken_ones_are_said(tmp_path: Path) -> None:
    rows = [world.image("/left/image_raw", t, picture(k), stamped=False) for k, t in enumerate(TIMES)]
    rows[7] = world.image("/left/image_raw", TIMES[7], picture(7)[:, :, 0], "bgr8", stamped=False)  # bytes are missing
    rows[9] = world.image("/left/image_raw", TIMES[6], picture(9), received_s=TIMES[9])
    project = scanned(world.bag(tmp_path, "ros1", rows), tmp_path / "out")
    assert said(project, "1 have a stamp that is not later than the one before")
    assert said(project, "by its receipt: its headers have no stamps")
    assert said(project, "1 of its 20 messages have no whole picture")
    assert 0 <= project.scene().time_s[0] - START_S - world.LATE_S < 0.5


def test_the_command_line_takes_a_bag_and_stores_nothing_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = world.bag(tmp_path, "ros1", camera() + fixes() + fixes("/rtk/fix"))
    run = ["run", str(path), "--until", "scan", "--pool", "serial"]
    assert main([*run, "--gnss", f"{path}:/rtk/fix"]) == 0
    stored = (tmp_path / "run.bag_tiegraph" / "tiegraph.toml").read_text()
    assert f"{path}:/rtk/fix" in stored
    assert main([*run, "--gnss", str(path)]) != 0
    assert "2 topics of that kind: /gps/fix" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "run.bag_tiegraph" / "tiegraph.toml").read_text() == stored
    assert main([*run, "--gnss", f"{path}:/gps/fix"]) == 0
    (tmp_path / "plain.txt").write_text("no bag")
    assert main(["run", str(tmp_path / "plain.txt"), "--until", "scan"]) != 0
    assert "is a file, and no video or bag; give the folder" in capsys.readouterr().err


def test_bags_beside_images_and_broken_ones_are_said(tmp_path: Path) -> None:
    path = world.bag(tmp_path / "in", "ros1", camera())
    path.write_bytes(path.read_bytes()[:5000])
    with refused("run.bag: cannot be read as a ROS bag"):
        scanned(tmp_path / "in", tmp_path / "out")
    for k in range(3):
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), picture(k, seed=k))
    project = scanned(tmp_path / "in", tmp_path / "beside")
    assert len(project.scene()) == 3 and said(project, "1 videos and bags beside the images are left out")


def test_bags_below_a_folder_are_found_once(tmp_path: Path) -> None:
    one = world.bag(tmp_path / "in" / "a", "ros1", fixes())
    two = world.bag(tmp_path / "in", "mcap", fixes(), name="b")
    loose = Path(shutil.copy(next(two.glob("*.mcap")), tmp_path / "in" / "c.mcap"))
    (tmp_path / "in" / "other").mkdir()
    (tmp_path / "in" / "other" / "metadata.yaml").write_text("author: nobody\n")
    assert find_bags(tmp_path / "in") == [one, two, loose]
    assert find_bags(two) == [two] and find_bags(tmp_path / "none") == []
