"""Shared visible surface: corridors and rings with exact truth, occlusion, backs of walls, unknown poses, size."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.network.coarse import proxy as proxies
from tiegraph.network.coarse import visible
from tiegraph.network.coarse.proxy import Proxy, assumed_proxy, observed_proxy
from tiegraph.network.coarse.visible import Overlap, pair_share, shared_surface
from tiegraph.network.tuning import Tuning

TUNING = Tuning().coarse
CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[320.0, 320.0, 240.0])  # 90 x 74 degrees


def points_proxy(points: np.ndarray) -> Proxy:
    """Bare points (P, 3), of which no observer is known."""
    none = np.zeros(0, int)
    reach, towards = np.full(len(points), np.inf), np.zeros((len(points), 3))
    return Proxy(points=points, reach=reach, towards=towards, image=none, point=none)


def look(centres: np.ndarray, yaw_deg: np.ndarray) -> np.ndarray:
    """cam_from_world (N, 4, 4), z up in the world: yaw 0 looks along y, 90 along -x."""
    level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    out = []
    for centre, yaw in zip(centres, yaw_deg):
        rotation = level @ Rotation.from_euler("z", -yaw, degrees=True).as_matrix()
        out.append(transforms.rigid(rotation, -rotation @ centre))
    return np.stack(out)


def wall(count: int = 6000, distance: float = 10.0, width: float = 60.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-5, width - 5, count), np.full(count, distance), rng.uniform(-6, 6, count)])


def observers(points: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image and point of every observation by projection alone."""
    local = np.einsum("nab,pb->npa", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    x, y, z = np.moveaxis(local, -1, 0)
    seen = (z > 0) & (np.abs(x) < z) & (np.abs(y) < 0.75 * z)
    return np.nonzero(seen)


def row_of_cameras(count: int = 10, step: float = 4.0) -> np.ndarray:
    return look(np.column_stack([np.arange(count) * step, np.zeros(count), np.zeros(count)]), np.zeros(count))


def shared(poses, proxy, max_angle_deg: float = 90.0, slack_rad: float = 0.0, cameras=None, **changed) -> Overlap:
    visibility, cameras = TUNING.visible.model_copy(update=changed), cameras or [CAMERA] * len(poses)
    return shared_surface(poses, cameras, proxy, visibility, max_angle_deg, slack_rad)


def between(found: Overlap, i: int, j: int) -> float:
    return float(found.between(np.array([i]), np.array([j]))[0])


def test_share_of_a_wall_is_that_of_the_geometry() -> None:
    poses, points = row_of_cameras(), wall()
    found = shared(poses, observed_proxy(points, *observers(points, poses), poses))
    # 20 m of wall in view from 10 m; images k * 4 m apart share 1 - k * 0.2 of it
    for k, share in ((1, 0.8), (2, 0.6), (3, 0.4), (4, 0.2)):
        assert between(found, 3, 3 + k) == pytest.approx(share, abs=0.06)
    assert between(found, 0, 9) == 0
    assert (found.i < found.j).all() and len(found) == len(set(zip(found.i, found.j)))


def test_angle_and_scale_of_the_shared_surface() -> None:
    poses = look(np.array([[0.0, 0, 0], [0, -10, 0], [10, 10, 0]]), np.array([0.0, 0, 90]))
    points = np.random.default_rng(0).normal([0, 10, 0], 0.5, (500, 3))
    found = shared(poses, points_proxy(points), max_angle_deg=180)
    pairs = {(a, b): k for k, (a, b) in enumerate(zip(found.i, found.j))}
    assert found.angle_deg[pairs[0, 2]] == pytest.approx(90, abs=3) and found.angle_deg[pairs[0, 1]] < 5
    assert found.scale[pairs[0, 1]] == pytest.approx(0.5, abs=0.03)
    narrow = shared(poses, points_proxy(points), max_angle_deg=60)
    assert (0, 2) not in set(zip(narrow.i, narrow.j))
    assert len(shared(poses, points_proxy(points), max_scale=1.5, max_angle_deg=60)) == 0


def test_a_nearer_wall_hides_the_one_behind() -> None:
    poses = look(np.array([[0.0, 0, 0], [0, 20.5, 0]]), np.array([0.0, 0.0]))
    behind, screen = wall(4000, 30.0), wall(4000, 20.0, seed=1)
    open_ = shared(poses, points_proxy(behind), max_scale=10)
    hidden = shared(poses, points_proxy(np.concatenate([behind, screen])), max_scale=10)
    assert open_.share.max() > 0.9 and len(hidden) == 0


def test_a_wall_is_not_seen_from_behind() -> None:
    front = look(np.array([[0.0, 0, 0], [2, 0, 0], [4, 0, 0]]), np.zeros(3))
    poses = np.concatenate([front, look(np.array([[0.0, 20, 0]]), np.array([180.0]))])
    points = wall(3000, width=10.0) * (1, 1, 0.2)
    found = shared(poses, observed_proxy(points, *observers(points, front), poses), max_angle_deg=180)
    assert set(zip(found.i, found.j)) == {(0, 1), (0, 2), (1, 2)}


def test_images_without_observations_and_without_pose() -> None:
    poses, points = row_of_cameras(), wall()
    image, point = observers(points, poses)
    proxy = observed_proxy(points, image[image != 4], point[image != 4], poses)
    poses[7] = np.nan
    found = shared(poses, proxy)
    assert between(found, 4, 5) > 0.7
    assert not np.isin(7, np.concatenate([found.i, found.j]))


def test_a_cluster_of_points_does_not_stand_for_the_image() -> None:
    poses = row_of_cameras(2, 12.0)
    rng = np.random.default_rng(0)
    cluster = np.column_stack([rng.normal(9.0, 0.3, 1500), np.full(1500, 10.0), rng.normal(0, 0.3, 1500)])
    points = np.concatenate([wall(4000), cluster])
    found = shared(poses, points_proxy(points))
    assert found.share[0] == pytest.approx(8 / 15, abs=0.06)  # of 15 m of wall; 0.77 if every point had a vote


def test_assumed_range_of_a_ring_looking_in_and_out() -> None:
    angle = np.radians(np.arange(0, 360, 15))
    where = 10 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    seen_in, seen_out = (
        shared(poses, assumed_proxy(poses, [CAMERA] * 24, 10.0, TUNING), max_angle_deg=most)
        for poses, most in ((look(where, np.degrees(angle) + 90), 120), (look(where, np.degrees(angle) - 90), 90))
    )
    assert between(seen_in, 0, 1) > 0.6 and between(seen_out, 0, 1) > 0.4
    assert between(seen_in, 0, 12) < 0.1 and between(seen_out, 0, 12) == 0
    assert between(seen_in, 0, 4) > 0.3 > between(seen_out, 0, 8)


def test_pair_share_is_the_same_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visible, "_OWNERS", 3)  # several parts
    poses = row_of_cameras(8)
    found = shared(poses, assumed_proxy(poses, [CAMERA] * 8, 10.0, TUNING))
    i, j = np.triu_indices(8, 1)
    direct = pair_share(poses, [CAMERA] * 8, i, j, 10.0, TUNING)
    listed = found.between(i, j)
    # votes are by image cell there and by point here
    assert np.abs(np.where(direct < 0.02, 0, direct) - listed).max() < 0.08


