"""Orthophotos; files of rasters and their pictures: heights as colours with their scale, contour lines."""

import json
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rasterio

import terrain_world as world
from products_world import BOX, CHECK, MAP, PIXEL, ROOF, SIZE, WALL, colour, height, in_box
from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin
from tiegraph.products import ortho as ortho_engine
from tiegraph.products.frame import Frame
from tiegraph.products.ortho import Images, block_px, draw, gains, ortho_margin, ortho_tile, patch, score
from tiegraph.products.raster import Place, read_window, relief, write_raster
from tiegraph.products.surface import Surface, Window, project
from tiegraph.products.terrain import Line
from tiegraph.products.tuning import OrthoTuning
from tiegraph.report.parts import product_views

TUNING = OrthoTuning()


def heights_of(scene):
    """w of windows and blocks, as the raster of the surface has it."""
    surface = scene.surface
    rows, columns = surface.shape

    def heights(window, step=1):
        u, v = np.meshgrid(*surface.places(window, step))
        inside = (u > 0) & (u < SIZE[0]) & (v > 0) & (v < SIZE[1])
        return np.where(inside, height(u, v), np.nan).astype(np.float32)

    return heights


def images_of(scene, views=None, exposures=None):
    views, heights, surface = views or scene.views(), heights_of(scene), scene.surface
    exposures = np.ones(len(views)) if exposures is None else exposures
    rgb = [np.clip(scene.picture(v) * e, 0, 255).astype(np.uint8) for v, e in zip(views, exposures)]
    masks = [np.ones(p.shape[:2], bool) for p in rgb]
    buffers = [draw(v, surface, heights, m, None, TUNING) for v, m in zip(views, masks)]
    found = [patch(v, b, p, surface, heights, block_px(len(views)), TUNING) for v, b, p in zip(views, buffers, rgb)]
    return Images(views, buffers.__getitem__, rgb.__getitem__, gains(found))


def made(scene, images, size=10_000):
    """RGBA and source of all tiles put together."""
    surface, heights, wide = scene.surface, heights_of(scene), ortho_margin(TUNING)
    rgba, source = np.zeros((4, *surface.shape), np.uint8), np.zeros(surface.shape, np.uint16)
    for window in surface.windows(size):
        w = heights(window.grown(wide))
        at = slice(window.row, window.row + window.rows), slice(window.column, window.column + window.columns)
        found = ortho_tile(surface, window, w, np.full(w.shape, 0.01), images, TUNING)
        rgba[:, at[0], at[1]], source[at] = found
    return rgba, source


@pytest.fixture(scope="module")
def images():
    return images_of(MAP)


@pytest.fixture(scope="module")
def ortho(images):
    return made(MAP, images)


def grid(scene=MAP):
    return np.meshgrid(*scene.surface.places(Window(0, 0, *scene.surface.shape)))


def far_from_the_box(u, v, away=3 * PIXEL):
    off = np.maximum(np.abs(u - np.mean(BOX[0])) - 1, np.abs(v - np.mean(BOX[1])) - 1)
    return np.abs(off) > away


@pytest.mark.slow
def test_the_checker_is_where_it_is_to_half_a_pixel(ortho):
    rgba, source = ortho
    u, v = grid()
    known = (rgba[3] > 0) & far_from_the_box(u, v)
    assert known[far_from_the_box(u, v)].mean() > 0.95 and ((source > 0) == (rgba[3] > 0)).all()
    truth = colour(u, v, in_box(u, v)).astype(float)
    off = np.abs(rgba[:3].transpose(1, 2, 0) - truth).max(-1)
    inside = (
        known & (np.abs(u / CHECK % 1 - 0.5) < 0.39) & (np.abs(v / CHECK % 1 - 0.5) < 0.39)
    )  # a pixel off the edges
    assert np.percentile(off[inside], 99) < 15
    # an edge of the checker is where half of the contrast is: columns of rows in the middle of fields
    for red, where in ((False, known & ~in_box(u, v)), (True, known & in_box(u, v))):
        rows = np.abs(v[:, 0] / CHECK % 1 - 0.5) < 0.3
        places = []
        for row in np.flatnonzero(rows):
            light = (rgba[0, row].astype(float) - 60) / 140
            at = np.flatnonzero((np.diff(np.sign(light - 0.5)) != 0) & where[row, 1:] & where[row, :-1])
            share = (0.5 - light[at]) / (light[at + 1] - light[at])
            places += list((u[row, at] + share * PIXEL) / CHECK)
        places = np.array(places)
        error = np.abs(places - np.round(places)) * CHECK / PIXEL
        assert len(places) > 50 and np.percentile(error, 95) < 0.5, red


