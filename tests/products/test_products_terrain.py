import numpy as np
import pytest

import terrain_world as world
from terrain_world import NOISE_M, PIXEL
from tiegraph.pipeline.terrain import TerrainWork, wanted
from tiegraph.products.raster import Place, read_window
from tiegraph.products.surface import Window
from tiegraph.products.tuning import Tuning

WHOLE = Window(0, 0, rows=world.ROWS, columns=world.COLUMNS)


def made(folder, tile=128, objects_m=16.0, **rasters):
    """dtm and its sigma of a run folder, and the work that made them."""
    world.as_run(folder, **rasters)
    place = Place(world.ORIGIN, "m", "accuracy predicted: none")
    work = TerrainWork(folder, world.surface(), place, Tuning(), tile, objects_m=objects_m)
    for step in work.steps():
        for item in step.todo():
            step.make(item)
        step.finish()
    dtm, sigma = (read_window(work.path(f"{name}.tif"), WHOLE).astype(float) for name in ("dtm", "dtm_sigma"))
    return dtm - work.surface.offset[2], sigma, work


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    return made(tmp_path_factory.mktemp("town") / "run")


def test_terrain_below_houses_trees_and_cars_is_as_true_as_its_sigma_says(town):
    dtm, sigma, work = town
    bare, _, objects = world.town()
    below = objects & np.isfinite(dtm)
    assert below[objects].mean() > 0.99 and (np.isnan(dtm) == np.isnan(sigma)).all()
    ratio = ((dtm - bare) / sigma)[below]
    assert np.mean(np.abs(ratio) < 3) > 0.995 and 0.3 < np.sqrt(np.mean(ratio**2)) < 1.5
    assert np.abs(dtm - bare)[below].max() < 0.4
    assert "1 m" not in work.said() and "contours." in work.said()


def test_open_ground_keeps_its_height_and_sigma(town):
    dtm, sigma, _ = town
    _, top, objects = world.town()
    same = np.abs(dtm - top) < 1e-4
    assert same[~objects].mean() > 0.85 and not same[objects].any()
    assert np.mean(np.abs(sigma[same] - NOISE_M) < 1e-6) > 0.999  # elsewhere it is the same by chance


@pytest.mark.slow
def test_tiles_do_not_change_the_terrain(town, tmp_path):
    whole = made(tmp_path / "whole", tile=512)
    np.testing.assert_allclose(whole[0], town[0], atol=1e-4)
    np.testing.assert_allclose(whole[1], town[1], atol=1e-5)
    again = made(tmp_path / "again")[2]
    for name in ("dtm.tif", "dtm_sigma.tif", "contours.gpkg", "dtm.jpg"):
        assert again.path(name).read_bytes() == town[2].path(name).read_bytes()


def test_what_is_wider_than_asked_for_stays(tmp_path):
    dtm, _, _ = made(tmp_path / "run", objects_m=4.0)
    left, low, wide, deep = world.HOUSES[1]
    row, column = int(world.ROWS - (low + deep / 2) / PIXEL), int((left + wide / 2) / PIXEL)
    assert dtm[row, column] == pytest.approx(world.town()[1][row, column], abs=1e-3)


def test_ground_that_was_not_seen_for_a_long_way_is_not_invented(tmp_path):
    top = world.town()[1].copy()
    x, y = world.places()
    pond = np.hypot(x - 30, y - 25) < 14
    beyond = x > 58
    top[pond | beyond] = np.nan
    dtm, _, _ = made(tmp_path / "run", dsm=top)
    assert np.isnan(dtm[np.hypot(x - 30, y - 25) < 4]).all()
    assert np.isfinite(dtm[pond]).any() and np.isnan(dtm[x > 60]).all()


def test_a_wall_and_a_model_without_scale_have_no_terrain():
    assert wanted(world.surface(), Place(world.ORIGIN))
    assert not wanted(world.surface(name="elevation1"), Place(world.ORIGIN))
    assert not wanted(world.surface(), Place(None, "units"))
