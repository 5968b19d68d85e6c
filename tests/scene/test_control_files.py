"""Control points: tables in one file or two, ODM's list; what is wrong is said with file and line."""

from __future__ import annotations

import numpy as np
import pytest

from said import refused, says
from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import crs_coordinates, make_origin, vertical_note, world_from_geodetic
from tiegraph.scene.control import image_lookup, locate
from tiegraph.scene.gcp import read_gcps
from tiegraph.scene.names import found_by
from tiegraph.scene.rig import Rig, Sensor, Source, prepared_pixel
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.targets import BAR_SIGMA_M

import pycolmap  # isort: skip
from pathlib import Path

from tiegraph.cli.main import main
from tiegraph.scene.control import surveyed_world
from tiegraph.scene.gcp import GcpFile

ORIGIN = make_origin(35.6965, 139.7695, 40.0)


CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=100, height=80, params=[80, 50, 40])


def _scene(positions: bool = True, camera: pycolmap.Camera | None = None, source: Source | None = None) -> Scene:
    """Four images, 100 x 80 pixels where they have a camera."""
    names = [f"a/{k:03d}.jpg" for k in range(4)]
    scene = simple_scene(Rig("lone", (Sensor("cam", camera, source=source),)), names, np.arange(4), np.zeros(4))
    if not positions:
        return scene
    poses = np.full((4, 4, 4), np.nan)
    poses[:, :3, 3] = world_from_geodetic(np.tile([35.6965, 139.7695, 40.0], (4, 1)), ORIGIN)
    return scene.with_(world_from_rig=poses, origin=ORIGIN, prior="gnss", position_sigma_m=np.full((4, 3), 0.05))


def _odm(tmp_path, lines: str, first: str = "EPSG:32654"):
    return control(tmp_path, f"{first}\n{lines}", "gcp_list.txt")


EAST, NORTH, _ = crs_coordinates(np.zeros(3), ORIGIN)


def test_odm_list_with_and_without_names(tmp_path) -> None:
    rows = f"{EAST} {NORTH} 3 10.5 20 000.jpg\n{EAST} {NORTH} 3 11 21 001.jpg\n{EAST + 5} {NORTH} 4 1 2 a/002.jpg\n"
    found = _odm(tmp_path, rows, "WGS84 UTM 54N")
    assert [p.name for p in found.points] == ["point 1", "point 2"] and len(found.marks) == 3
    placed = locate(found, _scene())
    np.testing.assert_allclose(placed.world_m[1] - placed.world_m[0], [5, 0, 1], atol=1e-6)
    np.testing.assert_array_equal(placed.marks.image, [0, 1, 2])
    assert any("EPSG:32654" in n and "ellipsoid" in n for n in placed.notes)


def test_images_are_named_in_any_case_where_that_is_unique() -> None:
    names = ["a/IMG_1.JPG", "a/IMG_2.JPG", "b/img_2.jpg"]
    scene = simple_scene(Rig("lone", (Sensor("cam"),)), names, np.arange(3), np.zeros(3))
    lookup = image_lookup(scene)
    asked = ("img_1.jpg", "A\\Img_1.jpg", "a/img_1.JPG", "IMG_2.JPG", "img_2.jpg", "Img_2.jpg", "IMG_3.JPG")
    assert [found_by(lookup, name) for name in asked] == [0, 0, 0, 1, 2, None, None]


def test_csv_of_points_and_marks_with_roles(tmp_path) -> None:
    rows = f"A,{EAST},{NORTH},1,0.01,0.02,gcp,,,\nB,{EAST + 2},{NORTH},1,,,check,,,\n"
    rows += "A,,,,,,,000.jpg,5,6\nB,,,,,,,001.jpg,7,8\n"
    placed = locate(control(tmp_path, HEAD + rows), _scene())
    assert placed.names == ("A", "B")
    np.testing.assert_array_equal(placed.check, [False, True])
    np.testing.assert_allclose(placed.sigma_m, [[0.01, 0.01, 0.02], [0.02, 0.02, 0.03]])
    np.testing.assert_allclose(placed.marks.xy_px, [[5, 6], [7, 8]])


