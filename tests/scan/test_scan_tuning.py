"""The constants of scan are in reach: a changed one changes what scan says, by itself and from a run's settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from scan_worlds import Survey, papers_rig, picture
from test_rig_files import toml

from said import refused, says
from tiegraph.api import open_project
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.scene import Scene


def tuned(images: Path, changes: dict[str, Any]) -> Scene:
    return Survey(images).scan(tuning=Tuning.model_validate(changes))


def test_few_images_are_loose_however_many_that_is(tmp_path: Path) -> None:
    for k in range(12):
        picture(tmp_path / f"{k:04d}.jpg")
    assert "fewer than 30" in tuned(tmp_path, {}).notes[0] and tuned(tmp_path, {}).sequences == ()
    assert tuned(tmp_path, {"folders": {"few": 12}}).sequences == ("all",)


def test_the_guess_of_a_camera(tmp_path: Path) -> None:
    for name in ("fisheye0/0", "fisheye0/1", "fisheye1/0", "fisheye1/1"):
        picture(tmp_path / f"{name}.jpg")
    scene = tuned(tmp_path, {"rig": {"camera": {"guessed_fisheye_deg": 90}}})
    camera = scene.sensor_of(0).camera
    assert camera is not None and camera.mean_focal_length() == pytest.approx(40.74, abs=0.01)
    assert says(scene.notes, "a fisheye of 90 degrees across")


@pytest.mark.slow
def test_a_run_takes_them_from_its_settings(tmp_path: Path) -> None:
    images, out = papers_rig(tmp_path / "in", cameras=2, frames=2), tmp_path / "out"
    changed = {"scan": {"rig": {"camera": {"guessed_focal": 0.5}}}}
    project = open_project(images, out, pool="serial", settings={"tuning": changed})
    project.run("scan")
    camera = project.scene().sensor_of(0).camera
    assert camera is not None and camera.mean_focal_length() == 32.0
    assert json.loads((out / "receipts" / "scan.json").read_text())["tuning"] == changed


def test_a_rig_is_held_against_them_before_the_run(tmp_path: Path) -> None:
    settings = {"tuning": {"scan": {"rig": {"max_rig_m": 0.01}}}}
    images = papers_rig(tmp_path / "in", frames=2)
    with refused(r"more than 0\.01 m"):
        open_project(images, tmp_path / "out", rig=str(toml(tmp_path)), settings=settings).run("scan")
