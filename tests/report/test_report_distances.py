"""Colours of the interactive view: what was measured near a point, and its section by name; how well passes agree."""

import json
from pathlib import Path

import numpy as np
import pytest
from fake_survey_run import make_run

from accuracy_marks import check, unmarked
from tiegraph.geometry.geodesy import Origin
from tiegraph.report.html import write_report
from tiegraph.report.parts import PASSES
from tiegraph.report.runfolder import RunFolder, read_run
from tiegraph.report.settings import ReportSettings
from tiegraph.report.spatial import distance_scales, section_scale
from tiegraph.scene.cloudchunks import Measured, write_measured

pytestmark = pytest.mark.slow  # a made-up run and its page
COLUMNS = ["section", "core points", "median m", "spread m"]
SECTIONS = "sections: open 1 (5 frames), bridge 1 (5 frames)"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with two passes compared and a reference cloud, its sections named."""
    made = make_run(tmp_path_factory.mktemp("run") / "quay")
    metrics = json.loads((made / "metrics.json").read_text())
    rows = [["all", 900, 0.001, 0.021], ["0", 500, 0.002, 0.017], ["1", 400, -0.001, 0.033]]
    metrics["tables"][PASSES] = {"columns": COLUMNS, "rows": rows}
    (made / "metrics.json").write_text(json.dumps(metrics))
    receipt = json.loads((made / "receipts" / "network.json").read_text())
    (made / "receipts" / "network.json").write_text(json.dumps({**receipt, "notes": [SECTIONS]}))
    origin = Origin.from_dict(json.loads((made / "world.json").read_text())["origin"])
    xyz = np.stack(np.meshgrid(np.arange(0, 10, 0.1), [9.0], np.arange(0, 5, 0.1)), -1).reshape(-1, 3)
    for name in ("evaluate/distances.laz", "passes/differences.laz"):
        (made / name).parent.mkdir(exist_ok=True)
        write_measured([Measured(xyz, {"distance_m": xyz[:, 0] - 5}, (-1, 1))], made / name, origin, 0.1)
    return made


@pytest.fixture(scope="module")
def run(folder: Path) -> RunFolder:
    return read_run(folder, 1000)


def test_a_point_has_the_distance_of_what_was_measured_next_to_it(run: RunFolder) -> None:
    xyz = np.array([[2.02, 9.01, 3.0], [7.5, 9.0, 1.0], [7.5, 8.0, 1.0], [-5, 9, 3.0]])
    found = distance_scales(run, xyz)
    assert [(name, s.signed) for name, s in found.items()] == [
        ("distance to the reference cloud", False),
        ("one pass against the other", True),
    ]
    for scale in found.values():
        assert np.allclose(scale.values, [-3, 2.5, np.nan, np.nan], atol=0.06, equal_nan=True)


def test_a_point_lies_in_the_section_of_the_nearest_camera(run: RunFolder) -> None:
    (scale,) = section_scale(run, np.array([[2.0, -3, 2], [15.0, -3, 2]])).values()
    assert [scale.names[int(k)] for k in scale.values] == ["open\N{NO-BREAK SPACE}1", "bridge\N{NO-BREAK SPACE}1"]


def test_what_cannot_be_read_is_left_out(folder: Path, tmp_path: Path, caplog) -> None:
    empty = make_run(tmp_path / "run", until="georef")
    (empty / "passes").mkdir()
    (empty / "passes" / "differences.laz").write_bytes(b"no cloud")
    assert distance_scales(read_run(empty, 100), np.zeros((1, 3))) == {}
    assert "differences.laz cannot be read and is left out" in caplog.text


def test_the_page_says_how_well_the_passes_agree(folder: Path) -> None:
    page = write_report(folder, ReportSettings(viewer_points=500)).read_text(encoding="utf-8")
    sure = page[page.index('<h2 id="sure">') : page.index('<h2 id="found">')]
    assert "One pass against the other" in sure and "were not compared" not in sure
    assert "<td>bridge\N{NO-BREAK SPACE}1</td>" in sure and f'"tables.{PASSES}.2.3">0.03' in sure
    assert page.count(f"tables.{PASSES}.0.2") == 1, "once, and not among the references"
    assert unmarked(page) == [] and f"tables.{PASSES}.0.3" in check(folder, page)
    data = json.loads(page[page.index('id="viewer-data">') + 17 :].partition("</script>")[0])
    assert [s["name"] for s in data["scales"]][2:] == [
        "distance to the reference cloud", "one pass against the other", "section",
    ]  # fmt: skip
    signed = data["scales"][3]
    assert signed["signed"] and signed["low"] == -signed["high"] and signed["unknown"]
