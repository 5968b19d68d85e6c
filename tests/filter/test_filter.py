"""View-graph filtering on synthetic rigs with known motions and known false pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from filter_world import add_repeats, serial, turned, world
from scipy.spatial.transform import Rotation

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


@pytest.mark.slow
def test_true_pairs_stay_and_repeats_go(repeated, tmp_path):
    result, false = repeated.run(tmp_path)
    true_kept, false_kept = _shares(result, false)
    assert result.method == "rig"
    assert false.sum() > 10
    assert true_kept >= 0.99
    assert false_kept <= 0.05
    assert result.counts["refused"] == np.sum(result.pairs.dropped > 0) > 0.9 * false.sum()


@pytest.mark.slow
def test_frame_motions_are_true(tmp_path):
    made = world(frames=4)
    result, _ = made.run(tmp_path)
    for (m, n), motion in zip(result.motions.units, result.motions.n_from_m):
        a, b = (Rotation.from_euler("yxz", [6 * np.sin(f), 2 * np.cos(2 * f), 1.5 * np.sin(3 * f)], degrees=True)
                for f in (m, n))  # fmt: skip
        error = (Rotation.from_matrix(motion[:3, :3]) * (b * a.inv()).inv()).magnitude()
        assert 0 < np.degrees(error) < 0.3


@pytest.mark.slow
def test_wide_rig(tmp_path):
    result, false = add_repeats(world(radius_m=1.0)).run(tmp_path)
    true_kept, false_kept = _shares(result, false)
    assert true_kept >= 0.99
    assert false_kept <= 0.1


@pytest.mark.slow
def test_turned_rig_is_refined_and_loses_nothing(repeated, tmp_path):
    result, false = repeated.run(tmp_path, turned(repeated.scene, 2.0))
    true_kept, false_kept = _shares(result, false)
    assert result.method == "rig refined"
    assert "turned by" in result.notes[0]
    assert true_kept >= 0.99
    assert false_kept <= 0.1


@pytest.mark.slow
def test_wrong_focal_length_falls_back_loudly(repeated, tmp_path):
    rig = repeated.scene.rigs[0]
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[768, 768, 320, 240])
    rig = replace(rig, sensors=tuple(replace(s, camera=camera) for s in rig.sensors))
    result, false = repeated.run(tmp_path, repeated.scene.with_(rigs=(rig,)))
    assert result.method == "rig does not hold"
    assert "does not hold" in result.notes[0] and "cam" in result.notes[0]
    assert _shares(result, false)[0] >= 0.97


@pytest.mark.slow
def test_unknown_rig_goes_by_loops_of_images(repeated, tmp_path):
    rig = repeated.scene.rigs[0]
    rig = replace(rig, sensors=tuple(replace(s, sensor_from_rig=None) for s in rig.sensors))
    result, false = repeated.run(tmp_path, repeated.scene.with_(rigs=(rig,)))
    assert result.method == "images"
    assert _shares(result, false)[0] >= 0.99


def test_lone_camera_in_loops(tmp_path):
    result, false = world(frames=7, sensors=1).run(tmp_path)
    assert result.method == "images"
    assert not false.any()
    assert _shares_true(result) >= 0.99
    assert not result.motions.by_frame
    assert result.motions.units.max() < 8


def _shares_true(result):
    return (result.pairs.dropped == 0).mean()


def test_off_keeps_all(repeated, tmp_path):
    result, _ = repeated.run(tmp_path, method="off")
    assert result.method == "off"
    assert np.all(result.pairs.dropped == 0)


@pytest.mark.slow
def test_same_input_same_result(tmp_path):
    made = add_repeats(world(frames=4, sensors=3))
    a, _ = made.run(tmp_path)
    b, _ = made.run(tmp_path)
    assert np.array_equal(a.pairs.dropped, b.pairs.dropped)
    assert np.array_equal(a.motions.n_from_m, b.motions.n_from_m)


def test_missing_database_is_named(repeated, tmp_path):
    pairs = Pairs.make(np.array([0]), np.array([5]), "sequence")
    with pytest.raises(InputError, match="nowhere.db"):
        filter_pairs(tmp_path / "nowhere.db", repeated.scene, pairs, FilterSettings(), Tuning(), serial)
