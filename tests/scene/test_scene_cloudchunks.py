"""Clouds read in parts, of every format, and what is wrong with them said."""

from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest

from said import refused
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene import cloudchunks
from tiegraph.scene.cloudchunks import Measured, check_cloud, open_cloud, write_measured
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud

ORIGIN = Origin(lat_deg=35.7, lon_deg=139.7, height_m=37.0, crs="EPSG:32654", shift_m=(380000.0, 3950000.0, 30.0))


def a_cloud(points: int = 500) -> Cloud:
    rng = np.random.default_rng(0)
    return Cloud(
        xyz_m=rng.uniform(-20, 20, (points, 3)),
        rgb=np.zeros((points, 3), np.uint8),
        normal=np.zeros((points, 3), np.float32),
        sigma_m=rng.uniform(0.01, 0.02, points).astype(np.float32),
        views=np.full(points, 3, np.uint8),
        origin=ORIGIN,
    )


def las_in(path: Path, crs: str | None = None, points: int = 10) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    if crs is not None:
        header.add_crs(pyproj.CRS(crs))
    las = laspy.LasData(header)
    las.xyz = np.arange(3.0 * points).reshape(points, 3)
    las.write(path)
    return path


@pytest.mark.parametrize("name", ["a.las", "a.laz", "a.copc.laz", "a.ply"])
def test_every_format_gives_coordinates_of_the_crs_in_parts(tmp_path: Path, name: str, monkeypatch) -> None:
    monkeypatch.setattr(cloudchunks, "_PART", 70)
    cloud, path = a_cloud(), tmp_path / name
    if name == "a.copc.laz":
        write_copc(lambda: iter([cloud]), path, 1.0, tmp_path)
    else:
        write_cloud(cloud, path)
    source = open_cloud(path)
    parts = list(source.parts())
    assert max(map(len, parts)) <= 70 and len(parts) >= 8
    xyz, sigma = np.concatenate([p.xyz for p in parts]), np.concatenate([p.sigma for p in parts])
    true = cloud.xyz_m + ORIGIN.shift_m
    order, theirs = np.lexsort(xyz.T.round(3)), np.lexsort(true.T.round(3))
    assert np.abs(xyz[order] - true[theirs]).max() < 6e-4 and np.allclose(sigma[order], cloud.sigma_m[theirs])
    assert source.crs == (None if name == "a.ply" else "EPSG:32654")


def test_e57_is_read_scan_by_scan(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    xyz, path, place = a_cloud().xyz_m, tmp_path / "scan.e57", np.array(ORIGIN.shift_m)
    file = pye57.E57(str(path), mode="w")
    for half in (xyz[:200], xyz[200:]):
        file.write_scan_raw(dict(zip(("cartesianX", "cartesianY", "cartesianZ"), half.T.copy())), translation=place)
    file.close()
    parts = list(open_cloud(path).parts())
    assert [len(p) for p in parts] == [200, 300]
    # pye57 writes single precision about the scanner's place, which is double
    assert np.abs(np.concatenate([p.xyz for p in parts]) - xyz - place).max() < 2e-6
    path.write_bytes(path.read_bytes()[:2000])
    with refused(r"scan.e57: not a readable point cloud: .* Copy or export it again"):
        list(open_cloud(path).parts())


def test_e57_without_its_reader_names_the_extra(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pye57", None)
    (tmp_path / "a.e57").write_bytes(b"ASTM-E57")
    with refused(r"pip install tiegraph\[e57\], or convert it to LAZ"):
        check_cloud(tmp_path / "a.e57")


def test_damaged_and_empty_files_say_what_to_do(tmp_path: Path) -> None:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\nelement vertex {{}}\n{axes}end_header\n"
    las_in(tmp_path / "empty.las", None, 0)
    for name in ("cut.las", "cut.laz"):
        whole = las_in(tmp_path / name, None, 5000).read_bytes()
        (tmp_path / name).write_bytes(whole[:-500])
    for name, data in (
        ("broken.laz", "LASF"),
        ("text.ply", "1 2 3\n"),
        ("nan.ply", head.format(2) + "1 2 3\n1 nan 3\n"),
        ("zero.ply", head.format(0)),
    ):
        (tmp_path / name).write_text(data)
    for name, words in (
        ("none.laz", "no such point cloud"),
        ("a.xyz", "a.xyz: clouds are read from .las, .laz, .ply or .e57: convert it"),
        ("broken.laz", "broken.laz: not a readable point cloud"),
        ("text.ply", "text.ply: .* no PLY file by its content"),
        ("empty.las", "empty.las: its header announces 0 points"),
    ):
        with refused(words):
            open_cloud(tmp_path / name)
    for name, words in (
        ("cut.las", "cut.las.* cut off"),
        ("cut.laz", "cut.laz.* cut off"),
        ("nan.ply", "nan.ply: 1 points have no coordinates .* point 2"),
        ("zero.ply", "zero.ply: it has no points"),
    ):
        with refused(words):
            list(open_cloud(tmp_path / name).parts())


def test_a_crs_in_degrees_or_feet_is_refused(tmp_path: Path) -> None:
    assert open_cloud(las_in(tmp_path / "a.laz", "EPSG:6691")).crs == "EPSG:6691"
    for crs, words in (("EPSG:4326", "not projected"), ("EPSG:2229", "foot"), ("EPSG:6340+6360", "foot")):
        with refused(rf"other.laz: the CRS in its header .* {words}.* convert the file"):
            check_cloud(las_in(tmp_path / "other.laz", crs))


def test_heights_above_a_geoid_are_those_of_the_header_or_said(tmp_path: Path, monkeypatch) -> None:
    path = las_in(tmp_path / "a.laz", "EPSG:6691+6695")
    found = open_cloud(path)
    assert found.crs == "EPSG:6691" and "heights refer to another level (EPSG:6695)" in found.note
    monkeypatch.setattr(cloudchunks, "check_vertical", lambda crs: None)  # its grid is there
    assert (open_cloud(path).crs, open_cloud(path).note) == ("EPSG:6691+6695", "")


def test_what_was_measured_is_written_part_by_part(tmp_path: Path) -> None:
    xyz, value = a_cloud().xyz_m, np.linspace(-0.1, 0.1, 500)
    value[7] = np.nan
    parts = [Measured(xyz[k : k + 250], {"distance_m": value[k : k + 250]}, (-0.1, 0.1)) for k in (0, 250)]
    assert write_measured(parts, tmp_path / "out.laz", ORIGIN, 0.01) == 500
    las = laspy.read(tmp_path / "out.laz")
    assert np.allclose(las["distance_m"], value, equal_nan=True) and las.header.parse_crs().to_epsg() == 32654
    assert np.abs(np.asarray(las.xyz) - xyz - ORIGIN.shift_m).max() < 6e-4
    assert las.blue[0] > las.red[0] and las.red[-1] > las.blue[-1] and las.red[7] == las.blue[7]
    assert write_measured([], tmp_path / "none.laz", ORIGIN, 0.01) == 0 and not (tmp_path / "none.laz").exists()
