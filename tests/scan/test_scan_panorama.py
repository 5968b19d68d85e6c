"""Equirectangular panoramas: recognised, unfolded into views of one centre, rendered where the rays say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scan_worlds import exif_of, picture, scan

from near import baselines_m
from tiegraph.errors import InputError
from tiegraph.scan.scan import prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.images import is_equirectangular
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import PanoramaTuning


def colour(rays: np.ndarray, turn: float) -> np.ndarray:
    """A smooth picture on the sphere: (..., 3) of unit rays (..., 3)."""
    x, y, z = np.moveaxis(rays, -1, 0)
    x, z = np.cos(turn) * x - np.sin(turn) * z, np.sin(turn) * x + np.cos(turn) * z
    return np.stack([128 + 60 * np.sin(5 * x), 128 + 90 * y, 128 + 60 * np.cos(4 * z + y)], axis=-1)


def panorama(path: Path, turn: float, width: int = 1200, **save: object) -> Path:
    """A panorama of ``colour``, turned about the vertical."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    latitude = (0.5 - (np.arange(width // 2) + 0.5) / (width // 2)) * np.pi
    longitude, latitude = np.meshgrid(longitude, latitude)
    flat = np.cos(latitude)
    rays = np.stack([flat * np.sin(longitude), -np.sin(latitude), flat * np.cos(longitude)], axis=-1)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(colour(rays, turn).round().astype(np.uint8)).save(path, quality=95, **save)
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
    assert any("4 equirectangular panoramas" in n for n in scene.notes)
    assert scene.prior == "exif" and scene.has_positions()
    assert Scene.from_json(scene.to_json()).rigs[0].sensors[3].source == rig.sensors[3].source


@pytest.mark.slow
def test_views_show_what_their_rays_see(walk: tuple[Path, Scene], tmp_path: Path) -> None:
    folder, scene = walk
    for k in range(len(scene)):
        sensor, frame = scene.sensor_of(k), int(scene.source_name(k)[1:3])
        prepare_image(folder / scene.source_name(k), tmp_path / scene.names[k], sensor, ScanSettings())
        with Image.open(tmp_path / scene.names[k]) as file:
            seen = np.asarray(file, float)
        camera = sensor.camera
        assert camera is not None and seen.shape[:2] == (camera.height, camera.width)
        px = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
        rays = np.concatenate([camera.cam_from_img(px.reshape(-1, 2)), np.ones((px[..., 0].size, 1))], axis=1)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ sensor.sensor_from_rig[:3, :3]
        expected = colour(rays, 0.3 * frame).reshape(seen.shape)
        assert np.abs(seen - expected).mean() < 1.5  # JPEG twice
        assert np.quantile(np.abs(seen - expected), 0.999) < 12


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
    with pytest.raises(InputError, match="640 x 480.*equirectangular"):
        scan(tmp_path / "other", rig="panorama")
