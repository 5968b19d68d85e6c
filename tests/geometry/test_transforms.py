"""Motions, similarities and rays; geodesy; which way is up; stereo pairs."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry import geodesy, transforms
from tiegraph.geometry.geodesy import Origin, crs_transformer, geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.geometry.gravity import UpTuning, levelled, looking_up, up_vector
from tiegraph.geometry.stereo import Pinhole, rectify, rectifying_rotation, usable_rays
from tiegraph.geometry.transforms import Similarity, cross, level_umeyama, off_plane, robust_umeyama, umeyama, unit_rays

vectors = arrays(float, 3, elements=st.floats(-100, 100))


def pose(rotvec, t):
    return transforms.rigid(Rotation.from_rotvec(rotvec / 50).as_matrix(), t)


@pytest.mark.slow
@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_inverses_undo_and_quaternions_come_back(rotvec, t):
    a = pose(rotvec, t)
    np.testing.assert_allclose(transforms.invert(a) @ a, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(transforms.apply(a, transforms.centre(a)[None]), 0, atol=1e-9)
    q = transforms.quaternion_xyzw(a[:3, :3])
    np.testing.assert_allclose(transforms.from_quaternion_wxyz(np.roll(q, 1), t), a, atol=1e-9)


def test_interpolation_is_halfway_and_respects_gaps():
    times = np.array([0.0, 2.0, 10.0])
    poses = np.stack([pose(np.array([0, 0, 0.0]), [0, 0, 0]), pose(np.array([0, 0, 50.0]), [4, 0, 0]),
                      pose(np.array([0, 0, 50.0]), [8, 0, 0])])  # fmt: skip
    out = transforms.interpolate(times, poses, np.array([1.0, 5.0, 11.0, np.nan, 2.0]), max_gap_s=3.0)
    np.testing.assert_allclose(out[0, :3, 3], [2, 0, 0])
    assert abs(transforms.angle_deg(np.eye(3), out[0, :3, :3]) - np.degrees(0.5)) < 1e-9
    assert np.isnan(out[1]).all() and np.isnan(out[2]).all() and np.isnan(out[3]).all()
    np.testing.assert_allclose(out[4], poses[1])


@pytest.mark.slow
@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_jacobians_of_rotation_vectors(rotvec, direction):
    v, step = rotvec / max(np.linalg.norm(rotvec), 1.0) * 3.0, direction / 100 * 1e-6
    by_vector = transforms.turn_by_vector(v[None])[0]
    moved = Rotation.from_rotvec(v + step) * Rotation.from_rotvec(v).inv()
    np.testing.assert_allclose(moved.as_rotvec(), by_vector @ step, atol=1e-11)
    np.testing.assert_allclose(transforms.vector_by_turn(v[None])[0] @ by_vector, np.eye(3), atol=1e-9)


def test_jacobians_of_rotation_vectors_where_their_series_begin():
    ends = np.array([[0.0, 0.0, 0.9999e-3], [0.0, 0.0, 1.0001e-3]])
    for jacobian in (transforms.turn_by_vector, transforms.vector_by_turn):
        first, second = jacobian(ends)
        np.testing.assert_allclose(first, second, atol=2e-7)
        np.testing.assert_array_equal(jacobian(np.zeros((1, 3)))[0], np.eye(3))


def world(seed=0, n=40):
    rng = np.random.default_rng(seed)
    truth = Similarity(2.5, Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3) * 10)
    source = rng.normal(size=(n, 3)) * 5
    return truth, source, rng


def test_similarities_are_recovered_exactly_and_never_a_mirror():
    truth, source, _ = world()
    fit = umeyama(source, truth(source))
    assert abs(fit.scale - 2.5) < 1e-12
    np.testing.assert_allclose(fit.matrix, truth.matrix, atol=1e-9)
    rigid = umeyama(source, Similarity(1.0, truth.rotation, truth.translation)(source), with_scale=False)
    np.testing.assert_allclose(rigid.rotation, truth.rotation, atol=1e-9)
    assert rigid.scale == 1.0
    rng = np.random.default_rng(1)
    source = rng.normal(size=(10, 3))
    fit = umeyama(source, source * [1, 1, -1])
    assert np.linalg.det(fit.rotation) > 0.99
    with pytest.raises(ValueError, match="at least 3 points, got 2"):
        umeyama(np.zeros((2, 3)), np.zeros((2, 3)))


def test_a_level_fit_turns_about_the_vertical_and_gives_wrong_places_little_weight():
    rng = np.random.default_rng(3)
    source, turn = rng.uniform(-10, 10, (30, 3)), Rotation.from_euler("z", 130, degrees=True).as_matrix()
    target = Similarity(2.0, turn, np.array([5.0, -7.0, 3.0]))(source) + rng.normal(0, 0.02, (30, 3))
    target[:6, :2] += 40.0
    fit, rms = level_umeyama(source, target, np.full((30, 3), 0.02))
    np.testing.assert_allclose(fit.translation, [5, -7, 3], atol=0.05)
    assert transforms.angle_deg(fit.rotation, turn) < 0.1 and fit.rotation[2, 2] == 1.0
    assert fit.scale == pytest.approx(2.0, abs=0.005) and 0 < rms < 0.1


def test_robust_fit_ignores_gross_errors_and_is_as_good_as_its_noise():
    truth, source, rng = world(3, 60)
    target = truth(source) + rng.normal(size=source.shape) * 0.1
    target[:15] += rng.normal(size=(15, 3)) * 30
    fit, inliers = robust_umeyama(source, target, 0.2)
    assert inliers[:15].sum() <= 1 and inliers[15:].sum() >= 42
    error = np.linalg.norm(fit(source) - truth(source), axis=1)
    assert 1e-3 < np.sqrt(np.mean(error**2)) < 0.1
    plain = np.linalg.norm(umeyama(source, target)(source) - truth(source), axis=1)
    assert np.mean(plain) > 10 * np.mean(error)


def pairs(angle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays of 40 points from two centres, the second turned off the epipolar plane; the way to the second centre."""
    rng = np.random.default_rng(0)
    xyz, way = rng.uniform((-4, -3, 6), (4, 3, 12), (40, 3)), np.tile([1.0, 0.2, 0.1], (40, 1))
    first, second = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (xyz, xyz - way))
    normal = np.cross(way, first)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return first, np.cos(angle) * second + np.sin(angle) * normal, way


