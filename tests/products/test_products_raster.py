"""Files of rasters, and their pictures: heights as colours with their scale, contour lines, in the report."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rasterio

import terrain_world as world
from products_world import MAP, WALL
from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin
from tiegraph.products.raster import Place, read_window, relief, write_raster
from tiegraph.products.surface import Surface, Window
from tiegraph.products.terrain import Line
from tiegraph.report.parts import product_views

ORIGIN = Origin(lat_deg=35.7, lon_deg=139.8, height_m=40.0, crs="EPSG:32654", shift_m=(388700.0, 3951000.0, 40.0))
SAID = "accuracy predicted: in the world 0.02 m"


def written(path, name, values, surface=None, origin=ORIGIN, unit="m"):
    surface = surface or large()
    parts = [(w, values[:, w.row : w.row + w.rows, w.column : w.column + w.columns]) for w in surface.windows(300)]
    write_raster(path / f"{name}.tif", parts, surface, Place(origin, unit, SAID), path / "scratch")
    assert not list((path / "scratch").iterdir())
    return path / f"{name}.tif"


def large(name="map", rows=700, columns=1100):
    low, high = np.array([10.0, 20.0, -5.0]), np.array([10.0 + columns * 0.1, 20.0 + rows * 0.1, 5.0])
    return Surface(name, np.eye(4), low, high, pixel_m=0.1, offset=np.array(ORIGIN.shift_m))


def ramp(rows=700, columns=1100):
    values = np.add.outer(np.arange(rows), np.arange(columns)) / 100.0
    values[:50, :60] = np.nan
    return values[None].astype(np.float32)


def test_a_raster_is_a_cloud_optimized_geotiff_that_says_what_it_is(tmp_path):
    path = written(tmp_path, "dsm", ramp())
    with rasterio.open(path) as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.crs == rasterio.crs.CRS.from_epsg(32654)
        assert raster.nodata == -9999 and raster.dtypes == ("float32",) and raster.shape == (700, 1100)
        assert raster.block_shapes == [(512, 512)] and raster.overviews(1) == [2, 4]
        assert raster.units == ("m",) and "height" in raster.descriptions[0]
        assert raster.tags()["accuracy"] == SAID and raster.tags()["surface"] == "map"
        assert np.array(json.loads(raster.tags()["surface_from_crs"])).tolist() == np.eye(4).tolist()
        assert tuple(raster.xy(0, 0)) == pytest.approx((388710.05, 3951020 + 70 - 0.05))
        found = raster.read(1, masked=True)
        statistics = {k: float(v) for k, v in raster.tags(1).items() if k.startswith("STATISTICS")}
    assert found.mask.sum() == 3000
    np.testing.assert_array_equal(found.filled(np.nan), ramp()[0])
    assert statistics["STATISTICS_MINIMUM"] == pytest.approx(0.5) and statistics["STATISTICS_MAXIMUM"] == pytest.approx(
        17.98
    )
    assert statistics["STATISTICS_MEAN"] == pytest.approx(float(found.mean()), rel=1e-4)


def test_the_same_pixels_make_the_same_bytes(tmp_path):
    one, two = (written(tmp_path / name, "sigma", ramp()).read_bytes() for name in "ab")
    assert one == two


def test_a_wall_has_a_local_crs_and_its_matrix(tmp_path):
    path = written(tmp_path, "dsm", np.zeros((1, *WALL.surface.shape), np.float32), WALL.surface)
    with rasterio.open(path) as raster:
        assert "LOCAL_CS" in raster.crs.to_wkt() and "elevation1" in raster.crs.to_wkt()
        matrix = np.array(json.loads(raster.tags()["surface_from_crs"]))
    corner = matrix @ [10.0 + ORIGIN.shift_m[0], -20.0 + ORIGIN.shift_m[1], 3.0 + ORIGIN.shift_m[2], 1]
    np.testing.assert_allclose(corner, [0, 0, 0, 1], atol=1e-6)
    described = Place(ORIGIN).described(WALL.surface)
    assert described["axes"]["w"] == "out of the wall" and np.allclose(described["surface_from_crs"], matrix)


def test_a_compound_crs_stays_one(tmp_path):
    origin = Origin(**{**ORIGIN.to_dict(), "crs": "EPSG:25833+5783", "shift_m": ORIGIN.shift_m})
    with rasterio.open(written(tmp_path, "dsm", ramp(), origin=origin)) as raster:
        assert "COMPD_CS" in raster.crs.to_wkt() or "COMPOUNDCRS" in raster.crs.to_wkt()


def test_a_crs_without_metres_is_refused(tmp_path):
    origin = Origin(**{**ORIGIN.to_dict(), "crs": "EPSG:2263", "shift_m": ORIGIN.shift_m})
    with pytest.raises(InputError, match="not metres"):
        written(tmp_path, "dsm", ramp(), origin=origin)


def test_a_model_without_scale_is_in_units(tmp_path):
    with rasterio.open(written(tmp_path, "dsm", ramp(), origin=None, unit="units")) as raster:
        assert raster.units == ("units",) and "units of the model" in raster.crs.to_wkt()


def test_colours_have_alpha_and_sources_the_nearest_overview(tmp_path):
    colours = np.zeros((4, 700, 1100), np.uint8)
    colours[0], colours[3, :, 550:] = 200, 255
    with rasterio.open(written(tmp_path, "ortho", colours)) as raster:
        assert [c.name for c in raster.colorinterp] == ["red", "green", "blue", "alpha"]
    source = np.full((1, 700, 1100), 7, np.uint16)
    source[:, ::2] = 4000
    with rasterio.open(written(tmp_path, "source", source)) as raster:
        assert raster.nodata == 0 and set(np.unique(raster.read(1, out_shape=(175, 275)))) <= {7, 4000}


def test_a_full_disk_is_an_error_that_names_it(tmp_path, monkeypatch):
    from tiegraph import limits

    monkeypatch.setattr(limits, "size_limit", lambda: 1000)
    with pytest.raises(InputError, match="ulimit -f"):
        written(tmp_path, "dsm", ramp())
    assert not (tmp_path / "dsm.tif").exists()


def test_windows_are_read_beyond_the_raster_as_unknown(tmp_path):
    path = written(tmp_path, "dsm", ramp())
    found = read_window(path, Window(-2, 1098, rows=4, columns=4))
    assert np.isnan(found[:2]).all() and np.isnan(found[:, 2:]).all()
    np.testing.assert_array_equal(found[2:, :2], ramp()[0, :2, 1098:1100])
    assert read_window(path, Window(0, 0, rows=700, columns=1100), step=4).shape == (175, 275)
    assert MAP.surface.shape == (120, 160)


def decoded(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(int)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A map of 120 x 100 pixels that rises to the east, with a corner that is not known."""
    x, _ = world.places((100, 120))
    w = (0.1 * x).astype(np.float32)
    w[:20, :20] = np.nan
    return world.as_run(tmp_path_factory.mktemp("picture") / "run", dsm=w, sigma=np.full(w.shape, np.float32(0.02)))


