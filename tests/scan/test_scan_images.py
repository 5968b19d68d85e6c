import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from scan_worlds import data, exif_of, picture

from tiegraph.errors import InputError
from tiegraph.scene.decoding import EIGHT_BIT, eight_bit
from tiegraph.scene.images import find_images, probe_image, search_images
from tiegraph.scene.tuning import ImageTuning


def test_find_images_is_sorted_posix_and_passes_over_hidden_files(tmp_path: Path) -> None:
    for name in ("b/2.JPG", "a/1.png", "a/._1.png", ".hidden/3.jpg", "a/Thumbs.db.jpg"):
        picture(tmp_path / name, format="PNG")
    (tmp_path / "Thumbs.db").write_bytes(b"x")
    (tmp_path / "notes.txt").write_text("x")
    assert find_images(tmp_path) == ["a/1.png", "a/Thumbs.db.jpg", "b/2.JPG"]


def test_a_folder_images_beside_masks_is_the_only_one_searched(tmp_path: Path) -> None:
    picture(tmp_path / "images" / "cam0" / "0.jpg")
    picture(tmp_path / "masks" / "cam0" / "0.jpg.png")
    assert find_images(tmp_path) == ["images/cam0/0.jpg"]


@pytest.mark.parametrize(
    "make, message", [("none", "no such folder"), ("empty", "an empty folder"), ("text", "none of them an image")]
)
def test_no_images_is_an_error_with_a_remedy(tmp_path: Path, make: str, message: str) -> None:
    folder = tmp_path / "in"
    if make != "none":
        folder.mkdir()
    if make == "text":
        (folder / "a.txt").write_text("x")
    with pytest.raises(InputError, match=message):
        find_images(folder)


def test_a_file_instead_of_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a file"):
        find_images(picture(tmp_path / "a.jpg"))


def test_probe_of_a_good_image_is_picklable_and_small(tmp_path: Path) -> None:
    probe = probe_image(picture(tmp_path / "a.jpg", (640, 480)), ImageTuning())
    assert (probe.width, probe.height, probe.levels, probe.reason) == (640, 480, EIGHT_BIT, "")
    assert len(pickle.dumps(probe)) < 1000
    assert pickle.loads(pickle.dumps(probe)) == pickle.loads(pickle.dumps(probe)) or np.isnan(probe.exif.focal_px)


@pytest.mark.parametrize("suffix, quality", [(".jpg", {"quality": 90}), (".png", {})])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_truncated_images_are_found(tmp_path: Path, suffix: str, quality: dict, share: float) -> None:
    path = picture(tmp_path / f"a{suffix}", (320, 240), **quality)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert probe_image(path, ImageTuning()).reason != ""


