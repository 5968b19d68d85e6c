"""Multispectral cameras in one flat folder are one rig; what their XMP says of it is taken; lenses are cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL.TiffImagePlugin import ImageFileDirectory_v2
from scan_worlds import exif_of, picture, scan

from said import says
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.exif import RigTags, relative_rotation
from tiegraph.scene.images import probe_image
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import ImageTuning

HEAD = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description rdf:about="" xmlns:Camera="http://pix4d.com/camera/1.0"'
ANGLES = {1: (0.0, 0.0, 0.0), 2: (-0.127427, 0.183305, 0.058653), 3: (0.4, -1.2, 0.3)}


def _elements(index: int, band: str, angles: tuple[float, ...], reference: int = 1) -> bytes:
    tags = {"BandName": band, "RigName": "RedEdge-MX", "RigCameraIndex": index,
            "RigRelatives": ", ".join(map(str, angles)), "RigRelativesReferenceRigCameraIndex": reference}  # fmt: skip
    inside = "".join(f"<Camera:{name}>{value}</Camera:{name}>" for name, value in tags.items())
    return f"{HEAD}>{inside}</rdf:Description></rdf:RDF></x:xmpmeta>".encode()


def _tiff(path: Path, xmp: bytes = b"", size: tuple[int, int] = (64, 48)) -> Path:
    tags = ImageFileDirectory_v2()
    if xmp:
        tags[700] = xmp
        tags.tagtype[700] = 1
    return picture(path, size, "L", tiffinfo=tags)


def _rig(scene: Scene) -> Rig:
    assert len(scene.rigs) == 1
    return scene.rigs[0]


def test_the_bands_of_a_sequoia_in_one_folder_are_a_rig(tmp_path: Path) -> None:
    for shot in range(4):
        for band in ("GRE", "NIR", "RED", "REG"):
            _tiff(tmp_path / f"IMG_180822_1339{shot:02d}_020{shot}_{band}.TIF")
        picture(tmp_path / f"IMG_180822_1339{shot:02d}_020{shot}_RGB.JPG", (96, 72))
    scene = scan(tmp_path)
    rig = _rig(scene)
    assert [s.name for s in rig.sensors] == ["GRE", "NIR", "RED", "REG", "RGB"] and rig.nominal
    assert scene.frames == 4 and len(scene) == 20 and scene.sequences == ("all",) and not scene.dropped
    assert all(len(set(scene.frame[scene.sensor == k])) == 4 for k in range(5))
    assert all(f"_020{f}_" in name for f, name in zip(scene.frame, scene.names))  # a frame is one shot
    assert [(s.camera.width, s.camera.height) for s in rig.sensors] == [(64, 48)] * 4 + [(96, 72)]
    assert says(scene.notes, "5 cameras that share folders, by the ends of the file names")


def test_numbers_of_micasense_are_bands_and_their_xmp_turns_them(tmp_path: Path) -> None:
    for shot in range(3):
        for index, band in ((1, "Blue"), (2, "Green"), (3, "Red")):
            _tiff(tmp_path / "one" / f"IMG_{shot:04d}_{index}.tif", _elements(index, band, ANGLES[index]))
        for index, band in ((1, "Blue"), (2, "Green")):  # the second is the reference
            angles = (0.2, -0.1, 0.3) if index == 1 else (0.0, 0.0, 0.0)
            _tiff(tmp_path / "two" / f"IMG_{shot:04d}_{index}.tif", _elements(index, band, angles, 2))
    scene = scan(tmp_path / "one")
    rig = _rig(scene)
    assert [s.name for s in rig.sensors] == ["Blue", "Green", "Red"] and scene.frames == 3
    for sensor, angles in zip(rig.sensors, ANGLES.values()):
        expected = relative_rotation(angles).T  # sensor_from_rig: the tags turn this camera into the reference
        np.testing.assert_allclose(sensor.sensor_from_rig[:3, :3], expected, atol=1e-12)
        np.testing.assert_allclose(sensor.sensor_from_rig[:3, 3], 0)
    # a positive first angle turns about x: what the camera sees ahead lies above (-y) in the reference
    ahead = [0, -np.sin(np.radians(1)), np.cos(np.radians(1))]
    np.testing.assert_allclose(relative_rotation((1.0, 0, 0)) @ [0, 0, 1], ahead)
    assert says(scene.notes, "RigRelatives")
    rig = _rig(scan(tmp_path / "two"))
    assert [s.name for s in rig.sensors] == ["Green", "Blue"]
    expected = relative_rotation((0.2, -0.1, 0.3)).T
    np.testing.assert_allclose(rig.sensors[1].sensor_from_rig[:3, :3], expected, atol=1e-12)


def test_names_alone_do_for_micasense_but_not_for_rows_and_columns(tmp_path: Path) -> None:
    for shot in range(4):
        for index in range(1, 6):
            _tiff(tmp_path / "flight" / f"IMG_{shot:04d}_{index}.tif")
            picture(tmp_path / "wall" / f"photo_{shot}_{index}.jpg")
    rig = _rig(scan(tmp_path / "flight"))
    assert [s.name for s in rig.sensors] == [f"band{k}" for k in range(1, 6)]
    assert len(_rig(scan(tmp_path / "wall")).sensors) == 1


def test_a_written_rig_of_bands_is_read_back(tmp_path: Path) -> None:
    for shot in range(3):
        for band in ("GRE", "RED"):
            _tiff(tmp_path / "in" / f"IMG_{shot}_{band}.TIF")
    guessed = scan(tmp_path / "in")
    write_rig_toml(_rig(guessed), tmp_path / "rig.toml")
    again = scan(tmp_path / "in", rig=str(tmp_path / "rig.toml"))
    assert [s.folder for s in _rig(again).sensors] == ["*_GRE", "*_RED"]
    assert again.frames == 3 and again.frame.tolist() == guessed.frame.tolist()


@pytest.mark.parametrize(
    "xmp, tags",
    [
        (f'{HEAD} Camera:RigName="Sequoia" Camera:RigCameraIndex="2" Camera:BandName="Red edge"/>'.encode(),
         RigTags(2, "Red edge")),
        (f"{HEAD}><Camera:RigCameraIndex>3</Camera:RigCameraIndex><Camera:RigRelatives><rdf:Seq><rdf:li>0.5</rdf:li>"
         "<rdf:li>0.2</rdf:li><rdf:li>-0.3</rdf:li></rdf:Seq></Camera:RigRelatives>".encode(),
         RigTags(3, "", (0.5, 0.2, -0.3))),
        (_elements(1, "Blue", (float("nan"), 0, 0)), RigTags(1, "Blue", (), 1)),
        (b"\xff\xfe broken RigCameraIndex", RigTags()),
    ],
)  # fmt: skip
def test_tags_in_every_form(tmp_path: Path, xmp: bytes, tags: RigTags) -> None:
    assert probe_image(_tiff(tmp_path / "a.tif", xmp), ImageTuning()).exif.rig == tags


# --- lenses ---------------------------------------------------------------------------------------------------------


def _lens(path: Path, name: str, **tags: object) -> None:
    exif = exif_of(make="Apple", model="iPhone 12", **tags)
    exif.get_ifd(0x8769)[0xA434] = name
    picture(path, exif=exif)


def test_several_lenses_of_one_make_are_several_cameras(tmp_path: Path) -> None:
    """And one lens is one camera also where some files do not say it."""
    for k in range(40):  # enough, and numbered evenly: a sequence by its names
        wide = k % 4 == 0
        focal_mm = 1.5 if wide else 4.2
        _lens(tmp_path / "two" / f"frame{k:04d}.jpg", f"back camera {focal_mm}mm", focal_mm=focal_mm)
        if k % 10 == 3:
            picture(tmp_path / "one" / f"frame{k:04d}.jpg", exif=exif_of(make="Apple", model="iPhone 12"))
        else:
            _lens(tmp_path / "one" / f"frame{k:04d}.jpg", "back camera", focal_mm=4.2)
    scene = scan(tmp_path / "two")
    assert len(scene.rigs) == 2 and scene.sequences == ()
    assert sorted(np.bincount(scene.rig[scene.frame]).tolist()) == [10, 30]
    assert says(scene.notes, "2 cameras by make, model, lens") and says(scene.notes, "taken with different lenses")
    scene = scan(tmp_path / "one")
    assert len(scene.rigs) == 1 and scene.sequences == ("all",)
