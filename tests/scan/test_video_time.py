"""When the frames of a video were taken: by its container, by a drone's subtitles, by the settings."""

from __future__ import annotations

import struct
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from recording_world import created
from tiegraph.scan.recording import Recording
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scan.videos.video import sharpest, take_pictures
from tiegraph.scan.videos.videotime import VideoClock, read_subtitles, video_clock
from tiegraph.scene.exif import Exif, Taken, exif_of, read_exif
from video_world import film

PICTURES = PicturesTuning()
START = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc).timestamp()

# As DJI's Air 2S (a fraction in two parts), Mini 3 Pro (no date), Mavic Pro (satellites), Matrice 300 (height) write.
NEW = """1
00:00:00,000 --> 00:00:00,100
<font size="36">SrtCnt : 1, DiffTime : 100ms
2024-05-01 12:00:00,774,808
[iso : 100] [focal_len : 240] [latitude: 41.424724] [longitude: -2.234156] [rel_alt: 1.300 abs_alt: 132.860] </font>

2
00:00:00,100 --> 00:00:00,200
<font size="36">SrtCnt : 2, DiffTime : 100ms
2024-05-01 12:00:00,874,808
[iso : 100] [focal_len : 240] [latitude: 41.424730] [longtitude: -2.234166] [altitude: 133.5] </font>
"""
DATELESS = "1\n00:00:00,000 --> 00:00:00,033\n[latitude: 59.0000] [longitude: 18.0000] [rel_alt: 1.0 abs_alt: 100.0]\n"
OLD = """1
00:00:00,000 --> 00:00:01,000
HOME(131.1660,-25.2088) 2017.07.29 15:18:50
GPS(131.1660,-25.2089,14) BAROMETER:0.5

2
00:00:01,000 --> 00:00:02,000
HOME(131.1660,-25.2088) 2017.07.29 15:18:51
GPS(131.1661,-25.2088,14) BAROMETER:1.0
"""
MATRICE = "1\n00:00:00,000 --> 00:00:01,000\n2022.06.21 16:06:17\nGPS(36.6146,-6.1120,12.5M) BAROMETER:0.3M\n"
NO_FIX = "1\n00:00:00,000 --> 00:00:01,000\n2026-05-31 16:15:29.797\n[latitude: 0.000000] [longitude: 0.000000]\n"


def seconds(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=timezone.utc).timestamp()


def grey(path: Path) -> Path:
    return film(path, (np.full((48, 64, 3), 10 * k % 250, np.uint8) for k in range(20)))


def stamped(path: Path, created_s: float, wide: bool = False) -> Path:
    """The video with its movie header's creation time set (seconds since 1970); ``wide``: of version 1."""
    if not wide:
        return created(path, created_s)
    data = bytearray(path.read_bytes())
    at = data.index(b"mvhd") + 4
    old, tail = struct.unpack_from(">IIII", data, at + 4), bytes(data[at + 20 : at + 88])
    data[at : at + 100] = struct.pack(">B3xQQIQ", 1, round(created_s) + 2082844800, 0, old[2], old[3]) + tail
    path.write_bytes(data)
    return path


def clock(path: Path, **settings: object) -> VideoClock:
    return video_clock(path, ScanSettings(**settings), PICTURES)


@pytest.mark.parametrize("wide", [False, True])
def test_the_container_says_when_a_video_began(tmp_path: Path, wide: bool) -> None:
    video = stamped(grey(tmp_path / "a.mp4"), START, wide)
    found = clock(video)
    assert found.start_s == START and found.known and found.utc
    assert "2024-05-01 10:00:00 UTC" in found.note and "--scan.video-offset SECONDS, or end" in found.note
    assert clock(video, video_offset=("end",)).start_s == pytest.approx(START - 2.0, abs=0.11)  # 20 frames, 10 a second
    assert clock(video, video_offset=("-7200.5",)).start_s == START - 7200.5


def test_a_video_without_creation_time_counts_from_its_start(tmp_path: Path) -> None:
    for video in (grey(tmp_path / "a.mp4"), tmp_path / "cut.mp4", tmp_path / "loop.mp4"):
        if not video.exists():
            video.write_bytes(b"\0\0\0\x04ftyp" if video.name == "loop.mp4" else b"\0\0\0\x08free" * 3 + b"\0\0")
        found = clock(video)
        assert (found.start_s, found.known, found.utc) == (0.0, False, False)
        assert f"{video.name}: it does not say when it was recorded" in found.note
    assert clock(tmp_path / "a.mp4", video_offset=(str(START),)).known


