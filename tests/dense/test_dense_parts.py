"""Partners and depths of a map; matching, combination, comparison and normals on surfaces with exact truth."""

from dataclasses import fields, replace

import cv2
import numpy as np
import pycolmap
import pytest
from dense_world import model_of

from tiegraph.dense import plan as planning
from tiegraph.dense.depth import Consistency, check, gone, with_normals
from tiegraph.dense.engine import Candidates, triangulate
from tiegraph.dense.plan import EPIPOLE, ONE_CENTRE, SCALE, WIDE, CameraModel, ViewPlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view, pinhole_of
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.scene.results import DepthMap

SETTINGS = DenseSettings()
TUNING = Tuning()
K = np.array([[200.0, 0, 80], [0, 200, 60], [0, 0, 1]])
SHAPE = (120, 160)


def candidate(inverse, unit=0.001):
    shape = (4, 5)
    return Candidates(np.full(shape, inverse, np.float32), np.full(shape, unit, np.float32))


def solved(*candidates):
    found = triangulate(candidates, 1.0, TUNING.rays)
    return found.inverse, found.sigma, found.support


def test_agreeing_partners_outvote_a_wrong_one_and_the_precise_one_weighs_more():
    inverse, sigma, support = solved(candidate(0.1), candidate(0.13, 0.0001), candidate(0.1002))
    np.testing.assert_allclose(inverse, 0.1001, rtol=1e-5)
    assert (support == 0b101).all()
    # Seven tenths of the variance are each partner's own and average out.
    np.testing.assert_allclose(sigma, TUNING.rays.sigma_px * 0.001 * np.sqrt(0.3 + 0.7 / 2), rtol=0.01)
    inverse, sigma, _ = solved(candidate(0.1, 0.0001), candidate(0.1004, 0.001))
    assert (np.abs(inverse - 0.1) < 0.00001).all() and (sigma < TUNING.rays.sigma_px * 0.0002).all()


@pytest.mark.parametrize("true_px", [0.12, 0.25, 0.4])
def test_an_image_tells_the_sigma_of_its_disparities(true_px):
    # Errors of which 0.3 of the variance is the base image's, so the same in all pairs; a tenth are blunders.
    rng = np.random.default_rng(1)
    shape, true = (100, 120), 0.1
    shared = np.sqrt(0.3) * true_px * rng.standard_normal(shape)
    proposals = []
    for unit in (0.0002, 0.0003, 0.00025):
        error = shared + np.sqrt(0.7) * true_px * rng.standard_normal(shape)
        error = np.where(rng.random(shape) < 0.1, rng.uniform(-50, 50, shape), error)
        proposals.append(Candidates((true + unit * error).astype(np.float32), np.full(shape, unit, np.float32)))
    found = triangulate(proposals, 1.0, TUNING.rays)
    assert 0.8 * true_px < found.sigma_px < 1.15 * true_px
    three = found.support == 0b111
    ratio = (found.inverse[three] - true) / found.sigma[three]
    assert 0.8 < np.std(ratio) < 1.2


def test_who_is_far_from_the_mean_is_left_out_and_who_is_near_counts_less():
    """The last agrees with each of the others, within two sigmas of one; of the mean of all it is judged alone."""
    inverse, _, support = solved(candidate(0.1), candidate(0.1), candidate(0.1), candidate(0.1014))
    np.testing.assert_allclose(inverse, 0.1, rtol=1e-6)
    assert (support == 0b0111).all()
    inverse, _, support = solved(candidate(0.1), candidate(0.1), candidate(0.1), candidate(0.1011))
    assert (support == 0b1111).all()
    assert (inverse > 0.1 + 0.00005).all() and (inverse < 0.1 + 0.0002).all(), "the plain mean is 0.100275"
    # The proposal that most agree with is not the mean: who takes part is decided by the mean.
    unit = 0.001
    near, middle, rim, wrong = candidate(0.1000), candidate(0.1008), candidate(0.1016), candidate(0.1035)
    inverse, _, support = solved(near, middle, rim, wrong)
    assert (support == 0b0111).all() and (np.abs(inverse - 0.1008) < 0.1 * unit).all()


def test_nothing_proposed_gives_nothing():
    inverse, sigma, support = solved(Candidates.nothing((4, 5)), Candidates.nothing((4, 5)))
    assert np.isnan(inverse).all() and np.isnan(sigma).all() and (support == 0).all()
    assert (solved(Candidates.nothing((4, 5)), candidate(0.2))[2] == 0b10).all()


