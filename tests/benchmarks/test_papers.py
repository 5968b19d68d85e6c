"""Tables of papers and documents: printed from what is kept, without running anything, and documents agree with it."""

import json
from pathlib import Path

import pytest
from benchmarks.papers.__main__ import main
from benchmarks.papers.measure import RESULTS, RUNS
from benchmarks.papers.printed import PRINTED
from benchmarks.papers.tables import tables

from benchmarks import bands, check, learned, lidar, table

_ROOT = Path(__file__).resolve().parents[2]


def row(name: str, method: str, **more: object) -> dict:
    stages = {"masks": [1.0, 1.0], "preview": [2.0, 2.0], "features": [3.0, 3.0], "match": [4.0, 4.0],
              "sparse": [5.0, 5.0], "dense": [60.0, 60.0], "cloud": [7.0, 7.0], "scan": [100.0, 1.0]}  # fmt: skip
    counts = {"matched": 50, "verified": 40, "dense_points": 9000}
    return {"set": name, "method": method, "seed": 0, "status": "done", "stages": stages, "counts": counts,
            "images": 20, "largest": 16, "components": 2, "points": 700, "ate_m": 0.25, "rmse_m": 0.003,
            **more}  # fmt: skip


def cells(text: str, name: str) -> list[str]:
    """The cells of the first row of that name below "Here"."""
    found = next(li for li in text.partition("## Here")[2].splitlines() if li.startswith(f"| {name} |"))
    return [c.strip() for c in found.strip("| ").split("|")][1:]


def test_each_printed_row_fills_its_columns() -> None:
    for paper, printed in PRINTED.items():
        for one in printed:
            assert all(len(r) == len(one.columns) for r in one.rows), (paper, one.title)
    assert set(PRINTED) == set(RUNS) == {"000", "001", "002", "003", "004"}
    # what the papers' totals add up to, where they do
    two = dict((r[0], r[1:]) for r in PRINTED["000"][1].rows)
    assert two["Total"] == pytest.approx(
        [sum(v) for v in zip(two["SfM"], two["MVS"], two["Mask image creation"])], abs=1
    )
    for one in PRINTED["001"][2:]:
        column = {r[0]: r[1:] for r in one.rows}
        total = [sum(values) for values in zip(*list(column.values())[:5])]
        assert column["Overall processing"] == pytest.approx(total, abs=0.2)


def test_paper_000_adds_up_the_stages_of_its_rows() -> None:
    text = tables("000", [row("canal_demo", "tiegraph"), row("canal_demo", "meguro2024", largest=10)])
    assert cells(text, "SfM, total") == ["14", "14"] and cells(text, "MVS") == ["67", "67"]
    assert cells(text, "Total") == ["82", "82"]  # without scan, which the papers do not count
    assert cells(text, "CPU s of SfM an image used") == ["1.4", "0.875"]  # meguro2024 stands before tiegraph
    assert "Not measured (`--run`): canal_demo: conventional; canal_demo: meguro2024, no list; " in text
    longer = tables("000", [row("canal_demo", "tiegraph"), row("canal", "tiegraph", largest=10)])
    assert "table 1 on `canal`" in longer and "table 1 on `canal`" not in text
    assert cells(longer, "SfM, total") == ["14"] and cells(longer, "CPU s of SfM an image used") == ["1.4"]


def test_of_several_seeds_the_median_stands_with_the_least_and_the_most() -> None:
    rows = [row("canal_demo", "meguro2024", seed=k, ate_m=a, largest=n) for k, (a, n) in enumerate(
        [(0.1, 100), (0.3, 50), (5.0, 100)])]  # fmt: skip
    text = tables("000", rows)
    assert cells(text.partition("table 2 on")[2].join(("## Here", "")), "ATE, m") == ["0.3 (0.1 to 5)"]
    assert cells(text, "Images used") == ["100 (50 to 100)"]
    shown = [
        {"competitor": "colmap", "calibration": "estimated", "repeat": k, "registered": n, "largest": n,
         "components": 1, "ate_m": a, "cpu_s": 150 + k}
        for k, (a, n) in enumerate([(0.08, 100), (6.1, 100), (0.12, 95)])
    ]  # fmt: skip
    assert table._figure(shown) == "100 (95 to 100), 0.12 m (80 mm to 6.1 m), 151 (150 to 152) s"


def test_figures_that_no_longer_hold_are_named(capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    assert check.main([]) == 0 and "5 of 5 figures hold" in capsys.readouterr().out
    monkeypatch.setattr(table, "figures", lambda *shown: "| another |")
    assert check.main([]) == 1
    said = capsys.readouterr().out
    assert "README.md no longer holds (python -m benchmarks.table --write)" in said and "+ | another |" in said


def test_paper_003_lays_both_ways_side_by_side() -> None:
    fast = row("vehicle ring", "by poses", counts={"matched": 10, "dense_points": 8000})
    text = tables("003", [row("vehicle ring", "all pairs"), fast])
    assert (
        "| vehicle ring, 20 images, by poses | 50 / 10 | 82 / 82 |" in text and "| vehicle ring, by poses | 5 |" in text
    )
    assert "| ID 2 | 12.62 | 1.13 |" in text


def test_paper_004_is_the_planners_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["004"]) == 0
    said = capsys.readouterr().out
    assert cells(said, "Precision, mm") == ["0.431", "0.845", "1.725", "2.484"]
    assert cells(said, "Resolution, px/mm2") == ["21.5", "11", "5.4", "3.7"]
    printed = [[45, 36], [65, 53], [98, 81], [119, 98]]
    ours = [[float(v) for v in c.split("*")] for c in cells(said, "Common to the square of four, cm")]
    assert all(abs(a - b) < 1.6 for p, o in zip(printed, ours) for a, b in zip(p, o))


@pytest.mark.parametrize("paper", sorted(RUNS))
def test_what_is_kept_prints(paper: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert RESULTS.exists() and main([paper]) == 0
    assert f"# Paper {paper}" in capsys.readouterr().out


def test_the_figures_of_the_documents_are_those_of_the_results(tmp_path: Path) -> None:
    for name in table._DOCUMENTS:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((_ROOT / name).read_text())
    table.write(tmp_path)
    for name in table._DOCUMENTS:
        assert (tmp_path / name).read_text() == (_ROOT / name).read_text(), (
            f"{name}: python -m benchmarks.table --write"
        )


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
