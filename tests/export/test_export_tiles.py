"""The cloud and the mesh as 3D Tiles, read again by trimesh: places on the Earth by PROJ, and the rules of the tree."""

import io
import json
import shutil

import cv2
import laspy
import numpy as np
import pygltflib
import pyproj
import pytest
import trimesh
from scipy.spatial import cKDTree

import mesh_world
from export_world import ORIGIN, finished
from tiegraph.errors import InputError, UnreadableArtefact
from tiegraph.mesh import files as levels
from tiegraph.mesh.files import Textured, glb
from tiegraph.mesh.surface import Mesh, ply_of
from tiegraph.scene.copc import copc_nodes, write_copc
from tiegraph.scene.results import Cloud

pytestmark = pytest.mark.slow
Z_UP = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # what a viewer of tiles does with glTF


def hill(origin) -> Cloud:
    """40 000 points of a hill 400 m wide, denser in its middle."""
    rng = np.random.default_rng(0)
    xy = np.concatenate([rng.uniform(-200, 200, (20000, 2)), rng.normal(0, 20, (20000, 2))])
    xyz = np.c_[xy, 30 * np.exp(-(xy**2).sum(axis=1) / 5000)]
    return Cloud(
        xyz_m=xyz,
        rgb=rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8),
        normal=np.tile(np.array([0, 0, 1], np.float32), (len(xyz), 1)),
        sigma_m=np.full(len(xyz), 0.01, np.float32),
        views=np.full(len(xyz), 3, np.uint8),
        origin=origin,
    )


def with_cloud(folder, origin=ORIGIN):
    """A survey with a cloud in its run folder."""
    found = finished(folder, origin=origin)
    out = found.project.folder
    write_copc(lambda: iter([hill(origin)]), out / "cloud.copc.laz", 0.5, folder)
    shutil.copy(out / "cloud.copc.laz", out / "cloud.laz")
    return found.project


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return with_cloud(tmp_path_factory.mktemp("survey"))


