"""Files that arrive: only whole ones are handed out, and what goes wrong stops nothing."""

import os
import shutil

import numpy as np
import pytest

from tiegraph.watch.arrivals import Arrivals
from tiegraph.watch.tuning import ArrivalsTuning

TUNING = ArrivalsTuning(settled_s=0.6, again_s=5.0, tries=3)


@pytest.fixture
def card(tmp_path):
    (tmp_path / "card").mkdir()
    return tmp_path / "card"


def put(card, name, size, time_s=1000):
    path = card / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"x" * size)
    os.utime(path, (time_s, time_s))


def test_a_file_is_handed_out_when_it_has_stopped_growing(card):
    arrivals = Arrivals(card, TUNING)
    put(card, "a.jpg", 100)
    assert arrivals.look(0.0) == []
    put(card, "a.jpg", 200)
    assert arrivals.look(0.5) == [] and arrivals.look(1.0) == []
    assert arrivals.look(1.2) == ["a.jpg"] and arrivals.waiting() == 1
    arrivals.opened("a.jpg", True, 1.2)
    assert arrivals.look(100.0) == [] and arrivals.waiting() == 0
    put(card, "a.jpg", 200, 1001)  # another picture of the same name
    assert arrivals.look(101.0) == [] and arrivals.look(102.0) == ["a.jpg"]


def test_a_broken_file_is_opened_again_later_and_less_often_then_no_more(card):
    arrivals = Arrivals(card, TUNING)
    put(card, "a.jpg", 100)
    handed = []
    for now in np.arange(0, 60, 0.5):
        if arrivals.look(now):
            handed.append(now)
            arrivals.opened("a.jpg", False, now)
    assert len(handed) == TUNING.tries
    assert handed[1] - handed[0] == pytest.approx(5, abs=0.5) and handed[2] - handed[1] == pytest.approx(10, abs=0.5)
    put(card, "a.jpg", 120)
    arrivals.look(200.0)
    assert arrivals.look(201.0) == ["a.jpg"], "it has changed, so it is opened again"


def test_a_card_that_is_pulled_out_is_said_and_comes_back(card, tmp_path):
    arrivals = Arrivals(card, TUNING)
    assert "empty" in (arrivals.look(0.0) or arrivals.trouble)
    put(card, "DCIM/a.jpg", 100)
    arrivals.look(0.0)
    assert arrivals.look(1.0) == ["DCIM/a.jpg"] and not arrivals.trouble
    arrivals.opened("DCIM/a.jpg", True, 1.0)
    shutil.move(card, tmp_path / "away")
    assert arrivals.look(2.0) == [] and str(card) in arrivals.trouble and "gone" in arrivals.trouble
    shutil.move(tmp_path / "away", card)
    put(card, "DCIM/b.jpg", 100)
    arrivals.look(3.0)
    assert arrivals.look(4.0) == ["DCIM/b.jpg"] and not arrivals.trouble


def test_files_are_handed_out_in_the_order_they_were_written(card):
    arrivals = Arrivals(card, TUNING)
    for name, time_s in (("b.jpg", 1000), ("a.jpg", 1001), ("c.jpg", 999)):
        put(card, name, 100, time_s)
    arrivals.look(0.0)
    assert arrivals.look(1.0) == ["c.jpg", "b.jpg", "a.jpg"]
