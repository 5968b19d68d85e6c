"""Large surveys in blocks: what is cut where, how the models of blocks come together, and what is said of tears."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from blocks_world import CAMERA, FRAMES, WALL_M, Mapper, place, survey, ties_of
from near import off_after_similarity
from network_steps import Mapper as Steps
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.network.coarse.assembled import Assembled, assembled
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.tuning import Tuning
from tiegraph.scene.blocks import Block, Poses, blocks_of, join, join_models
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.rig import camera_to_dict, rig_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import BlocksTuning
from tiegraph.scene.tuning import Tuning as SceneTuning

TUNING = SceneTuning(blocks=BlocksTuning(unplaced=1))  # small enough for a world of 960 images


@pytest.fixture(scope="module")
def world() -> tuple[Scene, np.ndarray, PreviewMatches]:
    scene, truth = survey()
    return scene, truth, ties_of(scene)


def mapped(world, make) -> Assembled:
    """The models of all blocks, joined; ``make`` maps one of them."""
    scene, _, ties = world
    return Steps(scene, Tuning(), make, TUNING)(ties)


def error_m(model: CoarseModel, truth: np.ndarray) -> np.ndarray:
    """(K,) distances of the placed images from the truth after the best similarity."""
    there = model.placed()
    found, true = (transforms.centre(poses[there]) for poses in (model.cam_from_world, truth))
    return np.linalg.norm(off_after_similarity(found, true), axis=1)


def test_both_passes_of_a_place_are_in_one_block(world) -> None:
    scene, _, ties = world
    found = blocks_of(scene, ties.i, ties.j, ties.counts(), TUNING.blocks)
    assert len(found) in (3, 4) and max(map(len, found)) <= TUNING.blocks.whole
    own = np.concatenate([b.images[b.own] for b in found])
    assert np.array_equal(np.sort(own), np.arange(len(scene)))
    for block in found:
        where = np.array([place(int(f)) for f in scene.frame[block.images[block.own]]])
        back = scene.frame[block.images[block.own]] >= FRAMES
        assert abs(np.mean(where[back]) - np.mean(where[~back])) < 6 and spread(scene, block) < 1.3
        assert 1.0 <= len(block) / block.own.sum() < 1.7


def spread(scene: Scene, block: Block) -> float:
    """Frames of the way over which a block's own images lie, over those that they would fill."""
    return float(np.ptp([place(int(f)) for f in scene.frame[block.images[block.own]]]) / (block.own.sum() / 4))


