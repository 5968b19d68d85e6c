"""Images as telephones, cameras and scanners write them: read with their depth and EXIF, or refused with a remedy."""

from __future__ import annotations

import io
import re
import shutil
import struct
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms, features
from PIL.TiffImagePlugin import IFDRational
from scan_worlds import exif_of, picture, scan

from said import refused
from tiegraph.scan.scan import prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.decoding import _register, opaque
from tiegraph.scene.images import probe_image

HEIC = Path(__file__).with_name("orientation6.heic")  # of COLOURS, turned by its container and by the same EXIF
COLOURS = np.array([[[200, 20, 20], [20, 200, 20], [20, 20, 200]], [[220, 220, 220], [128, 128, 128], [5, 5, 5]]])
LARGE = np.kron(COLOURS, np.ones((32, 32, 1), int)).astype(np.uint8)
WHEN = {"make": "Cam", "time": "2024:01:01 10:00:00", "focal_35mm": 26, "lat": 35.5, "lon": 139.75}


def dng(path: Path, rgb: np.ndarray, orientation: int = 6) -> Path:
    """A DNG of 12 bits with an RGGB pattern, uncompressed, of linear values (H, W, 3)."""
    mosaic = np.zeros(rgb.shape[:2], np.uint16)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[row::2, column::2] = rgb[row::2, column::2, channel]
    exif = exif_of(orientation=orientation, **WHEN)
    identity = tuple(IFDRational(int(v)) for v in np.eye(3).ravel())
    exif.update({50706: bytes([1, 4, 0, 0]), 33421: (2, 2), 33422: b"\0\1\1\2", 50717: 4095, 50721: identity,
                 50728: (IFDRational(1),) * 3, 50778: 21, 50708: "Cam"})  # fmt: skip
    file = io.BytesIO()
    Image.fromarray(mosaic).save(file, "TIFF", exif=exif.tobytes())
    data = bytearray(file.getvalue())
    first = struct.unpack_from("<I", data, 4)[0]
    for at in range(first + 2, first + 2 + 12 * struct.unpack_from("<H", data, first)[0], 12):
        tag = struct.unpack_from("<H", data, at)[0]
        if tag == 262:  # photometric interpretation: colour filter array
            struct.pack_into("<H", data, at + 8, 32803)
        if tag in (50706, 33422):  # bytes
            struct.pack_into("<H", data, at + 2, 1)
    path.write_bytes(data)
    return path


def probe(path: Path) -> object:
    return probe_image(path)


def prepared(folder: Path) -> np.ndarray:
    """The first image of a survey as the other stages read it, (H, W, C) u1."""
    scene = scan(folder)
    prepare_image(folder / scene.source_name(0), folder / "out" / scene.names[0], scene.sensor_of(0), ScanSettings())
    pixels = cv2.imread(str(folder / "out" / scene.names[0]), cv2.IMREAD_UNCHANGED)
    camera = scene.sensor_of(0).camera
    assert pixels.shape[:2] == (camera.height, camera.width)
    return pixels


@pytest.mark.slow
@pytest.mark.parametrize("kind", [".heic", ".avif", ".dng", ".jp2"])
def test_formats_of_cameras_are_read_upright_and_with_their_exif(tmp_path: Path, kind: str) -> None:
    want = np.rot90(LARGE[..., ::-1], -1)  # orientation 6; OpenCV's order of channels
    for k in range(2):
        path = tmp_path / f"IMG_{k}{kind.upper()}"
        if kind == ".heic":
            pytest.importorskip("pi_heif")
            path.write_bytes(HEIC.read_bytes() + bytes(k))
        elif kind == ".dng":
            pytest.importorskip("rawpy")
            dng(path, LARGE.astype(int) * 10)
        elif kind == ".avif":
            if not features.check("avif"):
                pytest.skip("Pillow reads AVIF from 11.3 on")
            Image.fromarray(LARGE).save(path, "AVIF", quality=95, exif=exif_of(orientation=6, **WHEN))
        else:
            Image.fromarray(np.ascontiguousarray(want[..., ::-1])).save(path, "JPEG2000")
        if k:
            with open(path, "ab") as file:
                file.write(b"\0" * 9)
    found = probe(tmp_path / f"IMG_0{kind.upper()}")
    assert found.upright_size() == (64, 96) and found.reason == ""
    if kind != ".jp2":
        assert (found.exif.lat_deg, found.exif.time_s) == pytest.approx((35.5, 1704103200.0))
        assert found.exif.focal_px == pytest.approx(26 / 43.27 * np.hypot(96, 64), rel=1e-3)
    pixels = prepared(tmp_path).astype(int)
    if kind == ".dng":  # demosaiced, in the camera's colours: which is which
        assert [pixels[y, x].argmax() for y, x in ((16, 48), (48, 48), (80, 48))] == [2, 1, 0]
        assert np.ptp(pixels[16, 16]) < 3 and pixels[16, 16, 0] > pixels[48, 16, 0] > pixels[80, 16, 0] + 50
    else:
        assert np.abs(pixels - want)[8:-8:16, 8:-8:16].mean() < 6


