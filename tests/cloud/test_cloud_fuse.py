from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tiegraph.cloud import fuse as fuse_module
from tiegraph.cloud import voxels as voxels_module
from tiegraph.cloud.fuse import Maps, automatic_voxel, filter_points, fuse, map_points
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning
from tiegraph.cloud.voxels import add_up, rows_of, spacing, sums, without_coarse_duplicates
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.scene.results import Cloud, DepthMap
from tiegraph.scene.sorting import row_numbers

SETTINGS = CloudSettings()
TUNING = Tuning()
SHAPE = (90, 120)
K = np.array([[100.0, 0, 60], [0, 100, 45], [0, 0, 1]])
RED = np.broadcast_to(np.array([200, 30, 10], np.uint8), (*SHAPE, 3))


def wall(name, x, noise_m=0.02, seed=0):
    """Depth map of the wall z = 10.05 from (x, 0, 0), with noise and its sigma."""
    depth = 10.05 + noise_m * np.random.default_rng(seed).normal(size=SHAPE)
    pose = transforms.rigid(np.eye(3), [-x, 0.0, 0.0])
    normal = np.zeros((*SHAPE, 3), np.float32)
    normal[..., 2] = -1
    sigma = np.full(SHAPE, max(noise_m, 0.001), np.float32)
    return DepthMap(name, depth.astype(np.float32), sigma, np.full(SHAPE, 3, np.uint8), K, pose, normal)


WALLS = {f"{k}": wall(f"{k}", x, seed=k) for k, x in enumerate((0.0, 1.0, 2.0, 3.0))}


def maps(depths):
    return Maps(depths.get, lambda name: RED)


MAPS = maps(WALLS)


@pytest.mark.slow
def test_overlapping_maps_become_one_even_surface(tmp_path):
    fused = fuse(list(WALLS), MAPS, tmp_path, SETTINGS, TUNING)
    cloud = fused.cloud()
    assert fused.voxel == pytest.approx(0.1, rel=0.01)
    cells = 15 * 9 / 0.1**2  # 12 m + 3 m wide, 9 m high, in cells of the spacing
    assert 0.85 * cells < len(cloud) < 1.35 * cells
    error = cloud.xyz_m[:, 2] - 10.05
    assert 0.004 < error.std() < 0.02  # four maps with 0.02 m of noise, averaged where they overlap
    assert abs(error.mean()) < 0.001
    nearest = cKDTree(cloud.xyz_m).query(cloud.xyz_m, k=2)[0][:, 1]
    assert np.median(nearest) > 0.05
    assert (cloud.rgb == [200, 30, 10]).all()
    np.testing.assert_allclose(cloud.normal, np.broadcast_to([0, 0, -1], cloud.normal.shape), atol=1e-6)
    assert (cloud.views == 3).all()
    np.testing.assert_allclose(cloud.sigma_m, 0.02, rtol=1e-3)
    assert fused.counts["pixels"] == 4 * SHAPE[0] * SHAPE[1]
    assert fused.counts["points"] == len(cloud)


@pytest.mark.slow
def test_without_filters_and_colours_strays_stay_and_points_are_black(tmp_path):
    depth = WALLS["0"].depth_m.copy()
    depth[45, 60] = 4.0  # nothing is near it
    stray = {"0": replace(WALLS["0"], depth_m=depth)}
    kept = fuse(["0"], Maps(stray.get), tmp_path / "a", SETTINGS.unfiltered(0.1), TUNING)
    cloud = kept.cloud()
    assert (cloud.xyz_m[:, 2] < 5).sum() == 1 and (cloud.rgb == 0).all()
    assert kept.counts["statistical"] == kept.counts["radius"] == 0 and kept.voxel == 0.1
    filtered = fuse(["0"], maps(stray), tmp_path / "b", SETTINGS, TUNING).cloud()
    assert (filtered.xyz_m[:, 2] > 5).all() and 0 < len(filtered) < len(cloud)


