"""Trajectory and map of a simulated scanner, and the verb that makes them files."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from lidar.lidar_world import HALL, Turn, turns, world_from_lidar, write_bins
from near import off_after_similarity, rms
from tiegraph.cli.main import main
from tiegraph.errors import EngineMissing, InputError
from tiegraph.geometry import transforms
from tiegraph.lidar import odometry as module
from tiegraph.lidar.odometry import MapCloud, ThinScan, adjust, adjusted, odometry
from tiegraph.lidar.scans import Scan
from tiegraph.lidar.settings import LidarSettings
from tiegraph.lidar.tuning import AdjustTuning, Tuning
from tiegraph.pipeline.lidar import lidar
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.posefile import read_poses

pytest.importorskip("kiss_icp")

_TUNING = Tuning()


def _scans(made: list[Turn], timed: bool = True) -> list[Scan]:
    return [Scan(f"{k}", t.start_s, t.xyz_m, t.offset_s if timed else None) for k, t in enumerate(made)]


def _thin(made: list[Turn], timed: bool = True) -> list[ThinScan]:
    return list(odometry(iter(_scans(made, timed)), 0.5, 60.0))


def _error_m(thin: list[ThinScan], poses: np.ndarray) -> float:
    """RMS after a rigid alignment."""
    true = world_from_lidar(np.array([s.time_s for s in thin]))[:, :3, 3]
    return rms(off_after_similarity(poses[:, :3, 3], true, with_scale=False))


@pytest.fixture(scope="module")
def drive() -> tuple[list[Turn], list[ThinScan]]:
    """Turns, and what odometry makes of them; of the first ones it makes the same alone."""
    made = turns(18)
    return made, _thin(made)


@pytest.mark.slow
def test_adjusted_scans_are_better_than_odometry(drive: tuple[list[Turn], list[ThinScan]]) -> None:
    made, thin = drive[0], drive[1][:16]
    first, second = np.array([s.pose for s in thin]), np.array(list(adjusted(thin, _TUNING.adjust)))
    path = 2.0 * (thin[-1].time_s - thin[0].time_s)
    before, after = _error_m(thin, first), _error_m(thin, second)
    assert 0 < after < 0.005 * path and after < 0.7 * before
    true = world_from_lidar(np.array([s.time_s for s in thin]))
    moved, should = (transforms.invert(p[0]) @ p[-1] for p in (second, true))
    assert transforms.angle_deg(moved[:3, :3], should[:3, :3]) < 0.2
    again = _thin(made[:6])
    np.testing.assert_array_equal(first[:6], [s.pose for s in again])
    np.testing.assert_array_equal(*(list(adjusted(some, _TUNING.adjust)) for some in (again, thin[:6])))


@pytest.mark.slow
def test_windows_go_on_where_the_last_one_ended(drive: tuple[list[Turn], list[ThinScan]]) -> None:
    thin = drive[1]
    poses = np.array(list(adjusted(thin, AdjustTuning(window=12))))
    assert len(poses) == len(thin) and 0 < _error_m(thin, poses) < 0.03
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert 0.15 < steps.min() and steps.max() < 0.25


@pytest.mark.slow
def test_times_of_points_count(drive: tuple[list[Turn], list[ThinScan]]) -> None:
    """Without them a turn is bent by its own motion, 20 cm at 2 m/s."""
    made, with_times = drive[0][:10], drive[1][:10]
    without = _thin(made, timed=False)
    held = np.array([s.pose for s in without])
    loose = adjust(without, held, 1, _TUNING.adjust)
    sharp = adjust(with_times, np.array([s.pose for s in with_times]), 1, _TUNING.adjust)
    assert _error_m(with_times, sharp) < 0.8 * _error_m(without, loose)
    assert without[0].before_s is None and without[0].time_s == pytest.approx(made[0].start_s)


def test_ranges_without_points() -> None:
    with pytest.raises(InputError, match="--near-m, --far-m"):
        next(odometry(iter(_scans(turns(1, rings=4))), 200.0, 300.0))


def test_the_map_has_a_point_a_voxel_and_keeps_within_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    xyz = rng.uniform(HALL[0], HALL[1], (5000, 3))
    monkeypatch.setattr(module, "_BATCH_POINTS", 900)
    fine = MapCloud(0.5)
    for part in np.array_split(xyz, 10):
        fine.add(part)
    cloud = fine.cloud()
    assert cloud.views.sum() == 5000
    cells = np.floor(cloud.xyz_m / 0.5)
    assert len(np.unique(cells, axis=0)) == len(cloud)
    monkeypatch.setattr(module, "_MOST_POINTS", 300)
    few = MapCloud(0.1)
    few.add(xyz)
    assert 0 < len(few.cloud()) <= 300 and few.voxel_m > 0.1


pytest.importorskip("kiss_icp")

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
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
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
        (["--near-m", "-1"], "--near-m -1.0: Input should be greater"),
    ):
        assert main(["lidar", str(folder), "-o", str(out), "--columns", *_COLUMNS, *more]) != 0
        assert named in capsys.readouterr().err and not out.exists()


def test_without_kiss_icp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_bins(tmp_path / "velodyne", turns(2, rings=4))
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    with pytest.raises(EngineMissing, match=r"tiegraph\[lidar\]"):
        lidar(folder, tmp_path / "out", LidarSettings(columns=_COLUMNS))
    assert not (tmp_path / "out").exists()