def test_geographic_points_and_a_world_of_their_own(tmp_path) -> None:
    found = control(tmp_path, "name,lat,lon,height,image,px,py\nA,35.6965,139.7695,40,000.jpg,1,1\n")
    np.testing.assert_allclose(locate(found, _scene()).world_m, _scene().world_from_rig[:1, :3, 3], atol=1e-6)
    alone = locate(_odm(tmp_path, f"{EAST} {NORTH} 3 1 1 000.jpg\n"), _scene(positions=False))
    assert alone.origin.crs == "EPSG:32654"
    np.testing.assert_allclose(crs_coordinates(alone.world_m, alone.origin)[0, :2], [EAST, NORTH], atol=1e-3)


def test_places_that_do_not_fit_the_survey(tmp_path) -> None:
    good = f"{EAST} {NORTH} 3 1 1 000.jpg\n"
    x, y, _ = crs_coordinates(np.zeros(3), make_origin(35.6965, 139.7695, 40.0, "EPSG:6677"))  # X north, near 0, 0
    for rows, crs, words in (
        (f"{EAST} {NORTH} 3 1 1 z.jpg\n", "EPSG:32654", r"no mark is in an image of this survey \(line 2: 'z.jpg'\)"),
        (good, "EPSG:32653", r"line 2: point 'point 1' lies .* km .* wrong CRS"),
        (f"{NORTH} {EAST} 3 1 1 000.jpg\n", "EPSG:32654", r"exchanged \(northing,easting\)"),
        (f"{y} {x} 3 1 1 000.jpg\n", "EPSG:6677", r"lies 39 km from .* positions: .*exchanged \(north, east\)"),
    ):
        with refused(words):
            locate(_odm(tmp_path, rows, crs), _scene())
    placed = locate(_odm(tmp_path, good + f"{EAST} {NORTH} 3 1 1 z.jpg\n"), _scene())
    assert says(placed.notes, "gcp_list.txt, line 3: image 'z.jpg' is not in the survey")
    assert len(locate(_odm(tmp_path, f"{x} {y} 3 1 1 000.jpg\n", "EPSG:6677"), _scene())) == 1
    for scene in (_scene(), _scene(positions=False)):
        with refused(r"line 2: point 'point 1': height 3955\d m, not within -500 to 9000 m"):
            locate(_odm(tmp_path, f"{EAST} {NORTH} 39558 1 1 000.jpg\n"), scene)
    assert len(locate(_odm(tmp_path, f"{EAST} {NORTH} -600 1 1 000.jpg\n"), _scene(), heights_m=(-700, 10))) == 1


@pytest.mark.slow
def test_heights_above_a_geoid_need_its_grid() -> None:
    assert "ellipsoid" in vertical_note("EPSG:6677")
    assert "JGD2011 (vertical)" in vertical_note("EPSG:6677+6695")
    try:
        origin = make_origin(35.7, 139.8, 40.0, "EPSG:6677+6695")
    except InputError as error:
        assert "grid" in str(error) and "projsync" in str(error)
    else:  # the grid is installed here
        assert abs(origin.shift_m[2] - 40.0) > 20


def test_marks_follow_cropping_and_undistortion() -> None:
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=100, height=80, params=[80, 50, 40, -0.1])
    pinhole = pycolmap.Camera(model="PINHOLE", width=90, height=70, params=[80, 80, 45, 35])
    assert prepared_pixel((20, 30), Sensor("c", camera, source=Source(camera, (5, 3, 0, 0)))) == (15, 27)
    moved = prepared_pixel((20, 30), Sensor("c", pinhole, source=Source(camera)))
    ray = np.append(camera.cam_from_img(np.array([20.0, 30.0])), 1.0)
    np.testing.assert_allclose(moved, pinhole.img_from_cam(ray), atol=1e-9)


CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=100, height=80, params=[80, 50, 40])
HEAD = "# crs: EPSG:32654\nname,x,y,z,sigma_xy,sigma_z,role,image,px,py\n"
A = f"A,{EAST},{NORTH},1,,,gcp,"


def test_odd_points_are_said(tmp_path) -> None:
    rows = f"{A}000.jpg,5,6\n{A}000.jpg,5,6\n{A}001.jpg,5,6\nB,{EAST},{NORTH},1,,,check,002.jpg,100.5,6\n"
    placed = locate(control(tmp_path, HEAD + rows), _scene(False, CAMERA))
    assert len(placed.marks.image) == 3
    said = "\n".join(placed.notes)
    assert "1 marks are given twice" in said
    assert "line 6: point 'B' has the same coordinates as 'A' in line 3" in said
    assert "line 6: 1 of 2 points have less than 2 marks in the survey's images and cannot be used: 'B' (1)" in said


def test_a_mark_that_was_cropped_away_is_left_out_and_said(tmp_path) -> None:
    found = control(tmp_path, HEAD + f"{A}000.jpg,5,6\n{A}001.jpg,50,40\n{A}002.jpg,50,40\n")
    cropped = pycolmap.Camera(model="SIMPLE_PINHOLE", width=80, height=80, params=[80, 30, 40])
    placed = locate(found, _scene(False, cropped, Source(CAMERA, (20, 0, 0, 0))))
    assert placed.marks.image.tolist() == [1, 2] and placed.marks.line.tolist() == [4, 5]
    assert says(placed.notes, "line 3: 1 marks lie where the images were cropped")


def test_marks_outside_are_left_to_be_judged_only_where_copies_of_the_images_hold_all(tmp_path) -> None:
    scene = _scene(camera=CAMERA)

    def located(*marks: str, orientation: int = 1):
        rows = "".join(f"{EAST + k} {NORTH} 3 {mark} 00{k}.jpg\n" for k, mark in enumerate(marks))
        found = locate(_odm(tmp_path, rows), scene, orientation=dict.fromkeys(range(4), orientation))
        assert says(found.notes, "the rays decide")
        return found.marks

    larger = located("190 20", "30 150", "5 5")  # of images twice as large: out to the right, and below
    np.testing.assert_array_equal(larger.file_px, [[190, 20], [30, 150], [5, 5]])
    turned = located("20 95", orientation=6)  # of the image as the sensor has it, 80 x 100
    np.testing.assert_array_equal(turned.orientation, [6])
    for marks, said in ((("190 20", "5 5"), "another size"), (("20 95",), "exchanged"), (("500 400",), "another size")):
        with refused(rf"line 2: the mark .* 100 x 80 pixels: .*{said}"):
            located(*marks)


POINTS = "name,x,y,z,role\nA,10,20,3,gcp\nB,11,21,4,check\n"


MARKS = "name,image,px,py\nA,1.jpg,5,6\nB,2.jpg,7,8\nA,2.jpg,9,10\n"


COLUMNS = r"points need the columns name, x, y, z .*lat, lon, height.* marks name, image, px, py, .*--marks"


def same(found: GcpFile) -> None:
    assert [(p.name, p.xyz, p.check) for p in found.points] == [("A", (10, 20, 3), False), ("B", (11, 21, 4), True)]
    marks = [("A", "1.jpg", (5, 6)), ("B", "2.jpg", (7, 8)), ("A", "2.jpg", (9, 10))]
    assert [(m.name, m.image, m.xy) for m in found.marks] == marks
    assert all(" columns read: " in note for note in found.notes)


def written(folder: Path, text: str | bytes, name: str = "gcp.csv") -> Path:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder / name


