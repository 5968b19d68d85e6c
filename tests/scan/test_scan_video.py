"""Videos: the sharpest picture of each stretch, whole or not at all."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scan_worlds import picture, scan

from tiegraph.scan.recording import Recording
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scan.videos.video import (
    OpenVideo,
    Pictures,
    find_videos,
    nearest,
    picture_folders,
    sharpest,
    take_pictures,
)
from tiegraph.scan.videos.videotime import VideoClock
from tiegraph.scene.images import has_images
from video_world import film

PICTURES = PicturesTuning()


def seconds_of(path: Path, seconds: int, sharp: int = 3, seed: int = 0) -> Path:
    """Ten pictures a second; each second's picture ``sharp`` alone is not blurred, and as bright as its second."""
    texture = np.random.default_rng(seed).integers(0, 120, (240, 320, 3), dtype=np.uint8)
    numbers = range(10 * seconds)
    pictures = (texture if n % 10 == sharp else cv2.GaussianBlur(texture, (0, 0), 2 + n % 10 / 10) for n in numbers)
    return film(
        path, (np.clip(p.astype(int) + 10 * (n // 10), 0, 255).astype(np.uint8) for n, p in enumerate(pictures))
    )


def take(video: Path, folder: Path, per_second: float) -> Pictures:
    return take_pictures(Recording(video), folder, sharpest(per_second), VideoClock(), PICTURES)


def test_the_sharpest_of_each_second_is_taken_in_order(tmp_path: Path) -> None:
    video = seconds_of(tmp_path / "river.avi", 6)
    taken = take(video, tmp_path / "out" / "river", 1.0)
    assert taken.said == "river.avi: 6 pictures, the sharpest of every 1 s"
    assert np.allclose(taken.stamps_s, 0.3 + np.arange(6), atol=1e-6) and taken.numbers == tuple(range(6))
    files = sorted((tmp_path / "out" / "river").glob("*.jpg"))
    assert [f.name for f in files] == [f"river_{k:06d}.jpg" for k in range(6)]
    pictures = [cv2.imread(str(f)).astype(float) for f in files]
    assert np.allclose(np.diff([p.mean() for p in pictures]), 10, atol=1.5)
    blurred = cv2.GaussianBlur(pictures[0], (0, 0), 2)
    assert all(p.std() > 1.5 * blurred.std() for p in pictures)
    before = files[0].stat().st_mtime_ns
    assert take(video, tmp_path / "out" / "river", 1.0) == taken and files[0].stat().st_mtime_ns == before


@pytest.mark.slow
def test_videos_are_passes_not_cameras(tmp_path: Path) -> None:
    for k, name in enumerate(("morning.avi", "noon.avi")):
        seconds_of(tmp_path / "in" / name, 20, seed=k)
    videos = find_videos(tmp_path / "in")
    for name, folder in zip(videos, picture_folders(videos)):
        take(tmp_path / "in" / name, tmp_path / "out" / folder, 1.0)
    scene = scan(tmp_path / "out", video=True)
    assert (len(scene), scene.sequences, len(scene.all_sensors)) == (40, ("morning", "noon"), 1)


def test_a_video_is_a_sequence_however_short(tmp_path: Path) -> None:
    take(seconds_of(tmp_path / "in" / "walk.avi", 3), tmp_path / "out" / "walk", 1.0)
    scene = scan(tmp_path / "out", video=True)
    assert (len(scene), scene.sequences, scene.guessed) == (3, ("walk",), ())
    assert scene.sequence.tolist() == [0, 0, 0] and np.allclose(scene.time_s, [0.3, 1.3, 2.3], atol=1e-5)
    assert scan(tmp_path / "out").sequences == ()  # of three photographs nobody knows


def test_videos_of_different_cameras_are_sequences_of_rigs_of_their_own(tmp_path: Path) -> None:
    take(seconds_of(tmp_path / "in" / "boat.avi", 3), tmp_path / "out" / "boat", 1.0)
    for k in range(3):
        picture(tmp_path / "out" / "phone" / f"phone_{k:06d}.jpg", (100, 60))
    scene = scan(tmp_path / "out", video=True)
    assert (scene.sequences, len(scene.rigs), scene.frames) == (("boat", "phone"), 2, 6)
    assert sorted(zip(scene.sequence.tolist(), scene.rig.tolist())) == [*[(0, 0)] * 3, *[(1, 1)] * 3]


def test_what_is_no_video_is_said(tmp_path: Path) -> None:
    broken = tmp_path / "in" / "a.mp4"
    broken.parent.mkdir()
    broken.write_bytes(b"no video at all" * 100)
    assert "a.mp4 cannot be decoded" in take(broken, tmp_path / "out" / "a", 2.0).said
    assert not has_images(tmp_path / "out") and find_videos(tmp_path / "in") == ["a.mp4"]
    assert picture_folders(["x/a.mp4", "x/a.mov", "x/b.mp4"]) == ["x/a_mp4", "x/a_mov", "x/b"]


def test_a_video_that_is_cut_off_says_so(tmp_path):
    rng = np.random.default_rng(3)
    whole = film(tmp_path / "whole.avi", (rng.integers(0, 255, (64, 96, 3), np.uint8) for _ in range(40)))
    assert "could be decoded" not in take(whole, tmp_path / "a", 2.0).said
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert "of its 40 frames could be decoded: is the file cut off?" in take(cut, tmp_path / "b", 2.0).said


class Stamped:
    """A capture that gives pictures with any stamps (ms)."""

    def __init__(self, stamps_ms: list[float], fps: float = 10.0) -> None:
        self.stamps_ms, self.fps, self.at = stamps_ms, fps, -1

    def isOpened(self) -> bool:
        return True

    def get(self, key: int) -> float:
        known = {cv2.CAP_PROP_FPS: self.fps, cv2.CAP_PROP_FRAME_COUNT: float(len(self.stamps_ms))}
        return known.get(key, self.stamps_ms[max(self.at, 0)])

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.at += 1
        return (True, np.zeros((4, 4, 3), np.uint8)) if self.at < len(self.stamps_ms) else (False, None)


@pytest.mark.parametrize(
    "stamps_ms, expected, unstamped",
    [([0, 40, 150, 190], [0, 0.04, 0.15, 0.19], 0), ([0, 0, 0, 0], [0, 0.1, 0.2, 0.3], 3),
     ([0, 100, 50, 300], [0, 0.1, 0.2, 0.3], 1)],
)  # fmt: skip
def test_stamps_are_the_containers_and_missing_ones_follow_the_rate(stamps_ms, expected, unstamped) -> None:
    video = OpenVideo(Stamped(stamps_ms))
    assert np.allclose([stamp for stamp, _ in video.frames()], expected)
    assert video.unstamped == unstamped
    said = Stamped(stamps_ms, fps=0.0)
    assert list(OpenVideo(said).frames()) == []


def test_the_frames_nearest_to_instants_are_taken() -> None:
    frames = [(k / 10, np.full((2, 2, 3), k, np.uint8)) for k in range(10)]
    found = list(nearest((3, 4, 5, 8), (-0.04, 0.33, 0.37, 0.99), 0.075).pick(iter(frames)))
    assert [(n, f[0]) for n, f in found] == [(3, 0.0), (4, 0.3), (5, 0.4)]  # 0.99 is 0.09 after the last
    assert [n for n, _ in nearest((1,), (0.9,), 0.01).pick(iter(frames))] == [1]
