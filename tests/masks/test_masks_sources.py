"""Sources of masks: files, a model of the user's, and the images they look at; compared with true masks."""

import logging
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from masks_world import DECK, HORIZON, SHAPE, frame, sequence, share, write
from tiegraph import papers
from tiegraph.errors import EngineMissing, InputError
from tiegraph.masks import EGO, SKY, USE, sources
from tiegraph.masks.folder import (
    candidates,
    check_folder,
    compare,
    find_mask,
    read_folder_mask,
    read_mask_file,
    table_text,
)
from tiegraph.masks.frames import full_size, grey, image_size, read_small, small_shape, two_frames
from tiegraph.masks.platform import flags, image_quality
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
        assert name == "marks" and why
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


@pytest.mark.slow
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


@pytest.mark.parametrize("still", [True, False])
def test_marks_that_stand_in_all_images_are_masked_and_nothing_else(tmp_path, still):
    """A thermal camera burns text and cross hairs into its images: 120 of 198 pairs of a survey were lost by them."""
    rng, images = np.random.default_rng(0), []
    ground = cv2.GaussianBlur(rng.integers(0, 255, (900, 1400), np.uint8), (0, 0), 3)
    ground = cv2.normalize(ground, None, 0, 255, cv2.NORM_MINMAX)
    for k in range(9):
        image = cv2.cvtColor(ground[40 * k : 40 * k + 480, 80 * k : 80 * k + 640], cv2.COLOR_GRAY2BGR)
        if still:
            cv2.putText(image, "23.4 C", (440, 60), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (255, 255, 255), 3)
            cv2.drawMarker(image, (320, 240), (255, 255, 255), cv2.MARKER_CROSS, 60, 2)
        images.append(tmp_path / f"{k}.png")
        cv2.imwrite(str(images[-1]), image)
    for mask in all_masks("marks", images):
        if still:
            assert mask[42:60, 445:540].mean() < 0.1 and mask[238:243, 295:345].mean() < 0.1
            assert 0.9 < mask.mean() < 0.99
        else:
            assert mask.all()
    assert all(mask.all() for mask in all_masks("marks", images[:5])), "too few to tell"


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


FRAMES = Tuning()


@pytest.mark.slow
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


@pytest.mark.slow
def test_blurred_and_repeated_images_are_flagged(tmp_path):
    images = [frame(k) for k in range(9)]
    images[4] = cv2.GaussianBlur(images[4], (0, 0), 4)
    images[7] = cv2.add(images[6], 3)
    paths = [write(tmp_path / f"{k}.png", image) for k, image in enumerate(images)]
    use = np.ones((240, 320), bool)
    quality = [image_quality(p, before, use, TUNING) for p, before in zip(paths, [None, *paths[:-1]])]
    found = flags(quality, TUNING)
    assert found[4].startswith("blurred: 0.") and found[7].startswith("similar: ")
    assert [k for k, why in enumerate(found) if why] == [4, 7]


def test_nothing_is_said_of_masked_or_lone_images(tmp_path):
    path = write(tmp_path / "a.png", frame(0))
    quality = image_quality(path, None, np.zeros((240, 320), bool), TUNING)
    assert np.isnan(quality).all()
    assert flags([quality], TUNING) == [""]
    dark = write(tmp_path / "dark.png", np.zeros((240, 320, 3), np.uint8))
    again = [image_quality(dark, path, np.ones((240, 320), bool), TUNING)] * 5
    assert flags(again, TUNING) == [""] * 5


SIZE = (48, 64)
NAME = "up/cam0/a.jpg"


def half(high=255):
    mask = np.zeros(SIZE, np.uint8)
    mask[:, 32:] = high
    return mask


@pytest.mark.parametrize(
    "file", "up/cam0/a.jpg.png up/cam0/a_mask.png up/cam0/a.mask.png up/cam0/a.png up/cam0.png cam0.png".split()
)
def test_every_naming_is_found(tmp_path, file):
    write(tmp_path / file, half())
    mask = read_folder_mask(tmp_path, NAME, SIZE)
    assert mask.dtype == bool and (mask == (half() > 0)).all()
    check_folder(tmp_path, [NAME])


