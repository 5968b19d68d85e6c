"""Plans: closed forms of a station, and paths: where frames stand, what they see, how well they are known."""

import math
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pycolmap
import pyproj
import pytest
from pydantic import ValidationError

from said import refused
from tiegraph.errors import InputError, SettingsError
from tiegraph.geometry.transforms import skew
from tiegraph.pipeline.plan import _propagate
from tiegraph.plan.accuracy import Fix, Known, PathPlan, Shape, _world, own_variance, plan_path
from tiegraph.plan.figures import Lens, Wanted, advice, rays_gain, station
from tiegraph.plan.network import MountedCamera, Network, _hit, make_network
from tiegraph.plan.path import SHAPES, Course, Path, make_path, read_anchor
from tiegraph.plan.planner import Rigged
from tiegraph.plan.request import CameraRequest, ImageRequest, PathRequest, WorldRequest
from tiegraph.sfm.tuning import Tuning as SfmTuning

COURSE = Course("canal", distance_m=8, length_m=30, width_m=20, height_m=8, base_m=2, row_m=3, passes=2)
SIDEWAYS = replace(COURSE, shape="facade", passes=1, height_m=4)


def camera(name: str = "cam0", shift: float = 0.0) -> MountedCamera:
    pose = np.eye(4)
    pose[0, 3] = -shift
    made = pycolmap.Camera(model="PINHOLE", width=1200, height=900, params=[900, 900, 610, 440])
    made.has_prior_focal_length = True
    return MountedCamera(name, made, pose)


