"""Blocks of a survey and the speed-up at equal registration, on worlds with known answers."""

from dataclasses import replace

import numpy as np
import pytest

from tiegraph.evaluate.baseline import Reference, Side, compare_sides, stretch
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene


def out_and_back(frames: int = 20) -> tuple[Scene, np.ndarray]:
    """Two passes along one line, two cameras; places (F, 3): the way back in reverse, 5 m beside."""
    rig = Rig("pair", (Sensor("a", None, np.eye(4)), Sensor("b", None, np.eye(4))))
    names = [f"{p}/{c}/{k:03d}.jpg" for p in ("down", "up") for c in "ab" for k in range(frames)]
    frame = np.array([k + frames * p for p in range(2) for _ in "ab" for k in range(frames)])
    sensor = np.array([c for _ in range(2) for c in range(2) for _ in range(frames)])
    scene = simple_scene(
        rig, names, frame, sensor, np.repeat([0, 1], frames), np.tile(np.arange(frames), 2), sequences=("down", "up")
    )
    x = np.arange(frames, dtype=float)
    along = np.r_[x, x[::-1]]
    return scene, np.column_stack([along, np.repeat([0.0, 5.0], frames), np.zeros(2 * frames)])


def test_a_block_is_a_stretch_of_both_passes_and_keeps_what_was_not_registered() -> None:
    scene, centres = out_and_back()
    lost = np.array(centres)
    lost[[9, 11, 30]] = np.nan
    for places in (centres, lost):
        taken = np.unique(scene.frame[stretch(scene, places, 40)])
        down, up = taken[taken < 20], taken[taken >= 20]
        assert 18 <= len(taken) <= 22 and abs(len(down) - len(up)) <= 6
        assert np.array_equal(down, np.arange(down[0], down[-1] + 1))  # connected, also over the frames that were lost
        assert np.array_equal(up, np.arange(up[0], up[-1] + 1))
        assert 9 in down and 11 in down
    # whole frames, and all of the survey when that is asked for
    assert len(stretch(scene, centres, 39)) == 40 and len(stretch(scene, centres, 10_000)) == len(scene)
    with pytest.raises(ValueError, match="no frame has a place"):
        stretch(scene, np.full_like(centres, np.nan), 40)


def test_loose_photographs_without_a_place_are_taken_by_their_names() -> None:
    names = [f"{k}.jpg" for k in range(10)]
    scene = simple_scene(Rig("one", (Sensor("a", None),)), names, np.arange(10), np.zeros(10, int))
    centres = np.column_stack([np.arange(10.0), np.zeros((10, 2))])
    centres[4] = np.nan
    taken = stretch(scene, centres, 4)
    assert 4 in taken and np.array_equal(taken, np.arange(taken[0], taken[-1] + 1))


def sides(lost: int = 0, bent_m: float = 0.0) -> tuple[Side, Side, Reference]:
    """Ours: 1 cm off, 60 s of CPU; theirs: 120 s, the first images ``lost``, the last half off by ``bent_m``."""
    rng = np.random.default_rng(1)
    true = rng.uniform(0, 30, (40, 3))
    every = np.ones(40, bool)
    ours = Side("tiegraph", every, true + rng.normal(0, 0.01 / 3**0.5, true.shape), np.full(40, 0.008),
                {"match": (50.0, 30.0), "sparse": (10.0, 10.0)}, {"pairs matched": 100})  # fmt: skip
    other = true * 0.5 + rng.normal(0, 0.005 / 3**0.5, true.shape)  # half the scale
    other[20:, 2] += 0.5 * bent_m
    there = np.arange(40) >= lost
    theirs = Side("COLMAP", there, np.where(there[:, None], other, np.nan), np.where(there, 0.004, np.nan),
                  {"match": (120.0, 60.0)}, {"pairs matched": 780})  # fmt: skip
    return ours, theirs, Reference(true, True, 0.3)


def rows(result: dict) -> dict[str, list]:
    return {row[0]: row[1:] for row in result["figures"]["rows"]}


def test_equal_registration_is_a_plain_speed_up() -> None:
    result = compare_sides(*sides(), ["0"] * 40)
    (said,) = result["speed_up"]
    assert said.startswith("speed-up at equal registration: 2 ") and "same 40 images" in said
    found = rows(result)
    assert found["CPU s per registered image"] == [1.5, 3.0, 2.0] and found["wall s"] == [40.0, 60.0, 1.5]
    assert all(0.006 < e < 0.014 for e in found["ATE, m"][:2])
    # sigmas in metres: the model of half the scale too
    assert found["sigma of a position, median, m"][:2] == pytest.approx([0.008, 0.008], rel=0.01)


def test_a_speed_up_names_the_images_that_are_lost() -> None:
    ours, theirs, reference = sides(lost=10)
    section = ["open"] * 20 + ["bridge"] * 20
    result = compare_sides(ours, theirs, reference, section)
    (said,) = result["speed_up"]
    assert "speed-up 2.667 per registered image, not at equal registration: COLMAP loses 10 images" in said
    assert result["lost"] == {"COLMAP": 10, "tiegraph": 0}
    by_section = {row[0]: row for row in result["sections"]["rows"]}
    assert by_section["open"][1:4] == [20, 20, 10] and by_section["bridge"][1:4] == [20, 20, 20]
    both = compare_sides(replace(ours, registered=np.arange(40) < 38), theirs, reference, section)
    assert both["lost"] == {"COLMAP": 10, "tiegraph": 2}
    assert "tiegraph loses 2" in both["speed_up"][0]


def test_a_bent_model_registers_all_and_is_not_called_equal() -> None:
    ours, theirs, reference = sides(bent_m=8.0)
    result = compare_sides(ours, theirs, reference, ["0"] * 40)
    assert "tiegraph 40 of its 40, COLMAP 20 of its 40: speed-up 4 per image at its place" in result["speed_up"][1]
    assert 1.5 < rows(result)["ATE, m"][1] < 4.5
    # by the poses of one side no place is proven
    own = compare_sides(ours, theirs, replace(reference, measured=False), ["0"] * 40)
    assert len(own["speed_up"]) == 1 and rows(own)["registered and at their place"][:2] == [None, None]


def test_a_side_without_a_model_has_no_speed_up() -> None:
    ours, theirs, reference = sides()
    none = replace(theirs, registered=np.zeros(40, bool), centres=np.full((40, 3), np.nan))
    result = compare_sides(ours, none, reference, ["0"] * 40)
    assert result["speed_up"] == ["no speed-up can be stated: COLMAP registered no image"]
    assert rows(result)["ATE, m"][1] is None and rows(result)["CPU s per registered image"][1] is None
