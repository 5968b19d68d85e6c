import json
import sqlite3
import sys
import xml.etree.ElementTree as xml

import laspy
import numpy as np
import pyproj
import pytest
from scipy.spatial import cKDTree

import terrain_world as world
from terrain_world import NOISE_M, PIXEL
from tiegraph.pipeline.products import TerrainWork
from tiegraph.products.raster import Place, read_window, write_lines
from tiegraph.products.surface import Window
from tiegraph.products.terrain import contour_lines, equidistance
from tiegraph.products.tuning import ContourTuning, Tuning

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


@pytest.mark.slow
def test_terrain_below_houses_trees_and_cars_is_as_true_as_its_sigma_says(town):
    dtm, sigma, work = town
    bare, _, objects = world.town()
    below = objects & np.isfinite(dtm)
    assert below[objects].mean() > 0.99 and (np.isnan(dtm) == np.isnan(sigma)).all()
    ratio = ((dtm - bare) / sigma)[below]
    assert np.mean(np.abs(ratio) < 3) > 0.995 and 0.3 < np.sqrt(np.mean(ratio**2)) < 1.5
    assert np.abs(dtm - bare)[below].max() < 0.4
    assert "1 m" not in work.said() and "contours." in work.said()


@pytest.mark.slow
def test_points_on_the_terrain_are_ground_and_none_is_lost(town):
    points, on_object = world.cloud()
    las = laspy.read(town[2].path("classified.laz"))
    assert len(las) == len(points) and set(np.unique(las.classification)) == {1, 2}
    assert las.header.parse_crs().to_epsg() == 32654
    distance, nearest = cKDTree(points.xyz_m + world.ORIGIN.shift_m).query(las.xyz)
    assert distance.max() < 2e-3 and len(np.unique(nearest)) == len(points)
    is_ground = np.zeros(len(points), bool)
    is_ground[nearest] = las.classification == 2
    x, y = points.xyz_m[:, 0] - 100.0, points.xyz_m[:, 1] - 200.0
    high = on_object & (points.xyz_m[:, 2] - world.ground(x, y) > 0.5)
    assert not is_ground[high].any() and not is_ground[-1]  # the last lies beyond the raster
    assert is_ground[: world.ROWS * world.COLUMNS][~on_object[: world.ROWS * world.COLUMNS]].mean() > 0.9
    below = is_ground[world.ROWS * world.COLUMNS : -1]
    assert 0.3 < below.mean()  # seen below trees and houses: as far as interpolated terrain is known


@pytest.mark.slow
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


@pytest.mark.slow
def test_what_is_wider_than_asked_for_stays(tmp_path):
    dtm, _, _ = made(tmp_path / "run", objects_m=4.0)
    left, low, wide, deep = world.HOUSES[1]
    row, column = int(world.ROWS - (low + deep / 2) / PIXEL), int((left + wide / 2) / PIXEL)
    assert dtm[row, column] == pytest.approx(world.town()[1][row, column], abs=1e-3)


@pytest.mark.slow
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
    assert Place(world.ORIGIN).has_terrain(world.surface())
    assert not Place(world.ORIGIN).has_terrain(world.surface(name="elevation1"))
    assert not Place(None, "units").has_terrain(world.surface())


TUNING = ContourTuning()
X, Y = world.places((150, 200))
PLACES = X[0], Y[:, 0]


def hill(x=X, y=Y):
    """Height of a round hill on a slope."""
    return 0.1 * x + 4 * np.exp(-((x - 20) ** 2 + (y - 15) ** 2) / 60)


