import re

import numpy as np
import pytest

from tiegraph.errors import InputError
from tiegraph.geometry import geodesy
from tiegraph.geometry.geodesy import Origin, crs_transformer, geodetic_from_world, make_origin, world_from_geodetic

HERE = (35.6965, 139.7695, 37.0)


@pytest.mark.parametrize("crs", ["auto", "ENU", "EPSG:6677", "EPSG:6691", "EPSG:32654"])
def test_round_trip_and_metres(crs):
    origin = make_origin(*HERE, crs)
    points = np.array([HERE, (35.6975, 139.7705, 47.0)])
    world = world_from_geodetic(points, origin)
    np.testing.assert_allclose(geodetic_from_world(world, origin), points, atol=1e-9, rtol=0)
    step = world[1] - world[0]
    # 0.001 degrees: 110.96 m north and 90.5 m east here (WGS84); grids may turn and scale by some 1e-3
    assert 142.9 < np.hypot(step[0], step[1]) < 143.5 and abs(step[2] - 10) < 0.01
    assert np.abs(world).max() < 500


@pytest.mark.parametrize(
    ("lon", "expected"),
    [([10.0, 11, 13], 11.0), ([179.9, -179.9, -179.7], -179.9), ([-179.9, 179.9, 179.8], 179.9)],
)
def test_the_middle_of_positions_about_the_date_line_is_there(lon: list[float], expected: float) -> None:
    found = geodesy.middle(np.array([[1.0, a, 5.0] for a in lon]))
    assert found == pytest.approx((1.0, expected, 5.0))


@pytest.mark.parametrize(
    ("crs", "place"),
    [(27700, (52, -1)), (28992, (52.2, 5.3)), (2056, (47, 8)), (31467, (50, 9)), (5514, (49.8, 15)),
     (30169, (35.6, 139.7)), (26717, (40, -81)), (23700, (47, 19))],
)  # fmt: skip
def test_heights_of_national_grids_stay_as_they_are(crs: int, place: tuple[float, float]) -> None:
    """Changed from datum to datum 40 m became -6 in Britain and -3 in the Netherlands, and no geoid was meant."""
    east, north, height = crs_transformer(f"EPSG:{crs}").transform(place[1], place[0], 40.0)
    assert height == 40.0
    lon, lat, back = crs_transformer(f"EPSG:{crs}").transform(east, north, height, direction="INVERSE")
    assert (lat, lon, back) == pytest.approx((*place, 40.0), abs=2e-8)
    world = make_origin(*place, 40.0, f"EPSG:{crs}") if crs != 5514 else None  # counts to the south and west
    assert world is None or world_from_geodetic(np.array([[*place, 43.0]]), world)[0, 2] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("crs", "place", "north"),
    [
        ("+proj=utm +zone=54 +datum=WGS84 +units=m +no_defs", (35.7, 139.8), (0, 1)),
        ("epsg:6677", (35.7, 139.8), (0, 1)),
        ("EPSG:3031", (-71.0, 0.0), (0, 1)),  # polar: its east and north both "point north"
        ("EPSG:3031", (-71.0, 90.0), (1, 0)),
        ("EPSG:5041", (85.0, 180.0), (0, -1)),  # 180 degrees is up
        ("EPSG:32661", (85.0, 0.0), (0, 1)),  # north and east, both "point south"
    ],
)
def test_grids_in_words_of_proj_and_about_the_poles(crs: str, place: tuple, north: tuple[int, int]) -> None:
    origin = make_origin(*place, 10.0, crs)
    moved = world_from_geodetic(np.array([[*place, 10.0], [place[0] + 0.001, place[1], 12.0]]), origin)
    step = moved[1] - moved[0]
    assert step[:2] / np.linalg.norm(step[:2]) == pytest.approx(north, abs=0.02) and step[2] == pytest.approx(2)
    assert geodetic_from_world(moved, origin)[1] == pytest.approx((place[0] + 0.001, place[1], 12.0), abs=1e-9)


def test_the_height_of_a_grid_in_feet_is_in_feet() -> None:
    lon, lat, height = crs_transformer("EPSG:2263").transform(984250.0, 194305.3, 100.0, direction="INVERSE")
    assert (lat, lon, height) == pytest.approx((40.7, -74.0, 30.48006), abs=1e-5)
    assert crs_transformer("EPSG:2263").transform(lon, lat, height)[2] == pytest.approx(100.0)


def test_how_well_two_datums_are_tied_is_said() -> None:
    assert "places are good to 9 m" in geodesy.vertical_note("EPSG:30169")
    assert "taken as one" in geodesy.vertical_note("EPSG:6677")
    assert "good to" not in geodesy.vertical_note("EPSG:32632") and "no geoid" in geodesy.vertical_note("EPSG:32632")


SWISS = "+proj=somerc +lat_0=46.9524055555556 +lon_0=7.43958333333333 +x_0=2600000 +y_0=1200000 +ellps=bessel"