def control(folder: Path, text: str | bytes, name: str = "gcp.csv") -> GcpFile:
    return read_gcps(written(folder, text, name))


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
    found = control(tmp_path, text)
    same(found)
    assert found.crs == ("EPSG:32654" if "crs" in text else None) and not found.geographic


def test_two_files_in_either_order(tmp_path: Path) -> None:
    points, marks = written(tmp_path, POINTS, "points.csv"), written(tmp_path, MARKS, "marks.csv")
    for found in (read_gcps(points, marks), read_gcps(marks, points)):
        same(found)
        assert (found.path, found.of_marks) == (points, marks)


def test_the_list_of_odm_is_read_as_ever(tmp_path: Path) -> None:
    rows = "494399.2 4232697.1 5 124.88 596.25 IMG_6785.jpg\n494399.2 4232697.1 5 284.25 636.75 IMG_6786.jpg\n"
    found = control(tmp_path, "WGS84 UTM 54N\n" + rows, "gcp_list.txt")
    assert found.crs == "EPSG:32654" and len(found.points) == 1 and len(found.marks) == 2
    assert found.points[0].xyz == (494399.2, 4232697.1, 5.0)
    degrees = control(tmp_path, "WGS84\n139.76 35.69 40 10.5 20 a.jpg\n", "gcp_list.txt")
    assert degrees.points[0].xyz == (35.69, 139.76, 40.0)


def test_names_in_a_list_of_tabs_may_have_blanks(tmp_path: Path) -> None:
    row = "389000\t3951000\t10\t5\t6\tDJI 0001 (2).JPG\tpoint one\n"
    (mark,) = control(tmp_path, f"EPSG:32654\n{row}", "gcp_list.txt").marks
    assert (mark.image, mark.name) == ("DJI 0001 (2).JPG", "point one")


