"""`tiegraph lidar` from scans to files."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("kiss_icp")
from lidar.lidar_world import turns, write_bins
from tiegraph.cli.main import main
from tiegraph.errors import EngineMissing
from tiegraph.lidar.settings import LidarSettings
from tiegraph.pipeline.lidar import lidar
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.posefile import read_poses

_COLUMNS = ("x", "y", "z", "intensity", "t")


@pytest.mark.slow
def test_trajectory_and_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_bins(tmp_path / "velodyne", turns(6))
    out = tmp_path / "out"
    assert main(["lidar", str(folder), "-o", str(out), "--far-m", "60", "--columns", *_COLUMNS]) == 0
    said = capsys.readouterr().out
    assert "6 scans" in said
    told = json.loads((out / "lidar.json").read_text())
    assert told["path_m"] == pytest.approx(1.0, rel=0.05)
    assert len(read_poses(out / "trajectory.tum").poses) == 6
    cloud = read_cloud(out / "map.laz")
    assert len(cloud) == told["map_points"] > 1000
    again = tmp_path / "again"
    lidar(folder, again, LidarSettings(far_m=60, columns=_COLUMNS))
    assert (again / "map.laz").read_bytes() == (out / "map.laz").read_bytes()
    assert main(["lidar", str(folder), "-o", str(out)]) != 0
    assert "is there already" in capsys.readouterr().err


def test_what_cannot_be_used_is_said_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_bins(tmp_path / "velodyne", turns(3, rings=4))
    out = tmp_path / "out"
    (tmp_path / "norun").mkdir()
    (tmp_path / "place.json").write_text(json.dumps({"hand_eye": {"rig_from_lidar": [1, 2], "clock_s": 0}}))
    for more, named in (
        (["--run", str(tmp_path / "norun")], "norun"),
        (["--place", str(tmp_path / "place.json")], "rig_from_lidar"),
        (["--poses", str(tmp_path / "none.json")], "none.json"),
    ):
        assert main(["lidar", str(folder), "-o", str(out), "--columns", *_COLUMNS, *more]) != 0
        assert named in capsys.readouterr().err and not out.exists()


def test_without_kiss_icp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_bins(tmp_path / "velodyne", turns(2, rings=4))
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    with pytest.raises(EngineMissing, match=r"tiegraph\[lidar\]"):
        lidar(folder, tmp_path / "out", LidarSettings(columns=_COLUMNS))
    assert not (tmp_path / "out").exists()
