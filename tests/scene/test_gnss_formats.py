"""Positions of every format, written as its specification says: places, times and sigmas to the last digit."""

from __future__ import annotations

import io
import struct
import zipfile
from datetime import datetime, timezone
from functools import reduce
from pathlib import Path

import numpy as np
import pyproj
import pytest

from said import refused, says
from tiegraph.errors import InputError
from tiegraph.scene.gnss import FORMATS, read_gnss
from tiegraph.scene.gnss.fixes import Gnss, on_clock_of
from tiegraph.scene.times import gps_from_utc, leap_seconds, utc_from_gps

NOON = 1714564800.0  # 2024-05-01 12:00:00 UTC, which is second 302418 of GPS week 2312
WEEK, SECOND = 2312, 302418
COUNT = 4
LLH = np.array([[35.69 + 1e-5 * k, 139.77 - 2e-5 * k, 40.0 + 0.125 * k] for k in range(COUNT)])
UNDULATION = 36.7
MM = np.array([1e-8, 1e-8, 1e-3])  # degrees and metres
IMAGES = [f"DJI_{k + 7:04d}.JPG" for k in range(COUNT)]


def read(folder: Path, data: str | bytes, name: str = "positions.txt") -> Gnss:
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return read_gnss(path)


def same_places(found: Gnss, off: np.ndarray = MM, llh: np.ndarray = LLH) -> None:
    assert found.lat_lon_height.shape == llh.shape
    assert np.all(np.abs(found.lat_lon_height - llh) <= off), found.lat_lon_height - llh


def same_times(found: Gnss) -> None:
    assert found.period_s == 0
    np.testing.assert_allclose(found.time_s, NOON + np.arange(COUNT), rtol=0, atol=1e-6)


def same(found: Gnss) -> None:
    same_places(found)
    same_times(found)


# --- time scales ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "utc, gps, leaps",
    [
        (315964800, 0, 0),  # 6 January 1980
        (1341100799, 1025136014, 15),  # 30 June 2012 23:59:59
        (1341100800, 1025136016, 16),  # and the second after the leap second
        (1483228799, 1167264016, 17),
        (1483228800, 1167264018, 18),
        (NOON, WEEK * 604800 + SECOND, 18),
    ],
)
def test_leap_seconds(utc: float, gps: float, leaps: int) -> None:
    assert utc_from_gps(np.array(gps)) == utc and gps_from_utc(np.array(utc)) == gps and leap_seconds(utc) == leaps


HEADS = {
    "gps_week,gps_sow": [f"{WEEK},{SECOND + k}" for k in range(COUNT)],
    "week,time": [f"{WEEK},{SECOND + k}" for k in range(COUNT)],
    "gps_week,tow (ms)": [f"{WEEK},{1000 * (SECOND + k)}" for k in range(COUNT)],
    "gps_week,gps_tow_ms": [f"{WEEK},{1000 * (SECOND + k)}" for k in range(COUNT)],
    "gps_seconds": [f"{WEEK * 604800 + SECOND + k}" for k in range(COUNT)],
    "gps_time": [f"2024-05-01T12:00:{18 + k}" for k in range(COUNT)],
    "time_ns": [f"{int(NOON) + k}000000000" for k in range(COUNT)],
    "timestamp [ns]": [f"{int(NOON) + k}000000000" for k in range(COUNT)],
    "time_us": [f"{int(NOON) + k}000000" for k in range(COUNT)],
    "unix_time": [f"{NOON + k}" for k in range(COUNT)],
    "utc": [f"2024-05-01T12:00:0{k}Z" for k in range(COUNT)],
    "timestamp": [f"2024/05/01 12:00:0{k}" for k in range(COUNT)],
    "time": [f"2024-05-01T21:00:0{k}+09:00" for k in range(COUNT)],
}


def csv(head: str, times: list[str]) -> str:
    return f"{head},lat,lon,height\n" + "".join(f"{t},{a:.8f},{o:.8f},{h:.3f}\n" for t, (a, o, h) in zip(times, LLH))


