"""Sources of masks, a model of the user's among them, and the images they look at."""

import logging
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from masks_world import DECK, HORIZON, SHAPE, frame, sequence, share, write
from tiegraph import papers
from tiegraph.errors import EngineMissing, InputError
from tiegraph.masks import EGO, SKY, USE, sources
from tiegraph.masks.folder import compare
from tiegraph.masks.frames import full_size, grey, image_size, read_small, small_shape, two_frames
from tiegraph.masks.platform import flags, image_quality
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import SOURCES, Camera, explain_source
from tiegraph.masks.tuning import FramesTuning, Tuning
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
    none_with_folder = {"source": "none", "folder": tmp_path}
    for wrong in (
        {"source": "folder"}, none_with_folder, {"keep_labels": (4,)}, {"source": "meguro"}, {"similarity": 1.5}
    ):  # fmt: skip
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
        assert m.shape == (1920, 2560) and (m[2::4, 2::4] == s).mean() > 0.95


@pytest.mark.slow
def test_paper_001_table_2_on_the_example_survey(canal, tmp_path):
    # The paper reports an accuracy of 91 % on its own images; the same method on the rendered survey, with its light
    # changing between first and last frame, reaches about 73 %. Paper 000's method is worse.
    truth = canal / "truth" / "masks"
    if not truth.is_dir():
        pytest.skip("no true masks in the example survey")
    accuracy, cameras = {}, {}
    for name in ("meguro2024", "meguro2025"):
        for camera in ("cam0", "cam1", "cam3", "cam5"):
            images = sorted((canal / "images").glob(f"*/{camera}/*.jpg"))
            chosen = [images[0], *images[1:-1:4], images[-1]]
            for path, mask in zip(chosen, all_masks(name, chosen)):
                relative = path.relative_to(canal / "images")
                write(tmp_path / name / f"{relative}.png", np.where(mask, 255, 0).astype(np.uint8))
                cameras[relative.as_posix()] = camera
        accuracy[name] = compare(tmp_path / name, truth, cameras, keep_labels=(4,)).rows[-1].accuracy
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


FRAMES = FramesTuning()


def test_the_first_and_the_last_frame_are_taken_equal_or_differently_sized_ones_passed_over(tmp_path):
    a, b = two_frames(sequence(tmp_path), FRAMES)
    assert (a == grey(frame(0))).all() and (b == grey(frame(3))).all()
    images = sequence(tmp_path)
    write(images[3], frame(0))
    write(images[2], frame(2)[:100])
    a, b = two_frames(images, FRAMES)
    assert (b == grey(frame(1))).all()


@pytest.mark.parametrize("broken", [0, 3])
def test_broken_end_frame_is_passed_over(tmp_path, broken, caplog):
    images = sequence(tmp_path)
    images[broken].write_bytes(b"not an image")
    a, b = two_frames(images, FRAMES)
    assert (a == grey(frame(1 if broken == 0 else 0))).all()
    assert (b == grey(frame(2 if broken == 3 else 3))).all() and images[broken].name in caplog.text


def test_one_image_equal_images_or_none_readable_give_none(tmp_path, caplog):
    one, same = (write(tmp_path / name, frame(0)) for name in ("a.png", "b.png"))
    with caplog.at_level(logging.WARNING):
        for images in ([one], [one, same], [tmp_path / "gone.png"]):
            assert two_frames(images, FRAMES) is None
    assert caplog.text.count("no mask from two frames") == 3


@pytest.mark.parametrize("size", [(2000, 3000), (1300, 700), (480, 640), (481, 641), (35, 6000)])
def test_reduced_size_keeps_the_shape(tmp_path, size):
    path = write(tmp_path / "a.jpg", np.full((*size, 3), 99, np.uint8))
    small = read_small(path, FRAMES.work_px)
    assert image_size(path) == size and small.shape[:2] == small_shape(size, FRAMES.work_px)
    assert max(small.shape) <= FRAMES.work_px
    assert full_size(np.ones(small.shape[:2], bool), size).shape == size


def test_reduced_reading_agrees_with_full_reading_and_grey_is_three_equal_channels(tmp_path):
    image = cv2.resize(frame(0), (2560, 1920), interpolation=cv2.INTER_CUBIC)
    small = read_small(write(tmp_path / "a.jpg", image), FRAMES.work_px).astype(float)
    full = cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA)
    assert np.abs(small - full).mean() < 2.0  # grey levels
    small = read_small(write(tmp_path / "a.png", grey(frame(0))), FRAMES.work_px)
    assert small.shape == (*SHAPE, 3) and np.ptp(small, axis=2).max() == 0


