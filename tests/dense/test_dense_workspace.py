"""Depth maps in COLMAP's dense workspace, fused by COLMAP itself."""

import numpy as np
import pycolmap
import pytest
from dense_world import render, true_model

from tiegraph.dense.depth import with_normals
from tiegraph.dense.neighbours import plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import pinhole_of
from tiegraph.dense.workspace import undistorted, write_workspace
from tiegraph.scene.results import DepthMap

SETTINGS = DenseSettings()
TUNING = Tuning()


def fused(folder: str) -> np.ndarray:
    """Points (M, 3) that COLMAP's stereo_fusion makes of a workspace."""
    options = pycolmap.StereoFusionOptions(num_threads=1, min_num_pixels=3)
    model = pycolmap.stereo_fusion(f"{folder}/fused.ply", folder, options=options, output_type="ply")
    return np.array([p.xyz for p in model.points3D.values()]).reshape(-1, 3)


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return render(tmp_path_factory.mktemp("workspace"))


def true_map(survey, plan):
    sensor = next(s for s in survey.rig.sensors if s.name == plan.view.name.split("/")[1])
    depth = survey.world.depth_m(sensor.camera, plan.view.cam_from_world).astype(np.float32)
    depth[~np.isfinite(depth)] = np.nan
    K, _ = pinhole_of(plan.view.camera, SETTINGS)
    full = np.full(depth.shape, 4, np.uint8)
    return with_normals(DepthMap(plan.view.name, depth, 0.01 * depth, full, K, plan.view.cam_from_world))


@pytest.mark.slow
def test_colmap_fuses_our_depth_maps(survey, tmp_path):
    model = true_model(survey)
    plans = plan_images(model, SETTINGS, TUNING.partners).images
    maps = {n: true_map(survey, p) for n, p in plans.items() if "/cam0/" in n}
    assert write_workspace(tmp_path, model, survey.images, maps.get, SETTINGS) == len(maps) == 5
    assert (tmp_path / "stereo" / "fusion.cfg").read_text().split() == sorted(maps)
    xyz = fused(str(tmp_path))
    assert len(xyz) > 5000
    one = maps["up/cam0/000002.jpg"]
    there = xyz @ one.cam_from_world[:3, :3].T + one.cam_from_world[:3, 3]
    there = there[there[:, 2] > 0.5]
    at = there @ one.K.T
    column, row = (at[:, k] / at[:, 2] for k in (0, 1))
    inside = (column > 1) & (column < 255) & (row > 1) & (row < 191)
    said = one.depth_m[row[inside].astype(int), column[inside].astype(int)]
    assert np.nanmedian(np.abs(said / there[inside, 2] - 1)) < 0.005


@pytest.mark.slow
def test_the_model_of_the_workspace_sees_the_same_points(survey):
    model = true_model(survey)
    names = {i.name for i in model.images.values() if "/cam0/" in i.name}
    flat = undistorted(model, names, SETTINGS)
    assert {i.name for i in flat.images.values()} == names
    assert all(c.model_name == "PINHOLE" for c in flat.cameras.values())
    assert 0 < flat.num_points3D() <= model.num_points3D()
    for image in flat.images.values():
        seen = [p for p in image.points2D if p.has_point3D()]
        at = [image.project_point(flat.points3D[p.point3D_id].xyz) for p in seen[:50]]
        assert np.abs(np.array(at) - [p.xy for p in seen[:50]]).max() < 0.01
