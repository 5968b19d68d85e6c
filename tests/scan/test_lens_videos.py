"""Videos of 360 cameras before stitching: two files of a shot, or two tracks of a file, are two cameras."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

import recording_world as world
import tiegraph
from said import refused, says
from tiegraph.api import Project
from tiegraph.scan.videos.video import picture_folders
from video_world import film


def scanned(images: Path, out: Path) -> Project:
    return tiegraph.open(images, out, pool="serial").run("scan")


def sensors(project: Project) -> tuple:
    scene = project.scene()
    return len(scene), scene.frames, [s.name for s in scene.all_sensors]


def shot(path: Path, width: int = 96, seed: int = 0, lenses: int = 1) -> Path:
    """Two seconds of MP4 with a circle a lens, side by side."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(width) + 0.5 - width / 2)
    dark = np.tile(np.hypot(x, y) > 0.46 * width, lenses)[..., None]
    small = (rng.integers(80, 255, (6, 6 * lenses, 3), dtype=np.uint8) for _ in range(20))
    large = (cv2.resize(s, (width * lenses, width), interpolation=cv2.INTER_CUBIC) for s in small)
    return film(path, (np.where(dark, 0, picture).astype(np.uint8) for picture in large))


def test_two_files_of_a_shot_are_two_cameras() -> None:
    shot, alone = "a/VID_20220110_121609_657", "a/VID_20220110_130000_00_658"
    videos = ["a/VID_20220110_121609_00_657.insv", "a/VID_20220110_121609_10_657.insv", f"{alone}.insv"]
    assert picture_folders(videos) == [f"{shot}/fisheye0", f"{shot}/fisheye1", alone]
    others = [v.replace(".insv", ".mp4") for v in videos]
    assert picture_folders(others) == [v[:-4] for v in others]


@pytest.mark.slow
def test_videos_of_two_lenses_become_a_rig(tmp_path: Path) -> None:
    for lens in (0, 1):
        shot(tmp_path / "in" / f"VID_20220110_121609_{lens}0_657.insv", seed=1 + lens)
    project = scanned(tmp_path / "in", tmp_path / "out")
    assert sensors(project) == (8, 4, ["fisheye0", "fisheye1"])
    assert any("+0.0000 s after" in n and "the lenses of one recording" in n for n in project.receipt("scan")["notes"])
    shot(tmp_path / "both" / "VID_20220110_121609_00_657.insv", lenses=2)
    project = scanned(tmp_path / "both", tmp_path / "out2")
    assert sensors(project) == (8, 4, ["lens0", "lens1"])
    scene = project.scene()
    assert scene.rigs[0].nominal and (tmp_path / "out2" / "images" / scene.names[7]).exists()


def test_videos_of_two_cameras_are_not_one_recording_by_their_ending(tmp_path: Path) -> None:
    for k in (0, 1):
        shot(tmp_path / "in" / f"cam{k}.insv", seed=1 + k)
    with refused(r"--scan.video-offset cam1=SECONDS"):
        scanned(tmp_path / "in", tmp_path / "out")


@pytest.mark.slow
def test_two_tracks_of_a_file_become_a_rig_with_times_and_positions(tmp_path: Path) -> None:
    one, other = shot(tmp_path / "one.mp4", seed=1), shot(tmp_path / "other.mp4", seed=2)
    video = tmp_path / "in" / "VID_20240501_120000_00_001.insv"
    video.parent.mkdir()
    start = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc)
    world.created(world.two_tracks(video, one, other), start.timestamp() + 7200)
    world.with_trailer(video, [(7, world.gps_record(world.walk(start, 30, 10)))], gap=100)
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene, notes = project.scene(), project.receipt("scan")["notes"]
    assert sensors(project) == (8, 4, ["fisheye0", "fisheye1"])
    for track, file in enumerate((one, other)):  # each camera has the pictures of its lens
        alone = next(iter(frames(file)))
        name = next(n for k, n in enumerate(scene.names) if f"fisheye{track}" in n)
        with Image.open(tmp_path / "out" / "images" / name) as image:
            assert min(np.abs(np.asarray(image, float) - f).mean() for f in frames(file)) < 4 < alone.mean()
    assert 0 <= scene.time_s[0] - start.timestamp() < 0.5
    way = scene.world_from_rig[:, :2, 3] - scene.world_from_rig[0, :2, 3]
    assert np.hypot(*way.T) == pytest.approx(world.SPEED * (scene.time_s - scene.time_s[0]), abs=0.01)
    assert sum("2 h from UTC by these fixes" in n for n in notes) == 1
    assert any("001.insv, track 2 begins +0.0000 s after" in n and "the lenses of one" in n for n in notes)


@pytest.mark.slow
def test_the_fixes_in_the_file_of_one_lens_place_both(tmp_path: Path) -> None:
    start = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc)
    for lens in (0, 1):
        video = shot(tmp_path / "in" / f"VID_20240501_120000_{lens}0_001.insv", seed=lens)
        world.created(video, start.timestamp() + 7200)
        if lens == 0:
            world.with_trailer(video, [(7, world.gps_record(world.walk(start, 30, 10)))])
    project = scanned(tmp_path / "in", tmp_path / "out")
    scene = project.scene()
    assert np.isfinite(scene.world_from_rig[:, :3, 3]).all() and 0 <= scene.time_s[0] - start.timestamp() < 0.5
    assert not says(project.receipt("scan")["notes"], "by its own clock")


def frames(path: Path) -> list[np.ndarray]:
    """All pictures of a video, RGB."""
    capture, out = cv2.VideoCapture(str(path)), []
    while (read := capture.read())[0]:
        out.append(read[1][..., ::-1].astype(float))
    return out
