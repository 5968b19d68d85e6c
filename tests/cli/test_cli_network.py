"""`tiegraph network --coverage`: the candidate pairs and those that the design chose."""

import json

import numpy as np
import pytest

from boat_world import photos
from tiegraph.cli import network
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs

RING, CHAIN = Pairs.make([0, 1, 2, 0], [1, 2, 3, 3], "file"), Pairs.make([0, 1, 2], [1, 2, 3], "file")


@pytest.fixture
def judged(tmp_path, monkeypatch, capsys):
    """What --coverage says of candidate pairs and of chosen ones, and its exit code."""
    asked = []
    monkeypatch.setattr(network.run, "main_stage", lambda stage, arguments, *_: asked.append(stage))
    (tmp_path / "tiegraph.toml").write_text("[run]\nimages = '.'\n")
    for name, folder in (("scene.json", tmp_path), ("scene.json", tmp_path / "network")):
        folder.mkdir(exist_ok=True)
        (folder / name).write_text(photos(4).to_json())

    def say(candidates, chosen, *more, previews=None):
        for folder, ties in (("coarse", previews or PreviewMatches.empty()), ("design", PreviewMatches.empty())):
            (tmp_path / folder).mkdir(exist_ok=True)
            np.savez(tmp_path / folder / "matches.npz", **ties.to_npz())
        for name, pairs in (("network", candidates), ("pairs", chosen)):
            np.savez(tmp_path / f"{name}.npz", **pairs.to_npz())
        code = network.main(["--coverage", str(tmp_path), *more])
        assert asked[-1] == "design", "else the pairs that it chose may be those of another network"
        return code, capsys.readouterr().out

    return say


def test_coverage_judges_the_chosen_pairs_too(judged):
    code, said = judged(RING, RING)
    assert code == 0 and said.count("no place hangs on a single link") == 2
    code, said = judged(RING, CHAIN)
    assert code == 1 and "candidate pairs: 4 pairs hold 4 images together" in said
    assert "pairs that the design chose: 3 single links" in said
    assert "weak links of the pairs that the design chose" in said and "weak links of the candidate" not in said


def test_coverage_as_json(judged):
    code, said = judged(RING, CHAIN, "--json")
    told = json.loads(said)
    assert code == 1 and told["sound"] is False and told["bridges"] == 0 and told["pairs"] == 4
    assert told["chosen"]["sound"] is False and told["chosen"]["bridges"] == 3
    assert len(told["chosen"]["weak_links"]["rows"]) == 5 and told["weak_links"]["rows"] == []


def test_coverage_judges_by_the_matches_of_previews_too(judged):
    """All pairs of four photographs are sound by themselves; the last one shares 40 points with the first and what
    noise has with the others. Of the pairs that the design chose the one of the 40 is not: these are worse.
    """
    ends = np.array([[0, 0, 1, 0, 1, 2], [1, 2, 2, 3, 3, 3]])
    every, matches = np.stack([np.arange(400)] * 2, axis=1), [400, 400, 400, 40, 20, 20]
    looks = PreviewMatches.make(*ends, [every[:n] for n in matches])
    code, said = judged(
        Pairs.make(*ends, "file"), Pairs.make(*ends[:, np.array(matches) != 40], "file"), previews=looks
    )
    first, second = said.split("pairs that the design chose", 1)
    assert code == 1 and "candidate pairs: hardly tied to the others" in first and "003.jpg: 40" in first
    assert "003.jpg: 0" in second and "000.jpg" not in said and "few points" in first
    assert judged(RING, RING)[0] == 0  # without previews only pairs can be judged
    whole = PreviewMatches.make(*ends, [every] * 6)
    assert judged(RING, RING, previews=whole)[0] == 0
