"""Insta360's trailer: positions by their times in UTC, time zones of the container, and damaged trailers."""

from __future__ import annotations

import struct
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

import recording_world as world
from recording_world import Fix
from tiegraph.scan.recording.insta360 import read_trailer
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scan.videos.videotime import VideoClock, video_clock

START = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc)
FIXES = world.walk(START - timedelta(seconds=0.5), 40, 10)  # before and beyond the three seconds
RECORDS = [(1, b"metadata" * 4), (7, world.gps_record(FIXES)), (3, b"\x11" * 500)]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return world.film(tmp_path_factory.mktemp("insta360") / "plain.mp4", seconds=3).read_bytes()


def insv(tmp_path: Path, plain: bytes, created_s: float | None, gap: int = 0, records: list = RECORDS) -> Path:
    path = tmp_path / "VID_20240501_120000_00_001.insv"
    path.write_bytes(plain)
    if created_s is not None:
        world.created(path, created_s)
    return world.with_trailer(path, records, gap)


def clock(path: Path, **settings: object) -> VideoClock:
    return video_clock(path, ScanSettings(**settings), PicturesTuning())


@pytest.mark.parametrize("gap", [0, 1000])  # ONE X2; X4, whose records lie apart
@pytest.mark.parametrize("hours", [0, 2, -3.5, 5.75])
def test_positions_by_time_whatever_zone_the_camera_is_on(tmp_path: Path, plain: bytes, gap: int, hours: float) -> None:
    found = clock(insv(tmp_path, plain, START.timestamp() + 3600 * hours, gap))
    assert found.start_s == START.timestamp() and found.known and found.utc
    for stamp in (0.0, 1.03, 2.9):
        at, since = found.taken(stamp), stamp + 0.5
        assert (at.lat_deg, at.lon_deg) == pytest.approx((48 + 1e-5 * since, 11 - 2e-5 * since), abs=1e-9)
        assert at.height_m == pytest.approx(500 + 0.5 * since, abs=1e-4)
    assert "positions from its Insta360 trailer: 40 of 40 fixes used" in found.note
    assert (f"its creation time is local, {hours:+g} h from UTC by these fixes" in found.note) == (hours != 0)


def test_signs_and_void_fixes(tmp_path: Path, plain: bytes) -> None:
    south = [Fix(f.time, -33.5, -70.25, 600.0, fix=0 if k < 8 else 3) for k, f in enumerate(FIXES)]
    record = bytearray(world.gps_record(south))
    record[53 * 20 + 28 : 53 * 20 + 29] = b"O"  # ouest
    found = clock(insv(tmp_path, plain, START.timestamp(), records=[(7, bytes(record) + b"\0" * 10)]))
    assert "32 of 40 fixes used (8 without a fix left out)" in found.note
    assert (found.taken(1.5).lat_deg, found.taken(1.5).lon_deg) == pytest.approx((-33.5, -70.25))
    assert np.isnan(found.taken(0.1).lat_deg)


def test_positions_of_another_time_are_not_used(tmp_path: Path, plain: bytes) -> None:
    found = clock(insv(tmp_path, plain, START.timestamp() + 400))
    assert "their times are not those of the recording (--scan.video-offset SECONDS): none used" in found.note
    assert found.places is None and found.start_s == START.timestamp() + 400
    mended = clock(insv(tmp_path, plain, START.timestamp() + 400), video_offset=("-400",))
    assert mended.start_s == START.timestamp() and np.isfinite(mended.taken(1.0).lat_deg)
    undated = clock(insv(tmp_path, plain, None))
    assert undated.places is None and "it does not say when it was recorded" in undated.note
    told = clock(insv(tmp_path, plain, None), video_offset=(str(START.timestamp()),))
    assert told.taken(1.0).lat_deg == pytest.approx(48 + 1.5e-5, abs=1e-9)
    many_days = clock(insv(tmp_path, plain, START.timestamp() + 50 * 3600))
    assert many_days.places is None


def test_a_file_without_trailer_or_receiver(tmp_path: Path, plain: bytes) -> None:
    path = tmp_path / "a.insv"
    for data in (b"", b"x" * 50, plain):
        path.write_bytes(data)
        assert read_trailer(path) is None
    found = clock(insv(tmp_path, plain, START.timestamp(), records=[(1, b"metadata")]))
    assert found.places is None and "Insta360" not in found.note


def test_damaged_trailers_are_named_and_the_video_keeps_its_time(tmp_path: Path, plain: bytes) -> None:
    for gap in (0, 300):
        path = insv(tmp_path, plain, START.timestamp(), gap)
        data = bytearray(path.read_bytes())
        struct.pack_into("<I", data, len(data) - 40, 2**31)
        path.write_bytes(data)
        assert "trailer cannot be read (it says that it has 2147483648 bytes" in clock(path).note
        data = bytearray(insv(tmp_path, plain, START.timestamp(), gap).read_bytes())
        struct.pack_into("<I", data, len(data) - 76, 10**6)
        path.write_bytes(data)
        found = clock(path)
        assert "its last record" in found.note and "says 1000000 bytes" in found.note
        assert found.start_s == START.timestamp() and found.places is None
    data[len(plain) :] = insv(tmp_path, plain, START.timestamp(), 300).read_bytes()[len(plain) :]
    at = bytes(data).rindex(struct.pack("<BBI", 7, 0, len(world.gps_record(FIXES))))
    struct.pack_into("<I", data, at + 6, 2**32 - 1)
    path.write_bytes(data)
    assert "its index says record 7 has 2120 bytes at 4294967295" in clock(path).note


@pytest.mark.slow
def test_no_damage_ever_raises(tmp_path: Path, plain: bytes) -> None:
    path = insv(tmp_path, plain, START.timestamp(), 20, [(7, world.gps_record(FIXES[:3]))])
    data, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(150):
        made = bytearray(data)
        for at in rng.integers(len(plain), len(made) - 32, 4):
            made[at] = rng.integers(256)
        path.write_bytes(made)
        assert clock(path).start_s - START.timestamp() == pytest.approx(0, abs=86400)
