"""What is said of a figure that is not known."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tiegraph.report.accuracy import placement, placement_part
from tiegraph.scene.results import Accuracy
from tiegraph.sfm.finish import _open_notes
from tiegraph.sfm.tuning import SigmaTuning
from tiegraph.text import known_to


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.42, "known to 42 % of its length only"), (1.3, "is not known,"), (709995883324.75, "is not known,"),
     (float("nan"), "is not known,")],
)  # fmt: skip
def test_a_lever_arm_whose_sigma_exceeds_it_is_not_known(share: float, words: str) -> None:
    (note,) = _open_notes(SimpleNamespace(open_mountings=lambda tuning: {2: share}), {2: "cam2"}, SigmaTuning())
    assert note.startswith("the lever arm of cam2 is ") and words in note
    assert len(note) < 220


def test_sigmas_larger_than_what_they_are_of_are_words() -> None:
    said = Accuracy("m", "positions", (), {"scale": 3.1e5, "yaw_deg": 4.0e4, "tilt_deg": 1.5})
    assert placement(said).striptags().endswith("heading not known; tilt 1.5°; scale not known.")
    assert placement_part(Accuracy("m", "", (), {"scale": 0.01}), "scale").striptags() == "scale 1.0 %"


def test_the_limit_is_the_size_of_the_thing() -> None:
    assert known_to(0.2, 1.0, "20 %") == "known to 20 %"
    assert known_to(1.0, 1.0, "100 %") == known_to(float("inf"), 90.0, "inf deg") == "not known"
