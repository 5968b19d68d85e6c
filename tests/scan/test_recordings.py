"""Recordings of cameras: tracks, GoPro's telemetry, Insta360's trailer and factory; damage stops nothing."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import recording_world as world
from recording_world import ONE_EACH, Fix, Layout, klv, nest
from tiegraph.scan.recording import BrokenTrack, OneVideoTrack, Recording, edits, samples, tracks
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.telemetry import entries, factory_lenses, read_trailer
from tiegraph.scan.videos.video import open_film, recordings_of
from tiegraph.scan.videos.videotime import VideoClock, video_clock

START = datetime(2016, 12, 31, 23, 59, 58, 250000, timezone.utc)  # a leap second came 1.75 s later: UTC has none of it
BEGAN = pytest.approx(START.timestamp(), abs=1e-3)
NEAR_DEG = 2e-7  # the format has 1e-7


def clock(path: Path, **settings: object) -> VideoClock:
    return video_clock(path, ScanSettings(**settings))


def payloads(kind: str, fixes: Sequence[Fix], each: int = 10) -> list[bytes]:
    make = {"GPS5": world.gps5, "GPS9": world.gps9}[kind]
    return [make(fixes[k : k + each]) for k in range(0, len(fixes), each)]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Three seconds of MP4 without a creation time."""
    return world.film(tmp_path_factory.mktemp("recordings") / "plain.mp4", seconds=3).read_bytes()


def gopro(tmp_path: Path, plain: bytes, made: Sequence[bytes], layout: Layout = ONE_EACH) -> Path:
    """Created two hours late: a camera on local time."""
    path = tmp_path / "GX010001.MP4"
    path.write_bytes(plain)
    return world.with_telemetry(world.created(path, START.timestamp() + 7200), made, layout)


@pytest.mark.parametrize("layout", [Layout(), Layout(in_chunk=2, wide=True), Layout(in_chunk=3)])
@pytest.mark.parametrize("kind, times", [("GPS5", 3), ("GPS9", 30)])
def test_times_and_positions_of_frames(tmp_path: Path, plain: bytes, kind: str, times: int, layout: Layout) -> None:
    video = gopro(tmp_path, plain, payloads(kind, world.walk(START, 30, 10)), layout)
    found = clock(video)
    assert found.start_s == BEGAN and found.known and found.utc
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
    assert found.start_s == BEGAN
    assert np.isnan(found.taken(0.2).lat_deg) and np.isfinite(found.taken(0.5).lat_deg)


def test_a_payload_without_a_fix_and_one_without_a_height(tmp_path: Path, plain: bytes) -> None:
    fixes = world.walk(START, 30, 10)
    none = world.walk(START + timedelta(days=900), 10, 10, fix=0)
    flat = world.walk(fixes[20].time, 10, 10, fix=2)
    found = clock(gopro(tmp_path, plain, [world.gps5(f, above_sea=False) for f in (none, fixes[10:20], flat)]))
    assert "20 of 30 fixes used (10 without a fix left out), heights above the ellipsoid" in found.note
    assert found.start_s == BEGAN
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
    assert "GPS9" in found.note and found.start_s == BEGAN
    undated = clock(gopro(tmp_path, plain, [stale]))
    assert undated.start_s == round(START.timestamp() + 7200) and np.isfinite(undated.taken(0.4).lat_deg)
    assert "by the creation time in it" in undated.note and "GPS5" in undated.note


def test_clocks_that_contradict_each_other_are_said(tmp_path: Path, plain: bytes) -> None:
    fixes = world.walk(START, 30, 10)
    later = [0.0] * 10 + [16.0] * 10 + [-2.0] * 10
    moved = [replace(f, time=f.time + timedelta(seconds=s)) for f, s in zip(fixes, later)]
    assert "contradict each other by 2.0 s" in clock(gopro(tmp_path, plain, payloads("GPS5", moved))).note
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
    "cut off": (GOOD[:-20], "'DEVC' announces"),
    "too long": (GOOD[:-328] + HUGE + GOOD[-320:], "'GPS9' announces 65535 rows"),
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
    assert "20 of 20 fixes used" in found.note and found.start_s == BEGAN
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
    "all of one size": (b"stsz", 4, struct.pack(">I", 2**31), "together are larger than the file"),
    "stts": (b"stts", 4, struct.pack(">I", 2**31), "stts announces 2147483648 rows and has room for 1"),
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