@pytest.mark.parametrize("data", [b"", b"GIF89a nonsense", None])
def test_unreadable_image_names_the_file(tmp_path, data):
    path = tmp_path / "a.jpg"
    if data is not None:
        path.write_bytes(data)
    for read in (image_size, lambda p: read_small(p, FRAMES.work_px)):
        with pytest.raises(InputError, match=r"a\.jpg"):
            read(path)


TOML = 'onnx = "tiny.onnx"\nsize = [32, 24]\n[classes]\nsky = [2]\nplatform = [0]\n'


def _field(number, value):
    """One field of a protocol buffer: bytes, text or a number."""

    def varint(n):
        out = bytearray()
        while n > 127:
            out.append(n & 127 | 128)
            n >>= 7
        return bytes([*out, n])

    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tiny_model():
    """ONNX bytes of Identity: the three colours of the image are the scores of three classes."""

    def value(name):
        dims = b"".join(_field(1, _field(1, n)) for n in (1, 3, 24, 32))
        return _field(1, name) + _field(2, _field(1, _field(1, 1) + _field(2, dims)))

    node = _field(1, "image") + _field(2, "scores") + _field(4, "Identity")
    graph = _field(1, node) + _field(2, "tiny") + _field(11, value("image")) + _field(12, value("scores"))
    return _field(1, 8) + _field(7, graph) + _field(8, _field(1, "") + _field(2, 13))


@pytest.fixture
def model(tmp_path):
    (tmp_path / "tiny.onnx").write_bytes(tiny_model())
    (tmp_path / "model.toml").write_text(TOML)
    return tmp_path / "model.toml"


def test_a_model_of_the_users_makes_masks(model, tmp_path):
    pytest.importorskip("onnxruntime")
    image = np.zeros((240, 320, 3), np.uint8)
    image[:80], image[80:160], image[160:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)  # blue, green, red
    path = write(tmp_path / "a.png", image)
    settings = MasksSettings(source="model", model=model)
    source = SOURCES["model"]
    prepared = source.prepare({0: Camera((path,))}, settings, Tuning(), map)[0]
    classes = source.look(path, prepared, settings, Tuning(), "a.png")
    assert (classes[:75] == SKY).all() and (classes[85:155] == USE).all() and (classes[165:] == EGO).all()
    mask = source.mask(path, prepared, settings, Tuning(), "a.png")
    assert mask.shape == (240, 320) and not mask[:75].any() and mask[85:155].all()
    (tmp_path / "tiny.onnx").write_bytes(b"nonsense")
    sources.session.cache_clear()
    with pytest.raises(InputError, match="not a model ONNX Runtime can load"):
        source.mask(path, prepared, settings, Tuning(), "a.png")


def test_without_onnx_runtime_it_says_what_to_install(model, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    sources.session.cache_clear()
    with pytest.raises(EngineMissing, match=r"tiegraph\[onnx\]"):
        sources.model_classes(np.zeros((24, 32, 3), np.uint8), sources.read_model(model))


@pytest.mark.parametrize(
    "text, said",
    [
        ("onnx = 3 =", "not valid TOML"),
        ("size = [32, 24]\n[classes]\nsky = [1]\n", "needs onnx"),
        (TOML.replace("tiny", "absent"), "no model .*absent"),
        (TOML.replace("sky", "heaven"), "no class 'heaven'"),
        (TOML.replace("[32, 24]", "[0, 24]"), "make no sense"),
    ],
)
def test_wrong_tables_are_refused_by_name(model, text, said):
    model.write_text(text)
    with pytest.raises(InputError, match=said):
        sources.read_model(model)
    with pytest.raises(InputError, match="cannot be read"):
        sources.read_model(model.with_name("nowhere.toml"))


def test_blurred_and_repeated_images_are_flagged(tmp_path):
    images = [frame(k) for k in range(9)]
    images[4] = cv2.GaussianBlur(images[4], (0, 0), 4)
    images[7] = cv2.add(images[6], 3)
    paths = [write(tmp_path / f"{k}.png", image) for k, image in enumerate(images)]
    use = np.ones((240, 320), bool)
    quality = [image_quality(p, before, use, TUNING) for p, before in zip(paths, [None, *paths[:-1]])]
    found = flags(quality, TUNING.quality)
    assert found[4].startswith("blurred: 0.") and found[7].startswith("similar: ")
    assert [k for k, why in enumerate(found) if why] == [4, 7]


def test_nothing_is_said_of_masked_or_lone_images(tmp_path):
    path = write(tmp_path / "a.png", frame(0))
    quality = image_quality(path, None, np.zeros((240, 320), bool), TUNING)
    assert np.isnan(quality).all()
    assert flags([quality], TUNING.quality) == [""]
    dark = write(tmp_path / "dark.png", np.zeros((240, 320, 3), np.uint8))
    again = [image_quality(dark, path, np.ones((240, 320), bool), TUNING)] * 5
    assert flags(again, TUNING.quality) == [""] * 5
