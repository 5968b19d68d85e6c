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
from tiegraph.scene.rig import Sensor, Source

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