def test_entries_say_what_they_are() -> None:
    data = klv("SCAL", "s", 2, struct.pack(">h", -418)) + klv("QQQQ", "q", 4, struct.pack(">i", 3 << 15)) + bytes(8)
    assert [(e.key, e.rows().tolist()) for e in entries(data)] == [("SCAL", [[-418.0]]), ("QQQQ", [[1.5]])]
    mixed = next(entries(klv("MyDD", "?", 14, struct.pack(">fffH", 1, 2, 3, 4))))
    assert mixed.rows("f[3]S").tolist() == [[1, 2, 3, 4]]
    with pytest.raises(BrokenTrack, match="14 bytes|not 14"):
        mixed.rows("f[2]S")


BEGIN = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc)
FIXES = world.walk(BEGIN - timedelta(seconds=0.5), 40, 10)  # before and beyond the three seconds
RECORDS = [(1, b"metadata" * 4), (7, world.gps_record(FIXES)), (3, b"\x11" * 500)]


def insv(tmp_path: Path, plain: bytes, created_s: float | None, gap: int = 0, records: list = RECORDS) -> Path:
    path = tmp_path / "VID_20240501_120000_00_001.insv"
    path.write_bytes(plain)
    if created_s is not None:
        world.created(path, created_s)
    return world.with_trailer(path, records, gap)


@pytest.mark.parametrize("gap", [0, 1000])  # ONE X2; X4, whose records lie apart
@pytest.mark.parametrize("hours", [0, 2, -3.5, 5.75])
def test_positions_by_time_whatever_zone_the_camera_is_on(tmp_path: Path, plain: bytes, gap: int, hours: float) -> None:
    found = clock(insv(tmp_path, plain, BEGIN.timestamp() + 3600 * hours, gap))
    assert found.start_s == BEGIN.timestamp() and found.known and found.utc
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
    found = clock(insv(tmp_path, plain, BEGIN.timestamp(), records=[(7, bytes(record) + b"\0" * 10)]))
    assert "32 of 40 fixes used (8 without a fix left out)" in found.note
    assert (found.taken(1.5).lat_deg, found.taken(1.5).lon_deg) == pytest.approx((-33.5, -70.25))
    assert np.isnan(found.taken(0.1).lat_deg)


def test_positions_of_another_time_are_not_used(tmp_path: Path, plain: bytes) -> None:
    found = clock(insv(tmp_path, plain, BEGIN.timestamp() + 400))
    assert "their times are not those of the recording (--scan.video-offset SECONDS): none used" in found.note
    assert found.places is None and found.start_s == BEGIN.timestamp() + 400
    mended = clock(insv(tmp_path, plain, BEGIN.timestamp() + 400), video_offset=("-400",))
    assert mended.start_s == BEGIN.timestamp() and np.isfinite(mended.taken(1.0).lat_deg)
    undated = clock(insv(tmp_path, plain, None))
    assert undated.places is None and "it has no recording time" in undated.note
    told = clock(insv(tmp_path, plain, None), video_offset=(str(BEGIN.timestamp()),))
    assert told.taken(1.0).lat_deg == pytest.approx(48 + 1.5e-5, abs=1e-9)
    many_days = clock(insv(tmp_path, plain, BEGIN.timestamp() + 50 * 3600))
    assert many_days.places is None


def test_a_file_without_trailer_or_receiver(tmp_path: Path, plain: bytes) -> None:
    path = tmp_path / "a.insv"
    for data in (b"", b"x" * 50, plain):
        path.write_bytes(data)
        assert read_trailer(path) is None
    found = clock(insv(tmp_path, plain, BEGIN.timestamp(), records=[(1, b"metadata")]))
    assert found.places is None and "Insta360" not in found.note


