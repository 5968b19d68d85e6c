"""Videos of 360 cameras before stitching: two files of a shot are two cameras, two tracks of a file are said."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import tiegraph
from tiegraph.errors import InputError
from tiegraph.scan.lensvideos import two_tracks_note, video_tracks
from tiegraph.scan.video import picture_folders


def film(path: Path, width: int = 96, seed: int = 0, lenses: int = 1) -> Path:
    """A second of MP4 with a circle a lens, side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made = path.with_suffix(".mp4")
    out = cv2.VideoWriter(str(made), cv2.VideoWriter_fourcc(*"mp4v"), 10, (width * lenses, width))
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(width) + 0.5 - width / 2)
    for _ in range(20):
        small = rng.integers(80, 255, (6, 6 * lenses, 3), dtype=np.uint8)
        picture = cv2.resize(small, (width * lenses, width), interpolation=cv2.INTER_CUBIC)
        picture[np.tile(np.hypot(x, y) > 0.46 * width, lenses)] = 0
        out.write(picture)
    out.release()
    return made.rename(path)


def two_tracks(path: Path) -> Path:
    """The MP4 with its video track named a second time in its header, which stands at the end."""
    data = path.read_bytes()
    at = data.rindex(b"moov") - 4
    track = data.index(b"trak", at) - 4
    size = int.from_bytes(data[track : track + 4], "big")
    moov = data[at + 4 :] + data[track : track + size]
    path.write_bytes(data[:at] + (4 + len(moov)).to_bytes(4, "big") + moov)
    return path


def test_two_files_of_a_shot_are_two_cameras() -> None:
    shot, alone = "a/VID_20220110_121609_657", "a/VID_20220110_130000_00_658"
    videos = ["a/VID_20220110_121609_00_657.insv", "a/VID_20220110_121609_10_657.insv", f"{alone}.insv"]
    assert picture_folders(videos) == [f"{shot}/fisheye0", f"{shot}/fisheye1", alone]
    others = [v.replace(".insv", ".mp4") for v in videos]
    assert picture_folders(others) == [v[:-4] for v in others]


def test_tracks_of_a_file_are_counted_and_two_are_said(tmp_path: Path) -> None:
    one = film(tmp_path / "one.insv")
    assert video_tracks(one) == 1 and two_tracks_note(one) == ""
    two = two_tracks(film(tmp_path / "two.insv"))
    assert video_tracks(two) == 2 and "ffmpeg -i two.insv" in two_tracks_note(two)
    assert two_tracks_note(two.rename(tmp_path / "two.mp4")) == ""
    broken = tmp_path / "broken.insv"
    for data in (b"", b"\0" * 5000, b"\xff" * 5000, one.read_bytes()[:3000], b"\0\0\0\x09moov\0\0\0\0\x08trak"):
        broken.write_bytes(data)
        assert video_tracks(broken) == 0
    assert video_tracks(tmp_path / "none.insv") == 0


@pytest.mark.slow
def test_videos_of_two_lenses_become_a_rig(tmp_path: Path) -> None:
    film(tmp_path / "in" / "VID_20220110_121609_00_657.insv", seed=1)
    film(tmp_path / "in" / "VID_20220110_121609_10_657.insv", seed=2)
    project = tiegraph.open(tmp_path / "in", tmp_path / "out", pool="serial").run("scan")
    scene = project.scene()
    assert (len(scene), scene.frames, [s.name for s in scene.all_sensors]) == (8, 4, ["fisheye0", "fisheye1"])
    assert any("+0.0000 s after" in n and "the lenses of one recording" in n for n in project.receipt("scan")["notes"])
    film(tmp_path / "both" / "VID_20220110_121609_00_657.insv", lenses=2)
    scene = tiegraph.open(tmp_path / "both", tmp_path / "out2", pool="serial").run("scan").scene()
    assert (len(scene), scene.frames, [s.name for s in scene.all_sensors]) == (8, 4, ["lens0", "lens1"])
    assert scene.rigs[0].nominal and (tmp_path / "out2" / "images" / scene.names[7]).exists()


def test_videos_of_two_cameras_are_not_one_recording_by_their_ending(tmp_path: Path) -> None:
    film(tmp_path / "in" / "cam0.insv", seed=1)
    film(tmp_path / "in" / "cam1.insv", seed=2)
    with pytest.raises(InputError, match=r"--scan.video-offset cam1=SECONDS"):
        tiegraph.open(tmp_path / "in", tmp_path / "out", pool="serial").run("scan")