def test_colours_follow_the_heights_and_what_is_not_known_is_white(run):
    picture = decoded(relief(run / "products/map/dsm.tif", 1400, "m"))
    assert picture.shape[1] == 120 and 100 < picture.shape[0] < 160
    assert picture[5:15, 5:15].min() > 240 and picture[40:90, 30:110].max() < 240
    # viridis: dark blue is low, yellow is high
    assert picture[50:90, 2:8, 0].mean() > picture[50:90, 112:118, 0].mean() + 20
    assert picture[50:90, 112:118, 2].mean() > picture[50:90, 2:8, 2].mean() + 80


def test_a_wide_raster_is_reduced(run):
    assert decoded(relief(run / "products/map/dsm.tif", 60, "m")).shape[1] == 60


def test_contour_lines_are_where_the_map_has_them(run):
    # 10 m to the east of the left border, that is 50 pixels, along the whole height
    east, north = np.array([100.0, 200.0]) + world.ORIGIN.shift_m[:2]
    line = Line(41.0, np.array([[east + 10.1, north], [east + 10.1, north + 20]]), sigma=0.02, index=False)
    plain, drawn = (decoded(relief(run / "products/map/dsm.tif", 1400, "m", lines)) for lines in ((), [line]))
    changed = np.abs(drawn - plain)[:100].sum(axis=(0, 2))
    assert changed.argmax() == 50 and changed[48:53].sum() > 0.5 * changed.sum()
    assert changed[:40].max() == changed[72:].max() == 0  # beyond the blocks of the JPEG file


def test_the_report_shows_each_picture_with_its_name(run):
    folder = run / "products" / "map"
    for name in ("overview.jpg", "dsm.jpg", "dtm.jpg"):
        cv2.imwrite(str(folder / name), np.full((20, 30, 3), 200, np.uint8))
    (run / "products" / "note.txt").write_text("no folder")
    views = product_views(SimpleNamespace(path=run))
    names = [name for name, uri in views if uri.startswith("data:image/jpeg")]
    assert names == ["True orthophoto: map", "Surface model: map", "Terrain and contour lines: map"]
