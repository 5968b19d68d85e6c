import cv2
import numpy as np
import pytest

import tiegraph  # noqa: F401  before pycolmap
from tiegraph.errors import SettingsError
from tiegraph.masks.tuning import Meguro2024Tuning, Tuning
from tiegraph.pipeline.masks import masks_by
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene


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
