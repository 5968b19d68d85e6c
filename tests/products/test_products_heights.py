import numpy as np
import pytest

from products_world import BOX, MAP, NOISE_M, PIXEL, ROOF, WALL, height, in_box
from tiegraph.products.heights import height_tile, margin
from tiegraph.products.raster import hillshade
from tiegraph.products.surface import Window
from tiegraph.products.tuning import HeightTuning

TUNING = HeightTuning()


def made(scene, cloud, size=10_000):
    """dsm and sigma of all tiles put together."""
    surface = scene.surface
    out = np.full((2, *surface.shape), np.nan)
    for window in surface.windows(size):
        low, high = surface.box(window.grown(margin(TUNING)))
        near = cloud.where(((cloud.xyz_m >= low) & (cloud.xyz_m <= high)).all(axis=1))
        at = slice(window.row, window.row + window.rows), slice(window.column, window.column + window.columns)
        out[0][at], out[1][at] = height_tile(near, surface, window, TUNING)
    return out


def truth(scene):
    """w (rows, columns) and the distance of each pixel to the edge of the box, in pixels."""
    u, v = np.meshgrid(*scene.surface.places(Window(0, 0, *scene.surface.shape)))
    inside = np.maximum(np.abs(u - np.mean(BOX[0])) - 1, np.abs(v - np.mean(BOX[1])) - 1)
    return height(u, v), np.abs(inside) / PIXEL, in_box(u, v)


@pytest.mark.parametrize("spacing", [0.025, 0.07], ids=["four points a pixel", "every other pixel"])
def test_heights_are_as_true_as_their_sigma_says(spacing):
    dsm, sigma = made(MAP, MAP.cloud(spacing))
    w, edge, roof = truth(MAP)
    far = edge > 8
    assert np.isfinite(dsm[far]).mean() > 0.98
    known = far & np.isfinite(dsm)
    error = (dsm - w)[known]
    assert 0.7 < np.sqrt(np.mean((error / sigma[known]) ** 2)) < 1.2
    assert 0.93 < np.mean(np.abs(error) < 2 * sigma[known]) < 0.995
    assert abs(error.mean()) < 0.1 * NOISE_M  # no bias towards the top
    assert np.median(dsm[roof & far]) == pytest.approx(ROOF, abs=0.02)
    assert 0.9 * NOISE_M < np.median(sigma[known]) < 1.1 * NOISE_M


def test_errors_of_their_own_are_not_worse_than_the_sigma_says():
    dsm, sigma = made(MAP, MAP.cloud(together=False))
    w, edge, _ = truth(MAP)
    known = (edge > 8) & np.isfinite(dsm)
    assert 0.4 < np.sqrt(np.mean(((dsm - w) / sigma)[known] ** 2)) < 0.8


def test_the_top_of_a_cell_is_its_surface_and_what_lies_below_or_alone_above_is_not():
    cloud = MAP.cloud()
    dsm, _ = made(MAP, cloud)
    w, edge, roof = truth(MAP)
    border = (edge < 0.9) & roof & np.isfinite(dsm)  # cells with points of the sides, down to the ground
    assert np.mean(np.abs(dsm - ROOF)[border] < 0.1) > 0.9
    below = cloud.moved(np.eye(4) + np.array([[0, 0, 0, 0]] * 2 + [[0, 0, 0, -1.0], [0, 0, 0, 0]]))
    stray = below.where(np.arange(40))
    stray.xyz_m[:, 2] = 4.5
    both, _ = made(MAP, type(cloud).concatenate([cloud, below, stray]))
    far = edge > 8
    assert np.nanmax(np.abs(both - dsm)[far]) < 4 and np.mean(np.abs(both - dsm)[far] < 0.03) > 0.97


def test_points_that_face_away_are_not_seen():
    cloud = MAP.cloud()
    underside = MAP.cloud(seed=1)
    underside.xyz_m[:, 2] += 2.5
    underside.normal[:] = [0, 0, -1]
    dsm, _ = made(MAP, type(cloud).concatenate([cloud, underside]))
    assert np.nanmax(dsm) < ROOF + 5 * NOISE_M


def test_small_holes_are_interpolated_and_large_ones_are_not():
    cloud = MAP.cloud()
    u, v = cloud.xyz_m[:, 0], cloud.xyz_m[:, 1]
    small = (np.abs(u % 1 - 0.5) < 0.2) & (np.abs(v % 1 - 0.5) < 0.2)  # 8 pixels wide
    large = (np.abs(u - 6.5) < 0.6) & (np.abs(v - 2) < 0.6)
    dsm, sigma = made(MAP, cloud.where(~(small | large)))
    w, edge, _ = truth(MAP)
    x, y = np.meshgrid(*MAP.surface.places(Window(0, 0, *MAP.surface.shape)))
    apart = (np.abs(x - 6.5) > 1) | (np.abs(y - 2) > 1)
    hole = (np.abs(x % 1 - 0.5) < 0.19) & (np.abs(y % 1 - 0.5) < 0.19) & (edge > 16) & apart
    assert np.isfinite(dsm[hole]).all() and np.abs(dsm - w)[hole].max() < 4 * NOISE_M
    assert 0.5 < np.sqrt(np.mean(((dsm - w) / sigma)[hole] ** 2)) < 1.5 and sigma[hole].max() < 2 * NOISE_M
    assert np.isnan(dsm[int(4 / PIXEL), int(6.5 / PIXEL)])
    assert (np.isnan(dsm) == np.isnan(sigma)).all()


def test_a_facade_is_a_map_in_another_frame():
    flat, upright = made(MAP, MAP.cloud()), made(WALL, WALL.cloud())
    np.testing.assert_array_equal(np.isnan(flat), np.isnan(upright))
    same = np.abs(flat - upright) < 1e-5
    assert np.mean(same[np.isfinite(flat)]) > 0.9999  # a point on the border of two cells may change them


def test_tiles_do_not_change_the_values():
    cloud = MAP.cloud(0.06)
    whole, tiled = made(MAP, cloud), made(MAP, cloud, size=37)
    np.testing.assert_allclose(tiled, whole, atol=2e-6)


def test_shades_are_bright_towards_the_light():
    u, v = np.meshgrid(np.arange(10.0), -np.arange(10.0))
    flat, towards, away = (hillshade(slope * (u - v), 1.0)[0, 0] for slope in (0.0, 0.5, -0.5))
    assert away < flat < towards
    assert flat == pytest.approx(255 / np.sqrt(2), abs=1)
    assert (hillshade(np.full((5, 5), np.nan), 1.0) == 0).all()
