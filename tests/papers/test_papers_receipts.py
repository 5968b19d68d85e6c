"""What of tiegraph's own acted in the measured runs of the papers' recipes, by their receipts: nothing."""

import json

import pytest
from benchmarks.papers.measure import RESULTS
from benchmarks.papers.ours import LEVELLED, STEPS, ours

ROWS = [r for r in json.loads(RESULTS.read_text())["runs"] if "ours" in r]
RUNS = {"columns": ["mapper"], "rows": [["incremental", "absent", "none", "", 1]]}


def receipts(**changed: dict) -> dict:
    """Those of a paper's recipe, with other values of some."""
    plain = {
        "candidates": {"notes": ["up runs back along down"]},
        "coarse": {"settings": {"method": "off"}},
        "design": {"settings": {"method": "all"}},
        "filter": {"settings": {"method": "off"}},
        "sparse": {"counts": {}, "tables": {"runs": RUNS, "models": {}}, "notes": []},
        "georef": {"settings": {"antenna": "ignored", "adjust": "no"}, "notes": [], "tables": {}},
    }
    return {stage: {**said, **changed.get(stage, {})} for stage, said in plain.items()}


@pytest.mark.parametrize(
    "step, changed",
    [
        ("rig check", {"candidates": {"notes": ["rig boat: the images agree with its sense of rotation"]}}),
        ("coarse model", {"coarse": {"settings": {"method": "mapper"}}}),
        ("choice of pairs", {"design": {"settings": {"method": "hybrid"}}}),
        ("view-graph filtering", {"filter": {"settings": {"method": "auto"}}}),
        ("final adjustment", {"sparse": {"notes": ["final robust adjustment: 0.3 -> 0.2 px"]}}),
        ("checks of frames, rig and lenses", {"sparse": {"tables": {"runs": RUNS, "rig diagnostics": {}}}}),
        ("sigmas of the model", {"sparse": {"counts": {"position_sigma_median": 0.1}}}),
        ("lever arm", {"georef": {"settings": {"antenna": "auto", "adjust": "no"}}}),
        ("adjustment with positions", {"georef": {"settings": {"antenna": "ignored", "adjust": "auto"}}}),
        (LEVELLED, {"georef": {"notes": ["levelled by the upward direction of the ring"]}}),
        ("models joined by matches",
         {"georef": {"tables": {"models in one world": {"rows": [["sparse/1", 35, "matches"]]}}}}),
        ("rig, positions or a second try of the mapper",
         {"sparse": {"tables": {"runs": {"rows": [["global", "absent", "none", "", 1]]}}}}),
    ],
)  # fmt: skip
def test_each_step_of_ours_shows_in_the_receipts(step: str, changed: dict) -> None:
    assert ours(receipts()) == [] and step in STEPS
    filled = receipts(**changed)
    for stage, said in receipts().items():
        filled[stage] = {**said, **filled[stage]}
    assert ours(filled) == [step]


@pytest.mark.parametrize("method", ["conventional", "meguro2024", "meguro2025"])
def test_nothing_of_ours_acted_in_a_recipe(method: str) -> None:
    rows = [r for r in ROWS if r["method"] == method]
    assert rows and all(r["status"] == "done" for r in rows), "python -m benchmarks.papers 000 001 --run"
    allowed = {LEVELLED} if method == "meguro2025" else set()
    assert all(set(r["ours"]) <= allowed for r in rows)
