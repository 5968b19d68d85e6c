"""Images: found, probed, and prepared for the other stages: linked, turned, cropped, undistorted."""

import pickle
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image, ImageOps
from scan_worlds import exif_of, picture, scan

from said import refused
from tiegraph.scan.prepare import crop_camera, pinhole_camera, prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.decoding import EIGHT_BIT, eight_bit
from tiegraph.scene.images import find_images, probe_image, search_images
from tiegraph.scene.rig import Sensor, Source


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
    probe = probe_image(picture(tmp_path / "a.jpg", (640, 480)))
    assert (probe.width, probe.height, probe.levels, probe.reason) == (640, 480, EIGHT_BIT, "")
    assert len(pickle.dumps(probe)) < 1000
    assert pickle.loads(pickle.dumps(probe)) == pickle.loads(pickle.dumps(probe)) or np.isnan(probe.exif.focal_px)


@pytest.mark.parametrize("suffix, quality", [(".jpg", {"quality": 90}), (".png", {})])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_truncated_images_are_found(tmp_path: Path, suffix: str, quality: dict, share: float) -> None:
    path = picture(tmp_path / f"a{suffix}", (320, 240), **quality)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    assert probe_image(path).reason != ""


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
        assert words in probe_image(tmp_path / name).reason


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
    probe = probe_image(tmp_path / "a.png")
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
    assert counted.startswith("3 files in 3 folders of the storage skipped, such as ")
    assert odd == "1 files begin like images but have other names, and are skipped: a.jpg_original"
    reasons = [probe_image(tmp_path / n).reason for n in names]
    assert reasons == ["", "", "", "", ".gif files are not read: convert to JPEG, PNG or TIFF"]


PLAIN = Sensor("camera")


def prepared(source: Path, sensor: Sensor = PLAIN, settings: ScanSettings | None = None, name: str = "") -> Path:
    target = source.parent / "out" / "deep" / (name or source.name)
    prepare_image(source, target, sensor, settings or ScanSettings())
    assert [p.name for p in target.parent.iterdir()] == [target.name]
    return target


@pytest.mark.parametrize(
    "mode, suffix", [("RGB", ".jpg"), ("L", ".jpg"), ("RGB", ".png"), ("L", ".tif"), ("RGB", ".bmp")]
)
def test_common_images_are_linked_or_where_that_fails_copied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str, suffix: str
) -> None:
    source = picture(tmp_path / f"a{suffix}", mode=mode)
    target = prepared(source)
    assert target.is_symlink() and target.resolve() == source.resolve()
    assert prepared(source).read_bytes() == source.read_bytes()  # again, over the first

    def refuse(*_: object) -> None:
        raise OSError("no links here")

    for name in ("os.symlink", "os.link"):
        monkeypatch.setattr(name, refuse)
    target = prepared(source)
    assert not target.is_symlink() and target.read_bytes() == source.read_bytes()


@pytest.mark.parametrize(
    "mode, suffix, channels",
    [("RGBA", ".png", 3), ("CMYK", ".jpg", 3), ("P", ".png", 3), ("LA", ".png", 1), ("1", ".png", 1)],
)
def test_odd_modes_become_eight_bit_grey_or_rgb(tmp_path: Path, mode: str, suffix: str, channels: int) -> None:
    source = picture(tmp_path / f"a{suffix}", mode=mode)
    target = prepared(source)
    assert not target.is_symlink()
    with Image.open(target) as image:
        assert len(image.getbands()) == channels and image.mode in ("L", "RGB")
        want = np.asarray(Image.open(source).convert(image.mode), int)
        assert np.abs(np.asarray(image, int) - want).mean() < 3


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_twelve_bit_images_keep_their_brightness(tmp_path: Path, channels: int) -> None:
    pixels = np.full((64, 64, channels), 2048, np.uint16)
    pixels[:, 32:, 0] = 1024
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    target = prepared(tmp_path / "a.png", Sensor("camera", source=Source(levels=(0, 4095))))
    out = cv2.imread(str(target), cv2.IMREAD_UNCHANGED)
    assert out.dtype == np.uint8 and out.reshape(64, 64, -1)[0, 0].tolist() == [128] * (1 if channels == 1 else 3)
    assert out.reshape(64, 64, -1)[0, 40, 0] == 64


