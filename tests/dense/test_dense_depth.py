"""From images to depth maps on a rendered corridor: errors and sigmas, COLMAP's workspace, input nobody should give."""

import pickle
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from dense_world import model_of, render, true_model

from tiegraph.dense.depth import confirmed_map, depth_map, with_normals
from tiegraph.dense.engine import DenseView, rectified_engine
from tiegraph.dense.plan import DepthRange, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tsgm import match_tsgm
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import pinhole_of, undistorted, write_workspace
from tiegraph.geometry.transforms import apply, rigid
from tiegraph.scene.results import DepthMap

pytestmark = pytest.mark.slow  # the world they share

SETTINGS = DenseSettings()
TUNING = Tuning()
NAMES = [f"up/cam0/{k:06d}.jpg" for k in (1, 2, 3)]


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return render(tmp_path_factory.mktemp("dense"))


@pytest.fixture(scope="module")
def model(survey):
    return true_model(survey)


@pytest.fixture(scope="module")
def made(survey, model):
    plan = plan_images(model, SETTINGS, TUNING.partners)
    names = [n for n in plan.images if "/cam0/" in n]
    first = {n: depth_map(plan.images[n], survey.images, None, SETTINGS, TUNING) for n in names}
    final = {n: confirmed_map(plan.images[n], first[n], first.get, SETTINGS, TUNING) for n in NAMES}
    return plan, first, final


def truth(survey, name):
    sensor = survey.rig.sensors[0]
    depth = survey.world.depth_m(sensor.camera, survey.cam_from_world[name])
    # Pixels on an edge have no single depth.
    low, high = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(depth, np.ones((3, 3)))
    return np.where(high < 1.1 * np.minimum(low, 1e6), depth, np.nan)


@pytest.fixture(scope="module")
def known(survey, made):
    """Error, stated sigma, true depth and number of views of all points of which there is a depth and a truth."""
    maps, true = [made[2][n][0] for n in NAMES], np.stack([truth(survey, n) for n in NAMES])
    depth, sigma, views = (np.stack([getattr(m, name) for m in maps]) for name in ("depth_m", "sigma_m", "views"))
    there = np.isfinite(depth - true)
    return (depth - true)[there], sigma[there], true[there], views[there]


def test_depth_errors_are_small(known):
    error, sigma, true, _ = known
    assert 0.3 < np.median(sigma / (true + error)) / (1.4826 * np.median(np.abs(error / true))) < 3
    error = error / true
    assert 0.0003 < np.median(np.abs(error)) < 0.006 and abs(np.median(error)) < 0.002
    assert np.mean(np.abs(error) > 0.05) < 0.02


def test_sigma_holds_for_certain_and_uncertain_points_alike_and_those_of_two_images(known):
    error, sigma, _, views = known
    two = np.flatnonzero(views == 2)
    assert len(two) > 1000 and np.mean(np.abs(error[two]) > 5 * sigma[two]) < 0.05
    for part in (slice(None), *np.array_split(np.argsort(sigma), 3), two):
        assert 0.3 < 1.4826 * np.median(np.abs(error[part])) / np.median(sigma[part]) < 3


def test_most_of_the_image_is_covered_by_three_views_or_all_there_are(made):
    _, first, final = made
    for name in NAMES:
        depth, counts = final[name]
        known = np.isfinite(depth.depth_m)
        assert 0.45 < known.mean() < 1 and depth.views[known].min() >= 2
        assert counts.two_rays == (depth.views == 2).sum()
        assert counts.two_rays < 0.5 * known.sum()  # five frames only: beside and ahead there is one neighbour
        assert (depth.views[~known] == 0).all()
        assert counts.before == np.isfinite(first[name].depth_m).sum()


def test_confirmation_removes_errors(survey, made):
    _, first, final = made

    def bad(depth):
        return np.nanmean(np.abs(depth.depth_m / truth(survey, NAMES[1]) - 1)[np.isfinite(depth.depth_m)] > 0.05)

    assert bad(final[NAMES[1]][0]) < bad(first[NAMES[1]])


def test_normals_of_walls_face_the_camera(survey, made):
    depth = made[2][NAMES[1]][0]
    known = np.isfinite(depth.normal).all(axis=-1)
    world = depth.normal[known] @ depth.cam_from_world[:3, :3]
    # Everything in the corridor is a face of an axis-aligned box.
    assert np.median(np.abs(world).max(axis=1)) > 0.97
    height, width = depth.depth_m.shape
    v, u = np.nonzero(known)
    rays = np.c_[u + 0.5, v + 0.5, np.ones(len(u))] @ np.linalg.inv(depth.K).T
    assert (np.sum(rays * depth.normal[known], axis=1) < 0).mean() > 0.99


