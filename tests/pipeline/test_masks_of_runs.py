"""Masks of a run: of another source, of the user, the reference, and what a lens does not light."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

import tiegraph
from masks_world import write
from said import refused
from tiegraph.errors import SettingsError
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.masks.tuning import Meguro2024Tuning, Tuning
from tiegraph.pipeline.evaluate import _masks
from tiegraph.pipeline.files import FINAL
from tiegraph.pipeline.inputs import check_against
from tiegraph.pipeline.masks import masks_by
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene

SIDE = 160


def lenses(folder: Path, radius: float) -> Path:
    """Two frames of a lens that lights a circle, with a focal length that shows 2 rad at its rim."""
    x, y = np.meshgrid(np.arange(SIDE) + 0.5 - SIDE / 2, np.arange(SIDE) + 0.5 - SIDE / 2)
    folder.mkdir(parents=True)
    for k in range(2):
        picture = np.random.default_rng(k).integers(90, 255, (SIDE, SIDE, 3), dtype=np.uint8)
        picture[np.hypot(x, y) > radius] = 0
        cv2.imwrite(str(folder / f"{k}.png"), picture)
    return folder


def rig(path: Path, distortion: float) -> Path:
    params = [40.0, 40.0, SIDE / 2, SIDE / 2, distortion, 0, 0, 0]
    camera = {"image_prefix": "", "ref_sensor": True, "camera_model_name": "OPENCV_FISHEYE", "camera_params": params}
    path.write_text(json.dumps([{"cameras": [camera]}]))
    return path


def used(out: Path, name: str) -> np.ndarray:
    mask = cv2.imread(str(out / "masks" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    return mask > 0


@pytest.mark.slow
def test_beyond_the_circle_nothing_is_used(tmp_path: Path) -> None:
    images, out = lenses(tmp_path / "in", radius=50.0), tmp_path / "out"
    options = {"rig": str(rig(tmp_path / "rig.json", 1e-6)), "settings": {"masks": {"source": "none"}}}
    tiegraph.open(images, out, pool="serial", **options).run("masks")
    views = ("front", "right", "left", "up", "down")
    front, *around = (used(out, f"{v}/0.png") for v in views)
    assert front.all()  # the rim, 3 % within 50 px, is 69.5 degrees off the axis
    right = around[0][len(around[0]) // 2]  # looks 43 degrees off the axis
    assert abs(right.mean() - (0.5 + np.tan(np.radians(69.5 - 43)) / 2)) < 0.03
    whole = {**options, "settings": {"masks": {"source": "none"}, "scan": {"fisheye": "whole"}}}
    tiegraph.open(images, tmp_path / "whole", pool="serial", **whole).run("masks")
    assert abs(used(tmp_path / "whole", "0.png").sum() / (np.pi * 48.5**2) - 1) < 0.05


@pytest.mark.slow
def test_masks_of_the_user_are_those_of_the_views(tmp_path: Path) -> None:
    images, out = lenses(tmp_path / "in", radius=79.0), tmp_path / "out"
    (tmp_path / "mine").mkdir()
    settings = {"masks": {"source": "folder", "folder": str(tmp_path / "mine")}}
    options = {"rig": str(rig(tmp_path / "rig.json", 1e-6)), "settings": settings, "pool": "serial"}
    with refused("front/0.png"):
        tiegraph.open(images, out, **options).run("masks")
    side = 80
    for view in ("front", "right", "left", "up", "down"):
        mask = np.full((side, side), 255, np.uint8)
        mask[: side // 2] = 0
        cv2.imwrite(str(tmp_path / "mine" / f"{view}.png"), mask)
    tiegraph.open(images, out, **options).run("masks")
    assert abs(used(out, "front/1.png").mean() - 0.5) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["RGBA.png", "LA.png", "RGBA.tif", "RGBA.webp", "deep.png"])
def test_what_is_transparent_is_not_used(tmp_path: Path, kind: str) -> None:
    """Orthophoto tiles, cut out objects, and exports of editors: their invisible pixels gave features."""
    mode, suffix = kind.split(".")
    folder, rng = tmp_path / "in", np.random.default_rng(0)
    folder.mkdir()
    for k in range(2):
        pixels = rng.integers(60, 200, (96, 128, 4), dtype=np.uint8)
        pixels[..., 3] = 255
        pixels[:, 80:, 3] = 0
        if mode == "deep":
            cv2.imwrite(str(folder / f"{k}.png"), pixels.astype(np.uint16) * 257)
        else:
            Image.fromarray(pixels).convert(mode).save(folder / f"{k}.{suffix}", lossless=True)
    out = tmp_path / "out"
    tiegraph.open(folder, out, pool="serial").run("masks")
    name = next(p.name for p in (out / "images").iterdir())
    keep = used(out, name)
    assert keep[:, :80].all() and not keep[:, 80:].any()


def test_masks_of_another_source_for_the_same_images(tmp_path):
    names = [f"cam0/{k}.png" for k in range(3)]
    scene = simple_scene(Rig("rig", (Sensor("cam0"),)), names, np.arange(3), np.zeros(3, int), np.zeros(3, int))
    for k, name in enumerate(names):
        image = np.full((60, 80, 3), 40 + 60 * k, np.uint8)
        image[40:] = 90  # equal in all: what paper 000 masks
        (tmp_path / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / name), image)
    masks_by("meguro2024", scene, tmp_path, tmp_path / "masks", Tuning())
    for name in names:
        mask = cv2.imread(str(tmp_path / "masks" / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
        assert mask.shape == (60, 80) and mask[44:].mean() < 20 and mask[:36].mean() > 200
    with pytest.raises(SettingsError, match="unknown mask source 'folder'"):
        masks_by("folder", scene, tmp_path, tmp_path / "masks", Tuning())
    whole = Tuning(meguro2024=Meguro2024Tuning(min_area=0.5))  # the black third of the image is a speck then
    masks_by("meguro2024", scene, tmp_path, tmp_path / "tuned", whole)
    assert cv2.imread(str(tmp_path / "tuned" / f"{names[0]}.png"), cv2.IMREAD_GRAYSCALE).min() == 255


NAMES = ["a.jpg", "b.jpg", "c.jpg"]
SCENE = simple_scene(Rig("lone", (Sensor("cam0", None, np.eye(4), "side"),)), NAMES, np.arange(3), np.zeros(3, int))


def _run(tmp_path: Path) -> Run:
    settings = Settings(evaluate=EvaluateSettings(reference_masks=tmp_path / "truth"))
    run = Run(tmp_path / "out", Inputs(tmp_path / "images"), settings, pool="serial")
    for name in NAMES:
        write(run.path(FINAL, "masks", f"{name}.png"), np.full((8, 10), 255, np.uint8))
    return run


def test_masks_of_no_image_are_refused_at_the_start(tmp_path: Path) -> None:
    run = _run(tmp_path)
    write(tmp_path / "truth/z.png", np.full((8, 10), 255, np.uint8))
    with refused("no mask of any image; .*a.jpg.png"):
        check_against(run, SCENE)
    write(tmp_path / "truth/b.png", np.full((8, 10), 255, np.uint8))
    assert check_against(run, SCENE) == ()


def test_a_mask_that_does_not_fit_is_passed_over_and_said(tmp_path: Path) -> None:
    run, found = _run(tmp_path), {}
    write(tmp_path / "truth/a.png", np.full((16, 20), 255, np.uint8))
    (said,) = _masks(run, SCENE, run.settings.evaluate, found)
    assert said.startswith("no reference mask is compared: ") and "20 x 16" in said and not found
    write(tmp_path / "truth/b.png", np.full((8, 10), 255, np.uint8))
    (said,) = _masks(run, SCENE, run.settings.evaluate, found)
    assert said.startswith("1 reference masks are not compared") and found["mask accuracy"]["rows"][-1][1] == 1
    write(tmp_path / "truth/a.png", np.full((8, 10), 255, np.uint8))
    assert _masks(run, SCENE, run.settings.evaluate, {}) == []
