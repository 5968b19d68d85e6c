"""The curve of rig diagnostics: from the file of the sparse stage, left out where there is none."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

from tiegraph.report.parts import rig_diagnostics
from tiegraph.sfm.rig.resections import COLUMNS


def test_the_curve_is_drawn_where_the_file_is(tmp_path: Path) -> None:
    run = SimpleNamespace(path=tmp_path)
    assert rig_diagnostics(run) is None
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    rows = [
        [f, "road", f"cam{c}", 30, 0.3, 0.01, 0, 0, 0.02, 0, 0, 0.01, 0.02, "", ""] for f in range(6) for c in (0, 1)
    ]
    lines = [",".join(map(str, row)) for row in [COLUMNS, *rows]]
    (tmp_path / "sparse" / "0" / "rig_diagnostics.csv").write_text("\n".join(lines) + "\n")
    found = rig_diagnostics(run)
    assert found is not None and found["chart"].startswith("<svg")
    (tmp_path / "sparse" / "0" / "rig_diagnostics.csv").write_text("frame,what\n1,2\n")
    assert rig_diagnostics(run) is None