def plane_map(name, position, normal=(0.2, -0.1, -1.0), distance=8.0, noise=0.0, views=2):
    """Depth map of the world plane normal . x = -distance from a camera at a position, axes of the world."""
    normal = np.asarray(normal) / np.linalg.norm(normal)
    u, v = np.meshgrid(np.arange(SHAPE[1]) + 0.5, np.arange(SHAPE[0]) + 0.5)
    rays = np.stack([(u - 80) / 200, (v - 60) / 200, np.ones_like(u)], axis=-1)
    depth = -(distance + np.asarray(position) @ normal) / (rays @ normal)
    depth = depth * (1 + noise * np.random.default_rng(len(name)).normal(size=SHAPE))
    pose = transforms.rigid(np.eye(3), -np.asarray(position, float))
    full = np.full(SHAPE, views, np.uint8)
    return DepthMap(name, depth.astype(np.float32), (0.005 * depth).astype(np.float32), full, K, pose)


def test_witnesses_confirm_average_and_refine():
    maps = {n: plane_map(n, (x, 0, 0), noise=0.003) for n, x in (("a", 0), ("bb", 0.5), ("ccc", -0.5))}
    result, counts = check(maps["a"], [], ["bb", "ccc"], maps.get, SETTINGS, TUNING.rays)
    true = plane_map("a", (0, 0, 0)).depth_m
    inner = np.s_[20:-20, 30:-30]
    assert (result.views[inner] == 4).mean() > 0.98  # two of its own, two witnesses
    before = np.std((maps["a"].depth_m / true)[inner])
    after = np.nanstd((result.depth_m / true)[inner])
    assert 0.4 * before < after < 0.75 * before
    assert (result.sigma_m[inner] < maps["a"].sigma_m[inner]).mean() > 0.98
    assert counts.kept == np.isfinite(result.depth_m).sum()


def test_partners_that_counted_do_not_count_twice():
    a, b = plane_map("a", (0, 0, 0)), plane_map("bb", (0.5, 0, 0))
    for support, views in ((1, 2), (2, 3)):
        known = replace(a, support=np.full(SHAPE, support, np.uint8))
        found, _ = check(known, ["bb"], ["bb"], {"bb": b}.get, DenseSettings(min_views=2), TUNING.rays)
        assert found.views[60, 80] == views


def test_a_wrong_patch_is_dropped_and_said_why():
    maps = {n: plane_map(n, (x, 0, 0)) for n, x in (("a", 0), ("bb", 0.5), ("ccc", -0.5))}
    depth = maps["a"].depth_m.copy()
    depth[50:70, 70:90] *= 0.7
    views = np.full(SHAPE, 3, np.uint8)
    views[50:60] = 2
    wrong = replace(maps["a"], depth_m=depth, views=views)
    result, counts = check(wrong, [], ["bb", "ccc"], maps.get, SETTINGS, TUNING.rays)
    assert np.isnan(result.depth_m[50:60, 70:90]).all()  # two views only
    assert counts.few_views >= 200
    assert counts.before == counts.kept + counts.few_views + counts.seen_through
    both = Consistency.total([counts, counts])
    assert both == Consistency(*(2 * getattr(counts, f.name) for f in fields(counts)))
    assert Consistency.total([]).table()["rows"][0][1:] == [0, 0.0]
    share = [100 * n / counts.before for n in (counts.few_views, counts.seen_through)]
    assert [row[2] for row in both.table()["rows"][3:]] == pytest.approx(share, abs=0.05)


def test_points_that_most_images_see_through_are_dropped_hidden_ones_are_not():
    at = {"bb": 0.2, "ccc": -0.2, "d": 0.1, "e": -0.1}
    witnesses = {n: plane_map(n, (x, 0, 0)) for n, x in at.items()}
    inner = np.s_[30:-30, 40:-40]
    for distance, stays in ((5.0, False), (12.0, True)):
        agreeing = {n: plane_map(n, (x, 0, 0), distance=distance) for n, x in (("f", 0.15), ("g", -0.15))}
        some = plane_map("a", (0, 0, 0), distance=distance, views=1)
        names = [*witnesses, *agreeing]
        result, counts = check(some, [], names, (witnesses | agreeing).get, SETTINGS, TUNING.rays)
        assert (counts.seen_through > 0.8 * some.depth_m.size) != stays
        assert (np.isfinite(result.depth_m[inner]) == stays).all()
        result, _ = check(some, [], ["bb", "f", "g"], (witnesses | agreeing).get, SETTINGS, TUNING.rays)
        assert np.isfinite(result.depth_m[inner]).all()