@pytest.mark.parametrize("head", HEADS)
def test_time_scales_of_a_csv(tmp_path: Path, head: str) -> None:
    found = read(tmp_path, csv(head, HEADS[head]))
    same(found)
    gps = "gps" in head or "week" in head
    assert [("18 leap seconds" in n) for n in found.notes] == ([False, True] if gps else [False])


def test_a_column_of_any_epoch_is_left_alone(tmp_path: Path) -> None:
    assert read(tmp_path, csv("time", ["36000.0", "36000.2", "36000.4", "36000.6"])).time_s[1] == 36000.2
    assert read(tmp_path, csv("gps_time", ["01:00:00", "01:00:01", "01:00:02", "01:00:03"])).time_s[0] == 3600


def test_seconds_of_a_week_without_the_week_are_those_of_the_frames(tmp_path: Path) -> None:
    found = read(tmp_path, csv("gps_sow", [f"{SECOND + k}" for k in range(COUNT)]))
    assert found.period_s == 604800 and found.time_s[0] == SECOND
    same_times(on_clock_of(found, np.array([NOON - 86400, NOON + 3600, np.nan])))
    for frames in ([np.nan], [SECOND + 5.0], []):  # no dates: the same clock, or none
        assert on_clock_of(found, np.array(frames)).time_s[0] == SECOND


@pytest.mark.parametrize(
    ("head", "times", "first", "period"),
    [
        ("gps_sow", ["604798", "604799", "0", "1"], 604798, 604800),
        ("time", ["23:59:58", "23:59:59", "00:00:00", "0:00:01"], 86398, 86400),
        ("gps_time", ["604798", "604799", "0", "1"], 604798, 604800),
    ],
)
def test_times_go_on_after_midnight_and_after_saturday(
    tmp_path: Path, head: str, times: list[str], first: float, period: float
) -> None:
    found = read(tmp_path, csv(head, times))
    assert found.period_s == period
    np.testing.assert_allclose(found.time_s, first + np.arange(COUNT))
    same_places(found)


# --- NMEA -----------------------------------------------------------------------------------------------------------


def sentence(body: str) -> str:
    return f"${body}*{reduce(lambda a, c: a ^ ord(c), body, 0):02X}\r\n"


def minutes(value: float, digits: int) -> str:
    whole = int(value)
    return f"{whole:0{digits}d}{(value - whole) * 60:010.7f}"


def gga(k: int, clock: str = "", quality: int = 4, undulation: str = f"{UNDULATION}") -> str:
    lat, lon, height = LLH[k]
    place = f"{minutes(lat, 2)},N,{minutes(lon, 3)},E,{quality},17,0.6,{height - UNDULATION:.4f},M,{undulation},M"
    return sentence(f"GNGGA,{clock or f'12000{k}.00'},{place},1.0,0001")


def rmc(clock: str = "120000.00", day: str = "010524", status: str = "A") -> str:
    return sentence(f"GNRMC,{clock},{status},3541.4,N,13946.2,E,0.01,77.5,{day},,,A")


def gst(k: int) -> str:
    return sentence(f"GNGST,12000{k}.00,0.9,0.02,0.01,45.0,0.0{k + 1},0.0{k + 2},0.0{k + 3}")


def test_nmea(tmp_path: Path) -> None:
    found = read(tmp_path, "".join(rmc(f"12000{k}.00") + gga(k) + gst(k) for k in range(COUNT)))
    same(found)
    np.testing.assert_allclose(found.sigma_m, [[0.01 * (k + 2), 0.01 * (k + 1), 0.01 * (k + 3)] for k in range(COUNT)])
    assert found.line[:2] == (2, 5) and says(found.notes, "4 RTK fixed")


@pytest.mark.parametrize(
    "before, after",
    [
        (rmc("115959.00"), ""),
        ("", rmc("120009.00")),
        (sentence("GPZDA,120000.00,01,05,2024,00,00"), ""),
        (rmc("120000.00", "010524", "V"), ""),
        (rmc("000100.00"), ""),
        (b"\xb5\x62\x01\x07\x0a\x00$\xff".decode("latin-1") + "\r\n" + rmc(), ""),
        (rmc(day="010580", status="V") + rmc(), ""),
    ],
)
def test_the_date_of_nmea(tmp_path: Path, before: str, after: str) -> None:
    text = before + "".join(gga(k) for k in range(COUNT)) + after
    same_times(read(tmp_path, text.encode("latin-1")))


