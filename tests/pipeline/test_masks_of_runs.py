"""Masks and previews of a run: what was made before a kill stays; the reference, and the accuracy of pairs."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image

import tiegraph
from blocks_world import Mapper, place, survey, ties_of
from said import refused
from tiegraph.errors import SettingsError
from tiegraph.features.preview import Preview, PreviewMatch
from tiegraph.masks.tuning import PapersTuning, Tuning
from tiegraph.network.coarse.assembled import Assembled
from tiegraph.pipeline import features as previews
from tiegraph.pipeline import network as coarse
from tiegraph.pipeline.features import Matcher, preview_path, with_previews
from tiegraph.pipeline.masks import masks_by
from tiegraph.pipeline.network import with_accuracy
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import Settings
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

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
    whole = Tuning(papers=PapersTuning(min_area=0.5))  # the black third of the image is a speck then
    masks_by("meguro2024", scene, tmp_path, tmp_path / "tuned", whole)
    assert cv2.imread(str(tmp_path / "tuned" / f"{names[0]}.png"), cv2.IMREAD_GRAYSCALE).min() == 255


class Killed(BaseException):
    """The machine was switched off."""


@pytest.fixture(scope="module")
def world() -> tuple:
    scene, truth = survey()
    return scene, truth, ties_of(scene)


def run_in(folder) -> SimpleNamespace:
    """What the glue uses of a run."""
    return SimpleNamespace(
        folder=folder,
        path=lambda *parts: folder.joinpath(*parts),
        settings=Settings.model_validate({"tuning": {"scene": {"blocks": {"unplaced": 1}}}}),
        reporter=Reporter("quiet"),
        map=lambda function, items, *args: [function(item, *args) for item in items],
    )


def same(one: Assembled, other: Assembled) -> bool:
    pairs = list(zip(one.models, other.models))
    columns = ("cam_from_world", "points", "image", "point")
    alike = [np.array_equal(getattr(a, c), getattr(b, c), equal_nan=True) for a, b in pairs for c in columns]
    return len(one.models) == len(other.models) == 1 and all(alike) and one.notes == other.notes


@pytest.mark.slow
def test_blocks_that_were_mapped_before_a_kill_stay(world, tmp_path, monkeypatch) -> None:
    scene, truth, ties = world
    mapper = Mapper(scene, truth)
    stop_at = [2]

    def made(run, part, inside):
        if len(mapper.sizes) == stop_at[0]:
            raise Killed
        return mapper(part, inside)

    monkeypatch.setattr(coarse, "coarse_model", made)
    with pytest.raises(Killed):
        coarse._Mapper(run_in(tmp_path), scene).mapped(ties)
    stop_at[0] = -1
    whole = coarse._Mapper(run_in(tmp_path), scene).mapped(ties)
    blocks = len(list((tmp_path / "coarse" / "blocks").glob("*.npz")))
    assert blocks > 2 and len(mapper.sizes) == blocks
    # From the files alone the model is the same bit by bit.
    assert same(coarse._Mapper(run_in(tmp_path), scene).mapped(ties), whole) and len(mapper.sizes) == blocks


@pytest.mark.slow
def test_a_block_whose_ties_did_not_change_is_not_mapped_again(world, tmp_path, monkeypatch) -> None:
    scene, truth, ties = world
    mapper = Mapper(scene, truth)
    monkeypatch.setattr(coarse, "coarse_model", lambda run, *given: mapper(*given))
    mapped = coarse._Mapper(run_in(tmp_path), scene)
    mapped.mapped(ties)
    first = np.array([place(int(f)) for f in scene.frame]) < 20  # at one end: in one block
    blocks = len(mapper.sizes)
    (model,) = mapped.mapped(ties.where(~(first[ties.i] & first[ties.j] & (ties.i % 5 == 0)))).models
    assert len(mapper.sizes) == blocks + 1 and model.placed().all()


@pytest.mark.slow
def test_a_block_that_cannot_be_mapped_is_not_tried_again(world, tmp_path, monkeypatch) -> None:
    scene, _, ties = world
    asked = []
    monkeypatch.setattr(coarse, "coarse_model", lambda *given: asked.append(given))
    for _ in range(2):
        assert coarse._Mapper(run_in(tmp_path), scene).mapped(ties).models == ()
    assert len(asked) == len(list((tmp_path / "coarse" / "blocks").glob("*.npz"))) > 2


def test_previews_that_were_matched_before_a_kill_stay(tmp_path, monkeypatch) -> None:
    rng, asked = np.random.default_rng(0), []

    def item(pair, *_):
        if len(asked) == 25:
            raise Killed
        asked.append(pair)
        count = int(rng.integers(0, 4))
        rotation = np.eye(3) if pair[0] % 2 else None
        return PreviewMatch(
            count, rotation, np.full(2, 0.5) if count else None, np.full((count, 2), pair[1], np.uint16)
        )

    monkeypatch.setattr(previews, "match_item", item)
    monkeypatch.setattr(previews, "_CHUNK", 10)
    pairs = np.array([(i, j) for i in range(9) for j in range(i + 1, 9)])
    with pytest.raises(Killed):
        Matcher(run_in(tmp_path), "candidates/matched")(pairs)
    assert len(asked) == 25
    before = {pair: None for pair in asked[:20]}
    asked.clear()
    again = Matcher(run_in(tmp_path), "candidates/matched")(pairs[:25])
    assert len(asked) == 5 and not before.keys() & set(asked)  # the third chunk was lost, the first two were not
    asked.clear()
    once_more = Matcher(run_in(tmp_path), "candidates/matched")(pairs[:25])
    assert not asked
    for one, other in zip(again, once_more):
        assert one.inliers == other.inliers and np.array_equal(one.matches, other.matches)
        assert (one.rotation is None) == (other.rotation is None) and (one.shift is None) == (other.shift is None)


def world_of_three(folder: Path) -> Scene:
    """Three frames of a camera that moves sideways past 60 points, and their previews in a run folder."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])
    rng = np.random.default_rng(0)
    xyz = rng.uniform((-4, -3, 8), (4, 3, 12), (60, 3))
    descriptors = rng.integers(0, 120, (60, 128)).astype(np.uint8)
    names = [f"{k}.jpg" for k in range(3)]
    scene = simple_scene(Rig("c", (Sensor("c", camera),)), names, np.arange(3), np.zeros(3), np.zeros(3),
                         sequences=("video",))  # fmt: skip
    (folder / "network").mkdir()
    for path in (folder / "scene.json", folder / "network" / "scene.json"):
        path.write_text(scene.to_json())
    for k, name in enumerate(names):
        xy = np.asarray(camera.img_from_cam(xyz - [k, 0, 0])) + rng.normal(0, 0.5, (60, 2))
        shares = np.full(16, 1 / 16, np.float32)
        preview = Preview(xy.astype(np.float32), descriptors, 640, 480, 0.5, 100.0, 40.0, shares)
        preview_path(folder, name).parent.mkdir(parents=True, exist_ok=True)
        np.savez(preview_path(folder, name), **preview.to_npz())
    return scene


