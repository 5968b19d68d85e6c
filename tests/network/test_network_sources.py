"""Pair sources: files, sequences, loose photographs, and what is chosen by itself."""

from pathlib import Path

import numpy as np
import pytest

from boat_world import Result, boat
from network_steps import estimate_network
from tiegraph.errors import InputError, SettingsError
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.sources import Context, axes_count, axes_pairs, exhaustive, sequence
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, pair_lines, read_pair_list
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Dropped, Scene, simple_scene


def photos(count: int) -> Scene:
    rig = Rig("camera", (Sensor("camera"),))
    return simple_scene(rig, [f"img_{k:04d}.jpg" for k in range(count)], np.arange(count), np.zeros(count))


def context(scene: Scene, settings: CandidatesSettings) -> Context:
    cache = MatchCache(lambda pairs: [Result(0) for _ in pairs], len(scene))
    return Context(scene, find_passes(scene), cache, settings, Tuning())


def line_match(reach: int, seed: int = 0):
    """Photographs in a hidden order that share things with the next ``reach``: their places and match function."""

    def build(count: int):
        place = np.random.default_rng(seed).permutation(count)

        def match(pairs: np.ndarray) -> list[Result]:
            apart = np.abs(place[pairs[:, 0]] - place[pairs[:, 1]])
            return [Result(int(60 / a) + 9 if a <= reach else 9) for a in apart]

        return place, match

    return build


def write(folder: Path, text: str) -> Path:
    path = folder / "pairs.txt"
    path.write_text(text)
    return path


def test_pair_list_is_read_and_oddities_are_counted(tmp_path) -> None:
    text = "# made by hand\nimg_0000.jpg img_0002.jpg\n\nimg_0002.jpg img_0000.jpg # again\nimg_0001.jpg img_0001.jpg\n"
    pairs, notes = read_pair_list(write(tmp_path, text + "img_0003.jpg  img_0001.jpg\n"), photos(4))
    assert list(zip(pairs.i.tolist(), pairs.j.tolist())) == [(0, 2), (1, 3)]
    assert "1 self pairs (line 5), 1 repeated pairs (line 4)" in notes[0]


@pytest.mark.parametrize(
    "text, parts",
    [
        ("img_0000.jpg img_0001.jpg\nimg_0000.jpg imgg_03.jpg\n", ["pairs.txt, line 2", "'imgg_03.jpg'", "perhaps"]),
        ("img_0000.jpg\n", ["line 1", "two image names"]),
        ("img_0000.jpg img_0001.jpg 3\n", ["line 1", "3 words"]),
        ("# nothing\n", ["no pairs"]),
        ("\nimg_0001.jpg img_0001.jpg\nimg_0002.jpg img_0002.jpg\n", ["line 2", "its 2 lines", "themselves"]),
        ("img_0000.jpg img\0_1\n", ["pairs.txt: is no text"]),
        ("img_0000.jpg broken.jpg\n", ["left out by scan: truncated"]),
    ],
)  # fmt: skip
def test_bad_pair_lists_name_file_line_and_name(tmp_path, text, parts) -> None:
    scene = photos(4).with_(dropped=(Dropped("broken.jpg", "truncated"),))
    with pytest.raises(InputError) as error:
        read_pair_list(write(tmp_path, text), scene)
    for part in parts:
        assert part in str(error.value)


