"""Shots of a calibrated rig: partners and depths without a sparse model, the unit they tell, images on a rig."""

import cv2
import numpy as np
import pycolmap
import pytest

from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.plan import EPIPOLE, ONE_CENTRE, CameraModel, DepthRange, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.shot import NO_OVERLAP, Seen, depth_range, in_camera, plan_hanging, plan_shot, shot_scale
from tiegraph.dense.tuning import Tuning
from tiegraph.errors import InputError
from tiegraph.geometry.transforms import apply, invert, rigid
from tiegraph.scene.composed import with_hanging
from tiegraph.scene.results import DepthMap
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene

SETTINGS = DenseSettings()
TUNING = Tuning()
CAMERA = CameraModel("PINHOLE", 320, 240, (300.0, 300.0, 160.0, 120.0))
RANGE = DepthRange(0.5, 1.2)


def view(name, position, rotation=None):
    rotation = np.eye(3) if rotation is None else rotation
    return ViewPlan(name, CAMERA, rigid(rotation, -rotation @ np.asarray(position, float)))


SQUARE = [view(f"{k}.png", (0.075 * x, 0.075 * y, 0)) for k, (x, y) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1)))]


def wave(x, y):
    return 0.7 + 0.02 * np.sin(20 * x + 5 * y) + 0.01 * np.sin(31 * y)


def photograph(folder, plan, seed=0):
    """Image and depth of a textured relief in front of a camera that looks along z."""
    position = -plan.cam_from_world[:3, 3]
    u, v = np.meshgrid(np.arange(320) + 0.5, np.arange(240) + 0.5)
    rx, ry = (u - 160) / 300, (v - 120) / 300
    z = np.full(u.shape, 0.7)
    for _ in range(20):
        z = wave(position[0] + rx * z, position[1] + ry * z)
    rng = np.random.default_rng(7)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (900, 900)).astype(np.float32), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
    at = [((p + r * z + 0.6) / 0.0015).astype(np.float32) for p, r in zip(position[:2], (rx, ry), strict=True)]
    image = cv2.remap(texture, at[0], at[1], cv2.INTER_CUBIC) + np.random.default_rng(seed).normal(0, 1.5, z.shape)
    cv2.imwrite(str(folder / plan.name), np.clip(image, 0, 255).astype(np.uint8))
    return z


@pytest.mark.slow
def test_a_shot_gives_depths_with_their_sigma(tmp_path):
    truth = {v.name: photograph(tmp_path, v, k) for k, v in enumerate(SQUARE)}
    plan = plan_shot(SQUARE, RANGE, SETTINGS, TUNING)
    assert set(plan.images) == set(truth) and not plan.dropped
    assert all(len(p.partners) == 3 for p in plan.images.values())
    first = {n: depth_map(p, tmp_path, None, SETTINGS, TUNING) for n, p in plan.images.items()}
    depth, _ = confirmed_map(plan.images["0.png"], first["0.png"], first.get, SETTINGS, TUNING)
    known = np.isfinite(depth.depth_m)
    assert known.mean() > 0.75
    error = np.abs(depth.depth_m - truth["0.png"])[known]
    actual = 1.4826 * np.median(error)
    assert 0.0001 < actual < 0.7**2 / (300 * 0.075) * 0.25  # a quarter of a pixel of one pair
    assert 0.5 < np.median(depth.sigma_m[known]) / actual < 2 and np.mean(error > 0.02) < 0.01


def test_the_range_follows_from_the_rig_where_none_is_given():
    found = depth_range(SQUARE, None, None)
    assert found.near == pytest.approx(5 * 0.075 * np.sqrt(2)) and found.far == pytest.approx(20 * found.near)
    assert depth_range(SQUARE, 0.5, None).near == 0.5


@pytest.mark.parametrize("near, far", [(-1.0, 2.0), (2.0, 1.0), (0.0, 1.0), (np.nan, 2.0), (1.0, np.inf)])
def test_a_range_that_is_none_is_refused(near, far):
    with pytest.raises(InputError, match="near"):
        depth_range(SQUARE, near, far)


def test_cameras_in_one_place_are_refused():
    for views in (SQUARE[:1], [SQUARE[0], view("again.png", (0, 0, 0))]):
        with pytest.raises(InputError, match="two calibrated cameras"):
            depth_range(views, None, None)


BACK = np.diag([-1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    "place, rotation, why",
    [((0.075, 0, 0), BACK, NO_OVERLAP), ((0, 0, 0.2), None, EPIPOLE), ((0.001, 0, 0), None, ONE_CENTRE)],
)
def test_no_pair_to_match_says_why(place, rotation, why):
    with pytest.raises(InputError, match=why.split(":")[0]):
        plan_shot([SQUARE[0], view("b.png", place, rotation)], RANGE, SETTINGS, TUNING)


LENS = np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]])
UNIT = 0.37  # metres


