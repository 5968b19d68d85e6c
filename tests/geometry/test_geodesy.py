import numpy as np
import pytest

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import (
    Origin,
    crs_coordinates,
    geodetic_from_world,
    make_origin,
    utm_crs,
    world_from_geodetic,
)

HERE = (35.6965, 139.7695, 37.0)


@pytest.mark.parametrize("crs", ["auto", "ENU", "EPSG:6677", "EPSG:6691", "EPSG:32654"])
def test_round_trip_and_metres(crs):
    origin = make_origin(*HERE, crs)
    points = np.array([HERE, (35.6975, 139.7705, 47.0)])
    world = world_from_geodetic(points, origin)
    np.testing.assert_allclose(geodetic_from_world(world, origin), points, atol=1e-9, rtol=0)
    step = world[1] - world[0]
    # 0.001 degrees: 110.96 m north and 90.5 m east here (WGS84); grids may turn and scale by some 1e-3
    assert 142.9 < np.hypot(step[0], step[1]) < 143.5
    assert abs(step[2] - 10) < 0.01
    assert np.abs(world).max() < 500


def test_japanese_plane_axes_are_east_north():
    """EPSG:6677 counts north first; our world is always east, north, up."""
    origin = make_origin(*HERE, "EPSG:6677")
    world = world_from_geodetic(np.array([HERE, (HERE[0] + 0.001, *HERE[1:])]), origin)
    assert (world[1] - world[0])[1] > 110 and abs((world[1] - world[0])[0]) < 2


def test_shift_is_round_and_given_back():
    origin = make_origin(*HERE, "auto")
    assert origin.crs == utm_crs(*HERE[:2]) == "EPSG:32654"
    assert all(s % 10 == 0 for s in origin.shift_m)
    np.testing.assert_allclose(crs_coordinates(np.zeros(3), origin), origin.shift_m)
    assert Origin.from_dict(origin.to_dict()) == origin


@pytest.mark.parametrize(
    ("crs", "words"),
    [("EPSG:4326", "not projected"), ("EPSG:99999999", "unknown CRS"), ("EPSG:2225", "not metres")],
)
def test_unusable_crs(crs, words):
    with pytest.raises(InputError, match=words):
        make_origin(*HERE, crs)
