"""Fisheye images, panoramas and multispectral cameras at the scan: views where the rays say, lenses as one rig."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2
from scan_worlds import data, exif_of, picture, scan

from near import baselines_m
from said import refused, says
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scan.scan import prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.decoding import opaque
from tiegraph.scene.exif import RigTags, relative_rotation
from tiegraph.scene.images import probe_image
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.wideviews import is_equirectangular, lit

SIDE, FOCAL, CIRCLE = 240, 60.0, 100.0
LENS = [FOCAL, FOCAL, SIDE / 2, SIDE / 2, 1e-6, 0, 0, 0]
BACK = {"cam_from_rig_rotation": [0, 0, 1, 0], "cam_from_rig_translation": [0, 0, -0.03]}


def colour(rays: np.ndarray) -> np.ndarray:
    """A smooth picture on the sphere: (..., 3) of unit rays (..., 3) of the rig."""
    x, y, z = np.moveaxis(rays, -1, 0)
    return np.stack([128 + 70 * np.sin(3 * x), 128 + 80 * y, 128 + 70 * np.cos(2 * z + y)], axis=-1)


def two_lenses(folder: Path, frames: int = 3) -> Path:
    """Images of two equidistant lenses back to back, which light a circle of 95.5 degrees off the axis."""
    x, y = np.meshgrid(np.arange(SIDE) + 0.5 - SIDE / 2, np.arange(SIDE) + 0.5 - SIDE / 2)
    off = np.hypot(x, y)
    angle = off / FOCAL
    rays = np.stack([np.sin(angle) * x / off, np.sin(angle) * y / off, np.cos(angle)], axis=-1)
    for name, turn in (("fish_a", 1.0), ("fish_b", -1.0)):
        seen = np.where(off[..., None] < CIRCLE, colour(rays * (turn, 1.0, turn)), 0)
        (folder / name).mkdir(parents=True, exist_ok=True)
        for k in range(frames):
            seen[SIDE // 2, SIDE // 2] = 20 * k  # no two files are equal
            Image.fromarray(seen.round().astype(np.uint8)).save(folder / name / f"{k:03d}.png")
    return folder


def camera(params: list[float]) -> dict:
    return {"camera_model_name": "OPENCV_FISHEYE", "camera_params": params}


def rig_config(path: Path, params: list[float], second: dict | None = None) -> str:
    first = {"image_prefix": "fish_a/", "ref_sensor": True, **camera(params)}
    other = {"image_prefix": "fish_b/", **(second or BACK), **camera(params)}
    path.write_text(json.dumps([{"cameras": [first, other]}]))
    return str(path)


@pytest.mark.slow
def test_two_lenses_back_to_back_become_level_views_all_round(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in")
    scene = scan(images, rig=rig_config(tmp_path / "rig_config.json", LENS))
    rig = scene.rigs[0]
    assert (len(scene), scene.frames, len(rig.sensors), rig.fixed) == (18, 3, 6, True)
    assert "fish_b/left/001.png" in scene.names
    assert {scene.source_name(k) for k in range(18)} == {f"fish_{s}/{k:03d}.png" for s in "ab" for k in range(3)}
    assert np.allclose(baselines_m(rig)[:3, :3], 0) and np.allclose(baselines_m(rig)[:3, 3:], 0.03)
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    a, b = np.cos(np.radians(42)), np.sin(np.radians(42))
    assert np.allclose(axes[:3], [[0, 0, 1], [a, 0, b], [-a, 0, b]])
    assert np.allclose(axes[3:], axes[:3] * (-1, 1, -1))
    source = rig.sensors[4].source
    assert source.view.name == "fish_b"
    x, y, radius = source.circle_px or (0, 0, 0)
    assert abs(x - 120) < 1 and abs(y - 120) < 1 and 0.95 * CIRCLE < radius < 0.99 * CIRCLE
    assert Scene.from_json(scene.to_json()).rigs[0].sensors[4].source == source
    assert says(scene.notes, "cut into views")


@pytest.mark.slow
def test_views_show_what_the_rig_sees_there(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=1)
    scene = scan(images, rig=rig_config(tmp_path / "rig_config.json", LENS))
    for k, name in enumerate(scene.names):
        sensor = scene.sensor_of(k)
        prepare_image(images / scene.source_name(k), tmp_path / name, sensor, ScanSettings())
        with Image.open(tmp_path / name) as file:
            seen = np.asarray(file, float)
        view, pose, used = sensor.camera, sensor.sensor_from_rig, lit(sensor, 80.0)
        assert pose is not None and seen.shape[:2] == (view.height, view.width)
        px = np.stack(np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5), axis=-1)
        rays = np.concatenate([view.cam_from_img(px.reshape(-1, 2)), np.ones((px[..., 0].size, 1))], axis=1)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ pose[:3, :3]
        error = np.abs(seen - colour(rays).reshape(seen.shape)).max(axis=2)
        inside = np.ones(error.shape, bool) if used is None else used
        assert inside.mean() > 0.95 and np.quantile(error[inside], 0.99) < 3


@pytest.mark.slow
def test_a_guessed_lens_stays_whole_and_says_so(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in")
    guessed = scan(images)
    assert len(guessed.all_sensors) == 2 and says(guessed.notes, "not calibrated")
    cameras = [s.camera for s in guessed.all_sensors if s.camera is not None]  # by their circles: no name says fisheye
    assert [c.model.name for c in cameras] == ["OPENCV_FISHEYE"] * 2 and not cameras[0].has_prior_focal_length
    assert all(0.98 < c.mean_focal_length() / (CIRCLE / np.radians(100)) < 1.02 for c in cameras)
    assert all(s.source is not None and s.source.circle_px is not None for s in guessed.all_sensors)
    with refused(r"scan.fisheye = views.*fish_a.*not calibrated"):
        scan(images, ScanSettings(fisheye="views"))


@pytest.mark.slow
def test_what_the_user_asks_for_holds_and_a_narrow_fisheye_stays_whole(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=1)
    rig = rig_config(tmp_path / "rig_config.json", LENS)
    assert len(scan(images, ScanSettings(fisheye="whole"), rig=rig).all_sensors) == 2
    straight = rig_config(tmp_path / "straight.json", [*LENS[:4], 0, 0, 0, 0])
    assert len(scan(images, ScanSettings(fisheye="views"), rig=straight).all_sensors) == 6
    narrow = scan(images, rig=rig_config(tmp_path / "narrow.json", [2 * FOCAL, 2 * FOCAL, *LENS[2:]]))
    assert len(narrow.all_sensors) == 2 and not says(narrow.notes, "fisheye images")


@pytest.mark.slow
def test_a_lens_alone_is_cut_all_round_its_axis(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=2) / "fish_a"
    lens = [{"cameras": [{"image_prefix": "", "ref_sensor": True, **camera(LENS)}]}]
    (tmp_path / "lens.json").write_text(json.dumps(lens))
    rig, a, b = scan(images, rig=str(tmp_path / "lens.json")).rigs[0], np.cos(np.radians(47)), np.sin(np.radians(47))
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    assert np.allclose(axes, [[0, 0, 1], [a, 0, b], [-a, 0, b], [0, -a, b], [0, a, b]]) and rig.fixed


@pytest.mark.slow
def test_lenses_that_lie_on_their_sides_have_level_views_too(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=1)
    rolled = {"cam_from_rig_rotation": [0, 1, 0, 0], "cam_from_rig_translation": [0, 0, -0.03]}
    rig = scan(images, rig=rig_config(tmp_path / "rig.json", LENS, rolled)).rigs[0]
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    assert np.allclose(axes[:, 0], 0) and np.allclose(np.sort(axes[:3, 1]), [-0.743, 0, 0.743], atol=1e-3)
    assert np.allclose(np.abs([s.sensor_from_rig[1, 0] for s in rig.sensors]), 1)  # down is along the lens' x


@pytest.mark.slow
def test_a_real_fisheye_rig_is_cut() -> None:
    folder = data("kerry_park_360rig")
    scene = scan(folder, rig=str(folder / "rig_config.json"))
    assert (len(scene), scene.frames, scene.dropped) == (144, 24, ())
    radii = [s.source.circle_px[2] for s in scene.all_sensors if s.source is not None and s.source.circle_px]
    assert len(radii) == 6 and min(radii) > 235 and max(radii) < 247


def side_by_side(folder: Path, frames: int = 3, behind: bytes = b"") -> Path:
    """The same images as a 360 camera writes them: JPEG with both circles, called .insp, and what is ``behind`` it."""
    halves = two_lenses(folder.with_name("halves"), frames)
    folder.mkdir()
    for k in range(frames):
        both = [np.asarray(Image.open(halves / f"fish_{s}" / f"{k:03d}.png")) for s in "ab"]
        path = folder / f"IMG_{k:03d}.insp"
        Image.fromarray(np.hstack(both)).save(path, "JPEG", quality=97)
        path.write_bytes(path.read_bytes() + behind)
    return folder


FACTORY = b"\x12\x342_100.5_120.1_119.8_0.188_-0.029_%s_100.2_360.2_120.3_-0.326_-0.038_%s_480_240_1137\x00"


@pytest.mark.slow
def test_two_circles_side_by_side_are_two_lenses_back_to_back(tmp_path: Path) -> None:
    images = side_by_side(tmp_path / "in")
    scene = scan(images)
    rig = scene.rigs[0]
    assert (len(scene), scene.frames, rig.nominal, rig.synchronised) == (6, 3, True, True)
    assert sorted(scene.names)[0] == "lens0/IMG_000.jpg" and scene.source_name(0) == "IMG_000.insp"
    assert np.allclose(rig.sensors[1].sensor_from_rig, np.diag([-1, 1, -1, 1])) and scene.sequences == ("all",)
    for k, sensor in enumerate(rig.sensors):
        camera, source = sensor.camera, sensor.source
        assert camera is not None and source is not None and source.part == k
        assert (camera.model.name, camera.width, camera.height) == ("OPENCV_FISHEYE", SIDE, SIDE)
        assert 0.98 < camera.mean_focal_length() / (CIRCLE / np.radians(100)) < 1.02  # the true one is 60, not 57
        x, y, radius = source.circle_px or (0, 0, 0)
        assert abs(x - 120) < 1 and abs(y - 120) < 1 and 0.95 * CIRCLE < radius < 0.99 * CIRCLE
        assert sensor.camera_sigma_px and Scene.from_json(scene.to_json()).rigs[0].sensors[k].source == source
    for name in ("lens0/IMG_001.jpg", "lens1/IMG_001.jpg"):
        sensor = scene.sensor_of(scene.image_index[name])
        prepare_image(images / "IMG_001.insp", tmp_path / name, sensor, ScanSettings())
        with Image.open(tmp_path / name) as made, Image.open(images / "IMG_001.insp") as whole:
            left = SIDE * int(name[4])
            expected = np.asarray(whole.crop((left, 0, left + SIDE, SIDE)), float)
            assert np.abs(np.asarray(made, float) - expected).mean() < 2
    assert says(scene.notes, "taken as upright")


@pytest.mark.slow
@pytest.mark.parametrize(("roll", "second"), [(b"89.9", [1, -1, -1]), (b"0.1", [-1, 1, -1]), (b"-90.0", [1, -1, -1])])
def test_the_factory_says_how_the_lenses_are_rolled(tmp_path: Path, roll: bytes, second: list[int]) -> None:
    rig = scan(side_by_side(tmp_path / "in", 2, FACTORY % (roll, roll))).rigs[0]
    assert np.allclose(rig.sensors[1].sensor_from_rig, np.diag([*second, 1]))


@pytest.mark.slow
def test_a_rig_file_for_two_circles_side_by_side(tmp_path: Path) -> None:
    images = side_by_side(tmp_path / "in")
    rig = rig_config(tmp_path / "rig_config.json", LENS)
    scene = scan(images, rig=rig)
    assert (len(scene), scene.frames, scene.rigs[0].fixed) == (18, 3, True)
    for k in (0, 17):
        target = tmp_path / scene.names[k]
        prepare_image(images / scene.source_name(k), target, scene.sensor_of(k), ScanSettings())
        with Image.open(target) as file:
            assert np.asarray(file).mean() > 90
    one = tmp_path / "one.json"
    one.write_text(json.dumps([{"cameras": json.loads(Path(rig).read_text())[0]["cameras"][:1]}]))
    for given, words in (
        ("ring:5", "--rig ring:5: the files hold two fisheye images"),
        (str(one), r"1 sensor\(s\), but the files hold two fisheye images"),
    ):
        with refused(words):
            scan(images, rig=given)


def sphere(focal_px: float = FOCAL, middle: float = SIDE / 2) -> bytes:
    """The factory's newer words for two lenses of the images here: a unified sphere fitted to the equidistant lens."""
    angle = np.radians(np.arange(1, 100))
    m = np.tan(angle / 2)  # sin / (cos + xi), xi = 1
    f, *k = np.linalg.lstsq(np.stack([m, m**3, m**5, m**7], axis=1), focal_px * angle, rcond=None)[0]
    lens = f"1.0_{f:.3f}_{f:.3f}_{{}}_{middle}_0.1_-0.2_0.3_0.0_0.0_-0.03_"
    lens += "_".join(f"{v / f:.8f}" for v in (*k, 0, 0)) + "_480_240_113"
    return f"\x01\x022_{lens.format(middle)}_{lens.format(middle + 240)}_{(3 << 16) + 1024}\0".encode()