def test_damaged_trailers_are_named_and_the_video_keeps_its_time(tmp_path: Path, plain: bytes) -> None:
    def note_of(gap: int, at: int, value: int) -> str:
        """What is said of a trailer with another number at a place; a record of fixes if there is none."""
        path = insv(tmp_path, plain, BEGIN.timestamp(), gap)
        data = bytearray(path.read_bytes())
        at = at + len(data) if at else bytes(data).rindex(struct.pack("<BBI", 7, 0, len(world.gps_record(FIXES)))) + 6
        struct.pack_into("<I", data, at, value)
        path.write_bytes(data)
        found = clock(path)
        assert found.start_s == BEGIN.timestamp() and found.places is None
        return found.note

    for gap in (0, 300):
        assert "trailer cannot be read (its stated length is 2147483648 bytes" in note_of(gap, -40, 2**31)
        last = note_of(gap, -76, 10**6)
        assert "its last record" in last and "announces 1000000 bytes" in last
    assert "its index lists record 7 with 2120 bytes at 4294967295" in note_of(300, 0, 2**32 - 1)


# An X5's (Insta360Develop/Desktop-CameraSDK-Cpp, issue 85).
OLD = "2_2657.621_2684.250_2687.750_-0.259_-0.011_89.729_2651.033_8066.330_2692.030_0.247_-0.221_89.754_10752_5376_1137"
SPHERE = (
    "2_2.000000_4291.910_4291.470_2684.250_2687.750_-0.259_-0.011_89.729_0.000000_0.000000_0.000000_0.18322477_"
    "2.08857179_-3.36655450_0.00089921_0.00038060_10752_5376_113_2.000000_4278.090_4278.390_8066.330_2692.030_0.247_"
    "-0.221_89.754_0.000792_0.000132_-0.031986_0.18963484_2.04539418_-3.23319674_0.00101338_0.00195932_10752_5376_113_"
    "197632"
)
RADIUS = 2657.621, 2651.033  # at 100 degrees, as the old form states it
POLYNOMIAL = (  # form 2: the same radius, and its polynomial of the angle
    (2663.416, (1.0, -0.18974844, 0.27346808, -0.09002038)),
    (2658.524, (1.0, -0.18765773, 0.27116153, -0.08905181)),
)


@pytest.mark.parametrize("number", [0, 1])
def test_the_sphere_is_the_lens_that_the_other_forms_describe(number: int) -> None:
    found = factory_lenses(f"{OLD} {SPHERE}")
    lens = found[number]
    assert 1e-4 < abs(float(lens.radius_px(np.radians(100.0))) / RADIUS[number] - 1) < 2e-3
    stated, coefficients = POLYNOMIAL[number]
    angle = np.radians(np.arange(20, 101, 5.0))
    curve = sum(c * angle ** (n + 1) for n, c in enumerate(coefficients))
    assert 1e-4 < np.max(np.abs(lens.radius_px(angle) / (stated * curve / curve[-1]) - 1)) < 4e-3


@pytest.mark.parametrize("number, width", [(0, 5376), (1, 2880)])
def test_colmaps_lens_is_the_sphere_to_a_tenth_of_a_pixel(number: int, width: int) -> None:
    found = factory_lenses(SPHERE)
    params = found[number].opencv_fisheye(number, width)
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=width, height=width, params=params)
    angle = np.radians(np.arange(1.0, 88.0))
    at = np.asarray(camera.img_from_cam(np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])))
    scale = width / 5376
    centre = scale * (np.array([2684.25, 2687.75]) if number == 0 else np.array([8066.33 - 5376, 2692.03]))
    assert np.allclose(at[:, 1], centre[1])
    assert np.max(np.abs(at[:, 0] - centre[0] - scale * found[number].radius_px(angle))) < 0.1