@pytest.mark.slow
def test_nothing_is_shown_twice_beside_the_box(ortho):
    rgba, _ = ortho
    u, v = grid()
    red = (rgba[0].astype(int) - rgba[1] > 25) & (rgba[3] > 0)
    blue = (rgba[2].astype(int) - rgba[1] > 25) & (rgba[3] > 0)
    assert (red & ~in_box(u, v) & far_from_the_box(u, v, 2 * PIXEL)).sum() == 0
    assert (red & in_box(u, v)).sum() > 0.9 * in_box(u, v).sum() / 1.1
    assert (blue & far_from_the_box(u, v, 2 * PIXEL)).mean() < 1e-3  # the faces are no part of a map


@pytest.mark.slow
def test_the_source_of_a_pixel_saw_it(ortho, images):
    _, source = ortho
    u, v = grid()
    xyz = np.stack([u, v, height(u, v)], -1)
    for k, view in enumerate(images.views):
        own = source == k + 1
        assert own.any()
        assert np.isfinite(project(view, xyz[own])[2]).all()
        centre = np.linalg.inv(view.cam_from_world)[:3, 3]
        for t in np.linspace(0.02, 0.98, 60):  # the way to the camera is free, but for what lies at its very edge
            at = xyz[own] + t * (centre - xyz[own])
            hidden = (at[:, 2] < ROOF - 3 * PIXEL) & in_box(at[:, 0] + 1e-9, at[:, 1])
            assert hidden.mean() < 0.02
    corner = source[:10, :10]
    assert len(np.unique(corner)) == 1 and images.views[int(corner[0, 0]) - 1].name == "6.jpg"


@pytest.mark.slow
def test_what_no_image_sees_has_no_colour():
    low = MAP.view("low", (-6.0, 3.0, 6.0), (4.0, 3.001, 0.0))
    rgba, source = made(MAP, images_of(MAP, [low]))
    u, v = grid()
    shadow = (u > BOX[0][1] + 3 * PIXEL) & (u < 6.0) & (np.abs(v - 3) < 0.8)
    assert (rgba[3][shadow] == 0).mean() > 0.99 and (source[shadow] == 0).mean() > 0.99
    foot = 4 * PIXEL  # two blocks of two pixels, by which the slope of the ground is told
    free = (u > 1) & (u < BOX[0][0] - foot) & (np.abs(v - 3) < 1)
    assert (source[free] == 1).all()


@pytest.mark.slow
def test_a_facade_is_a_map_in_another_frame(ortho):
    rgba, source = made(WALL, images_of(WALL))
    assert (source == ortho[1]).mean() > 0.999
    assert np.percentile(np.abs(rgba.astype(int) - ortho[0]), 99.9) <= 1


@pytest.mark.slow
def test_tiles_do_not_change_the_picture(ortho, images):
    rgba, source = made(MAP, images, size=48)
    assert (source == ortho[1]).all() and (rgba[3] == ortho[0][3]).all()
    assert np.abs(rgba.astype(int) - ortho[0]).max() <= 2


@pytest.mark.slow
def test_what_an_image_cannot_see_is_left_out_without_a_change(monkeypatch):
    """Pieces of the surface that lie outside of an image are not scored for it."""
    longer = [[3, 1, 1], [1, 3, 1], [1, 1, 1]]  # times the focal length: each sees a ninth of what it saw
    close = [replace(v, K=v.K * longer, name=f"close {v.name}") for v in MAP.views()[:2]]
    found, points = [], []
    for size in (10_000, 16):
        monkeypatch.setattr(ortho_engine, "_PIECE", size)
        monkeypatch.setattr(ortho_engine, "score", lambda *g: points[-1].append(g[2].xyz.size) or score(*g))
        points.append([])
        images = images_of(MAP, close)
        found.append((*made(MAP, images), *(images.buffer(k).depth for k in range(2))))
    assert (found[0][1] > 0).mean() > 0.02 and all(map(np.array_equal, *found))
    assert sum(points[1]) < 0.5 * sum(points[0])