@pytest.mark.parametrize(
    "name, remedy", [("a.heic", "tiegraph[heif]"), ("a.jpg", "tiegraph[heif]"), ("a.dng", "tiegraph[raw]"),
                     ("a.jxl", "convert to JPEG")],
)  # fmt: skip
def test_what_a_library_is_missing_for_is_said_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, remedy: str
) -> None:
    for k in (1, 2):
        path = tmp_path / name.replace("a", f"a{k}")
        if name == "a.dng":
            dng(path, LARGE.astype(int) * 10)
        else:
            path.write_bytes(HEIC.read_bytes() + bytes(k))
    monkeypatch.setitem(sys.modules, "rawpy", None)
    monkeypatch.setattr("tiegraph.scene.decoding._PLUGINS", ())
    _register.cache_clear()
    Image.init()  # and as if no plugin of Pillow for HEIC were there
    monkeypatch.setattr(Image, "ID", [i for i in Image.ID if i != "HEIF"])
    monkeypatch.delitem(Image.OPEN, "HEIF", raising=False)
    with refused(f"a1.*, a2.*: .*{remedy.replace('[', '.')}"):
        scan(tmp_path)
    for k in range(2):
        picture(tmp_path / f"{k}.png")
    said = scan(tmp_path)
    assert len(said) == 2 and len(said.dropped) == 2
    assert any(n.startswith("2 images: ") and remedy in n for n in said.notes) or remedy.startswith("convert")


@pytest.mark.parametrize(
    "first, second, kept, others",
    [
        ("a/1.jpg", "a/1.DNG", "a/1.jpg", 1),  # a camera writes both
        ("a/1.HEIC", "a/1.jpg", "a/1.jpg", 1),  # a telephone's, and its copy
        ("a/1.tif", "a/1.jpg", "a/1.jpg", 1),  # a developed copy
        ("raw/1.dng", "jpg/1.jpg", "jpg/1.jpg", 1),  # in folders of their own: by their EXIF
        ("a/1.jpg", "b/1.jpg", "a/1.jpg", 0),  # cameras of a rig
    ],
)
def test_a_photograph_in_two_formats_is_one_image(
    tmp_path: Path, first: str, second: str, kept: str, others: int
) -> None:
    pytest.importorskip("rawpy")
    pytest.importorskip("pi_heif")
    for number in ("1", "2"):
        for name in (first, second):
            path = tmp_path / name.replace("1.", f"{number}.")
            path.parent.mkdir(exist_ok=True)
            if path.suffix.lower() == ".dng":
                dng(path, LARGE.astype(int) * 10 + int(number))
            elif path.suffix == ".HEIC":
                path.write_bytes(HEIC.read_bytes() + bytes(int(number)))
            else:
                picture(path, (96, 64), exif=exif_of(orientation=6, **WHEN).tobytes())
    scene = scan(tmp_path)
    files = {scene.source_name(k) for k in range(len(scene))}
    assert kept in files and len(files) == 4 - 2 * others and len(scene.dropped) == 2 * others
    assert any(n.startswith("2 photographs are here in two formats: of ") for n in scene.notes) == bool(others)
    assert all(d.reason.startswith("the same photograph as ") for d in scene.dropped)