@pytest.mark.slow
def test_the_distortion_starts_from_what_the_factory_measured(tmp_path: Path) -> None:
    old = FACTORY % (b"0.1", b"0.2")
    scene = scan(side_by_side(tmp_path / "in", 2, old + sphere()))
    assert [s.name for s in scene.all_sensors] == ["lens0", "lens1"] and scene.rigs[0].nominal
    rays = np.array([[np.sin(a), 0, np.cos(a)] for a in np.radians([20, 50, 80])])
    for sensor in scene.all_sensors:
        assert sensor.camera is not None and sensor.camera_sigma_px == pytest.approx(0.01 * FOCAL, rel=0.01)
        at = np.asarray(sensor.camera.img_from_cam(rays))
        expected = 120 + FOCAL * np.radians([20, 50, 80])
        assert np.allclose(at[:, 0], expected, atol=0.15) and np.allclose(at[:, 1], 120)
    assert says(scene.notes, "their initial distortion is the factory's")
    assert any(
        "used whole" in n and "its calibration is an initial value" in n for n in scene.notes
    )  # views hold their lens
    assert len(scan(tmp_path / "in", ScanSettings(fisheye="views")).all_sensors) == 6


@pytest.mark.slow
@pytest.mark.parametrize("words", [sphere(focal_px=52.0), sphere(middle=125.0), sphere().replace(b"1.0_", b"-9.0_")])
def test_what_does_not_fit_the_circles_is_not_used_and_said(tmp_path: Path, words: bytes) -> None:
    scene = scan(side_by_side(tmp_path / "in", 2, words))
    assert all(s.camera is not None and not np.any(s.camera.params[4:]) for s in scene.all_sensors)
    assert says(scene.notes, "the factory's values do not fit the circles")


