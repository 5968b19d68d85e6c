"""Tables in the layouts of the programs that write them, and as people change them: the right places, or an error."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from said import refused, says
from tiegraph.scene.gcp import SIGMA_M, GcpFile, read_gcps, read_points
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.gnss.fixes import Gnss
from tiegraph.scene.pairs import pair_lines
from tiegraph.scene.posefile import read_poses
from tiegraph.scene.table import read_table

LLH = [[46.5, 126.25, 539.9], [46.50001, 126.25002, 540.4]]  # what all tables below say, where they are of degrees
EAST_NORTH = [[288991.4543, 5153277.9239], [288993.0276, 5153278.9816]]  # the same in EPSG:32652


OFF = np.array([2e-9, 2e-9, 1e-3])


def gnss(folder: Path, text: str | bytes) -> Gnss:
    path = folder / "g.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_gnss(path)


def control(folder: Path, text: str | bytes, marks: str = "") -> GcpFile:
    path = folder / "c.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    if not marks:
        return read_points(path)
    (folder / "m.txt").write_text(marks)
    return read_gcps(path, folder / "m.txt")


GEOGCS = (
    'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]]'
)
WKT = (
    f'PROJCS["WGS 84 / UTM zone 52N",{GEOGCS},PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",129],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],'
    'PARAMETER["false_northing",0],UNIT["metre",1]]'
)
BY_IMAGE = {
    "Pix4D, no header": "I 1.JPG,46.5,126.25,539.9,0.02,0.04\nI 2.JPG,46.50001,126.25002,540.4,0.02,0.04\n",
    "Pix4Dmatic with angles": "I 1.JPG,46.5,126.25,539.9,38.6,-89,8.3,0.02,0.04\n"
    "I 2.JPG,46.50001,126.25002,540.4,38.6,-89,8.3,0.02,0.04\n",
    "lon before lat, tabs": "I 1.JPG\t126.25\t46.5\t539.9\nI 2.JPG\t126.25002\t46.50001\t540.4\n",
    "Metashape": "#CoordinateSystem: " + GEOGCS + "\n#Label,X/Longitude,Y/Latitude,Z/Altitude,Accuracy_X/Y_(m),"
    "Accuracy_Z_(m),Yaw,Pitch,Roll,Error_(m),X_error,Y_error,Z_error,Error_(deg)\n"
    "I 1.JPG,126.25,46.5,539.9,0.02,0.04,38,-89,0,1,1,1,1,2\n"
    "I 2.JPG,126.25002,46.50001,540.4,0.02,0.04,38,-89,0,1,1,1,1,2\n",
    "Metashape in a grid": f"#CoordinateSystem: {WKT}\n#Label,X/Easting,Y/Northing,Z/Altitude\n"
    + "".join(f"I {k + 1}.JPG,{e},{n},{LLH[k][2]}\n" for k, (e, n) in enumerate(EAST_NORTH)),
    "exiftool -csv": "SourceFile,GPSLatitude,GPSLongitude,GPSAltitude,GPSLatitudeRef\n"
    "I 1.JPG,\"46 deg 30' 0.00\"\" N\",\"126 deg 15' 0.00\"\" E\",539.9 m Above Sea Level,North\n"
    "I 2.JPG,\"46 deg 30' 0.036\"\" N\",\"126 deg 15' 0.072\"\" E\",540.4 m Above Sea Level,North\n",
    "Mission Planner": "#name longitude/X latitude/Y height/Z yaw pitch roll SAlt\n"
    "I_1.JPG 126.25 46.5 539.9 38 -1 2 100\nI_2.JPG 126.25002 46.50001 540.4 38 -1 2 100\n",
    "ODM geo.txt, tabs": "EPSG:4326\nI 1.JPG\t126.25\t46.5\t539.9\nI 2.JPG\t126.25002\t46.50001\t540.4\n",
    "German": "Bild;Breite;Länge;Höhe\nI 1.JPG;46,5;126,25;539,9\nI 2.JPG;46,50001;126,25002;540,4\n",
    "French": "image;Latitude;Longitude;Altitude (m)\n"
    "I 1.JPG;46,5;126,25;539,9\nI 2.JPG;46,50001;126,25002;540,4\n",
    "Spanish": "imagen;latitud;longitud;altura\nI 1.JPG;46,5;126,25;539,9\nI 2.JPG;46,50001;126,25002;540,4\n",
    "Italian": "foto\tlatitudine\tlongitudine\tquota\n"
    "I 1.JPG\t46,5\t126,25\t539,9\nI 2.JPG\t46,50001\t126,25002\t540,4\n",
    "Japanese": "画像,緯度,経度,楕円体高\nI 1.JPG,46.5,126.25,539.9\nI 2.JPG,46.50001,126.25002,540.4\n",
    "feet at the end of the name": "photo,lat,long,alt_ft\n"
    "I 1.JPG,46.5,126.25,1771.3255\nI 2.JPG,46.50001,126.25002,1772.9659\n",
    "the unit in a column": "photo,lat,long,alt,alt_unit\nI 1.JPG,46.5,126.25,1771.3255,ft\n"
    "I 2.JPG,46.50001,126.25002,1772.9659,ft\n",
    "Excel's sep, an empty first cell, minutes": "sep=;\n;image;lat;lon;height (MSL)\n"
    ";I 1.JPG;46°30'0,000\"N;126°15'E;539,9\n"
    ";I 2.JPG;46°30'0,036\"N;126°15'0,072\"E;540,4\n",
    "tabs before all, and an index": "\t\timage\tlat\tlon\taltitude_msl\n\t0\tI 1.JPG\t46.5\t126.25\t539.9\n"
    "\t1\tI 2.JPG\t46.50001\t126.25002\t540.4\n",
    "a flight log": "utc,timestamp,lat,lon,alt_msl,image\n2026-01-13 03:05:44+00:00,1,46.5,126.25,539.9,I 1.JPG\n"
    "2026-01-13 03:05:47+00:00,2,46.50001,126.25002,540.4,I 2.JPG\n",
    "blank lines, trailing delimiters, quotes": "\n\nimage,lat,lon,height,\n\n\"I 1.JPG\",46.5,126.25,539.9,\n"
    "# a pause\n\nI 2.JPG,46.50001,126.25002,540.4,\n,,,,\n",
}  # fmt: skip


@pytest.mark.parametrize("name", BY_IMAGE)
def test_positions_of_images(tmp_path: Path, name: str) -> None:
    found = gnss(tmp_path, BY_IMAGE[name])
    assert np.all(np.abs(found.lat_lon_height - LLH) <= OFF), found.lat_lon_height
    assert [n.replace("_", " ") for n in found.names] == ["I 1.JPG", "I 2.JPG"]
    if "0.04" in BY_IMAGE[name]:
        np.testing.assert_allclose(found.sigma_m, [[0.02, 0.02, 0.04]] * 2)
    assert says(found.notes, "heights above the sea, used unchanged") == ("msl" in BY_IMAGE[name].lower())
    assert np.isnan(found.heading_deg).all() == (name != "Mission Planner")


@pytest.mark.parametrize(
    "text",
    [
        "time,lat,lon,height,sigma\n10,35,139,40,0.1\n11,35.001,139.001,41,0.1\n",
        "Time (s);Latitude [deg];Longitude [deg];Altitude (m);Accuracy\n10;35;139;40;0.1\n11;35.001;139.001;41;0.1\n",
        "# made by a receiver\n# t lat long elevation sigma_m\n10 35 139 40 0.1\n11 35.001 139.001 41 0.1\n",
        "\ufefftimestamp\tlat_deg\tlng\talt\tstd\n10\t35\t139\t40\t0.1\n\n11\t35.001\t139.001\t41\t0.1\n",
        "q,height,lon,lat,time,sigma_h,sigma_v\n1,40,139,35,1970-01-01T00:00:10Z,0.1,0.2\n"
        "1,41,139.001,35.001,1970-01-01 00:00:11.0,0.1,0.2\n",
        "date,time,lat,lon,height,sde,sdn,sdu\n1970/01/01,00:00:10.0,35,139,40,.1,.1,.2\n"
        "1970/01/01,00:00:11.0,35.001,139.001,41,.1,.1,.2\n",
    ],
)  # fmt: skip
def test_tables_of_many_shapes(tmp_path: Path, text: str) -> None:
    found = gnss(tmp_path, text)
    assert found.time_s.tolist() == [10, 11]
    assert found.lat_lon_height.tolist() == [[35, 139, 40], [35.001, 139.001, 41]]
    assert found.sigma_m == pytest.approx(np.array([[0.1, 0.1, 0.2]] * 2))
    assert len(found.notes) == 1 and found.notes[0].startswith("g.txt: columns read: ")
    assert ("; passed over: q" in found.notes[0]) == (text[0] == "q")


@pytest.mark.parametrize(
    "text",
    [
        "image,lat,lat_ref,lon,lon_ref,height\na.jpg,33.5,S,70.25,W,40\n",
        "image,lat,n/s,lon,e/w,alt\na.jpg,33.5,s,70.25,w,40\n",
        "SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\n"
        "a.jpg,\"33 deg 30' 0.00\"\" S\",\"70 deg 15' 0.00\"\" W\",40\n",
        "image;lat;lon;height\na.jpg;S33.5;70.25 W;40\n",
        "image;lat;lon;height\na.jpg;33°30'0\"S;70°15'W;40\n",
    ],
)  # fmt: skip
def test_the_half_of_the_earth_may_be_a_letter(tmp_path: Path, text: str) -> None:
    found = gnss(tmp_path, text)
    assert found.lat_lon_height == pytest.approx(np.array([[-33.5, -70.25, 40.0]]))
    assert len(found.notes) == 1 and "passed over" not in found.notes[0]


def test_lengths_have_the_unit_of_their_header(tmp_path: Path) -> None:
    found = gnss(tmp_path, "image,lat,lon,height (ft),sigma_h (mm),sigma_v (cm)\na.jpg,33.5,70.25,100,12,3\n")
    assert found.lat_lon_height[0, 2] == pytest.approx(30.48)
    assert "height [ft], sigma_h [mm] (horizontal sigma), sigma_v [cm] (vertical sigma)" in found.notes[0]
    assert found.sigma_m == pytest.approx(np.array([[0.012, 0.012, 0.03]]))


@pytest.mark.parametrize(("pitch", "heading"), [(-90, np.nan), (4, 120), (359.5, 120)])
def test_the_yaw_of_a_tilted_camera_is_no_heading(tmp_path: Path, pitch: float, heading: float) -> None:
    found = gnss(tmp_path, f"image,lat,lon,height,yaw,pitch,roll\na.jpg,33.5,70.25,40,120,{pitch},0\n")
    np.testing.assert_equal(found.heading_deg, [heading])
    said = "yaw, pitch, roll: cameras tilted by up to 90 degrees: these angles are not used"
    assert (said in found.notes[0]) == (pitch == -90)


def test_rows_that_cannot_be_used_are_left_out_with_their_lines(tmp_path: Path) -> None:
    rows = "3,35,139,1\n1,35,139,2\n2,,139,3\n2,95,139,3\n2,0,0,0\n1,35,139,9\nx,35,139,1\n"
    found = gnss(tmp_path, f"time,lat,lon,height\n{rows}")
    assert found.time_s.tolist() == [1, 3] and found.lat_lon_height[:, 2].tolist() == [2, 1]
    assert says(found.notes, r"4 of 7 rows left out.*\(line 4, 5, 6, 8\)")
    assert says(found.notes, "not in time order") and says(found.notes, "1 rows have the time")
    assert gnss(tmp_path, 'note,time,lat,lon,height\n"a, b",1,35,139,40\n"c",2,35,139,40\n').time_s.tolist() == [1, 2]


def test_positions_in_a_grid_of_feet_and_one_whose_x_is_north(tmp_path: Path) -> None:
    text = "# crs: EPSG:2263\nimage,easting,northing,height{}\na.jpg,984250,194305.3,{}\n"  # 40.7, -74.0
    for unit, height in (("", 100.0), (" (m)", 30.48006)):
        found = gnss(tmp_path, text.format(unit, height))
        np.testing.assert_allclose(found.lat_lon_height, [[40.7, -74.0, 30.48006]], rtol=0, atol=1e-4)
    notes = gnss(tmp_path, "# crs: EPSG:6677\nimage,x,y,z\na.jpg,-5000,-34000,3\n").notes
    assert says(notes, "IX is the northing, but x is read as the easting")


def test_control_in_degrees_of_the_southern_half(tmp_path: Path) -> None:
    text = "name,lat,lat_ref,lon,lon_ref,height\nA,33.5,S,70.25,W,40\n"
    assert control(tmp_path, text).points[0].xyz == (-33.5, -70.25, 40.0)
    with refused("column 'half' has halves of the Earth"):
        control(tmp_path, text.replace("lat_ref", "half"))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp932", "cp1252"])
def test_localised_headers_in_the_encodings_of_windows(tmp_path: Path, encoding: str) -> None:
    text = BY_IMAGE["Japanese" if encoding == "cp932" else "German"]
    found = gnss(tmp_path, text.encode(encoding))
    np.testing.assert_allclose(found.lat_lon_height, LLH, rtol=0, atol=1e-8)
    assert says(found.notes, "not UTF-8") == encoding.startswith("cp")
    widened = text.replace("\n", ";Genauigkeit\n", 1).replace("\n", ";0,02\n").replace("keit;0,02", "keit")
    if encoding != "cp932":
        assert gnss(tmp_path, widened.encode(encoding)).sigma_m[:, :2] == pytest.approx(np.full((2, 2), 0.02))


NOON = 1714564800.0  # 2024-05-01 12:00:00 UTC, second 302418 of GPS week 2312
BY_TIME = {
    "gpsbabel unicsv": "No,Latitude,Longitude,Name,Altitude,Description,Date,Time\n"
    "1,46.5,126.25,\"TP1\",539.9,\"a, b\",2024/05/01,12:00:00\n"
    "2,46.50001,126.25002,\"TP2\",540.4,\"\",2024/05/01,12:00:01\n",
    "Inertial Explorer": "Project:     a\nProgram:     Inertial Explorer\n\n"
    "  Week  GPSTime  Latitude  Longitude  H-Ell  SDEast  SDNorth  SDHeight  Q\n"
    "(weeks)  (sec)  (deg)  (deg)  (m)  (m)  (m)  (m)\n"
    "2312 302418.0 46.5 126.25 539.9 0.01 0.02 0.03 1\n2312 302419.0 46.50001 126.25002 540.4 0.01 0.02 0.03 1\n",
    "ArduPilot CAM": "TimeUS,I,Img,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt\n"
    "5000000,0,1,302418000,2312,46.5,126.25,539.9,100,539\n"
    "6000000,0,2,302419000,2312,46.50001,126.25002,540.4,100,540\n",
    "Bad Elf": "LINE,DATE_TIME_UTC,LATITUDE,LONGITUDE,ELLIPSOIDAL_HEIGHT,ELEVATION_MSL,H_RMS,V_RMS\n"
    "1,2024-05-01T12:00:00Z,46.5,126.25,539.9,500,0.01,0.03\n"
    "2,2024-05-01T12:00:01Z,46.50001,126.25002,540.4,501,0.01,0.03\n",
    "German dates": "Datum;Uhrzeit;Breite;Länge;Höhe\n01.05.2024;12:00:00,0;46,5;126,25;539,9\n"
    "01.05.2024;12:00:01,0;46,50001;126,25002;540,4\n",
    "thousands": "unix_time;lat;lon;height\n"
    "1.714.564.800,0;46,5;126,25;539,9\n1.714.564.801,0;46,50001;126,25002;540,4\n",
}  # fmt: skip


@pytest.mark.parametrize("name", BY_TIME)
def test_positions_at_times(tmp_path: Path, name: str) -> None:
    found = gnss(tmp_path, BY_TIME[name])
    assert np.all(np.abs(found.lat_lon_height - LLH) <= OFF), found.lat_lon_height
    np.testing.assert_allclose(found.time_s, [NOON, NOON + 1], rtol=0, atol=1e-6)
    if name == "Inertial Explorer":
        np.testing.assert_allclose(found.sigma_m, [[0.01, 0.02, 0.03]] * 2)


WRONG = [
    ("time,lat,height\n1,2,3\n", "no column lon; found: time, lat, height"),
    ("lat,lon,height\n1,2,3\n", r"no column time \(or image\)"),
    ("1,2,3,4\n5,6,7,8\n", "line 1: neither a header nor .* such as time,lat,lon,height"),
    ("time,lat,lon,height\n1,nan,2,3\n", "none of 1 rows"),
    ("image,lat,lat_ref,lon,height\na.jpg,33.5,E,70.25,40\n", "g.txt, line 2: lat_ref 'E' is not N or S"),
    ("a.jpg,46.5,6.5,539.9\nb.jpg,46.6,6.5,540\n", "line 1: neither a header nor .* such as .*image,lat,lon,height"),
    ("image,lat,lon,height\na.jpg;46,5;6,5;539,9\n", "none of 1 rows|fewer cells"),
    ("image;lat;lon;height\na.jpg;46.5;6.5;1,234\n", "line 2: '1,234' can be 1.234 or 1234: write numbers"),
    ("image,lat,lon,height (fathoms)\na.jpg,46.5,6.5,5\n", "column 'height' has lengths in 'fathoms': give m, cm"),
    ("image,lat,lon,height,half\na.jpg,46.5,6.5,5,S\n", r"column 'half' has halves of the Earth \(S\), .* lat_ref"),
    ("image,lat [gon],lon [gon],height\na.jpg,46.5,6.5,5\n", "column 'lat' is in gon: write degrees"),
]


@pytest.mark.parametrize(("text", "words"), WRONG)
def test_tables_that_may_be_two_things_are_refused(tmp_path: Path, text: str, words: str) -> None:
    with refused(words, "g.txt"):
        gnss(tmp_path, text)


@pytest.mark.parametrize("what", ["folder", "pipe", "device", "absent"])
def test_tables_that_are_no_files(tmp_path: Path, what: str) -> None:
    path = {"folder": tmp_path, "pipe": tmp_path / "p", "device": Path("/dev/zero"), "absent": tmp_path / "no"}[what]
    if what == "pipe":
        os.mkfifo(path)
    for read in (read_gnss, partial(read_table, purpose="GNSS file", example="time,lat")):
        with refused("is a folder|is no plain file|cannot be read", str(path), "give the GNSS file"):
            read(path)


ABOVE = "\ufeff# what a person writes above\n\n# more\fof it\n"  # a form feed ends no line in an editor
CONTROL = "name,x,y,z,image,px,py\nA,1,2,3,a.jpg,4,5\n\n# next\nB,1,2,WRONG,a.jpg,4,5\n"


@pytest.mark.parametrize(
    "read, text",
    [
        (read_gnss, "time,lat,lon,height\n1,35,139,4\n\n# a pause\n2,35,139,4,5 WRONG\n"),
        (read_gcps, CONTROL),
        (read_poses, "# time x y z qx qy qz qw\n1 0 0 0 0 0 0 1\n\n2 1 0 0 0 0 0 WRONG\n"),
        (pair_lines, "a.jpg b.jpg\n\n# and\na.jpg b.jpg WRONG\n"),
    ],
)
def test_every_table_counts_lines_as_an_editor_does(tmp_path: Path, read: Callable, text: str) -> None:
    (tmp_path / "table.txt").write_text(ABOVE + text, encoding="utf-8")
    line = next(k for k, words in enumerate((ABOVE + text).split("\n"), 1) if "WRONG" in words)
    with refused(rf"table.txt, line {line}:"):
        read(tmp_path / "table.txt")


def test_so_does_the_list_of_odm(tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text("EPSG:32654\n\n# two\n1 2 3 4 5 a.jpg\n1 2 3 WRONG 5 b.jpg\n")
    with refused(r"gcp_list.txt, line 5: 'WRONG' is no number"):
        read_gcps(tmp_path / "gcp_list.txt")


# --- control points -------------------------------------------------------------------------------------------------

EMLID = (
    "Name,Code,Code description,Easting,Northing,Elevation,Description,Longitude,Latitude,Ellipsoidal height,Origin,"
    "Tilt angle,Easting RMS,Northing RMS,Elevation RMS,Lateral RMS,Antenna height,Antenna height units,Solution status,"
    "Correction type,Averaging start,Averaging end,Samples,PDOP,Baseline,CS name\n"
    "P 1,GCP,,288991.454,5153277.924,501.2,,126.25,46.5,539.9,Global,,0.011,0.010,0.018,0.015,1.8,m,FIX,RTK,"
    "2024-05-01 12:00:00.0 UTC+00:00,2024-05-01 12:00:05.0 UTC+00:00,26,1.3,3400,WGS 84 / UTM zone 52N\n"
)


def test_emlid_degrees_with_the_height_above_the_ellipsoid(tmp_path: Path) -> None:
    found = control(tmp_path, EMLID, "name,image,px,py\nP 1,DJI 0001 (2).JPG,5,6\n")
    (point,) = found.points
    assert (point.name, point.xyz, point.sigma_m) == ("P 1", (46.5, 126.25, 539.9), (0.015, 0.015, 0.018))
    assert found.geographic and found.marks[0].image == "DJI 0001 (2).JPG"
    said = "\n".join(found.notes)
    assert "places by latitude, longitude and ellipsoidal height; for easting, northing and height put a line" in said
    assert "solution_status" in said and "tilt_angle" in said


@pytest.mark.parametrize("degrees", [True, False])
def test_emlid_in_its_grid(tmp_path: Path, degrees: bool) -> None:
    """By a line above the header, or where there are no degrees: then the file's own name of the grid counts."""
    text = "# crs: EPSG:32652\n" + EMLID if degrees else EMLID.replace("Longitude,Latitude", "a,b")
    found = control(tmp_path, text)
    assert found.points[0].xyz == (288991.454, 5153277.924, 501.2) and not found.geographic
    assert found.crs == "EPSG:32652"