def propagated(model: pycolmap.Reconstruction, calibrated: bool) -> Shape:
    """Calibrated cameras in a fixed rig."""
    return _propagate(
        model, calibrated, rigged=Rigged([], held=(1, 2), fixed=True), calibration_px=0.0, tuning=SfmTuning()
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_frames_look_at_the_surface_and_are_a_base_apart(shape):
    """Body axes are a rotation; from a frame the middle of the view, or for ways along it a side, meets a facet."""
    path = make_path(replace(COURSE, shape=shape))
    turns = path.world_from_body[:, :3, :3]
    assert np.allclose(turns @ np.swapaxes(turns, 1, 2), np.eye(3))
    assert np.allclose(np.linalg.det(turns), 1)
    step = np.linalg.norm(np.diff(path.centres, axis=0), axis=1)[np.diff(path.leg) == 0]
    expected = 2.0 * (10 + 8) / 10 if shape == "orbit" else 2.0
    assert np.all(step <= expected + 1e-9) and np.all(step > 0.9 * expected)
    beyond = shape in ("canal", "road", "corridor", "tunnel")
    view = path.world_from_body[len(path) // 2 - 1]
    away = view[:3, 0] if beyond else view[:3, 2]
    far, normal = _hit(view[:3, 3], away[None], path.surface)
    assert 0.6 * 8 < far[0] < 1.4 * 8
    assert normal[0] @ away < -0.9


def test_a_canal_is_gone_out_and_back_on_the_right():
    path = make_path(COURSE)
    out, back = (path.centres[path.leg == k] for k in (0, 1))
    assert path.legs == ("pass 1 out", "pass 2 back")
    assert np.allclose(out[:, 1], -1.2) and np.allclose(back[:, 1], 1.2)
    assert np.allclose(out[:, 0], back[::-1, 0] - (30 - out[-1, 0]))
    assert np.allclose(path.world_from_body[path.leg == 1][:, :3, 2], [-1, 0, 0])


def test_yaw_turns_to_the_right_and_pitch_up():
    path = make_path(replace(COURSE, turned_deg=(90.0, 0.0)))
    assert np.allclose(path.world_from_body[0, :3, 2], [0, -1, 0])
    path = make_path(replace(COURSE, turned_deg=(0.0, 30.0)))
    assert path.world_from_body[0, 2, 2] == pytest.approx(0.5)


def test_an_orbit_that_looks_down_stands_higher_round_the_same_middle_and_sees_the_ground():
    level, down = (make_path(replace(COURSE, shape="orbit", turned_deg=(0.0, p))) for p in (0.0, -30.0))
    middle = level.centres[level.leg == 0].mean(axis=0)
    for path in (level, down):
        view = path.world_from_body[path.leg == 0]
        far = np.linalg.norm(view[:, :3, 3] - middle, axis=1)
        assert np.allclose(view[:, :3, 3] + far[:, None] * view[:, :3, 2], middle) and np.ptp(far) < 1e-9
    assert np.allclose(down.centres[0, 2] - level.centres[0, 2], np.linalg.norm(level.centres[0] - middle) / 2)
    far, normal = _hit(level.centres[0], np.array([[0.0, 0.0, -1.0]]), level.surface)
    assert far[0] == pytest.approx(level.centres[0, 2]) and normal[0] == pytest.approx([0, 0, 1])


def network(course: Course = SIDEWAYS, most: int = 800, tie_px: float = 0.2) -> tuple[Path, Network]:
    path = make_path(course)
    with patch("tiegraph.plan.network._MOST_POINTS", most):
        return path, make_network(path, [camera(), camera("cam1", 0.5)], WorldRequest(tie_px=tie_px), 0.4)


@pytest.mark.slow
def test_the_network_is_what_the_cameras_see():
    path, made = network()
    model = made.model
    assert model.num_reg_images() == 2 * len(path)
    for key in list(model.point3D_ids())[:100]:
        point = model.point3D(key)
        rays = []
        for element in point.track.elements:
            image = model.image(element.image_id)
            seen = image.points2D[element.point2D_idx].xy
            off = image.camera.img_from_cam(image.cam_from_world() * point.xyz) - seen
            assert np.all(np.abs(off) < 6 * 0.2) and np.all((seen > -2) & (seen < [1202, 902]))
            rays.append((point.xyz - image.projection_center()) / np.linalg.norm(point.xyz - image.projection_center()))
        assert np.degrees(np.arccos(np.min(np.array(rays) @ np.array(rays).T))) > 0.9
    assert 3 < made.figures()["track_length"] < 15
    assert 0 < made.share <= 1


@pytest.mark.slow
def test_sigmas_follow_the_noise_and_not_the_number_simulated():
    """Twice the noise, twice the sigma; half the points of so much smaller errors, the same sigma. Symmetric paths have
    symmetric sigmas."""

    def plan(tie_px: float, most: int) -> PathPlan:
        path = make_path(SIDEWAYS)
        world = WorldRequest(tie_px=tie_px)
        with patch("tiegraph.plan.network._MOST_POINTS", most):
            return plan_path(path, [camera(), camera("cam1", 0.5)], propagated, world, 0.4)

    few, twice, many = plan(0.15, 1500), plan(0.3, 1500), plan(0.15, 3000)
    middle = np.median(few.expected.shape)
    assert 1.8 < np.median(twice.expected.shape) / middle < 2.2
    assert 0.85 < np.median(many.expected.shape) / middle < 1.15
    assert 0.8 < np.median(many.expected.point_shape) / np.median(few.expected.point_shape) < 1.25
    row = few.expected.shape[few.path.leg == 0]
    first, last = row[: len(row) // 2].mean(), row[(len(row) + 1) // 2 :].mean()
    assert 0.6 < first / last < 1.6
    assert few.advice == (
        "nothing places the path in the world: with --gnss or --control its accuracy there is worked out, too",
    )
    # The points that two cameras 0.5 m apart and their neighbours see: no worse than the widest pair of rays allows.
    gsd = 8 / 900
    assert 0.2 * 0.15 * gsd < np.median(few.expected.point_shape) < 8 * 0.15 * gsd * 8 / 2


def shape_of(count: int, sigma: float = 0.0, walk: float = 0.0, scale: float | None = 1e-9) -> Shape:
    """Positions of independent errors, and of errors that add up along the way."""
    one = sigma**2 * np.eye(count) + walk**2 * np.minimum.outer(np.arange(count), np.arange(count))
    return Shape(np.arange(count), np.kron(one, np.eye(3)), scale, 0.2, np.zeros(0, int), np.zeros((0, 3)))


def row(count: int) -> np.ndarray:
    return np.column_stack([np.arange(count), np.zeros((count, 2))]).astype(float)


def fixes(centres: np.ndarray, rows: range | list[int], sigma: float) -> tuple[Fix, ...]:
    return tuple(Fix(k, centres[k], np.full(3, sigma)) for k in rows)


def test_a_rigid_path_is_placed_as_a_line_is_fitted():
    """Shift and turn of n positions of sigma s: s / sqrt(n) in the middle, and by the line's ends 2 s / sqrt(n)."""
    centres, count = row(101), 101
    known = Known(fixes(centres, range(count), 0.02), np.zeros(3), 1.0)
    world, _ = _world(shape_of(count), centres, np.zeros((0, 3)), known)
    assert world[50] == pytest.approx(np.full(3, 0.02 / np.sqrt(count)), rel=0.01)
    assert world[0, 1:] == pytest.approx(np.full(2, 2 * 0.02 / np.sqrt(count)), rel=0.03)
    assert world[0, 0] == pytest.approx(0.02 / np.sqrt(count), rel=0.01)  # the rig holds the scale
    common, _ = _world(shape_of(count), centres, np.zeros((0, 3)), replace(known, common=np.array([0.02, 0.02, 0.03])))
    assert common**2 - world**2 == pytest.approx(np.tile([0.02**2, 0.02**2, 0.03**2], (count, 1)))


def test_the_world_is_that_of_least_squares():
    """Against the normal equations of an unknown similarity with a loose prior, for errors that add up."""
    rng, count = np.random.default_rng(1), 12
    centres = row(count) + rng.normal(0, 2, (count, 3))
    shape = shape_of(count, 0.01, 0.02, scale=None)
    some = fixes(centres, [0, 3, 4, 9], 0.03)
    world, _ = _world(shape, centres, np.zeros((0, 3)), Known(some, np.zeros(3), None))
    shift = np.tile(np.eye(3), (count, 1, 1))
    moved = np.concatenate([-skew(centres), shift, centres[:, :, None]], axis=2).reshape(-1, 7)
    whole = shape.covariance + 1e2 * moved @ moved.T
    rows = (3 * np.array([0, 3, 4, 9])[:, None] + np.arange(3)).ravel()
    gain = whole[:, rows] @ np.linalg.inv(whole[np.ix_(rows, rows)] + 0.03**2 * np.eye(12))
    assert world.ravel() == pytest.approx(np.sqrt(np.diag(whole - gain @ whole[rows])), rel=0.01)


def test_an_outage_is_where_errors_grow_and_a_point_in_it_stops_them():
    centres, count = row(60), 60
    shape = shape_of(count, 0.001, 0.02)
    open_sky = [k for k in range(count) if not 20 <= k <= 45]
    known = Known(fixes(centres, open_sky, 0.02), np.zeros(3), 1.0)
    world = np.linalg.norm(_world(shape, centres, np.zeros((0, 3)), known)[0], axis=1)
    assert 30 <= np.argmax(world) <= 36 and world[33] > 2 * world[5]
    held = replace(known, fixes=(*known.fixes, *fixes(centres, [33], 0.005)))
    mended = np.linalg.norm(_world(shape, centres, np.zeros((0, 3)), held)[0], axis=1)
    assert mended[33] < 0.3 * world[33] and np.all(mended <= world + 1e-12)


def test_waypoints_on_the_earth_keep_lengths_and_heading():
    anchor = read_anchor("35.6965,139.7695,40", 30.0)
    geodetic, grid = anchor.coordinates(np.array([[0, 0, 0], [100, 0, 0], [0, 50, 2.0]]))
    forward, _, far = pyproj.Geod(ellps="WGS84").inv(*geodetic[0, [1, 0]], *geodetic[1, [1, 0]])
    assert forward == pytest.approx(30.0, abs=0.001) and far == pytest.approx(100 * 6371 / 6371.04, abs=0.002)
    left, _, _ = pyproj.Geod(ellps="WGS84").inv(*geodetic[0, [1, 0]], *geodetic[2, [1, 0]])
    assert left == pytest.approx(-60.0, abs=0.001) and geodetic[2, 2] == pytest.approx(42.0, abs=0.01)
    assert 99.9 < np.linalg.norm(grid[1, :2] - grid[0, :2]) < 100.1


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: make_path(replace(COURSE, shape="canl")), "canal"),
        (lambda: make_path(replace(COURSE, passes=1, length_m=1)), "1 frame"),
        (lambda: network(replace(COURSE, base_m=0.01)), "1500"),
        (lambda: network(replace(COURSE, turned_deg=(0, 90))), "see past it"),
        (lambda: WorldRequest(gnss="0,0.02").positions(), "--gnss 0"),
        (lambda: WorldRequest(gnss="0.02", outage=("5-3",)).positions(), "--outage 5-3"),
        (lambda: read_anchor("91,3", 0.0), "--origin 91,3"),
        (lambda: read_anchor("here", 0.0), "LAT,LON"),
    ],
)  # fmt: skip
def test_what_makes_no_path_is_refused_by_name(make, said):
    with pytest.raises((InputError, SettingsError), match=said):
        make()