@pytest.mark.parametrize(
    "content, message", [(b"", "zero bytes"), (b"hello", "not an image"), (b"\xff\xd8\xff\xe0" + b"0" * 99, "")]
)
def test_files_that_are_no_images(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(content)
    reason = probe_image(path, ImageTuning()).reason
    assert reason and message in reason


def test_unreadable_and_tiny_images_say_why(tmp_path: Path) -> None:
    (tmp_path / "a.jxl").write_bytes(b"123")
    assert "convert to JPEG" in probe_image(tmp_path / "a.jxl", ImageTuning()).reason
    assert "cannot be read" in probe_image(tmp_path / "absent.jpg", ImageTuning()).reason
    assert "8 x 6 pixels" in probe_image(picture(tmp_path / "b.png", (8, 6)), ImageTuning()).reason


@pytest.mark.parametrize("low, high", [(0, 1000), (0, 65535), (28_500, 31_000)])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("hot", [False, True])
def test_the_levels_of_deep_images_are_what_most_pixels_use(
    tmp_path: Path, low: int, high: int, channels: int, hot: bool
) -> None:
    pixels = np.linspace(low, high, 64 * 64 * channels).astype(np.uint16).reshape(64, 64, channels)
    pixels[..., 3:] = 65535
    if hot:
        pixels[5, 5], pixels[7, 7] = 65535, 0
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    probe = probe_image(tmp_path / "a.png", ImageTuning())
    assert probe.levels == pytest.approx((low, high), abs=0.003 * (high - low)) and probe.reason == ""
    shown = eight_bit(pixels, probe.levels)[..., :3]
    assert shown.dtype == np.uint8 and len(np.unique(shown)) > 250


def test_what_storage_keeps_is_passed_over_and_counted_as_are_images_of_other_names(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.JFIF", "c.jpe", "d.mpo"):
        picture(tmp_path / "one.jpg")
        (tmp_path / "one.jpg").rename(tmp_path / name)
    for name in ("@eaDir/a.jpg", "x/#recycle/b.jpg", "$RECYCLE.BIN/c.jpg"):
        picture(tmp_path / name)
    (tmp_path / "a.jpg_original").write_bytes((tmp_path / "a.jpg").read_bytes())
    (tmp_path / "raw.gif").write_bytes(b"II*\0")
    (tmp_path / "notes.txt").write_text("flown in the morning")
    names, (counted, odd) = search_images(tmp_path)
    assert names == ["a.jpg", "b.JFIF", "c.jpe", "d.mpo", "raw.gif"]
    assert counted.startswith("3 files in 3 folders of the storage passed over, such as ")
    assert odd == "1 files begin like images but are not named so, and are passed over: a.jpg_original"
    assert [p.reason for p in (probe_image(tmp_path / n, ImageTuning()) for n in names)] == ["", "", "", "", (
        ".gif files are not read: convert to JPEG, PNG or TIFF")]  # fmt: skip


def test_exif_position_time_and_focal_length(tmp_path: Path) -> None:
    exif = exif_of(
        make="Canon\0",
        model="EOS",
        time="2023:09:15 10:00:00",
        subsec="25",
        offset="+09:00",
        focal_35mm=50,
        lat=35.5,
        lon=-120.25,
        alt=-3,
    )
    found = probe_image(picture(tmp_path / "a.jpg", (3000, 2000), exif=exif), ImageTuning()).exif
    assert found.focal_px == pytest.approx(50 / 43.27 * np.hypot(3000, 2000), rel=1e-9)
    assert (found.lat_deg, found.lon_deg, found.height_m) == pytest.approx((35.5, -120.25, -3.0), abs=1e-7)
    assert found.time_s == pytest.approx(1694739600.25) and found.time_utc  # 01:00:00.25 UTC
    assert (found.make, found.model) == ("Canon", "EOS")


@pytest.mark.parametrize(("reference", "height"), [(0, 428.0), (1, -428.0), (2, 428.0), (3, -428.0)])
def test_exif_3_heights_below_sea_level(tmp_path: Path, reference: int, height: float) -> None:
    exif = exif_of(lat=31.5, lon=35.5, alt=428)
    exif.get_ifd(0x8825)[5] = bytes([reference])
    assert probe_image(picture(tmp_path / "a.jpg", exif=exif), ImageTuning()).exif.height_m == height


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
        found = probe_image(picture(tmp_path / name, size, exif=exif), ImageTuning()).exif
        assert found.focal_px == pytest.approx(4000.0 * smaller, rel=1e-3)


def test_unbelievable_exif_counts_as_not_written(tmp_path: Path) -> None:
    exif = exif_of(focal_35mm=1, time="0000:00:00 00:00:00", lat=0.0, lon=0.0, alt=0.0)
    found = probe_image(picture(tmp_path / "a.jpg", (1500, 1000), exif=exif), ImageTuning()).exif
    assert np.isnan([found.focal_px, found.time_s, found.lat_deg, found.lon_deg]).all()


def test_phone_photographs_of_a_hill() -> None:
    folder = data("oppaiyama", "images")
    found = probe_image(folder / find_images(folder)[0], ImageTuning()).exif
    # iPhone 5s: 29 mm equivalent on 1224 x 918 pixels; about 1040 px from the sensor's data sheet (4.15 mm on 4.89 mm).
    assert 980 < found.focal_px < 1060
    assert 38.2 < found.lat_deg < 38.3 and 140.9 < found.lon_deg < 141.0
    assert found.position_sigma_m == 5.0 and not found.time_utc
