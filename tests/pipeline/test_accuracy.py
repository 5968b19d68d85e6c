"""Paper 002's accuracy of the previewed pairs, from the previews in a run folder."""

from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.features.preview import Preview
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning
from tiegraph.pipeline.design import with_accuracy
from tiegraph.pipeline.preview import preview_path, with_previews
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.sfm.tuning import TwoViewTuning


def world_of_three(folder: Path) -> Scene:
    """Three frames of a camera that moves sideways past 60 points, and their previews in a run folder."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])
    rng = np.random.default_rng(0)
    xyz = rng.uniform((-4, -3, 8), (4, 3, 12), (60, 3))
    descriptors = rng.integers(0, 120, (60, 128)).astype(np.uint8)
    names = [f"{k}.jpg" for k in range(3)]
    scene = simple_scene(Rig("c", (Sensor("c", camera),)), names, np.arange(3), np.zeros(3), np.zeros(3),
                         sequences=("video",))  # fmt: skip
    (folder / "network").mkdir()
    for path in (folder / "scene.json", folder / "network" / "scene.json"):
        path.write_text(scene.to_json())
    for k, name in enumerate(names):
        xy = np.asarray(camera.img_from_cam(xyz - [k, 0, 0])) + rng.normal(0, 0.5, (60, 2))
        shares = np.full(16, 1 / 16, np.float32)
        preview = Preview(xy.astype(np.float32), descriptors, 640, 480, 0.5, 100.0, 40.0, shares)
        preview_path(folder, name).parent.mkdir(parents=True, exist_ok=True)
        np.savez(preview_path(folder, name), **preview.to_npz())
    return scene


def in_turn(function, items, *args):
    return [function(item, *args) for item in items]


def test_previewed_pairs_get_their_accuracy_and_base(tmp_path: Path) -> None:
    scene = world_of_three(tmp_path)
    all_points = np.stack([np.arange(60)] * 2, axis=1)
    pairs = Pairs.make([0, 0, 1], [1, 2, 2], "sequence")
    ties = PreviewMatches.make([0, 0], [1, 2], [all_points, all_points])
    found = with_accuracy(pairs, scene, ties, tmp_path, in_turn, TwoViewTuning())
    assert np.isfinite(found.sigma_m).tolist() == [True, True, False], "the third was not previewed"
    assert np.all(found.sigma_m[:2] > 0) and np.all(found.sigma_m[:2] < 1.5)
    assert 8 < found.h_over_b[0] < 13 and 4 < found.h_over_b[1] < 6.5


def test_pairs_without_previews_have_no_accuracy() -> None:
    scene = simple_scene(Rig("camera", (Sensor("camera"),)), ["a.jpg", "b.jpg"], np.arange(2), np.zeros(2))
    by_model = np.array([0.1])
    pairs = Pairs.make([0], [1], "sequence", sigma_m=by_model, h_over_b=by_model)
    found = with_accuracy(pairs, scene, PreviewMatches.empty(), Path("."), lambda *_: [], TwoViewTuning())
    assert np.isnan([found.sigma_m[0], found.h_over_b[0]]).all(), "what the coarse model says is none of the paper's"


def test_pairs_of_which_nothing_is_known_are_previewed_for_the_design(tmp_path: Path) -> None:
    world_of_three(tmp_path)
    by_model = Pairs.make([1], [2], "model", overlap=np.array([0.4]))
    dropped = Pairs.make([0], [2], "file", dropped=np.array([1]))
    known = PreviewMatches.make([0], [2], [np.zeros((3, 2))])
    listed, how = Pairs.make([0], [1], "sequence") | dropped | by_model, (PreviewSettings(), PreviewTuning())
    pairs, ties, count = with_previews(listed, known, tmp_path, *how, in_turn)
    assert count == 1, "one has an overlap, one was dropped"
    assert pairs.score[0] > 40 and np.isnan(pairs.score[1:]).all()
    row = ties.find(np.array([0, 0]), np.array([1, 2]))
    assert len(ties) == 2 and ties.counts()[row].tolist() == [pairs.score[0], 3]
    again = with_previews(pairs, ties, tmp_path, *how, in_turn)
    assert again[2] == 0 and again[0] is pairs
