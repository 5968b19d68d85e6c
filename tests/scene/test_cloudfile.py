"""Files of clouds: written and read whole and in parts, as COPC too; damaged ones refused."""

from __future__ import annotations

import datetime as dt
import errno
import json
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest
from scipy.spatial import cKDTree

from said import refused
from tiegraph.errors import EngineMissing, TiegraphError
from tiegraph.geometry.geodesy import Origin, make_origin
from tiegraph.scene import cloudchunks, cloudfile
from tiegraph.scene.atomic import replacing, same_file
from tiegraph.scene.cloudchunks import Measured, check_cloud, open_cloud, write_measured
from tiegraph.scene.cloudfile import read_cloud, write_cloud, write_ply
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud, DepthMap, load_depth, save_depth

UTM = make_origin(35.6965, 139.7695, 40.0, "EPSG:6691")
ENU = Origin(35.6965, 139.7695, 37.0)


def cloud(origin=None, count=500, scale=30.0):
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(count, 3))
    return Cloud(
        rng.normal(0, scale, (count, 3)),
        rng.integers(0, 256, (count, 3), dtype=np.uint8),
        (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.001, 0.5, count).astype(np.float32),
        rng.integers(2, 9, count, dtype=np.uint8),
        origin,
    )


@pytest.mark.parametrize("suffix", ["las", "laz", "ply"])
@pytest.mark.parametrize("origin", [UTM, ENU, None], ids=["utm", "enu", "free"])
def test_clouds_come_back(tmp_path, suffix, origin):
    path, before = tmp_path / f"c.{suffix}", cloud(origin)
    write_cloud(before, path)
    after = read_cloud(path, origin)
    np.testing.assert_allclose(after.xyz_m, before.xyz_m, atol=0.00051 if suffix != "ply" else 1e-9)
    for name in ("rgb", "normal", "sigma_m", "views"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["las", "laz", "ply", "copc.laz"])
