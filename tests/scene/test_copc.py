"""COPC: the cloud comes back whole, by level, by box and from any LAZ reader."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import laspy
import numpy as np
import pytest
from scipy.spatial import cKDTree

from tiegraph.geometry.geodesy import Origin, make_origin
from tiegraph.scene.atomic import same_file
from tiegraph.scene.cloudfile import read_cloud, write_cloud
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud

UTM = make_origin(35.6965, 139.7695, 40.0, "EPSG:6691")
SPACING = 0.05


def wall(count: int, seed: int, origin: Origin | None) -> Cloud:
    """A bent wall of 40 m, 6 m high."""
    rng = np.random.default_rng(seed)
    along, up = rng.uniform(0, 40, count), rng.uniform(0, 6, count)
    xyz = np.column_stack([along + 30 * (seed % 2), 3 * np.sin(along / 5) + seed, up])
    grey = rng.integers(0, 256, (count, 3), dtype=np.uint8)
    normal = np.tile(np.float32([0, 1, 0]), (count, 1))
    return Cloud(xyz, grey, normal, np.full(count, 0.01, np.float32), np.full(count, 3, np.uint8), origin)


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


def test_the_reader_of_web_viewers_opens_it(tmp_path: Path) -> None:
    """npm ``copc``, which Potree, iTowns and giro3d bundle: `npm install -g copc` and NODE_PATH=$(npm root -g)."""
    node = shutil.which("node")
    if node is None or subprocess.run([node, "-e", "require.resolve('copc')"], capture_output=True).returncode:
        pytest.skip("node or its package copc is not installed")
    write_copc(lambda: iter([wall(3000, 0, UTM)]), tmp_path / "c.copc.laz", SPACING, tmp_path)
    read = subprocess.run([node, "-e", _READ_BY_COPC_JS, tmp_path / "c.copc.laz"], capture_output=True, text=True)
    assert read.stderr == "" and json.loads(read.stdout) == [3000, pytest.approx(0.01)]
