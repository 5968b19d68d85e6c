"""Scans from every format, and what is said of those that cannot be used."""

from __future__ import annotations

import json
import os
from pathlib import Path

import laspy
import numpy as np
import pytest

from bag_world import Row, bag
from lidar.lidar_world import turns, write_bins
from tiegraph.errors import InputError
from tiegraph.lidar.formats import READERS
from tiegraph.lidar.scans import Scan, open_scans
from tiegraph.lidar.settings import LidarSettings
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud

_XYZT = ("x", "y", "z", "intensity", "t")


def _read(path: Path, **how: object) -> list[Scan]:
    return list(open_scans(path, LidarSettings(**how)).read())  # type: ignore[arg-type]


def _points(count: int = 200, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(1, 9, (count, 3)), np.sort(rng.uniform(0, 0.1, count))


def _write_pcd(path: Path, xyz: np.ndarray, t: np.ndarray, encoding: str) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    kinds = (np.float32,) * 3 + (np.float64,)
    made = pypcd4.PointCloud.from_points(np.column_stack([xyz, t]), ("x", "y", "z", "time"), kinds)
    made.save(path, encoding=pypcd4.Encoding(encoding))


def _write(path: Path, xyz: np.ndarray, t: np.ndarray, form: str) -> bool:
    """A scan in a form; whether it can hold the points' times."""
    if form.startswith("pcd"):
        _write_pcd(path.with_suffix(".pcd"), xyz, t, form[4:])
    elif form == "npz":
        np.savez(path.with_suffix(".npz"), xyz_cm=np.round(xyz * 100).astype(np.int16), time_s=t)
    elif form == "ply":
        missing = np.full((len(xyz), 3), np.nan, np.float32)
        grey, none = np.zeros((len(xyz), 3), np.uint8), np.zeros(len(xyz), np.uint8)
        write_cloud(Cloud(xyz, grey, missing, missing[:, 0], none), path.with_suffix(".ply"))
        return False
    else:
        las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
        las.header.scales = [0.001] * 3
        las.x, las.y, las.z = xyz.T
        las.gps_time = t
        las.write(path.with_suffix(f".{form}"))
    return True


@pytest.mark.parametrize("form", ["pcd ascii", "pcd binary", "pcd binary_compressed", "npz", "ply", "las", "laz"])
def test_a_scan_a_file(tmp_path: Path, form: str) -> None:
    made = [_points(seed=k) for k in range(3)]
    timed = [_write(tmp_path / f"{k}", *points, form) for k, points in enumerate(made)]
    found = _read(tmp_path, rate_hz=10.0)
    assert len(found) == 3
    for k, (scan, (xyz, t)) in enumerate(zip(found, made)):
        assert scan.stamp_s == pytest.approx(k / 10)
        np.testing.assert_allclose(scan.xyz_m, xyz, atol=0.0051 if form == "npz" else 6e-4)
        if timed[k]:
            assert scan.offset_s is not None
            np.testing.assert_allclose(scan.offset_s, t, atol=1e-6)
        else:
            assert scan.offset_s is None


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_point_clouds_of_bags(tmp_path: Path, form: str) -> None:
    """PointCloud2 with padding, with times in nanoseconds from the stamp (Ouster), and NaN points."""
    made = [_points(seed=k) for k in range(3)]

    def row(k: int) -> Row:
        xyz, t = made[k]
        kind = np.dtype({"names": ["x", "y", "z", "t"], "formats": ["<f4"] * 3 + ["<u4"], "offsets": [0, 4, 8, 16],
                         "itemsize": 24})  # fmt: skip
        table = np.zeros(len(xyz) + 1, kind)
        for c, name in enumerate("xyz"):
            table[name][:-1], table[name][-1] = xyz[:, c], np.nan
        table["t"][:-1] = np.round(t * 1e9)

        def built(make, header):
            fields = [
                make("sensor_msgs/PointField", {"name": n, "offset": o, "datatype": d, "count": 1})
                for n, o, d in (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("t", 16, 6))
            ]
            return make(
                "sensor_msgs/PointCloud2",
                {
                    "header": header(500 + k / 10, "os"), "height": 1, "width": len(table), "fields": fields,
                    "is_bigendian": False, "point_step": 24, "row_step": table.nbytes,
                    "data": table.view(np.uint8).reshape(-1), "is_dense": False,
                },
            )  # fmt: skip

        return Row("/points", "sensor_msgs/PointCloud2", 500 + k / 10 + 0.05, built)

    found = _read(bag(tmp_path, form, [row(k) for k in range(3)]))
    assert [s.lost for s in found] == [1, 1, 1]
    for k, (scan, (xyz, t)) in enumerate(zip(found, made)):
        assert scan.stamp_s == pytest.approx(500 + k / 10)
        np.testing.assert_allclose(scan.xyz_m, xyz, atol=1e-5)
        assert scan.offset_s is not None
        np.testing.assert_allclose(scan.offset_s, t, atol=1e-8)


def test_kitti_layouts_and_times(tmp_path: Path) -> None:
    """velodyne/ below the folder, dates a line, other files left out and said."""
    folder = write_bins(tmp_path / "velodyne", turns(3, rings=4), with_times=False)
    (folder / "times.txt").unlink()
    (tmp_path / "timestamps.txt").write_text("".join(f"2011-09-26 13:02:25.{k}00000000\n" for k in (1, 2, 3)))
    np.zeros(4, "<f4").tofile(folder / "static_map.bin")
    recording = open_scans(tmp_path, LidarSettings())
    assert any("static_map.bin" in n for n in recording.notes)
    np.testing.assert_allclose(np.diff([s.stamp_s for s in recording.read()]), 0.1, atol=1e-6)


def test_scans_in_a_world_are_brought_back(tmp_path: Path) -> None:
    """PandaSet: more poses and times than scans, which have the numbers of their names."""
    xyz, _ = _points()
    turn = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])
    matrix = np.array([[np.cos(0.6), -np.sin(0.6), 0], [np.sin(0.6), np.cos(0.6), 0], [0, 0, 1]])
    poses = [{"position": {"x": 5.0 * k, "y": 1.0, "z": 0.0}, "heading": dict(zip("wxyz", turn))} for k in range(6)]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    (tmp_path / "timestamps.json").write_text(json.dumps([100.0 + k for k in range(6)]))
    for k in (2, 3):
        np.savez(tmp_path / f"{k:02d}.npz", xyz=xyz @ matrix.T + [5.0 * k, 1.0, 0.0])
    found = _read(tmp_path, poses=tmp_path / "poses.json")
    assert [s.stamp_s for s in found] == [102.0, 103.0]
    for scan in found:
        np.testing.assert_allclose(scan.xyz_m, xyz, atol=1e-9)