def test_nmea_over_midnight(tmp_path: Path) -> None:
    clocks = ["235958.00", "235959.00", "000000.00", "000001.00"]
    rows = [gga(k, clock) for k, clock in enumerate(clocks)]
    dated = read(tmp_path, rmc("235957.50", "300424") + "".join(rows))
    np.testing.assert_allclose(dated.time_s, NOON - 43202 + np.arange(COUNT))
    bare = read(tmp_path, "".join(rows))
    assert bare.period_s == 86400 and says(bare.notes, "no RMC or ZDA gives a date")
    np.testing.assert_allclose(bare.time_s, 86398 + np.arange(COUNT))
    for hours in (-11, 0, 11):  # frames of another time of that day
        found = on_clock_of(bare, np.array([NOON - 43200 + 3600 * hours]))
        np.testing.assert_allclose(found.time_s, NOON - 43202 + np.arange(COUNT))


def test_nmea_that_pauses_for_more_than_half_a_day(tmp_path: Path) -> None:
    """The first row after the pause stands before its own date."""
    rows = [gga(0, "080000.00"), rmc("080000.00", "300424"), gga(1, "210000.00"), rmc("210000.00"), gga(2, "210001.00")]
    found = read(tmp_path, "".join(rows))
    np.testing.assert_allclose(found.time_s, NOON + 3600 * np.array([-28, 9, 9 + 1 / 3600]))


@pytest.mark.parametrize("better_first", [True, False])
def test_of_two_talkers_the_better_fix_of_an_epoch_counts(tmp_path: Path, better_first: bool) -> None:
    text = rmc()
    for k in range(COUNT):
        single = gga(k, quality=1).replace("$GN", "$GP")
        body = single[1:].partition("*")[0].split(",")
        body[2] = "3500.0000"  # far off
        pair = [gga(k), sentence(",".join(body))]
        text += "".join(pair if better_first else pair[::-1])
    found = read(tmp_path, text)
    same(found)
    assert says(found.notes, "4 epochs have two positions, of two talkers: the better fix counts")


def test_nmea_south_and_west(tmp_path: Path) -> None:
    found = read(tmp_path, rmc() + sentence("GPGGA,120000,3351.5000,S,15112.6000,W,1,8,1.0,10.0,M,-20.5,M,,"))
    np.testing.assert_allclose(found.lat_lon_height, [[-(33 + 51.5 / 60), -(151 + 12.6 / 60), -10.5]], atol=1e-9)


def test_heights_of_nmea_are_above_the_ellipsoid(tmp_path: Path) -> None:
    lacking = read(tmp_path, rmc() + gga(0) + gga(1, undulation="") + gga(2) + gga(3))
    same_places(lacking)
    none = read(tmp_path, rmc() + "".join(gga(k, undulation="") for k in range(COUNT)))
    same_places(none, llh=LLH - [0, 0, UNDULATION])
    assert says(none.notes, "above the sea, used unchanged")


def test_nmea_rows_that_are_left_out(tmp_path: Path) -> None:
    wrong = gga(1).replace("N,139", "N,138")
    found = read(tmp_path, rmc() + gga(0) + wrong + gga(2, quality=0) + gga(3) + gga(3)[:30])
    same_places(found, llh=LLH[[0, 3]])
    assert any("line 3:" in n and "2 such sentences are left out" in n for n in found.notes)
    assert any("1 of 3 rows left out" in n and "(line 4)" in n for n in found.notes)


def test_nmea_as_another_program_writes_it(tmp_path: Path) -> None:
    library = pytest.importorskip("pynmeagps")
    data = b""
    for k, (lat, lon, height) in enumerate(LLH):
        given = {"NS": "N", "EW": "E", "quality": 4, "numSV": 12, "HDOP": 0.7, "altUnit": "M", "sepUnit": "M"}
        place = {"lat": round(lat, 9), "lon": round(lon, 9), "alt": round(height - UNDULATION, 3), "sep": UNDULATION}
        for kind, values in ("GGA", given | place), ("ZDA", {"day": 1, "month": 5, "year": 2024}):
            data += library.NMEAMessage("GN", kind, library.GET, time=f"12:00:0{k}", **values).serialize()
    found = read(tmp_path, data)
    same_places(found, 30 * MM)  # it writes five decimals of a minute
    same_times(found)


