"""A rig file that contradicts the images: held as given, but never without a word."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from moving_world import moving_world, write_database

from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.rig import Rig
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.registrationreport import rig_doubts
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning


def test_what_a_contradicted_rig_leaves_is_said() -> None:
    model, scene = moving_world(frames=2)
    assert rig_doubts(model, scene, [0], 6, 6, Tuning()) == []
    (few,) = rig_doubts(model, scene, [0], 3, 6, Tuning())
    assert "rig car was held as given" in few and "3 of 6" in few and "sparse.rig" in few
    assert rig_doubts(model, scene, [], 3, 6, Tuning()) == [], "a rig that is adjusted or absent is not the cause"
    camera = model.camera(3)
    camera.params = camera.params + np.array([0, 0, 400 * np.tan(np.radians(5.0)), 0])
    (turned,) = rig_doubts(model, scene, [0], 6, 6, Tuning())
    assert "camera cam2" in turned and "5.0 deg" in turned and "rig car" in turned
    assert rig_doubts(model, scene, [], 6, 6, Tuning()) == []


def _turned(rig: Rig) -> Rig:
    """Its last camera 10 degrees off."""
    *others, last = rig.sensors
    assert last.sensor_from_rig is not None
    off = transforms.rigid(orient(10.0, 0, 0), np.zeros(3)) @ last.sensor_from_rig
    return replace(rig, sensors=(*others, replace(last, sensor_from_rig=off)))


def _swapped(rig: Rig) -> Rig:
    """Its left camera where the right one is."""
    a, b, c = rig.sensors
    places = (c.sensor_from_rig, b.sensor_from_rig)
    return replace(rig, sensors=(a, *(replace(s, sensor_from_rig=p) for s, p in zip((b, c), places))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "frames", "points", "named"),
    [(_turned, 12, 2500, "camera cam2 is mounted otherwise"), (_swapped, 6, 1500, "rig car")],
)
def test_a_rig_that_contradicts_the_images_is_named(wrong, frames, points, named, tmp_path: Path) -> None:
    model, scene = moving_world(frames=frames, points=points)
    write_database(model, tmp_path / "database.db")
    result = reconstruct(
        Source(tmp_path / "database.db", None), tmp_path / "sparse", scene.with_(rigs=(wrong(scene.rigs[0]),)),
        SparseSettings(covariance_frames=0), Tuning(), SceneTuning(), tmp_path / "log.txt",
    )  # fmt: skip
    assert any("contradict" in said and named in said for said in result.remarks.contradictions), (
        result.remarks.contradictions
    )
    lost = {name for name, _ in result.remarks.dropped}
    assert len(lost) == len(scene) - len(result.models[0].images), "every image that is lost has its reason"
