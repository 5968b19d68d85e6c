"""Bridge and open sections from the up camera, and whether they are tied to each other."""

import numpy as np
import pytest

from boat_world import boat, ring
from network_steps import network_of
from tiegraph.network.passes import find_passes
from tiegraph.network.sections import (
    Section,
    SectionResult,
    UpLight,
    by_up_frame,
    find_sections,
    join_places,
    otsu,
    two_states,
)
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene

TUNING = Tuning().sections


def survey(frames: int = 20):
    """Two passes; the first and the return pass see the bridge at the same place. Brightness (N,) by image, and which
    of them (N,) are below it."""
    world = boat((frames, frames), (2.0, 2.0))
    there = np.where(world.track == 0, world.step, frames - world.step)
    under = (there >= 8) & (there < 13)
    noise = np.random.default_rng(0).normal(0, 4, len(world.scene))
    return world, np.where(under, 60, 150) + noise, under


def of_frames(scene: Scene, under: np.ndarray) -> np.ndarray:
    return by_up_frame(scene, under.astype(float)) > 0.5


def cut(scene: Scene, light: np.ndarray | UpLight) -> SectionResult:
    return find_sections(scene, find_passes(scene), light if isinstance(light, UpLight) else UpLight(light), TUNING)


def bridges(found: SectionResult) -> np.ndarray:
    """(F,) bool: frames in a bridge section."""
    frames = [f for section in found.sections if section.kind == "bridge" for f in section.frames]
    return np.isin(np.arange(len(found.of_frame)), frames)


@pytest.mark.slow
def test_bridge_is_found_and_joined_over_both_passes() -> None:
    world, brightness, under = survey()
    network = network_of(world.scene, world.match, light=brightness)
    kinds = {s.name: s for s in network.network.cut.sections}
    assert sorted(kinds) == ["bridge 1", "open 1", "open 2"]
    bridge = np.isin(world.scene.frame, kinds["bridge 1"].frames)
    assert np.array_equal(bridge, under) and 80 < np.nanmean(network.network.cut.cues[0].threshold) < 130
    assert set(network.scene.section) == {0, 1, 2}


@pytest.mark.slow
def test_paper_001_cuts_between_sections_and_link_does_not() -> None:
    world, brightness, _ = survey()
    linked = network_of(world.scene, world.match, light=brightness)
    split = network_of(world.scene, world.match, light=brightness, sections="meguro2025")
    section = split.scene.section[split.scene.frame]
    kept = split.pairs.kept()
    assert (section[kept.i] == section[kept.j]).all()
    cut = split.pairs.funnel()["section"]
    assert cut == np.sum(linked.pairs.dropped == 0) - len(kept) > 0
    assert REASONS.index("section") not in linked.pairs.dropped
    assert any("components" in note for note in split.notes)


def test_even_light_and_slow_change_of_it_are_one_section() -> None:
    scene, rng = survey()[0].scene, np.random.default_rng(1)
    found = cut(scene, UpLight(rng.normal(150, 5, len(scene)), rng.normal(0.8, 0.03, len(scene))))
    assert len(found.sections) == 1 and "two clear classes" in found.notes[0] and "needed" in found.notes[0]
    assert (found.of_frame == 0).all() and not any(c.decided for c in found.cues)
    scene = survey(30)[0].scene
    assert len(cut(scene, 150 - 0.5 * scene.frame).sections) == 1


def test_automatic_exposure_hides_the_bridge_from_brightness_but_not_from_the_sky_share() -> None:
    """The camera opens within three frames: the deck becomes as bright as the sky was, and the sky then burns out."""
    world, _, under = survey()
    scene = world.scene
    frame_under = of_frames(scene, under)
    rng = np.random.default_rng(3)
    grey = np.zeros(scene.frames)
    gain = 1.0
    for f in range(scene.frames):
        light = 40.0 if frame_under[f] else 130.0
        grey[f] = min(255.0, light * gain) + rng.normal(0, 4)
        gain *= (130.0 / (light * gain)) ** 0.6
    sky = np.where(frame_under, 0.12, 0.8) + rng.normal(0, 0.05, scene.frames)
    alone = cut(scene, grey[scene.frame])
    both = cut(scene, UpLight(grey[scene.frame], sky[scene.frame]))
    assert np.mean(bridges(alone) == frame_under) < 0.9
    assert np.array_equal(bridges(both), frame_under)
    assert len(both.cues) == 2 and both.cues[0].decided


