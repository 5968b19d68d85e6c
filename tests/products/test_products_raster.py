import json

import numpy as np
import pytest
import rasterio

from products_world import MAP, WALL
from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin
from tiegraph.products.raster import Place, read_window, write_raster
from tiegraph.products.surface import Surface, Window

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