def colour_panorama(rays: np.ndarray, turn: float) -> np.ndarray:
    """A smooth picture on the sphere: (..., 3) of unit rays (..., 3)."""
    x, y, z = np.moveaxis(rays, -1, 0)
    x, z = np.cos(turn) * x - np.sin(turn) * z, np.sin(turn) * x + np.cos(turn) * z
    return np.stack([128 + 60 * np.sin(5 * x), 128 + 90 * y, 128 + 60 * np.cos(4 * z + y)], axis=-1)


@lru_cache(maxsize=4)
def sphere_panorama(turn: float, width: int = 1200) -> np.ndarray:
    """All of ``colour``, turned about the vertical, as a panorama (width / 2, width, 3)."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 360
    latitude = (0.5 - (np.arange(width // 2) + 0.5) / (width // 2)) * 180
    return colour_panorama(rays_of(np.array(np.meshgrid(longitude, latitude))), turn).round().astype(np.uint8)


def panorama(path: Path, turn: float, width: int = 1200, **save: object) -> Path:
    """A file of ``sphere``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(sphere_panorama(turn, width)).save(path, quality=95, **save)
    return path


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Scene]:
    folder = tmp_path_factory.mktemp("walk")
    for k in range(4):
        panorama(folder / f"p{k:02d}.jpg", 0.3 * k, exif=exif_of(lat=35.0, lon=139.0 + 1e-5 * k, alt=10.0))
    picture(folder / "portrait.jpg")
    return folder, scan(folder)