def test_previewed_pairs_get_their_accuracy_and_base(tmp_path: Path) -> None:
    scene = world_of_three(tmp_path)
    all_points = np.stack([np.arange(60)] * 2, axis=1)
    pairs = Pairs.make([0, 0, 1], [1, 2, 2], "sequence")
    ties = PreviewMatches.make([0, 0], [1, 2], [all_points, all_points])
    found = with_accuracy(run_in(tmp_path), pairs, scene, ties)
    assert np.isfinite(found.sigma_m).tolist() == [True, True, False], "the third was not previewed"
    assert np.all(found.sigma_m[:2] > 0) and np.all(found.sigma_m[:2] < 1.5)
    assert 8 < found.h_over_b[0] < 13 and 4 < found.h_over_b[1] < 6.5


def test_pairs_without_previews_have_no_accuracy() -> None:
    scene = simple_scene(Rig("camera", (Sensor("camera"),)), ["a.jpg", "b.jpg"], np.arange(2), np.zeros(2))
    by_model = np.array([0.1])
    pairs = Pairs.make([0], [1], "sequence", sigma_m=by_model, h_over_b=by_model)
    found = with_accuracy(run_in(Path(".")), pairs, scene, PreviewMatches.empty())
    assert np.isnan([found.sigma_m[0], found.h_over_b[0]]).all(), "what the coarse model says is none of the paper's"


def test_pairs_of_which_nothing_is_known_are_previewed_for_the_design(tmp_path: Path) -> None:
    world_of_three(tmp_path)
    by_model = Pairs.make([1], [2], "model", overlap=np.array([0.4]))
    dropped = Pairs.make([0], [2], "file", dropped=np.array([1]))
    known = PreviewMatches.make([0], [2], [np.zeros((3, 2))])
    listed = Pairs.make([0], [1], "sequence") | dropped | by_model
    pairs, ties, count = with_previews(run_in(tmp_path), listed, known)
    assert count == 1, "one has an overlap, one was dropped"
    assert pairs.score[0] > 40 and np.isnan(pairs.score[1:]).all()
    row = ties.find(np.array([0, 0]), np.array([1, 2]))
    assert len(ties) == 2 and ties.counts()[row].tolist() == [pairs.score[0], 3]
    again = with_previews(run_in(tmp_path), pairs, ties)
    assert again[2] == 0 and again[0] is pairs