@pytest.mark.slow
def test_tiles_do_not_change_the_points(tmp_path, monkeypatch):
    whole = fuse(list(WALLS), MAPS, tmp_path / "a", SETTINGS, TUNING)
    a = whole.cloud().xyz_m
    monkeypatch.setattr(voxels_module, "TILE_VOXELS", 32)
    tiled = fuse(list(WALLS), MAPS, tmp_path / "b", SETTINGS, TUNING)
    assert len(tiled.tiles) > 3 * len(whole.tiles)
    b = tiled.cloud().xyz_m
    distance, _ = cKDTree(b).query(a)
    assert abs(len(a) - len(b)) < 0.01 * len(a)  # the average spacing of a tile decides what is an outlier
    assert (distance < 1e-9).mean() > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("limits", [{"_MERGE_ROWS": 1000}, {"_MAPS_AT_ONCE": 1, "_POINTS_AT_ONCE": 0}])
def test_parts_and_groups_of_maps_give_the_same_points_in_bounded_memory(tmp_path, monkeypatch, limits):
    whole = fuse(list(WALLS), MAPS, tmp_path / "a", SETTINGS, TUNING)
    for name, value in limits.items():
        monkeypatch.setattr(fuse_module, name, value)
    parts = fuse(list(WALLS), MAPS, tmp_path / "b", SETTINGS, TUNING)
    assert parts.counts == whole.counts
    np.testing.assert_allclose(whole.cloud().xyz_m, parts.cloud().xyz_m, atol=1e-6)
    assert not list((tmp_path / "b").glob("*.points"))


def test_uncertain_points_are_left_out_and_counted():
    far = wall("far", 0, noise_m=0.5)
    cloud, _, uncertain = map_points(far, RED, SETTINGS, slice(0, SHAPE[0]))
    assert len(cloud) + uncertain == SHAPE[0] * SHAPE[1]
    assert uncertain > 0.9 * SHAPE[0] * SHAPE[1]


def test_a_point_lies_on_the_ray_through_the_centre_of_its_pixel():
    view = wall("near", 0)
    cloud, _, _ = map_points(view, RED, CloudSettings(voxel_size=0.1, max_relative_sigma=0.5), slice(0, SHAPE[0]))
    pixels = transforms.apply(view.cam_from_world, cloud.xyz_m) @ K.T
    assert len(cloud) == SHAPE[0] * SHAPE[1]
    np.testing.assert_allclose((pixels[:, :2] / pixels[:, 2:])[[0, -1]], [[0.5, 0.5], [SHAPE[1] - 0.5, SHAPE[0] - 0.5]])


def test_missing_and_empty_maps(tmp_path):
    assert len(fuse(["0", "missing"], MAPS, tmp_path, SETTINGS, TUNING).cloud()) > 1000
    empty = DepthMap("e", np.full(SHAPE, np.nan, np.float32), WALLS["0"].sigma_m, WALLS["0"].views, K, np.eye(4))
    for name, settings, words in (("e", SETTINGS, "empty"), ("f", CloudSettings(voxel_size=0.1), "min-views")):
        with pytest.raises(ReconstructionError, match=words):
            fuse(["e"], maps({"e": empty}), tmp_path / name, settings, TUNING)


def test_automatic_voxel_is_the_size_of_a_pixel():
    assert automatic_voxel(list(WALLS), WALLS.get, TUNING.sampled_maps) == pytest.approx(10 / 100, rel=0.01)


def cloud_of(xyz, sigma=0.01):
    n = len(xyz)
    return Cloud(
        np.asarray(xyz, float), np.full((n, 3), 100, np.uint8), np.full((n, 3), np.nan, np.float32),
        np.full(n, sigma, np.float32), np.full(n, 3, np.uint8),
    )  # fmt: skip


def tile_of(xyz, justified, voxel=0.1, sigma=0.01):
    """The voxels of points that lie in one tile, and the tile."""
    tile, rows = rows_of(cloud_of(xyz, sigma), np.asarray(justified, float), voxel)
    assert (tile == tile[:, :1]).all()
    return sums(rows, voxel), tuple(tile[:, 0].tolist())


def test_sums_of_parts_are_sums_of_the_whole():
    xyz = np.random.default_rng(0).uniform(0, 2, (500, 3))
    wide = np.random.default_rng(1).choice([0.1, 0.3], 500)
    whole, tile = tile_of(xyz, wide)
    again = add_up([tile_of(xyz[200:], wide[200:])[0], tile_of(xyz[:200], wide[:200])[0]])
    np.testing.assert_array_equal(whole.cell, again.cell)
    np.testing.assert_allclose(whole.place, again.place, rtol=1e-6)
    mean = whole.cloud(tile, 0.1)
    assert np.isnan(mean.normal).all()
    size = spacing(whole.cell, 0.1)[:, None]
    assert sorted(set(size.ravel())) == pytest.approx([0.1, 0.4])
    expected = {tuple(np.floor(p / s).astype(int)) for p, s in zip(xyz, np.where(wide > 0.2, 0.4, 0.1), strict=True)}
    assert {tuple(c) for c in np.floor(mean.xyz_m / size).astype(int)} == expected


