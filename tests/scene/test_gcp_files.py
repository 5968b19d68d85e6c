"""Control points as people write them: one table, two tables in one file, two files; what is missing is said with the
columns that are needed."""

from __future__ import annotations

from pathlib import Path

import pytest

from said import refused
from tiegraph.cli.main import main
from tiegraph.geometry.geodesy import make_origin
from tiegraph.scene.control import surveyed_world
from tiegraph.scene.gcp import GcpFile, read_gcps
from tiegraph.scene.tuning import ControlTuning

POINTS = "name,x,y,z,role\nA,10,20,3,gcp\nB,11,21,4,check\n"
MARKS = "name,image,px,py\nA,1.jpg,5,6\nB,2.jpg,7,8\nA,2.jpg,9,10\n"
COLUMNS = r"points need the columns name, x, y, z .*lat, lon, height.* marks name, image, px, py, .*--marks"


def _same(found: GcpFile) -> None:
    assert [(p.name, p.xyz, p.check) for p in found.points] == [("A", (10, 20, 3), False), ("B", (11, 21, 4), True)]
    assert [(m.name, m.image, m.xy) for m in found.marks] == [
        ("A", "1.jpg", (5, 6)), ("B", "2.jpg", (7, 8)), ("A", "2.jpg", (9, 10))
    ]  # fmt: skip
    assert all(" columns read: " in note for note in found.notes)