IN_GRID = (288991.454, 5153277.924, 539.9)
POINTS = {
    "Trimble, Leica PNEZD": "# crs: EPSG:32652\nP 1,5153277.924,288991.454,539.9,IP\n"
    "P 2,5153278.98,288993.03,540,IP\n",
    "Leica, blanks": "# crs: EPSG:32652\nP1  5153277.924  288991.454  539.9\nP2  5153278.98  288993.03  540\n",
    "PENZ between tabs": "# crs: EPSG:32652\nP 1\t288991.454\t5153277.924\t539.9\nP 2\t288993.03\t5153278.98\t540\n",
    "PNEZD with a header": "# crs: EPSG:32652\nPoint,Northing,Easting,Elevation,Code\n"
    "P 1,5153277.924,288991.454,539.9,IP\n",
    "Pix4D with accuracies": "# crs: EPSG:32652\nP 1,288991.454,5153277.924,539.9,0.02,0.03\n",
    "Metashape": "# CoordinateSystem: EPSG:32652\n#Label,X/Easting,Y/Northing,Z/Altitude\n"
    "P 1,288991.454,5153277.924,539.9\n",
    "German": "# crs: EPSG:32652\nPunktnummer;Rechtswert;Hochwert;Höhe\nP 1;288.991,454;5.153.277,924;539,9\n",
    "Swiss groups": "# crs: EPSG:32652\nname;east;north;height\nP 1;288'991.454;5'153'277.924;539.9\n",
    "feet": "# crs: EPSG:32652\nname,east,north,height_ft\nP 1,288991.454,5153277.924,1771.3255\n",
}  # fmt: skip


