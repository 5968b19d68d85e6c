"""EXIF and XMP as cameras and programs write them (docs/situations.md): places, times, focal lengths."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scan_worlds import ORIGIN, data, exif_of, in_enu, picture, scan

from said import says
from tiegraph.geometry.geodesy import geodetic_from_world
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.exif import Exif, orientation_of, read_exif
from tiegraph.scene.images import find_images, probe_image
from tiegraph.scene.scene import Scene

HERE = {"lat": 35.5, "lon": 139.25, "alt": 100.0}
EMPTY = IFDRational(0, 0)


def facts(gps: dict | None = None, detail: dict | None = None, base: dict | None = None, xmp: str = "", **tags) -> Exif:
    """What is read of a JPEG with such tags; GPS, detail and base tags by number."""
    block = exif_of(**tags)
    block.get_ifd(0x8825).update(gps or {})
    block.get_ifd(0x8769).update(detail or {})
    block.update(base or {})
    image = SimpleNamespace(getexif=lambda: block, size=(4000, 3000), info={"xmp": xmp.encode()})
    return read_exif(image, image.size)


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
    assert found.sigma_m == 9.0


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
    assert (found.make, found.model, found.focal_mm, found.utc) == ("DJI", "FC6310", 8.8, True)
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
    assert (found.time_s, found.utc) == (pytest.approx(time_s, nan_ok=True, abs=1e-4), utc)


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
    assert any(
        "4 of 6 positions are identical to those of other frames" in n for n in scan(tmp_path, ScanSettings()).notes
    )


def test_damaged_entries_count_as_not_written() -> None:
    """XMP that is no XML, a focal length of 0/0 and a make that is no text."""
    xmp = "<x drone-dji:GpsLatitude='+35.5' drone-dji:GpsLongitude=\"+139.25\" <\0& drone-dji:AbsoluteAltitude='+1,5'"
    found = facts(detail={0x920A: EMPTY, 0xA405: 0}, base={0x010F: b"\xff\0"}, xmp=xmp)
    assert (found.lat_deg, found.lon_deg, found.make) == (35.5, 139.25, "\xff")
    assert np.isnan([found.height_m, found.focal_mm, found.focal_px]).all()


def flight(folder: Path, count: int = 6, **of_last: float) -> Scene:
    """Photographs 11 m apart, the last of which is at another place."""
    for k in range(count):
        place = {"lat": 35.69 + 1e-4 * k, "lon": 139.77, "alt": 40.0, **(of_last if k == count - 1 else {})}
        picture(folder / f"IMG_{k}.jpg", exif=exif_of(**place))
    return scan(folder)


@pytest.mark.parametrize(
    "of_last, words, known",
    [
        ({"lat": 91.0}, r"EXIF of IMG_5.jpg: latitude 91, longitude 139.77 is no place.*not used, as in 1 of 6", 5),
        ({"lat": 0.0, "lon": 0.0}, r"IMG_5.jpg: latitude 0, longitude 0 is what a receiver without a fix writes", 5),
        ({"alt": 39558.0}, r"EXIF of IMG_5.jpg: height 39558 m, not within -500 to 9000 m.*; 1 positions are", 6),
        ({"lat": 40.19}, r"IMG_5.jpg: lat 40.190000, lon 139.770000 lies 499 km .*1 of 6 positions are not used", 5),
    ],
)
def test_exif_positions_that_are_said(tmp_path: Path, of_last: dict, words: str, known: int) -> None:
    scene = flight(tmp_path, **of_last)
    assert says(scene.notes, words), scene.notes
    places = scene.world_from_rig[:, :3, 3]
    assert np.isfinite(places[:, 0]).sum() == known and np.nanmax(np.abs(np.ptp(places[:5], axis=0))) < 60


def test_no_exif_position_in_range_one_and_the_same_for_all(tmp_path: Path) -> None:
    for k in range(4):
        picture(tmp_path / "none" / f"{k}.jpg", exif=exif_of(lat=91.0, lon=139.77))
        picture(tmp_path / "same" / f"{k}.jpg", exif=exif_of(lat=35.69, lon=139.77, alt=40.0))
        picture(tmp_path / "one" / f"{k}.jpg", exif=exif_of(lat=35.69, lon=139.77) if k == 1 else Image.Exif())
    none, same = scan(tmp_path / "none"), scan(tmp_path / "same")
    assert says(none.notes, "latitude 91, .*as in 4 of 4 images; correct the files") and none.prior == "none"
    assert says(same.notes, "EXIF: all 4 positions are lat 35.69.*Not used") and same.prior == "none"
    assert says(scan(tmp_path / "one").notes, "1 of 4 frames has a position.*not used")


def test_exif_without_hemisphere_and_of_no_accuracy() -> None:
    found = facts({1: ""}, lat=-35.69, lon=139.77, alt=40.0)
    assert found.lat_deg > 0 and "north or south" in found.doubt
    found = facts({31: 1e7}, lat=35.69, lon=139.77, alt=40.0)
    assert np.isnan(found.lat_deg) and "accuracy of 1e+07 m is none" in found.doubt


def test_two_photographs_far_apart_are_said_and_used(tmp_path: Path) -> None:
    scene = flight(tmp_path, 2, lat=40.19)
    assert says(scene.notes, "499 km.*as 1 of 2 positions do") and np.isfinite(scene.world_from_rig[:, 0, 3]).all()


def test_positions_from_exif(tmp_path: Path) -> None:
    enu = np.array([[0.0, 0, 0], [30, 10, 2], [60, 0, 4]])
    for k, (a, o, h) in enumerate(geodetic_from_world(enu, ORIGIN)):
        picture(tmp_path / f"IMG_{k}.jpg", exif=exif_of(lat=a, lon=o, alt=h))
    picture(tmp_path / "IMG_9.jpg")
    scene = scan(tmp_path, ScanSettings(crs="EPSG:6677"))
    got = in_enu(scene)
    assert np.linalg.norm(got[:3] - enu, axis=1).max() < 0.05
    assert np.isnan(got[3]).all() and scene.prior == "exif"
    assert np.allclose(scene.position_sigma_m[:3], [5, 5, 10])
    assert scene.origin.crs == "EPSG:6677"


@pytest.mark.parametrize(("others", "taken"), [(400.0, False), (2.0, True)])
def test_a_height_of_nought_among_others_is_none(tmp_path: Path, others: float, taken: bool) -> None:
    for k in range(5):
        place = {"lat": 35.0, "lon": 139 + 1e-4 * k, "alt": 0.0 if k == 2 else others + k}
        picture(tmp_path / f"IMG_{k}.jpg", exif=exif_of(**place))
    scene = scan(tmp_path, ScanSettings(crs="ENU"))
    assert np.ptp(scene.world_from_rig[:, 2, 3]) < 10
    assert says(scene.notes, "1 positions have no height") != taken and (scene.position_sigma_m[2, 2] > 50) != taken


@pytest.mark.parametrize("crs", ["ENU", "auto"])
def test_a_survey_on_both_sides_of_180_degrees_is_one_place(tmp_path: Path, crs: str) -> None:
    for k in range(4):
        east = (179.9997 + 0.0002 * k + 180) % 360 - 180
        picture(tmp_path / f"IMG_{k}.jpg", exif=exif_of(lat=-16.8, lon=east, alt=5))
    scene = scan(tmp_path, ScanSettings(crs=crs))
    assert abs(scene.origin.lon_deg) > 179.999
    steps = np.diff(scene.world_from_rig[:, :3, 3], axis=0)
    assert np.abs(scene.world_from_rig[:, :2, 3]).max() < 150
    assert np.linalg.norm(steps, axis=1) == pytest.approx(np.full(3, 21.3), abs=0.05)  # 0.0002 deg at 16.8 south


@pytest.mark.slow
def test_exif_position_time_and_focal_length(tmp_path: Path) -> None:
    when = {"time": "2023:09:15 10:00:00", "subsec": "25", "offset": "+09:00"}
    exif = exif_of(make="Canon\0", model="EOS", focal_35mm=50, lat=35.5, lon=-120.25, alt=-3, **when)
    found = probe_image(picture(tmp_path / "a.jpg", (3000, 2000), exif=exif)).exif
    assert found.focal_px == pytest.approx(50 / 43.27 * np.hypot(3000, 2000), rel=1e-9)
    assert (found.lat_deg, found.lon_deg, found.height_m) == pytest.approx((35.5, -120.25, -3.0), abs=1e-7)
    assert found.time_s == pytest.approx(1694739600.25) and found.utc  # 01:00:00.25 UTC
    assert (found.make, found.model) == ("Canon", "EOS")


@pytest.mark.parametrize(("reference", "height"), [(0, 428.0), (1, -428.0), (2, 428.0), (3, -428.0)])
def test_exif_3_heights_below_sea_level(reference: int, height: float) -> None:
    assert facts({5: bytes([reference])}, lat=31.5, lon=35.5, alt=428).height_m == height


@pytest.mark.slow
@pytest.mark.parametrize(
    "size, smaller",
    [((6000, 4000), 1.0), ((1500, 1000), 0.25), ((1000, 1500), 0.25), ((4000, 4000), 1.0), ((1000, 1000), 0.25)],
)
def test_the_focal_length_is_that_of_the_photograph_before_it_was_made_smaller_or_cut(
    tmp_path: Path, size: tuple[int, int], smaller: float
) -> None:
    # 24 mm before a sensor of 36 x 24 mm and 6000 x 4000 pixels, by the density of the pixels and by its equivalent
    written = {"width": 6000, "height": 4000}
    density = exif_of(focal_mm=24.0, plane_x=6000 / 36 * 10, plane_unit=3, **written)
    equivalent = exif_of(focal_35mm=24, **written)
    for name, exif in ("density.jpg", density), ("equivalent.jpg", equivalent):
        found = probe_image(picture(tmp_path / name, size, exif=exif)).exif
        assert found.focal_px == pytest.approx(4000.0 * smaller, rel=1e-3)


def test_unbelievable_exif_counts_as_not_written() -> None:
    found = facts(focal_35mm=1, time="0000:00:00 00:00:00", lat=0.0, lon=0.0, alt=0.0)
    assert np.isnan([found.focal_px, found.time_s, found.lat_deg, found.lon_deg]).all()


def test_phone_photographs_of_a_hill() -> None:
    folder = data("oppaiyama", "images")
    found = probe_image(folder / find_images(folder)[0]).exif
    # iPhone 5s: 29 mm equivalent on 1224 x 918 pixels; about 1040 px from the sensor's data sheet (4.15 mm on 4.89 mm).
    assert 980 < found.focal_px < 1060
    assert 38.2 < found.lat_deg < 38.3 and 140.9 < found.lon_deg < 141.0
    assert found.sigma_m == 5.0 and not found.utc


@pytest.mark.parametrize(("written", "read"), [(8, 8), (3, 3), (9, 1), (0, 1), (None, 1)])
def test_orientation_is_read_and_1_where_nothing_says_it(tmp_path: Path, written: int | None, read: int) -> None:
    exif = Image.Exif()
    if written is not None:
        exif[0x0112] = written
    Image.new("RGB", (4, 3)).save(tmp_path / "a.jpg", exif=exif)
    assert orientation_of(tmp_path / "a.jpg") == read
    (tmp_path / "b.jpg").write_bytes(b"no image")
    assert orientation_of(tmp_path / "b.jpg") == orientation_of(tmp_path / "none.jpg") == 1
