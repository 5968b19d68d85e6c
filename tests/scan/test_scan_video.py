"""Videos: the sharpest picture of each stretch, whole or not at all."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scan_worlds import scan

from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scan.video import find_videos, picture_folders, take_pictures
from tiegraph.scene.images import has_images

PICTURES = PicturesTuning()


def film(path: Path, seconds: int, sharp: int = 3, seed: int = 0) -> Path:
    """Ten pictures a second; each second's picture ``sharp`` alone is not blurred, and as bright as its second."""
    path.parent.mkdir(parents=True, exist_ok=True)
    out = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (320, 240))
    texture = np.random.default_rng(seed).integers(0, 120, (240, 320, 3), dtype=np.uint8)
    for number in range(10 * seconds):
        picture = texture if number % 10 == sharp else cv2.GaussianBlur(texture, (0, 0), 2 + number % 10 / 10)
        out.write(np.clip(picture.astype(int) + 10 * (number // 10), 0, 255).astype(np.uint8))
    out.release()
    return path


def test_the_sharpest_of_each_second_is_taken_in_order(tmp_path: Path) -> None:
    video = film(tmp_path / "river.avi", 6)
    said = take_pictures(video, tmp_path / "out" / "river", 1.0, PICTURES)
    assert said == "river.avi: 6 pictures, the sharpest of every 1 s"
    files = sorted((tmp_path / "out" / "river").iterdir())
    assert [f.name for f in files] == [f"river_{k:06d}.jpg" for k in range(6)]
    pictures = [cv2.imread(str(f)).astype(float) for f in files]
    assert np.allclose(np.diff([p.mean() for p in pictures]), 10, atol=1.5)
    blurred = cv2.GaussianBlur(pictures[0], (0, 0), 2)
    assert all(p.std() > 1.5 * blurred.std() for p in pictures)
    before = files[0].stat().st_mtime_ns
    assert (
        take_pictures(video, tmp_path / "out" / "river", 1.0, PICTURES) == "" and files[0].stat().st_mtime_ns == before
    )


@pytest.mark.slow
def test_videos_are_passes_not_cameras(tmp_path: Path) -> None:
    for k, name in enumerate(("morning.avi", "noon.avi")):
        film(tmp_path / "in" / name, 20, seed=k)
    videos = find_videos(tmp_path / "in")
    for name, folder in zip(videos, picture_folders(videos)):
        take_pictures(tmp_path / "in" / name, tmp_path / "out" / folder, 1.0, PICTURES)
    scene = scan(tmp_path / "out")
    assert (len(scene), scene.sequences, len(scene.all_sensors)) == (40, ("morning", "noon"), 1)


def test_what_is_no_video_is_said(tmp_path: Path) -> None:
    broken = tmp_path / "in" / "a.mp4"
    broken.parent.mkdir()
    broken.write_bytes(b"no video at all" * 100)
    assert "a.mp4 cannot be decoded" in take_pictures(broken, tmp_path / "out" / "a", 2.0, PICTURES)
    assert not has_images(tmp_path / "out") and find_videos(tmp_path / "in") == ["a.mp4"]
    assert picture_folders(["x/a.mp4", "x/a.mov", "x/b.mp4"]) == ["x/a_mp4", "x/a_mov", "x/b"]


def test_a_video_that_is_cut_off_says_so(tmp_path):
    whole = tmp_path / "whole.avi"
    made = cv2.VideoWriter(str(whole), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (96, 64))
    rng = np.random.default_rng(3)
    for _ in range(40):
        made.write(rng.integers(0, 255, (64, 96, 3), np.uint8))
    made.release()
    assert "could be decoded" not in take_pictures(whole, tmp_path / "a", 2.0, PICTURES)
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert "of its 40 frames could be decoded: is the file cut off?" in take_pictures(
        cut, tmp_path / "b", 2.0, PICTURES
    )