def _written(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize(
    "text",
    [
        POINTS + "\n" + MARKS,
        "# crs: EPSG:32654\n[points]\n" + POINTS + "\n[marks]\n" + MARKS,
        MARKS + POINTS,
        "Points:\n" + POINTS.replace(",", ";") + "Marks:\n" + MARKS.replace(",", "\t"),
        POINTS + MARKS.replace("name,image,px,py", "point,image,x,y"),
        POINTS.replace("x,y,z", "easting,northing,elevation") + MARKS.replace("px,py", "pixel_x,pixel_y"),
    ],
)
def test_two_tables_in_one_file(tmp_path: Path, text: str) -> None:
    found = read_gcps(_written(tmp_path, "gcp.csv", text), ControlTuning())
    _same(found)
    assert found.crs == ("EPSG:32654" if "crs" in text else None) and not found.geographic


def test_two_files_in_either_order(tmp_path: Path) -> None:
    points, marks = _written(tmp_path, "points.csv", POINTS), _written(tmp_path, "marks.csv", MARKS)
    for found in (read_gcps(points, ControlTuning(), marks), read_gcps(marks, ControlTuning(), points)):
        _same(found)
        assert (found.path, found.of_marks) == (points, marks)


def test_degrees_in_two_tables(tmp_path: Path) -> None:
    text = "name,lat,lon,height\nA,35.6,139.7,40\n" + "name,image,px,py\nA,1.jpg,5,6\n"
    found = read_gcps(_written(tmp_path, "gcp.csv", text), ControlTuning())
    assert found.geographic and found.points[0].xyz == (35.6, 139.7, 40.0) and len(found.marks) == 1


@pytest.mark.parametrize(
    "text, more, words",
    [
        (POINTS, None, r"gcp.csv: points, but no marks with a pixel in an image; " + COLUMNS),
        (MARKS, None, r"gcp.csv: marks, but no points with coordinates; " + COLUMNS),
        ("name,x,y\nA,1,2\n", None, r"gcp.csv: found the columns name, x, y; " + COLUMNS),
        ("A,10,20,3\n", None, r"line 1: no header says .*'A,10,20,3'; write .*name,northing,easting,height,code"),
        ("1 2 3 4 5 a.jpg\n", None, r"line 1: '1 2 3 4 5 a.jpg' is no coordinate system; .*header: " + COLUMNS),
        ("", None, r"gcp.csv: the file is empty; " + COLUMNS),
        (POINTS, "name,image,px,py\nC,1.jpg,5,6\n", r"marks.csv, line 2: a mark of point 'C', which .* in gcp.csv"),
        (POINTS, "name,image,px,py\nA,1.jpg,five,6\n", r"marks.csv, line 2: 'five' is no number"),
        (POINTS + MARKS, MARKS, r"both hold marks; leave --marks away"),
        (POINTS, POINTS, r"both hold points"),
        (POINTS + "name,lat,lon,height\nC,35,139,4\n" + MARKS, None, "by x, y, z in one table and by lat, lon"),
        (POINTS + MARKS.replace("B,2.jpg,7,8", "B,2.jpg,,8"), None, "line 6: '' is no number"),
    ],
)
def test_what_is_missing_is_said_with_the_columns(tmp_path: Path, text: str, more: str | None, words: str) -> None:
    marks = None if more is None else _written(tmp_path, "marks.csv", more)
    with refused(words):
        read_gcps(_written(tmp_path, "gcp.csv", text), ControlTuning(), marks)


def test_the_list_of_odm_is_read_as_ever(tmp_path: Path) -> None:
    rows = "494399.2 4232697.1 5 124.88 596.25 IMG_6785.jpg\n494399.2 4232697.1 5 284.25 636.75 IMG_6786.jpg\n"
    found = read_gcps(_written(tmp_path, "gcp_list.txt", "WGS84 UTM 54N\n" + rows), ControlTuning())
    assert found.crs == "EPSG:32654" and len(found.points) == 1 and len(found.marks) == 2
    assert found.points[0].xyz == (494399.2, 4232697.1, 5.0)
    degrees = _written(tmp_path, "gcp_list.txt", "WGS84\n139.76 35.69 40 10.5 20 a.jpg\n")
    assert read_gcps(degrees, ControlTuning()).points[0].xyz == (35.69, 139.76, 40.0)


@pytest.mark.slow
def test_names_in_a_list_of_tabs_may_have_blanks(tmp_path: Path) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text("EPSG:32654\n389000\t3951000\t10\t5\t6\tDJI 0001 (2).JPG\tpoint one\n")
    file = read_gcps(path, ControlTuning())
    assert [(m.image, m.name) for m in file.marks] == [("DJI 0001 (2).JPG", "point one")]


def test_marks_without_points_are_refused_before_anything_is_made(tmp_path: Path, capsys) -> None:
    (tmp_path / "in").mkdir()
    marks = _written(tmp_path, "marks.csv", MARKS)
    assert main(["run", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--marks", str(marks)]) == 2
    assert "marks of no points; give the points by --gcp" in capsys.readouterr().err
    assert main(["run", "--help-all"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "points (name, x, y, z or name, lat, lon, height)" in said and "--marks" in said


def test_targets_need_no_marks_and_bars_stand_in_a_table_of_their_own(tmp_path: Path) -> None:
    text = "name,x,y,z\ntag36h11:3,10,20,3\n[scale bars]\nfrom,to,length (mm),sigma (mm),role\n"
    text += "tag36h11:3,4x4_50:7,1200.5,0.05,\ntag36h11:3,4x4_50:8,800,,check\n"
    found = read_gcps(_written(tmp_path, "gcp.csv", text), ControlTuning())
    assert [p.name for p in found.points] == ["tag36h11:3"] and not found.marks and len(found.targets) == 3
    first, second = found.bars
    assert first.ends == ("tag36h11:3", "4x4_50:7")
    assert (first.length_m, first.sigma_m) == pytest.approx((1.2005, 5e-5))
    assert second.check and second.sigma_m == ControlTuning().bar_sigma_m and second.line == 6
    bars = "from,to,length\nA,B,1.5\nname,image,px,py\nA,1.jpg,5,6\nB,1.jpg,7,6\n"
    alone = read_gcps(_written(tmp_path, "bars.csv", bars), ControlTuning())
    assert not alone.points and alone.bars[0].length_m == 1.5 and len(alone.marks) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,x,y,z\ntag16h5:30,1,2,3\n", r"gcp.csv, line 2: target 'tag16h5:30': that family has 30 targets"),
        ("name,x,y,z\ntag36h11:1,1,2,3\napriltag_36h11:01,1,2,4\n", "are one target: name it in one way only"),
        ("name,x,y,z\ntag36h12:1,1,2,3\n", "no marks with a pixel in an image.* such as tag36h11:12"),
        ("from,to,length\ntag36h11:1,A,1\n", r"line 2: the end 'A' of this bar is neither marked nor a coded target"),
        ("from,to,length\ntag36h11:1,tag36h11:2,1200.5\n", r"line 2: length = 1200.5: .* length \(mm\)"),
        ("from,to,length\ntag36h11:1,tag36h11:2,long\n", "line 2: length = long"),
        ("from,to,length,sigma\ntag36h11:1,tag36h11:2,1,2\n", "line 2: sigma = 2: .* below the length"),
        ("from,to,length\ntag36h11:1,tag36h11:1,1\n", "line 2: a scale bar needs two names that differ"),
        ("from,to,length (px)\ntag36h11:1,tag36h11:2,1\n", "lengths in 'px': give m, cm, mm or ft"),
        ("from,to,length\ntag36h11:1,tag36h11:2,1\ntag36h11:2,tag36h11:1,2\n", "line 3: the bar .* line 2 already"),
    ],
)
def test_wrong_targets_and_bars_say_where(tmp_path: Path, text: str, said: str) -> None:
    with refused(said):
        read_gcps(_written(tmp_path, "gcp.csv", text), ControlTuning())


def _points(path: Path, text: str) -> GcpFile:
    path.write_text(text + "\nname,image,px,py\nA,a.jpg,1,2\n")
    return read_gcps(path, ControlTuning())


def test_units_of_a_header_are_read(tmp_path: Path) -> None:
    """12 mm were read as 12 m, and feet as metres."""
    head = "# crs: EPSG:32654\nname,x,y,z (ft),sigma_xy (mm),sigma_z (cm)\nA,389000,3951000,100,12,3\n"
    (point,) = _points(tmp_path / "p.csv", head).points
    assert point.xyz == pytest.approx((389000.0, 3951000.0, 30.48))
    assert point.sigma_m == pytest.approx((0.012, 0.012, 0.03))


@pytest.mark.parametrize(("z", "metres"), [("z", 30.48006), ("z (m)", 100.0), ("z (ft)", 30.48)])
def test_heights_of_a_grid_in_feet(tmp_path: Path, z: str, metres: float) -> None:
    """EPSG:2263 counts in US survey feet, and so do heights that do not say otherwise."""
    file = _points(tmp_path / "p.csv", f"# crs: EPSG:2263\nname,x,y,{z}\nA,984250,194305.3,100\n")
    world = surveyed_world(file, make_origin(40.7, -74.0, 0.0))
    assert world[0, 2] == pytest.approx(metres, abs=1e-3) and abs(world[0, :2]).max() < 100