def test_what_two_images_of_another_pass_see_through_was_there_in_one_pass_only():
    """A board before the wall; one image alone, and images that confirm it or see something nearer, prove nothing."""
    wall = {n: plane_map(n, (x, 0, 0)) for n, x in {"b": 0.2, "cc": -0.2, "ddd": 0.1}.items()}
    nearer = {n: plane_map(n, (x, 0, 0), distance=3.0) for n, x in {"e": 0.15, "ff": -0.15}.items()}
    board = plane_map("a", (0, 0, 0)).depth_m.copy()
    board[40:80, 60:100] *= 0.6
    found, load = replace(plane_map("a", (0, 0, 0)), depth_m=board), (wall | nearer).get

    def left_out(*others):
        return gone(found, others, load, SETTINGS.tolerance_px, TUNING.rays)

    assert left_out("b", "cc")[40:80, 60:100].all() and left_out("b", "cc", "missing").sum() == 40 * 40
    assert not left_out("b").any() and not left_out("e", "ff").any()
    same = {n: replace(wall["b"], image=n, depth_m=board, cam_from_world=found.cam_from_world) for n in ("g", "hh")}
    assert not gone(found, ["b", "cc", *same], (wall | same).get, SETTINGS.tolerance_px, TUNING.rays).any()
    assert gone(found, ["b", "cc", "ddd", *same], (wall | same).get, SETTINGS.tolerance_px, TUNING.rays)[60, 80]


def test_what_the_partners_depth_maps_do_not_say_again_is_dropped():
    maps = {n: plane_map(n, (x, 0, 0), views=3) for n, x in (("a", 0), ("bb", 0.5), ("ccc", -0.5))}
    both = replace(maps["a"], support=np.full(SHAPE, 3, np.uint8))
    silent = replace(maps["bb"], depth_m=np.full(SHAPE, np.nan, np.float32))
    kept, _ = check(both, ["bb", "ccc"], ["bb", "ccc"], maps.get, SETTINGS, TUNING.rays)
    dropped, _ = check(both, ["bb", "ccc"], ["bb", "ccc"], (maps | {"bb": silent}).get, SETTINGS, TUNING.rays)
    mapless, _ = check(both, ["bb", "ccc"], ["bb", "ccc"], {"ccc": maps["ccc"]}.get, SETTINGS, TUNING.rays)
    inner = np.s_[20:-20, 40:-40]
    assert np.isfinite(kept.depth_m[inner]).all() and np.isfinite(mapless.depth_m[inner]).all()
    assert np.isnan(dropped.depth_m[inner]).all()


def test_an_image_with_one_neighbour_needs_only_that():
    a, b = plane_map("a", (0, 0, 0), views=1), plane_map("bb", (0.5, 0, 0))
    result, counts = check(a, [], ["bb", "missing"], {"bb": b}.get, SETTINGS, TUNING.rays)
    assert result.views.max() == 2 and counts.two_rays == counts.kept > 0


def test_two_rays_suffice_only_where_no_third_image_looks():
    maps = {n: plane_map(n, (x, 0, 0), views=1) for n, x in (("a", 0), ("right", 4.0), ("far", -4.0))}
    maps["far"] = replace(maps["far"], depth_m=np.full(SHAPE, np.nan, np.float32))
    result, _ = check(maps["a"], [], ["right", "far"], maps.get, SETTINGS, TUNING.rays)
    kept = np.isfinite(result.depth_m)
    # 8 m away and 4 m aside, a witness sees 100 of the 160 columns: the outer ones are seen by one witness each.
    assert kept[60, 130:155].all() and not kept[60, 5:50].any() and not kept[60, 75:85].any()
    assert (result.views[kept] == 2).all()


