"""The example's own positions as every format: the places, sigmas and gaps that its CSV gives; its receivers."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta, timezone
from functools import reduce
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scan_worlds import Survey, exif_of, picture, scan

from said import refused
from tiegraph.geometry.geodesy import geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.pipeline.georef import _rows
from tiegraph.project.settings import Settings
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning as ScanTuning
from tiegraph.scene.colmapmodel import image_poses, read_model
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fixes import Measurements, PositionRows
from tiegraph.sfm.world.georef import georeference

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


def solution(rows: Table, scale: str = "GPST", ahead: float = 18.0) -> str:
    names = "latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m)"
    head = f"% (lat/lon/height=WGS84/ellipsoidal)\n%  {scale}  {names}\n"
    clocks = [iso(r[0], ahead)[:23].replace("-", "/").replace("T", " ") for r in rows]
    return head + "".join(
        f"{t} {a:.9f} {o:.9f} {h:.4f} 5 9 {s} {s} {u}\n" for t, (_, a, o, h, s, u) in zip(clocks, rows)
    )


def gpx(rows: Table) -> str:
    points = "".join(
        f'<trkpt lat="{a:.9f}" lon="{o:.9f}"><ele>{h}</ele><time>{iso(t)}</time></trkpt>\n' for t, a, o, h, _, _ in rows
    )
    return f'<?xml version="1.0"?><gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>'


def kml(rows: Table) -> str:
    whens = "".join(f"<when>{iso(r[0])}</when>" for r in rows)
    places = "".join(f"<gx:coord>{o:.9f} {a:.9f} {h}</gx:coord>" for _, a, o, h, _, _ in rows)
    return f'<kml xmlns:gx="http://www.google.com/kml/ext/2.2"><gx:Track>{whens}{places}</gx:Track></kml>'


def sbet(rows: Table, ahead: float = 259218.0) -> bytes:
    return b"".join(
        struct.pack("<17d", t + ahead, np.radians(a), np.radians(o), h, *[0.0] * 13) for t, a, o, h, _, _ in rows
    )


def weeks(rows: Table) -> str:
    lines = [f"2312,{t + 259218:.2f},{a:.9f},{o:.9f},{h},{s},{u}\n" for t, a, o, h, s, u in rows]
    return "gps_week,gps_sow,lat,lon,height,sigma_h,sigma_v\n" + "".join(lines)


FORMATS: dict[str, tuple[Callable[[Table], str | bytes], str, bool]] = {
    "nmea": (nmea, "dates", True),
    "nmea by the day": (lambda rows: nmea(rows, dated=False), "seconds", True),
    "nmea by the frames' day": (lambda rows: nmea(rows, dated=False), "dates", True),
    "rtklib": (solution, "dates", True),
    "rtklib utc": (lambda rows: solution(rows, "UTC", 0.0), "dates", True),
    "gpx": (gpx, "dates", False),
    "kml": (kml, "dates", False),
    "sbet": (sbet, "dates", False),
    "sbet by the week": (lambda rows: sbet(rows, 0.0), "seconds", False),
    "gps weeks": (weeks, "dates", True),
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


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_places_of_the_csv(canal: Canal, by_csv: Scene, tmp_path: Path, name: str) -> None:
    write, kind, sigma = FORMATS[name]
    found = canal.placed(written(tmp_path, write(canal.rows)), times_file(tmp_path, kind))
    placed = np.isfinite(by_csv.world_from_rig[:, 0, 3])
    assert placed.sum() > 5 and (~placed).sum() > 5  # the outage below the bridge stays
    assert found.origin.crs == by_csv.origin.crs and found.origin.shift_m == by_csv.origin.shift_m
    # A millimetre is the rounding of the formats; times of 1.7e9 s are rounded to 0.2 us.
    np.testing.assert_allclose(found.world_from_rig[:, :3, 3], by_csv.world_from_rig[:, :3, 3], rtol=0, atol=1e-3)
    if sigma:
        np.testing.assert_allclose(found.position_sigma_m, by_csv.position_sigma_m, rtol=1e-6)


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
    gnss = read_gnss(CANAL / name, ScanTuning().positions.gnss)
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