@pytest.mark.slow
def test_each_panorama_is_a_frame_of_views_with_one_centre(walk: tuple[Path, Scene]) -> None:
    _, scene = walk
    assert (len(scene), scene.frames, scene.sequences != ()) == (24, 4, True)
    rig = scene.rigs[0]
    assert rig.fixed and rig.known() and [s.role for s in rig.sensors] == ["side"] * 5 + ["up"]
    assert np.allclose(baselines_m(rig), 0)
    angles = rig.axis_angles_deg()
    assert np.allclose(angles[0, 1:], [72, 144, 144, 72, 90])
    assert {scene.source_name(k) for k in range(24)} == {f"p{k:02d}.jpg" for k in range(4)}
    assert [d.name for d in scene.dropped] == ["portrait.jpg"]
    assert says(scene.notes, "4 equirectangular panoramas")
    assert scene.prior == "exif" and scene.has_positions()
    assert Scene.from_json(scene.to_json()).rigs[0].sensors[3].source == rig.sensors[3].source


@pytest.mark.slow
def test_views_show_what_their_rays_see(walk: tuple[Path, Scene], tmp_path: Path) -> None:
    folder, scene = walk
    for k in range(len(scene)):
        seen, shown, angles = seen_of(folder, scene, k, tmp_path)
        off = np.abs(seen - colour_panorama(rays_of(angles), 0.3 * int(scene.source_name(k)[1:3])))
        assert shown.all() and off.mean() < 1.5  # JPEG twice
        assert np.quantile(off, 0.999) < 12


