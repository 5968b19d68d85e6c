import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from masks_world import DECK, HORIZON, SHAPE, frame, sequence, share, write
from tiegraph import papers
from tiegraph.errors import InputError
from tiegraph.masks import sources
from tiegraph.masks.compare import compare
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import SOURCES, Camera, explain_source
from tiegraph.masks.tuning import Tuning
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene

TUNING = Tuning()


def scene(cameras=2, frames=6, loose=False):
    rig = Rig("rig", tuple(Sensor(f"cam{c}") for c in range(cameras)))
    names = [f"up/cam{c}/{k:03d}.jpg" for c in range(cameras) for k in range(frames)]
    track = np.full(frames, -1 if loose else 0)
    order, sensor = np.tile(np.arange(frames), cameras), np.repeat(np.arange(cameras), frames)
    return simple_scene(rig, names, order, sensor, track, sequences=() if loose else ("up",))


def all_masks(name, images, **settings):
    chosen = MasksSettings(source=name, **settings)
    papers.plug_in(papers.MASKS, name, SOURCES)
    prepared = SOURCES[name].prepare({0: Camera(tuple(images))}, chosen, TUNING, map)[0]
    return [SOURCES[name].mask(p, prepared, chosen, TUNING, p.name) for p in images]


def test_auto():
    assert explain_source(scene(), MasksSettings(), TUNING)[0] == "learnt"
    for other in (scene(loose=True), scene(cameras=1), scene(frames=3)):
        name, why = explain_source(other, MasksSettings(), TUNING)
        assert name == "none" and why
    assert explain_source(scene(loose=True), MasksSettings(source="meguro2024"), TUNING)[0] == "meguro2024"


def test_auto_takes_a_given_folder_and_checks_it(tmp_path):
    write(tmp_path / "cam0.png", np.full(SHAPE, 255, np.uint8))
    settings = MasksSettings(folder=tmp_path)
    with pytest.raises(InputError, match=r"6 of 12 images: up/cam1/000\.jpg"):
        explain_source(scene(), settings, TUNING)
    write(tmp_path / "cam1.png", np.full(SHAPE, 255, np.uint8))
    assert explain_source(scene(), settings, TUNING)[0] == "folder"


def test_contradicting_settings(tmp_path):
    for wrong in (
        {"source": "folder"},
        {"source": "none", "folder": tmp_path},
        {"keep_labels": (4,)},
        {"source": "meguro"},
        {"similarity": 1.5},
    ):
        with pytest.raises(ValidationError):
            MasksSettings(**wrong)


def test_every_source_on_the_same_sequence(tmp_path):
    images = sequence(tmp_path)
    deck, scenery, sky = slice(DECK + 8, None), slice(HORIZON + 8, DECK - 8), slice(0, HORIZON - 8)
    expected = {  # rows that must be (masked, used)
        "meguro2024": ([deck, sky], [scenery]),
        "meguro2025": ([deck, sky], [scenery]),
        "sky": ([sky], [scenery, deck]),
        "none": ([], [sky, scenery, deck]),
    }
    for name, (masked, used) in expected.items():
        for mask in all_masks(name, images):
            assert mask.shape == SHAPE and mask.dtype == bool
            assert all(share(mask, rows) < 0.1 for rows in masked), name
            assert all(share(mask, rows) > 0.9 for rows in used), name


def test_folder_source(tmp_path):
    images = sequence(tmp_path / "images", 2)
    labels = np.full(SHAPE, 2, np.uint8)
    labels[:DECK] = 4
    for path in images:
        write(tmp_path / "masks" / f"{path.name}.png", labels)
    for mask in all_masks("folder", images, folder=tmp_path / "masks", keep_labels=(4,)):
        assert mask[:DECK].all() and not mask[DECK:].any()


@pytest.mark.parametrize("name", ["meguro2024", "meguro2025"])
def test_single_grey_and_oddly_shaped_images(tmp_path, name):
    alone = [write(tmp_path / "alone.png", frame(0))]
    assert share(all_masks(name, alone)[0], slice(HORIZON + 8, None)) > 0.9
    greys = [write(tmp_path / f"grey{k}.png", frame(k)[..., 0]) for k in range(2)]
    assert 0.1 < all_masks(name, greys)[0].mean() < 0.9
    mixed = [*sequence(tmp_path / "mixed", 2), write(tmp_path / "tall.png", np.swapaxes(frame(5), 0, 1).copy())]
    with pytest.raises(InputError, match=r"tall\.png: 240 x 320 pixels"):
        all_masks(name, [mixed[0], mixed[2], mixed[1]])


@pytest.mark.slow
def test_large_images_give_the_mask_of_small_ones_at_full_size(tmp_path):
    small = [cv2.resize(frame(k), (640, 480), interpolation=cv2.INTER_LINEAR) for k in range(2)]
    large = [cv2.resize(s, (2560, 1920), interpolation=cv2.INTER_LINEAR) for s in small]
    small_masks = all_masks("meguro2025", [write(tmp_path / f"s{k}.png", s) for k, s in enumerate(small)])
    large_masks = all_masks("meguro2025", [write(tmp_path / f"l{k}.png", s) for k, s in enumerate(large)])
    for s, m in zip(small_masks, large_masks):
        assert m.shape == (1920, 2560)
        assert (m[2::4, 2::4] == s).mean() > 0.95


def test_paper_001_masks_in_a_fraction_of_a_second_an_image(tmp_path):
    # The paper takes 0.18 s an image on one desktop core; measured here 0.004-0.01 s.
    images = [write(tmp_path / f"{k}.jpg", cv2.resize(frame(k), (640, 480))) for k in range(5)]
    began = time.process_time()
    all_masks("meguro2025", images)
    assert (time.process_time() - began) / 5 < 0.18


@pytest.mark.slow
def test_paper_001_table_2_on_the_example_survey(canal, tmp_path):
    # The paper reports an accuracy of 91 % on its own images; the same method on the rendered survey, with its light
    # changing between first and last frame, reaches about 73 %. Paper 000's method is worse.
    truth = canal / "truth" / "masks"
    if not truth.is_dir():
        pytest.skip("no true masks in the example survey")
    accuracy = {}
    for name in ("meguro2024", "meguro2025"):
        for camera in ("cam0", "cam1", "cam3", "cam5"):
            images = sorted((canal / "images").glob(f"*/{camera}/*.jpg"))
            chosen = [images[0], *images[1:-1:4], images[-1]]
            for path, mask in zip(chosen, all_masks(name, chosen)):
                relative = path.relative_to(canal / "images")
                write(tmp_path / name / f"{relative}.png", np.where(mask, 255, 0).astype(np.uint8))
        accuracy[name] = compare(tmp_path / name, truth, keep_labels=(4,)).rows[-1].accuracy
    assert 0.45 < accuracy["meguro2024"] < accuracy["meguro2025"] < 0.9
    assert accuracy["meguro2025"] > 0.62


def test_views_of_a_lens_are_one_witness_of_water(monkeypatch):
    asked = []
    monkeypatch.setattr(sources, "learn", lambda images, settings, *rest: asked.append(settings.water) or {})
    for lens in ("", "left"):
        cameras = {k: Camera((Path("a.png"),), lens=lens and f"{lens}{k % 2}") for k in range(6)}
        SOURCES["learnt"].prepare(cameras, MasksSettings(source="learnt"), Tuning(), map)
    SOURCES["learnt"].prepare(cameras, MasksSettings(source="learnt", water="on"), Tuning(), map)
    assert asked == ["auto", "off", "on"]
