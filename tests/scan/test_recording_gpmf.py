"""GoPro's telemetry: when and where by truth, what is left out and said, and damaged tracks that stop nothing."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

import recording_world as world
from recording_world import ONE_EACH, Fix, Layout, klv, nest
from tiegraph.scan.recording.gpmf import entries
from tiegraph.scan.recording.tracks import BrokenTrack
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scan.videos.videotime import VideoClock, video_clock

PICTURES = PicturesTuning()
START = datetime(2016, 12, 31, 23, 59, 58, 250000, timezone.utc)  # a leap second came 1.75 s later: UTC has none of it
NEAR_DEG = 2e-7  # the format has 1e-7


def clock(path: Path, **settings: object) -> VideoClock:
    return video_clock(path, ScanSettings(**settings), PICTURES)


def payloads(kind: str, fixes: Sequence[Fix], each: int = 10, **how: object) -> list[bytes]:
    make = {"GPS5": world.gps5, "GPS9": world.gps9}[kind]
    return [make(fixes[k : k + each], **how) for k in range(0, len(fixes), each)]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Three seconds of MP4, created two hours late: a camera on local time."""
    path = world.film(tmp_path_factory.mktemp("gopro") / "plain.mp4", seconds=3)
    return world.created(path, START.timestamp() + 7200).read_bytes()


def gopro(tmp_path: Path, plain: bytes, made: Sequence[bytes], layout: Layout = ONE_EACH) -> Path:
    path = tmp_path / "GX010001.MP4"
    path.write_bytes(plain)
    return world.with_telemetry(path, made, layout)


@pytest.mark.parametrize("layout", [Layout(), Layout(in_chunk=2, wide=True), Layout(in_chunk=3)])
@pytest.mark.parametrize("kind, times", [("GPS5", 3), ("GPS9", 30)])
def test_times_and_positions_of_frames(tmp_path: Path, plain: bytes, kind: str, times: int, layout: Layout) -> None:
    video = gopro(tmp_path, plain, payloads(kind, world.walk(START, 30, 10)), layout)
    found = clock(video)
    assert found.start_s == pytest.approx(START.timestamp(), abs=1e-3) and found.known and found.utc
    for stamp in (0.0, 0.73, 1.0, 2.9):
        at = found.taken(stamp)
        assert at.time_s == pytest.approx(START.timestamp() + stamp, abs=1e-3)
        assert (at.lat_deg, at.lon_deg) == pytest.approx((48 + 1e-5 * stamp, 11 - 2e-5 * stamp), abs=NEAR_DEG)
        assert at.height_m == pytest.approx(500 + 0.5 * stamp, abs=2e-3)
    assert f"GX010001.MP4: begins at 2016-12-31 23:59:58.250 UTC by {times} times of its receiver" in found.note
    assert f"positions from its GPMF track ({kind}): 30 of 30 fixes used, heights above the sea" in found.note
    later = clock(video, video_offset=("0.5",))
    assert later.start_s == pytest.approx(found.start_s + 0.5) and later.taken(1.0).lat_deg == found.taken(1.0).lat_deg


def test_fixes_that_are_none_or_poor_are_left_out_and_counted(tmp_path: Path, plain: bytes) -> None:
    fixes = world.walk(START, 30, 10)
    fixes[:4] = world.walk(START + timedelta(days=900), 4, 10, fix=0)  # the camera's clock before its first fix
    fixes[20:26] = world.walk(fixes[20].time, 6, 10, dop=9.99)
    fixes[26] = Fix(fixes[26].time, 0.0, 0.0, 0.0)
    found = clock(gopro(tmp_path, plain, payloads("GPS9", fixes)))
    assert "19 of 30 fixes used (5 without a fix, 6 with a DOP above 5 left out)" in found.note
    assert found.start_s == pytest.approx(START.timestamp(), abs=1e-3)
    assert np.isnan(found.taken(0.2).lat_deg) and np.isfinite(found.taken(0.5).lat_deg)


def test_a_payload_without_a_fix_and_one_without_a_height(tmp_path: Path, plain: bytes) -> None:
    fixes = world.walk(START, 30, 10)
    none = world.walk(START + timedelta(days=900), 10, 10, fix=0)
    flat = world.walk(fixes[20].time, 10, 10, fix=2)
    made = [
        world.gps5(none, above_sea=False),
        world.gps5(fixes[10:20], above_sea=False),
        world.gps5(flat, above_sea=False),
    ]
    found = clock(gopro(tmp_path, plain, made))
    assert "20 of 30 fixes used (10 without a fix left out), heights above the ellipsoid" in found.note
    assert found.start_s == pytest.approx(START.timestamp(), abs=1e-3)
    assert np.isnan(found.taken(0.5).lat_deg) and found.taken(1.5).height_m == pytest.approx(500.75, abs=2e-3)
    assert np.isfinite(found.taken(2.5).lat_deg) and np.isnan(found.taken(2.5).height_m)