def test_triangulation_is_the_linear_solution_of_the_rays():
    """Three cameras right of, above, and left of the base, whose pixels of a point have errors: the least squares over
    its place on the base ray, by brute force."""
    focal, depth, base = 1000.0, 8.0, np.array([0.1, -0.05, 1.0])
    centres = np.array([[0.5, 0, 0], [0, 0.7, 0], [-0.4, 0, 0]])
    length = np.linalg.norm(centres, axis=1)
    along, unit = centres / length[:, None], 1 / (focal * length)
    errors = np.random.default_rng(0).normal(0, 0.2, len(centres))
    found, sigma, _ = solved(*map(candidate, 1 / depth + errors * unit, unit))
    z = 1 / np.linspace(1 / 8.2, 1 / 7.8, 1001)
    at = focal * (z[:, None, None] * base - centres) / z[:, None, None]
    measured = focal * (depth * base - centres) / depth - errors[:, None] * along
    best = z[np.argmin(np.sum(np.sum((at - measured) * along, axis=2) ** 2, axis=1))]
    assert abs(1 / found[0, 0] - best) < 3e-3 * depth
    assert 0 < abs(1 / found[0, 0] - depth) / (sigma[0, 0] * depth**2) < 3


def test_the_normal_of_a_plane_is_exact_with_holes_and_unknown_at_an_edge():
    depth = plane_map("a", (0, 0, 0))
    holes = np.where(np.random.default_rng(0).random(SHAPE) < 0.2, np.float32(np.nan), depth.depth_m)
    result = with_normals(replace(depth, depth_m=holes))
    truth = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])
    known = np.isfinite(result.normal).all(axis=-1)
    assert known.sum() > 0.99 * np.isfinite(holes).sum()
    angle = np.degrees(np.arccos(np.clip(result.normal[known] @ truth, -1, 1)))
    assert angle.max() < 0.5
    base = plane_map("a", (0, 0, 0), normal=(0, 0, -1.0))
    nearer = np.where(np.arange(SHAPE[1]) < 80, base.depth_m, 0.6 * base.depth_m)
    result = with_normals(replace(base, depth_m=nearer.astype(np.float32)))
    assert np.isnan(result.normal[60, 79]).all() and np.isfinite(result.normal[60, 60]).all()


@pytest.mark.parametrize(("share", "stays"), [(0.003, True), (0.02, False)])
def test_a_vague_depth_needs_one_map_more(share, stays):
    maps = {n: plane_map(n, (x, 0, 0)) for n, x in (("a", 0), ("bb", 0.1), ("ccc", -0.1), ("d", 0.2))}
    maps = {n: replace(m, sigma_m=(share * m.depth_m).astype(np.float32)) for n, m in maps.items()}
    hole = np.full(SHAPE, np.nan, np.float32)
    maps["d"] = replace(maps["d"], depth_m=hole, sigma_m=hole)  # sees the place and says nothing
    inner = np.s_[30:-30, 40:-40]
    result, _ = check(maps["a"], [], ["bb", "ccc", "d"], maps.get, SETTINGS, TUNING.rays)
    assert (np.isfinite(result.depth_m[inner]) == stays).all()
    result, _ = check(maps["a"], [], ["bb", "ccc"], maps.get, SETTINGS, TUNING.rays)  # no more images could see it
    assert np.isfinite(result.depth_m[inner]).all()


CAMERA = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])


def model(positions, turns_deg=None, cameras=None, count=400, seed=0):
    """Cameras that look along +z (turned about y) at points between z = 9 and 11."""
    rng = np.random.default_rng(seed)
    world = np.c_[rng.uniform(-6, 6, count), rng.uniform(-4, 4, count), rng.uniform(9, 11, count)]
    turns = np.radians(turns_deg if turns_deg is not None else np.zeros(len(positions)))
    poses, seen = [], []
    cameras = cameras or [CAMERA] * len(positions)
    for position, turn, camera in zip(positions, turns, cameras, strict=True):
        c, s = np.cos(turn), np.sin(turn)
        rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        pose = transforms.rigid(rotation, -rotation @ np.asarray(position, float))
        there = transforms.apply(pose, world)
        pixel = np.full((count, 2), np.nan)
        front = there[:, 2] > 0
        pixel[front] = camera.img_from_cam(there[front])
        inside = ((pixel >= 0) & (pixel <= (camera.width, camera.height))).all(axis=1)
        poses.append(pose)
        seen.append(np.where(inside[:, None], pixel, np.nan))
    return model_of([f"{k}.jpg" for k in range(len(positions))], cameras, poses, world, seen)


def considered(model, settings=SETTINGS):
    """The partners of the first image, those used first."""
    table = planning._table(model)
    return planning._candidates(table, planning._shared_counts(table), 0, settings, TUNING.partners)


def by_name(partners):
    return {p.view.name: p for p in partners}


