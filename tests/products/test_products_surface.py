from dataclasses import replace

import numpy as np
import pytest

from products_world import FACADE, MAP, SIZE, WALL
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.products.settings import ProductsSettings
from tiegraph.products.surface import Survey, Window, choose, project
from tiegraph.products.tuning import ChooseTuning
from tiegraph.scene.results import Cloud

TUNING = ChooseTuning()
SHIFT = np.array([500.0, 4000.0, 10.0])


def survey(scene, **more):
    return Survey(**{"sample": scene.cloud(0.04), "views": scene.views(), "spacing": 0.04, "shift": SHIFT} | more)


def test_cameras_that_look_down_make_a_map_whose_pixels_are_round_and_lie_on_whole_ones_of_the_crs():
    (found,), notes = choose(survey(MAP), ProductsSettings(), TUNING)
    assert found.name == "map" and (found.surface_from_world == np.eye(4)).all()
    assert found.pixel_m == 0.025  # 9 m over 400 pixels are 2.25 cm; half the spacing is 2 cm
    corner = (found.low + found.offset)[:2] / found.pixel_m
    np.testing.assert_allclose(corner, np.round(corner), atol=1e-6)
    assert np.abs(np.subtract(found.shape, (240, 320))).max() <= 1
    assert "look sideways" in notes[0] and "map" in notes[0]


def test_cameras_that_look_sideways_make_elevations_of_the_walls():
    (found,), notes = choose(survey(WALL), ProductsSettings(pixel_m=0.05), TUNING)
    assert found.name == "elevation1"
    outwards = found.surface_from_world[2, :3]
    assert np.degrees(np.arccos(outwards @ FACADE[:, 2])) < 12  # the plane of the world slants by up to 6 deg
    np.testing.assert_allclose(found.surface_from_world[1, :3], [0, 0, 1])
    assert found.surface_from_world[0, :3] @ FACADE[:, 0] > 0.97  # a viewer sees u grow to the right
    assert found.low[0] == 0 and found.high[0] == pytest.approx(SIZE[0], abs=0.2)
    assert found.low[1] + found.offset[1] == pytest.approx(3.0 + SHIFT[2], abs=0.1)
    assert 0.5 < found.share <= 1 and "elevation1: " in " ".join(notes)


def test_two_banks_are_two_elevations_that_face_each_other():
    turned = transforms.rigid(np.diag([-1.0, -1.0, 1.0]), [30.0, -20.0, 0.0])
    other = WALL.cloud(0.04, seed=1)
    both = Cloud.concatenate([WALL.cloud(0.04), replace(other.moved(turned), origin=None)])
    found, _ = choose(survey(WALL, sample=both), ProductsSettings(), TUNING)
    assert [s.name for s in found] == ["elevation1", "elevation2"]
    one, two = (s.surface_from_world[2, :3] for s in found)
    assert one @ two < -0.95


def test_a_plane_that_is_given_is_taken_between_its_ends():
    ends = (*(np.array([10.0, -20.0]) + SHIFT[:2]), *(np.array([10.0, -20.0]) + 4 * FACADE[:2, 0] + SHIFT[:2]))
    (found,), _ = choose(survey(WALL), ProductsSettings(plane=ends, pixel_m=0.05), TUNING)
    assert found.shape[1] == pytest.approx(80, abs=1) and np.isnan(found.share)
    np.testing.assert_allclose(found.surface_from_world[2, :3], FACADE[:, 2], atol=1e-9)
    np.testing.assert_allclose(
        transforms.apply(found.surface_from_world, np.array([[10.0, -20, 3]]))[0], [0, 3, 0], atol=1e-9
    )


@pytest.mark.parametrize(
    ("plane", "said"),
    [((0.0, 0.0, 9.0, 0.0), "no points of the cloud lie within"), ((1.0, 2.0, 1.0, 2.0), "are one place")],
)
def test_a_plane_without_points_or_length_is_an_error_that_says_where_the_points_are(plane, said):
    with pytest.raises(ReconstructionError, match=said) as told:
        choose(survey(WALL), ProductsSettings(plane=plane), TUNING)
    assert "products.plane" in str(told.value)


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


def test_the_box_around_a_window_holds_its_pixels():
    surface = WALL.surface
    window = Window(20, 30, rows=10, columns=15)
    u, v = np.meshgrid(*surface.places(window))
    low, high = surface.box(window)
    for w in (-5.0, 5.0):
        xyz = surface.in_world(u, v, np.full_like(u, w))
        assert (xyz >= low).all() and (xyz <= high).all()
    assert sum(w.rows * w.columns for w in surface.windows(50)) == np.prod(surface.shape)


def test_a_point_behind_a_camera_or_beside_its_image_is_not_seen():
    view = MAP.view("a", (4, 3, 9.0), (4, 3.001, 0.0))
    x, y, z = project(view, np.array([[4, 3, 0], [4, 3, 12], [9.5, 3, 0.0]]))
    np.testing.assert_allclose([x[0], y[0], z[0]], [240, 180, 9], atol=0.1)
    assert np.isnan([x[1:], y[1:], z[1:]]).all()