def test_points_keep_their_places_on_both_sides_of_the_origin():
    xyz = np.random.default_rng(0).uniform(-1e5, 1e5, (300, 3))
    tile, rows = rows_of(cloud_of(xyz), np.full(300, 0.01), 0.01)
    back = np.concatenate(
        [sums(rows[k : k + 1], 0.01).cloud(tuple(tile[:, k].tolist()), 0.01).xyz_m for k in range(300)]
    )
    np.testing.assert_allclose(back, xyz, atol=0.01 / 2**16)


def test_a_coarse_point_yields_to_finer_ones():
    fine, _ = tile_of([[0.05, 0.05, 0.05], [0.05, 3.25, 0.05]], [0.1, 0.1])
    coarse, tile = tile_of([[0.3, 0.3, 0.3], [5.0, 5.0, 5.0], [0.1, 3.7, 0.1]], [0.4, 0.4, 3.2], sigma=0.3)
    left = without_coarse_duplicates(add_up([fine, coarse]))
    assert (left.cell >> 27).tolist() == [0, 0, 2]
    np.testing.assert_allclose(left.cloud(tile, 0.1).xyz_m[2], [5, 5, 5], atol=1e-5)


def test_filters_drop_outliers_and_keep_the_surface():
    x, y = np.meshgrid(np.arange(60) * 0.1, np.arange(60) * 0.1)
    surface = np.c_[x.ravel(), y.ravel(), np.random.default_rng(0).normal(0, 0.01, x.size)]
    outliers = np.random.default_rng(1).uniform((0, 0, 1), (6, 6, 9), (40, 3))
    points, spacing = np.r_[surface, outliers], np.full(len(surface) + 40, 0.1)
    keep, statistical, radius = filter_points(points, spacing, SETTINGS, TUNING)
    assert keep[: len(surface)].mean() > 0.97
    assert keep[len(surface) :].mean() < 0.05
    assert (~keep).sum() == statistical + radius
    keep, _, _ = filter_points(points, spacing, CloudSettings(statistical_ratio=0), TUNING)
    assert keep[: len(surface)].all() and not keep[len(surface) :].any()
    keep, statistical, radius = filter_points(points, spacing, CloudSettings(radius_neighbours=0), TUNING)
    assert keep[: len(surface)].mean() > 0.97 and not keep[len(surface) :].any()
    assert statistical == (~keep).sum() and radius == 0
    three = np.r_[surface, [[0, 0, 9.0], [0.1, 0, 9], [0, 0.1, 9]]]  # a point is no neighbour of its own
    few, statistical_only = TUNING.model_copy(update={"neighbours": 3}), CloudSettings(radius_neighbours=0)
    assert not filter_points(three, np.full(len(three), 0.1), statistical_only, few)[0][-3:].any()
    off = CloudSettings(statistical_ratio=0, radius_neighbours=0)
    assert filter_points(points, spacing, off, TUNING)[0].all()
    assert len(filter_points(np.zeros((0, 3)), np.zeros(0), SETTINGS, TUNING)[0]) == 0


def test_the_surroundings_of_a_tile_count_as_neighbours():
    lonely = np.array([[0.0, 0, 0]])
    around = np.random.default_rng(0).normal(0, 0.05, (30, 3))
    assert not filter_points(lonely, np.array([0.1]), SETTINGS, TUNING)[0][0]
    assert filter_points(lonely, np.array([0.1]), SETTINGS, TUNING, around)[0][0]


def test_tiles_far_apart_are_told_apart():
    far = cloud_of([[1e9, 1e9, 1e9], [-1e9, -1e9, -1e9], [1e9, 1e9, 1e9]])
    numbers = row_numbers(rows_of(far, np.full(3, 0.001), 0.001)[0])
    assert numbers[0] == numbers[2] > numbers[1] >= 0