@pytest.mark.slow
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_positions_keep_places_that_look_alike_apart(world, missing: float) -> None:
    """A wall that repeats every 100 frames: a cut by matches alone puts places 100 frames apart into one block."""
    scene, truth, ties = world
    rng = np.random.default_rng(0)
    where = np.array([place(int(f)) for f in scene.frame])
    i, j = np.triu_indices(len(scene), 1)
    alike = np.flatnonzero((np.abs(np.abs(where[i] - where[j]) - 100) < 8) & (rng.random(len(i)) < 0.5))
    starts, none = 60 * np.arange(len(alike) + 1), np.zeros((60 * len(alike), 2), np.uint16)
    torn = ties | PreviewMatches(i[alike], j[alike], starts, none)
    assert max(spread(scene, b) for b in blocks_of(scene, torn.i, torn.j, torn.counts(), TUNING.blocks)) > 1.8
    first = np.unique(scene.frame, return_index=True)[1]
    known = np.full((scene.frames, 4, 4), np.nan)
    known[:, :3, 3] = transforms.centre(truth[first]) + rng.normal(0, 4.0, (scene.frames, 3))
    known[[FRAMES - 1, 2 * FRAMES - 1]] = np.nan  # where a pass ends
    for gap in (40, 300):
        known[gap : gap + int(missing * FRAMES)] = np.nan
    placed = scene.with_(world_from_rig=known, prior="gnss")
    found = blocks_of(placed, torn.i, torn.j, torn.counts(), BlocksTuning())
    assert len(found) in (3, 4) and max(map(len, found)) <= 600
    for block in found:
        assert spread(scene, block) < 1.3
        middle = [where[block.images[block.own & (scene.frame[block.images] // FRAMES == k)]].mean() for k in (0, 1)]
        assert abs(middle[0] - middle[1]) < 20


def test_a_block_beyond_the_last_position_of_its_pass_is_tied_to_the_others(world) -> None:
    """Three quarters of a pass without positions: its frames are linked with those around them, and lent as others."""
    scene, truth, ties = world
    first = np.unique(scene.frame, return_index=True)[1]
    known = transforms.invert(truth[first])
    known[FRAMES // 4 : FRAMES] = np.nan
    found = blocks_of(scene.with_(world_from_rig=known), ties.i, ties.j, ties.counts(), TUNING.blocks)
    for block in found:
        others = np.concatenate([b.images for b in found if b is not block])
        assert 30 <= len(np.intersect1d(block.images, others)) <= 4 * TUNING.blocks.lent


def test_the_size_of_blocks_is_in_reach_and_larger_without_positions(world) -> None:
    scene, _, ties = world
    assert len(blocks_of(scene, ties.i, ties.j, ties.counts(), BlocksTuning())) == 1  # 960 of up to 1500
    assert len(blocks_of(scene, ties.i, ties.j, ties.counts(), BlocksTuning(unplaced=1.2))) == 2
    assert len(blocks_of(scene, ties.i, ties.j, ties.counts(), BlocksTuning(whole=960, unplaced=1))) == 1
    small = blocks_of(scene, ties.i, ties.j, ties.counts(), BlocksTuning(own=200, lent=20, unplaced=1))
    assert len(small) >= 5 and max(int(b.own.sum()) for b in small) <= 200


def test_a_small_survey_is_mapped_whole(world) -> None:
    scene, truth, ties = world
    few = np.flatnonzero(scene.frame % FRAMES < 100)
    block = Block(few, np.ones(len(few), bool))
    small, inside = block.part_of(scene, ties)
    mapper = Mapper(small, truth[few])
    made = Steps(small, Tuning(), mapper, TUNING)(inside)
    assert mapper.sizes == [len(few)] and len(made.models) == 1 and made.notes == ()
    assert [small.names[k] for k in (0, 7)] == [scene.names[few[k]] for k in (0, 7)]
    assert np.array_equal(small.sequence_index[small.frame], scene.sequence_index[scene.frame[few]])


@pytest.mark.slow
def test_blocks_come_together_in_one_frame(world) -> None:
    scene, truth, _ = world
    mapper = Mapper(scene, truth, noise_m=0.02)
    made = mapped(world, mapper)
    (model,), notes = made.models, made.notes
    assert len(mapper.sizes) > 2 and max(mapper.sizes) <= TUNING.blocks.whole
    assert model.placed().all()
    assert 0.005 < np.median(error_m(model, truth)) < 0.5  # of 480 m
    turned = np.swapaxes(truth[:, :3, :3], 1, 2) @ model.cam_from_world[:, :3, :3]  # of the frame, alike for all
    assert transforms.angle_deg(turned, turned[:1]).max() < 0.1
    assert "blocks" in notes[0] and "100 %" in notes[0] and len(notes) == 1
    seen = np.bincount(model.image, minlength=len(scene))
    assert seen.min() >= 12  # nobody lost his points
    assert len(model.points) < 1.1 * len(scene)  # and hardly any is there twice


@pytest.mark.slow
def test_a_torn_block_is_said_and_the_parts_stay_usable(world) -> None:
    made = mapped(world, Mapper(*world[:2], broken=1))
    models, notes = made.models, made.notes
    assert len(models) >= 2
    assert any("not joined there" in n for n in notes) and any("torn into" in n for n in notes)
    both = np.sum([m.placed() for m in models], axis=0)
    assert both.max() == 1  # no image twice
    assert models[0].placed().sum() >= models[1].placed().sum() > 0


@pytest.mark.slow
def test_a_block_that_cannot_be_mapped_is_said(world) -> None:
    scene, truth, _ = world
    mapper = Mapper(scene, truth)

    def make(part: Scene, inside: PreviewMatches) -> CoarseModel | None:
        model = mapper(part, inside)
        return None if len(mapper.sizes) == 2 else model

    made = mapped(world, make)
    assert any("could not be mapped" in n for n in made.notes)
    assert 0.4 < sum(m.placed().sum() for m in made.models) / len(scene) < 0.95


@pytest.mark.slow
def test_a_model_is_the_same_from_its_file(world) -> None:
    (model,) = mapped(world, Mapper(*world[:2])).models
    again = CoarseModel.from_npz(model.to_npz())
    for name in ("cam_from_world", "points", "image", "point"):
        assert np.array_equal(getattr(again, name), getattr(model, name), equal_nan=True)
        assert getattr(again, name).dtype == getattr(model, name).dtype
    assert [camera_to_dict(c) for c in again.cameras] == [camera_to_dict(c) for c in model.cameras]
    assert [rig_to_dict(r) for r in again.rigs] == [rig_to_dict(r) for r in model.rigs]


def _models(
    truth: np.ndarray, ends: list[tuple[int, int]], rng: np.random.Generator
) -> tuple[list[Poses], list[Similarity]]:
    models, own = [], []
    for a, b in ends:
        s = Similarity(rng.uniform(0.5, 2), Rotation.random(random_state=a).as_matrix(), rng.normal(0, 9, 3))
        world_from_cam = transforms.invert(truth[a:b])
        moved = transforms.rigid(s.rotation @ world_from_cam[:, :3, :3], s(world_from_cam[:, :3, 3]))
        models.append(Poses(np.arange(a, b), transforms.invert(moved), WALL_M * s.scale))
        own.append(s)
    return models, own


def test_a_join_finds_the_similarity_along_a_straight_line() -> None:
    """The turn about the line is open to the centres alone."""
    truth = np.stack([transforms.rigid(np.eye(3), [-2.0 * k, 0, 0]) for k in range(40)])
    (a, b), (own_a, own_b) = _models(truth, [(0, 25), (10, 40)], np.random.default_rng(1))
    found = join(0, 1, a, b, TUNING.joining)
    assert found is not None and found.holds and found.shared == found.agree == 15
    point = np.array([[7.0, 5.0, 3.0]])
    assert np.allclose(found.b_from_a(own_a(point)), own_b(point), atol=1e-6)
    assert join(0, 1, a, Poses(b.images + 20, b.cam_from_world, b.range_), TUNING.joining) is None  # share too few


def test_images_that_stood_still_take_the_scale_from_what_they_see() -> None:
    turns = Rotation.from_euler("z", np.arange(30)[:, None] * 12, degrees=True).as_matrix()
    truth = transforms.rigid(turns, np.zeros((30, 3)))
    (a, b), (own_a, own_b) = _models(truth, [(0, 30), (0, 30)], np.random.default_rng(1))
    found = join(0, 1, a, b, TUNING.joining)
    assert found is not None and found.holds
    assert found.b_from_a.scale == pytest.approx(own_b.scale / own_a.scale, rel=1e-6)


def test_a_loop_of_blocks_closes_and_a_false_join_is_refused() -> None:
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    turns = Rotation.from_euler("z", angle[:, None]).as_matrix()
    centre = 50 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    truth = transforms.rigid(turns, -np.einsum("kab,kb->ka", turns, centre))
    rng = np.random.default_rng(2)
    models, own = _models(truth, [(0, 80), (60, 140), (120, 200), (180, 240)], rng)
    again = np.arange(0, 20)  # the last block sees the first frames again
    last, _ = _models(truth[np.r_[180:240, again]], [(0, 80)], rng)
    order = np.argsort(np.r_[180:240, again])
    models[3] = Poses(np.r_[180:240, again][order], last[0].cam_from_world[order], last[0].range_)
    joined = join_models(models, TUNING.joining)
    assert len(joined.joins) == 4 and all(j.holds for j in joined.joins) and joined.part.tolist() == [0, 0, 0, 0]
    for k in (1, 2):
        scale = joined.world_from[k].scale * own[k].scale
        assert scale == pytest.approx(own[0].scale, rel=1e-6)
    # The last block takes twenty images of the second for its own: a wall that repeats, twenty frames on.
    wrong = Poses(np.r_[180:240, 90:110], models[3].cam_from_world[order.argsort()], models[3].range_)
    wrong = Poses(np.sort(wrong.images), wrong.cam_from_world[np.argsort(wrong.images)], wrong.range_)
    joined = join_models([*models[:3], wrong], TUNING.joining)
    refused = [j for j in joined.joins if not j.holds]
    assert [(j.a, j.b) for j in refused] == [(3, 1)] and joined.part.tolist() == [0, 0, 0, 0]


def _tied_model(part: Scene, truth: np.ndarray, ties: PreviewMatches, off_m: float) -> CoarseModel:
    """A model whose ties share a point each, with the way back displaced along the way: there only every fourth tie
    between the passes has its point, of those that the displaced ones would have."""
    pose = truth.copy()
    back = part.frame >= FRAMES if part.frames == 2 * FRAMES else np.array([n.startswith("back") for n in part.names])
    pose[back, :3, 3] += pose[back, :3, 0] * off_m
    across = back[ties.i] != back[ties.j]
    kept = ~across | (off_m == 0) | (np.arange(len(ties)) % 4 == 0)
    i, j, n = ties.i[kept], ties.j[kept], int(kept.sum())
    point = transforms.centre(pose)[i] + WALL_M * pose[i, 2, :3]
    images, points = np.concatenate([i, j]), np.tile(np.arange(n), 2)
    return CoarseModel(pose, (CAMERA,) * len(pose), point, images, points, part.rigs)


def _tied_models(world, blocks: Sequence[Block], wrong: int | None = None) -> list[CoarseModel]:
    """Of all blocks; in that of a number the way back stands 30 m further."""
    scene, truth, ties = world
    parts = [(*block.part_of(scene, ties), truth[block.images]) for block in blocks]
    return [_tied_model(part, true, inside, 30.0 * (k == wrong)) for k, (part, inside, true) in enumerate(parts)]


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0, 1])
def test_the_ties_that_put_one_pass_of_a_block_elsewhere_are_found(world, wrong: int) -> None:
    """And only those of the block that is wrong; the frames of a pass are never cut apart."""
    scene, truth, ties = world
    blocks = blocks_of(scene, ties.i, ties.j, ties.counts(), TUNING.blocks)
    models = _tied_models(world, blocks, wrong)
    made = assembled(scene, blocks, models, Tuning().coarse, TUNING.joining)
    i, j = made.suspects
    assert len(i) > 50 and len(made.models) > 1
    inside = np.isin(np.arange(len(scene)), blocks[wrong].images)
    assert inside[i].all() and inside[j].all()
    assert ((scene.frame[i] >= FRAMES) != (scene.frame[j] >= FRAMES)).all()
    across = (scene.frame[ties.i] >= FRAMES) != (scene.frame[ties.j] >= FRAMES)
    sharing = {(a, b) for a, b in zip(i, j)}
    false = [(a, b) for a, b in zip(ties.i[across], ties.j[across]) if inside[a] and inside[b]]
    assert 0.2 < np.mean([pair in sharing for pair in false]) < 0.3, "every fourth made it into the model"
    whole = assembled(scene, blocks, _tied_models(world, blocks), Tuning().coarse, TUNING.joining)
    assert len(whole.models) == 1 and not len(whole.suspects[0])


@pytest.mark.slow
def test_a_rig_is_taken_from_the_block_that_agrees_with_the_others(world) -> None:
    """Not from the one with most images, which may be mapped as roughly as any."""
    scene, truth, ties = world
    blocks = blocks_of(scene, ties.i, ties.j, ties.counts(), TUNING.blocks)
    models = _tied_models(world, blocks)
    largest = int(np.argmax([len(b) for b in blocks]))
    rng = np.random.default_rng(1)
    for k, model in enumerate(models):
        turned = Rotation.from_euler("y", 10.0 if k == largest else rng.normal(0, 0.1), degrees=True)
        turn = transforms.rigid(turned.as_matrix(), np.zeros(3))
        first, second, *rest = scene.rigs[0].sensors
        second = replace(second, sensor_from_rig=turn @ second.sensor_from_rig)
        models[k] = replace(model, rigs=(replace(scene.rigs[0], sensors=(first, second, *rest)),))
    (made,) = assembled(scene, blocks, models, Tuning().coarse, TUNING.joining).models
    pose, truth_pose = (r.sensors[1].sensor_from_rig[:3, :3] for r in (made.rigs[0], scene.rigs[0]))
    assert 0.001 < transforms.angle_deg(pose, truth_pose) < 0.3