def rays_of(angles: np.ndarray) -> np.ndarray:
    """Unit rays (..., 3) of longitudes and latitudes (2, ...) in degrees."""
    lon, lat = np.radians(angles)
    return np.stack([np.cos(lat) * np.sin(lon), -np.sin(lat), np.cos(lat) * np.cos(lon)], axis=-1)


def gpano(width: int, box: tuple[int, int, int, int], scale: float = 1.0) -> bytes:
    """XMP of a part (left, top, columns, rows) of a panorama, as the program wrote it before a change of size."""
    left, top, columns, rows = (round(v / scale) for v in box)
    of_file = {"ImageWidthPixels": columns, "ImageHeightPixels": rows, "LeftPixels": left, "TopPixels": top}
    tags = {"FullPanoWidthPixels": width / scale, "FullPanoHeightPixels": width / 2 / scale}
    tags |= {f"CroppedArea{tag}": value for tag, value in of_file.items()}
    said = "".join(f'GPano:{k}="{round(v)}" ' for k, v in tags.items())
    return f'<x:xmpmeta><rdf:Description GPano:ProjectionType="equirectangular" {said}/></x:xmpmeta>'.encode()


def seen_of(folder: Path, scene: Scene, k: int, target: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Prepared pixels (H, W, 3) of an image, what is not masked of it (H, W), and longitude and latitude (2, H, W) of
    its rays, degrees."""
    prepare_image(folder / scene.source_name(k), target / scene.names[k], scene.sensor_of(k), ScanSettings())
    with Image.open(target / scene.names[k]) as file:
        pixels = np.asarray(file.convert("RGB"), float)
    shown = opaque(target / scene.names[k])
    camera, source = scene.sensor_of(k).camera, scene.sensor_of(k).source
    assert source is not None and pixels.shape[:2] == (camera.height, camera.width)
    px = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
    rays = np.concatenate([camera.cam_from_img(px.reshape(-1, 2)), np.ones((px[..., 0].size, 1))], axis=1)
    x, y, z = (rays / np.linalg.norm(rays, axis=1, keepdims=True) @ np.reshape(source.panorama, (3, 3))).T.reshape(
        3, *pixels.shape[:2]
    )
    angles = np.degrees([np.arctan2(x, z), -np.arcsin(y)])
    return pixels, np.ones(px.shape[:2], bool) if shown is None else shown, angles


@pytest.mark.slow
@pytest.mark.parametrize(
    "left, top, columns, rows, scale, views",
    [
        (0, 150, 1200, 300, 1.0, 6),  # a band of 90 degrees
        (300, 150, 600, 300, 1.0, 4),  # 2:1
        (900, 60, 600, 400, 1.0, 5),  # over the seam
        (0, 150, 1200, 300, 0.5, 6),  # made half as large since its tags were written
        (0, 0, 1200, 600, 1.0, 6),  # all of it
    ],
)
def test_a_part_of_a_panorama_is_where_its_tags_say(
    tmp_path: Path, left: int, top: int, columns: int, rows: int, scale: float, views: int
) -> None:
    for k in range(2):
        twice = np.tile(sphere_panorama(0.3 * k), (1, 2, 1))
        part = Image.fromarray(twice[top : top + rows, left : left + columns])
        part.save(tmp_path / f"p{k}.jpg", quality=95, xmp=gpano(1200, (left, top, columns, rows), scale))
    scene = scan(tmp_path)
    assert (len(scene), scene.frames) == (2 * views, 2) and scene.rigs[0].fixed
    turns = [np.reshape(s.source.panorama, (3, 3)) for s in scene.rigs[0].sensors]
    for turn, sensor in zip(turns, scene.rigs[0].sensors):
        np.testing.assert_allclose(sensor.sensor_from_rig[:3, :3], turn @ turns[0].T, atol=1e-12)
    for k in range(0, len(scene), 2):
        pixels, shown, (lon, lat) = seen_of(tmp_path, scene, k, tmp_path / "out")
        column, row = ((lon / 360 + 0.5) * 1200 - left) % 1200, (0.5 - lat / 180) * 600 - top
        inside = (column < columns) & (row > 0) & (row < rows)
        edge = np.minimum.reduce([np.abs(column - columns), column, 1200 - column, np.abs(row), np.abs(row - rows)]) < 3
        assert (shown == inside)[~edge | (columns == 1200) & (np.minimum(row, rows - row) > 3)].all()
        off = np.abs(pixels - colour_panorama(rays_of(np.array([lon, lat])), 0.0))[shown & ~edge]
        assert shown.any() and off.mean() < 2
        assert scene.names[k].endswith(".jpg" if inside.all() else ".png")


@pytest.mark.parametrize(
    "change", [{"left": None}, {"FullPanoHeightPixels": 999}, {"CroppedAreaTopPixels": 500}, {"equi": "cylindrical"}]
)
def test_tags_that_contradict_the_file_are_not_used_and_that_is_said(tmp_path: Path, change: dict) -> None:
    tags = gpano(1200, (0, 150, 1200, 300)).decode()
    for tag, value in change.items():
        tags = tags.replace("equirectangular", str(value)) if tag == "equi" else re.sub(f"{tag}\\S*=\"\\d+\"", "" if
            value is None else f'{tag}="{value}"', tags, flags=re.IGNORECASE)  # fmt: skip
    for k in range(2):
        picture(tmp_path / f"{k}.jpg", (1200, 300), xmp=tags.encode())
    scene = scan(tmp_path)
    assert len(scene) == 2 and len(scene.all_sensors) == 1
    assert any(n.startswith("2 images: tags of a panorama (GPano) that contradict") for n in scene.notes)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_black_poles_and_sides_are_masked(tmp_path: Path, mode: str) -> None:
    for k in range(2):
        pixels = sphere_panorama(0.3 * k).copy()
        pixels[:100], pixels[460:], pixels[:, :30] = 0, 0, 0
        Image.fromarray(pixels).convert(mode).save(tmp_path / f"p{k}.jpg", quality=95)
    scene = scan(tmp_path, rig="panorama")
    assert {n[-4:] for n in scene.names} == {".jpg", ".png"}
    for k in range(0, len(scene), 2):
        _, shown, (lon, lat) = seen_of(tmp_path, scene, k, tmp_path / "out")
        column, row = (lon / 360 + 0.5) * 1200, (0.5 - lat / 180) * 600
        inside = (row > 100) & (row < 460) & (column > 30)
        edge = np.minimum.reduce([np.abs(column - 30), column, 1200 - column, np.abs(row - 100), np.abs(row - 460)]) < 3
        assert (shown == inside)[~edge].all()


@pytest.mark.slow
def test_photographs_of_that_shape_are_no_panoramas(tmp_path: Path) -> None:
    with Image.open(panorama(tmp_path / "p.jpg", 0.5)) as whole:
        assert is_equirectangular(whole)
        part = whole.crop((100, 100, 900, 500)).resize((1200, 600))
        assert not is_equirectangular(part)
        assert not is_equirectangular(whole.resize((1200, 601)))
        assert not is_equirectangular(Image.new("RGB", (1200, 600), (90, 150, 220)))


@pytest.mark.slow
def test_the_user_may_say_so(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / f"{k}.jpg", (1200, 600))
    assert len(scan(tmp_path).all_sensors) == 1
    assert len(scan(tmp_path, rig="panorama").all_sensors) == 6
    picture(tmp_path / "other" / "a.jpg", (640, 480))
    picture(tmp_path / "other" / "b.jpg", (640, 480))
    with refused("640 x 480.*equirectangular"):
        scan(tmp_path / "other", rig="panorama")


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


def test_the_bands_of_a_dji_head_are_a_rig_with_its_colour_camera(tmp_path: Path) -> None:
    for shot in range(3):
        for band in ("G", "R", "RE", "NIR"):
            _tiff(tmp_path / f"DJI_202308_000{shot}_MS_{band}.TIF")
        picture(tmp_path / f"DJI_202308_000{shot}_D.JPG", (96, 72))
    scene = scan(tmp_path)
    rig = _rig(scene)
    assert [s.folder for s in rig.sensors] == ["*_D", "*_MS_G", "*_MS_NIR", "*_MS_R", "*_MS_RE"] and rig.nominal
    assert scene.frames == 3 and len(scene) == 15 and not scene.dropped


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


@pytest.mark.slow
def test_names_alone_do_for_micasense_but_not_for_rows_and_columns(tmp_path: Path) -> None:
    for shot in range(4):
        for index in range(1, 6):
            _tiff(tmp_path / "flight" / f"IMG_{shot:04d}_{index}.tif")
            picture(tmp_path / "wall" / f"photo_{shot}_{index}.jpg")
    rig = _rig(scan(tmp_path / "flight"))
    assert [s.name for s in rig.sensors] == [f"band{k}" for k in range(1, 6)]
    assert len(_rig(scan(tmp_path / "wall")).sensors) == 1


@pytest.mark.parametrize(
    ("name", "folders", "said"),
    [
        ("shot{s}/image_camera{c:02d}.jpg", ["*_camera01", "*_camera02", "*_camera03"], "ends"),
        ("{s:04d}_cam{c}.jpg", ["*_cam1", "*_cam2", "*_cam3"], "ends"),
        ("run/cam{c}_{s:04d}.jpg", ["cam1_*", "cam2_*", "cam3_*"], "beginnings"),
        ("camera{c}-{s:04d}.jpg", ["camera1-*", "camera2-*", "camera3-*"], "beginnings"),
    ],
)
def test_cameras_that_mark_their_files_are_a_rig(name: str, folders: list[str], said: str, tmp_path: Path) -> None:
    for shot in range(4):
        for camera in (1, 2, 3):
            (tmp_path / name.format(s=shot, c=camera)).parent.mkdir(exist_ok=True)
            picture(tmp_path / name.format(s=shot, c=camera))
    scene = scan(tmp_path)
    rig = _rig(scene)
    assert [s.folder for s in rig.sensors] == folders and [s.name for s in rig.sensors] == [
        f.strip("*_-") for f in folders
    ]
    assert scene.frames == 4 and len(scene) == 12 and not scene.dropped
    assert not rig.nominal, "cameras, unlike bands, look anywhere"
    assert says(scene.notes, f"3 cameras that share folders, by the {said} of the file names")


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
    assert probe_image(_tiff(tmp_path / "a.tif", xmp)).exif.rig == tags


# --- lenses ---------------------------------------------------------------------------------------------------------


def _lens(path: Path, name: str, **tags: object) -> None:
    exif = exif_of(make="Apple", model="iPhone 12", **tags)
    exif.get_ifd(0x8769)[0xA434] = name
    picture(path, exif=exif)


@pytest.mark.slow
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
