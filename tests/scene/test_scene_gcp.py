"""Control points: both file forms, CRS, images, and what is wrong with them said with file and line."""

from __future__ import annotations

import numpy as np
import pytest

from said import refused, says
from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import crs_coordinates, make_origin, vertical_note, world_from_geodetic
from tiegraph.scene.control import image_lookup, locate
from tiegraph.scene.gcp import read_gcps
from tiegraph.scene.markpixels import prepared_pixel
from tiegraph.scene.names import found_by
from tiegraph.scene.rig import Rig, Sensor, Source
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.tuning import ControlTuning

import pycolmap  # isort: skip

ORIGIN = make_origin(35.6965, 139.7695, 40.0)


def _scene(positions: bool = True) -> Scene:
    names = [f"a/{k:03d}.jpg" for k in range(4)]
    scene = simple_scene(Rig("lone", (Sensor("cam"),)), names, np.arange(4), np.zeros(4))
    if not positions:
        return scene
    poses = np.full((4, 4, 4), np.nan)
    poses[:, :3, 3] = world_from_geodetic(np.tile([35.6965, 139.7695, 40.0], (4, 1)), ORIGIN)
    return scene.with_(world_from_rig=poses, origin=ORIGIN, prior="gnss", position_sigma_m=np.full((4, 3), 0.05))


def _odm(tmp_path, lines: str, first: str = "EPSG:32654"):
    path = tmp_path / "gcp_list.txt"
    path.write_text(f"{first}\n{lines}")
    return read_gcps(path, ControlTuning())


EAST, NORTH, _ = crs_coordinates(np.zeros(3), ORIGIN)


def test_odm_list_with_and_without_names(tmp_path) -> None:
    found = _odm(
        tmp_path,
        f"{EAST} {NORTH} 3 10.5 20 000.jpg\n{EAST} {NORTH} 3 11 21 001.jpg\n{EAST + 5} {NORTH} 4 1 2 a/002.jpg\n",
        "WGS84 UTM 54N",
    )
    assert [p.name for p in found.points] == ["point 1", "point 2"] and len(found.marks) == 3
    control = locate(found, _scene())
    np.testing.assert_allclose(control.world_m[1] - control.world_m[0], [5, 0, 1], atol=1e-6)
    np.testing.assert_array_equal(control.marks.image, [0, 1, 2])
    assert any("EPSG:32654" in n and "ellipsoid" in n for n in control.notes)


def test_images_are_named_in_any_case_where_that_is_unique() -> None:
    names = ["a/IMG_1.JPG", "a/IMG_2.JPG", "b/img_2.jpg"]
    scene = simple_scene(Rig("lone", (Sensor("cam"),)), names, np.arange(3), np.zeros(3))
    lookup = image_lookup(scene)
    asked = ("img_1.jpg", "A\\Img_1.jpg", "a/img_1.JPG", "IMG_2.JPG", "img_2.jpg", "Img_2.jpg", "IMG_3.JPG")
    assert [found_by(lookup, name) for name in asked] == [0, 0, 0, 1, 2, None, None]


