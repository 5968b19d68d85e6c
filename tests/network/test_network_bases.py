"""Base, distance over base and sigma of pairs by a coarse model of known geometry."""

import csv
from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from tiegraph.network.network import metres_per_unit, with_bases
from tiegraph.network.sections.light import UpLight
from tiegraph.pipeline import network as glue
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.matches import PreviewMatches, Visibility
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

FOCAL_PX, UNIT_M = 500.0, 4.0  # a unit of the model is 4 m
CAMERA = pycolmap.Camera.create_from_model_name(0, "SIMPLE_PINHOLE", FOCAL_PX, 640, 480)


def world(sigma_m: float = 0.02) -> tuple[Scene, Visibility]:
    """Four images along x, 2 units apart, that look at a wall 10 units away; first and last share no point."""
    centre = np.stack([2.0 * np.arange(4), np.zeros(4), np.zeros(4)], axis=1)
    wall = np.stack([np.linspace(-3, 9, 121), np.zeros(121), np.full(121, 10.0)], axis=1)
    seen = [np.flatnonzero(np.abs(wall[:, 0] - x) < 2.5) for x in centre[:, 0]]
    start = np.r_[0, np.cumsum([len(s) for s in seen])]
    poses = np.tile(np.eye(4), (4, 1, 1))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    poses[:, :3, 3] = UNIT_M * centre @ turn.T + [5, 6, 7]
    poses[3] = np.nan  # under the bridge
    rig = Rig("camera", (Sensor("camera", camera=CAMERA),))
    scene = simple_scene(
        rig, [f"{k}.jpg" for k in range(4)], np.arange(4), np.zeros(4), world_from_rig=poses, prior="gnss",
        position_sigma_m=np.where(np.isfinite(poses[:, :3, 3]), sigma_m, np.nan),
    )  # fmt: skip
    return scene, Visibility(start, np.concatenate(seen), wall, centre)


def test_base_distance_over_base_and_sigma_of_pairs():
    scene, visibility = world()
    pairs = Pairs.make([0, 0, 0, 2], [1, 2, 3, 3], "sequence", score=np.array([100.0, 25, 25, np.nan]))
    found = with_bases(pairs, scene, visibility)
    assert metres_per_unit(scene.measured(), visibility.centre) == pytest.approx(UNIT_M)
    assert found.baseline_m == pytest.approx([8, 16, 24, 8], rel=1e-5), "the fourth image has no position"
    assert found.h_over_b[[0, 1, 3]] == pytest.approx([10.1 / 2, 10.1 / 4, 10.1 / 2], rel=0.02)
    assert np.isnan(found.h_over_b[2]) and np.isnan(found.sigma_m[2:]).all(), "no common point, no matches"
    assert found.sigma_m[:2] == pytest.approx([40.4 / FOCAL_PX / 10, 40.4 / FOCAL_PX / 5], rel=0.02)
    known = with_bases(pairs.with_(baseline_m=np.full(4, 9.0)), scene, visibility)
    assert np.all(known.baseline_m == 9.0), "known by poses"


def test_without_positions_that_tell_the_scale_only_the_ratio_is_known():
    pairs = Pairs.make([0], [1], "sequence", score=np.array([100.0]))
    scene, visibility = world(sigma_m=50.0)
    nowhere = scene.with_(world_from_rig=np.full((4, 4, 4), np.nan))
    for uncertain in (scene, nowhere, replace(scene, prior="odometry")):
        found = with_bases(pairs, uncertain, visibility)
        assert np.isnan([found.baseline_m[0], found.sigma_m[0]]).all() and np.isfinite(found.h_over_b[0])


def test_the_stage_network_writes_them(tmp_path, monkeypatch):
    scene, visibility = world()
    pairs = Pairs.make([0, 1], [1, 2], "sequence", score=np.array([100.0, 100.0]))
    (tmp_path / "coarse").mkdir()
    (tmp_path / "coarse" / "scene.json").write_text(scene.to_json())
    np.savez(tmp_path / "coarse.npz", **pairs.to_npz())
    np.savez(tmp_path / "coarse" / "matches.npz", **PreviewMatches.empty().to_npz())
    np.savez(tmp_path / "coarse" / "visibility.npz", **visibility.to_npz())
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, 3] = -visibility.centre
    np.savez(tmp_path / "coarse" / "model.npz", cam_from_world=poses)
    monkeypatch.setattr(glue, "up_light", lambda run, scene: UpLight(np.full(len(scene), 99.0)))
    glue.network(Run(tmp_path, Inputs(tmp_path), Settings(), "serial"))
    with (tmp_path / "network.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert float(row["h_over_b"]) == pytest.approx(10.1 / 2, rel=0.02) and float(row["baseline_m"]) == 8
    assert float(row["sigma_m"]) == pytest.approx(40.4 / FOCAL_PX / 10, rel=0.02)
    with np.load(tmp_path / "network.npz") as stored:
        assert np.isfinite(stored["h_over_b"]).all()
