"""Equirectangular panoramas: recognised, unfolded into views of one centre, rendered where the rays say."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scan_worlds import exif_of, picture, scan

from near import baselines_m
from said import refused, says
from tiegraph.scan.scan import prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.decoding import opaque
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import PanoramaTuning
from tiegraph.scene.wideviews import is_equirectangular


def colour(rays: np.ndarray, turn: float) -> np.ndarray:
    """A smooth picture on the sphere: (..., 3) of unit rays (..., 3)."""
    x, y, z = np.moveaxis(rays, -1, 0)
    x, z = np.cos(turn) * x - np.sin(turn) * z, np.sin(turn) * x + np.cos(turn) * z
    return np.stack([128 + 60 * np.sin(5 * x), 128 + 90 * y, 128 + 60 * np.cos(4 * z + y)], axis=-1)


@lru_cache(maxsize=4)
def sphere(turn: float, width: int = 1200) -> np.ndarray:
    """All of ``colour``, turned about the vertical, as a panorama (width / 2, width, 3)."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 360
    latitude = (0.5 - (np.arange(width // 2) + 0.5) / (width // 2)) * 180
    return colour(rays_of(np.array(np.meshgrid(longitude, latitude))), turn).round().astype(np.uint8)


def panorama(path: Path, turn: float, width: int = 1200, **save: object) -> Path:
    """A file of ``sphere``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(sphere(turn, width)).save(path, quality=95, **save)
    return path


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Scene]:
    folder = tmp_path_factory.mktemp("walk")
    for k in range(4):
        panorama(folder / f"p{k:02d}.jpg", 0.3 * k, exif=exif_of(lat=35.0, lon=139.0 + 1e-5 * k, alt=10.0))
    picture(folder / "portrait.jpg")
    return folder, scan(folder)


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
        off = np.abs(seen - colour(rays_of(angles), 0.3 * int(scene.source_name(k)[1:3])))
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
        twice = np.tile(sphere(0.3 * k), (1, 2, 1))
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
        off = np.abs(pixels - colour(rays_of(np.array([lon, lat])), 0.0))[shown & ~edge]
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
        pixels = sphere(0.3 * k).copy()
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


def test_photographs_of_that_shape_are_no_panoramas(tmp_path: Path) -> None:
    with Image.open(panorama(tmp_path / "p.jpg", 0.5)) as whole:
        assert is_equirectangular(whole, PanoramaTuning())
        part = whole.crop((100, 100, 900, 500)).resize((1200, 600))
        assert not is_equirectangular(part, PanoramaTuning())
        assert not is_equirectangular(whole.resize((1200, 601)), PanoramaTuning())
        assert not is_equirectangular(Image.new("RGB", (1200, 600), (90, 150, 220)), PanoramaTuning())


def test_the_user_may_say_so(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / f"{k}.jpg", (1200, 600))
    assert len(scan(tmp_path).all_sensors) == 1
    assert len(scan(tmp_path, rig="panorama").all_sensors) == 6
    picture(tmp_path / "other" / "a.jpg", (640, 480))
    picture(tmp_path / "other" / "b.jpg", (640, 480))
    with refused("640 x 480.*equirectangular"):
        scan(tmp_path / "other", rig="panorama")
