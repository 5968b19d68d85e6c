"""Pictures of rasters: heights as colours with their scale, contour lines, and the report that shows them."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import terrain_world as world
from tiegraph.products.contours import Line
from tiegraph.products.pictures import relief
from tiegraph.report.parts import product_views


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
