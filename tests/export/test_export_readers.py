"""Exports, opened by the programs themselves where these are installed; each test says how to have its own.

nerfstudio: `pip install nerfstudio==1.1.5 open3d`. gsplat: its examples on the path and what they import
(`PYTHONPATH=gsplat/examples`). py3dtiles: `pip install py3dtiles`. COPC: `npm install` in `web`, and Node.
"""

import json
import shutil
import subprocess
from pathlib import Path

import laspy
import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_export_tiles import Z_UP, ecef, with_cloud

from export_world import FRAMES, finished
from tiegraph.geometry.transforms import apply, invert
from tiegraph.scene.colmapmodel import matrix

pytestmark = pytest.mark.slow
WEB = Path(__file__).parents[2] / "web"
COPC = """
import { Copc } from 'copc'
const file = process.argv[1], copc = await Copc.create(file), all = []
const { nodes } = await Copc.loadHierarchyPage(file, copc.info.rootHierarchyPage)
for (const node of Object.values(nodes)) {
  const view = await Copc.loadPointDataView(file, copc, node)
  const get = ['X', 'Y', 'Z', 'Red'].map((name) => view.getter(name))
  for (let k = 0; k < view.pointCount; k++) all.push(get.map((value) => value(k)))
}
console.log(JSON.stringify({ points: all, wkt: copc.wkt }))
"""


def flat(name):
    return name.replace("/", "_")


def check_poses(made, found, tolerance):
    """world_from_cam (4, 4) by the names in the folder."""
    assert len(found) == 4 * FRAMES
    for image in made.model.images.values():
        assert np.abs(found[flat(image.name)] - invert(matrix(image.cam_from_world()))).max() < tolerance


def check_rays(made, image, directions, centre):
    """Unit rays (N, 3) of the pixels of an image pass through the points that it saw there."""
    seen = [p for p in image.points2D if p.has_point3D()]
    to = np.array([made.model.points3D[p.point3D_id].xyz for p in seen]) - centre
    angle = np.linalg.norm(np.cross(directions, to / np.linalg.norm(to, axis=1, keepdims=True)), axis=1)
    assert len(seen) > 15 and np.median(angle) < 1e-4 and angle.max() < 1e-3  # a pixel is 5e-3


@pytest.mark.parametrize("lens", ["OPENCV", "OPENCV_FISHEYE"])
def test_nerfstudio_opens_it(tmp_path, lens):
    torch = pytest.importorskip("torch")
    parser = pytest.importorskip("nerfstudio.data.dataparsers.nerfstudio_dataparser")
    pytest.importorskip("open3d")
    depths = pytest.importorskip("nerfstudio.data.datasets.depth_dataset")
    made = finished(tmp_path, (lens, lens))
    made.project.export(tmp_path / "ns", "nerfstudio")
    as_it_is = {"orientation_method": "none", "center_method": "none", "auto_scale_poses": False, "eval_mode": "all"}
    config = parser.NerfstudioDataParserConfig(data=tmp_path / "ns", load_3D_points=True, **as_it_is)
    found = config.setup().get_dataparser_outputs("train")
    poses = {}
    for k, path in enumerate(found.image_filenames):
        poses[path.name] = np.eye(4)
        poses[path.name][:3] = found.cameras.camera_to_worlds[k].numpy() * [1, -1, -1, 1]  # y up, looks along -z
    check_poses(made, poses, 1e-5)
    points = np.array([p.xyz for p in made.model.points3D.values()])
    assert cKDTree(found.metadata["points3D_xyz"].numpy()).query(points)[0].max() < 1e-5
    for k, path in enumerate(found.image_filenames):
        image = next(i for i in made.model.images.values() if flat(i.name) == path.name)
        at = np.array([p.xy for p in image.points2D if p.has_point3D()])[:, ::-1].astype(np.float32)  # rows first
        rays = found.cameras.generate_rays(camera_indices=k, coords=torch.from_numpy(at.copy()))
        check_rays(made, image, rays.directions.numpy(), poses[path.name][:3, 3])
    item = depths.DepthDataset(found)[len(found.image_filenames) - 1]
    assert item["depth_image"].shape[:2] == item["image"].shape[:2] == item["mask"].shape[:2]
    known = item["depth_image"][item["depth_image"] > 0]
    assert 1 < known.median() < 30 and not item["mask"][:, :39].any()  # metres


