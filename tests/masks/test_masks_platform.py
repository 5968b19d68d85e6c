import cv2
import numpy as np
import pytest

from masks_world import DECK, SHAPE, frame, write
from tiegraph.masks.platform import different_frames, learn_platform, platform_of_frames
from tiegraph.masks.tuning import Tuning

SIZE = (240, 320)
TUNING = Tuning()


def scenery(k, gain=1.0):
    """A scene that moves, under a platform with an outline and a mast: what a deck looks like. (240, 320) u1."""
    rng = np.random.default_rng(50 + k)
    coarse = rng.uniform(40, 210, (40, 54)).astype(np.float32)
    image = cv2.resize(coarse, SIZE[::-1], interpolation=cv2.INTER_LINEAR)
    for mask in platform():
        image[mask] = 150
    image[205:] += np.linspace(0, 20, 320)[None]
    image = gain * image + rng.normal(0, 1.5, SIZE)
    return np.clip(image, 0, 255).astype(np.uint8)


def platform():
    deck, mast = np.zeros(SIZE, bool), np.zeros(SIZE, bool)
    deck[190:] = True
    mast[100:190, 60:76] = True
    return deck, mast


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize("light", ["steady", "changing"])
def test_platform_is_found_in_any_light(light):
    gains = np.linspace(0.45, 1.2, 14) if light == "changing" else np.ones(14)
    found = platform_of_frames([scenery(k, g) for k, g in enumerate(gains)], TUNING.platform)
    truth = platform()[0] | platform()[1]
    assert 0.85 < iou(found, truth) <= 1
    assert found[~truth].mean() < 0.02


def test_nothing_is_invented_where_everything_moves():
    rng = np.random.default_rng(3)
    frames = [cv2.GaussianBlur(rng.uniform(0, 255, SIZE).astype(np.float32), (0, 0), 2) for _ in range(10)]
    assert not platform_of_frames([f.astype(np.uint8) for f in frames], TUNING.platform).any()


def test_a_far_skyline_that_shakes_is_no_platform():
    # The upper part stands still but for a shake of a pixel, as a skyline does for a car; the lower part moves.
    far = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, (150, 340)).astype(np.float32), (0, 0), 3)
    frames = []
    for k in range(14):
        rng = np.random.default_rng(k)
        image = cv2.GaussianBlur(rng.uniform(0, 255, SIZE).astype(np.float32), (0, 0), 3)
        x, y = rng.normal(0, 1.2, 2)
        shift = np.array([[1, 0, x - 10], [0, 1, y - 10]], np.float32)
        image[:120] = cv2.warpAffine(far, shift, (320, 120))
        frames.append(np.clip((image - 127) * 4 + 127, 0, 255).astype(np.uint8))
    assert platform_of_frames(frames, TUNING.platform).mean() < 0.01


def test_standing_cameras_and_short_sequences_are_refused(tmp_path):
    still = [write(tmp_path / f"still{k}.png", scenery(0)) for k in range(12)]
    assert len(different_frames(still, TUNING)) == 1
    found = learn_platform(different_frames(still, TUNING), len(still), TUNING)
    assert found.mask is None and "hardly moves" in found.note
    alone = learn_platform(different_frames(still[:1], TUNING), 1, TUNING)
    assert alone.mask is None and "one image" in alone.note
    few = [write(tmp_path / f"few{k}.png", scenery(k)) for k in range(TUNING.platform.min_frames - 1)]
    assert learn_platform(different_frames(few, TUNING), len(few), TUNING).mask is None
    assert learn_platform(different_frames([tmp_path / "absent.png"], TUNING), 1, TUNING).mask is None


def test_from_files_and_a_camera_without_platform(tmp_path):
    own = [write(tmp_path / f"{k}.png", scenery(k)) for k in range(9)]
    found = learn_platform(different_frames(own, TUNING), len(own), TUNING)
    assert found.mask is not None and found.mask.shape == SIZE and 0.15 < found.mask.mean() < 0.4
    mast = [p.with_name(f"mast{p.name}") for p in own]
    for k, path in enumerate(mast):  # the deck cut off: a thin mast alone is too little for so few frames
        write(path, np.where(np.arange(SIZE[0])[:, None] < 190, scenery(k), 255 * (k % 2)).astype(np.uint8)[60:190])
    assert learn_platform(different_frames(mast, TUNING), len(mast), TUNING).mask is None
    bare = [write(tmp_path / f"bare{k}.png", frame(k)[60:DECK]) for k in range(8)]
    found = learn_platform(different_frames(bare, TUNING), len(bare), TUNING)
    assert found.mask is None and found.note == "no platform seen"
    assert SHAPE == SIZE


def test_what_is_black_in_every_frame_round_a_fisheye_image_is_no_scene():
    across, down = np.meshgrid(np.arange(SIZE[1]) - SIZE[1] / 2, np.arange(SIZE[0]) - SIZE[0] / 2)
    radius = np.hypot(across, down) / SIZE[0]
    frames = [np.random.default_rng(k).uniform(40, 210, (30, 40)).astype(np.float32) for k in range(10)]
    frames = [np.where(radius > 0.48, 3, cv2.resize(f, SIZE[::-1])).astype(np.uint8) for f in frames]
    mask = platform_of_frames(frames, TUNING.platform)
    assert mask[radius > 0.48].mean() > 0.97 and mask[radius < 0.44].mean() < 0.02