@pytest.mark.slow
def test_exposures_are_compensated_and_seams_are_not_seen():
    exposures = np.array([1.0, 0.8, 1.1, 0.9, 1.0, 0.75, 1.1, 0.85, 1.0])
    images = images_of(MAP, exposures=exposures)
    left = exposures * images.gains.mean(axis=1)
    assert np.ptp(exposures) / exposures.mean() > 0.35 and np.ptp(left) / left.mean() < 0.1
    rgba, source = made(MAP, images)
    u, v = grid()
    light = (colour(u, v, np.zeros_like(u, bool))[..., 0] == 200) & ~in_box(u, v)
    inner = light & (np.abs(u / CHECK % 1 - 0.5) < 0.35) & (np.abs(v / CHECK % 1 - 0.5) < 0.35) & far_from_the_box(u, v)
    values = rgba[0][inner & (source > 0)].astype(float)
    assert values.std() / values.mean() < 0.04


@pytest.mark.slow
def test_masked_pixels_and_what_a_depth_map_has_in_front_are_not_taken():
    from tiegraph.scene.results import DepthMap

    view, surface, heights = MAP.view("a", (4, 3, 9.0), (4, 3.001, 0.0)), MAP.surface, heights_of(MAP)
    mask = np.ones((360, 480), bool)
    mask[:, :240] = False
    masked = draw(view, surface, heights, mask, None, TUNING)
    near = np.full((90, 120), np.nan, np.float32)
    near[:, 60:70] = 3.0  # a mast at a third of the way
    pose, K = view.cam_from_world, view.K / [[4], [4], [1]]
    own = DepthMap("a", near, np.full(near.shape, 0.01, np.float32), np.zeros(near.shape, np.uint8), K, pose)
    mast = draw(view, surface, heights, np.ones((360, 480), bool), own, TUNING)
    rgb, u = MAP.picture(view), grid()[0]
    for buffer, hidden in ((masked, u < 3.9), (mast, (u > 4.05) & (u < 4.7))):
        _, source = made(MAP, Images([view], [buffer].__getitem__, [rgb].__getitem__, np.ones((1, 3))))
        assert (source[hidden] == 0).mean() > 0.97
        assert (source[60, 110:130] == 1).all()


def test_an_image_that_sees_nothing_of_the_surface_has_no_buffer():
    away = MAP.view("away", (4, 3, 9.0), (4, 3.001, 20.0))
    assert draw(away, MAP.surface, heights_of(MAP), np.ones((360, 480), bool), None, TUNING) is None
    assert (gains([None, None]) == 1).all()


def test_blocks_are_larger_for_many_images():
    assert [block_px(n) for n in (1, 500, 501, 2000, 2001, 40_000)] == [8, 8, 16, 16, 32, 128]


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
    return Surface(name, Frame(np.eye(4)), low, high, pixel_m=0.1, offset=np.array(ORIGIN.shift_m))


def ramp(rows=700, columns=1100):
    values = np.add.outer(np.arange(rows), np.arange(columns)) / 100.0
    values[:50, :60] = np.nan
    return values[None].astype(np.float32)


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_compound_crs_stays_one(tmp_path):
    origin = Origin(**{**ORIGIN.to_dict(), "crs": "EPSG:25833+5783", "shift_m": ORIGIN.shift_m})
    with rasterio.open(written(tmp_path, "dsm", ramp(), origin=origin)) as raster:
        assert "COMPD_CS" in raster.crs.to_wkt() or "COMPOUNDCRS" in raster.crs.to_wkt()


def test_a_crs_without_metres_is_refused(tmp_path):
    origin = Origin(**{**ORIGIN.to_dict(), "crs": "EPSG:2263", "shift_m": ORIGIN.shift_m})
    with pytest.raises(InputError, match="not metres"):
        written(tmp_path, "dsm", ramp(), origin=origin)


@pytest.mark.slow
def test_a_model_without_scale_is_in_units(tmp_path):
    with rasterio.open(written(tmp_path, "dsm", ramp(), origin=None, unit="units")) as raster:
        assert raster.units == ("units",) and "units of the model" in raster.crs.to_wkt()


@pytest.mark.slow
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


@pytest.mark.slow
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