def test_the_newest_form_that_can_be_read_is_taken() -> None:
    old, both = factory_lenses(OLD), factory_lenses(f"{OLD} {SPHERE}")
    assert [lens.roll_deg for lens in old] == [lens.roll_deg for lens in both] == [89.729, 89.754]
    assert not old[0].sphere and both[0].sphere and old[0].centre_px == both[0].centre_px
    assert factory_lenses(f"{SPHERE.removesuffix('197632')}132096 {OLD}") == old  # its last number says another form
    assert factory_lenses(f"{OLD} {SPHERE.replace('2_2.0', '1_2.0', 1)}") == old


@pytest.mark.parametrize("text", ["", "2_1", OLD.replace("10752", "0"), OLD.replace("5376", "4000"),
                                  SPHERE.replace("10752", "9" * 400), SPHERE.replace("10752", "10000", 1)])  # fmt: skip
def test_words_that_are_no_lenses(text: str) -> None:
    assert factory_lenses(text) is None


def test_numbers_of_no_lens_give_no_camera() -> None:
    found = factory_lenses(SPHERE.replace("4291.910", "0").replace("4291.470", "0"))
    assert found[0].opencv_fisheye(0, 1000) == ()


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["GoPro", "Insta360"])
def test_no_damage_ever_raises(tmp_path: Path, plain: bytes, camera: str) -> None:
    if camera == "GoPro":
        path, start = gopro(tmp_path, plain, payloads("GPS9", world.walk(START, 4, 10), each=2)), START
        begin, end = path.read_bytes().index(b"DEVC") - 8, 0
    else:
        path, start = insv(tmp_path, plain, BEGIN.timestamp(), 20, [(7, world.gps_record(FIXES[:3]))]), BEGIN
        begin, end = len(plain), 32
    data, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(150):
        made = bytearray(data)
        for at in rng.integers(begin, len(made) - end, 4):
            made[at] = rng.integers(256)
        cut = camera == "GoPro" and rng.random() < 0.2
        path.write_bytes(made[: rng.integers(begin, len(made) + 1)] if cut else made)
        found = clock(path)
        assert np.isfinite(found.start_s) and found.note
        assert camera == "GoPro" or found.start_s - start.timestamp() == pytest.approx(0, abs=86400)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    one, other = world.film(folder / "one.mp4", level=20), world.film(folder / "other.mp4", level=150)
    return world.two_tracks(folder / "VID_20240501_120000_00_001.insv", one, other)


@pytest.mark.parametrize("track, level", [(0, 20), (1, 150), (None, 20)])
def test_frames_of_each_track(two: Path, track: int | None, level: int) -> None:
    with open_film(Recording(two, track)) as opened:
        frames = list(opened.frames())
    assert [stamp for stamp, _ in frames] == pytest.approx(np.arange(20) / 10)
    assert np.all(np.abs([picture.mean() - level - k for k, (_, picture) in enumerate(frames)]) < 6)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize(
    "listed, first, stamp, count",
    [
        ([(2.0, 0)], 0, 0.0, 20),
        ([(0.37, -1), (2.0, 0)], 0, 0.37, 20),  # recorded later than the sound
        ([(0.25, -1), (0.12, -1), (2.0, 0)], 0, 0.37, 20),
        ([(1.5, 0.5)], 5, 0.0, 15),  # cut without encoding it again
        ([(0.3, -1), (1.0, 0.5)], 5, 0.3, 10),
    ],
)
def test_frames_count_as_the_edit_list_shows_them(
    tmp_path: Path, listed: list, first: int, stamp: float, count: int, wide: bool
) -> None:
    path = world.film(tmp_path / "a.mp4")
    with open_film(Recording(path)) as opened:
        whole = [picture.mean() for _, picture in opened.frames()]
    with open_film(Recording(world.edited(path, 0, listed, wide))) as opened:
        frames = list(opened.frames())
    assert [s for s, _ in frames] == pytest.approx(stamp + np.arange(count) / 10, abs=1e-6)
    assert [p.mean() for _, p in frames] == pytest.approx(whole[first : first + count])