@pytest.mark.parametrize("orientation", range(2, 9))
def test_turned_images_stand_upright_for_every_reader(tmp_path: Path, orientation: int) -> None:
    source = picture(tmp_path / "a.png", (80, 48), exif=exif_of(orientation=orientation))
    target = prepared(source)
    want = np.asarray(ImageOps.exif_transpose(Image.open(source)))
    with Image.open(target) as image:
        assert image.getexif().get(0x0112, 1) == 1
        np.testing.assert_array_equal(np.asarray(image), want)
    kept = prepared(source, Sensor("camera", source=Source(upright=False)))
    np.testing.assert_array_equal(cv2.imread(str(kept))[:, :, ::-1], np.asarray(Image.open(source)))


def test_crop_moves_the_principal_point(tmp_path: Path) -> None:
    camera = pycolmap.Camera(model="OPENCV", width=64, height=48, params=[60, 61, 32, 24, 0, 0, 0, 0])
    smaller = crop_camera(camera, 4, 6, 10, 2)
    assert (smaller.width, smaller.height) == (50, 40)
    assert list(smaller.params[:4]) == [60, 61, 28, 18]
    source = picture(tmp_path / "a.png")
    target = prepared(source, Sensor("camera", smaller, source=Source(camera, (4, 6, 10, 2))))
    np.testing.assert_array_equal(np.asarray(Image.open(target)), np.asarray(Image.open(source))[6:46, 4:54])


@pytest.mark.parametrize(
    "model, extra", [("OPENCV", [-0.2, 0.05, 0.002, -0.001]), ("OPENCV_FISHEYE", [0.02, -0.01, 0.002, 0.0])]
)
def test_undistorted_pixels_are_where_the_pinhole_camera_says(tmp_path: Path, model: str, extra: list[float]) -> None:
    camera = pycolmap.Camera(model=model, width=320, height=240, params=[200, 201, 163, 118, *extra])
    pinhole = pinhole_camera(camera)
    points = np.array([[x, y, 1.0] for x in (-0.5, 0.1, 0.45) for y in (-0.35, 0.0, 0.3)])
    image = np.zeros((240, 320), np.float32)
    yy, xx = np.mgrid[:240, :320] + 0.5
    for u, v in camera.img_from_cam(points):
        image += np.exp(-((xx - u) ** 2 + (yy - v) ** 2) / 8)
    Image.fromarray((255 * image).astype(np.uint8)).save(tmp_path / "a.png")
    target = prepared(
        tmp_path / "a.png", Sensor("camera", pinhole, source=Source(camera)), ScanSettings(undistort=True)
    )
    out = np.asarray(Image.open(target), float)
    assert out.shape == (pinhole.height, pinhole.width)
    yy, xx = np.mgrid[: out.shape[0], : out.shape[1]] + 0.5
    for u, v in pinhole.img_from_cam(points):
        weight = out * ((xx - u) ** 2 + (yy - v) ** 2 < 49)
        centre = np.array([(weight * xx).sum(), (weight * yy).sum()]) / weight.sum()
        assert np.linalg.norm(centre - (u, v)) < 0.35  # px; blobs lose a little of their symmetry


@pytest.mark.slow
def test_scene_camera_is_that_of_the_prepared_image(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / "in" / f"{k}.png", (320, 240))
    lens = "model = 'OPENCV'\nsize = [640, 480]\nparams = [500, 500, 320, 240, -0.1, 0.01, 0, 0]\n"
    (tmp_path / "rig.toml").write_text(f"[[sensors]]\nname = 'c'\ncrop_px = [10, 0, 0, 20]\n[sensors.camera]\n{lens}")
    settings = ScanSettings(undistort=True)
    sensor = scan(tmp_path / "in", settings, rig=str(tmp_path / "rig.toml")).sensor_of(0)
    target, camera = prepared(tmp_path / "in" / "0.png", sensor, settings), sensor.camera
    assert camera.model.name == "PINHOLE" and camera.has_prior_focal_length
    assert Image.open(target).size == (camera.width, camera.height)
    assert camera.params[0] == pytest.approx(250)
    with refused("scan again"):  # a source that went away
        prepare_image(tmp_path / "gone.jpg", tmp_path / "out" / "gone.jpg", PLAIN, ScanSettings())