def test_the_mask_of_the_image_goes_before_that_of_the_camera(tmp_path):
    """And the folder images of a name may be left away."""
    write(tmp_path / "cam0.png", half())
    write(tmp_path / "up/cam0/a.jpg.png", 255 - half())
    assert find_mask(tmp_path, NAME) == tmp_path / "up/cam0/a.jpg.png"
    assert find_mask(tmp_path, "up/cam0/b.jpg") == tmp_path / "cam0.png"
    write(tmp_path / "up/cam0/a.jpg.png", half())
    assert find_mask(tmp_path, "images/" + NAME) is not None
    assert candidates("a.jpg") == ["a.jpg.png", "a_mask.png", "a.mask.png", "a.png"]


def test_missing_masks_are_listed(tmp_path):
    write(tmp_path / "up/cam0/a.jpg.png", half())
    names = [NAME] + [f"up/cam0/{k}.jpg" for k in range(7)]
    with pytest.raises(InputError) as error:
        check_folder(tmp_path, names)
    text = str(error.value)
    with pytest.raises(InputError, match="no such folder"):
        check_folder(tmp_path / "nowhere", [NAME])
    assert "7 of 8" in text and "up/cam0/4.jpg and 2 more" in text and "up/cam0/5.jpg" not in text
    assert "up/cam0/0_mask.png" in text and "cam0.png" in text
    with pytest.raises(InputError, match=r"up/cam0/6\.jpg"):
        read_folder_mask(tmp_path, names[-1], SIZE)


def test_wrong_size(tmp_path):
    write(tmp_path / "cam0.png", half())
    with pytest.raises(InputError, match=r"cam0\.png: the mask has 64 x 48 pixels, its image .*a\.jpg has 128 x 96"):
        read_folder_mask(tmp_path, NAME, (96, 128))


@pytest.mark.parametrize("high", [1, 255])
def test_two_levels(tmp_path, high):
    path = write(tmp_path / "m.png", half(high))
    assert read_mask_file(path).mean() == 0.5
    assert not read_mask_file(write(path, half(0))).any()  # masks that leave nothing are allowed
    assert read_mask_file(write(path, half(0) + np.uint8(high))).all()


def test_other_ways_of_saving_the_same_mask(tmp_path):
    path = tmp_path / "m.png"
    for mode in ("1", "RGB", "RGBA", "P"):
        Image.fromarray(half()).convert(mode).save(path)
        assert (read_mask_file(path) == (half() > 0)).all(), mode


