import cv2
import numpy as np

from masks_world import frame, write
from tiegraph.masks.quality import flags, image_quality
from tiegraph.masks.tuning import Tuning

TUNING = Tuning()


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
    assert np.isnan(quality.sharpness) and np.isnan(quality.moved)
    assert flags([quality], TUNING.quality) == [""]
    dark = write(tmp_path / "dark.png", np.zeros((240, 320, 3), np.uint8))
    again = [image_quality(dark, path, np.ones((240, 320), bool), TUNING)] * 5
    assert flags(again, TUNING.quality) == [""] * 5