def test_masked_pixels_get_no_depth_and_give_none(survey, made, tmp_path):
    plan = made[0]
    name = NAMES[1]
    for view in (plan.images[name].view, *plan.images[name].partners):
        mask = np.full((192, 256), 255, np.uint8)
        mask[:, :128] = 0
        path = tmp_path / f"{view.name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
    depth = depth_map(plan.images[name], survey.images, tmp_path, SETTINGS, TUNING)
    assert np.isnan(depth.depth_m[:, :128]).all()
    assert 0.2 < np.isfinite(depth.depth_m[:, 128:]).mean() < np.isfinite(made[1][name].depth_m[:, 128:]).mean()


def test_the_unit_of_length_does_not_matter(survey, model, made):
    scaled = pycolmap.Reconstruction(model)
    scaled.transform(pycolmap.Sim3d(0.001, pycolmap.Rotation3d(), np.array([5.0, 0, 0])))
    plan = plan_images(scaled, SETTINGS, TUNING.partners)
    name = NAMES[1]
    assert [v.name for v in plan.images[name].partners] == [v.name for v in made[0].images[name].partners]
    small = depth_map(plan.images[name], survey.images, None, SETTINGS, TUNING)
    both = np.isfinite(small.depth_m) & np.isfinite(made[1][name].depth_m)
    assert both.sum() > 0.95 * np.isfinite(made[1][name].depth_m).sum()
    ratio = small.depth_m[both] / made[1][name].depth_m[both]
    assert abs(np.median(ratio) / 0.001 - 1) < 1e-3


def test_plans_travel_to_workers(made):
    plan = made[0].images[NAMES[0]]
    again = pickle.loads(pickle.dumps(plan))
    assert again.view.camera == plan.view.camera and len(pickle.dumps(plan)) < 10_000


def picture(size=(160, 120), position=(0.0, 0, 0), rotation=None, seed=0):
    width, height = size
    grey = cv2.GaussianBlur(np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 1)
    rotation = np.eye(3) if rotation is None else rotation
    K = np.array([[200.0, 0, width / 2], [0, 200, height / 2], [0, 0, 1]])
    pose = rigid(rotation, -rotation @ np.asarray(position, float))
    bgr = cv2.cvtColor(grey.astype(np.uint8), cv2.COLOR_GRAY2BGR)
    return DenseView("x", bgr, np.ones((height, width), bool), K, pose)


def matched(reference, *partners, near=2.0, far=50.0):
    return rectified_engine(reference, partners, DepthRange(near, far), SETTINGS, TUNING, match_tsgm)


def test_images_that_share_nothing_give_no_depth():
    behind = np.diag([-1.0, 1.0, -1.0])
    for other in (picture(position=(1, 0, 0), rotation=behind), picture(position=(5000.0, 0, 0))):
        assert np.isnan(matched(picture(), other).depth_m).all()
    found = matched(picture(seed=1), picture(position=(0.5, 0, 0), seed=2), picture(position=(-0.5, 0, 0), seed=3))
    assert np.mean(found.views >= 3) < 0.05


@pytest.mark.parametrize("size", [(1, 1), (160, 1), (1, 120), (3, 3), (17, 16)])
def test_tiny_images_give_no_depth_and_no_crash(size):
    found = matched(picture(size), picture(size, (0.5, 0, 0)))
    assert found.depth_m.shape == (size[1], size[0]) and np.isfinite(found.depth_m).mean() < 1


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_poses_that_are_no_numbers_give_no_depth(value):
    broken = replace(picture(position=(0.5, 0, 0)), cam_from_world=np.full((4, 4), value))
    assert np.isnan(matched(picture(), broken).depth_m).all()
    assert np.isnan(matched(broken, picture()).depth_m).all()


