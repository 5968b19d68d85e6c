"""Which images that a control file marks are turned by EXIF."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from PIL import Image

from tiegraph.pipeline.inputs import orientations
from tiegraph.scene.gcp import read_gcps
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.scene.tuning import ControlTuning


def test_orientations_are_those_of_the_marked_files_alone(tmp_path: Path) -> None:
    names = ["a/0.jpg", "a/1.jpg", "a/2.jpg", "a/3.jpg"]
    (tmp_path / "a").mkdir()
    for number, orientation in ((0, 8), (1, 1), (2, 6)):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.new("RGB", (4, 3)).save(tmp_path / names[number], exif=exif)
    rows = [f"1 2 3 1 1 {image}" for image in ("0.jpg", "a/1.jpg", "a\\0.jpg", "3.jpg", "another.jpg")]
    (tmp_path / "gcp_list.txt").write_text("EPSG:32654\n" + "\n".join(rows))
    scene = simple_scene(Rig("lone", (Sensor("cam"),)), names, np.arange(4), np.zeros(4))
    run = SimpleNamespace(inputs=SimpleNamespace(images=tmp_path))
    found = orientations(run, scene, read_gcps(tmp_path / "gcp_list.txt", ControlTuning()))  # type: ignore[arg-type]
    assert found == {0: 8, 1: 1}