def test_partners_at_good_angles_are_preferred():
    line = model([(x, 0, 0) for x in (0, 0.05, 0.3, 1.2, 2.0, 5.0)])
    partners = considered(line, DenseSettings(partners=2))
    used = [p.view.name for p in partners if not p.reason]
    assert used == ["3.jpg", "4.jpg"] and 5 < partners[0].angle_deg < 9
    assert by_name(partners)["1.jpg"].reason == ONE_CENTRE


def test_forward_motion_wide_angle_and_scale_are_refused():
    close = pycolmap.Camera(model="PINHOLE", width=2000, height=1500, params=[1500, 1500, 1000, 750])
    odd = model([(0, 0, 0), (0.05, 0, 2.5), (9.5, 0, 1), (1, 0, 0)], [0, 0, -45, 0], [CAMERA, CAMERA, CAMERA, close])
    partners = by_name(considered(odd))
    assert partners["1.jpg"].reason == EPIPOLE and partners["2.jpg"].reason == WIDE
    assert partners["3.jpg"].reason == SCALE


def test_points_that_no_partner_sees_do_not_set_the_depth_range():
    close = np.array([[0.01 * k, 0, 0.05] for k in range(30)])  # what moved while the camera stood
    rng = np.random.default_rng(0)
    world = np.concatenate([np.c_[rng.uniform(-6, 6, 400), rng.uniform(-4, 4, 400), rng.uniform(9, 11, 400)], close])
    poses = [transforms.rigid(np.eye(3), -np.array([x, 0.0, 0.0])) for x in (0, 0.001, 1)]
    seen = []
    for k, pose in enumerate(poses):
        pixel = CAMERA.img_from_cam(transforms.apply(pose, world))
        pixel[400:] = np.nan if k == 2 else 300.0
        seen.append(pixel)
    stood = model_of(["0.jpg", "1.jpg", "2.jpg"], [CAMERA] * 3, poses, world, seen)
    plan = plan_images(stood, SETTINGS, TUNING.partners)
    assert [v.name for v in plan.images["0.jpg"].partners] == ["2.jpg"]
    assert 3 < plan.images["0.jpg"].depth_range.near < 6


def test_refused_images_still_witness_and_the_depth_range_holds_the_points_with_margin():
    plan = plan_images(model([(0, 0, 0), (1, 0, 0), (0.05, 0, 2.5)]), SETTINGS, TUNING.partners)
    assert [v.name for v in plan.images["0.jpg"].partners] == ["1.jpg"]
    assert "2.jpg" in plan.images["0.jpg"].witnesses and plan.refused[EPIPOLE] >= 2
    assert plan.images["0.jpg"].elsewhen == ()
    passes = {"0.jpg": 0, "1.jpg": 0, "2.jpg": 1}
    plan = plan_images(model([(0, 0, 0), (1, 0, 0), (0.05, 0, 2.5)]), SETTINGS, TUNING.partners, passes)
    assert plan.images["0.jpg"].elsewhen == ("2.jpg",) and plan.images["1.jpg"].elsewhen == ("2.jpg",)
    assert any("one partner" in note for note in plan.notes)
    plan = plan_images(model([(x, 0, 0) for x in (0, 1, 2)]), SETTINGS, TUNING.partners)
    near, far = plan.images["1.jpg"].depth_range.near, plan.images["1.jpg"].depth_range.far
    assert 4 < near < 6 and 11 < far < 20


def test_an_image_without_partner_is_dropped_with_its_reason():
    plan = plan_images(model([(0, 0, 0), (1, 0, 0), (0, 0, -1)], [0, 0, 180]), SETTINGS, TUNING.partners)
    assert sorted(plan.images) == ["0.jpg", "1.jpg"] and plan.dropped[0][0] == "2.jpg"
    assert "sparse points" in plan.dropped[0][1]


def test_no_partner_at_all_is_an_error_with_a_remedy():
    with pytest.raises(ReconstructionError, match="different places"):
        plan_images(model([(0, 0, 0), (0.001, 0, 0)]), SETTINGS, TUNING.partners)
    with pytest.raises(ReconstructionError, match="no image.*partner"):
        plan_images(pycolmap.Reconstruction(), SETTINGS, TUNING.partners)


@pytest.mark.slow
def test_each_of_many_images_that_see_the_same_has_a_bounded_plan():
    plan = plan_images(model([(0.06 * k, 0, 0) for k in range(100)], count=400), SETTINGS, TUNING.partners)
    assert len(plan.images) == 100 and not plan.dropped
    assert {len(p.partners) for p in plan.images.values()} == {SETTINGS.partners}