OUT_OF_RANGE = {
    CameraRequest: {"focal": 0.0, "pixel": -1.0, "sensor": 0.0, "focal_px": np.nan, "calibration_px": -0.1},
    ImageRequest: {"sidelap": 1.0, "precision": 0.0, "match_px": 0.0, "speed": -1.0, "rate": 0.0, "exposure": 0.0},
    PathRequest: {"length": -1.0, "width": 0.0, "height": np.inf, "relief": -1.0},
    WorldRequest: {"control": -1, "control_sigma": 0.0, "tie_px": 0.0, "ties": 0.0},
}


def test_a_value_out_of_range_is_refused_by_name():
    for kind, values in OUT_OF_RANGE.items():
        for name, value in values.items():
            with pytest.raises(ValidationError, match=name):
                kind(**{name: value})


LENS = Lens(8 / 0.00345, (2448, 2048))  # paper 004: 8 mm, 3.45 um, 5 MP


@pytest.mark.parametrize(
    "distance, precision_mm, points, footprint_cm",
    [
        (0.5, 0.431, 21.5, (45, 36)),
        (0.7, 0.845, 11.0, (65, 53)),
        (1.0, 1.725, 5.4, (98, 81)),
        (1.2, 2.484, 3.7, (119, 98)),
    ],
)
def test_table_1_of_paper_004(distance, precision_mm, points, footprint_cm):
    made = station(LENS, distance, Wanted(base_m=0.075, match_px=0.3))
    assert round(1000 * made.precision_m[0], 3) == precision_mm
    assert round(made.points_mm2, 1) == points
    # The paper's footprint is what all four cameras of the square see; its 65 cm should be 66.
    common = [100 * (side - 0.075) for side in made.footprint_m]
    assert common == pytest.approx(footprint_cm, abs=1.5)


