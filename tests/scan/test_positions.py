"""Positions of frames by files of every format: interpolated, named, in a CRS, or refused with file and line."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta, timezone
from functools import reduce
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scan_worlds import ORIGIN, Survey, exif_of, flu_rig, gnss_csv, in_enu, papers_rig, picture, scan, times_csv

from said import refused, says
from tiegraph.geometry.geodesy import geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.pipeline.georef import _rows
from tiegraph.project.settings import Settings
from tiegraph.scan.rigfiles.rigspec import AXES, orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.colmapmodel import image_poses, read_model
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fixes import Measurements, PositionRows
from tiegraph.sfm.world.georef import georeference

HEAD = "time,lat,lon,height"
FRAMES = 8


def row(k: int, **other: object) -> str:
    """A row of the good GNSS file: 2 m a second, in Tokyo."""
    good: dict[str, object] = {"time": 100.0 + k, "lat": round(35.69 + 1e-5 * k, 8), "lon": 139.77, "height": 40.0}
    return ",".join(str(v) for v in {**good, **other}.values())


def table(*changed: tuple[int, dict], head: str = HEAD, more: str = "") -> str:
    rows = [row(k, **dict(changed).get(k, {})) + more for k in range(FRAMES)]
    return "\n".join([head, *rows]) + "\n"


def by_image(*lines: str, images: Sequence[str] = ()) -> str:
    rows = [f"{n},{35.69 + 1e-5 * k:.6f},139.77,40" for k, n in enumerate(images or ALL)]
    return "\n".join(["image,lat,lon,height", *rows, *lines]) + "\n"


ALL = [f"up/cam0/{k:06d}.jpg" for k in range(FRAMES)]
EVERY = {k: {} for k in range(FRAMES)}
RADIANS = tuple((k, {"lat": 0.6229 + 1e-7 * k, "lon": 2.4394}) for k in range(FRAMES))


def scan_gnss(survey: Survey, folder: Path, text: str | bytes, crs: str = "auto") -> Scene:
    (folder / "g.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return survey.scan(ScanSettings(crs=crs), gnss=folder / "g.csv", times=times_csv(folder / "t.csv", FRAMES))


@pytest.mark.parametrize(
    "text, words",
    [
        (HEAD + "\n100,0,35,69,139,77,40,0\n", r"line 2: 8 cells below a header of 4 .*decimal commas"),
        (table() + "108,35.69,139.77,40,9\n", r"line 10: 5 cells below a header of 4"),
        (table(*RADIANS), r"line 2: lat 0.6229, lon 2.4394: .*radians do: write degrees"),
        (table(head="time,lat (rad),lon,height"), "column 'lat' is in radians: write degrees"),
        (table(*((k, {"height": 39558}) for k in EVERY)),
         r"none of 8 rows.*line 2, height '39558', not within -500 to 9000 m: in another unit"),
        (table(head=HEAD + ",sigma", more=",inf"), r"none of 8 rows.*line 2, accuracy 'inf'"),
        (table(head=HEAD + ",sigma", more=",1e300"), r"none of 8 rows.*line 2, accuracy '1e300'"),
        (table(*((k, {"lat": 3541.4, "lon": 13946.2}) for k in EVERY)), r"line 2, latitude '3541.4'.*NMEA"),
        (table(*((k, {"lat": 356914000, "lon": 1397700000}) for k in EVERY)), r"1e-7 degrees"),
        (table(*((k, {"lat": 139.77, "lon": 35.69}) for k in EVERY)), "lat and lon look exchanged"),
        (table(head=HEAD + ",lat", more=",1"), r"column 'lat' 2 times \(columns 2, 5\): keep the right one"),
        (table() + "time,lon,lat,height\n110,139.77,35.69,40\n", "line 10: a second header with other columns"),
        (table(*((k, {"time": 103}) for k in EVERY)), r"line 3: all 8 rows have the time 103.00 s: give the time"),
        (table(*((k, {"time": 1e5 + 1e3 * k}) for k in EVERY)), r"do not overlap.*look like ms: .*time \(ms\)"),
        (HEAD + "\n", "no rows below its header"),
        (table().encode("utf-16-le"), "is no text"),
        (bytes(range(256)) * 20, "is no text"),
        (by_image(f"{ALL[2]},35.7,139.77,40"), r"line 10: image 'up/cam0/000002.jpg' has another place than in line 4"),
    ],
)  # fmt: skip
def test_gnss_files_that_cannot_be_meant(one_pass: Survey, tmp_path: Path, text: str | bytes, words: str) -> None:
    with refused(words, "g.csv"):
        scan_gnss(one_pass, tmp_path, text)


def test_short_names_that_several_passes_share(two_passes: Survey, tmp_path: Path) -> None:
    with refused("several images have this name: write down/cam0/000000.jpg"):
        scan_gnss(two_passes, tmp_path, by_image(images=["000000.jpg", "000001.jpg"]))


@pytest.mark.parametrize(
    "text, words, known",
    [
        (table((3, {"height": 9000.5})), r"1 of 8 rows left out.*line 5, height '9000.5', not within -500 to 9", 8),
        (table((7, {"height": -9999})), r"1 of 8 rows left out.*line 9, height '-9999', not within -500 to", 7),
        (table((3, {"lat": 95})), r"line 5, latitude '95'; correct", 8),
        (table((7, {"lat": "nan"})), r"line 9, latitude 'nan'", 7),
        (table((7, {"time": "inf"})), r"line 9, time 'inf'", 7),
        (table((7, {"time": "1e308"})), r"line 9, time '1e308'", 7),
        (table((7, {"lat": 0, "lon": 0})), r"line 9, position 0, 0", 7),
        (table((7, {"height": "40,1e300"}), head=HEAD + ",sigma", more="").replace("40.0\n", "40.0,0.1\n"),
         r"line 9, accuracy '1e300'", 7),
        (table(head=HEAD + ",sigma", more=",-1"), r"line 2: 'sigma' '-1' is no standard deviation.*8 of 8", 8),
        (table(head=HEAD + ",sigma_h", more=",0"), r"line 2: 'sigma_h' '0' is no standard deviation", 8),
        (table(head=HEAD + ",sigma", more=",good"), r"'sigma' 'good' is no standard deviation", 8),
        (table(head=HEAD + ",heading", more=",1e9"), r"line 2: 'heading' '1e9' is no angle in degrees: not used", 8),
        (table((7, {"lat": 40.19})), r"line 9: lat 40.190000, lon 139.770000 lies 499 km from most.*1 of 8 pos", 7),
        (table((7, {"height": 9000})), r"line 9: lat 35.690070, lon 139.770000 lies 9 km", 7),
        (table(*((k, {"lat": 40.0}) for k in range(4))), r"lies 47\d km.*as 4 of 8 positions do: two surveys", 8),
        (table(*((k, {"lat": 35.69}) for k in EVERY)), r"all 8 positions are lat 35.690000, lon 139.770000", 8),
        (table(*((k, {"time": 107 - k}) for k in EVERY)), r"line 3: rows are not in time order", 8),
        (table() + row(3) + "\n", r"line 10: 1 rows have the time of another row and are left out, as at 103.00 s", 8),
        (table() + table(), r"line 10: the header again, left out", 8),
        (table() + "108,35.6", r"line 10: fewer cells than the header has columns \(4\), as in 1 of 9 rows", 8),
        (table(head="time,lat,lon,altitude,ellipsoidal_height", more=",80"),
         r"ellipsoidal_height; passed over: altitude", 8),
        (table(*((k, {"time": 100e3 * k + 100}) for k in EVERY)), r"7 of 8 frames have no position.*look like ms", 1),
        ("# H\xf6he\n".encode("latin-1") + table().encode(), r"line 1: not UTF-8", 8),
        (by_image(f"{ALL[2]},35.690020,139.77,40"), r"line 10: image 'up/cam0/000002.jpg' is listed twice", 8),
        (by_image("up/cam1/000002.jpg,35.70,139.77,40"), r"line 10: up/cam1/000002.jpg lies 110\d.\d m from", 8),
        (by_image("x.jpg,35.7,139.77,40"), r"1 rows name images that are not here, such as x.jpg \(line 10\)", 8),
        (by_image(f"{ALL[7]},40.19,139.77,40", images=ALL[:7]), r"line 9: lat 40.19.* 499 km.*1 of 8 .*not used", 7),
        (by_image(*(f"{n},40.19,139.77,40" for n in ALL[5:]), images=ALL[:5]), r"3 of 8 positions do: two", 8),
    ],
)  # fmt: skip
def test_gnss_rows_that_are_said(one_pass: Survey, tmp_path: Path, text: str | bytes, words: str, known: int) -> None:
    scene = scan_gnss(one_pass, tmp_path, text)
    assert says(scene.notes, words) and says(scene.notes, "g.csv"), scene.notes
    positions = scene.world_from_rig[:, :3, 3]
    assert np.isfinite(positions[:, 0]).sum() == known


def test_what_is_left_out_is_not_in_the_way(one_pass: Survey, tmp_path: Path) -> None:
    """The others keep the places they have without the false row, also for georef, which reads the file itself."""
    clean = scan_gnss(one_pass, tmp_path, table())
    spoilt = scan_gnss(one_pass, tmp_path, table((7, {"lat": 40.19})))
    assert np.allclose(spoilt.world_from_rig[:7, :3, 3], clean.world_from_rig[:7, :3, 3], atol=1e-6)
    assert len(read_gnss(tmp_path / "g.csv").time_s) == 7


@pytest.mark.parametrize(
    "text",
    [
        table(),
        b"\xef\xbb\xbf" + table().encode(),
        table().encode("utf-16"),
        table().replace("\n", "\r\n"),
        table().replace("\n", "\r"),
        table().replace(",", ";"),
        table().replace(",", "\t"),
        table(*((k, {"time": f"{100 + k}.0"}) for k in EVERY)).replace(",", ";").replace(".", ",").encode("utf-16"),
        table(head="Time (s) Latitude [deg] Longitude [deg] Height (m)").replace(",", " "),
        table(*((k, {"time": 1000 * (100 + k)}) for k in EVERY), head="time (ms),lat,lon,height"),
        table(*((k, {"time": f'"{100 + k}"'}) for k in EVERY)),
        by_image(),
        by_image(images=[n.replace("/", "\\") for n in ALL]),
        by_image(images=[n.upper() for n in ALL]),
        "%  UTC           latitude(deg) longitude(deg)  height(m)\n"
        + "".join(f"1970/01/01 00:01:{40 + k}.000  {35.69 + 1e-5 * k:.8f}  139.77  40.0\n" for k in EVERY),
    ],
)  # fmt: skip
def test_good_files_of_many_kinds_say_nothing_but_the_accuracy(
    one_pass: Survey, tmp_path: Path, text: str | bytes
) -> None:
    scene = scan_gnss(one_pass, tmp_path, text)
    said = [n for n in scene.notes if "g.csv" in n and "columns read: " not in n]
    assert said == ["g.csv: accuracy not given; 5 m horizontal and 10 m vertical assumed"]
    north = scene.world_from_rig[:, 1, 3]
    assert np.diff(north) == pytest.approx(1.109, abs=0.01)


@pytest.mark.parametrize(
    "crs, words",
    [
        ("EPSG:27700", r"EPSG:27700 \(.*\): lengths in it are 1.15.*35.690.*choose EPSG:32654"),
        ("EPSG:32632", r"1.268. times the true ones.*choose EPSG:32654"),
        ("EPSG:3857", r"1.23.. times the true ones.*choose EPSG:32654"),
        ("EPSG:4326", "not projected"),
        ("foo", "unknown CRS 'foo'"),
    ],
)
def test_a_crs_of_another_place_is_refused(one_pass: Survey, tmp_path: Path, crs: str, words: str) -> None:
    with refused(words):
        scan_gnss(one_pass, tmp_path, table(), crs)


def test_a_crs_that_is_only_near_is_said(one_pass: Survey, tmp_path: Path) -> None:
    near = r"EPSG:32653 .*: 8 of 8 positions lie outside its area of use.*EPSG:32654 would fit"
    assert says(scan_gnss(one_pass, tmp_path, table(), "EPSG:32653").notes, near)
    assert not says(scan_gnss(one_pass, tmp_path, table(), "EPSG:6677").notes, "area of use")


@pytest.mark.slow
def test_a_crs_without_positions_is_said_and_checked(one_pass: Survey) -> None:
    for crs, code in (("EPSG:6677", "EPSG:6677"), ("UTM10N", "EPSG:32610")):
        notes = one_pass.scan(ScanSettings(crs=crs)).notes
        assert says(notes, rf"--scan.crs {code}: nothing here has positions.*--gcp")
    assert not says(one_pass.scan().notes, "scan.crs")
    zone = r"'UTM10': EPSG:32610 is .* north .*EPSG:32710 south.*give EPSG:n .*ENU.*auto"
    for crs, words in (("EPSG:1", "unknown CRS 'EPSG:1'"), ("UTM10", zone)):
        with refused(words):
            one_pass.scan(ScanSettings(crs=crs))


def test_heights_of_an_aircraft_that_says_so(tmp_path: Path) -> None:
    (tmp_path / "g.csv").write_text("time,lat,lon,height\n0,35.69,139.77,11000\n1,35.691,139.77,-600\n")
    with refused("none of 2 rows"):
        read_gnss(tmp_path / "g.csv")
    assert len(read_gnss(tmp_path / "g.csv", (-500.0, 12000.0)).time_s) == 1
    for k in range(3):
        picture(tmp_path / "in" / f"IMG_{k}.jpg", exif=exif_of(lat=35.69 + 1e-4 * k, lon=139.77, alt=11000.0))
    for settings, sigma in ((ScanSettings(), 100.0), (ScanSettings(heights_m=(-500.0, 12000.0)), 10.0)):
        scene = Survey(tmp_path / "in").scan(settings=settings)
        assert np.all(scene.position_sigma_m[:, 2] == sigma)
        assert abs(scene.origin.height_m - (0 if sigma == 100 else 11000)) < 1


ENU = ScanSettings(crs="ENU")


def test_positions_are_interpolated_and_gaps_stay_empty(one_pass: Survey, tmp_path: Path) -> None:
    t = np.array([99.5, 100.5, 101.5, 105.5, 106.5])
    given = {"gnss": gnss_csv(tmp_path / "g.csv", t, np.stack([2 * t, -t, 0 * t + 3], axis=1))}
    given["times"] = times_csv(tmp_path / "t.csv", FRAMES)
    scene, want = one_pass.scan(ENU, **given), 100.0 + np.arange(FRAMES)
    known = np.isfinite(in_enu(scene)[:, 0])
    assert np.flatnonzero(known).tolist() == [0, 1, 6]
    assert in_enu(scene)[known] == pytest.approx(np.stack([2 * want, -want, 0 * want + 3], axis=1)[known], abs=1e-3)
    assert np.allclose(scene.position_sigma_m[known], [0.05, 0.05, 0.1])
    assert np.isnan(scene.position_sigma_m[~known]).all()
    assert scene.prior == "gnss" and scene.has_positions() and not scene.has_orientations()
    assert says(scene.notes, "5 of 8 frames have no position") and np.allclose(scene.time_s, want)
    wide = one_pass.scan(ScanSettings(crs="ENU", max_gap_s=10), **given)
    assert np.isfinite(in_enu(wide)[:, 0]).sum() == 7  # the frame at 107 s is outside, not in a gap


def test_gnss_by_image_name_and_the_default_accuracy(one_pass: Survey, tmp_path: Path) -> None:
    llh = geodetic_from_world(np.array([[0.0, 0, 0], [5, 0, 0]]), ORIGIN)
    rows = [f"{name},{a:.9f},{o:.9f},{h:.4f}\n" for name, (a, o, h) in zip(ALL, llh)]
    (tmp_path / "g.csv").write_text("image,lat,lon,alt\n" + "".join(rows) + "else.jpg,35,139,1\n")
    scene = one_pass.scan(ENU, gnss=tmp_path / "g.csv")
    assert in_enu(scene)[:2] == pytest.approx(np.array([[0, 0, 0], [5, 0, 0]]), abs=1e-3)
    assert np.allclose(scene.position_sigma_m[:2], [5, 5, 10]) and np.isnan(scene.position_sigma_m[2:]).all()
    assert says(scene.notes, "1 rows name images that are not here, such as else.jpg")
    (tmp_path / "g.csv").write_text("image,lat,lon,alt\nelse.jpg,35,139,1\n")
    with refused("none of its images is here: else.jpg"):
        one_pass.scan(gnss=tmp_path / "g.csv")


def test_frames_without_times_and_times_that_do_not_overlap(one_pass: Survey, tmp_path: Path) -> None:
    gnss = gnss_csv(tmp_path / "g.csv", np.arange(5.0), np.zeros((5, 3)))
    with refused("the frames have none.*--times"):
        one_pass.scan(gnss=gnss)
    with refused(r"0.00 ... 4.00 s do not overlap the frames' 100.00 ... 107.00 s"):
        one_pass.scan(gnss=gnss, times=times_csv(tmp_path / "t.csv", FRAMES))


def test_times_from_file_names_reach_the_gnss(tmp_path: Path) -> None:
    t = 1694739600.0 + np.arange(4)
    for camera, time in product(("cam0", "cam1"), t):
        picture(tmp_path / "in" / camera / f"{time:.3f}.jpg")
    gnss = gnss_csv(tmp_path / "g.csv", t, np.stack([t - t[0], 0 * t, 0 * t], axis=1))
    assert in_enu(scan(tmp_path / "in", ENU, gnss=gnss))[:, 0] == pytest.approx([0, 1, 2, 3], abs=1e-3)


def test_a_heading_column_gives_level_rotations(one_pass: Survey, tmp_path: Path) -> None:
    llh = geodetic_from_world(np.array([[0.0, 0, 0], [0, 5, 0], [0, 10, 0]]), ORIGIN)
    rows = [f"{100 + k},{a:.9f},{o:.9f},{h:.3f},{(350, 90, 10)[k]}\n" for k, (a, o, h) in enumerate(llh)]
    (tmp_path / "g.csv").write_text("time,lat,lon,height,heading\n" + "".join(rows))
    given = {"gnss": tmp_path / "g.csv", "times": times_csv(tmp_path / "t.csv", 3), "rig": flu_rig(tmp_path)}
    body = one_pass.scan(ENU, **given).world_from_rig[:3, :3, :3] @ orient(30, -5, 0, "flu").T
    assert body[1, :, 0] == pytest.approx([1, 0, 0], abs=1e-6)  # heading 90: forward is east
    assert body[0, :, 0] == pytest.approx([np.sin(np.radians(350)), np.cos(np.radians(350)), 0], abs=1e-6)
    assert body[:, :, 2] == pytest.approx(np.tile([0, 0, 1.0], (3, 1)), abs=1e-6)
    assert np.linalg.det(AXES["flu"]) == pytest.approx(1)


def test_the_row_of_a_frame_that_stands_off_is_the_one_blamed(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 3, 2)
    rows = [f"up/cam{c}/{k:06d}.jpg,{35.69 + 1e-5 * k:.5f},139.77,40" for c in range(3) for k in range(2)]
    rows[0] = "up/cam0/000000.jpg,35.6902,139.77,40"  # 22 m off; the others of its frame agree
    (tmp_path / "g.csv").write_text("\n".join(["image,lat,lon,height", *rows]) + "\n")
    (note,) = (n for n in scan(images, gnss=tmp_path / "g.csv").notes if "of the same frame" in n)
    assert "g.csv, line 2: up/cam0/000000.jpg lies 22.2 m from up/cam1/000000.jpg" in note


def test_frames_without_a_position_are_named(one_pass: Survey, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("image,time\n" + "".join(f"{ALL[k]},{100 + 10 * k}\n" for k in range(6)))
    times = [*range(98, 111), *range(132, 141)]  # a gap about the frame at 120, and nothing after 140
    rows = "".join(f"{t},{35.69 + 1e-6 * t:.6f},139.77,40\n" for t in times)
    (tmp_path / "g.csv").write_text(f"{HEAD}\n{rows}")
    notes = one_pass.scan(gnss=tmp_path / "g.csv", times=tmp_path / "t.csv").notes
    (note,) = (n for n in notes if "have no position" in n)
    assert "5 of 8 frames" in note  # two have no time
    assert "up/cam0/000002.jpg, up/cam0/000003.jpg, up/cam0/000005.jpg and 2 more" in note


def test_images_that_no_row_names_are_said(one_pass: Survey, tmp_path: Path) -> None:
    notes = scan_gnss(one_pass, tmp_path, by_image(images=ALL[:3])).notes
    (note,) = (n for n in notes if "have no position" in n)
    assert "5 of 8 frames have no position: up/cam0/000003.jpg, " in note and "and 2 more" in note


@pytest.mark.parametrize("words, crs", [("UTM10N", "EPSG:32610"), ("utm zone 54 s", "EPSG:32754"), ("ENU", "ENU"),
                                        ("WGS84 UTM 1N", "EPSG:32601"), ("UTM61N", "UTM61N")])  # fmt: skip
def test_a_zone_by_its_name_is_its_code(words: str, crs: str) -> None:
    assert ScanSettings(crs=words).crs == crs


CANAL = Path(__file__).parents[2] / "examples" / "canal"
DAY = 1714521600.0  # 2024-05-01 0:00 UTC, a Wednesday: second 259218 of GPS week 2312
UNDULATION = 36.7
Table = list[tuple[float, float, float, float, float, float]]


class Canal(Survey):
    """The example, and its rows: time, lat, lon, height, sigma_h, sigma_v."""

    def __init__(self) -> None:
        super().__init__(CANAL / "images")
        lines = (CANAL / "gnss.csv").read_text().split()[1:]
        self.rows: Table = [tuple(float(v) for v in line.split(",")[:6]) for line in lines]  # type: ignore[misc]

    def placed(self, gnss: Path, times: Path) -> Scene:
        return self.scan(rig=str(CANAL / "rig.toml"), gnss=gnss, times=times)


@pytest.fixture(scope="module")
def canal() -> Canal:
    return Canal()


@pytest.fixture(scope="module")
def by_csv(canal: Canal) -> Scene:
    return canal.placed(CANAL / "gnss.csv", CANAL / "times.csv")


def iso(time: float, offset: float = 0.0) -> str:
    return (datetime.fromtimestamp(DAY, timezone.utc) + timedelta(seconds=round(time + offset, 3))).isoformat(
        timespec="milliseconds"
    )


def sentence(body: str) -> str:
    return f"${body}*{reduce(lambda a, c: a ^ ord(c), body, 0):02X}\r\n"


def nmea(rows: Table, dated: bool = True) -> str:
    out = []
    for time, lat, lon, height, flat, up in rows:
        clock = iso(time)[11:22].replace(":", "")
        south, east = (f"{int(v):0{d}d}{v % 1 * 60:010.7f}" for v, d in ((lat, 2), (lon, 3)))
        place = f"{south},N,{east},E"
        out += [sentence(f"GNRMC,{clock},A,{place},0,0,010524,,,A")] if dated else []
        out.append(sentence(f"GNGGA,{clock},{place},5,9,1.0,{height - UNDULATION:.4f},M,{UNDULATION},M,,"))
        out.append(sentence(f"GNGST,{clock},1,,,,{flat},{flat},{up}"))
    return "".join(out)


def solution(rows: Table) -> str:
    names = "latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m)"
    head = f"% (lat/lon/height=WGS84/ellipsoidal)\n%  GPST  {names}\n"
    clocks = [iso(r[0], 18.0)[:23].replace("-", "/").replace("T", " ") for r in rows]
    return head + "".join(
        f"{t} {a:.9f} {o:.9f} {h:.4f} 5 9 {s} {s} {u}\n" for t, (_, a, o, h, s, u) in zip(clocks, rows)
    )


def gpx(rows: Table) -> str:
    points = "".join(
        f'<trkpt lat="{a:.9f}" lon="{o:.9f}"><ele>{h}</ele><time>{iso(t)}</time></trkpt>\n' for t, a, o, h, _, _ in rows
    )
    return f'<?xml version="1.0"?><gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def sbet(rows: Table, ahead: float = 259218.0) -> bytes:
    return b"".join(
        struct.pack("<17d", t + ahead, np.radians(a), np.radians(o), h, *[0.0] * 13) for t, a, o, h, _, _ in rows
    )


def weeks(rows: Table) -> str:
    lines = [f"2312,{t + 259218:.2f},{a:.9f},{o:.9f},{h},{s},{u}\n" for t, a, o, h, s, u in rows]
    return "gps_week,gps_sow,lat,lon,height,sigma_h,sigma_v\n" + "".join(lines)


# Of each kind of clock one: the places and times of every format are those of tests/scene/test_gnss_formats.py.
FORMATS: dict[str, tuple[Callable[[Table], str | bytes], str, bool]] = {
    "nmea": (nmea, "dates", True),
    "nmea by the frames' day": (lambda rows: nmea(rows, dated=False), "dates", True),
    "rtklib": (solution, "dates", True),
    "sbet": (sbet, "dates", False),
    "sbet by the week": (lambda rows: sbet(rows, 0.0), "seconds", False),
}


def times_file(folder: Path, kind: str) -> Path:
    if kind == "seconds":
        return CANAL / "times.csv"
    lines = [line.split(",") for line in (CANAL / "times.csv").read_text().split()[1:]]
    path = folder / "times.csv"
    path.write_text("pass,frame,time\n" + "".join(f"{p},{f},{iso(float(t))}\n" for p, f, t in lines))
    return path


def written(folder: Path, data: str | bytes) -> Path:
    path = folder / "positions"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_every_clock_gives_the_places_of_the_csv(canal: Canal, by_csv: Scene, tmp_path: Path, name: str) -> None:
    write, kind, sigma = FORMATS[name]
    found = canal.placed(written(tmp_path, write(canal.rows)), times_file(tmp_path, kind))
    placed = np.isfinite(by_csv.world_from_rig[:, 0, 3])
    assert placed.sum() > 5 and (~placed).sum() > 5  # the outage below the bridge stays
    assert found.origin.crs == by_csv.origin.crs and found.origin.shift_m == by_csv.origin.shift_m
    # A millimetre is the rounding of the formats; times of 1.7e9 s are rounded to 0.2 us.
    np.testing.assert_allclose(found.world_from_rig[:, :3, 3], by_csv.world_from_rig[:, :3, 3], rtol=0, atol=1e-3)
    if sigma:
        np.testing.assert_allclose(found.position_sigma_m, by_csv.position_sigma_m, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nmea by the frames' day", "sbet", "rtklib"])
def test_georef_reads_the_rows_on_the_frames_clock(canal: Canal, tmp_path: Path, name: str) -> None:
    write, kind, _ = FORMATS[name]
    path = written(tmp_path, write(canal.rows))
    scene = canal.placed(path, times_file(tmp_path, kind))
    run = SimpleNamespace(inputs=SimpleNamespace(gnss=path, times=tmp_path), settings=Settings())
    rows = _rows(run, scene)  # type: ignore[arg-type]
    np.testing.assert_allclose(rows.time_s, DAY + np.array([r[0] for r in canal.rows]), rtol=0, atol=1e-6)


def since_1980(rows: Table) -> str:
    return "time,lat,lon,height\n" + "".join(f"{DAY + 18 - 315964800 + t},{a},{o},{h}\n" for t, a, o, h, *_ in rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    "data, kind, words",
    [
        (lambda rows: sbet(rows, 0.0), "dates", r"do not overlap"),
        (sbet, "seconds", r"it has seconds of the GPS week without a date: give the frames' times"),
        (lambda rows: gpx([(r[0] - 9 * 3600, *r[1:]) for r in rows]), "dates", r"-9 h would match .* in local time\?"),
        (lambda rows: weeks(rows).replace("gps_week,gps_sow", "unit,time"), "dates", "do not overlap"),
        (since_1980, "dates", r"look like seconds since 1980 \(GPS\): name the column gps_seconds"),
    ],
)
def test_a_wrong_scale_is_refused(canal: Canal, tmp_path: Path, data: Callable, kind: str, words: str) -> None:
    with refused(words, "positions"):
        canal.placed(written(tmp_path, data(canal.rows)), times_file(tmp_path, kind))


# --- DJI's MRK: by number -------------------------------------------------------------------------------------------


def mrk(count: int) -> str:
    return "".join(
        f"{k}\t{300000 + 2 * k}.5\t[2312]\t-15,N\t4,E\t192,V\t{35.69 + 1e-5 * k:.8f},Lat\t139.77,Lon\t60.000,Ellh\t"
        "0.011, 0.012, 0.021\t50,Q\n"
        for k in range(1, count + 1)
    )


def drone(folder: Path, names: Sequence[str]) -> Path:
    for name in names:
        picture(folder / name, exif=exif_of(make="DJI", time="2024:05:01 12:00:00"))
    return folder


@pytest.mark.parametrize("name", ["DJI_{:04d}.JPG", "DJI_20240501120000_{:04d}_V.JPG", "100_0003_{:04d}.JPG"])
def test_an_mrk_names_its_images_by_number(tmp_path: Path, name: str) -> None:
    images = drone(tmp_path / "in", [name.format(k) for k in range(1, 5)])
    (tmp_path / "a.MRK").write_text(mrk(5))
    scene = scan(images, gnss=tmp_path / "a.MRK")
    assert np.diff(scene.world_from_rig[:, 1, 3]) == pytest.approx([1.109] * 3, abs=0.002)
    np.testing.assert_allclose(scene.position_sigma_m, [[0.012, 0.011, 0.021]] * 4)
    assert any("1 rows name images that are not here, such as #5 (line 5)" in n for n in scene.notes)


def test_an_mrk_of_two_flights_is_refused(tmp_path: Path) -> None:
    images = drone(tmp_path / "in", [f"{f}/DJI_{k:04d}.JPG" for f in ("one", "two") for k in range(1, 4)])
    (tmp_path / "a.MRK").write_text(mrk(3))
    with refused("a.MRK, line 1: image 1 can be one/DJI_0001.JPG or two/DJI_0001.JPG: give the"):
        scan(images, ScanSettings(layout="loose"), gnss=tmp_path / "a.MRK")


# --- DJI's XMP ------------------------------------------------------------------------------------------------------


def rtk_picture(path: Path, k: int, flag: int = 50, sigma: float = 0.012, element: bool = False) -> None:
    """A JPEG of a drone with RTK: EXIF rounded to a metre, XMP exact."""
    lat, lon = 35.69 + 1e-5 * k, 139.77
    tags = {"GpsLatitude": f"+{lat:.9f}", "GpsLongitude": f"+{lon:.9f}", "AbsoluteAltitude": "+61.250", "RtkFlag": flag,
            "RtkStdLon": sigma, "RtkStdLat": sigma / 2, "RtkStdHgt": 2 * sigma}  # fmt: skip
    attributes = "" if element else " ".join(f'drone-dji:{n}="{v}"' for n, v in tags.items())
    elements = "".join(f"<drone-dji:{n}>{v}</drone-dji:{n}>" for n, v in tags.items()) if element else ""
    xmp = (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF>'
        '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
        f"{attributes}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    picture(path, exif=exif_of(make="DJI", lat=round(lat, 4), lon=lon, alt=60.0), xmp=xmp.encode())


@pytest.mark.parametrize("element", [False, True])
def test_positions_of_a_drone_with_rtk(tmp_path: Path, element: bool) -> None:
    for k in range(4):
        rtk_picture(tmp_path / f"DJI_{k:04d}.JPG", k, element=element)
    scene = scan(tmp_path)
    assert scene.prior == "exif"
    assert np.diff(scene.world_from_rig[:, 1, 3]) == pytest.approx([1.109] * 3, abs=0.002)
    np.testing.assert_allclose(scene.position_sigma_m, [[0.012, 0.012, 0.024]] * 4)


def test_positions_of_a_drone_without_a_fix_are_those_of_exif(tmp_path: Path) -> None:
    for k in range(4):
        rtk_picture(tmp_path / f"DJI_{k:04d}.JPG", 100 * k, flag=0 if k % 2 else 16, sigma=0.012 if k % 2 else 1e5)
    scene = scan(tmp_path)
    assert np.all(scene.position_sigma_m[:, 0] == ScanSettings().gnss_sigma_m)
    assert scene.world_from_rig[0, 2, 3] + scene.origin.shift_m[2] == pytest.approx(60.0)  # type: ignore[union-attr]


RTK, FLOAT = "gnss.csv", "gnss_float.csv"
OUTAGES_S = {RTK: ((36003.6, 36008.4), (36250.6, 36255.4)), FLOAT: ((36003.8, 36007.8), (36251.4, 36255.2))}


@pytest.fixture(scope="module", params=[RTK, FLOAT], ids=["rtk", "float"])
def placed(request):
    """The name of a file, the scene with its positions, and how far it puts the true model from where it is, (N, 3)."""
    name = request.param
    given = {"rig": str(CANAL / "rig.toml"), "gnss": CANAL / name, "times": CANAL / "times.csv"}
    scene = scan(CANAL / "images", **given)
    model = read_model(CANAL / "truth" / "colmap")
    gnss = read_gnss(CANAL / name)
    rows = PositionRows(gnss.time_s, world_from_geodetic(gnss.lat_lon_height, scene.origin), gnss.sigma_m)
    found = georeference(model, scene, GeorefSettings(), Tuning().world, Measurements(rows=rows))
    inside = np.linalg.inv(image_poses(model, scene))[:, :3, 3]
    truth = geodetic_from_world(inside, make_origin(35.6965, 139.7695, 37.0, "ENU"))
    return name, scene, found.world_from_model(inside) - world_from_geodetic(truth, scene.origin)


@pytest.mark.slow
def test_frames_without_a_fix_under_the_bridge_stay_without(placed) -> None:
    name, scene, _ = placed
    known = np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1)
    under = np.any([(first < scene.time_s) & (scene.time_s < last) for first, last in OUTAGES_S[name]], axis=0)
    assert not known[under].any() and known.sum() == 10 and under.sum() == (10 if name == RTK else 8)
    assert name == FLOAT or known[~under].all(), "the poor one ends before the last frames"


@pytest.mark.slow
def test_the_true_model_is_placed_as_well_as_the_receiver_is_good(placed) -> None:
    name, _, off = placed
    rmse = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert (0.003 < rmse < 0.05) if name == RTK else (0.2 < rmse < 3.0), rmse