def test_pair_share_of_cameras_of_several_kinds_is_that_of_each_pair() -> None:
    """Of the barrel the corners have no rays, so that images have unequally many points."""
    barrel = pycolmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[320.0, 320.0, 240.0, -0.35])
    cameras, poses = [CAMERA, barrel, None] * 3, row_of_cameras(9)
    poses[4] = np.nan
    counts = np.bincount(assumed_proxy(poses, cameras, 10.0, TUNING).image, minlength=9)
    assert counts[1] < counts[0] and counts[4] == 0
    i, j = np.triu_indices(9, 1)
    at_once = pair_share(poses, cameras, i, j, 10.0, TUNING)
    one_by_one = [pair_share(poses, cameras, i[k : k + 1], j[k : k + 1], 10.0, TUNING)[0] for k in range(len(i))]
    np.testing.assert_array_equal(at_once, one_by_one)
    np.testing.assert_array_equal(np.isnan(at_once), (i == 4) | (j == 4))
    listed = shared(poses, assumed_proxy(poses, cameras, 10.0, TUNING), cameras=cameras).between(i, j)
    known = np.isfinite(at_once) & (at_once > 0.02)
    assert known.sum() > 10 and np.abs(at_once - listed)[known].max() < 0.12


def test_slack_widens_the_view_of_unsure_poses() -> None:
    poses, proxy = row_of_cameras(2, 22.0), points_proxy(wall())
    assert len(shared(poses, proxy, max_angle_deg=180)) == 0
    assert len(shared(poses, proxy, slack_rad=0.3, max_angle_deg=180)) == 1