def test_between_fixes_that_are_far_apart_nothing_is_known(tmp_path: Path, plain: bytes) -> None:
    made = [world.gps9([f]) for f in world.walk(START, 2, 0.25)]
    video = gopro(tmp_path, plain, made, Layout(seconds=4.0))
    assert np.isnan(clock(video).taken(2.0).lat_deg) and np.isnan(clock(video).taken(9.0).lat_deg)
    assert clock(video, max_gap_s=5.0).taken(2.0).lat_deg == pytest.approx(48 + 2e-5, abs=NEAR_DEG)


def test_the_date_line_is_crossed_the_short_way(tmp_path: Path, plain: bytes) -> None:
    ends = [Fix(START, -17.0, 179.9999, 1.0), Fix(START + timedelta(seconds=0.5), -17.0, -179.9999, 1.0)]
    at = clock(gopro(tmp_path, plain, [world.gps9(ends)])).taken(0.25)
    assert abs(at.lon_deg) == pytest.approx(180, abs=NEAR_DEG) and at.lat_deg == pytest.approx(-17)


def test_rows_with_their_own_times_are_taken_where_both_kinds_are(tmp_path: Path, plain: bytes) -> None:
    fixes = world.walk(START, 10, 10)
    stale = world.gps5(fixes, utc="550910008224.040")  # issue 162 of gpmf-parser: no date
    found = clock(gopro(tmp_path, plain, [stale + world.gps9(fixes)]))
    assert "GPS9" in found.note and found.start_s == pytest.approx(START.timestamp(), abs=1e-3)
    undated = clock(gopro(tmp_path, plain, [stale]))
    assert undated.start_s == round(START.timestamp() + 7200) and np.isfinite(undated.taken(0.4).lat_deg)
    assert "by the creation time in it" in undated.note and "GPS5" in undated.note


def test_clocks_that_contradict_each_other_are_said(tmp_path: Path, plain: bytes) -> None:
    fixes = world.walk(START, 30, 10)
    fixes[10:20] = [Fix(f.time + timedelta(seconds=16), f.lat, f.lon, f.height) for f in fixes[10:20]]
    fixes[20:] = [Fix(f.time - timedelta(seconds=2), f.lat, f.lon, f.height) for f in fixes[20:]]
    assert "contradict each other by 2.0 s" in clock(gopro(tmp_path, plain, payloads("GPS5", fixes))).note
    much_later = world.walk(START + timedelta(days=400), 30, 10)
    said = clock(gopro(tmp_path, plain, payloads("GPS5", much_later))).note
    assert "its creation time is 400 days from that and not used" in said


def deep(levels: int) -> bytes:
    data = b""
    for _ in range(levels):
        data = struct.pack(">4sBBH", b"DEVC", 0, 1, min(len(data), 65535)) + data
        data = data[:65000]
    return data