def test_missing_pair_list_is_an_error(tmp_path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_pair_list(tmp_path / "none.txt", photos(3))
    with pytest.raises(SettingsError, match="pairs_file"):
        estimate_network(photos(3), np.zeros(3), lambda p: [], CandidatesSettings(sources=("file",)), Tuning())


def test_pair_list_as_only_source_previews_nothing(tmp_path) -> None:
    path = write(tmp_path, "img_0000.jpg img_0001.jpg\n")
    settings = CandidatesSettings(sources=("file",), pairs_file=path)
    network = estimate_network(photos(4), np.zeros(4), lambda p: pytest.fail("asked"), settings, Tuning())
    assert len(network.pairs.kept()) == 1
    assert any("2 images have no pair: img_0002.jpg, img_0003.jpg" in n for n in network.notes)


def test_sequence_ties_the_next_frames_of_each_camera() -> None:
    world = boat((6, 5), (2.0, 2.0))
    plain = sequence(context(world.scene, CandidatesSettings(sequence_frames=2))).pairs
    step, key = world.scene.sequence_index[world.scene.frame], world.scene.sensor_key
    assert len(plain) == 6 * (5 + 4) + 6 * (4 + 3)
    assert (key[plain.i] == key[plain.j]).all() and (np.abs(step[plain.i] - step[plain.j]) <= 2).all()
    wide = sequence(
        context(world.scene, CandidatesSettings(sequence_frames=1, sequence_cameras=True, axes_deg=80))
    ).pairs
    across = wide.where(key[wide.i] != key[wide.j])
    angle = world.scene.rigs[0].axis_angles_deg()
    assert len(across) and angle[world.scene.sensor[across.i], world.scene.sensor[across.j]].max() < 80
    nothing = sequence(context(photos(3), CandidatesSettings()))
    assert len(nothing.pairs) == 0 and nothing.notes


def test_sequence_bridges_a_lost_image() -> None:
    rig = Rig("camera", (Sensor("camera"),))
    scene = simple_scene(rig, ["a.jpg", "c.jpg"], np.array([0, 1]), np.zeros(2), np.zeros(2), np.array([0, 2]))
    assert len(sequence(context(scene, CandidatesSettings(sequence_frames=1))).pairs) == 1


def test_few_photographs_are_compared_with_one_another() -> None:
    network = estimate_network(photos(11), np.zeros(11), lambda p: [Result(0)] * len(p), CandidatesSettings(), Tuning())
    assert len(network.pairs.kept()) == 55  # whatever the previews say
    assert len(exhaustive(context(photos(11), CandidatesSettings())).pairs) == 55
    assert "sources chosen: exhaustive" in network.notes


@pytest.mark.slow
@pytest.mark.parametrize("count, share", [(150, 1.0), (700, 0.35)])
def test_many_photographs_are_found_by_previews(count, share) -> None:
    place, match = line_match(8)(count)
    asked = [0]

    def counted(pairs):
        asked[0] += len(pairs)
        return match(pairs)

    network = estimate_network(photos(count), np.zeros(count), counted, CandidatesSettings(), Tuning())
    kept = network.pairs.kept()
    tied = np.abs(place[kept.i] - place[kept.j]) <= 8
    truth = 8 * count - 36
    assert tied.sum() > 0.9 * truth
    assert tied.mean() > 0.8
    assert asked[0] <= share * count * (count - 1) / 2
    assert (network.pairs.degree(count) > 0).all()


def test_nothing_matches_at_all_is_said_and_not_fatal() -> None:
    world = boat((6,), (2.0,))
    network = estimate_network(
        world.scene,
        np.zeros(len(world.scene)),
        lambda pairs: [Result(0) for _ in pairs],
        CandidatesSettings(),
        Tuning(),
    )
    assert network.pairs.funnel()["votes"] > 0
    assert len(network.pairs.kept()) == 6 * (5 + 4)  # the sequence stays


def test_sources_are_merged() -> None:
    world = boat((6,), (2.0,))
    settings = CandidatesSettings(sources=("sequence", "exhaustive"))
    pairs = estimate_network(world.scene, np.zeros(36), world.match, settings, Tuning()).pairs
    assert len(pairs) == 36 * 35 // 2
    assert pairs.from_source("sequence").sum() == 6 * 9 and pairs.from_source("exhaustive").all()


def test_unknown_source_is_refused() -> None:
    with pytest.raises(ValueError):
        CandidatesSettings(sources=("offset",))  # type: ignore[arg-type]


def test_pairs_that_the_axes_rule_out_are_counted_without_a_table() -> None:
    world = boat((12, 9), (2.0, 2.0))
    passes = find_passes(world.scene)
    settings = CandidatesSettings(axes_deg=80)
    listed = axes_pairs(passes, settings)
    assert axes_count(passes, settings) == len(listed) > 100
    assert np.all(listed.dropped == REASONS.index("axes"))


def test_pair_lists_of_another_system_and_no_text(tmp_path) -> None:
    path = write(tmp_path, "\ufeffimg_0000.jpg ./img_0001.jpg\r\nimg_0001.jpg img_0002.jpg\r\n")
    assert len(read_pair_list(path, photos(4))[0]) == 2
    assert pair_lines(write(tmp_path, "I 1.jpg,I 2.jpg\n'a' \"b c.jpg\"\n")) == [
        (1, ["I 1.jpg", "I 2.jpg"]), (2, ["'a'", "b c.jpg"])
    ]  # fmt: skip
    for data in (b"\xff\xfei\x00", b"\x89PNG\r\n"):
        path.write_bytes(data)
        with pytest.raises(InputError, match="pairs.txt(: is no text|, line 1: expected two image names)"):
            read_pair_list(path, photos(4))
