"""Previews and coarse blocks of a run: what was made before a kill stays; the accuracy of previewed pairs."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from blocks_world import Mapper, place, survey, ties_of
from tiegraph.features.preview import Preview, PreviewMatch
from tiegraph.network.coarse.assembled import Assembled
from tiegraph.pipeline import features as previews
from tiegraph.pipeline import network as coarse
from tiegraph.pipeline.design import with_accuracy
from tiegraph.pipeline.features import Matcher, preview_path, with_previews
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import Settings
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene


class Killed(BaseException):
    """The machine was switched off."""


@pytest.fixture(scope="module")
def world() -> tuple:
    scene, truth = survey()
    return scene, truth, ties_of(scene)


def run_in(folder) -> SimpleNamespace:
    """What the glue uses of a run."""
    return SimpleNamespace(
        folder=folder,
        path=lambda *parts: folder.joinpath(*parts),
        settings=Settings.model_validate({"tuning": {"scene": {"blocks": {"unplaced": 1}}}}),
        reporter=Reporter("quiet"),
        map=lambda function, items, *args: [function(item, *args) for item in items],
    )


def same(one: Assembled, other: Assembled) -> bool:
    pairs = list(zip(one.models, other.models))
    columns = ("cam_from_world", "points", "image", "point")
    alike = [np.array_equal(getattr(a, c), getattr(b, c), equal_nan=True) for a, b in pairs for c in columns]
    return len(one.models) == len(other.models) == 1 and all(alike) and one.notes == other.notes


@pytest.mark.slow
def test_blocks_that_were_mapped_before_a_kill_stay(world, tmp_path, monkeypatch) -> None:
    scene, truth, ties = world
    mapper = Mapper(scene, truth)
    stop_at = [2]

    def made(run, part, inside):
        if len(mapper.sizes) == stop_at[0]:
            raise Killed
        return mapper(part, inside)

    monkeypatch.setattr(coarse, "coarse_model", made)
    with pytest.raises(Killed):
        coarse._Mapper(run_in(tmp_path), scene).mapped(ties)
    stop_at[0] = -1
    whole = coarse._Mapper(run_in(tmp_path), scene).mapped(ties)
    blocks = len(list((tmp_path / "coarse" / "blocks").glob("*.npz")))
    assert blocks > 2 and len(mapper.sizes) == blocks
    # From the files alone the model is the same bit by bit.
    assert same(coarse._Mapper(run_in(tmp_path), scene).mapped(ties), whole) and len(mapper.sizes) == blocks


def test_a_block_whose_ties_did_not_change_is_not_mapped_again(world, tmp_path, monkeypatch) -> None:
    scene, truth, ties = world
    mapper = Mapper(scene, truth)
    monkeypatch.setattr(coarse, "coarse_model", lambda run, *given: mapper(*given))
    mapped = coarse._Mapper(run_in(tmp_path), scene)
    mapped.mapped(ties)
    first = np.array([place(int(f)) for f in scene.frame]) < 20  # at one end: in one block
    blocks = len(mapper.sizes)
    (model,) = mapped.mapped(ties.where(~(first[ties.i] & first[ties.j] & (ties.i % 5 == 0)))).models
    assert len(mapper.sizes) == blocks + 1 and model.placed().all()


def test_a_block_that_cannot_be_mapped_is_not_tried_again(world, tmp_path, monkeypatch) -> None:
    scene, _, ties = world
    asked = []
    monkeypatch.setattr(coarse, "coarse_model", lambda *given: asked.append(given))
    for _ in range(2):
        assert coarse._Mapper(run_in(tmp_path), scene).mapped(ties).models == ()
    assert len(asked) == len(list((tmp_path / "coarse" / "blocks").glob("*.npz"))) > 2


def test_previews_that_were_matched_before_a_kill_stay(tmp_path, monkeypatch) -> None:
    rng, asked = np.random.default_rng(0), []

    def item(pair, *_):
        if len(asked) == 25:
            raise Killed
        asked.append(pair)
        count = int(rng.integers(0, 4))
        rotation = np.eye(3) if pair[0] % 2 else None
        return PreviewMatch(
            count, rotation, np.full(2, 0.5) if count else None, np.full((count, 2), pair[1], np.uint16)
        )

    monkeypatch.setattr(previews, "match_item", item)
    monkeypatch.setattr(previews, "_CHUNK", 10)
    pairs = np.array([(i, j) for i in range(9) for j in range(i + 1, 9)])
    with pytest.raises(Killed):
        Matcher(run_in(tmp_path), "candidates/matched")(pairs)
    assert len(asked) == 25
    before = {pair: None for pair in asked[:20]}
    asked.clear()
    again = Matcher(run_in(tmp_path), "candidates/matched")(pairs[:25])
    assert len(asked) == 5 and not before.keys() & set(asked)  # the third chunk was lost, the first two were not
    asked.clear()
    once_more = Matcher(run_in(tmp_path), "candidates/matched")(pairs[:25])
    assert not asked
    for one, other in zip(again, once_more):
        assert one.inliers == other.inliers and np.array_equal(one.matches, other.matches)
        assert (one.rotation is None) == (other.rotation is None) and (one.shift is None) == (other.shift is None)


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


def test_previewed_pairs_get_their_accuracy_and_base(tmp_path: Path) -> None:
    scene = world_of_three(tmp_path)
    all_points = np.stack([np.arange(60)] * 2, axis=1)
    pairs = Pairs.make([0, 0, 1], [1, 2, 2], "sequence")
    ties = PreviewMatches.make([0, 0], [1, 2], [all_points, all_points])
    found = with_accuracy(run_in(tmp_path), pairs, scene, ties)
    assert np.isfinite(found.sigma_m).tolist() == [True, True, False], "the third was not previewed"
    assert np.all(found.sigma_m[:2] > 0) and np.all(found.sigma_m[:2] < 1.5)
    assert 8 < found.h_over_b[0] < 13 and 4 < found.h_over_b[1] < 6.5


def test_pairs_without_previews_have_no_accuracy() -> None:
    scene = simple_scene(Rig("camera", (Sensor("camera"),)), ["a.jpg", "b.jpg"], np.arange(2), np.zeros(2))
    by_model = np.array([0.1])
    pairs = Pairs.make([0], [1], "sequence", sigma_m=by_model, h_over_b=by_model)
    found = with_accuracy(run_in(Path(".")), pairs, scene, PreviewMatches.empty())
    assert np.isnan([found.sigma_m[0], found.h_over_b[0]]).all(), "what the coarse model says is none of the paper's"


def test_pairs_of_which_nothing_is_known_are_previewed_for_the_design(tmp_path: Path) -> None:
    world_of_three(tmp_path)
    by_model = Pairs.make([1], [2], "model", overlap=np.array([0.4]))
    dropped = Pairs.make([0], [2], "file", dropped=np.array([1]))
    known = PreviewMatches.make([0], [2], [np.zeros((3, 2))])
    listed = Pairs.make([0], [1], "sequence") | dropped | by_model
    pairs, ties, count = with_previews(run_in(tmp_path), listed, known)
    assert count == 1, "one has an overlap, one was dropped"
    assert pairs.score[0] > 40 and np.isnan(pairs.score[1:]).all()
    row = ties.find(np.array([0, 0]), np.array([1, 2]))
    assert len(ties) == 2 and ties.counts()[row].tolist() == [pairs.score[0], 3]
    again = with_previews(run_in(tmp_path), pairs, ties)
    assert again[2] == 0 and again[0] is pairs