@pytest.mark.slow
def test_marks_without_points_are_refused_before_anything_is_made(tmp_path: Path, capsys) -> None:
    (tmp_path / "in").mkdir()
    marks = written(tmp_path, MARKS, "marks.csv")
    assert main(["run", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--marks", str(marks)]) == 2
    assert "marks of no points; give the points by --gcp" in capsys.readouterr().err
    assert main(["run", "--help-all"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "points (name, x, y, z or name, lat, lon, height)" in said and "--marks" in said


def test_targets_need_no_marks_and_bars_stand_in_a_table_of_their_own(tmp_path: Path) -> None:
    text = "name,x,y,z\ntag36h11:3,10,20,3\n[scale bars]\nfrom,to,length (mm),sigma (mm),role\n"
    found = control(tmp_path, text + "tag36h11:3,4x4_50:7,1200.5,0.05,\ntag36h11:3,4x4_50:8,800,,check\n")
    assert [p.name for p in found.points] == ["tag36h11:3"] and not found.marks and len(found.targets) == 3
    first, second = found.bars
    assert first.ends == ("tag36h11:3", "4x4_50:7")
    assert (first.length_m, first.sigma_m) == pytest.approx((1.2005, 5e-5))
    assert second.check and second.sigma_m == BAR_SIGMA_M and second.line == 6
    alone = control(tmp_path, "from,to,length\nA,B,1.5\nname,image,px,py\nA,1.jpg,5,6\nB,1.jpg,7,6\n")
    assert not alone.points and alone.bars[0].length_m == 1.5 and len(alone.marks) == 2


MARK = "\nname,image,px,py\nA,a.jpg,1,2\n"


def test_degrees_and_units_of_a_header_are_read(tmp_path: Path) -> None:
    """12 mm were read as 12 m, and feet as metres."""
    head = "# crs: EPSG:32654\nname,x,y,z (ft),sigma_xy (mm),sigma_z (cm)\nA,389000,3951000,100,12,3\n"
    (point,) = control(tmp_path, head + MARK).points
    assert point.xyz == pytest.approx((389000.0, 3951000.0, 30.48))
    assert point.sigma_m == pytest.approx((0.012, 0.012, 0.03))
    found = control(tmp_path, "name,lat,lon,height\nA,35.6,139.7,40" + MARK)
    assert found.geographic and found.points[0].xyz == (35.6, 139.7, 40.0) and len(found.marks) == 1


@pytest.mark.parametrize(("z", "metres"), [("z", 30.48006), ("z (m)", 100.0), ("z (ft)", 30.48)])
def test_heights_of_a_grid_in_feet(tmp_path: Path, z: str, metres: float) -> None:
    """EPSG:2263 counts in US survey feet, and so do heights that do not say otherwise."""
    file = control(tmp_path, f"# crs: EPSG:2263\nname,x,y,{z}\nA,984250,194305.3,100\n{MARK}")
    world = surveyed_world(file, make_origin(40.7, -74.0, 0.0))
    assert world[0, 2] == pytest.approx(metres, abs=1e-3) and abs(world[0, :2]).max() < 100


POSITION, TAGS = f"{EAST},{NORTH},1", "from,to,length\ntag36h11:1,"
WRONG: list[tuple[str | bytes, str]] = [
    (b"\x89PNG\r\n\x1a\n\x00\x00", "gcp.csv: is no text"),
    (POINTS, r"gcp.csv: points, but no marks with a pixel in an image; " + COLUMNS),
    (MARKS, r"gcp.csv: marks, but no points with coordinates; " + COLUMNS),
    ("name,x,y,z,image,px,py\nA,,,,000.jpg,1,2\n", "marks, but no points with coordinates; points need the columns"),
    (f"# crs: EPSG:32654\nname,x,y,z,image,px\nA,{POSITION},000.jpg,5\n", "three columns image, px and py"),
    ("name,x,y\nA,1,2\n", r"gcp.csv: found the columns name, x, y; " + COLUMNS),
    ("A,10,20,3\n", r"line 1: neither a header nor .*'A,10,20,3'; write .*name,northing,easting,height,code"),
    ("1 2 3 4 5 a.jpg\n", r"line 1: '1 2 3 4 5 a.jpg' is no coordinate system; .*header: " + COLUMNS),
    ("", r"gcp.csv: the file is empty; " + COLUMNS),
    (POINTS + "name,lat,lon,height\nC,35,139,4\n" + MARKS, "by x, y, z in one table and by lat, lon"),
    (POINTS + MARKS.replace("B,2.jpg,7,8", "B,2.jpg,,8"), "line 6: '' is no number"),
    # ODM's list
    ("nonsense\n1 2 3 1 1 000.jpg\n", r"gcp.csv, line 1: 'nonsense' is no coordinate system"),
    ("survey\n1 2 3 1 1 000.jpg\n", r"line 1: 'survey' is no coordinate system"),  # PROJ takes the name most like it
    (f"EPSG:32654\n{EAST} {NORTH} 3 1 1 000.jpg\n1 2 3\n", r"line 3: expected x y z px py image"),
    ("EPSG:32654\n1 x 3 1 1 000.jpg\n", r"line 2: 'x' is no number"),
    # coded targets and scale bars
    ("name,x,y,z\ntag16h5:30,1,2,3\n", r"gcp.csv, line 2: target 'tag16h5:30': that family has 30 targets"),
    ("name,x,y,z\ntag36h11:1,1,2,3\napriltag_36h11:01,1,2,4\n", "are one target: name it in one way only"),
    ("name,x,y,z\ntag36h12:1,1,2,3\n", "no marks with a pixel in an image.* such as tag36h11:12"),
    (TAGS + "A,1\n", r"line 2: the end 'A' of this bar is neither marked nor a coded target"),
    (TAGS + "tag36h11:2,1200.5\n", r"line 2: length = 1200.5: .* length \(mm\)"),
    (TAGS + "tag36h11:2,long\n", "line 2: length = long"),
    (TAGS.replace("length", "length,sigma") + "tag36h11:2,1,2\n", "line 2: sigma = 2: .* below the length"),
    (TAGS + "tag36h11:1,1\n", "line 2: a scale bar needs two different names"),
    (TAGS.replace("length", "length (px)") + "tag36h11:2,1\n", "lengths in 'px': give m, cm, mm or ft"),
    (TAGS + "tag36h11:2,1\ntag36h11:2,tag36h11:1,2\n", "line 3: the bar .* line 2 already"),
    # points and marks
    (f"{HEAD}{A}000.jpg,5,6\n{A}000.jpg,9,6\n", r"line 4: point 'A' is marked in a/000.jpg at \(9.0, 6.0\), but .* 3"),
    (f"{HEAD}{A}000.jpg,5,6\n{A}a/000.jpg,50,6\n", r"line 4: point 'A' is marked in a/000.jpg at .* but in line 3"),
    (f"{HEAD}{A}000.jpg,5,6\n{A}001.jpg,105,6\n", r"line 4: the mark \(105, 6\) of .* outside a/001.jpg, .* 100 x 80"),
    (f"{HEAD}{A}000.jpg,5,95\n", r"line 3: the mark \(5, 95\) .* px and py exchanged"),
    (f"{HEAD}{A}000.jpg,5,-20\n", r"line 3: the mark \(5, -20\) .* another size"),
    (f"{HEAD}{A}000.jpg,nan,6\n", "line 3: 'nan' is no number"),
    (f"{HEAD}{A}000.jpg,5,1e999\n", "line 3: '1e999' is no number"),
    (f"{HEAD}A,nan,{NORTH},1,,,gcp,000.jpg,5,6\n", "line 3: 'nan' is no number"),
    (f"{HEAD}A,,{NORTH},1,,,gcp,000.jpg,5,6\n", "line 3: '' is no number"),
    (f"{HEAD}A,{POSITION},inf,,gcp,000.jpg,5,6\n", "line 3: 'inf' is no number"),
    (f"{HEAD}A,{POSITION},-1,,gcp,000.jpg,5,6\n", "line 3: sigma_xy = -1: a sigma is above 0"),
    (f"{HEAD}A,{POSITION},,0,gcp,000.jpg,5,6\n", "line 3: sigma_z = 0: a sigma is above 0"),
    (f"{HEAD}A,{POSITION},bad,,gcp,000.jpg,5,6\n", "line 3: 'bad' is no number"),
    (f"{HEAD}{A}000.jpg,5,6\nA,{EAST + 3},{NORTH},1,,,gcp,,,\n", "line 4: point 'A' has another place than in line 3"),
    (f"{HEAD}{A}000.jpg,5,6\nA,{POSITION},,,check,,,\n", "line 4: point 'A' has another role than in line 3"),
    (f"{HEAD},{POSITION},,,gcp,000.jpg,5,6\n", "line 3: the point has no name"),
]  # fmt: skip


@pytest.mark.parametrize("text, words", WRONG)
def test_control_files_that_cannot_be_meant_say_where(tmp_path, text: str | bytes, words: str) -> None:
    with refused(words):
        locate(control(tmp_path, text), _scene(False, CAMERA))


@pytest.mark.parametrize(
    "text, more, words",
    [
        (POINTS, "name,image,px,py\nC,1.jpg,5,6\n", r"marks.csv, line 2: a mark of point 'C', which .* in gcp.csv"),
        (POINTS, "name,image,px,py\nA,1.jpg,five,6\n", r"marks.csv, line 2: 'five' is no number"),
        (POINTS + MARKS, MARKS, r"both contain marks; omit --marks"),
        (POINTS, POINTS, r"both contain points"),
    ],
)
def test_two_files_that_do_not_go_together(tmp_path, text: str, more: str, words: str) -> None:
    with refused(words):
        read_gcps(written(tmp_path, text), written(tmp_path, more, "marks.csv"))