# --- RTKLIB ---------------------------------------------------------------------------------------------------------

PROGRAM = "% program   : RTKPOST ver.2.4.2\n% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,ns=# of satellites)\n"
NAMES = "latitude(deg) longitude(deg)  height(m)   Q  ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s)  ratio"
MORE = "1   9   0.0030   0.0020   0.0060   0.0010  -0.0010   0.0020   0.00   12.3"
SIGMA = [[0.002, 0.003, 0.006]] * COUNT


def solution(clock: str, times: list[str], names: str = NAMES, head: str = PROGRAM, sep: str = " ") -> str:
    rows = [sep.join([t, f"{a:.9f}", f"{o:.9f}", f"{h:.4f}", *MORE.split()]) for t, (a, o, h) in zip(times, LLH)]
    return f"{head}%  {clock}  {names}\n" + "\n".join(rows) + "\n"


CLOCKS = {
    "GPST": [f"2024/05/01 12:00:{18 + k}.000" for k in range(COUNT)],
    "UTC": [f"2024/05/01 12:00:0{k}.000" for k in range(COUNT)],
    "JST": [f"2024/05/01 21:00:0{k}.000" for k in range(COUNT)],
    "GPST ": [f"{WEEK} {SECOND + k}.000" for k in range(COUNT)],
}


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("sep", [" ", ",", "\t"])
def test_rtklib(tmp_path: Path, clock: str, sep: str) -> None:
    found = read(tmp_path, solution(clock, CLOCKS[clock], sep=sep))
    same(found)
    np.testing.assert_allclose(found.sigma_m, SIGMA)
    assert says(found.notes, "18 leap seconds") == ("GPST" in clock)
    assert says(found.notes, "4 fixed")


def test_rtklib_in_degrees_minutes_and_seconds(tmp_path: Path) -> None:
    rows = []
    for time, (lat, lon, height) in zip(CLOCKS["UTC"], LLH * [-1, 1, 1]):
        cells = []
        for value in (lat, lon):
            whole, rest = divmod(abs(value) * 3600, 3600)
            cells.append(f"{'-' if value < 0 else ''}{whole:.0f} {rest // 60:02.0f} {rest % 60:08.5f}")
        rows.append(f"{time} {cells[0]} {cells[1]} {height:.4f} {MORE}")
    names = NAMES.replace("latitude(deg)", "latitude(d'\")").replace("longitude(deg)", "longitude(d'\")")
    same_places(read(tmp_path, f"{PROGRAM}%  UTC   {names}\n" + "\n".join(rows)), llh=LLH * [-1, 1, 1])