GOOD = payloads("GPS9", world.walk(START, 10, 10))[0]
HUGE = struct.pack(">4scBH", b"GPS9", b"?", 255, 65535)
SCALES = (10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1)
BAD = {
    "cut off": (GOOD[:-20], "'DEVC' says"),
    "too long": (
        GOOD[:-328] + HUGE + GOOD[-320:],
        "'GPS9' says 65535 rows",
    ),
    "no scale": (world.gps9(world.walk(START, 3, 10), scales=()), "and 0 scales"),
    "scale of zero": (world.gps9(world.walk(START, 3, 10), scales=(0, *SCALES[1:])), "9 scales"),
    "few scales": (world.gps9(world.walk(START, 3, 10), scales=SCALES[:4]), "and 4 scales"),
    "other type": (GOOD.replace(b"lllllllSS", b"lllllllS?"), "numbers of type 'lllllllS?' are not known"),
    "other rows": (GOOD.replace(b"lllllllSS", b"lllllllSd"), "rows of type lllllllSd have 38 bytes, not 32"),
    "huge type": (GOOD.replace(b"lllllllSS", b"l[999]SSS"), "are not known"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_damaged_payload_is_named_and_the_others_are_used(tmp_path: Path, plain: bytes, name: str) -> None:
    bad, said = BAD[name]
    fixes = world.walk(START, 30, 10)
    found = clock(gopro(tmp_path, plain, [world.gps9(fixes[:10]), bad, world.gps9(fixes[20:])]))
    assert "1 of its 3 GPMF payloads cannot be read (" in found.note and said in found.note
    assert "20 of 20 fixes used" in found.note and found.start_s == pytest.approx(START.timestamp(), abs=1e-3)
    assert found.taken(2.5).lat_deg == pytest.approx(48 + 2.5e-5, abs=NEAR_DEG)


@pytest.mark.parametrize("payload", [deep(16000), nest("DEVC"), b"", b"\0" * 400, world.device()])
def test_payloads_without_a_receiver(tmp_path: Path, plain: bytes, payload: bytes) -> None:
    found = clock(gopro(tmp_path, plain, [payload]))
    assert "its GPMF track has no fixes of a receiver" in found.note and "by the creation time in it" in found.note
    assert found.places is None


def test_numbers_that_are_no_places_or_times(tmp_path: Path, plain: bytes) -> None:
    far = [Fix(START, 48.0, 11.0, 200_000.0), Fix(START, 95.0, 11.0, 500.0)]
    assert "0 of 2 fixes used (2 not on the Earth left out)" in clock(gopro(tmp_path, plain, [world.gps9(far)])).note
    late = GOOD.replace(struct.pack(">i", (START - world.EPOCH_2000).days), struct.pack(">i", 2**31 - 1))
    found = clock(gopro(tmp_path, plain, [late]))
    assert "by the creation time in it" in found.note and np.isfinite(found.taken(0.5).lat_deg)


TABLES = {
    "stsz": (b"stsz", 8, struct.pack(">I", 2**32 - 1), "4294967295 samples, more than"),
    "all of one size": (b"stsz", 4, struct.pack(">I", 2**31), "are larger together than the file"),
    "stts": (b"stts", 4, struct.pack(">I", 2**31), "stts says 2147483648 rows and has room for 1"),
    "few times": (b"stts", 8, struct.pack(">I", 2), "times of 2 samples of 3"),
    "stsc": (b"stsc", 8, struct.pack(">I", 7), "stsc and stco contradict"),
    "few places": (b"stsc", 12, struct.pack(">I", 0), "stsc and stco have 0 samples, stsz has 3"),
    "places": (b"stco", 8, struct.pack(">I", 2**32 - 1), "1 of its 3 GPMF payloads cannot be read (a payload lies"),
    "no table": (b"stco", -4, b"none", "it has no table stco"),
    "no scale": (b"mdhd", 12, bytes(4), "its header has no time scale"),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_a_damaged_table_is_named_and_the_container_is_used(tmp_path: Path, plain: bytes, name: str) -> None:
    box, at, new, said = TABLES[name]
    video = gopro(tmp_path, plain, payloads("GPS9", world.walk(START, 30, 10)))
    data = bytearray(video.read_bytes())
    at += data.rindex(box) + 4
    data[at : at + len(new)] = new
    video.write_bytes(data)
    found = clock(video)
    assert said in found.note
    if name != "places":
        assert "its GPMF track cannot be read" in found.note and found.start_s == round(START.timestamp() + 7200)


@pytest.mark.slow
def test_no_damage_ever_raises(tmp_path: Path, plain: bytes) -> None:
    video = gopro(tmp_path, plain, payloads("GPS9", world.walk(START, 4, 10), each=2))
    data = video.read_bytes()
    rng = np.random.default_rng(0)
    begin = data.index(b"DEVC") - 8
    for _ in range(150):
        made = bytearray(data)
        for at in rng.integers(begin, len(made), 4):
            made[at] = rng.integers(256)
        video.write_bytes(made[: rng.integers(begin, len(made) + 1)] if rng.random() < 0.2 else made)
        found = clock(video)
        assert np.isfinite(found.start_s) and found.note


def test_entries_say_what_they_are() -> None:
    data = klv("SCAL", "s", 2, struct.pack(">h", -418)) + klv("QQQQ", "q", 4, struct.pack(">i", 3 << 15)) + bytes(8)
    assert [(e.key, e.rows().tolist()) for e in entries(data)] == [("SCAL", [[-418.0]]), ("QQQQ", [[1.5]])]
    mixed = next(entries(klv("MyDD", "?", 14, struct.pack(">fffH", 1, 2, 3, 4))))
    assert mixed.rows("f[3]S").tolist() == [[1, 2, 3, 4]]
    with pytest.raises(BrokenTrack, match="14 bytes|not 14"):
        mixed.rows("f[2]S")