def test_csv_of_points_and_marks_with_roles(tmp_path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(
        "# crs: EPSG:32654\nname,x,y,z,sigma_xy,sigma_z,role,image,px,py\n"
        f"A,{EAST},{NORTH},1,0.01,0.02,gcp,,,\nB,{EAST + 2},{NORTH},1,,,check,,,\n"
        "A,,,,,,,000.jpg,5,6\nB,,,,,,,001.jpg,7,8\n"
    )
    control = locate(read_gcps(path, ControlTuning()), _scene())
    assert control.names == ("A", "B")
    np.testing.assert_array_equal(control.check, [False, True])
    np.testing.assert_allclose(control.sigma_m, [[0.01, 0.01, 0.02], [0.02, 0.02, 0.03]])
    np.testing.assert_allclose(control.marks.xy_px, [[5, 6], [7, 8]])


def test_geographic_points_and_a_world_of_their_own(tmp_path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("name,lat,lon,height,image,px,py\nA,35.6965,139.7695,40,000.jpg,1,1\n")
    np.testing.assert_allclose(
        locate(read_gcps(path, ControlTuning()), _scene()).world_m, _scene().world_from_rig[:1, :3, 3], atol=1e-6
    )
    alone = locate(_odm(tmp_path, f"{EAST} {NORTH} 3 1 1 000.jpg\n", "EPSG:32654"), _scene(positions=False))
    assert alone.origin is not None and alone.origin.crs == "EPSG:32654"
    np.testing.assert_allclose(crs_coordinates(alone.world_m, alone.origin)[0, :2], [EAST, NORTH], atol=1e-3)


def test_wrong_files_say_where(tmp_path) -> None:
    good = f"{EAST} {NORTH} 3 1 1 000.jpg\n"
    with refused(r"gcp_list.txt, line 1: 'nonsense' is no coordinate system"):
        _odm(tmp_path, good, "nonsense")
    with refused(r"line 1: 'survey' is no coordinate system"):
        _odm(tmp_path, good, "survey")  # PROJ would take the CRS whose name is most like it
    with refused(r"line 3: expected x y z px py image"):
        _odm(tmp_path, good + "1 2 3\n")
    with refused(r"line 2: 'x' is no number"):
        _odm(tmp_path, "1 x 3 1 1 000.jpg\n")
    with refused(r"no mark is in an image of this survey \(line 2: 'z.jpg'\)"):
        locate(_odm(tmp_path, f"{EAST} {NORTH} 3 1 1 z.jpg\n"), _scene())
    control = locate(_odm(tmp_path, good + f"{EAST} {NORTH} 3 1 1 z.jpg\n"), _scene())
    assert any("gcp_list.txt, line 3: image 'z.jpg' is not in the survey" in n for n in control.notes)
    with refused(r"line 2: point 'point 1' lies .* km .* wrong CRS"):
        locate(_odm(tmp_path, good, "EPSG:32653"), _scene())
    with refused(r"exchanged \(northing,easting\)"):
        locate(_odm(tmp_path, f"{NORTH} {EAST} 3 1 1 000.jpg\n"), _scene())
    x, y, _ = crs_coordinates(np.zeros(3), make_origin(35.6965, 139.7695, 40.0, "EPSG:6677"))  # X north, near 0, 0
    assert len(locate(_odm(tmp_path, f"{x} {y} 3 1 1 000.jpg\n", "EPSG:6677"), _scene())) == 1
    with refused(r"lies 39 km from the survey's positions: .*exchanged \(north, east\)"):
        locate(_odm(tmp_path, f"{y} {x} 3 1 1 000.jpg\n", "EPSG:6677"), _scene())
    for scene in (_scene(), _scene(positions=False)):
        with refused(r"line 2: point 'point 1': height 3955\d m, not within -500 to 9000 m"):
            locate(_odm(tmp_path, f"{EAST} {NORTH} 39558 1 1 000.jpg\n"), scene)
    assert len(locate(_odm(tmp_path, f"{EAST} {NORTH} -600 1 1 000.jpg\n"), _scene(), heights_m=(-700, 10))) == 1
    (tmp_path / "m.csv").write_text("name,x,y,z,image,px,py\nA,,,,000.jpg,1,2\n")
    with refused(r"marks, but no points with coordinates; points need the columns name, x"):
        read_gcps(tmp_path / "m.csv", ControlTuning())


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
HEAD = "name,x,y,z,sigma_xy,sigma_z,role,image,px,py\n"
A = f"A,{EAST},{NORTH},1,,,gcp,"


def _with_camera(crop: tuple[int, int, int, int] = (0, 0, 0, 0)) -> Scene:
    left, top, right, bottom = crop
    width, height = 100 - left - right, 80 - top - bottom
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=width, height=height, params=[80, 50 - left, 40 - top])
    source = Source(CAMERA, crop) if any(crop) else None
    names = [f"a/{k:03d}.jpg" for k in range(4)]
    return simple_scene(Rig("lone", (Sensor("cam", camera, source=source),)), names, np.arange(4), np.zeros(4))


def _csv(tmp_path, text: str):
    path = tmp_path / "points.csv"
    path.write_text("# crs: EPSG:32654\n" + text)
    return path


@pytest.mark.parametrize(
    "rows, message",
    [
        (f"{A}000.jpg,5,6\n{A}000.jpg,9,6\n", r"line 4: point 'A' is marked in '000.jpg' at \(9.0, 6.0\), but .* 3"),
        (f"{A}000.jpg,5,6\n{A}a/000.jpg,50,6\n", r"line 4: point 'A' is marked in a/000.jpg at .* but in line 3"),
        (f"{A}000.jpg,5,6\n{A}001.jpg,105,6\n", r"line 4: the mark \(105, 6\) of .* outside a/001.jpg, .* 100 x 80"),
        (f"{A}000.jpg,5,95\n", r"line 3: the mark \(5, 95\) .* px and py exchanged"),
        (f"{A}000.jpg,5,-20\n", r"line 3: the mark \(5, -20\) .* another size"),
        (f"{A}000.jpg,nan,6\n", "line 3: 'nan' is no number"),
        (f"{A}000.jpg,5,1e999\n", "line 3: '1e999' is no number"),
        (f"A,nan,{NORTH},1,,,gcp,000.jpg,5,6\n", "line 3: 'nan' is no number"),
        (f"A,,{NORTH},1,,,gcp,000.jpg,5,6\n", "line 3: '' is no number"),
        (f"A,{EAST},{NORTH},1,inf,,gcp,000.jpg,5,6\n", "line 3: 'inf' is no number"),
        (f"A,{EAST},{NORTH},1,-1,,gcp,000.jpg,5,6\n", "line 3: sigma_xy = -1: a sigma is above 0"),
        (f"A,{EAST},{NORTH},1,,0,gcp,000.jpg,5,6\n", "line 3: sigma_z = 0: a sigma is above 0"),
        (f"A,{EAST},{NORTH},1,bad,,gcp,000.jpg,5,6\n", "line 3: 'bad' is no number"),
        (f"{A}000.jpg,5,6\nA,{EAST + 3},{NORTH},1,,,gcp,,,\n", "line 4: point 'A' has another place than in line 3"),
        (f"{A}000.jpg,5,6\nA,{EAST},{NORTH},1,,,check,,,\n", "line 4: point 'A' has another role than in line 3"),
        (f",{EAST},{NORTH},1,,,gcp,000.jpg,5,6\n", "line 3: the point has no name"),
    ],
)  # fmt: skip
def test_points_and_marks_that_cannot_be_meant(tmp_path, rows: str, message: str) -> None:
    with refused(message):
        locate(read_gcps(_csv(tmp_path, HEAD + rows), ControlTuning()), _with_camera())


def test_odd_points_are_said(tmp_path) -> None:
    rows = f"{A}000.jpg,5,6\n{A}000.jpg,5,6\n{A}001.jpg,5,6\nB,{EAST},{NORTH},1,,,check,002.jpg,100.5,6\n"
    control = locate(read_gcps(_csv(tmp_path, HEAD + rows), ControlTuning()), _with_camera())
    assert len(control.marks.image) == 3
    said = "\n".join(control.notes)
    assert "1 marks are given twice" in said
    assert "line 6: point 'B' is at the very place of 'A' in line 3" in said
    assert "line 6: 1 of 2 points have less than 2 marks in the survey's images and cannot be used: 'B' (1)" in said


def test_a_mark_that_was_cropped_away_is_left_out_and_said(tmp_path) -> None:
    found = read_gcps(_csv(tmp_path, HEAD + f"{A}000.jpg,5,6\n{A}001.jpg,50,40\n{A}002.jpg,50,40\n"), ControlTuning())
    control = locate(found, _with_camera((20, 0, 0, 0)))
    assert control.marks.image.tolist() == [1, 2] and control.marks.line.tolist() == [4, 5]
    assert says(control.notes, "line 3: 1 marks lie where the images were cropped")


def test_no_text_and_half_a_mark(tmp_path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00")
    with refused("points.csv: is no text"):
        read_gcps(path, ControlTuning())
    with refused("three columns image, px and py"):
        read_gcps(_csv(tmp_path, f"name,x,y,z,image,px\nA,{EAST},{NORTH},1,000.jpg,5\n"), ControlTuning())


def test_marks_outside_are_left_to_be_judged_only_where_copies_of_the_images_hold_all(tmp_path) -> None:
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=100, height=80, params=[80, 50, 40])
    scene = _scene().with_(rigs=(Rig("lone", (Sensor("cam", camera),)),))

    def located(*marks: str, orientation: int = 1):
        rows = "".join(f"{EAST + k} {NORTH} 3 {mark} 00{k}.jpg\n" for k, mark in enumerate(marks))
        found = locate(_odm(tmp_path, rows), scene, orientation=dict.fromkeys(range(4), orientation))
        assert says(found.notes, "rays will tell")
        return found.marks

    larger = located("190 20", "30 150", "5 5")  # of images twice as large: out to the right, and below
    np.testing.assert_array_equal(larger.file_px, [[190, 20], [30, 150], [5, 5]])
    turned = located("20 95", orientation=6)  # of the image as the sensor has it, 80 x 100
    np.testing.assert_array_equal(turned.orientation, [6])
    for marks, said in ((("190 20", "5 5"), "another size"), (("20 95",), "exchanged"), (("500 400",), "another size")):
        with refused(rf"line 2: the mark .* 100 x 80 pixels: .*{said}"):
            located(*marks)