def test_rtklib_in_ecef(tmp_path: Path) -> None:
    """Sigmas of the axes of the Earth are turned to east, north and up with their covariances."""
    xyz = np.stack(pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978").transform(*LLH.T), axis=-1)
    lat, lon = np.radians(LLH[0, :2])
    turn = np.array([[-np.sin(lon), np.cos(lon), 0],
                     [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
                     [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]])  # fmt: skip
    cov = turn.T @ np.diag([0.02, 0.03, 0.06]) ** 2 @ turn
    signed = [np.sign(c) * abs(c) ** 0.5 for c in (*np.diag(cov), cov[0, 1], cov[1, 2], cov[2, 0])]
    rows = [f"{t} " + " ".join(f"{v:.5f}" for v in p) + " 1 9 " + " ".join(f"{s:.7f}" for s in signed) + " 0.00 9.9"
            for t, p in zip(CLOCKS["GPST"], xyz)]  # fmt: skip
    head = "%  GPST   x-ecef(m)  y-ecef(m)  z-ecef(m)  Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) sdzx(m) age(s) ratio\n"
    found = read(tmp_path, head + "\n".join(rows))
    same_places(found, 10 * MM)
    np.testing.assert_allclose(found.sigma_m, [[0.02, 0.03, 0.06]] * COUNT, rtol=1e-3)


def test_rtklib_that_is_cut_off_or_above_the_geoid_is_said(tmp_path: Path) -> None:
    text = solution("GPST", CLOCKS["GPST"], head=PROGRAM.replace("ellipsoidal", "geodetic"))
    found = read(tmp_path, text[:-20])
    same_places(found, llh=LLH[:3])
    assert any("1 of 4 rows left out" in n and "(line 7)" in n for n in found.notes)
    assert says(found.notes, "above the geoid")


# --- GPX and KML ----------------------------------------------------------------------------------------------------


def gpx(more: str = "", time: bool = True, name: str = "trkpt") -> str:
    rows = [
        f'<{name} lat="{a:.9f}" lon="{o:.9f}"><ele>{h:.4f}</ele>{more}'
        f"{f'<time>2024-05-01T12:00:0{k}.000Z</time>' if time else ''}</{name}>\n"
        for k, (a, o, h) in enumerate(LLH)
    ]
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">\n'
    return f"{head}<trk><trkseg>\n{''.join(rows)}</trkseg></trk></gpx>\n"


def kml(inside: str) -> str:
    spaces = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    return f'<?xml version="1.0"?>\n<kml {spaces}>\n<Document>{inside}</Document></kml>'


WHENS = "".join(f"<when>2024-05-01T12:00:0{k}Z</when>\n" for k in range(COUNT))
COORDS = "".join(f"<gx:coord>{o:.9f} {a:.9f} {h:.4f}</gx:coord>\n" for a, o, h in LLH)
POINTS = [f"<Point><coordinates>{o:.9f},{a:.9f},{h:.4f}</coordinates></Point>" for a, o, h in LLH]


def test_gpx(tmp_path: Path) -> None:
    plain, raised = read(tmp_path, gpx()), read(tmp_path, gpx(f"<geoidheight>{UNDULATION}</geoidheight>"))
    same_places(plain)
    same_times(plain)
    same_places(raised, llh=LLH + [0, 0, UNDULATION])
    assert says(plain.notes, "above the sea") and not raised.notes
    assert plain.line == (4, 5, 6, 7)


def test_gpx_as_another_program_writes_it(tmp_path: Path) -> None:
    library = pytest.importorskip("gpxpy.gpx")
    whole, track, segment = library.GPX(), library.GPXTrack(), library.GPXTrackSegment()
    for k, (lat, lon, height) in enumerate(LLH):
        when = datetime.fromtimestamp(NOON + k, timezone.utc)
        segment.points.append(library.GPXTrackPoint(lat, lon, elevation=height, time=when))
    track.segments.append(segment)
    whole.tracks.append(track)
    same(read(tmp_path, whole.to_xml()))


@pytest.mark.parametrize(
    "data",
    [
        kml(f"<Placemark><gx:Track>{WHENS}{COORDS}</gx:Track></Placemark>"),
        kml("<gx:Track>" + "".join(a + b for a, b in zip(WHENS.splitlines(), COORDS.splitlines())) + "</gx:Track>"),
        kml("".join(f"<Placemark><name>stop</name><TimeStamp>{w}</TimeStamp>{p}</Placemark>"
                    for w, p in zip(WHENS.splitlines(), POINTS))),
    ],
)  # fmt: skip
def test_kml_tracks(tmp_path: Path, data: str) -> None:
    same(read(tmp_path, data))


def kmz(files: dict[str, str]) -> bytes:
    with zipfile.ZipFile(buffer := io.BytesIO(), "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return buffer.getvalue()


@pytest.mark.parametrize("name", ["doc.kml", "track.KML", "files/other.kml"])
def test_kml_packed_as_kmz(tmp_path: Path, name: str) -> None:
    track = kml(f"<Placemark><gx:Track>{WHENS}{COORDS}</gx:Track></Placemark>")
    more = {"images/pin.png": "x" * 5000, "a.kml": kml("")} if name == "doc.kml" else {}
    same(read(tmp_path, kmz({**more, name: track}), "flight.kmz"))


def test_kml_points_named_as_images(tmp_path: Path) -> None:
    found = read(tmp_path, kml("".join(f"<Placemark><name>{n}</name>{p}</Placemark>" for n, p in zip(IMAGES, POINTS))))
    same_places(found)
    assert list(found.names) == IMAGES


# --- ODM's geo.txt --------------------------------------------------------------------------------------------------


def geo(crs: str, more: str = "", back: bool = False) -> str:
    to = pyproj.Transformer.from_crs("EPSG:4979", pyproj.CRS(crs).to_3d(), always_xy=True)
    x, y, z = to.transform(LLH[:, 1], LLH[:, 0], LLH[:, 2])
    x, y = (y, x) if back else (x, y)
    return f"{crs}\n" + "".join(f"{n} {x[k]:.9f} {y[k]:.9f} {z[k]:.4f}{more}\n" for k, n in enumerate(IMAGES))


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32654", "EPSG:6677", "WGS84 UTM 54N",
                                 "+proj=utm +zone=54 +datum=WGS84 +units=m +no_defs"])  # fmt: skip
def test_geo_txt(tmp_path: Path, crs: str) -> None:
    text = geo("EPSG:32654").replace("EPSG:32654", crs) if crs.startswith("WGS84") else geo(crs)
    found = read(tmp_path, text)
    same_places(found)
    assert list(found.names) == IMAGES and np.isnan(found.sigma_m).all()


def test_geo_txt_with_angles_accuracies_and_labels(tmp_path: Path) -> None:
    found = read(tmp_path, geo("EPSG:4326", " 12.5 -90 0 0.02 0.05 a label"))
    np.testing.assert_allclose(found.sigma_m, [[0.02, 0.02, 0.05]] * COUNT)
    assert np.isnan(found.heading_deg).all()
    same_places(read(tmp_path, "# made by hand\n" + geo("EPSG:4326", " north")))
    cut = read(tmp_path, geo("EPSG:4326") + gga(0))
    same_places(cut)
    assert any("1 of 5 rows left out, empty or out of range (line 6)" in n for n in cut.notes)


# --- SBET -----------------------------------------------------------------------------------------------------------


def sbet(start: float = SECOND) -> bytes:
    motion = (*[0.1] * 3, 0.01, 0.02, 1.5, 0.0, *[0.2] * 3, *[0.001] * 3)
    places = [(np.radians(lat), np.radians(lon), height) for lat, lon, height in LLH]
    return b"".join(struct.pack("<17d", start + k, *place, *motion) for k, place in enumerate(places))


def test_sbet(tmp_path: Path) -> None:
    found = read(tmp_path, sbet(), "sbet_mission.out")
    same_places(found)
    assert found.period_s == 604800 and says(found.notes, "no week")
    same_times(on_clock_of(found, np.array([NOON, NOON + 9])))


def test_sbet_has_more_records_than_are_needed(tmp_path: Path) -> None:
    rows = np.zeros((1001, 17))
    rows[:, 0] = SECOND + np.arange(1001) / 200
    rows[:, 1:4] = [*np.radians(LLH[0, :2]), 40.0]
    rows[:, 1] += 1e-9 * np.arange(1001)
    found = read(tmp_path, rows.astype("<f8").tobytes())
    np.testing.assert_allclose(found.time_s, SECOND + np.arange(101) / 20, atol=1e-9)
    assert found.line[:3] == (1, 11, 21) and says(found.notes, "one in 10 is used")


# --- DJI ------------------------------------------------------------------------------------------------------------


def mrk(*changed: tuple[int, str, str]) -> str:
    rows = [
        f"{k + 7}\t{SECOND + k}.140277\t[{WEEK}]\t   -15,N\t     4,E\t   192,V\t{lat:.9f},Lat\t{lon:.9f},Lon\t"
        f"{height:.3f},Ellh\t0.010{k}, 0.0200, 0.0300\t50,Q"
        for k, (lat, lon, height) in enumerate(LLH)
    ]
    for row, old, new in changed:
        rows[row] = rows[row].replace(old, new)
    return "\n".join(rows) + "\n"


def test_mrk(tmp_path: Path) -> None:
    found = read(tmp_path, mrk(), "100_Timestamp.MRK")
    same_places(found)
    assert found.names == ("#7", "#8", "#9", "#10") and says(found.notes, "4 of Q 50")
    np.testing.assert_allclose(found.sigma_m, [[0.02, 0.01 + 1e-4 * k, 0.03] for k in range(COUNT)])
    without = read(tmp_path, mrk((1, "50,Q", "0,Q")))  # a row without a position
    same_places(without, llh=LLH[[0, 2, 3]])
    assert any("(line 2)" in n for n in without.notes)


# --- all of them ----------------------------------------------------------------------------------------------------

GOOD = {
    "GPX": gpx(),
    "KML": kml(f"<gx:Track>{WHENS}{COORDS}</gx:Track>"),
    "SBET": sbet(),
    "NMEA 0183": rmc() + gga(0),
    "RTKLIB": solution("GPST", CLOCKS["GPST"]),
    "DJI MRK": mrk(),
    "ODM geo.txt": geo("EPSG:4326"),
    "CSV": csv("time", HEADS["unix_time"]),
}


def raw(name: str) -> bytes:
    data = GOOD[name]
    return data if isinstance(data, bytes) else data.encode()


@pytest.mark.parametrize("name", FORMATS)
def test_a_format_is_told_by_its_content(name: str) -> None:
    data = raw(name)
    told = [n for n, (is_one, _) in FORMATS.items() if is_one(data.decode("utf-8", errors="replace"), data)]
    assert told == ([name, "CSV"] if name != "CSV" else ["CSV"])


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("seed", range(12))
def test_damaged_files_are_named_errors(tmp_path: Path, name: str, seed: int) -> None:
    """Cut off, or with bytes changed: rows or an InputError that names the file, never anything else."""
    rng, whole = np.random.default_rng(seed), raw(name)
    data = bytearray(whole[: rng.integers(1, len(whole))] if seed % 2 else whole)
    for at in rng.integers(0, len(data), seed):
        data[at] = rng.integers(0, 256)
    try:
        found = read(tmp_path, bytes(data))
    except InputError as error:
        assert "positions.txt" in str(error)
    else:
        assert len(found.lat_lon_height) and np.isfinite(found.lat_lon_height).all()


ROW = "<Placemark><gx:Track>{}</gx:Track></Placemark>"
WRONG: list[tuple[str | bytes, str]] = [
    (b"", "positions.txt: no rows"),
    (b"\0" * 4000, "positions.txt: is no text"),
    (bytes(range(256)) * 9, "positions.txt: is no text"),
    # a CSV whose times may mean two things
    (csv("gps_time", ["1398600018", "1398600019", "1398600020", "1398600021"]),
     r"line 2: gps_time 1398600018 can count from 1980 \(GPS\) or from 1970 .*: name the column gps_seconds, or"),
    (csv("week,sow", [f"264,{SECOND + k}" for k in range(4)]), r"line 2: GPS week 264 is none since 1999.*modulo"),
    (csv("week,sow", [f"2312.5,{SECOND + k}" for k in range(4)]), r"line 2: GPS week 2312.5 is none"),
    (csv("gps_week,sow", [f"2312,{302418000 + k}" for k in range(4)]), r"line 2: sow 302418000 is no second .*ms"),
    # NMEA
    (rmc() * 3, "no GGA sentence; the others have no height"),
    (gga(0).replace(",17,", ",18,"), "line 1: .* a wrong checksum, as have all 1 sentences"),
    (rmc() + sentence("GNGGA,120000,3541.4,N,13946.2,E,4,9,1,131.2,F,36.7,M,,"), "line 2: .*other units than metres"),
    (rmc() + gga(0, quality=0), "none of 1 rows has a time and a position in range: line 2"),
    (rmc() + sentence("GNGGA,120000,3561.4,N,13946.2,E,4,9,1,131.2,M,36.7,M,,"), "none of 1 rows"),
    # RTKLIB
    (solution("GPST", CLOCKS["GPST"], NAMES.replace("latitude(deg)", "e-baseline(m)")), "line 3: baselines .*llh"),
    (solution("GPST", CLOCKS["GPST"], head=PROGRAM.replace("WGS84", "Tokyo")), "line 2: positions on the datum Tokyo"),
    (solution("GPST", CLOCKS["GPST"]) + "2024/05/01 12:00:30.0 1 2 3 4 5 6 7 8 9 10 11 12 13 14\n", "line 8: 16 col"),
    (solution("GPST", []), "no rows below its header"),
    (solution("GPST", [f"264 {SECOND + k}" for k in range(4)]), "line 4: GPS week 264 is none"),
    (solution("GPST", CLOCKS["GPST"]).replace(" 35.", " 135."), "none of 4 rows .*line 4, latitude '135.69'"),
    # GPX and KML
    (gpx()[:-40], r"line 7: XML that is cut off or damaged"),
    (gpx().replace("</ele>", "<ele>", 1), "line 4: XML that is cut off or damaged"),
    (gpx(time=False), "line 4: no track point has a time"),
    (gpx(name="wpt"), "no track points .trkpt., 4 of routes"),
    (gpx() + "time,lat,lon,height\n1,35,139,4\n", "line 9: XML that is cut off or damaged .junk"),
    (gpx().replace("<gpx", '<!DOCTYPE x [<!ENTITY a "b">]>\n<gpx'), "line 2: defines entities"),
    (kml(ROW.format(WHENS + COORDS[:80] + "</gx:coord>")), "line"),
    (kml(f"<gx:Track>{WHENS}{COORDS.splitlines()[0]}</gx:Track>"), "line 3: a gx:Track of 4 times and 1 places"),
    (kml("".join(f"<Placemark><name>stop</name>{p}</Placemark>" for p in POINTS)),
     r"no gx:Track .* \(4 points without"),
    (kml("<LineString><coordinates>1,2,3</coordinates></LineString>"), "no gx:Track"),
    (kml(f"<gx:Track><altitudeMode>relativeToGround</altitudeMode>{WHENS}{COORDS}</gx:Track>"),
     "line 3: .* the ground"),
    (b"PK\x03\x04\x14\x00\x00\x00doc.kml\x00", "a KMZ or another ZIP archive that is cut off or damaged"),
    (kmz({"notes.txt": "x"}), r"a ZIP archive, but no KMZ \(no KML in it\)"),
    (kmz({"doc.kml": "<kml>"}), "XML that is cut off or damaged"),
    (kmz({"doc.kml": kml("") * 20})[:-30], "cut off or damaged"),
    # ODM's geo.txt
    ("EPSG:4326\n", "positions.txt: no rows"),
    (geo("EPSG:4326").replace("4326", "99999"), "line 1: 'EPSG:99999' is no coordinate system"),
    (geo("EPSG:32654").replace("32654", "4326"), "line 2: x 388.* lies outside WGS 84: .*another CRS"),
    (geo("EPSG:4326", back=True), r"line 2: x 35.69, y 139.77 lies outside WGS 84: latitude and longitude exchanged"),
    ("EPSG:4326\na.jpg 139 35 WRONG\n", "line 2, height 'WRONG'; correct the file"),
    ("EPSG:4326\na.jpg 139\n", "none of 1 rows has a position in range: line 2, latitude ''"),
    ("EPSG:4326\na.jpg 139 35\n", "none of 1 rows has a position in range: line 2, height"),
    ("EPSG:32654\n388 3950 40 12 13 a.jpg\n", "line 2: x y z px py image, .*by --gcp"),
    (geo("EPSG:4326") + f"{IMAGES[0]} 139.8 35.7 40\n", "line 6: image 'DJI_0007.JPG' has another place"),
    # SBET and DJI's MRK
    (sbet()[:-5], "positions.txt: 539 bytes are no whole records of 136 bytes: .* cut off"),
    (mrk()[:-30], r"positions.txt, line 4: '10.t302421.* is no row of a Timestamp.MRK"),
]  # fmt: skip


@pytest.mark.parametrize("data, words", WRONG)
def test_files_that_cannot_be_used_are_refused_with_their_line(tmp_path: Path, data: str | bytes, words: str) -> None:
    with refused(words, "positions.txt"):
        read(tmp_path, data)