@pytest.mark.parametrize("name", POINTS)
def test_lists_of_points(tmp_path: Path, name: str) -> None:
    point = control(tmp_path, POINTS[name]).points[0]
    assert point.name.replace("P1", "P 1") == "P 1" and point.xyz == pytest.approx(IN_GRID, abs=1e-4)
    assert point.sigma_m == ((0.02, 0.02, 0.03) if "Pix4D" in name else SIGMA_M)


@pytest.mark.parametrize(
    "text", ["1,5000.0,4000.0,100.0,IP\n", "# crs: EPSG:6677\n1,-34000,-5000,3,IP\n", "G1,46.2,6.5,300,0.02,0.03\n"]
)
def test_a_list_whose_order_nothing_tells_is_asked_for(tmp_path: Path, text: str) -> None:
    with refused(r"line \d: neither a header nor .*name,northing,easting,height,code"):
        control(tmp_path, text)


def test_a_grid_whose_x_is_north_is_said(tmp_path: Path) -> None:
    notes = control(tmp_path, "# crs: EPSG:6677\nname,x,y,z\nA,-5000,-34000,3\n").notes
    assert says(notes, "X of JGD2011 / Japan Plane Rectangular CS IX is the northing, but x is read as")
    other = control(tmp_path, "# crs: EPSG:6677\nname,easting,northing,z\nA,-5000,-34000,3\n").notes
    assert not says(other, "is the northing, but")


