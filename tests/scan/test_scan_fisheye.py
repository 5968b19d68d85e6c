"""Fisheye images at the scan: cut into views where the lens is calibrated and sees far aside, else used as they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scan_worlds import data, scan

from near import baselines_m
from said import refused, says
from tiegraph.scan.scan import prepare_image
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.scene import Scene
from tiegraph.scene.wideviews import lit

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


def test_what_the_user_asks_for_holds_and_a_narrow_fisheye_stays_whole(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=1)
    rig = rig_config(tmp_path / "rig_config.json", LENS)
    assert len(scan(images, ScanSettings(fisheye="whole"), rig=rig).all_sensors) == 2
    straight = rig_config(tmp_path / "straight.json", [*LENS[:4], 0, 0, 0, 0])
    assert len(scan(images, ScanSettings(fisheye="views"), rig=straight).all_sensors) == 6
    narrow = scan(images, rig=rig_config(tmp_path / "narrow.json", [2 * FOCAL, 2 * FOCAL, *LENS[2:]]))
    assert len(narrow.all_sensors) == 2 and not says(narrow.notes, "fisheye images")


def test_a_lens_alone_is_cut_all_round_its_axis(tmp_path: Path) -> None:
    images = two_lenses(tmp_path / "in", frames=2) / "fish_a"
    lens = [{"cameras": [{"image_prefix": "", "ref_sensor": True, **camera(LENS)}]}]
    (tmp_path / "lens.json").write_text(json.dumps(lens))
    rig, a, b = scan(images, rig=str(tmp_path / "lens.json")).rigs[0], np.cos(np.radians(47)), np.sin(np.radians(47))
    axes = np.stack([s.optical_axis() for s in rig.sensors])
    assert np.allclose(axes, [[0, 0, 1], [a, 0, b], [-a, 0, b], [0, -a, b], [0, a, b]]) and rig.fixed


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


@pytest.mark.parametrize("words", [sphere(focal_px=52.0), sphere(middle=125.0), sphere().replace(b"1.0_", b"-9.0_")])
def test_what_does_not_fit_the_circles_is_not_used_and_said(tmp_path: Path, words: bytes) -> None:
    scene = scan(side_by_side(tmp_path / "in", 2, words))
    assert all(s.camera is not None and not np.any(s.camera.params[4:]) for s in scene.all_sensors)
    assert says(scene.notes, "the factory's values do not fit the circles")
