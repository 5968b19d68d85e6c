"""Surfaces and heights above the ground."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from products_world import BOX, FACADE, MAP, NOISE_M, PIXEL, ROOF, SIZE, WALL, Scene, height, in_box
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.products.heights import height_tile, margin
from tiegraph.products.raster import hillshade
from tiegraph.products.settings import ProductsSettings
from tiegraph.products.surface import Survey, Window, choose, project
from tiegraph.products.tuning import ChooseTuning, HeightTuning
from tiegraph.scene.results import Cloud

TUNING = ChooseTuning()
SHIFT = np.array([500.0, 4000.0, 10.0])


def survey(scene, **more):
    return Survey(**{"sample": scene.cloud(0.04), "views": scene.views(), "spacing": 0.04, "shift": SHIFT} | more)


def test_cameras_that_look_down_make_a_map_whose_pixels_are_round_and_lie_on_whole_ones_of_the_crs():
    (found,), notes = choose(survey(MAP), ProductsSettings(), TUNING)
    assert found.name == "map" and (found.frame.surface_from_world == np.eye(4)).all()
    assert found.pixel_m == 0.025  # 9 m over 400 pixels are 2.25 cm; half the spacing is 2 cm
    corner = (found.low + found.offset)[:2] / found.pixel_m
    np.testing.assert_allclose(corner, np.round(corner), atol=1e-6)
    assert np.abs(np.subtract(found.shape, (240, 320))).max() <= 1
    assert "look sideways" in notes[0] and "map" in notes[0]


@pytest.mark.slow
def test_cameras_that_look_sideways_make_elevations_of_the_walls():
    (found,), notes = choose(survey(WALL), ProductsSettings(pixel_m=0.05), TUNING)
    assert found.name == "elevation1"
    outwards = found.frame.surface_from_world[2, :3]
    assert np.degrees(np.arccos(outwards @ FACADE[:, 2])) < 12  # the plane of the world slants by up to 6 deg
    np.testing.assert_allclose(found.frame.surface_from_world[1, :3], [0, 0, 1])
    assert found.frame.surface_from_world[0, :3] @ FACADE[:, 0] > 0.97  # a viewer sees u grow to the right
    assert found.low[0] == 0 and found.high[0] == pytest.approx(SIZE[0], abs=0.2)
    assert found.low[1] + found.offset[1] == pytest.approx(3.0 + SHIFT[2], abs=0.1)
    assert 0.5 < found.share <= 1 and "elevation1: " in " ".join(notes)


@pytest.mark.slow
def test_two_banks_are_two_elevations_that_face_each_other():
    turned = transforms.rigid(np.diag([-1.0, -1.0, 1.0]), [30.0, -20.0, 0.0])
    other = WALL.cloud(0.04, seed=1)
    both = Cloud.concatenate([WALL.cloud(0.04), replace(other.moved(turned), origin=None)])
    found, _ = choose(survey(WALL, sample=both), ProductsSettings(), TUNING)
    assert [s.name for s in found] == ["elevation1", "elevation2"]
    one, two = (s.frame.surface_from_world[2, :3] for s in found)
    assert one @ two < -0.95


def test_what_hangs_over_cameras_has_its_clearance_above_the_water():
    """The world as a ceiling 20 m high whose box hangs down to 18 m; the water at 3 m. Nothing comes of what is beside
    the cameras."""
    ceiling = Scene(transforms.rigid(np.diag([1.0, -1.0, -1.0]), [5.0, 7.0, 20.0]), "underside1")
    points = ceiling.cloud(0.04)
    stray = replace(points.where(np.arange(1)), xyz_m=np.array([[1e7, -1e7, 30.0]]))
    seen = survey(ceiling, water=3.0, sample=Cloud.concatenate([points, stray]))
    (found,), notes = choose(seen, ProductsSettings(pixel_m=PIXEL), TUNING)
    assert found.name == "underside1" and found.level and found.axes[2] == "up from the water"
    assert "underside1: 9" in " ".join(notes) and found.offset.tolist() == [500.0, 4000.0, -3.0]
    window = Window(0, 0, *found.shape)
    w, sigma = height_tile(ceiling.cloud(), found, window, HeightTuning())
    x, y = np.meshgrid(*found.places(window))
    u, v = x - 5.0, 7.0 - y
    off = found.heights(w) - (17.0 - height(u, v))
    rim = cv2.dilate(in_box(u, v).astype(np.uint8), np.ones((5, 5))) > cv2.erode(
        in_box(u, v).astype(np.uint8), np.ones((5, 5))
    )
    assert np.isfinite(off).mean() > 0.9 and 0.5 < np.nanstd(off[~rim] / sigma[~rim]) < 2
    np.testing.assert_allclose(found.w(found.heights(w)), w, atol=1e-5)
    aside = replace(
        seen, sample=replace(ceiling.cloud(0.04).moved(transforms.rigid(np.eye(3), [60.0, 0, 0])), origin=None)
    )
    found, notes = choose(aside, ProductsSettings(), TUNING)
    assert not found and "no raster is made" in notes[0]


def test_a_plane_that_is_given_is_taken_between_its_ends():
    ends = (*(np.array([10.0, -20.0]) + SHIFT[:2]), *(np.array([10.0, -20.0]) + 4 * FACADE[:2, 0] + SHIFT[:2]))
    (found,), _ = choose(survey(WALL), ProductsSettings(plane=ends, pixel_m=0.05), TUNING)
    assert found.shape[1] == pytest.approx(80, abs=1) and np.isnan(found.share)
    np.testing.assert_allclose(found.frame.surface_from_world[2, :3], FACADE[:, 2], atol=1e-9)
    np.testing.assert_allclose(
        transforms.apply(found.frame.surface_from_world, np.array([[10.0, -20, 3]]))[0], [0, 3, 0], atol=1e-9
    )


@pytest.mark.parametrize(
    ("plane", "said"),
    [((0.0, 0.0, 9.0, 0.0), "no points of the cloud lie within"), ((1.0, 2.0, 1.0, 2.0), "are one place")],
)
def test_a_plane_without_points_or_length_is_an_error_that_says_where_the_points_are(plane, said):
    with pytest.raises(ReconstructionError, match=said) as told:
        choose(survey(WALL), ProductsSettings(plane=plane), TUNING)
    assert "products.plane" in str(told.value)


def test_pixels_that_no_image_resolves_are_refused_and_coarse_ones_are_taken():
    with pytest.raises(ReconstructionError, match=r"pixel_m = 0.0005: no image resolves map better.*give 0.006 or"):
        choose(survey(MAP), ProductsSettings(pixel_m=0.0005), TUNING)
    for taken in (0.01, 0.5):
        assert choose(survey(MAP), ProductsSettings(pixel_m=taken), TUNING)[0][0].pixel_m == taken


@pytest.mark.slow
def test_what_is_ordered_is_made_and_nothing_else():
    assert choose(survey(MAP), ProductsSettings(make="none"), TUNING)[0] == []
    assert [s.name for s in choose(survey(WALL), ProductsSettings(make="both"), TUNING)[0]] == ["map", "elevation1"]
    assert [s.name for s in choose(survey(MAP), ProductsSettings(make="map"), TUNING)[0]] == ["map"]
    found, notes = choose(survey(MAP), ProductsSettings(make="elevations"), TUNING)
    assert found == [] and "no vertical plane" in notes[0] and "products.make = map" in notes[0]


def test_strays_far_away_do_not_make_a_raster_endless():
    cloud = MAP.cloud(0.04)
    cloud.xyz_m[:20] += 5000.0
    (found,), _ = choose(survey(MAP, sample=cloud), ProductsSettings(pixel_m=0.05), TUNING)
    assert max(found.shape) < 200


def test_a_narrow_part_of_the_survey_is_not_cut_off():
    cloud = MAP.cloud(0.04)
    (whole,), _ = choose(survey(MAP, sample=cloud), ProductsSettings(pixel_m=0.05), TUNING)
    few = len(cloud) // 400  # a path that leads away from the area, and a point beyond
    cloud.xyz_m[:few, 0] = np.linspace(0.99, 0.75, few) * whole.low[0] + np.linspace(0.01, 0.25, few) * whole.high[0]
    cloud.xyz_m[:few, 1] = whole.high[1] + np.linspace(0, 0.3, few) * (whole.high[1] - whole.low[1])
    cloud.xyz_m[few, 1] = whole.high[1] + 5 * (whole.high[1] - whole.low[1])
    (found,), _ = choose(survey(MAP, sample=cloud), ProductsSettings(pixel_m=0.05), TUNING)
    tall = found.high[1] - found.low[1]
    assert 1.27 < tall / (whole.high[1] - whole.low[1]) < 1.33


def test_the_box_around_a_window_holds_its_pixels():
    surface = WALL.surface
    window = Window(20, 30, rows=10, columns=15)
    u, v = np.meshgrid(*surface.places(window))
    low, high = surface.box(window)
    for w in (-5.0, 5.0):
        xyz = surface.frame.in_world(u, v, np.full_like(u, w))
        assert (xyz >= low).all() and (xyz <= high).all()
    assert sum(w.rows * w.columns for w in surface.windows(50)) == np.prod(surface.shape)


def test_a_point_behind_a_camera_or_beside_its_image_is_not_seen():
    view = MAP.view("a", (4, 3, 9.0), (4, 3.001, 0.0))
    x, y, z = project(view, np.array([[4, 3, 0], [4, 3, 12], [9.5, 3, 0.0]]))
    np.testing.assert_allclose([x[0], y[0], z[0]], [240, 180, 9], atol=0.1)
    assert np.isnan([x[1:], y[1:], z[1:]]).all()


TUNING_HEIGHTS = HeightTuning()


def made(scene, cloud, size=10_000):
    """dsm and sigma of all tiles put together."""
    surface = scene.surface
    out = np.full((2, *surface.shape), np.nan)
    for window in surface.windows(size):
        low, high = surface.box(window.grown(margin(TUNING_HEIGHTS)))
        near = cloud.where(((cloud.xyz_m >= low) & (cloud.xyz_m <= high)).all(axis=1))
        at = slice(window.row, window.row + window.rows), slice(window.column, window.column + window.columns)
        out[0][at], out[1][at] = height_tile(near, surface, window, TUNING_HEIGHTS)
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_facade_is_a_map_in_another_frame():
    flat, upright = made(MAP, MAP.cloud()), made(WALL, WALL.cloud())
    np.testing.assert_array_equal(np.isnan(flat), np.isnan(upright))
    same = np.abs(flat - upright) < 1e-5
    assert np.mean(same[np.isfinite(flat)]) > 0.9999  # a point on the border of two cells may change them


@pytest.mark.slow
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
