"""Choosing pairs for matching: budgets, connectivity, and what falls apart."""

import numpy as np
from boat_world import boat
from hypothesis import given, settings
from hypothesis import strategies as st

from tiegraph.network.design import component_notes, components, design
from tiegraph.network.network import estimate_network
from tiegraph.network.settings import DesignSettings, NetworkSettings
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene


def photos(count: int):
    return simple_scene(
        Rig("camera", (Sensor("camera"),)), [f"{k:03d}.jpg" for k in range(count)], np.arange(count), np.zeros(count)
    )


def graph(count: int, edges: int, seed: int) -> Pairs:
    rng = np.random.default_rng(seed)
    i, j = rng.integers(0, count, edges), rng.integers(0, count, edges)
    score = np.where(rng.random(edges) < 0.2, np.nan, rng.integers(0, 200, edges).astype(float))
    return Pairs.make(i, j, "offsets", score=score, dropped=np.where(rng.random(edges) < 0.2, 8, 0))


def test_all_keeps_everything() -> None:
    pairs = graph(20, 100, 0)
    assert design(pairs, photos(20), DesignSettings(method="all")) is pairs


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 30), st.integers(0, 200), st.integers(0, 99), st.integers(1, 6))
def test_top_only_drops_and_keeps_the_components(count, edges, seed, most) -> None:
    pairs = graph(count, edges, seed)
    chosen = design(pairs, photos(count), DesignSettings(method="top", pairs_per_image=most))
    assert len(chosen) == len(pairs)
    assert np.all((chosen.dropped == 0) <= (pairs.dropped == 0))
    before, after = components(pairs, count), components(chosen, count)
    assert len(np.unique(before)) == len(np.unique(after))
    assert len(chosen.kept()) <= count * most + count - 1
    assert np.all(chosen.degree(count) >= np.minimum(pairs.degree(count), most))


def test_top_keeps_every_pass_and_camera_in_an_images_list() -> None:
    world = boat((16, 16), (1.0, 1.0))
    pairs = estimate_network(world.scene, np.full(len(world.scene), 100.0), world.match, NetworkSettings()).pairs
    chosen = design(pairs, world.scene, DesignSettings(method="top", pairs_per_image=8))
    assert len(chosen.kept()) < 0.5 * len(pairs.kept())
    track = world.scene.track[world.scene.frame]

    def across(p: Pairs) -> float:
        kept = p.kept()
        return float(np.mean(track[kept.i] != track[kept.j]))

    assert across(chosen) > 0.8 * across(pairs)


def test_strongest_pairs_win() -> None:
    pairs = Pairs.make([0, 0, 0, 1], [1, 2, 3, 2], "offsets", score=np.array([50.0, 40.0, 30.0, np.nan]))
    chosen = design(pairs, photos(4), DesignSettings(method="top", pairs_per_image=1))
    assert chosen.dropped.tolist() == [0, 0, 0, 10]


def test_components_and_lonely_images_are_named() -> None:
    pairs = Pairs.make([0, 1, 4], [1, 2, 5], "file")
    assert components(pairs, 7).tolist() == [0, 0, 0, 2, 1, 1, 3]
    notes = component_notes(pairs, photos(7))
    assert "2 images have no pair: 003.jpg, 006.jpg" in notes[0]
    assert "2 components: 3 images with 000.jpg, 2 images with 004.jpg" in notes[1]
    assert component_notes(Pairs.make([0], [1], "file"), photos(2)) == ()