def _milliseconds(folder: Path) -> None:
    rows = np.fromfile(folder / "000000.bin", "<f4").reshape(-1, 5)
    rows[:, 4] *= 1000
    rows.tofile(folder / "000000.bin")


def _few_times(folder: Path) -> dict:
    """Names without numbers, so that rows cannot go by these."""
    for k, f in enumerate(sorted(folder.glob("*.bin"))):
        f.rename(folder / f"s{k}.bin")
    (folder / "times.txt").write_text("1\n2\n")
    return {"times": folder / "times.txt"}


SPOILT = {
    "no scans": lambda folder: [f.unlink() for f in folder.iterdir()],
    "000001.bin: .*are not points of 5 columns": lambda folder: os.truncate(
        one := folder / "000001.bin", one.stat().st_size - 7
    ),
    "only scan": lambda folder: [(folder / f"00000{k}.bin").unlink() for k in (1, 2)],
    "000001.bin: 0 of 500 points": lambda folder: np.full((500, 5), np.nan, "<f4").tofile(folder / "000001.bin"),
    "does not come after": lambda folder: (folder / "times.txt").write_text("3\n2\n1\n"),
    "2 rows for 3 scans|one each": _few_times,
    "--times": lambda folder: (folder / "times.txt").unlink(),
    "another unit": _milliseconds,
    "5 .*columns would fit.*--columns": lambda folder: {"columns": ("x", "y", "z", "intensity")},
}


@pytest.mark.parametrize("named", SPOILT)
def test_bad_scans(tmp_path: Path, named: str) -> None:
    folder = write_bins(tmp_path / "scans", turns(3, rings=5, step_deg=3.8))
    how = SPOILT[named](folder)
    with pytest.raises(InputError, match=named):
        _read(folder, **{"columns": _XYZT} | (how if isinstance(how, dict) else {}))


def test_every_reader_names_a_damaged_file(tmp_path: Path) -> None:
    for ending, reader in READERS.items():
        path = tmp_path / f"scan{ending}"
        path.write_bytes(b"no scan at all")
        with pytest.raises(InputError, match=f"scan{ending}"):
            reader(path, ("x", "y", "z", "intensity"))