def test_unit_rays_go_through_their_places_and_keep_nan():
    rays = unit_rays(np.array([[0.3, -0.4], [0.0, 0.0], [np.nan, 1.0]]))
    assert np.allclose(np.linalg.norm(rays[:2], axis=1), 1) and np.allclose(rays[0, :2] / rays[0, 2], [0.3, -0.4])
    assert np.isnan(rays[2]).all()


def test_cross_is_numpys():
    a, b = np.random.default_rng(0).normal(size=(2, 20, 3))
    assert np.allclose(cross(a, b), np.cross(a, b))


def test_angles_to_the_plane_are_those_by_which_rays_were_turned():
    for angle in (0.0, 1e-4, 0.02):
        first, second, way = pairs(angle)
        assert np.allclose(off_plane(way, first, np.cross(first, second)), np.sin(angle), atol=1e-12)


TUNING = UpTuning()
LEVEL = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)  # world_from_cam of a level camera that looks north


def _up(turns, cameras=1):
    """What images of ``cameras`` cameras, turned (N, 3, 3) world_from_cam and frame by frame, say of up."""
    frames = len(turns) // cameras
    poses = transforms.rigid(np.swapaxes(turns, 1, 2), np.zeros((len(turns), 3)))
    return up_vector(poses, np.repeat(np.arange(frames), cameras), TUNING)


def _off_deg(up):
    return np.degrees(np.arccos(min(1.0, up.direction[2])))