SIZE = (320, 240)
CAMERAS = {
    "PINHOLE": [200, 210, 158, 121],
    "SIMPLE_RADIAL": [200, 160, 120, -0.1],
    "OPENCV": [200, 202, 158, 121, -0.15, 0.03, 0.001, -0.001],
    "FULL_OPENCV": [200, 202, 158, 121, -0.1, 0.02, 0.001, 0, 0, 0, 0, 0],
    "OPENCV_FISHEYE": [110, 110, 160, 120, 0.01, -0.003, 0, 0],
    "SIMPLE_FISHEYE": [100, 160, 120],
}


def plan(model):
    return ViewPlan("a.png", CameraModel(model, *SIZE, tuple(map(float, CAMERAS[model]))), np.eye(4))


@pytest.mark.parametrize("model", CAMERAS)
def test_pixels_come_from_where_the_camera_saw_their_ray(model, tmp_path):
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    coded = np.stack([u * 0.75, v * 0.75, np.zeros_like(u)], axis=-1)
    cv2.imwrite(str(tmp_path / "a.png"), np.rint(coded).astype(np.uint8))
    view = load_view(plan(model), tmp_path, None, SETTINGS)
    assert view.mask.mean() > 0.7
    row, column = np.nonzero(cv2.erode(view.mask.astype(np.uint8), np.ones((5, 5))))
    rays = np.c_[column + 0.5, row + 0.5, np.ones(len(row))] @ np.linalg.inv(view.K).T
    camera = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=CAMERAS[model])
    expected = camera.img_from_cam(rays)
    found = view.image_bgr[row, column, :2] / 0.75
    assert np.median(np.abs(found - expected)) < 0.6
    assert np.percentile(np.abs(found - expected), 99) < 1.2


def test_field_of_view_is_kept_up_to_the_limit():
    K, size = pinhole_of(plan("OPENCV").camera, SETTINGS)
    # The borders of the image lie at 77 degrees, its corners, stretched by the barrel distortion, at 87.
    assert 77 < 2 * np.degrees(np.arctan(size[0] / 2 / K[0, 0])) < 88
    for limit in (60, 100):
        K, size = pinhole_of(plan("SIMPLE_FISHEYE").camera, DenseSettings(max_fov_deg=limit))
        left, right = -K[0, 2] / K[0, 0], (size[0] - K[0, 2]) / K[0, 0]
        assert np.degrees(np.arctan(right) - np.arctan(left)) == pytest.approx(limit, abs=0.5)


def test_size_is_limited_and_a_pinhole_unchanged():
    K, size = pinhole_of(plan("PINHOLE").camera, SETTINGS)
    np.testing.assert_allclose(K, [[200, 0, 158], [0, 200 * 240 / 229, 121], [0, 0, 1]], rtol=0.06)
    _, size = pinhole_of(plan("OPENCV").camera, DenseSettings(max_image_size=100))
    assert max(size) == 100


def test_masks_are_warped_and_missing_ones_use_all(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320, 3), np.uint8))
    mask = np.zeros((240, 320), np.uint8)
    mask[:, 160:] = 255
    cv2.imwrite(str(tmp_path / "a.png.png"), mask)
    whole = load_view(plan("OPENCV"), tmp_path, None, SETTINGS).mask
    half = load_view(plan("OPENCV"), tmp_path, tmp_path, SETTINGS).mask
    assert 0.45 < half.sum() / whole.sum() < 0.55 and not half[:, :100].any()
    assert (load_view(plan("OPENCV"), tmp_path, tmp_path / "none", SETTINGS).mask == whole).all()


def test_bad_files_are_named_and_a_camera_that_sees_all_round_is_refused(tmp_path):
    with pytest.raises(InputError, match="a.png"):
        load_view(plan("PINHOLE"), tmp_path, None, SETTINGS)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((120, 160, 3), np.uint8))
    with pytest.raises(InputError, match="160 x 120"):
        load_view(plan("PINHOLE"), tmp_path, None, SETTINGS)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "a.png.png"), np.zeros((24, 32), np.uint8))
    with pytest.raises(InputError, match="a.png.png"):
        load_view(plan("PINHOLE"), tmp_path, tmp_path, SETTINGS)
    with pytest.raises(InputError, match="all round"):
        pinhole_of(CameraModel("EQUIRECTANGULAR", 400, 200, (400.0, 200.0)), SETTINGS)
