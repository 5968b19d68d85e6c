import numpy as np
import pytest

from products_world import BOX, CHECK, MAP, PIXEL, ROOF, SIZE, WALL, colour, height, in_box
from tiegraph.products.ortho import Images, block_px, draw, gains, ortho_margin, ortho_tile, patch
from tiegraph.products.surface import Window, project
from tiegraph.products.tuning import OrthoTuning

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


def test_nothing_is_shown_twice_beside_the_box(ortho):
    rgba, _ = ortho
    u, v = grid()
    red = (rgba[0].astype(int) - rgba[1] > 25) & (rgba[3] > 0)
    blue = (rgba[2].astype(int) - rgba[1] > 25) & (rgba[3] > 0)
    assert (red & ~in_box(u, v) & far_from_the_box(u, v, 2 * PIXEL)).sum() == 0
    assert (red & in_box(u, v)).sum() > 0.9 * in_box(u, v).sum() / 1.1
    assert (blue & far_from_the_box(u, v, 2 * PIXEL)).mean() < 1e-3  # the faces are no part of a map


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


def test_what_no_image_sees_has_no_colour():
    low = MAP.view("low", (-6.0, 3.0, 6.0), (4.0, 3.001, 0.0))
    rgba, source = made(MAP, images_of(MAP, [low]))
    u, v = grid()
    shadow = (u > BOX[0][1] + 3 * PIXEL) & (u < 6.0) & (np.abs(v - 3) < 0.8)
    assert (rgba[3][shadow] == 0).mean() > 0.99 and (source[shadow] == 0).mean() > 0.99
    free = (u > 1) & (u < BOX[0][0] - 3 * PIXEL) & (np.abs(v - 3) < 1)
    assert (source[free] == 1).all()


def test_a_facade_is_a_map_in_another_frame(ortho):
    rgba, source = made(WALL, images_of(WALL))
    assert (source == ortho[1]).mean() > 0.999
    assert np.percentile(np.abs(rgba.astype(int) - ortho[0]), 99.9) <= 1


def test_tiles_do_not_change_the_picture(ortho, images):
    rgba, source = made(MAP, images, size=48)
    assert (source == ortho[1]).all() and (rgba[3] == ortho[0][3]).all()
    assert np.abs(rgba.astype(int) - ortho[0]).max() <= 2


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