@pytest.mark.parametrize(
    ("crs", "words"),
    [
        (SWISS, "datum is not named, and on the ellipsoid Bessel 1841 places may lie hundreds of metres"),
        (f"{SWISS} +towgs84=674.374,15.056,405.346", "^$"),
        ("+proj=utm +zone=54 +ellps=GRS80", "^$"),  # metres at most
        ("ENU", "^$"),
    ],
)
def test_a_grid_on_an_ellipsoid_without_a_datum_is_said(crs: str, words: str) -> None:
    assert re.search(words, geodesy.datum_note(crs))


def test_japanese_plane_axes_are_east_north():
    """EPSG:6677 counts north first; our world is always east, north, up."""
    origin = make_origin(*HERE, "EPSG:6677")
    world = world_from_geodetic(np.array([HERE, (HERE[0] + 0.001, *HERE[1:])]), origin)
    assert (world[1] - world[0])[1] > 110 and abs((world[1] - world[0])[0]) < 2


def test_shift_is_round_and_given_back():
    origin = make_origin(*HERE, "auto")
    assert origin.crs == geodesy.utm_crs(*HERE[:2]) == "EPSG:32654"
    assert all(s % 10 == 0 for s in origin.shift_m)
    np.testing.assert_allclose(geodesy.crs_coordinates(np.zeros(3), origin), origin.shift_m)
    assert Origin.from_dict(origin.to_dict()) == origin


@pytest.mark.parametrize(
    ("crs", "words"),
    [
        ("EPSG:4326", "not projected"),
        ("EPSG:4978", "not projected"),
        ("EPSG:99999999", "unknown CRS"),
        ("foo", "unknown CRS"),
        ("EPSG:2225", "not metres"),
        ("EPSG:5513", "to the west"),
        ("EPSG:27700", "British National Grid.*1.15[0-9]* times.*EPSG:32654"),
        ("EPSG:32632", "1.268. times the true ones.*lat 35.69650, lon 139.76950.*EPSG:32654"),
        ("EPSG:3857", "1.23.* times the true ones.*EPSG:32654"),
        ("EPSG:28992", "times the true ones"),
        ("EPSG:5514", "lie outside it|times the true ones"),
        ("+proj=tmerc +lon_0=141 +ellps=GRS80 +axis=esu", "mirror"),
    ],
)
def test_unusable_crs(crs, words):
    with pytest.raises(InputError, match=words):
        make_origin(*HERE, crs)


def test_exchanged_positions_are_guessed_from_the_area_of_a_crs():
    with pytest.raises(InputError, match="exchanged"):
        make_origin(11.58, 48.14, 500.0, "EPSG:25832")  # Munich


@pytest.mark.parametrize(
    ("crs", "lat", "lon"),
    [("EPSG:32653", 35.7, 139.8), ("EPSG:2154", 48.8, 2.3), ("EPSG:3857", 0.2, 32.6), ("EPSG:2193", -41.3, 174.8),
     ("EPSG:2056", 46.9, 7.4), ("EPSG:3035", 48.1, 11.6), ("EPSG:27700", 58.0, -6.0), ("EPSG:27572", 48.8, 2.3)],
)  # fmt: skip
def test_crs_that_serve_here_or_nearly_so(crs, lat, lon):
    assert make_origin(lat, lon, 0.0, crs).crs == crs


def test_positions_outside_the_area_of_use_are_said():
    there = np.array([HERE, (48.1, 11.6, 500.0)])
    assert geodesy.area_note("EPSG:32654", there[:1]) == geodesy.area_note("ENU", there) == ""
    note = geodesy.area_note("EPSG:32653", there)
    assert "2 of 2 positions" in note and "lat 35.69650" in note and "EPSG:32654" in note
    assert (
        geodesy.area_note("EPSG:3832", np.array([[0.0, 179.9, 0], [0, -179.9, 0]])) == ""
    )  # its area spans the date line


@pytest.mark.parametrize(
    ("metres", "far"),
    [
        (np.arange(20.0), []),
        (np.r_[np.arange(19.0), 5e5], [19]),
        (np.r_[5e5, np.arange(8.0), -4e3], [0, 9]),
        (np.r_[np.zeros(60), np.linspace(0, 3e4, 60)], []),  # stands, then drives 30 km
        (np.r_[np.arange(5.0), 1900 + np.arange(4.0)], []),
        (np.r_[np.arange(5.0), 5e5 + np.arange(4.0)], [5, 6, 7, 8]),
        (np.r_[np.arange(4.0), 5e5 + np.arange(4.0)], [4, 5, 6, 7]),
        (np.r_[0.0, 5e5], [1]),  # the user is asked which of two
        (np.r_[0.0], []),
        (np.r_[0.0, 1.0, 5e5], [2]),
    ],
)
def test_what_stands_far_from_the_rest(metres, far):
    places = np.array([(HERE[0], HERE[1] + m / 90500, HERE[2]) for m in metres])
    found, away = geodesy.far_from_rest(places)
    assert np.flatnonzero(found).tolist() == far and len(away) == len(places)
