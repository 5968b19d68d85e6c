"""The folder of a comparison with another method: what was interrupted is said; what made no model was not."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tiegraph.pipeline import STAGES
from tiegraph.pipeline.baseline import Block, interrupted_note, run_side
from tiegraph.project.artefacts import LOST
from tiegraph.project.run import Inputs, Run
from tiegraph.project.settings import merged
from tiegraph.project.stages import Receipts
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene


def block(folder: Path, whole: bool) -> Block:
    scene = simple_scene(Rig("one", (Sensor("a", None),)), ["0.jpg", "1.jpg"], np.arange(2), np.zeros(2, int))
    run = Run(folder / "survey", Inputs(folder / "images"), merged())
    (folder / "block").mkdir()
    return Block(folder=folder / "block", run=run, scene=scene, whole=whole)


def test_a_run_that_goes_on_is_said_to_have_been_interrupted(tmp_path: Path) -> None:
    made = block(tmp_path, whole=False)
    assert interrupted_note(made, "conventional", STAGES) == ""  # not begun
    made.side("conventional").mkdir()
    for _ in range(2):  # also when it has gone on since
        assert "times are too short" in interrupted_note(made, "conventional", STAGES)
    made.side("meguro2024").mkdir()
    Receipts(made.side("meguro2024")).write("georef", {"began": "key", LOST: "it needs the stage match"})
    assert interrupted_note(made, "meguro2024", STAGES) == ""
    side = run_side(made, "meguro2024", STAGES)
    assert side.count == 0 and side.cpu_s == 0 and np.isnan(side.centres).all()


def test_a_block_in_an_outage_is_given_no_gnss(tmp_path: Path) -> None:
    made = block(tmp_path, whole=False)
    assert made.silent == ()  # the survey has none either
    run = Run(made.run.folder, replace(made.run.inputs, gnss=tmp_path / "gnss.csv"), made.run.settings)
    assert replace(made, run=run).silent == ("gnss",)
    poses, sigma = np.tile(np.eye(4), (2, 1, 1)), np.array([[0.1, 0.1, 0.1], [np.nan] * 3])
    fixed = made.scene.with_(prior="gnss", world_from_rig=poses, position_sigma_m=sigma)
    assert replace(made, run=run, scene=fixed).silent == ()


def test_a_whole_survey_is_its_own_side(tmp_path: Path) -> None:
    made = block(tmp_path, whole=True)
    assert made.side("tiegraph") == tmp_path / "survey" and made.images == tmp_path / "images"
    assert made.side("colmap") == tmp_path / "block" / "colmap"
    made.run.folder.mkdir()
    assert interrupted_note(made, "tiegraph", STAGES) == ""
