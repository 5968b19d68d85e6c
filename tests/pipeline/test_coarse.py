"""The stages candidates and coarse after a kill: previews and blocks that were finished are not made again."""

from types import SimpleNamespace

import numpy as np
import pytest

from blocks_world import Mapper, place, survey, ties_of
from tiegraph.features.preview import PreviewMatch
from tiegraph.network.coarse.assembled import Assembled
from tiegraph.pipeline import coarse
from tiegraph.pipeline import preview as previews
from tiegraph.pipeline.preview import Matcher
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import Settings


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
