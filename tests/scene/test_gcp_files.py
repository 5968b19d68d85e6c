"""Control points as people write them: one table, two tables in one file, two files; what is missing is said with the
columns that are needed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tiegraph.cli.main import main
from tiegraph.errors import InputError
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
    assert found.notes == ()


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
        ("A,10,20,3\n", None, r"line 1: 'A,10,20,3' is no coordinate system; .*header: " + COLUMNS),
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
    with pytest.raises(InputError, match=words):
        read_gcps(_written(tmp_path, "gcp.csv", text), ControlTuning(), marks)


def test_the_list_of_odm_is_read_as_ever(tmp_path: Path) -> None:
    rows = "494399.2 4232697.1 5 124.88 596.25 IMG_6785.jpg\n494399.2 4232697.1 5 284.25 636.75 IMG_6786.jpg\n"
    found = read_gcps(_written(tmp_path, "gcp_list.txt", "WGS84 UTM 54N\n" + rows), ControlTuning())
    assert found.crs == "EPSG:32654" and len(found.points) == 1 and len(found.marks) == 2
    assert found.points[0].xyz == (494399.2, 4232697.1, 5.0)


@pytest.mark.slow
def test_marks_without_points_are_refused_before_anything_is_made(tmp_path: Path, capsys) -> None:
    (tmp_path / "in").mkdir()
    marks = _written(tmp_path, "marks.csv", MARKS)
    assert main(["run", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--marks", str(marks)]) == 2
    assert "marks of no points; give the points by --gcp" in capsys.readouterr().err
    assert main(["run", "--help-all"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "points (name, x, y, z or name, lat, lon, height)" in said and "--marks" in said