@pytest.mark.parametrize(("yaws", "ring"), [((80, -80), True), ((0, 180), True), ((0, 10), False), ((0, 60), False)])
def test_cameras_all_round_say_which_way_is_up(yaws: tuple[float, float], ring: bool) -> None:
    """Two that look away from each other do; of a stereo pair that drives in a circle only the x axes do."""
    for size in (0.0, 12.0):
        up = _up([
            Rotation.from_euler("ZXZ", [30.0 * f, size * (-1) ** (f // 2), yaws[k]], degrees=True).as_matrix() @ LEVEL
            for f in range(12) for k in range(2)
        ], cameras=2)  # fmt: skip
        assert up is not None and up.ring == ring and up.tilt and up.direction[2] > 0.99
        if ring:
            assert up.sigma_deg == pytest.approx(max(size, 3.0), rel=0.1)


def test_a_camera_that_looks_up_does_not_tilt_the_ring() -> None:
    """Five level cameras and one that looks up, of a boat that goes straight on: its top points ahead."""
    own = [Rotation.from_euler("Z", 72.0 * k, degrees=True).as_matrix() @ LEVEL for k in range(5)]
    turns = np.array([*own, Rotation.from_euler("X", 90.0, degrees=True).as_matrix() @ LEVEL] * 4)
    poses, frame = transforms.rigid(np.swapaxes(turns, 1, 2), np.zeros((24, 3))), np.repeat(np.arange(4), 6)
    assert looking_up(poses, frame).tolist() == [False] * 5 + [True] + ([False] * 5 + [True]) * 3
    poses[3] = np.nan
    assert looking_up(poses, frame).sum() == 4
    up = up_vector(poses, frame, TUNING)
    assert up is not None and up.ring and up.sigma_deg == TUNING.ring_sigma_deg and _off_deg(up) < 1e-3


def _held(headings_deg, pitch_deg, roll_deg, rng):
    """Photographs (N, 3, 3) world_from_cam: all pitched alike, rolled with a sigma."""
    rolls = roll_deg * rng.standard_normal(len(headings_deg))
    angles = [[h, pitch_deg, 0.0] for h in headings_deg]
    turned = Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix() @ LEVEL
    return turned @ Rotation.from_euler("z", rolls[:, None], degrees=True).as_matrix()


@pytest.mark.parametrize("pitch_deg", [25.0, 60.0, -50.0], ids=["up a facade", "up at a bridge", "down at a find"])
def test_photographs_held_level_say_which_way_is_up_however_they_are_pitched(pitch_deg: float) -> None:
    rng = np.random.default_rng(3)
    up = _up(_held(rng.uniform(-60, 60, 30), pitch_deg, 4.0, rng))
    assert up.tilt and not up.ring
    assert _off_deg(up) < min(4.0, 1.5 * up.sigma_deg) and 3.0 <= up.sigma_deg < 9.0


def test_photographs_of_one_heading_tell_the_roll_only_and_those_held_anyhow_nothing() -> None:
    rng = np.random.default_rng(4)
    facade = _up(_held(rng.uniform(-4, 4, 30), 10.0, 2.0, rng))
    assert not facade.tilt and 8 < _off_deg(facade) < 12 and facade.sigma_deg == TUNING.lone_sigma_deg
    assert _up(_held([0.0, 180.0] * 10, -90.0, 1.0, rng)) is None  # lines of a drone, to and fro
    assert _up(_held(rng.uniform(-180, 180, 30), -90.0, 1.0, rng)) is None  # straight down, or straight up?
    assert _up(Rotation.random(40, random_state=5).as_matrix()) is None


@pytest.mark.parametrize(("headings_deg", "pitch_deg", "most_deg"), [
    (np.linspace(-60, 60, 20), 30.0, 0.5), (np.tile([0.0, 180.0], 10), -90.0, 0.5),
    (np.tile([0.0, 180.0], 10), -60.0, 0.5), (np.linspace(-180, 180, 20), -90.0, 0.5),
    (np.linspace(-4, 4, 20), 10.0, 10.5),
], ids=["up a facade", "lines of a drone", "its camera pitched", "straight down, turning", "tops alone"])  # fmt: skip
def test_a_model_is_drawn_from_above_whatever_its_frame(headings_deg, pitch_deg: float, most_deg: float) -> None:
    turns = _held(headings_deg, pitch_deg, 0.2, np.random.default_rng(6))
    places = np.column_stack([np.arange(20.0), np.arange(20) % 3, np.zeros(20)])
    anyhow = transforms.rigid(Rotation.random(random_state=1).as_matrix(), np.array([3.0, -1, 2]))
    poses = transforms.invert(transforms.rigid(turns, places)) @ anyhow
    plan = levelled(np.concatenate([poses, np.full((1, 4, 4), np.nan)]), np.arange(21))
    assert np.linalg.det(plan[:3, :3]) == pytest.approx(1)
    up = (plan @ transforms.invert(anyhow))[2, :3]
    assert np.degrees(np.arccos(min(1.0, up[2]))) < most_deg
    drawn = transforms.apply(plan, transforms.centre(poses))
    assert np.ptp(drawn[:, 0]) > 5 * np.ptp(drawn[:, 1]) and drawn.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)


K = np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]])
SIZE = (640, 480)
RANGE = (4.0, 40.0)


def camera(position, turn_deg=(0, 0, 0), K=K):
    rotation = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    return Pinhole(K, transforms.rigid(rotation, -rotation @ np.asarray(position, float)), SIZE)


