import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from scan_worlds import picture

from said import refused
from tiegraph.scene.decoding import EIGHT_BIT, eight_bit
from tiegraph.scene.images import find_images, probe_image, search_images
from tiegraph.scene.tuning import ImageTuning


def test_find_images_is_sorted_posix_and_passes_over_hidden_files(tmp_path: Path) -> None:
    for name in ("b/2.JPG", "a/1.png", "a/._1.png", ".hidden/3.jpg", "a/Thumbs.db.jpg"):
        picture(tmp_path / "in" / name, format="PNG")
    (tmp_path / "in" / "Thumbs.db").write_bytes(b"x")
    (tmp_path / "in" / "notes.txt").write_text("x")
    assert find_images(tmp_path / "in") == ["a/1.png", "a/Thumbs.db.jpg", "b/2.JPG"]
    for name in ("images/cam0/0.jpg", "masks/cam0/0.jpg.png"):  # beside masks it is the only one searched
        picture(tmp_path / "set" / name)
    assert find_images(tmp_path / "set") == ["images/cam0/0.jpg"]


def test_no_images_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    for name in ("empty", "texts"):
        (tmp_path / name).mkdir()
    (tmp_path / "texts" / "a.txt").write_text("x")
    picture(tmp_path / "a.jpg")
    for name, message in (
        ("none", "no such folder"),
        ("empty", "an empty folder"),
        ("texts", "none of them an image"),
        ("a.jpg", "is a file"),
    ):
        with refused(message):
            find_images(tmp_path / name)


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


def test_files_that_are_no_images_and_unreadable_or_tiny_ones_say_why(tmp_path: Path) -> None:
    for name, content in (
        ("zero.jpg", b""),
        ("text.jpg", b"hello"),
        ("head.jpg", b"\xff\xd8\xff\xe0" + b"0" * 99),
        ("a.jxl", b"123"),
    ):
        (tmp_path / name).write_bytes(content)
    picture(tmp_path / "tiny.png", (8, 6))
    reasons = {"zero.jpg": "zero bytes", "text.jpg": "not an image", "head.jpg": " ", "a.jxl": "convert to JPEG",
               "absent.jpg": "cannot be read", "tiny.png": "8 x 6 pixels"}  # fmt: skip
    for name, words in reasons.items():
        assert words in probe_image(tmp_path / name, ImageTuning()).reason


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
    images = ["a.jpg", "b.JFIF", "c.jpe", "d.mpo"]
    for name in (*images, "@eaDir/a.jpg", "x/#recycle/b.jpg", "$RECYCLE.BIN/c.jpg"):
        picture(tmp_path / name, format="JPEG")
    (tmp_path / "a.jpg_original").write_bytes((tmp_path / "a.jpg").read_bytes())
    (tmp_path / "raw.gif").write_bytes(b"II*\0")
    (tmp_path / "notes.txt").write_text("flown in the morning")
    names, (counted, odd) = search_images(tmp_path)
    assert names == [*images, "raw.gif"]
    assert counted.startswith("3 files in 3 folders of the storage passed over, such as ")
    assert odd == "1 files begin like images but are not named so, and are passed over: a.jpg_original"
    reasons = [probe_image(tmp_path / n, ImageTuning()).reason for n in names]
    assert reasons == ["", "", "", "", ".gif files are not read: convert to JPEG, PNG or TIFF"]