def wavy(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.6 + 0.3 * x + 0.02 * np.sin(40 * y)


def depth_of(camera: np.ndarray, noise: float = 0.0) -> DepthMap:
    """Depth of the surface from a camera shifted in x, y, by fixed point."""
    u, v = np.meshgrid((np.arange(320) + 0.5 - 160) / 400, (np.arange(240) + 0.5 - 120) / 400)
    place = invert(camera)[:3, 3]
    z = np.full(u.shape, 0.6)
    for _ in range(12):
        z = wavy(place[0] + u * z, place[1] + v * z)
    z = z + noise * np.random.default_rng(1).normal(size=z.shape)
    z[:, :40] = np.nan
    return DepthMap("a", z.astype(np.float32), z, np.ones(z.shape, np.uint8), LENS, camera)


def observed(shot: int, far: int = 300, noise: float = 3e-4) -> Seen:
    """Points of the surface in a wide camera, and more behind it that no depth map has."""
    rng = np.random.default_rng(shot)
    rig_from_wide = rigid(np.eye(3), np.array([0.04, 0.07, -0.005]))
    x, y = rng.uniform(-0.2, 0.2, (2, 300))
    points = np.column_stack([x, y, wavy(x, y)])
    behind = rng.uniform((-1, -1, 1.5), (1, 1, 3), (far, 3))
    depth = depth_of(rigid(np.eye(3), np.array([-0.05, 0.0, 0])), noise)
    return Seen(shot, apply(invert(rig_from_wide), np.concatenate([points, behind])) / UNIT, rig_from_wide, depth)


@pytest.mark.slow
def test_points_on_the_surface_tell_the_unit():
    found = shot_scale([observed(0), observed(1), observed(2)])
    assert found.shots == 3 and 450 < found.points < 900  # not those that fall outside, or where the map has no depth
    assert 0 < abs(found.metres_per_unit / UNIT - 1) < 4e-4 and 0 < found.sigma < 3e-4
    each = observed(0).scales(UNIT * 1.01)
    np.testing.assert_allclose(each[np.isfinite(each)], UNIT, rtol=0.05)


def test_points_that_lie_on_no_map_or_behind_the_camera_tell_nothing():
    one = observed(0)
    off = Seen(0, one.points[300:], one.rig_from_camera, one.depth)
    assert shot_scale([off]) is None
    few = Seen(0, one.points[:9], one.rig_from_camera, one.depth)
    assert shot_scale([few]) is None and shot_scale([]) is None
    local = in_camera(np.eye(4), np.array([[0.0, 0, 1], [0, 0, -1]]))
    np.testing.assert_array_equal(local, [[0, 0, 1]])


PLACES = {"wide": 0.0, "a": -0.04, "b": 0.04}  # m to the right


def lens() -> pycolmap.Camera:
    camera = pycolmap.Camera(model="PINHOLE", width=200, height=160, params=[180, 180, 100, 80], camera_id=1)
    camera.has_prior_focal_length = True
    return camera


def hung(points: int, frames: int = 2) -> pycolmap.Reconstruction:
    """A wide camera that sees points 0.5 to 1 m away, and two that hang on it."""
    sensors = [
        Sensor(
            name, lens(), rigid(np.eye(3), np.array([-x, 0, 0])), role="wide" if name == "wide" else "side", folder=name
        )
        for name, x in PLACES.items()
    ]
    rows = sorted((f"{s}/{f}.png", f, k) for k, s in enumerate(PLACES) for f in range(frames))
    names, frame, sensor = zip(*rows)
    scene = simple_scene(Rig("head", tuple(sensors)), list(names), np.array(frame), np.array(sensor))
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens())
    for k in range(frames):
        image = pycolmap.Image(name=f"wide/{k}.png", camera_id=1, image_id=k + 1, keypoints=np.ones((points, 2)))
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.eye(4)[:3]))
    for row, depth in enumerate(np.linspace(0.5, 1, points)):
        track = pycolmap.Track([pycolmap.TrackElement(k + 1, row) for k in range(frames)])
        model.add_point3D(np.array([0, 0, depth]), track)
    return with_hanging(model, scene)


def test_partners_are_those_of_the_frame():
    names = {"a/0.png", "a/1.png", "b/0.png", "b/1.png"}
    plan = plan_hanging(hung(20), names, DenseSettings(), Tuning())
    assert set(plan.images) == names and plan.dropped == ()
    one = plan.images["a/1.png"]
    assert [p.name for p in one.partners] == ["b/1.png"] == list(one.witnesses)
    assert 0.2 < one.depth_range.near < 0.5 and 1 < one.depth_range.far < 1.5


def test_a_frame_that_sees_too_little_is_left_out_with_the_reason():
    plan = plan_hanging(hung(3), {"a/0.png", "b/0.png"}, DenseSettings(), Tuning())
    assert not plan.images and [n for n, _ in plan.dropped] == ["a/0.png", "b/0.png"]
    assert "see 3 points: too few" in plan.dropped[0][1]