def ecef(crs: np.ndarray) -> np.ndarray:
    """By PROJ alone, of east, north and ellipsoidal height in the CRS of the survey."""
    lon, lat = pyproj.Transformer.from_crs(ORIGIN.crs, "EPSG:4326", always_xy=True).transform(*crs.T[:2])
    return np.stack(pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978").transform(lat, lon, crs[:, 2]), axis=-1)


def opened(folder):
    """The tileset in a folder and its tiles with their depths, checked by the rules of the specification."""
    said = json.loads((folder / "tileset.json").read_text())
    assert said["asset"]["version"] == "1.1" and said["geometricError"] > said["root"]["geometricError"]
    tiles, rest = [], [(said["root"], 0, None)]
    while rest:
        tile, depth, above = rest.pop()
        assert len(tile["boundingVolume"]["box"]) == 12 and (folder / tile["content"]["uri"]).is_file()
        middle, half = box(tile)
        assert (half > 0).all()
        if above is not None:
            assert tile["geometricError"] < above["geometricError"]
            around = box(above)
            assert (np.abs(middle - around[0]) + half <= around[1] + 1e-6).all()
        assert ("children" in tile) == (tile["geometricError"] > 0)
        tiles.append((tile, depth))
        rest += [(child, depth + 1, tile) for child in tile.get("children", ())]
    assert sorted(t["content"]["uri"] for t, _ in tiles) == sorted(p.name for p in folder.glob("*.glb"))
    return said, tiles


def box(tile):
    values = np.array(tile["boundingVolume"]["box"])
    return values[:3], np.abs(values[3:].reshape(3, 3)).sum(axis=0)


def parts(folder, tile):
    """What trimesh reads of a tile: geometries with places (N, 3) in the axes of the tree."""
    scene = trimesh.load_scene(folder / tile["content"]["uri"])
    for geometry in scene.dump():
        geometry.apply_transform(Z_UP)
        middle, half = box(tile)
        assert (np.abs(geometry.vertices - middle) <= half + 1e-4).all()
        yield geometry


def placed(said, xyz):
    matrix = np.array(said["root"]["transform"]).reshape(4, 4).T
    return xyz @ matrix[:3, :3].T + matrix[:3, 3]


def colours(path):
    """(N, 4) the colours of a file's points, which trimesh reads in 8 bits only."""
    file = pygltflib.GLTF2().load(str(path))
    accessor = file.accessors[file.meshes[0].primitives[0].attributes.COLOR_0]
    assert accessor.normalized and accessor.componentType == pygltflib.UNSIGNED_SHORT and accessor.type == "VEC4"
    start = file.bufferViews[accessor.bufferView].byteOffset
    return np.frombuffer(file.binary_blob(), "<u2", 4 * accessor.count, start).reshape(-1, 4) / 65535


def linear(rgb):
    shares = np.asarray(rgb) / 255
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def test_the_cloud_stands_where_proj_puts_it(project, tmp_path):
    assert project.export(tmp_path / "t", "3dtiles") == 40000
    said, tiles = opened(tmp_path / "t" / "cloud")
    assert said["root"]["refine"] == "ADD" and max(depth for _, depth in tiles) >= 2
    found = [part for tile, _ in tiles for part in parts(tmp_path / "t" / "cloud", tile)]
    xyz = placed(said, np.concatenate([p.vertices for p in found]))
    las = laspy.read(project.folder / "cloud.copc.laz")
    truth = ecef(np.asarray(las.xyz))
    away, nearest = cKDTree(truth).query(xyz)
    assert len(np.unique(nearest)) == len(truth) == len(xyz)  # each point, and each once
    assert away.max() < 5e-4
    rgb = np.stack([las.red, las.green, las.blue], axis=1)[nearest] >> 8
    light = np.concatenate([colours(tmp_path / "t" / "cloud" / tile["content"]["uri"]) for tile, _ in tiles])
    assert np.abs(light[:, :3] - linear(rgb)).max() < 1e-4 and (light[:, 3] == 1).all()
    assert not (tmp_path / "t" / "mesh").exists()


def test_coarse_tiles_hold_sparse_points(project):
    spacing = [(node.spacing, node.cloud.xyz_m) for node in copc_nodes(project.folder / "cloud.copc.laz", ORIGIN)]
    assert sum(len(xyz) for _, xyz in spacing) == 40000
    root, xyz = spacing[0]
    assert 0.3 * root < np.median(cKDTree(xyz).query(xyz, 2)[0][:, 1]) < 2 * root


def test_a_world_that_is_not_on_the_earth_keeps_its_axes(tmp_path):
    project = with_cloud(tmp_path, None)
    project.export(tmp_path / "t", "3dtiles")
    said, tiles = opened(tmp_path / "t" / "cloud")
    assert "transform" not in said["root"]
    xyz = np.concatenate([part.vertices for tile, _ in tiles for part in parts(tmp_path / "t" / "cloud", tile)])
    truth = np.asarray(laspy.read(project.folder / "cloud.copc.laz").xyz)
    assert cKDTree(truth).query(xyz)[0].max() < 5e-4


def test_a_damaged_cloud_and_one_without_points_are_named(tmp_path):
    project = with_cloud(tmp_path)
    path = project.folder / "cloud.copc.laz"
    data = bytearray(path.read_bytes())
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(UnreadableArtefact, match=r"cloud.copc.laz"):
        project.export(tmp_path / "t", "3dtiles")
    write_copc(lambda: iter([Cloud.empty(ORIGIN)]), path, 0.5, tmp_path)
    with pytest.raises(InputError, match="no point"):
        project.export(tmp_path / "t", "3dtiles")
    assert not (tmp_path / "t").exists()


def painted(pixels=40.0):
    """The box of the world of meshes with a texture on each of its sides, two sides beside each other on a page: the
    mesh, where its corners are, on which page, and the pages (BGR)."""
    mesh = mesh_world.true_mesh(20)
    middle, place = mesh.xyz[mesh.corners].mean(axis=1), np.zeros((len(mesh.corners), 3, 2))
    page, pages = np.zeros(len(mesh.corners), int), [np.zeros((200, 400, 3), np.uint8) for _ in range(3)]
    sides = [(k, end) for k in range(3) for end in (0.0, mesh_world.SIZE[k]) if (k, end) != (2, 0.0)]
    for number, (k, end) in enumerate(sides):
        own = np.abs(middle[:, k] - end) < 1e-6
        a, b = (j for j in range(3) if j != k)
        start = np.array([10 + 200 * (number % 2), 10])
        place[own] = start + pixels * mesh.xyz[mesh.corners[own]][..., [a, b]]
        page[own] = number // 2
        v, u = np.mgrid[0:200, 0:200]
        xyz = np.zeros((200, 200, 3))
        xyz[..., a], xyz[..., b], xyz[..., k] = (u + 0.5 - 10) / pixels, (v + 0.5 - 10) / pixels, end
        rgb = np.clip(mesh_world.colour(xyz, stripes=0), 0, 255)
        pages[number // 2][:, 200 * (number % 2) : 200 * (number % 2) + 200] = rgb[..., ::-1]
    return mesh, place, page, pages


def write_mesh(folder):
    mesh, place, page, pages = painted()
    folder.mkdir(exist_ok=True)
    jpeg = [cv2.imencode(".jpg", p, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes() for p in pages]
    size = np.array([p.shape[1::-1] for p in pages])
    (folder / "mesh.glb").write_bytes(glb(Textured(mesh, place=place, texture=page, pages=size), jpeg, {}))
    (folder / "mesh.ply").write_bytes(ply_of(mesh))
    return mesh


def test_the_mesh_in_levels_of_detail(project, tmp_path, monkeypatch):
    mesh = write_mesh(project.folder / "mesh")
    monkeypatch.setattr(levels, "MOST", 1200)  # of 4000 faces
    project.export(tmp_path / "t", "3dtiles")
    said, tiles = opened(tmp_path / "t" / "mesh")
    assert said["root"]["refine"] == "REPLACE" and len(tiles) == 5
    truth = cKDTree(ecef(mesh.xyz + ORIGIN.shift_m))
    area = trimesh.Trimesh(mesh.xyz, mesh.corners).area
    for tile, depth in tiles[:1]:  # what stands for all
        (one,) = parts(tmp_path / "t" / "mesh", tile)
        assert depth == 0 and len(one.faces) <= 1300 and one.area == pytest.approx(area, rel=0.01)
        assert truth.query(placed(said, one.vertices))[0].max() < 0.2  # a face's edge
    fine = [part for tile, depth in tiles if depth for part in parts(tmp_path / "t" / "mesh", tile)]
    assert sum(part.area for part in fine) == pytest.approx(area, rel=1e-3)  # a UTM zone's scale
    assert sum(len(part.faces) for part in fine) == len(mesh.corners)
    off = []
    for part in fine:
        away, nearest = truth.query(placed(said, part.vertices))
        assert away.max() < 5e-4
        picture = np.asarray(part.visual.material.baseColorTexture.convert("RGB"), float)
        uv = part.visual.uv[part.faces].mean(axis=1)
        x, y = uv[:, 0] * picture.shape[1], (1 - uv[:, 1]) * picture.shape[0]
        there = mesh.xyz[nearest][part.faces].mean(axis=1)
        off.append(np.abs(picture[y.astype(int), x.astype(int)] - mesh_world.colour(there, stripes=0)))
    assert np.median(np.concatenate(off)) < 4 and np.percentile(np.concatenate(off), 99) < 15
    shutil.rmtree(project.folder / "mesh")


def test_a_mesh_of_two_makings_is_refused(tmp_path):
    mesh = write_mesh(tmp_path)
    data = (tmp_path / "mesh.glb").read_bytes()
    assert len(levels.Finished.read(data, tmp_path / "mesh.ply").island) == len(mesh.corners)
    (tmp_path / "mesh.ply").write_bytes(ply_of(Mesh(mesh.xyz + 0.01, mesh.corners, mesh.rgb)))
    with pytest.raises(ValueError, match="same mesh"):
        levels.Finished.read(data, tmp_path / "mesh.ply")


def test_potree_gets_the_cloud_in_its_crs(project, tmp_path):
    assert project.export(tmp_path / "p", "potree") == 40000
    with laspy.CopcReader.open(io.BytesIO((tmp_path / "p" / "cloud.copc.laz").read_bytes())) as reader:
        assert len(reader.query(level=0)) and reader.header.parse_crs().to_epsg() == 32654
        assert np.abs(reader.header.mins - ORIGIN.shift_m).max() < 300
    said = json.loads((tmp_path / "p" / "offset.json").read_text())
    assert said["crs"] == "EPSG:32654" and said["crs_from_local"] == np.eye(4).tolist()


@pytest.mark.parametrize("name", ["3dtiles", "potree"])
def test_nothing_is_overwritten_or_half_written(project, tmp_path, name):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    with pytest.raises(InputError, match="not empty"):
        project.export(tmp_path / "full", name)
    (project.folder / "cloud.laz").rename(project.folder / "away.laz")
    with pytest.raises(InputError, match=r"cloud.laz is not there yet: run\(until='cloud'\) makes it"):
        project.export(tmp_path / "none", name)
    (project.folder / "away.laz").rename(project.folder / "cloud.laz")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["full"]