def test_many_points_are_thinned_without_loss() -> None:
    poses = row_of_cameras()
    proxy = points_proxy(wall(60000))
    found = shared(poses, proxy)
    assert between(found, 3, 4) == pytest.approx(0.8, abs=0.05)
    fewer = shared(poses, proxy, mean_visible=(300, 300))
    assert between(fewer, 3, 4) == pytest.approx(0.8, abs=0.12)


def test_the_table_is_the_same_in_blocks_of_any_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block names only the images that see anything of it: three images or all at once."""
    poses, points = row_of_cameras(40, 2.0), wall(width=80)
    poses[11, :3] = np.nan
    proxy = replace(points_proxy(points), reach=np.full(len(points), 30.0))
    whole = shared(poses, proxy)
    monkeypatch.setattr(visible, "_BLOCK", 3)
    parts = shared(poses, proxy)
    assert len(whole) > 100 and 11 not in np.r_[whole.i, whole.j] and np.ptp(whole.j) == 38
    for name in ("i", "j", "share", "angle_deg", "scale"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name))


def test_boxes_leave_out_only_points_that_no_cone_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proxies, "_LEAF", 4)
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(0, 200, 3000), rng.normal(0, 8, 3000), rng.uniform(0, 6, 3000)])
    proxy = replace(points_proxy(points), reach=rng.uniform(5, 40, len(points)))
    held = proxies.Boxes(proxy)
    fewest, most = len(points), 0
    for half in (0.2, 0.7, 1.4, 3.0):
        for _ in range(20):
            centre, axis = points[rng.integers(len(points))] + rng.normal(0, 5, 3), rng.normal(size=3)
            axis /= np.linalg.norm(axis)
            distance = np.linalg.norm(points - centre, axis=1)
            inside = ((points - centre) @ axis > np.cos(half) * distance) & (distance < proxy.reach)
            near = held.near(centre, axis, half)
            assert np.isin(np.flatnonzero(inside), near).all()
            fewest, most = min(fewest, len(near)), max(most, len(near))
    assert fewest < 300 < most < len(points)


def test_nothing_in_nothing_out() -> None:
    poses = row_of_cameras(3)
    empty = Proxy(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int))
    assert len(shared(poses, empty, cameras=[None] * 3)) == 0
    assert len(shared(np.full((3, 4, 4), np.nan), points_proxy(wall(10)))) == 0
    assert len(assumed_proxy(np.full((3, 4, 4), np.nan), [CAMERA] * 3, 5.0, TUNING)) == 0
    without_camera = shared(poses, points_proxy(wall()), cameras=[None] * 3)
    assert without_camera.share[:2] == pytest.approx([0.65, 0.31], abs=0.06)  # 60 degrees of view, 4 m apart