def test_a_model_with_a_broken_pose_leaves_that_image_out(survey, model):
    names = sorted(survey.cam_from_world)
    sensors = {s.name: s.camera for s in survey.rig.sensors}
    poses = [survey.cam_from_world[n] for n in names]
    poses[names.index(NAMES[1])] = np.full((4, 4), np.nan)
    world = np.array([p.xyz for p in model.points3D.values()])
    seen = [np.full((len(world), 2), np.nan) for _ in names]
    for row, point in enumerate(model.points3D.values()):
        for e in point.track.elements:
            seen[e.image_id - 1][row] = model.images[e.image_id].points2D[e.point2D_idx].xy
    broken = model_of(names, [sensors[n.split("/")[1]] for n in names], poses, world, seen)
    found = plan_images(broken, SETTINGS, TUNING.partners)
    assert NAMES[1] not in found.images
    assert all(NAMES[1] != v.name for p in found.images.values() for v in p.partners)


def test_a_wrong_calibration_costs_depths_and_does_not_make_false_ones(survey, made):
    plan, right = made[0].images[NAMES[1]], made[1][NAMES[1]]
    camera = plan.view.camera
    wrong = replace(camera, params=(camera.params[0] * 1.3, *camera.params[1:]))
    partners = tuple(replace(v, camera=wrong) if v.camera == camera else v for v in plan.partners)
    bad = depth_map(replace(plan, partners=partners), survey.images, None, SETTINGS, TUNING)
    assert np.mean(bad.views >= 3) < 0.6 * np.mean(right.views >= 3)


def test_disparities_beyond_the_kernels_are_refused_or_coarser():
    left, right = np.zeros((40, 60), np.uint8), np.zeros((40, 60 + 5000), np.uint8)
    try:
        found = match_tsgm(left, right, 5000, SETTINGS, TUNING)
    except ValueError as error:
        assert "disparities" in str(error)
    else:
        assert found.shape == (40, 60)
    # The engine never asks for them: a range to nearly the camera is matched at a coarser resolution.
    found = matched(picture(), picture(position=(0.5, 0, 0), seed=0), near=1e-4, far=1e6)
    assert found.depth_m.shape == (120, 160)


def true_map(survey, plan):
    sensor = next(s for s in survey.rig.sensors if s.name == plan.view.name.split("/")[1])
    depth = survey.world.depth_m(sensor.camera, plan.view.cam_from_world).astype(np.float32)
    depth[~np.isfinite(depth)] = np.nan
    K, _ = pinhole_of(plan.view.camera, SETTINGS)
    full = np.full(depth.shape, 4, np.uint8)
    return with_normals(DepthMap(plan.view.name, depth, 0.01 * depth, full, K, plan.view.cam_from_world))


def test_colmap_fuses_our_depth_maps(survey, model, made, tmp_path):
    maps = {n: true_map(survey, p) for n, p in made[0].images.items() if "/cam0/" in n}
    assert write_workspace(tmp_path, model, survey.images, maps.get, SETTINGS) == len(maps) == 5
    assert (tmp_path / "stereo" / "fusion.cfg").read_text().split() == sorted(maps)
    options = pycolmap.StereoFusionOptions(num_threads=1, min_num_pixels=3)
    cloud = pycolmap.stereo_fusion(f"{tmp_path}/fused.ply", str(tmp_path), options=options, output_type="ply")
    xyz = np.array([p.xyz for p in cloud.points3D.values()]).reshape(-1, 3)
    assert len(xyz) > 5000
    one = maps["up/cam0/000002.jpg"]
    there = apply(one.cam_from_world, xyz)
    there = there[there[:, 2] > 0.5]
    at = there @ one.K.T
    column, row = (at[:, k] / at[:, 2] for k in (0, 1))
    inside = (column > 1) & (column < 255) & (row > 1) & (row < 191)
    said = one.depth_m[row[inside].astype(int), column[inside].astype(int)]
    assert np.nanmedian(np.abs(said / there[inside, 2] - 1)) < 0.005


def test_the_model_of_the_workspace_sees_the_same_points(model):
    names = {i.name for i in model.images.values() if "/cam0/" in i.name}
    flat = undistorted(model, names, SETTINGS)
    assert {i.name for i in flat.images.values()} == names
    assert all(c.model_name == "PINHOLE" for c in flat.cameras.values())
    assert 0 < flat.num_points3D() <= model.num_points3D()
    for image in flat.images.values():
        seen = [p for p in image.points2D if p.has_point3D()]
        at = [image.project_point(flat.points3D[p.point3D_id].xyz) for p in seen[:50]]
        assert np.abs(np.array(at) - [p.xy for p in seen[:50]]).max() < 0.01
