"""The scan stage on a folder of videos: pictures are taken once, and again when the setting changes."""

from __future__ import annotations

import re
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

import recording_world
import tiegraph
import video_world
from said import refused, says
from tiegraph.api import Project
from tiegraph.scene.exif import read_exif

pytestmark = pytest.mark.slow
START_S = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc).timestamp()


def scanned(images: Path, out: Path, settings: dict | None = None, **inputs: object) -> Project:
    given = {"settings": {"scan": settings}} if settings else {}
    return tiegraph.open(images, out, pool="serial", **given, **inputs).run("scan")


def said(project: Project, words: str) -> bool:
    """Whether a note of the scan has the words (a regular expression)."""
    return says(project.receipt("scan")["notes"], words)


def film(path: Path, seconds: int) -> None:
    rng = np.random.default_rng(len(path.name))
    video_world.film(path, (rng.integers(0, 255, (120, 160, 3), np.uint8) for _ in range(5 * seconds)), 5)


def test_pictures_are_taken_and_follow_the_setting(tmp_path: Path) -> None:
    film(tmp_path / "in" / "up.avi", 4)
    (tmp_path / "in" / "broken.mp4").write_bytes(b"\0" * 5000)
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene = project.scene()
    assert [Path(n).name for n in scene.names] == [f"up_{k:06d}.jpg" for k in range(8)]
    assert all((tmp_path / "out" / "images" / n).exists() for n in scene.names)
    assert said(project, "broken.mp4 cannot be decoded")
    assert len(scanned(tmp_path / "in", tmp_path / "out", {"video_fps": 1.0}).scene()) == 4


def test_videos_beside_images_are_left_out_and_said(tmp_path: Path) -> None:
    film(tmp_path / "in" / "a.avi", 1)
    for k in range(3):
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), np.random.default_rng(k).integers(0, 255, (90, 120, 3)))
    project = scanned(tmp_path / "in", tmp_path / "out")
    assert len(project.scene()) == 3 and said(project, "1 videos beside the images are left out")


def test_only_broken_videos_are_an_error_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "broken.mp4").write_bytes(b"\0" * 5000)
    with refused("broken.mp4 cannot be decoded.*H.264"):
        scanned(tmp_path / "in", tmp_path / "out")


def recorded(path: Path, begin_s: float, **camera: object) -> Path:
    """Five seconds of a shaken rig, 15 frames a second, from a time on; the file says when, in whole seconds."""
    times = begin_s + np.arange(75) / 15
    video_world.film(path, video_world.pictures(video_world.Shake.of(3), times, **camera), 15.0)
    return recording_world.created(path, int(START_S + begin_s))


def taken_s(file: Path) -> float:
    with Image.open(file) as image:
        return read_exif(image, image.size).time_s


def track(path: Path) -> Path:
    """A receiver's fixes, five a second: 3 m/s to the north."""
    rows = [f"{START_S + t:.1f},{35 + 3 * t / 110_946:.9f},139.0,40.0,0.02" for t in np.arange(-5, 20, 0.2)]
    path.write_text("\n".join(["unix_time,lat,lon,height,sigma", *rows]))
    return path


def test_frames_of_a_video_meet_positions_by_time(tmp_path: Path) -> None:
    recorded(tmp_path / "in" / "walk.mp4", 2.0)
    gnss = track(tmp_path / "track.csv")
    project = scanned(tmp_path / "in", tmp_path / "out", gnss=gnss)
    scene = project.scene()
    assert (scene.sequences, len(scene)) == (("walk",), 10)
    assert np.all(np.diff(scene.time_s) > 0.1) and 0 <= scene.time_s[0] - (START_S + 2) < 0.5
    north = scene.world_from_rig[:, 1, 3]
    assert np.allclose(north - north[0], 3 * (scene.time_s - scene.time_s[0]), atol=0.02)
    assert said(project, "walk.mp4: begins at 2024-05-01 10:00:02 UTC")
    moved = scanned(tmp_path / "in", tmp_path / "late", {"video_offset": ("1.0",)}, gnss=gnss).scene()
    assert np.allclose(moved.time_s - scene.time_s, 1.0, atol=1e-5)
    rows = [f"{n},{100 + k}" for k, n in enumerate(scene.names)]
    (tmp_path / "times.csv").write_text("\n".join(["image,time", *rows]))
    told = scanned(tmp_path / "in", tmp_path / "told", times=tmp_path / "times.csv").scene()
    assert told.time_s.tolist() == list(range(100, 110))


def test_a_camera_with_a_receiver_says_where_times_and_positions_came_from(tmp_path: Path) -> None:
    video = recorded(tmp_path / "in" / "GX010001.mp4", 2.0)
    start = datetime(2024, 5, 1, 8, 0, 2, 500000, timezone.utc)  # the container is two hours late: local time
    fixes = recording_world.walk(start, 50, 10)
    fixes[:5] = recording_world.walk(start, 5, 10, fix=0)
    recording_world.with_telemetry(video, [recording_world.gps9(fixes[k : k + 10]) for k in range(0, 50, 10)])
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene = project.scene()
    assert np.all(np.abs(scene.time_s - start.timestamp() - 0.25 - 0.5 * np.arange(10)) < 0.26)
    placed = np.isfinite(scene.world_from_rig[:, 1, 3])
    assert 9 <= placed.sum() <= 10 and placed[1:].all()
    place, time_s = scene.world_from_rig[placed, :2, 3], scene.time_s[placed]
    way = np.hypot(*(place - place[0]).T)
    assert np.allclose(way, recording_world.SPEED * (time_s - time_s[0]), atol=0.01)
    receiver = r"^GX010001.mp4: begins.*2024-05-01 08:00:02\.500 UTC by 45 times of its receiver"
    assert said(
        project, rf"{receiver}.*\(GPS9\): 45 of 50 fixes used \(5 without a fix left out\), heights above the sea"
    )
    gnss = track(tmp_path / "track.csv")  # what the user gives comes first: nothing of it is of that time
    with refused("times"):
        scanned(tmp_path / "in", tmp_path / "given", gnss=gnss)