@pytest.mark.parametrize("rays", [2, 3, 5])
def test_precision_by_rays_is_that_of_least_squares(rays):
    """Rays in a row to a point far away: the normal equations say the same as the closed form."""
    made = station(LENS, 1.0, Wanted(base_m=0.05, match_px=0.3))
    model = row_of_cameras(rays, 0.05, 1.0)
    depth = math.sqrt(own_variance(model, np.array([1]))[0, 2]) * 0.3 / math.sqrt(2)  # a disparity is of two images
    assert 0.97 < depth / made.precision_m[rays - 2] < 1.03
    assert made.precision_m[rays - 2] == pytest.approx(made.precision_m[0] * rays_gain(rays))


def row_of_cameras(count: int, base: float, distance: float) -> pycolmap.Reconstruction:
    """Cameras side by side that see one point before their middle."""
    model = pycolmap.Reconstruction()
    params = [LENS.focal_px, LENS.focal_px, 1224, 1024]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=2448, height=2048, params=params, camera_id=1)
    )
    point = np.array([(count - 1) / 2 * base, 0, distance])
    for k in range(count):
        pose = pycolmap.Rigid3d(np.column_stack([np.eye(3), [-k * base, 0, 0]]))
        xy = model.camera(1).img_from_cam(pose * point)
        image = pycolmap.Image(name=str(k), camera_id=1, image_id=k + 1, keypoints=np.atleast_2d(xy))
        model.add_image_with_trivial_frame(image, pose)
    model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, 0) for k in range(count)]))
    return model


