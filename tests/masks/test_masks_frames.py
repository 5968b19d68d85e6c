import logging

import cv2
import numpy as np
import pytest

from masks_world import SHAPE, frame, sequence, write
from tiegraph.errors import InputError
from tiegraph.masks.frames import full_size, grey, image_size, read_small, small_shape, two_frames
from tiegraph.masks.tuning import FramesTuning

TUNING = FramesTuning()


def test_first_and_last(tmp_path):
    a, b = two_frames(sequence(tmp_path), TUNING)
    assert (a == grey(frame(0))).all() and (b == grey(frame(3))).all()


@pytest.mark.parametrize("broken", [0, 3])
def test_broken_end_frame_is_passed_over(tmp_path, broken, caplog):
    images = sequence(tmp_path)
    images[broken].write_bytes(b"not an image")
    a, b = two_frames(images, TUNING)
    assert (a == grey(frame(1 if broken == 0 else 0))).all()
    assert (b == grey(frame(2 if broken == 3 else 3))).all()
    assert images[broken].name in caplog.text


def test_equal_or_differently_sized_last_frame_is_passed_over(tmp_path):
    images = sequence(tmp_path)
    write(images[3], frame(0))
    write(images[2], frame(2)[:100])
    a, b = two_frames(images, TUNING)
    assert (b == grey(frame(1))).all()


def test_one_image_equal_images_or_none_readable_give_none(tmp_path, caplog):
    one = write(tmp_path / "a.png", frame(0))
    same = write(tmp_path / "b.png", frame(0))
    gone = tmp_path / "gone.png"
    with caplog.at_level(logging.WARNING):
        assert two_frames([one], TUNING) is None
        assert two_frames([one, same], TUNING) is None
        assert two_frames([gone], TUNING) is None
    assert caplog.text.count("no mask from two frames") == 3


@pytest.mark.parametrize("size", [(2000, 3000), (1300, 700), (480, 640), (481, 641), (35, 6000)])
def test_reduced_size_keeps_the_shape(tmp_path, size):
    path = write(tmp_path / "a.jpg", np.full((*size, 3), 99, np.uint8))
    small = read_small(path, TUNING.work_px)
    assert image_size(path) == size
    assert small.shape[:2] == small_shape(size, TUNING.work_px)
    assert max(small.shape) <= TUNING.work_px
    assert full_size(np.ones(small.shape[:2], bool), size).shape == size


def test_reduced_reading_agrees_with_full_reading(tmp_path):
    image = cv2.resize(frame(0), (2560, 1920), interpolation=cv2.INTER_CUBIC)
    small = read_small(write(tmp_path / "a.jpg", image), TUNING.work_px).astype(float)
    full = cv2.resize(image, (640, 480), interpolation=cv2.INTER_AREA)
    assert np.abs(small - full).mean() < 2.0  # grey levels


def test_grey_image_is_read_as_three_equal_channels(tmp_path):
    small = read_small(write(tmp_path / "a.png", grey(frame(0))), TUNING.work_px)
    assert small.shape == (*SHAPE, 3) and np.ptp(small, axis=2).max() == 0


@pytest.mark.parametrize("data", [b"", b"GIF89a nonsense", None])
def test_unreadable_image_names_the_file(tmp_path, data):
    path = tmp_path / "a.jpg"
    if data is not None:
        path.write_bytes(data)
    for read in (image_size, lambda p: read_small(p, TUNING.work_px)):
        with pytest.raises(InputError, match=r"a\.jpg"):
            read(path)