def test_videos_of_a_rig_are_aligned_by_their_motion(tmp_path: Path) -> None:
    recorded(tmp_path / "in" / "cam0.mp4", 0.0)
    recorded(tmp_path / "in" / "cam1.mp4", 0.52, turn_deg=(10, 70, 20), focal_px=110.0)
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene, notes = project.scene(), project.receipt("scan")["notes"]
    assert len(scene.all_sensors) == 2 and scene.frames == 10 and len(scene) == 19  # cam1 lacks the first
    times = [taken_s(tmp_path / "out" / "images" / n) for n in scene.names]
    for frame in range(1, scene.frames):
        one, other = (times[k] for k in np.flatnonzero(scene.frame == frame))
        assert 0 < abs(one - other) < 0.02 and abs((one + other) / 2 - scene.time_s[frame]) < 1e-5
    begun = next(n for n in notes if n.startswith("cam1.mp4 begins"))
    offset, sigma_ms = re.findall(r"begins ([-+.\d]+) s after cam0.mp4 \(sigma ([.\d]+) ms", begun)[0]
    assert abs(float(offset) - 0.52) < 0.002 and 0.1 < float(sigma_ms) < 5
    apart = next(n for n in notes if "from the instants of the first camera" in n)
    assert 10 < float(re.findall(r"lie ([.\d]+) ms", apart)[0]) < 16 and "1 of 10 instants are not in it" in apart
    told = scanned(tmp_path / "in", tmp_path / "told", {"video_offset": ("cam1=0.4",)})
    assert said(told, r"cam1\.mp4 begins \+0\.4000 s after cam0\.mp4 \(by --scan\.video-offset\)")


def test_positions_by_time_and_a_video_without_one_say_the_remedy(tmp_path: Path) -> None:
    film(tmp_path / "in" / "walk.avi", 3)
    gnss = track(tmp_path / "track.csv")
    with refused(f"count from the start of a video.*--scan.video-offset {START_S - 5:.0f}"):
        scanned(tmp_path / "in", tmp_path / "out", gnss=gnss)
    known = scanned(tmp_path / "in", tmp_path / "known", {"video_offset": (str(START_S),)}, gnss=gnss)
    assert np.isfinite(known.scene().world_from_rig[:, 0, 3]).all()


def test_a_broken_video_of_a_rig_is_named(tmp_path: Path) -> None:
    film(tmp_path / "in" / "cam0.avi", 2)
    (tmp_path / "in" / "cam1.avi").write_bytes(b"\0" * 5000)
    project = scanned(tmp_path / "in", tmp_path / "out")
    assert len(project.scene()) == 4 and said(project, "cam1.avi cannot be decoded")
    (tmp_path / "rig.toml").write_text('[[sensors]]\nname = "cam0"\n[[sensors]]\nname = "cam1"\n')
    with refused("'cam1'.*cam1.avi cannot be decoded"):
        scanned(tmp_path / "in", tmp_path / "rig", rig=str(tmp_path / "rig.toml"))


def test_recordings_that_all_begin_at_zero_are_said(tmp_path: Path) -> None:
    for name in ("morning", "noon"):
        film(tmp_path / "in" / f"{name}.avi", 3 + len(name) % 3)
    counted, at_once = (
        "2 videos, such as morning.avi and noon.avi, each count from",
        "recorded at the same time by their",
    )
    assert said(scanned(tmp_path / "in", tmp_path / "out"), counted)
    assert said(scanned(tmp_path / "in", tmp_path / "dated", {"video_offset": (str(START_S),)}), f"avi were {at_once}")
    project = scanned(tmp_path / "in", tmp_path / "later", {"video_offset": ("noon=100",)})
    assert not said(project, "each count from") and not said(project, "at the same time")
    times = project.scene().time_s[project.scene().sequence == 1]
    assert 100 <= times.min() < times.max() < 106


def test_an_offset_that_the_motion_does_not_tell_is_asked_for(tmp_path: Path) -> None:
    for name in ("cam0", "second_cam"):
        film(tmp_path / "in" / f"{name}.avi", 4)
    with refused("second_cam.avi: the motion .* no offset stands out.*--scan.video-offset second_"):
        scanned(tmp_path / "in", tmp_path / "out")
    told = scanned(tmp_path / "in", tmp_path / "told", {"video_offset": ("second_cam=0",)}).scene()
    assert (told.frames, len(told)) == (8, 16)
    apart = scanned(tmp_path / "in", tmp_path / "apart", {"layout": "sequence"}).scene()
    assert apart.sequences == ("cam0", "second_cam")