def test_a_photograph_and_its_thermal_image_are_two(tmp_path: Path) -> None:
    for k in range(2):
        picture(tmp_path / f"DJI_{k}.jpg", (64, 48))
        picture(tmp_path / f"DJI_{k}.tif", (40, 32))
    assert len(scan(tmp_path)) == 4


def tiff_of(pixels: np.ndarray, orientation: int) -> bytes:
    """A TIFF by OpenCV, with the tag Orientation."""
    data = bytearray(cv2.imencode(".tif", pixels)[1].tobytes())
    first = struct.unpack_from("<I", data, 4)[0]
    count = struct.unpack_from("<H", data, first)[0]
    rows = [bytes(data[first + 2 + 12 * k : first + 14 + 12 * k]) for k in range(count)]
    rows = sorted([*rows, struct.pack("<HHIHH", 274, 3, 1, orientation, 0)], key=lambda row: row[:2][::-1])
    struct.pack_into("<I", data, 4, len(data))
    return bytes(data) + struct.pack("<H", len(rows)) + b"".join(rows) + bytes(4)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("grey", [False, True])
def test_tiff_of_any_depth_is_turned_once(tmp_path: Path, orientation: int, depth: type, grey: bool) -> None:
    pixels = LARGE[..., 1] if grey else LARGE
    for k in range(2):
        (tmp_path / f"{k}.tif").write_bytes(tiff_of(pixels.astype(depth), orientation) + bytes(k))
    found = prepared(tmp_path).astype(int)
    want = np.rot90(pixels, {1: 0, 3: 2, 6: -1, 8: 1}[orientation]).astype(int)
    assert found.shape == want.shape
    scaled = want if depth is np.uint8 else (want - want.min()) * 255 / np.ptp(want)
    assert np.abs(found - scaled).max() <= 1


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".tif", ".ppm", ".jp2", ".png"])
def test_colours_of_twelve_bits_keep_them_in_every_format(tmp_path: Path, suffix: str) -> None:
    ramp = np.tile(np.linspace(0, 4095, 256).astype(np.uint16)[:, None], (64, 1, 3)).reshape(64, 256, 3)
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}{suffix}"), np.roll(ramp, k, axis=0))
        with open(tmp_path / f"{k}{suffix}", "ab") as file:
            file.write(bytes(k))
    assert probe(tmp_path / f"0{suffix}").levels == (0, 4095)
    assert len(np.unique(prepared(tmp_path))) == 256


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_temperatures_with_pixels_without_value(tmp_path: Path, bad: float) -> None:
    degrees = np.tile(np.linspace(-12.5, 31.5, 256, dtype=np.float32), (64, 1))
    degrees[5, 5] = bad
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.tif"), np.roll(degrees, k, axis=0))
    assert probe(tmp_path / "0.tif").levels == pytest.approx((-12.5, 31.5), abs=0.2)
    pixels = prepared(tmp_path)
    assert pixels.dtype == np.uint8 and len(np.unique(pixels)) > 250
    cv2.imwrite(str(tmp_path / "none.tif"), np.full((64, 64), np.nan, np.float32))
    assert probe(tmp_path / "none.tif").reason == "no pixel has a value"


@pytest.mark.parametrize(
    "name, how, pages",
    [
        ("a.mpo", {"format": "MPO", "save_all": True}, 1),  # of one instant: the first is the camera's
        ("a.tif", {"save_all": True}, 2),
        ("a.webp", {"save_all": True, "lossless": True}, 2),
        ("a.png", {"save_all": True}, 2),
    ],
)
def test_of_several_pictures_in_a_file_the_first_is_used_and_that_is_said(
    tmp_path: Path, name: str, how: dict, pages: int
) -> None:
    for k in range(2):
        image = Image.fromarray(np.roll(LARGE, k, axis=1))
        image.save(tmp_path / name.replace("a", str(k)), append_images=[image.rotate(180)], **how)
    scene = scan(tmp_path)
    said = [n for n in scene.notes if n == "2 images: the first of 2 pictures in the file is used"]
    assert len(said) == (pages > 1)
    assert np.abs(prepared(tmp_path)[..., ::-1].astype(int) - LARGE).mean() < 6