def test_nerfstudio_reads_what_metashape_reads(tmp_path):
    """Metashape has no free reader; nerfstudio's of its cameras leaves out b1 and the exchange of p1 and p2."""
    reader = pytest.importorskip("nerfstudio.process_data.metashape_utils")
    made = finished(tmp_path, ("PINHOLE", "SIMPLE_RADIAL"))
    made.project.export(tmp_path / "ms", "metashape")
    paths = {p.stem: Path(p.name) for p in (tmp_path / "ms" / "images").iterdir()}
    reader.metashape_to_json(paths, tmp_path / "ms" / "cameras.xml", tmp_path)
    data = json.loads((tmp_path / "transforms.json").read_text())
    back = invert(np.vstack([data["applied_transform"], [0, 0, 0, 1]]))
    found = {f["file_path"]: back @ np.array(f["transform_matrix"]) * [1, -1, -1, 1] for f in data["frames"]}
    check_poses(made, found, 1e-9)
    for frame in data["frames"]:
        image = next(i for i in made.model.images.values() if flat(i.name) == frame["file_path"])
        said = [frame[key] for key in ("fl_x", "cx", "cy", "w", "h")]
        lens = image.camera
        middle = lens.principal_point_x, lens.principal_point_y
        assert np.allclose(said, [lens.mean_focal_length(), *middle, lens.width, lens.height])
        assert frame["k1"] == (lens.params[3] if lens.model_name == "SIMPLE_RADIAL" else 0)


def test_gsplat_opens_it(tmp_path):
    colmap = pytest.importorskip("datasets.colmap")
    made = finished(tmp_path)
    made.project.export(tmp_path / "gs", "gsplat")
    found = colmap.Parser(str(tmp_path / "gs"))
    check_poses(made, dict(zip(found.image_names, found.camtoworlds)), 1e-9)
    points = np.array([p.xyz for p in made.model.points3D.values()])
    assert cKDTree(points).query(found.points)[0].max() < 1e-5
    item = colmap.Dataset(found, load_depths=True)[0]
    assert (item["depths"] > 0).all() and len(item["points"]) == len(item["depths"]) > 15
    for k in range(len(found.image_names)):
        K, size = found.Ks_dict[found.camera_ids[k]], found.imsize_dict[found.camera_ids[k]]
        assert not len(found.params_dict[found.camera_ids[k]])
        assert (K[:2, 2] == np.array(size) / 2).all() and K[0, 0] == K[1, 1]


def test_py3dtiles_opens_it(tmp_path):
    tileset = pytest.importorskip("py3dtiles.tileset.tileset")
    project = with_cloud(tmp_path)
    project.export(tmp_path / "t", "3dtiles")
    folder = tmp_path / "t" / "cloud"
    root, xyz = tileset.TileSet.from_file(folder / "tileset.json").root_tile, []
    rest = [root]
    while rest:
        tile = rest.pop()
        content = tile.get_or_fetch_content(folder)
        node = np.array(content._gltf.nodes[0].matrix).reshape(4, 4).T
        xyz.append(apply(root.transform @ Z_UP @ node, content.get_vertices().astype(float)))
        rest += tile.children
    truth = ecef(np.asarray(laspy.read(project.folder / "cloud.copc.laz").xyz))
    away, nearest = cKDTree(truth).query(np.concatenate(xyz))
    assert away.max() < 5e-4 and len(np.unique(nearest)) == len(truth) == len(away)


def test_copc_of_npm_opens_it(tmp_path):
    if shutil.which("node") is None or not (WEB / "node_modules" / "copc").is_dir():
        pytest.skip("npm install in web makes it")
    project = with_cloud(tmp_path)
    project.export(tmp_path / "p", "potree")
    command = ["node", "--input-type=module", "-e", COPC, str(tmp_path / "p" / "cloud.copc.laz")]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, cwd=WEB).stdout)
    points, las = np.array(found["points"]), laspy.read(project.folder / "cloud.copc.laz")
    away, nearest = cKDTree(np.asarray(las.xyz)).query(points[:, :3])
    assert away.max() < 5e-4 and len(np.unique(nearest)) == len(las) == len(points)
    assert (points[:, 3] == np.asarray(las.red)[nearest]).all() and "UTM zone 54N" in found["wkt"]
