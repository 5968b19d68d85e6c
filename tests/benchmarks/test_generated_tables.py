"""Tables of documents that are written from results: what stands in them, and that documents and results agree."""

import json

import pytest

from benchmarks import bands, learned, lidar, table

_ROW = {
    "set": "boat", "images": 60, "unit": "m", "held_by": "nothing",
    "bands": {
        "in the world": [0.02, 0.03], "over 10 m": [0.004, 0.002], "over 100 m": [None, None],
        "over the whole": [0.0051, 1.02],
    },
}  # fmt: skip
_SIGMA = {"set": "gantry", "position_m": {"predicted": 0.5, "actual": 0.25}, "truth_m": 0.0}


def test_bands_state_both_and_their_ratio() -> None:
    rows = bands.table([_ROW], [_SIGMA]).splitlines()
    assert rows[2].split(" | ")[2:6] == ["20 mm / 30 mm (1.5)", "4 mm / 2 mm (0.5)", "-", "5.1 mm / 1.02 m (2e+02)"]
    assert rows[2].endswith("| not run | not known |")
    assert rows[3] == "| `gantry` |  | not run | not run | not run | not run | 0.5 m / 0.25 m (0.5) | none |"


def test_the_document_holds_what_the_results_say() -> None:
    rows, sigma = (json.loads((bands._RESULTS / f"{n}.json").read_text())["rows"] for n in ("bands", "sigma"))
    said = f"{bands.BEGIN}\n{bands.table(rows, sigma)}\n{bands.END}"
    assert bands._DOCUMENT.read_text().count(said) == 1, "python -m benchmarks.bands --write"


def test_the_table_of_learned_features_is_that_of_the_results() -> None:
    said = f"{learned.BEGIN}\n{learned.table(json.loads(learned._RESULTS.read_text()))}\n{learned.END}"
    assert learned._DOCUMENT.read_text().count(said) == 1, "python -m benchmarks.learned --write"


def test_the_page_of_the_lidar_holds_what_the_results_say() -> None:
    rows = json.loads((lidar._RESULTS / "lidar.json").read_text())["rows"]
    said = f"{lidar.BEGIN}\n{lidar.tables(rows)}\n{lidar.END}"
    assert lidar._DOCUMENT.read_text().count(said) == 1, "python -m benchmarks.lidar --write"


@pytest.mark.parametrize("name", table._DOCUMENTS)
def test_the_table_of_figures_is_that_of_the_results(name: str) -> None:
    said = f"{table.BEGIN}\n{table.figures(*table._DOCUMENTS[name])}\n{table.END}"
    assert (table._ROOT / name).read_text().count(said) == 1, "python -m benchmarks.table --write"
