"""Verified matches between the cameras of a rig against a model that holds the rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from moving_world import moving_world, write_database

from tiegraph.scene.rig import Source
from tiegraph.sfm.rig.cameramatches import camera_matches, sentence, table
from tiegraph.sfm.tuning.placement import AgreementTuning
from tiegraph.sfm.tuning.rig import CameraMatchesTuning
from tiegraph.sfm.verified import image_observations, read_verified


@pytest.mark.parametrize("late_s", [0.0, 0.6])
def test_two_cameras_that_fire_apart_are_told_by_their_matches(late_s: float, tmp_path: Path) -> None:
    model, scene = moving_world(late_s=(0.0, 0.0, late_s), frames=12)
    write_database(model, tmp_path / "database.db")
    verified = read_verified(tmp_path / "database.db", scene)
    found = camera_matches(verified, image_observations(model, scene, AgreementTuning()), scene, CameraMatchesTuning())
    by = {(t.first, t.second): t for t in found}
    assert not by[0, 1].contradicted and by[0, 1].between > 0.95 and by[0, 1].own > 0.95
    assert by[0, 2].contradicted == (late_s > 0) and (by[0, 2].between < 0.7) == (late_s > 0)
    assert [row[5] for row in table(found, scene)["rows"] if row[:2] == ["cam0", "cam2"]] == [
        "contradicts the model" if late_s else ""
    ]
    said = sentence(found, scene)
    assert len(said) == (late_s > 0)
    assert all("cam2" in line and "fire apart" in line for line in said)
    views = [replace(s, source=Source(panorama=True)) for s in scene.rigs[0].sensors]
    assert sentence(found, replace(scene, rigs=(replace(scene.rigs[0], sensors=tuple(views)),))) == []


def test_cameras_without_ties_have_no_opinion(tmp_path: Path) -> None:
    model, scene = moving_world(frames=6)
    write_database(model, tmp_path / "database.db")
    verified = read_verified(tmp_path / "database.db", scene)
    alone = verified.where(scene.sensor[verified.pairs[:, 0]] == scene.sensor[verified.pairs[:, 1]])
    assert (
        camera_matches(alone, image_observations(model, scene, AgreementTuning()), scene, CameraMatchesTuning()) == []
    )