def test_the_base_comes_from_what_is_said_first():
    both = {"overlap": 0.8, "speed_m_s": 2.0, "rate_hz": 4.0}
    assert station(LENS, 5.0, Wanted(base_m=0.3, **both)).base_m == 0.3
    assert station(LENS, 5.0, Wanted(**both)).base_m == 0.5
    made = station(LENS, 5.0, Wanted(overlap=0.8))
    assert made.base_m == pytest.approx(0.2 * 5.0 / LENS.focal_px * 2448)
    assert made.overlap == pytest.approx(0.8)
    upright = station(Lens(LENS.focal_px, LENS.size, along=1), 5.0, Wanted(overlap=0.8))
    assert upright.base_m == pytest.approx(0.2 * 5.0 / LENS.focal_px * 2048)


def test_motion_blur_and_the_exposure_that_avoids_it():
    made = station(LENS, 2.0, Wanted(speed_m_s=1.5, rate_hz=10.0, exposure_s=0.002))
    assert made.blur_px == pytest.approx(1.5 * 0.002 / made.gsd_m)
    assert made.exposure_s == pytest.approx(0.5 * made.gsd_m / 1.5)
    longest = Wanted(speed_m_s=1.5, rate_hz=10.0, exposure_s=made.exposure_s)
    assert station(LENS, 2.0, longest).blur_px == pytest.approx(0.5)


def test_what_is_advised_gives_what_is_wanted():
    wanted = Wanted(overlap=0.9, precision_m=0.002, speed_m_s=2.0, rate_hz=2.0, exposure_s=0.01)
    made = station(LENS, 5.0, wanted)
    said = advice(made, LENS, wanted)
    assert len(said) == 3
    base = float(said[0].split("a base of ")[1].split(" m")[0])
    better = station(LENS, 5.0, Wanted(base_m=base, precision_m=0.002))
    assert 0.99 < better.precision_m[0] / 0.002 < 1.01
    nearer = station(LENS, made.farthest_m, wanted)
    assert nearer.precision_m[0] == pytest.approx(0.002)
    speed = float(said[1].split("go ")[1].split(" m/s")[0])
    assert station(LENS, 5.0, Wanted(speed_m_s=speed, rate_hz=2.0)).overlap == pytest.approx(0.9, abs=0.002)
    assert "expose" in said[2]
    assert not advice(better, LENS, Wanted(base_m=base, precision_m=0.00201))


def test_images_too_far_apart_are_said_to_show_nothing():
    made = station(LENS, 1.0, Wanted(base_m=5.0))
    assert made.overlap == 0 and made.precision_m == ()
    assert "do not overlap" in advice(made, LENS, Wanted(base_m=5.0))[0]


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: CameraRequest(focal=8.0).focal_length_px(), "--pixel too"),
        (lambda: CameraRequest(focal=8.0, focal_px=100.0).focal_length_px(), "say the same"),
        (lambda: CameraRequest(focal=8.0, pixel=3.0, sensor=7.0).focal_length_px(), "say the same"),
        (lambda: CameraRequest(size="0x5").image_size(), "--size 0x5"),
        (lambda: CameraRequest(size="large").image_size(), "2448x2050"),
        (lambda: Wanted(overlap=1.0), "--overlap 1"),
        (lambda: Wanted(overlap=-0.1), "--overlap -0.1"),
        (lambda: Wanted(base_m=float("nan")), "--base nan"),
        (lambda: Wanted(speed_m_s=2.0), "without --rate"),
        (lambda: Wanted(rate_hz=2.0), "without --speed"),
        (lambda: Wanted(exposure_s=0.001), "without --speed"),
        (lambda: station(LENS, -1.0, Wanted(overlap=0.8)), "--distance -1"),
        (lambda: station(LENS, 1.0, Wanted()), "--overlap, --base"),
        (lambda: ImageRequest().distances(), "--distance"),
        (lambda: ImageRequest(distance="1,x").distances(), "--distance 1,x"),
    ],
)
def test_what_makes_no_survey_is_refused_by_name(make, said):
    with refused(said):
        make()


def test_the_focal_length_by_pitch_or_by_sensor():
    by_pitch = CameraRequest(focal=8.0, pixel=3.45, size="2448x2048").focal_length_px()
    by_sensor = CameraRequest(focal=8.0, sensor=2448 * 0.00345, size="2448x2048").focal_length_px()
    assert by_pitch == pytest.approx(LENS.focal_px) == pytest.approx(by_sensor)
