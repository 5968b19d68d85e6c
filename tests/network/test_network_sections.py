"""Bridge and open sections from the up camera's brightness."""

import numpy as np
from boat_world import boat, ring

from tiegraph.network.network import estimate_network
from tiegraph.network.passes import find_passes
from tiegraph.network.sections import find_sections, otsu
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS


def survey(frames: int = 20, dark: tuple[int, int] = (8, 13)):
    """Two passes; the first and the return pass see the bridge at the same place. Brightness (N,) by image."""
    world = boat((frames, frames), (2.0, 2.0))
    step = world.scene.step[world.scene.frame]
    there = np.where(world.scene.track[world.scene.frame] == 0, step, frames - step)
    under = (there >= dark[0]) & (there < dark[1])
    noise = np.random.default_rng(0).normal(0, 4, len(world.scene))
    return world, np.where(under, 60, 150) + noise, under


def test_bridge_is_found_and_joined_over_both_passes() -> None:
    world, brightness, under = survey()
    network = estimate_network(world.scene, brightness, world.match, NetworkSettings())
    kinds = {s.name: s for s in network.sections}
    assert sorted(kinds) == ["bridge 1", "open 1", "open 2"]
    bridge = np.isin(world.scene.frame, kinds["bridge 1"].frames)
    assert np.array_equal(bridge, under)
    assert 80 < network.threshold < 130
    assert set(network.scene.section) == {0, 1, 2}


def test_split_cuts_between_sections_and_link_does_not() -> None:
    world, brightness, _ = survey()
    linked = estimate_network(world.scene, brightness, world.match, NetworkSettings())
    split = estimate_network(world.scene, brightness, world.match, NetworkSettings(sections="split"))
    section = split.scene.section[split.scene.frame]
    kept = split.pairs.kept()
    assert (section[kept.i] == section[kept.j]).all()
    cut = split.pairs.funnel()["section"]
    assert cut == np.sum(linked.pairs.dropped == 0) - len(kept) > 0
    assert REASONS.index("section") not in linked.pairs.dropped
    assert any("components" in note for note in split.notes)


def test_even_brightness_is_one_section() -> None:
    world, _, _ = survey()
    even = np.random.default_rng(1).normal(150, 5, len(world.scene))
    found = find_sections(world.scene, find_passes(world.scene), even)
    assert len(found.sections) == 1 and "two clear classes" in found.notes[0]
    assert (found.of_frame == 0).all() and np.isnan(found.threshold)


def test_no_up_camera_and_off_are_one_section() -> None:
    world = boat((10,), (2.0,), ring(5, up=False))
    found = find_sections(world.scene, find_passes(world.scene), np.zeros(len(world.scene)))
    assert len(found.sections) == 1 and "no camera looks up" in found.notes[0]
    dark, brightness, _ = survey()
    off = estimate_network(dark.scene, brightness, dark.match, NetworkSettings(sections="off"))
    assert len(off.sections) == 1 and (off.scene.section == 0).all()


def test_a_single_dark_frame_is_no_bridge() -> None:
    world, brightness, _ = survey()
    up = world.scene.sensor == 5
    flash = brightness.copy()
    flash[up & (world.scene.frame == 3)] = 60
    found = find_sections(world.scene, find_passes(world.scene), flash)
    assert all(3 not in s.frames for s in found.sections if s.kind == "bridge")


def test_otsu_splits_two_heaps() -> None:
    rng = np.random.default_rng(0)
    threshold, separation, ratio = otsu(np.r_[rng.normal(60, 5, 30), rng.normal(150, 8, 70)])
    assert 75 < threshold < 130 and 0.9 < separation <= 1 and 2.2 < ratio < 2.8
    assert otsu(np.full(9, 7.0))[1] == 0.0