PAIRS = {
    "right": camera((1, 0, 0)),
    "left": camera((-1, 0, 0)),
    "above": camera((0, -1, 0)),
    "diagonal": camera((0.7, 0.7, 0.1)),
    "convergent": camera((1.5, 0, 0), (0, 8, 0)),
    "rolled": camera((1, 0.2, 0), (2, -3, 40)),
    "half forward": camera((1, 0, 0.8)),
    "other focal": camera((1, 0, 0), K=np.diag([1.3, 1.3, 1]) @ K),
}


def points_seen(pair, partner, count=400):
    """World points in both images within the range, with their pixels."""
    rng = np.random.default_rng(0)
    pixels = rng.uniform((0, 0), SIZE, (count, 2))
    depth = 1 / rng.uniform(1 / RANGE[1], 1 / RANGE[0], count)
    world = np.c_[(pixels - K[:2, 2]) / 400, np.ones(count)] * depth[:, None]
    there = transforms.apply(partner.cam_from_world, world) @ partner.K.T
    ok = there[:, 2] > 0
    pixels_there = there[:, :2] / there[:, 2:]
    ok &= ((pixels_there >= 0) & (pixels_there <= SIZE)).all(axis=1)
    return pixels[ok], pixels_there[ok], depth[ok]


def map_pixels(homography, pixels):
    ray = np.c_[pixels, np.ones(len(pixels))] @ homography.T
    assert (ray[:, 2] > 0).all()
    return ray[:, :2] / ray[:, 2:]


@pytest.mark.parametrize("name", PAIRS)
def test_same_row_and_disparity_gives_depth(name):
    reference, partner = camera((0, 0, 0)), PAIRS[name]
    pair = rectify(reference, partner, RANGE, 1e6, 1024)
    pixels, there, depth = points_seen(reference, partner)
    inside_ray = np.c_[pixels, np.ones(len(pixels))] @ pair.rect_from_reference.T
    front = inside_ray[:, 2] > 0
    pixels, there, depth = pixels[front], there[front], depth[front]
    a, b = map_pixels(pair.rect_from_reference, pixels), map_pixels(pair.rect_from_partner, there)
    window = ((a >= 0) & (a <= pair.size)).all(axis=1)
    assert window.mean() > (0.6 if name == "half forward" else 0.9)  # there the epipole is near the border
    np.testing.assert_allclose(a[:, 1], b[:, 1], atol=1e-6)
    disparity = a[:, 0] - b[:, 0]
    assert (disparity[window] > -1e-6).all() and (disparity[window] < pair.disparities).all()
    inverse = pair.inverse_depth_per_px(*pixels.T) * (disparity + pair.offset)
    np.testing.assert_allclose(1 / inverse, depth, rtol=1e-9)


@pytest.mark.parametrize("name", PAIRS)
def test_resolution_is_kept(name):
    pair = rectify(camera((0, 0, 0)), PAIRS[name], RANGE, 1e7, 4096)
    stretch = pair.stretch(np.array([320.0]), np.array([240.0]))
    assert 0.7 < stretch[0] < 1.4


def test_limits_make_the_window_coarser():
    reference, partner = camera((0, 0, 0)), PAIRS["right"]
    free = rectify(reference, partner, RANGE, 1e7, 4096)
    few = rectify(reference, partner, RANGE, 1e7, 32)
    small = rectify(reference, partner, RANGE, 20_000, 4096)
    assert few.disparities <= 32 < free.disparities and few.focal < free.focal
    assert 15_000 < small.size[0] * small.size[1] < 22_000


def test_no_baseline_motion_along_the_view_and_no_common_part_are_refused():
    reference = camera((0, 0, 0))
    for other in (camera((0, 0, 0), (0, 5, 0)), camera((0, 0, 2))):
        assert rectifying_rotation(reference.cam_from_world, other.cam_from_world) is None
    assert rectify(reference, camera((0, 0, 2)), RANGE, 1e6, 512) is None
    for other, reach in ((camera((1, 0, 0), (0, 170, 0)), RANGE), (camera((100, 0, 0)), (4.0, 5.0))):
        assert rectify(camera((0, 0, 0)), other, reach, 1e6, 512) is None


def test_usable_rays_end_at_the_limit():
    at = np.radians([0, 64, 66, 120])
    rays = np.stack([np.sin(at), np.zeros(4), np.cos(at)], axis=1)
    assert usable_rays(rays).tolist() == [True, True, False, False]


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
