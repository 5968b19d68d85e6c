"""View-graph filtering on synthetic rigs with known motions and known false pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from filter_world import add_repeats, serial, turned, world

from tiegraph.errors import InputError
from tiegraph.filter.filter import filter_pairs
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import Tuning
from tiegraph.scene.pairs import Pairs


@pytest.fixture(scope="module")
def repeated():
    return add_repeats(world())


def _shares(result, false):
    kept = result.pairs.dropped == 0
    return kept[~false].mean(), kept[false].mean()


def test_true_pairs_stay_and_repeats_go(repeated, tmp_path):
    result, false = repeated.run(tmp_path)
    true_kept, false_kept = _shares(result, false)
    assert false.sum() > 10
    assert true_kept >= 0.99
    assert false_kept <= 0.05
    assert result.counts["refused"] == np.sum(result.pairs.dropped > 0) > 0.9 * false.sum()


def test_wide_rig(tmp_path):
    result, false = add_repeats(world(radius_m=1.0)).run(tmp_path)
    true_kept, false_kept = _shares(result, false)
    assert true_kept >= 0.99
    assert false_kept <= 0.1


def test_a_turned_rig_loses_nothing(repeated, tmp_path):
    result, false = repeated.run(tmp_path, turned(repeated.scene, 2.0))
    true_kept, false_kept = _shares(result, false)
    assert true_kept >= 0.99
    assert false_kept <= 0.1


def test_wrong_focal_lengths_refuse_nothing_and_are_told_of(repeated, tmp_path):
    rig = repeated.scene.rigs[0]
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[768, 768, 320, 240])
    rig = replace(rig, sensors=tuple(replace(s, camera=camera) for s in rig.sensors))
    result, false = repeated.run(tmp_path, repeated.scene.with_(rigs=(rig,)))
    assert "focal lengths, or the rig, are probably wrong" in result.notes[0]
    assert _shares(result, false)[0] >= 0.97


def test_unknown_rig_goes_by_loops_of_images(repeated, tmp_path):
    rig = repeated.scene.rigs[0]
    rig = replace(rig, sensors=tuple(replace(s, sensor_from_rig=None) for s in rig.sensors))
    result, false = repeated.run(tmp_path, repeated.scene.with_(rigs=(rig,)))
    true_kept, false_kept = _shares(result, false)
    assert true_kept >= 0.99
    assert false_kept <= 0.1


def test_lone_camera_in_loops(tmp_path):
    result, false = world(frames=7, sensors=1).run(tmp_path)
    assert not false.any()
    assert (result.pairs.dropped == 0).mean() >= 0.99


def test_off_keeps_all(repeated, tmp_path):
    result, _ = repeated.run(tmp_path, method="off")
    assert np.all(result.pairs.dropped == 0)


def test_same_input_same_result(tmp_path):
    made = add_repeats(world(frames=4, sensors=3))
    a, b = (made.run(tmp_path)[0] for _ in range(2))
    assert np.array_equal(a.pairs.dropped, b.pairs.dropped)


def test_missing_database_is_named(repeated, tmp_path):
    pairs = Pairs.make(np.array([0]), np.array([5]), "sequence")
    with pytest.raises(InputError, match="nowhere.db"):
        filter_pairs(tmp_path / "nowhere.db", repeated.scene, pairs, FilterSettings(), Tuning(), serial)