def test_telemetry_counts_as_its_own_edit_list_says(tmp_path: Path) -> None:
    path = world.with_telemetry(world.film(tmp_path / "a.mp4"), [b"abcd"] * 4)
    for listed, first in (([(4.0, 0)], 0.0), ([(0.37, -1), (3.0, 1.5)], -1.13)):
        world.edited(path, 1, listed)
        with path.open("rb") as file:
            assert samples(file, tracks(file)[1]).begin_s == pytest.approx(first + np.arange(4))


@pytest.mark.parametrize("rows", [0, 1, 10**9])
def test_broken_edit_lists_do_nothing(tmp_path: Path, rows: int) -> None:
    path = world.edited(world.film(tmp_path / "a.mp4"), 0, [(0.5, -1)])
    data = path.read_bytes()
    at = data.index(b"elst") + 8
    path.write_bytes(data[:at] + rows.to_bytes(4, "big") + data[at + 4 :])
    with path.open("rb") as file:
        assert edits(file, tracks(file)[0])[1] == 0


def test_the_file_is_what_it_was_but_for_one_word(two: Path) -> None:
    data = two.read_bytes()
    places = [data.index(b"trak"), data.rindex(b"trak")]
    with OneVideoTrack(two, 1) as view:
        assert view.read() == data[: places[0]] + b"free" + data[places[0] + 4 :]
        for step in (1, 3, 7, 1000):
            view.seek(0)
            parts = [view.read(step) for _ in range(0, len(data) + step, step)]
            assert b"".join(parts) == data[: places[0]] + b"free" + data[places[0] + 4 :]
        assert view.seek(-10, 2) == len(data) - 10 and view.read(4) == data[-10:-6]
    with OneVideoTrack(two, 0) as view:
        assert view.read() == data[: places[1]] + b"free" + data[places[1] + 4 :]


def test_a_track_in_a_box_of_a_long_size_is_hidden_too(tmp_path: Path, two: Path) -> None:
    data = two.read_bytes()
    moov = dict(world.split(data))[b"moov"]
    boxes = b""
    for kind, inside in world.split(moov):
        long = (1).to_bytes(4, "big") + kind + (16 + len(inside)).to_bytes(8, "big") + inside
        boxes += long if kind == b"trak" else world.box(kind, inside)
    path = tmp_path / "long.insv"
    path.write_bytes(data[: data.rindex(b"moov") - 4] + world.box(b"moov", boxes))
    for track, level in ((0, 20), (1, 150)):
        with open_film(Recording(path, track)) as opened:
            assert abs(next(opened.frames())[1].mean() - level) < 6


def test_which_files_are_two_recordings(tmp_path: Path, two: Path) -> None:
    assert recordings_of(two, "a/shot") == [
        (Recording(two, 0), "a/shot/fisheye0"),
        (Recording(two, 1), "a/shot/fisheye1"),
    ]
    assert Recording(two, 1).name == "VID_20240501_120000_00_001.insv, track 2"
    renamed = tmp_path / "phone.mp4"
    renamed.write_bytes(two.read_bytes())
    assert recordings_of(renamed, "phone") == [(Recording(renamed), "phone")]
    small = world.film(tmp_path / "small.mp4", size=48)
    big = world.film(tmp_path / "big.mp4")
    other = world.two_tracks(tmp_path / "preview.insv", big, small)  # not two lenses: of different sizes
    for path in (other, tmp_path / "none.insv"):
        assert recordings_of(path, "f") == [(Recording(path), "f")]


def test_tracks_of_broken_files(tmp_path: Path, two: Path) -> None:
    path = tmp_path / "broken.insv"
    for data in (b"", b"\0" * 5000, b"\xff" * 5000, two.read_bytes()[:1500], b"\0\0\0\x09moov\0\0\0\0\x08trak"):
        path.write_bytes(data)
        with path.open("rb") as file:
            assert all(t.kind == b"" for t in tracks(file))
        assert recordings_of(path, "f") == [(Recording(path), "f")]
    with two.open("rb") as file:
        assert [(t.kind, t.format) for t in tracks(file)] == [(b"vide", b"mp4v")] * 2