def test_pictures_carry_the_time_of_their_frames(tmp_path: Path) -> None:
    video = stamped(grey(tmp_path / "a.mp4"), START)
    taken = take_pictures(
        Recording(video), tmp_path / "out", sharpest(2.0), clock(video, video_offset=("0.25",)), PICTURES
    )
    found = [exif(f) for f in sorted((tmp_path / "out").glob("*.jpg"))]
    assert [e.time_s for e in found] == pytest.approx([START + 0.25 + s for s in taken.stamps_s], abs=1e-6)
    assert all(e.time_utc for e in found) and len(found) == 4
    assert all(np.isnan(e.lat_deg) for e in found)


def exif(file: Path) -> Exif:
    with Image.open(file) as image:
        return read_exif(image, image.size, (0.3, 10.0))


@pytest.mark.parametrize("taken", [Taken(START + 0.123456, True, -41.4247244, 2.2341561, -3.21, 11.5),
                                   Taken(12.5, False, 0.0000123, -179.9999999)])  # fmt: skip
def test_what_is_written_is_read_again(tmp_path: Path, taken: Taken) -> None:
    Image.new("RGB", (40, 30)).save(tmp_path / "a.jpg", exif=exif_of(taken))
    found = exif(tmp_path / "a.jpg")
    assert found.time_s == pytest.approx(taken.time_s, abs=1e-6) and found.time_utc == taken.utc
    assert (found.lat_deg, found.lon_deg) == pytest.approx((taken.lat_deg, taken.lon_deg), abs=1e-9)
    assert found.height_m == pytest.approx(taken.height_m, abs=1e-3, nan_ok=True)
    assert found.position_sigma_m == pytest.approx(taken.sigma_m, abs=1e-3, nan_ok=True)


@pytest.mark.parametrize(
    "text, start, place, later",
    [(NEW, "2024-05-01T12:00:00.774808", (41.424724, -2.234156, 132.86), (41.42473, -2.234166, 133.5)),
     (OLD, "2017-07-29T15:18:50", (-25.2089, 131.166, np.nan), (-25.2088, 131.1661, np.nan)),
     (MATRICE, "2022-06-21T16:06:17", (36.6146, -6.112, 12.5), (36.6146, -6.112, 12.5)),
     (DATELESS, "", (59.0, 18.0, 100.0), (59.0, 18.0, 100.0)),
     (NO_FIX, "2026-05-31T16:15:29.797", (np.nan,) * 3, (np.nan,) * 3)],
)  # fmt: skip
def test_each_form_of_a_drones_subtitles(tmp_path: Path, text: str, start: str, place: tuple, later: tuple) -> None:
    (tmp_path / "a.SRT").write_text(text)
    found = read_subtitles(tmp_path / "a.SRT", 5.0)
    assert found.start_s == pytest.approx(seconds(start) if start else np.nan, abs=1e-6, nan_ok=True)
    for stamp, expected in ((0.05, place), (5.0, later)):
        at = found.place(stamp)
        assert (at.lat_deg, at.lon_deg, at.height_m) == pytest.approx(expected, nan_ok=True)
    coarse = text in (OLD, MATRICE, DATELESS)  # four decimals: 11 m
    assert found.sigma_m == pytest.approx(np.hypot(5.0, 11.132) if coarse else np.nan, nan_ok=True)


def test_subtitles_beside_a_video_come_first_and_others_are_said(tmp_path: Path) -> None:
    video = stamped(grey(tmp_path / "DJI_0001.mp4"), START)
    (tmp_path / "DJI_0001.SRT").write_text(NEW)
    found = clock(video, video_offset=("-7200.0",))
    assert found.start_s == pytest.approx(seconds("2024-05-01T10:00:00.774808"), abs=1e-6) and not found.utc
    assert "2 of 2 rows have a position" in found.note and "own clock and zone" in found.note
    take_pictures(Recording(video), tmp_path / "out", sharpest(2.0), found, PICTURES)
    first = exif(min((tmp_path / "out").glob("*.jpg")))
    assert first.lat_deg == pytest.approx(41.42473, abs=1e-5) and 132 < first.height_m < 134
    (tmp_path / "DJI_0001.SRT").write_text("1\n00:00:00,000 --> 00:00:02,000\nA river, in 2024.\n")
    other = clock(video)
    assert other.start_s == START and "no times or positions of a DJI drone in them: not used" in other.note