def test_coordinates_of_the_world_are_no_degrees(tmp_path: Path) -> None:
    assert control(tmp_path, "name,x,y,z\nA,389000,3951000,3\n").points[0].xyz == (389000, 3951000, 3)


@pytest.mark.parametrize(
    "text",
    [
        "# crs: EPSG:31467\nPunkt;x;y;z\nA;5932000,12;3567000,34;12,5\n",
        "EPSG:32652\n5153277.924 288991.454 5 1 2 a.jpg\n",
        "name,lat,lon,height\nA,139.7,35.6,3\n",
    ],
)
def test_exchanged_coordinates_are_found_in_the_file(tmp_path: Path, text: str) -> None:
    with refused(r"of point '.*' are exchanged \((northing,easting|lon,lat)\)"):
        control(tmp_path, text)


@pytest.mark.parametrize("rows", ["I 1.JPG,P 1,5.5,6.5\n", "P 1,I 1.JPG,5.5,6.5\n"])
def test_marks_without_a_header(tmp_path: Path, rows: str) -> None:
    (mark,) = control(tmp_path, EMLID, rows).marks
    assert (mark.name, mark.image, mark.xy) == ("P 1", "I 1.JPG", (5.5, 6.5))


def test_rows_behind_a_comment_sign_and_ends_of_names_are_said(tmp_path: Path) -> None:
    found = control(tmp_path, "# crs: EPSG:32652\nname,east,north,height\nP,1,2,3\n#Q,1,3,4\n# a word\n")
    assert any("c.txt, line 4: 1 rows begin with # or % and are passed over" in n for n in found.notes)
    with refused("line 2: the image 'I' has no suffix, but a later word has"):
        control(tmp_path, "EPSG:32652\n1 2 3 4 5 I 1.JPG P\n")
    quoted = control(tmp_path, 'EPSG:32652\n288991 5153277 3 4 5 "I 1.JPG" "P 1"\n')
    assert [(m.image, m.name) for m in quoted.marks] == [("I 1.JPG", "P 1")]


