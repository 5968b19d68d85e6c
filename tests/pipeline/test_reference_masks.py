"""Reference masks that do not fit: none at all is an input error at the start, single ones are passed over and said."""

from pathlib import Path

import numpy as np

from masks_world import write
from said import refused
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.pipeline.evaluate import _masks
from tiegraph.pipeline.files import FINAL
from tiegraph.pipeline.inputs import check_against
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene

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