def test_images_that_are_no_masks_are_refused_with_the_reason(tmp_path):
    grey = half()
    grey[:, 30:34] = [60, 120, 180, 220]
    for image, said in (
        (grey, r"m\.png: 6 different values .*keep_labels"),
        (half(128), r"2 different values \(0, 128\)"),
        (half().astype(np.uint16) * 257, "65535"),
        (np.dstack([half(), half(), 255 - half()]), "colours"),
        (np.dstack([half()] * 4), "transparent"),
    ):
        with pytest.raises(InputError, match=said):
            read_mask_file(write(tmp_path / "m.png", image))
    whole = cv2.imencode(".png", np.random.default_rng(1).integers(0, 2, SIZE).astype(np.uint8))[1].tobytes()
    for data in (b"not a png", whole[: len(whole) // 2]):
        (tmp_path / "m.png").write_bytes(data)
        with pytest.raises(InputError, match=r"m\.png.*cannot be read"):
            read_mask_file(tmp_path / "m.png")


def test_labels(tmp_path):
    labels = np.repeat(np.arange(4, dtype=np.uint8), 12)[:, None] * np.ones((1, 64), np.uint8)
    path = write(tmp_path / "cam0.png", labels)
    assert (read_folder_mask(tmp_path, NAME, SIZE, (1, 3)) == np.isin(labels, (1, 3))).all()
    palette = Image.fromarray(labels).convert("P")
    palette.putdata(labels.ravel().tolist())
    palette.putpalette([0, 0, 0, 200, 0, 0, 0, 200, 0, 0, 0, 200])
    palette.save(path)
    assert (read_mask_file(path, (2,)) == (labels == 2)).all()
    with pytest.raises(InputError, match="not class labels"):
        read_mask_file(write(path, half()), (4,))


def test_masks_in_jpeg_are_said(tmp_path):
    Image.new("L", (8, 6)).save(tmp_path / "a_mask.JPG")
    with pytest.raises(InputError, match="a_mask.JPG is there, but JPEG blurs the edges of masks: save PNG"):
        check_folder(tmp_path, ["a.jpg"])


def mask(used_columns, shape=(10, 20)):
    out = np.zeros(shape, np.uint8)
    out[:, used_columns] = 255
    return out


def test_figures_per_camera_and_together(tmp_path):
    found, truth = tmp_path / "found", tmp_path / "truth"
    write(found / "up/cam0/a.jpg.png", mask(slice(0, 10)))
    write(truth / "up/cam0/a.jpg.png", mask(slice(5, 20)))
    write(found / "up/cam1/a.jpg.png", mask(slice(0, 20)))
    write(truth / "up/cam1/a.png", mask(slice(0, 20)))
    write(found / "up/cam1/b.jpg.png", mask(slice(0, 20)))  # no truth: left out
    names = ("up/cam0/a.jpg", "up/cam1/a.jpg", "up/cam1/b.jpg")
    result = compare(found, truth, {name: name.split("/")[1] for name in names})
    cam0, cam1, both = result.rows
    assert [r.camera for r in result.rows] == ["cam0", "cam1", "all"]
    assert [r.images for r in result.rows] == [1, 1, 2]
    assert (cam0.accuracy, cam0.iou) == (0.25, 0.25)
    assert (cam0.useful_lost, cam0.useless_kept) == (pytest.approx(10 / 15), 1.0)
    assert (cam1.accuracy, cam1.iou, cam1.useful_lost) == (1.0, 1.0, 0.0)
    assert np.isnan(cam1.useless_kept)
    assert both.accuracy == pytest.approx(25 / 40) and both.iou == pytest.approx(25 / 40)
    assert result.table()["rows"][1] == ["cam1", 1, 100.0, 100.0, 0.0, None]
    lines = table_text(result.table()).splitlines()
    assert len(lines) == 4 and len({len(line) for line in lines}) == 1 and lines[2].endswith("-")


def test_labels_as_truth_and_given_cameras(tmp_path):
    labels = np.repeat(np.arange(5, dtype=np.uint8), 4)[None] * np.ones((10, 1), np.uint8)
    write(tmp_path / "truth/a.png", labels)
    write(tmp_path / "found/a.jpg.png", mask(slice(16, 20)))
    rows = compare(tmp_path / "found", tmp_path / "truth", {"a.jpg": "left"}, keep_labels=(4,)).rows
    assert rows[0].camera == "left" and rows[0].accuracy == 1.0


def test_errors(tmp_path):
    found, truth = tmp_path / "found", tmp_path / "truth"
    cameras = {"cam0/a.jpg": "cam0"}
    write(found / "cam0/a.jpg.png", mask(slice(0, 5)))
    with pytest.raises(InputError, match="no true mask for any of 1"):
        compare(found, truth, cameras)
    write(truth / "cam0/a.jpg.png", mask(slice(0, 5), (12, 20)))
    with pytest.raises(InputError, match=r"a\.jpg\.png: 20 x 10 pixels, but .* has 20 x 12"):
        compare(found, truth, cameras)
    write(found / "cam0/c.jpg.png", mask(slice(0, 5)))
    write(truth / "cam0/c.jpg.png", mask(slice(0, 5)))
    result = compare(found, truth, cameras | {"cam0/c.jpg": "cam0"})  # the others are compared all the same
    assert result.rows[-1].images == 1 and len(result.unfit) == 1 and "20 x 12" in result.unfit[0]
    write(truth / "cam0/b.jpg.png", mask(slice(0, 5)))
    with pytest.raises(InputError, match=r"no mask for cam0/b\.jpg, which has a true one"):
        compare(found, truth, {"cam0/b.jpg": "cam0"})