def test_exif_exposure_gives_the_light_itself() -> None:
    world, _, under = survey()
    rng = np.random.default_rng(4)
    exposure = np.where(under, 1 / 60, 1 / 600) * np.exp(rng.normal(0, 0.1, len(under)))
    luminance = np.where(under, 8.0, 80.0)
    grey = 255 * np.clip(luminance * exposure, 0, 1) ** (1 / 2.2) + rng.normal(0, 2, len(under))
    found = cut(world.scene, UpLight(grey, None, exposure))
    assert np.array_equal(bridges(found), of_frames(world.scene, under))
    assert [c.name for c in found.cues] == ["luminance by EXIF exposure"]
    half = np.where(world.scene.frame % 2 == 0, exposure, np.nan)  # too few images carry it
    assert [c.name for c in cut(world.scene, UpLight(grey, None, half)).cues] == ["brightness"]


def test_each_pass_has_its_own_threshold_and_a_clouded_pass_is_not_a_bridge() -> None:
    world, brightness, under = survey()
    back, passes = world.track == 1, find_passes(world.scene)
    found = cut(world.scene, np.where(back, 0.45, 1.0) * brightness)
    assert np.array_equal(bridges(found), of_frames(world.scene, under))
    first, second = (found.cues[0].threshold[p.frames[0]] for p in passes)
    assert first > 1.7 * second
    clouded = np.where(back, 60 + 0.1 * brightness, brightness)  # the whole way back as dark as the bridge was
    there = bridges(cut(world.scene, clouded))
    assert there[passes[0].frames].any() and not there[passes[1].frames].any()


@pytest.mark.slow
def test_no_up_camera_and_off_are_one_section() -> None:
    world = boat((10,), (2.0,), ring(5, up=False))
    found = cut(world.scene, np.zeros(len(world.scene)))
    assert len(found.sections) == 1 and "no camera looks up" in found.notes[0]
    dark, brightness, _ = survey()
    off = network_of(dark.scene, dark.match, light=brightness, sections="off")
    assert len(off.network.cut.sections) == 1 and (off.scene.section == 0).all()


def test_a_single_dark_frame_is_no_bridge_and_missing_images_take_the_state_of_their_neighbours() -> None:
    world, brightness, under = survey()
    up, frame = world.scene.sensor == 5, world.scene.frame
    assert not bridges(cut(world.scene, np.where(up & (frame == 3), 60, brightness)))[3]
    found = cut(world.scene, np.where(up & np.isin(frame, (2, 10)), np.nan, brightness))
    assert np.array_equal(bridges(found), of_frames(world.scene, under))


def test_otsu_splits_two_heaps() -> None:
    rng = np.random.default_rng(0)
    found = otsu(np.r_[rng.normal(60, 5, 30), rng.normal(150, 8, 70)])
    assert 75 < found.threshold < 130 and 0.9 < found.separation <= 1 and 2.2 < found.high / found.low < 2.8
    assert otsu(np.full(9, 7.0)).separation == 0.0


@pytest.mark.parametrize(("say", "dark"), [((-4, 4, -4, -4), 0), ((-4, 4, 4, -4), 2), ((-1, 1, 1, -1), 0), ((), 0)])
def test_two_states_need_more_than_one_frame(say: tuple, dark: int) -> None:
    assert two_states(np.array(say, float), TUNING).sum() == dark


@pytest.mark.parametrize("back", [False, True])
def test_places_are_joined_in_order_even_where_everything_sees_everything(back: bool) -> None:
    """Two passes cut into open, bridge, open; every image of every section is tied, the true place a little more."""
    scene = boat((9, 9), (2.0, 2.0)).scene
    cuts = [range(0, 3), range(3, 6), range(6, 9), range(9, 12), range(12, 15), range(15, 18)]
    sections = tuple(
        Section(f"{k} {n}", k, tuple(c)) for n, (k, c) in enumerate(zip(("open", "bridge", "open") * 2, cuts))
    )
    of_frame = np.repeat(np.arange(6), 3)
    i, j = np.triu_indices(len(scene), 1)
    a, b = of_frame[scene.frame[i]], of_frame[scene.frame[j]]
    place = np.array([0, 1, 2, 2, 1, 0] if back else [0, 1, 2, 0, 1, 2])
    pairs = Pairs.make(i, j, "model", overlap=np.where(place[a] == place[b], 0.55, 0.5))
    result = SectionResult(sections, of_frame, ())
    joined = join_places(result, scene, pairs, TUNING)
    assert joined.of_frame.tolist() == np.repeat(place, 3).tolist()
    within = scene.sequence[scene.frame[pairs.i]] == scene.sequence[scene.frame[pairs.j]]
    apart = join_places(result, scene, pairs.where(within), TUNING)
    assert len(apart.sections) == 6