@pytest.mark.parametrize(
    ("relief", "sigma", "every"), [(30, 0.02, 1.0), (3, 0.02, 0.1), (75, 0.02, 2.0), (3, 0.4, 2.0), (900, 0.1, 50.0)]
)
def test_the_equidistance_fits_the_relief_and_is_no_finer_than_the_heights(relief, sigma, every):
    w = np.linspace(100, 100 + relief, 10_000).reshape(100, 100)
    assert equidistance(w, np.full(w.shape, sigma), TUNING) == every
    assert equidistance(np.full((5, 5), np.nan), np.full((5, 5), np.nan), TUNING) == 0


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_lines_lie_at_their_height_to_a_pixel_and_rings_are_closed(noise):
    lines = contour_lines(hill() + noise * world.errors(X.shape), np.full(X.shape, 0.02), PLACES, 0.25, TUNING)
    off, rings = [], 0
    for line in lines:
        assert line.w == pytest.approx(round(line.w / 0.25) * 0.25) and line.sigma == pytest.approx(0.02)
        assert line.index == (round(line.w / 0.25) % 5 == 0)
        x, y = line.uv.T
        step = world.PIXEL / 2
        slope = np.hypot(hill(x + step, y) - hill(x - step, y), hill(x, y + step) - hill(x, y - step))
        off.append((hill(x, y) - line.w) / (slope + noise))
        closed = (line.uv[0] == line.uv[-1]).all()
        ends = line.uv[[0, -1]]
        border = np.minimum(ends - [X[0, 0], Y[-1, 0]], [X[0, -1], Y[0, 0]] - ends).min(axis=1)
        assert closed or (border < 1e-6).all()  # a line ends at the border or nowhere
        rings += closed
    off = np.abs(np.concatenate(off))
    assert np.percentile(off, 99) < 1 and off.max() < 3
    assert rings >= 5 and len({line.w for line in lines}) > 15


def test_lines_are_smooth_and_specks_are_left_out():
    w = 0.1 * X + 0.03 * world.errors(X.shape)
    w[40, 40] += 5
    lines = contour_lines(w, np.full(w.shape, 0.03), PLACES, 0.5, TUNING)
    assert len(lines) == len({line.w for line in lines})
    turned = [np.diff(np.unwrap(np.arctan2(*np.diff(line.uv, axis=0).T))) for line in lines]
    assert np.degrees(np.sqrt(np.mean(np.concatenate(turned) ** 2))) < 15


def test_heights_too_scattered_for_planes_have_no_lines():
    w, sigma = np.full(X.shape, np.nan), np.full(X.shape, 0.02)
    w[3::25, 5::25] = hill()[3::25, 5::25]  # as of a canal between walls: a cell here and there
    assert equidistance(w, sigma, TUNING) > 0
    assert contour_lines(w, sigma, PLACES, 0.25, TUNING) == []


def drawn(folder):
    lines = contour_lines(hill() + 40, np.full(X.shape, 0.02), (PLACES[0] + 388_800, PLACES[1] + 3_951_200), 1, TUNING)
    return write_lines(folder / "contours.gpkg", lines, world.surface(), Place(world.ORIGIN)), lines


@pytest.mark.slow
def test_a_geopackage_has_the_crs_and_heights(tmp_path):
    raw = pytest.importorskip("pyogrio.raw")
    name, lines = drawn(tmp_path)
    meta, _, shapes, values = raw.read(tmp_path / name, layer="contours")
    assert pyproj.CRS.from_user_input(meta["crs"]).to_epsg() == 32654
    assert meta["geometry_type"] == "LineString Z" and list(meta["fields"]) == ["elevation_m", "index", "sigma_m"]
    assert values[0].tolist() == [line.w for line in lines]
    with sqlite3.connect(tmp_path / name) as data:
        styled = data.execute("SELECT f_table_name, f_geometry_column, styleQML, useAsDefault FROM layer_styles")
        (layer, column, style, default), *more = styled.fetchall()
    assert (layer, column, default, more) == ("contours", "geom", 1, [])
    assert xml.fromstring(style.split("\n", 1)[1]).find("renderer-v2/symbols/symbol/layer") is not None
    first = np.frombuffer(shapes[0][9:], "<f8").reshape(-1, 3)
    np.testing.assert_allclose(first, np.c_[lines[0].uv, np.full(len(lines[0].uv), lines[0].w)])


def test_without_pyogrio_it_is_geojson_in_degrees(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    name, lines = drawn(tmp_path)
    assert name == "contours.geojson"
    data = json.loads((tmp_path / name).read_text())
    lon, lat, _ = np.array(data["features"][0]["geometry"]["coordinates"]).T
    east, north = pyproj.Transformer.from_crs(4326, 32654, always_xy=True).transform(lon, lat)
    np.testing.assert_allclose(np.c_[east, north], lines[0].uv, atol=1e-3)
    assert data["features"][0]["properties"]["elevation_m"] == lines[0].w
    nowhere = write_lines(tmp_path / "a.gpkg", lines, world.surface(), Place(None))
    assert "pyogrio" in nowhere and not (tmp_path / "a.geojson").exists()