def test_bars_say_their_columns(tmp_path: Path) -> None:
    text = "from,to,length_mm,datum\nA,B,1200.5,x\n\nname,image,px,py\nA,1.jpg,5,6\nB,1.jpg,7,6\n"
    path = tmp_path / "c.txt"
    path.write_text(text)
    found = read_gcps(path)
    assert found.bars[0].length_m == pytest.approx(1.2005)
    (said,) = (n for n in found.notes if "length" in n)
    assert said.endswith("read: from, to, length_mm (length); passed over: datum")


# --- trajectories ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "times", "period"),
    [
        ("", ["604798", "604799", "0", "1"], 604800),
        ("# time x y z qx qy qz qw\n", ["86398", "86399", "0.0", "1.0"], 86400),
        ("utc x y z qx qy qz qw\n", ["23:59:58", "23:59:59", "00:00:00", "00:00:01"], 86400),
        ("gps_sow x y z qx qy qz qw\n", ["604798", "604799", "0", "1"], 604800),
    ],
)
def test_poses_go_on_after_midnight_and_saturday(tmp_path: Path, head: str, times: list[str], period: float) -> None:
    path = tmp_path / "a.tum"
    path.write_text(head + "".join(f"{t} {k} 0 0 0 0 0 1\n" for k, t in enumerate(times)))
    found = read_poses(path)
    assert found.period_s == period
    np.testing.assert_allclose(found.time_s, period - 2 + np.arange(4))
    np.testing.assert_allclose(found.poses[:, 0, 3], np.arange(4))


def test_a_trajectory_by_dates_in_millimetres(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(
        "time;x [mm];y [mm];z [mm];qx;qy;qz;qw;status\n2024-05-01T12:00:00;0;0;0;0;0;0;1;ok\n"
        "2024-05-01T12:00:01;1000,5;0;0;0;0;0;1;ok\n"
    )
    found = read_poses(path)
    np.testing.assert_allclose(found.time_s, [NOON, NOON + 1])
    assert found.poses[1, 0, 3] == pytest.approx(1.0005)
    assert says(found.notes, "passed over: status")


def test_every_program_of_the_reference_is_tested() -> None:
    text = (Path(__file__).parents[2] / "docs" / "inputs.md").read_text()
    rows = text[text.index("| program and its file") :].split("\n\n")[0].splitlines()[2:]
    tested = " ".join([*BY_IMAGE, *BY_TIME, *POINTS, "Emlid", "RTKLIB", "TUM"])  # the last two in tests of their own
    programs = [row.strip("| ").split()[0].strip(",") for row in rows]
    assert len(programs) > 12 and [p for p in programs if p not in tested] == []