@pytest.mark.parametrize("how", ["cmyk", "palette", "progressive", "profile", "lab", "key colour"])
def test_odd_photographs_become_what_they_show(tmp_path: Path, how: str) -> None:
    image = Image.fromarray(LARGE)
    suffix = {"palette": "png", "key colour": "png", "lab": "tif"}.get(how, "jpg")
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    save = {"profile": {"icc_profile": profile, "quality": 95}, "progressive": {"progressive": True}}.get(how, {})
    save = {"transparency": (5, 5, 5)} if how == "key colour" else save
    mode = {"cmyk": "CMYK", "lab": "LAB"}.get(how, "RGB")
    for k in range(2):
        made = image.quantize(8) if how == "palette" else image.convert(mode)
        made.save(tmp_path / f"{k}.{suffix}", **save)
        with open(tmp_path / f"{k}.{suffix}", "ab") as file:
            file.write(bytes(k))
    found = prepared(tmp_path)
    if how == "key colour":
        np.testing.assert_array_equal(opaque(tmp_path / "out" / "0.png"), (LARGE != 5).any(axis=2))
    assert np.abs(found[..., 2::-1].astype(int) - LARGE)[4::8, 4::8].mean() < 8


@pytest.mark.parametrize("suffix", [".png", ".webp", ".jpg", ".avif"])
def test_orientation_is_read_of_every_format(tmp_path: Path, suffix: str) -> None:
    if suffix == ".avif" and not features.check("avif"):
        pytest.skip("Pillow reads AVIF from 11.3 on")
    for k in range(2):
        Image.fromarray(np.roll(LARGE, k, axis=0)).save(tmp_path / f"{k}{suffix}", exif=exif_of(orientation=8))
    assert probe(tmp_path / f"0{suffix}").upright_size() == (64, 96)
    assert np.abs(prepared(tmp_path)[..., ::-1].astype(int) - np.rot90(LARGE))[4::8, 4::8].mean() < 10


@pytest.mark.parametrize("kind", ["heic", "avif", "dng", "jp2", "tif"])
def test_what_is_cut_off_in_other_formats_is_said(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "heic":
        pytest.importorskip("pi_heif")
        shutil.copy(HEIC, path)
    elif kind == "dng":
        pytest.importorskip("rawpy")
        dng(path, LARGE.astype(int) * 10)
    else:
        cv2.imwrite(str(path), LARGE.astype(np.uint16 if kind == "tif" else np.uint8))
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    assert re.match("truncated|damaged|broken|LibRaw cannot", probe(path).reason)


def test_files_that_are_none_are_left_out_and_the_survey_goes_on(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / f"IMG_{k}.JPG", (320, 240))
    whole = (tmp_path / "IMG_2.JPG").read_bytes()
    (tmp_path / "IMG_2.JPG").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "._IMG_0.JPG").write_bytes(b"\0\5\26\7" + bytes(99))
    (tmp_path / "IMG_3.JPG").write_bytes(b"")
    (tmp_path / "IMG_4.JPG").write_bytes(whole.replace(b"\x08\0\xf0\1\x40", b"\x0c\0\xf0\1\x40", 1))  # 12 bits
    bomb = bytearray(picture(tmp_path / "IMG_5.PNG").read_bytes())
    struct.pack_into(">II", bomb, 16, 40_000, 30_000)
    struct.pack_into(">I", bomb, 29, zlib.crc32(bomb[12:29]))
    (tmp_path / "IMG_5.PNG").write_bytes(bomb)
    shutil.copy(HEIC, tmp_path / "IMG_6.GIF")
    scene = scan(tmp_path)
    reasons = {d.name: d.reason for d in scene.dropped}
    assert len(scene) == 2 and len(reasons) == 5
    for number, word in ((2, "truncated"), (3, "zero bytes"), (4, "rare"), (5, "40000 x 30000"), (6, "convert")):
        assert word in next(r for n, r in reasons.items() if n.startswith(f"IMG_{number}"))
