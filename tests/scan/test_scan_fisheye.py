"""Fisheye images at the scan: cut into views where the lens is calibrated and sees far aside, else used as they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scan_worlds import data, scan

from tiegraph.errors import InputError
from tiegraph.scan.scan import prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import PicturesTuning
from tiegraph.scene.fisheye import lit
from tiegraph.scene.scene import Scene

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


def rig_config(path: Path, params: list[float], model: str = "OPENCV_FISHEYE") -> str:
    camera = {"camera_model_name": model, "camera_params": params}
    first = {"image_prefix": "fish_a/", "ref_sensor": True, **camera}
    path.write_text(json.dumps([{"cameras": [first, {"image_prefix": "fish_b/", **BACK, **camera}]}]))
    return str(path)


@pytest.mark.slow
def test_a_wide_calibrated_lens_becomes_five_views_with_one_centre(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in")
    scene = scan(images, rig=rig_config(tmp_path / "rig_config.json", LENS))
    rig = scene.rigs[0]
    assert (len(scene), scene.frames, len(rig.sensors), rig.fixed) == (30, 3, 10, True)
    assert "fish_b/left/001.png" in scene.names
    assert {scene.source_name(k) for k in range(30)} == {f"fish_{s}/{k:03d}.png" for s in "ab" for k in range(3)}
    assert np.allclose(rig.baselines_m()[:5, :5], 0) and np.allclose(rig.baselines_m()[:5, 5:], 0.03)
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    s = np.sqrt(0.5)
    assert np.allclose(axes[:5], [[0, 0, 1], [s, 0, s], [-s, 0, s], [0, -s, s], [0, s, s]])
    assert np.allclose(axes[5:], axes[:5] * (-1, 1, -1))
    source = rig.sensors[7].source
    assert source is not None and source.view is not None and source.view.name == "fish_b"
    x, y, radius = source.circle_px or (0, 0, 0)
    assert abs(x - 120) < 1 and abs(y - 120) < 1 and 0.95 * CIRCLE < radius < 0.99 * CIRCLE
    assert Scene.from_json(scene.to_json()).rigs[0].sensors[7].source == source
    assert any("cut into 5 views" in n for n in scene.notes)


@pytest.mark.slow
def test_views_show_what_the_rig_sees_there(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=1)
    scene = scan(images, rig=rig_config(tmp_path / "rig_config.json", LENS))
    for k, name in enumerate(scene.names):
        sensor = scene.sensor_of(k)
        prepare_image(images / scene.source_name(k), tmp_path / name, sensor, ScanSettings(), PicturesTuning())
        with Image.open(tmp_path / name) as file:
            seen = np.asarray(file, float)
        camera, pose, used = sensor.camera, sensor.sensor_from_rig, lit(sensor, 80.0)
        assert camera is not None and pose is not None and seen.shape[:2] == (camera.height, camera.width)
        px = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
        rays = np.concatenate([camera.cam_from_img(px.reshape(-1, 2)), np.ones((px[..., 0].size, 1))], axis=1)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ pose[:3, :3]
        error = np.abs(seen - colour(rays).reshape(seen.shape)).max(axis=2)
        inside = np.ones(error.shape, bool) if used is None else used
        assert inside.mean() > 0.95 and np.quantile(error[inside], 0.99) < 3


@pytest.mark.slow
def test_a_guessed_lens_stays_whole_and_says_so(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in")
    guessed = scan(images, ScanSettings(camera_model="OPENCV_FISHEYE"))
    assert len(guessed.all_sensors) == 2 and any("not calibrated" in n for n in guessed.notes)
    assert all(s.source is not None and s.source.circle_px is not None for s in guessed.all_sensors)
    with pytest.raises(InputError, match=r"scan.fisheye = views.*fish_a.*not calibrated"):
        scan(images, ScanSettings(camera_model="OPENCV_FISHEYE", fisheye="views"))


def test_what_the_user_asks_for_holds(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=1)
    rig = rig_config(tmp_path / "rig_config.json", LENS)
    assert len(scan(images, ScanSettings(fisheye="whole"), rig=rig).all_sensors) == 2
    straight = rig_config(tmp_path / "straight.json", [*LENS[:4], 0, 0, 0, 0])
    assert len(scan(images, ScanSettings(fisheye="views"), rig=straight).all_sensors) == 10


def test_a_narrow_fisheye_stays_whole(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in")
    rig = rig_config(tmp_path / "rig_config.json", [2 * FOCAL, 2 * FOCAL, *LENS[2:]])
    scene = scan(images, rig=rig)
    assert len(scene.all_sensors) == 2 and not any("fisheye images" in n for n in scene.notes)


@pytest.mark.slow
def test_a_real_fisheye_rig_is_cut() -> None:
    folder = data("kerry_park_360rig")
    scene = scan(folder, rig=str(folder / "rig_config.json"))
    assert (len(scene), scene.frames, scene.dropped) == (240, 24, ())
    radii = [s.source.circle_px[2] for s in scene.all_sensors if s.source is not None and s.source.circle_px]
    assert len(radii) == 10 and min(radii) > 235 and max(radii) < 247
