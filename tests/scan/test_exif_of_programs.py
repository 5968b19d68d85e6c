"""EXIF and XMP as cameras and programs are reported to write them (docs/situations.md)."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL.TiffImagePlugin import IFDRational
from scan_worlds import exif_of, picture, scan

from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.exif import Exif, read_exif

HERE = {"lat": 35.5, "lon": 139.25, "alt": 100.0}
EMPTY = IFDRational(0, 0)


def facts(gps: dict | None = None, detail: dict | None = None, base: dict | None = None, xmp: str = "", **tags) -> Exif:
    """What is read of a JPEG with such tags; GPS, detail and base tags by number."""
    block = exif_of(**tags)
    block.get_ifd(0x8825).update(gps or {})
    block.get_ifd(0x8769).update(detail or {})
    block.update(base or {})
    image = SimpleNamespace(getexif=lambda: block, size=(4000, 3000), info={"xmp": xmp.encode()})
    return read_exif(image, image.size, (0.2, 20.0))


def place(found: Exif) -> list[float]:
    return [found.lat_deg, found.lon_deg, found.height_m]


@pytest.mark.parametrize(
    ("gps", "lat", "lon"),
    [
        ({2: (35.0, 30.0, EMPTY)}, 35.5, 139.25),  # degrees and minutes, the seconds 0/0
        ({2: (35.5, EMPTY, EMPTY)}, 35.5, 139.25),
        ({2: (35.0, 30.0)}, 35.5, 139.25),
        ({4: (-139.0, 15.0, 0.0), 3: "W"}, 35.5, -139.25),  # the sign twice
        ({4: (-139.0, 15.0, 0.0), 3: "E"}, 35.5, -139.25),
        ({1: "South", 3: "w"}, -35.5, -139.25),
    ],
)
def test_angles_as_cameras_write_them(gps: dict, lat: float, lon: float) -> None:
    assert place(facts(gps, **HERE)) == pytest.approx([lat, lon, 100.0], abs=1e-9)


@pytest.mark.parametrize(
    ("gps", "used", "doubt"),
    [
        ({2: (EMPTY,) * 3, 4: (EMPTY,) * 3, 6: EMPTY, 1: "\0", 3: "\0"}, False, "fields .* are empty"),
        ({9: "V", 2: (17056881.85, 0.0, 0.0)}, False, "no place on the Earth"),
        ({9: "V"}, True, "no fix when it was taken"),
        ({9: "A", 18: "WGS-84"}, True, "^$"),
        ({18: "OSGB 1936"}, True, "its datum is OSGB 1936"),
    ],
)
def test_positions_without_a_fix_or_of_another_datum_are_said(gps: dict, used: bool, doubt: str) -> None:
    found = facts(gps, **HERE)
    assert np.isfinite(found.lat_deg) == used
    assert re.search(doubt, found.doubt)


def test_the_datum_tokyo_becomes_wgs84() -> None:
    found = facts({18: "TOKYO"}, **HERE)
    assert found.lat_deg - 35.5 == pytest.approx(11.7 / 3600, abs=0.3 / 3600)  # of Japan's maps before 2002: 450 m
    assert found.lon_deg - 139.25 == pytest.approx(-11.5 / 3600, abs=0.3 / 3600)
    assert found.position_sigma_m == 9.0


DJI = (
    'drone-dji:GpsLatitude="+35.500123456" drone-dji:GpsLongitude="+139.250098765" drone-dji:AbsoluteAltitude="+123.4"'
)
ADOBE = (
    'exif:GPSLatitude="35,30.0074N" exif:GPSLongitude="139,15,0.35E" exif:GPSAltitude="1234/10" exif:GPSAltitudeRef="1"'
)


@pytest.mark.parametrize(
    ("xmp", "tags", "right"),
    [
        (DJI, {}, [35.500123456, 139.250098765, 123.4]),  # EXIF was lost
        (DJI, {"lat": 0.0, "lon": 0.0, "alt": 0.0}, [35.500123456, 139.250098765, 123.4]),
        (DJI, HERE, [35.500123456, 139.250098765, 100.0]),  # EXIF cuts seconds off
        (DJI, {**HERE, "alt": 0.0}, [35.500123456, 139.250098765, 123.4]),
        (DJI, {**HERE, "lat": 35.50007891}, [35.50007891, 139.25, 100.0]),  # written after the flight
        (ADOBE, {}, [35 + 30.0074 / 60, 139.25 + 0.35 / 3600, -123.4]),
        (ADOBE, HERE, [35.500123333, 139.250097222, 100.0]),
    ],
)
def test_positions_in_xmp_count_where_exif_has_none_or_their_rounding(xmp: str, tags: dict, right: list) -> None:
    found = facts(xmp=xmp, **tags)
    assert place(found) == pytest.approx(right, abs=1e-8) and found.doubt == ""


def test_accuracies_in_xmp(tmp_path: Path) -> None:
    xmp = '<x Camera:GPSXYAccuracy="0.02" Camera:GPSZAccuracy="0.05"/>'
    for k in range(3):
        picture(tmp_path / f"{k}.jpg", exif=exif_of(**{**HERE, "lat": 35.5 + k / 1000}), xmp=xmp.encode())
    assert scan(tmp_path).position_sigma_m.tolist() == [[0.02, 0.02, 0.05]] * 3


def test_exif_that_stands_in_xmp_alone() -> None:
    lens = 'tiff:Make="DJI" tiff:Model="FC6310" exif:FocalLengthIn35mmFilm="24" exif:FocalLength="88/10"'
    found = facts(xmp=f'{lens} exif:DateTimeOriginal="2023-05-01T18:00:10.25+09:00"')
    assert (found.make, found.model, found.focal_mm, found.time_utc) == ("DJI", "FC6310", 8.8, True)
    assert found.focal_px == pytest.approx(5000 * 24 / 43.27) and found.time_s == 1682931610.25


UTC_S = 1682931610.0  # 2023-05-01 09:00:10


@pytest.mark.parametrize(
    ("detail", "base", "time_s", "utc"),
    [
        ({0x9003: "2023:05:01 18:00:10", 0x9010: "+09:00"}, {}, UTC_S, True),
        ({0x9003: "2023:05:01 09:00:10", 0x9011: "Z"}, {}, UTC_S, True),
        ({0x9003: "2023:05:01 03:30:10", 0x9011: "-05:30"}, {}, UTC_S, True),
        ({0x9003: "2023-05-01T18:00:10+09:00"}, {}, UTC_S, True),
        ({0x9004: "2023:05:01 18:00:10", 0x9292: "5"}, {}, UTC_S + 9 * 3600 + 0.5, False),
        ({0x9290: "25", 0x9010: "+09:00"}, {0x0132: "2023:05:01 18:00:10"}, UTC_S + 0.25, True),
        ({0x9003: "0000:00:00 00:00:00"}, {0x0132: "2023:05:01 18:00:10"}, UTC_S + 9 * 3600, False),
        ({0x9003: "2023:05:01 06:00:10 PM"}, {}, np.nan, False),  # not half a day early
    ],
)
def test_times_and_zones_of_every_tag(detail: dict, base: dict, time_s: float, utc: bool) -> None:
    found = facts(detail=detail, base=base)
    assert (found.time_s, found.time_utc) == (pytest.approx(time_s, nan_ok=True, abs=1e-4), utc)


def test_the_receivers_time_tells_the_zone_of_the_cameras_clock(tmp_path: Path) -> None:
    for k in range(4):
        exif = exif_of(**{**HERE, "lat": 35.5 + k / 1000}, time=f"2023:05:01 18:01:{10 + k}")  # a minute fast
        if k < 3:  # one picture was taken before the receiver had its time
            exif.get_ifd(0x8825).update({29: "2023:05:01", 7: (9.0, 0.0, 10.0 + k)})
        picture(tmp_path / f"{k}.jpg", exif=exif)
    scene = scan(tmp_path)
    assert scene.time_s.tolist() == [UTC_S + 60 + k for k in range(4)]
    assert any("the cameras' clock is UTC+9 h" in n for n in scene.notes)


@pytest.mark.parametrize("plane", [False, True])
def test_a_digital_zoom_is_another_camera(tmp_path: Path, plane: bool) -> None:
    for k in range(4):
        pixels = {"plane_x": 64 / 6.17, "plane_unit": 4} if plane else {}
        exif = exif_of(focal_35mm=24, focal_mm=4.5, **pixels)
        exif.get_ifd(0x8769)[0xA404] = 1.0 + (k > 1)
        picture(tmp_path / f"{k}.jpg", exif=exif)
    focal = [r.sensors[0].camera.params[0] for r in scan(tmp_path).rigs]  # type: ignore[union-attr]
    assert focal == pytest.approx([80 * 24 / 43.27, 160 * 24 / 43.27])


def test_positions_that_repeat_are_said(tmp_path: Path) -> None:
    for k in range(6):
        picture(tmp_path / f"{k}.jpg", exif=exif_of(lat=35.5 + k // 3 / 1000, lon=139.25, alt=100.0 + k))
    assert any("4 of 6 positions are those of another frame" in n for n in scan(tmp_path, ScanSettings()).notes)


def test_damaged_entries_count_as_not_written() -> None:
    """XMP that is no XML, a focal length of 0/0 and a make that is no text."""
    xmp = "<x drone-dji:GpsLatitude='+35.5' drone-dji:GpsLongitude=\"+139.25\" <\0& drone-dji:AbsoluteAltitude='+1,5'"
    found = facts(detail={0x920A: EMPTY, 0xA405: 0}, base={0x010F: b"\xff\0"}, xmp=xmp)
    assert (found.lat_deg, found.lon_deg, found.make) == (35.5, 139.25, "\xff")
    assert np.isnan([found.height_m, found.focal_mm, found.focal_px]).all()