def test_files_do_not_depend_on_the_day(tmp_path, monkeypatch, suffix):
    days = [dt.date(2024, 2, 29), dt.date(2025, 12, 31)]

    class Today(dt.date):
        @classmethod
        def today(cls):
            return days.pop()

    monkeypatch.setattr(laspy.header, "date", Today)
    paths = [tmp_path / f"{k}.{suffix}" for k in (0, 1)]
    for path in paths:
        if suffix == "copc.laz":
            write_copc(lambda: iter([cloud(UTM)]), path, 0.5, tmp_path)
        else:
            write_cloud(cloud(UTM), path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    if suffix != "ply":
        monkeypatch.undo()
        assert laspy.read(paths[0]).header.creation_date is None


def test_las_states_crs_version_and_full_coordinates(tmp_path):
    notes = write_cloud(cloud(UTM), tmp_path / "c.laz")
    assert "EPSG:6691" in notes[0]
    las = laspy.read(tmp_path / "c.laz")
    assert str(las.header.version) == "1.4" and las.header.point_format.id == 7
    assert las.header.parse_crs().to_epsg() == 6691
    np.testing.assert_allclose(las.header.scales, 0.001)
    np.testing.assert_allclose(las.header.offsets, UTM.shift_m)
    np.testing.assert_allclose(np.mean(las.x), cloud().xyz_m[:, 0].mean() + UTM.shift_m[0], atol=0.001)
    assert UTM.shift_m[0] > 100_000 and UTM.shift_m[1] > 3_000_000
    assert las.red.max() > 60_000
    for name in ("c.las", "c.ply"):  # ENU has no CRS and says so
        assert "35.69650000" in write_cloud(cloud(ENU), tmp_path / name)[0]
    assert laspy.read(tmp_path / "c.las").header.parse_crs() is None


def test_what_is_said_of_a_cloud_stands_in_its_header(tmp_path):
    write_copc(lambda: iter([cloud(UTM)]), tmp_path / "c.copc.laz", 0.5, tmp_path, "accuracy of a point 0.04 m")
    write_ply(cloud(UTM), tmp_path / "c.ply", "accuracy of a point 0.04 m")
    (text,) = laspy.read(tmp_path / "c.copc.laz").header.vlrs.get_by_id("LASF_Spec", [3])
    assert text.record_data_bytes() == b"accuracy of a point 0.04 m\0"
    assert b"comment accuracy of a point 0.04 m\n" in (tmp_path / "c.ply").read_bytes()[:500]
    for name in ("c.copc.laz", "c.ply"):
        assert len(read_cloud(tmp_path / name)) == len(cloud())


def test_world_is_found_again_from_the_file_alone(tmp_path):
    for name in ("c.laz", "c.ply"):
        write_cloud(cloud(UTM), tmp_path / name)
        after = read_cloud(tmp_path / name)
        np.testing.assert_allclose(after.xyz_m, cloud().xyz_m, atol=0.00051)
        assert after.origin.crs == "EPSG:6691" and after.origin.shift_m == UTM.shift_m
        assert after.origin.lat_deg == pytest.approx(UTM.lat_deg, abs=0.01)


def test_small_and_far_worlds_keep_their_precision(tmp_path):
    small = cloud(scale=0.003)
    write_cloud(small, tmp_path / "s.laz")
    np.testing.assert_allclose(read_cloud(tmp_path / "s.laz").xyz_m, small.xyz_m, atol=1e-8)
    far = Cloud(**{**cloud().__dict__, "xyz_m": cloud().xyz_m + [4e6, 3e6, 5e6]})
    write_cloud(far, tmp_path / "f.laz")
    np.testing.assert_allclose(read_cloud(tmp_path / "f.laz").xyz_m, far.xyz_m, atol=0.001)


@pytest.mark.parametrize("suffix", ["laz", "ply"])
def test_parts_are_written_one_after_another(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(cloudfile, "_CHUNK", 64)
    path, whole = tmp_path / f"c.{suffix}", cloud(UTM)
    for parts in (whole, (whole.where(slice(k, k + 100)) for k in range(0, 500, 100))):
        write_cloud(parts, path)
        np.testing.assert_allclose(read_cloud(path, UTM).xyz_m, whole.xyz_m, atol=0.00051)
    write_cloud(iter([]), path)
    assert len(read_cloud(path)) == 0


def test_files_of_others_lack_columns(tmp_path):
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales = [0.01] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.arange(30.0).reshape(3, 10)
    las.write(tmp_path / "other.las")
    found = read_cloud(tmp_path / "other.las")
    np.testing.assert_allclose(found.xyz_m[:, 1], np.arange(10, 20))
    assert np.isnan(found.normal).all() and np.isnan(found.sigma_m).all() and (found.rgb == 128).all()
    text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "other.ply").write_text(text + "1 2 3\n4 5 6\n")
    np.testing.assert_allclose(read_cloud(tmp_path / "other.ply").xyz_m, [[1, 2, 3], [4, 5, 6]])


def test_unreadable_files_are_named(tmp_path):
    write_cloud(cloud(), tmp_path / "d.ply")
    whole = (tmp_path / "d.ply").read_bytes()
    for name, content in (
        ("a.laz", b"LASF nonsense"),
        ("b.ply", b"solid"),
        ("c.txt", b"1 2 3"),
        ("d.ply", whole[:-100]),
    ):
        (tmp_path / name).write_bytes(content)
        with refused("cut off" if name == "d.ply" else name):
            read_cloud(tmp_path / name)
    with refused("no such file"):
        read_cloud(tmp_path / "none.laz")
    with refused("laz"):
        write_cloud(cloud(), tmp_path / "c.xyz")


@pytest.mark.parametrize("suffix", ["laz", "ply"])
def test_a_full_disk_is_said_and_leaves_the_old_file(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"c.{suffix}"
    write_cloud(cloud(), path)
    before = path.read_bytes()

    def full(*args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(cloudfile, "_ply_rows" if suffix == "ply" else "las_points", full)
    with pytest.raises(TiegraphError, match="No space left"):
        write_cloud(cloud(), path)
    with (
        pytest.raises(ZeroDivisionError),
        replacing(tmp_path / "x.bin") as temporary,
    ):  # other errors pass, and clean up
        temporary.write_bytes(b"half")
        raise ZeroDivisionError
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 1


def test_depth_maps_come_back_and_do_not_depend_on_the_time(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 50, (40, 50)).astype(np.float32)
    depth[:10] = np.nan
    normal = rng.normal(size=(40, 50, 3))
    normal = np.where(np.isfinite(depth)[..., None], normal / np.linalg.norm(normal, axis=-1, keepdims=True), np.nan)
    views = np.full((40, 50), 3, np.uint8)
    before = DepthMap("a/b.jpg", depth, depth * 0.01, views, np.eye(3), np.eye(4), normal.astype(np.float32))
    save_depth(before, tmp_path / "a" / "b.jpg.npz")
    after = load_depth(tmp_path / "a" / "b.jpg.npz")
    assert after.image == "a/b.jpg" and after.support is None
    np.testing.assert_allclose(after.depth_m, depth, rtol=3e-5)
    np.testing.assert_allclose(after.sigma_m, before.sigma_m, rtol=2e-3)
    assert np.nanmax(np.abs(after.normal - before.normal)) < 0.01
    np.testing.assert_array_equal(np.isnan(after.normal), np.isnan(before.normal))
    monkeypatch.setattr(zipfile.time, "localtime", lambda *_: (2030, 1, 2, 3, 4, 6, 0, 0, 0))
    save_depth(before, tmp_path / "1.npz")
    assert (tmp_path / "a" / "b.jpg.npz").read_bytes() == (tmp_path / "1.npz").read_bytes()
    save_depth(replace(before, normal=None), tmp_path / "2.npz")
    assert load_depth(tmp_path / "2.npz").normal is None
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    with refused("bad.npz"):
        load_depth(tmp_path / "bad.npz")


def test_a_cloud_without_units_may_begin_with_one_point(tmp_path):
    far = cloud(scale=5000.0)
    lone = far.where(slice(0, 1))
    write_cloud(iter([lone, far]), tmp_path / "c.laz", spacing=0.02)
    after = read_cloud(tmp_path / "c.laz")
    assert len(after) == len(far) + 1
    np.testing.assert_allclose(after.xyz_m[1:], far.xyz_m, atol=0.02 / 100)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "las", "laz"])
def test_more_points_than_there_are_is_refused_before_memory_is_asked_for(tmp_path, kind):
    path = tmp_path / (f"a.{kind}" if kind.startswith("la") else "a.ply")
    if kind.startswith("la"):
        las = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
        las.x = las.y = las.z = np.arange(10.0)
        las.write(path)
        data = bytearray(path.read_bytes())
        data[247:255] = (10**12).to_bytes(8, "little")  # number of points of LAS 1.4
        path.write_bytes(data)
    else:
        properties = "".join(f"property double {c}\n" for c in "xyz")
        path.write_text(f"ply\nformat {kind} 1.0\nelement vertex {10**12}\n{properties}end_header\n1 2 3\n")
    with refused("a.la" if kind.startswith("la") else f"cut off: its header announces {10**12} points"):
        read_cloud(path)


SPACING = 0.05


def wall(count: int, seed: int, origin: Origin | None) -> Cloud:
    """A bent wall of 40 m, 6 m high."""
    rng = np.random.default_rng(seed)
    along, up = rng.uniform(0, 40, count), rng.uniform(0, 6, count)
    xyz = np.column_stack([along + 30 * (seed % 2), 3 * np.sin(along / 5) + seed, up])
    grey = rng.integers(0, 256, (count, 3), dtype=np.uint8)
    normal = np.tile(np.float32([0, 1, 0]), (count, 1))
    return Cloud(xyz, grey, normal, np.full(count, 0.01, np.float32), np.full(count, 3, np.uint8), origin)


@pytest.mark.slow
@pytest.mark.parametrize("origin", [UTM, None], ids=["utm", "free"])
def test_the_whole_cloud_comes_back_from_any_reader(tmp_path: Path, origin: Origin | None) -> None:
    parts = [wall(30_000, 0, origin), wall(1, 3, origin), wall(20_000, 1, origin)]
    path = tmp_path / "c.copc.laz"
    notes = write_copc(lambda: iter(parts), path, SPACING, tmp_path)
    assert notes and [p.name for p in tmp_path.iterdir()] == [path.name]
    before, after = Cloud.concatenate(parts), read_cloud(path, origin)
    assert len(after) == len(before)
    distance, which = cKDTree(before.xyz_m).query(after.xyz_m)
    assert distance.max() < 0.001 and len(np.unique(which)) > 0.999 * len(before)
    assert (after.rgb == before.rgb[which]).all(axis=1).mean() > 0.999  # colours stay with their points
    np.testing.assert_allclose(np.sort(after.xyz_m, axis=0), np.sort(before.xyz_m, axis=0), atol=0.0006)
    np.testing.assert_array_equal(np.sort(after.rgb, axis=0), np.sort(before.rgb, axis=0))
    assert (after.views == 3).all() and np.allclose(after.normal, [0, 1, 0]) and np.allclose(after.sigma_m, 0.01)


@pytest.mark.slow
def test_levels_thin_the_cloud_evenly_and_boxes_are_found(tmp_path: Path) -> None:
    parts = [wall(60_000, 0, UTM), wall(60_000, 1, UTM)]
    path = tmp_path / "c.copc.laz"
    write_copc(lambda: iter(parts), path, SPACING, tmp_path)
    shift = np.asarray(UTM.shift_m)
    everything = Cloud.concatenate(parts).xyz_m
    with laspy.CopcReader.open(str(path)) as reader:
        root = np.column_stack([(q := reader.query(level=0)).x, q.y, q.z]) - shift
        cells = np.unique((root / reader.copc_info.spacing).astype(int), axis=0)
        assert 0.3 * len(root) < len(cells) <= len(root)
        whole = everything.max(axis=0) - everything.min(axis=0)
        assert (root.max(axis=0) - root.min(axis=0) > 0.9 * whole).all()
        low, high = np.array([5.0, -1.0, 1.0]), np.array([12.0, 3.0, 4.0])
        found = reader.query(bounds=laspy.copc.Bounds(low + shift, high + shift))
        inside = ((everything >= low) & (everything <= high)).all(axis=1).sum()
        assert inside > 1000 and abs(len(found) - inside) <= 5  # rounding to 1 mm at the sides
        assert len(reader.query()) == len(everything)
    with laspy.open(path) as file:
        assert file.header.vlrs[0].user_id == "copc" and file.header.parse_crs().to_epsg() == 6691
        np.testing.assert_allclose(file.header.mins - shift, everything.min(axis=0), atol=0.001)


def test_an_empty_cloud_and_a_second_name(tmp_path: Path) -> None:
    write_copc(lambda: iter([Cloud.empty(UTM)]), tmp_path / "c.copc.laz", SPACING, tmp_path)
    same_file(tmp_path / "c.copc.laz", tmp_path / "c.laz")
    assert len(read_cloud(tmp_path / "c.laz", UTM)) == 0
    with laspy.open(tmp_path / "c.laz") as file:
        assert file.header.parse_crs().to_epsg() == 6691


@pytest.mark.parametrize("name", ["c.copc.laz", "c.laz", "c.las"])
def test_extra_dimensions_state_no_extremes_that_are_not_theirs(tmp_path: Path, name: str) -> None:
    """Said before a point is written they were 0 and 2^64 - 1, at which the reader of Potree and iTowns stops."""
    path, part = tmp_path / name, wall(300, 0, UTM)
    if name == "c.copc.laz":
        write_copc(lambda: iter([part]), path, SPACING, tmp_path)
    else:
        write_cloud(part, path)
    with laspy.open(path) as reader:
        records = reader.header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs
        assert [r.format_name() for r in records] == ["sigma_m", "views", "NormalX", "NormalY", "NormalZ"]
        assert all(record.min is None and record.max is None for record in records)


_READ_BY_COPC_JS = """
const { Copc } = require('copc'), b = require('fs').readFileSync(process.argv[1]);
const get = async (from, to) => new Uint8Array(b.subarray(from, to));
(async () => {
  const c = await Copc.create(get), { nodes } = await Copc.loadHierarchyPage(get, c.info.rootHierarchyPage);
  const view = await Copc.loadPointDataView(get, c, nodes['0-0-0-0']);
  console.log(JSON.stringify([c.header.pointCount, view.getter('sigma_m')(0)]));
})();
"""


@pytest.mark.slow
def test_the_reader_of_web_viewers_opens_it(tmp_path: Path) -> None:
    """npm ``copc``, which Potree, iTowns and giro3d bundle: `npm install -g copc` and NODE_PATH=$(npm root -g)."""
    node = shutil.which("node")
    if node is None or subprocess.run([node, "-e", "require.resolve('copc')"], capture_output=True).returncode:
        pytest.skip("node or its package copc is not installed")
    write_copc(lambda: iter([wall(3000, 0, UTM)]), tmp_path / "c.copc.laz", SPACING, tmp_path)
    read = subprocess.run([node, "-e", _READ_BY_COPC_JS, tmp_path / "c.copc.laz"], capture_output=True, text=True)
    assert read.stderr == "" and json.loads(read.stdout) == [3000, pytest.approx(0.01)]


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
    with pytest.raises(EngineMissing, match=r"a.e57: .*pip install 'tiegraph\[e57\]'; LAZ needs nothing"):
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
