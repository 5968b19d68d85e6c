"""Pairs from prior poses: distance, axes, line of sight, baseline, gaps; shared visible surface with exact truth."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from boat_world import Result, World, boat, found, ring
from network_steps import context_of, network_of, without_features
from tiegraph.geometry import transforms
from tiegraph.network.candidates import Candidates, find_candidates
from tiegraph.network.coarse import proxy as proxies
from tiegraph.network.coarse import visible
from tiegraph.network.coarse.proxy import Proxy, assumed_proxy, observed_proxy
from tiegraph.network.coarse.visible import Overlap, pair_share, shared_surface
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.posecheck import PriorCheck, check_prior, checked_pose_pairs
from tiegraph.network.poses import PoseResult, assumed_range, pose_pairs, view_cameras
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS = CandidatesSettings(sources=("poses",), range_m=12.0, axes_deg=80)
TUNING = Tuning()


def with_priors(world: World, rotation: bool = True) -> Scene:
    scene = world.scene
    reference = np.flatnonzero(scene.sensor == 0)
    poses = np.empty((scene.frames, 4, 4))
    poses[scene.frame[reference]] = world.world_from_sensor[reference]
    if not rotation:
        poses[:, :3, :3] = np.nan
    sigma = np.full((scene.frames, 3), 0.002)
    return scene.with_(world_from_rig=poses, position_sigma_m=sigma, prior="trajectory" if rotation else "gnss")


def paired(scene: Scene, settings: CandidatesSettings = SETTINGS) -> PoseResult:
    return pose_pairs(scene, find_passes(scene), settings, TUNING)


@pytest.mark.slow
def test_full_poses_find_what_overlaps() -> None:
    world = boat((10, 10), (2.0, 2.0))
    result = paired(with_priors(world))
    share, precision = found(result.pairs, world.useful())
    assert share > 0.93 and 0.6 < precision < 1
    reasons = result.pairs.funnel()
    assert reasons["axes"] > 0 and reasons["sight"] > 0 and reasons["overlap"] > 0
    assert (result.pairs.kept().angle_deg <= 80.001).all() and not len(result.without)


@pytest.mark.slow
def test_positions_alone_take_the_heading_from_the_track() -> None:
    world = boat((10, 10), (2.0, 2.0))
    result = paired(with_priors(world, rotation=False))
    share, precision = found(result.pairs, world.useful())
    assert share > 0.85 and precision > 0.2
    assert any("heading of 20 frames" in note for note in result.notes)
    angles = result.pairs.angle_deg
    assert np.isfinite(angles).mean() > 0.9


@pytest.mark.slow
def test_frames_without_prior_fall_back_on_previews() -> None:
    world = boat((10, 10), (2.0, 2.0))
    scene = with_priors(world)
    poses = scene.world_from_rig.copy()
    poses[5:8] = np.nan
    world.scene = scene.with_(world_from_rig=poses)
    network = network_of(world.scene, world.match, SETTINGS)
    lost = np.isin(scene.frame, range(5, 8))
    assert (network.pairs.degree(len(scene))[lost] > 0).all()
    assert found(network.pairs, world.useful())[0] > 0.8
    assert any("3 of 20 frames have no prior position" in note for note in network.notes)


@pytest.mark.slow
def test_beyond_some_ranges_nothing_is_shared() -> None:
    """And a prior that is not sure enough does not refuse."""
    scene = with_priors(boat((10,), (2.0,)))
    near = CandidatesSettings(sources=("poses",), range_m=3.5, axes_deg=80)
    pairs = paired(scene, near).pairs
    far = pairs.dropped == REASONS.index("distance")
    assert TUNING.poses.far_ranges == 2.0  # frames stand every 2 m
    assert (pairs.baseline_m[~far].max(), pairs.baseline_m[far].min()) == (6.0, 8.0)
    unsure = scene.with_(position_sigma_m=np.full((scene.frames, 3), 4.0))
    assert "distance" not in paired(unsure, near).pairs.funnel()


@pytest.mark.slow
def test_odometry_of_two_passes_is_never_compared() -> None:
    scene = with_priors(boat((10, 10), (2.0, 2.0))).with_(prior="odometry")
    pairs = paired(scene).pairs
    track = scene.sequence[scene.frame]
    assert len(pairs) and (track[pairs.i] == track[pairs.j]).all()


@pytest.fixture(scope="module")
def two_passes() -> World:
    return boat((10, 10), (2.0, 2.0))


def candidates_of(scene: Scene, match: Callable) -> Candidates:
    return find_candidates(scene, MatchCache(match, len(scene)), SETTINGS, TUNING, without_features(scene))


def _across(scene: Scene, pairs: Pairs) -> int:
    track = scene.sequence[scene.frame]
    return int(np.sum(track[pairs.i] != track[pairs.j]))


@pytest.mark.slow
def test_passes_with_odometry_of_their_own_are_tied_by_previews(two_passes: World) -> None:
    scene = with_priors(two_passes).with_(prior="odometry")
    candidates = candidates_of(scene, two_passes.match)
    share, precision = found(candidates.pairs, two_passes.useful())
    assert 0.9 < share < 1 and 0.7 < precision < 1
    assert 500 < _across(scene, candidates.pairs.kept()) < 2000
    assert any("2 passes have poses in separate worlds" in note for note in candidates.notes)


@pytest.mark.slow
def test_passes_that_nothing_ties_are_said(two_passes: World) -> None:
    """Previews that find nothing between the passes: not silence, but a sentence."""
    scene = with_priors(two_passes).with_(prior="odometry")
    track = scene.sequence[scene.frame]

    def blind(pairs: np.ndarray) -> list[Result]:
        same = track[pairs[:, 0]] == track[pairs[:, 1]]
        return [m if s else Result(inliers=0) for m, s in zip(two_passes.match(pairs), same)]

    candidates = candidates_of(scene, blind)
    assert _across(scene, candidates.pairs.kept()) == 0
    assert any("nothing ties them, so they can only form" in note for note in candidates.notes)


MOVED = {
    "far away": (np.zeros(3), (500.0, 0.0, 0.0)),
    "turned and far away": (np.array([0.0, 0.0, np.pi]), (300.0, 50.0, 0.0)),
    "laid over the other": (np.array([0.0, 0.0, np.pi]), (18.0, 0.0, 0.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [None, *MOVED])
def test_a_trajectory_of_each_pass_in_a_frame_that_nothing_tells(name: str | None, two_passes: World) -> None:
    """They do not start at the same pose, so that only the images can tell that they are not in one world."""
    scene = with_priors(two_passes)
    turn, shift = MOVED[name] if name else (np.zeros(3), (0.0, 0.0, 0.0))
    moved = transforms.rigid(Rotation.from_rotvec(turn).as_matrix(), np.array(shift))
    poses = np.array(scene.world_from_rig)
    second = scene.sequence == 1
    poses[second] = moved @ poses[second]
    scene = scene.with_(world_from_rig=poses)
    candidates = candidates_of(scene, two_passes.match)
    share, precision = found(candidates.pairs, two_passes.useful())
    assert 0.9 < share < 1 and 0.6 < precision < 1
    assert any("are not in one world" in note for note in candidates.notes) == (name is not None)
    assert candidates.scene.prior == ("odometry" if name else "trajectory")
    assert candidates.scene.measured_positions().any() == (name is None)
    if name:  # what the poses know of their own pass is kept
        track = scene.sequence[scene.frame]
        same = track[candidates.pairs.i] == track[candidates.pairs.j]
        assert {"sight", "overlap"} <= set(candidates.pairs.where(same).funnel())


@pytest.mark.slow
def test_too_short_a_base_of_one_camera_is_dropped() -> None:
    scene = with_priors(boat((10,), (2.0,)))
    poses = scene.world_from_rig.copy()
    poses[4] = poses[3]
    pairs = paired(scene.with_(world_from_rig=poses)).pairs
    dropped = pairs.where(pairs.dropped == REASONS.index("baseline"))
    assert len(dropped) == 6 and set(scene.frame[dropped.i]) | set(scene.frame[dropped.j]) == {3, 4}


def test_drone_photographs_take_their_nearest() -> None:
    rng = np.random.default_rng(3)
    count = 200
    where = np.column_stack([rng.uniform(0, 300, (count, 2)), rng.normal(80, 2, count)])
    poses = transforms.rigid(np.full((count, 3, 3), np.nan), where)
    rig = Rig("camera", (Sensor("camera"),))
    scene = simple_scene(rig, [f"{k}.jpg" for k in range(count)], np.arange(count), np.zeros(count), prior="exif")
    scene = scene.with_(world_from_rig=poses, position_sigma_m=np.full((count, 3), 3.0))
    pairs = pose_pairs(scene, (), CandidatesSettings(sources=("poses",)), TUNING).pairs.kept()
    distance = np.linalg.norm(where[pairs.i] - where[pairs.j], axis=1)
    assert (pairs.degree(count) >= 20).all() and len(pairs) < 0.3 * count * count / 2
    assert np.allclose(distance, pairs.baseline_m, rtol=1e-4)


def test_no_prior_at_all_is_said() -> None:
    result = paired(boat((4,), (2.0,)).scene)
    assert len(result.pairs) == 0 and len(result.without) == 4 and "fewer than two" in result.notes[0]


def test_a_vehicle_that_mostly_stands_is_given_the_range_of_its_drive() -> None:
    """And positions that a telephone wrote into several photographs are one place."""
    world = boat((10,), (2.0,))
    scene, passes = with_priors(world), find_passes(world.scene)
    steady = assumed_range(scene, passes, TUNING.poses)
    assert steady == pytest.approx(20.0, rel=0.05)
    poses = scene.world_from_rig.copy()
    poses[passes[0].frames[:7], :3, 3] = poses[passes[0].frames[6], :3, 3] + np.linspace(0, 0.05, 7)[:, None]
    assert assumed_range(scene.with_(world_from_rig=poses), passes, TUNING.poses) == pytest.approx(steady, rel=0.1)
    scene = with_priors(boat((12,), (2.0,)))
    poses = scene.world_from_rig.copy()
    poses[:, :3, 3] = poses[np.arange(12) // 3 * 3, :3, 3]  # four places, 6 m apart
    assert assumed_range(scene.with_(world_from_rig=poses), (), TUNING.poses) == pytest.approx(60.0, rel=0.05)


@pytest.mark.slow
def test_an_unsure_prior_refuses_little_by_sight() -> None:
    scene = with_priors(boat((8, 8), (2.0, 2.0)))
    sure = paired(scene).pairs
    unsure = paired(scene.with_(position_sigma_m=np.full((16, 3), 4.0))).pairs
    assert sure.funnel()["sight"] > 30
    assert "sight" not in unsure.funnel() and "overlap" not in unsure.funnel()
    assert set(zip(sure.kept().i, sure.kept().j)) <= set(zip(unsure.kept().i, unsure.kept().j))


def test_a_guessed_focal_length_is_widened_to_the_rig() -> None:
    guess = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[768.0, 320.0, 240.0])
    scene = boat((3,), (2.0,)).scene
    rig = scene.rigs[0]

    def focal_lengths(camera: pycolmap.Camera) -> set[float]:
        given = replace(rig, sensors=tuple(replace(s, camera=camera) for s in rig.sensors))
        return {c.mean_focal_length() for c in view_cameras(scene.with_(rigs=(given,)), TUNING.coarse.visible)}

    focal = focal_lengths(guess)
    assert len(focal) <= 2 and max(focal) < 330  # five cameras, 72 degrees apart
    guess.has_prior_focal_length = True
    assert focal_lengths(guess) == {768.0}


ROS = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])  # camera from vehicle axes
WRONG = {
    "as it is": (lambda p: p, ""),
    "inverted": (lambda p: np.linalg.inv(p), "world-to-camera"),
    "vehicle axes": (lambda p: p @ ROS, "x forward"),
    "OpenGL": (lambda p: p @ np.diag([1.0, -1, -1, 1]), "OpenGL"),
    "mirrored": (lambda p: np.where(np.arange(16).reshape(4, 4) == 3, -p, p), "mirrored in x"),
    "late": (lambda p: np.concatenate([_later(p[:12], 5), _later(p[12:], 5)]), "5 frames too early"),
    "shuffled": (lambda p: p[np.random.default_rng(0).permutation(len(p))], ""),
}


def _later(poses: np.ndarray, step: int) -> np.ndarray:
    out = poses[np.minimum(np.arange(len(poses)) + step, len(poses) - 1)].copy()
    out[-step:, :3, 3] += np.arange(1, step + 1)[:, None] * (poses[-1, :3, 3] - poses[-2, :3, 3])
    return out


@pytest.fixture(scope="module")
def canal() -> World:
    return boat((12, 12), (2.0, 2.0))


def asked(world: World, scene: Scene) -> tuple[PriorCheck, MatchCache]:
    """What previews say of the priors of a scene, and those previews."""
    context = context_of(scene, world.match, SETTINGS)
    return check_prior(context, paired(scene)), context.cache


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_prior_is_noticed_and_named(name: str, canal: World) -> None:
    spoil, said = WRONG[name]
    true = with_priors(canal)
    scene = true.with_(world_from_rig=spoil(np.array(true.world_from_rig)))
    check, cache = asked(canal, scene)
    assert len(cache) <= 240 and check.good == (name == "as it is")
    assert said in check.better and bool(said) == bool(check.better)
    assert "prior checked by previews" in check.notes[0]
    sure = any("looks wrong" in note and "once in 1000 surveys" in note for note in check.notes)
    unsure = any("may be wrong" in note and "may be chance" in note for note in check.notes)
    assert sure + unsure == bool(said)
    if name in ("inverted", "late"):  # the others are close to the limit, where the draw of the sample decides
        assert sure == (name == "inverted")
    assert any('axes = "flu"' in note for note in check.notes) == (name == "vehicle axes")
    if name == "as it is":
        assert check.fit > 0.5 and len(check.notes) == 1


@pytest.mark.slow
def test_a_right_prior_of_a_camera_that_looks_ahead_is_believed() -> None:
    # All near frames share nearly all of their pictures: readings that only follow the distance correlate better.
    world = boat((40,), (1.0,), ring(1, up=False))
    check, _ = asked(world, with_priors(world))
    assert check.good and not check.better and check.fit < 0.6


@pytest.mark.slow
def test_a_bad_prior_loses_no_pair(canal: World) -> None:
    true = with_priors(canal)
    poses = np.array(true.world_from_rig)[np.random.default_rng(0).permutation(true.frames)]
    scene = true.with_(world_from_rig=poses)
    checked = checked_pose_pairs(context_of(scene, canal.match, SETTINGS))
    assert len(checked.without) == scene.frames and (checked.pairs.dropped == 0).all()
    assert any("refuses no pair" in note for note in checked.notes)


VISIBLE = Tuning().coarse
CAMERA = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[320.0, 320.0, 240.0])  # 90 x 74 degrees


def points_proxy(points: np.ndarray) -> Proxy:
    """Bare points (P, 3), of which no observer is known."""
    none = np.zeros(0, int)
    reach, towards = np.full(len(points), np.inf), np.zeros((len(points), 3))
    return Proxy(points=points, reach=reach, towards=towards, image=none, point=none)


def look(centres: np.ndarray, yaw_deg: np.ndarray) -> np.ndarray:
    """cam_from_world (N, 4, 4), z up in the world: yaw 0 looks along y, 90 along -x."""
    level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    out = []
    for centre, yaw in zip(centres, yaw_deg):
        rotation = level @ Rotation.from_euler("z", -yaw, degrees=True).as_matrix()
        out.append(transforms.rigid(rotation, -rotation @ centre))
    return np.stack(out)


def wall(count: int = 6000, distance: float = 10.0, width: float = 60.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-5, width - 5, count), np.full(count, distance), rng.uniform(-6, 6, count)])


def observers(points: np.ndarray, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Image and point of every observation by projection alone."""
    local = np.einsum("nab,pb->npa", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    x, y, z = np.moveaxis(local, -1, 0)
    seen = (z > 0) & (np.abs(x) < z) & (np.abs(y) < 0.75 * z)
    return np.nonzero(seen)


def row_of_cameras(count: int = 10, step: float = 4.0) -> np.ndarray:
    return look(np.column_stack([np.arange(count) * step, np.zeros(count), np.zeros(count)]), np.zeros(count))


def shared(poses, proxy, max_angle_deg: float = 90.0, slack_rad: float = 0.0, cameras=None, **changed) -> Overlap:
    visibility, cameras = VISIBLE.visible.model_copy(update=changed), cameras or [CAMERA] * len(poses)
    return shared_surface(poses, cameras, proxy, visibility, max_angle_deg, slack_rad)


def between(found: Overlap, i: int, j: int) -> float:
    return float(found.between(np.array([i]), np.array([j]))[0])


def test_share_of_a_wall_is_that_of_the_geometry() -> None:
    poses, points = row_of_cameras(), wall()
    found = shared(poses, observed_proxy(points, *observers(points, poses), poses))
    # 20 m of wall in view from 10 m; images k * 4 m apart share 1 - k * 0.2 of it
    for k, share in ((1, 0.8), (2, 0.6), (3, 0.4), (4, 0.2)):
        assert between(found, 3, 3 + k) == pytest.approx(share, abs=0.06)
    assert between(found, 0, 9) == 0
    assert (found.i < found.j).all() and len(found) == len(set(zip(found.i, found.j)))


def test_angle_and_scale_of_the_shared_surface() -> None:
    poses = look(np.array([[0.0, 0, 0], [0, -10, 0], [10, 10, 0]]), np.array([0.0, 0, 90]))
    points = np.random.default_rng(0).normal([0, 10, 0], 0.5, (500, 3))
    found = shared(poses, points_proxy(points), max_angle_deg=180)
    pairs = {(a, b): k for k, (a, b) in enumerate(zip(found.i, found.j))}
    assert found.angle_deg[pairs[0, 2]] == pytest.approx(90, abs=3) and found.angle_deg[pairs[0, 1]] < 5
    assert found.scale[pairs[0, 1]] == pytest.approx(0.5, abs=0.03)
    narrow = shared(poses, points_proxy(points), max_angle_deg=60)
    assert (0, 2) not in set(zip(narrow.i, narrow.j))
    assert len(shared(poses, points_proxy(points), max_scale=1.5, max_angle_deg=60)) == 0


def test_a_nearer_wall_hides_the_one_behind() -> None:
    poses = look(np.array([[0.0, 0, 0], [0, 20.5, 0]]), np.array([0.0, 0.0]))
    behind, screen = wall(4000, 30.0), wall(4000, 20.0, seed=1)
    open_ = shared(poses, points_proxy(behind), max_scale=10)
    hidden = shared(poses, points_proxy(np.concatenate([behind, screen])), max_scale=10)
    assert open_.share.max() > 0.9 and len(hidden) == 0


def test_a_wall_is_not_seen_from_behind() -> None:
    front = look(np.array([[0.0, 0, 0], [2, 0, 0], [4, 0, 0]]), np.zeros(3))
    poses = np.concatenate([front, look(np.array([[0.0, 20, 0]]), np.array([180.0]))])
    points = wall(3000, width=10.0) * (1, 1, 0.2)
    found = shared(poses, observed_proxy(points, *observers(points, front), poses), max_angle_deg=180)
    assert set(zip(found.i, found.j)) == {(0, 1), (0, 2), (1, 2)}


def test_images_without_observations_and_without_pose() -> None:
    poses, points = row_of_cameras(), wall()
    image, point = observers(points, poses)
    proxy = observed_proxy(points, image[image != 4], point[image != 4], poses)
    poses[7] = np.nan
    found = shared(poses, proxy)
    assert between(found, 4, 5) > 0.7
    assert not np.isin(7, np.concatenate([found.i, found.j]))


def test_a_cluster_of_points_does_not_stand_for_the_image() -> None:
    poses = row_of_cameras(2, 12.0)
    rng = np.random.default_rng(0)
    cluster = np.column_stack([rng.normal(9.0, 0.3, 1500), np.full(1500, 10.0), rng.normal(0, 0.3, 1500)])
    points = np.concatenate([wall(4000), cluster])
    found = shared(poses, points_proxy(points))
    assert found.share[0] == pytest.approx(8 / 15, abs=0.06)  # of 15 m of wall; 0.77 if every point had a vote


@pytest.mark.slow
def test_assumed_range_of_a_ring_looking_in_and_out() -> None:
    angle = np.radians(np.arange(0, 360, 15))
    where = 10 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    seen_in, seen_out = (
        shared(poses, assumed_proxy(poses, [CAMERA] * 24, 10.0, VISIBLE), max_angle_deg=most)
        for poses, most in ((look(where, np.degrees(angle) + 90), 120), (look(where, np.degrees(angle) - 90), 90))
    )
    assert between(seen_in, 0, 1) > 0.6 and between(seen_out, 0, 1) > 0.4
    assert between(seen_in, 0, 12) < 0.1 and between(seen_out, 0, 12) == 0
    assert between(seen_in, 0, 4) > 0.3 > between(seen_out, 0, 8)


def test_pair_share_is_the_same_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visible, "_OWNERS", 3)  # several parts
    poses = row_of_cameras(8)
    found = shared(poses, assumed_proxy(poses, [CAMERA] * 8, 10.0, VISIBLE))
    i, j = np.triu_indices(8, 1)
    direct = pair_share(poses, [CAMERA] * 8, i, j, 10.0, VISIBLE)
    listed = found.between(i, j)
    # votes are by image cell there and by point here
    assert np.abs(np.where(direct < 0.02, 0, direct) - listed).max() < 0.08


@pytest.mark.slow
def test_pair_share_of_cameras_of_several_kinds_is_that_of_each_pair() -> None:
    """Of the barrel the corners have no rays, so that images have unequally many points."""
    barrel = pycolmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[320.0, 320.0, 240.0, -0.35])
    cameras, poses = [CAMERA, barrel, None] * 3, row_of_cameras(9)
    poses[4] = np.nan
    counts = np.bincount(assumed_proxy(poses, cameras, 10.0, VISIBLE).image, minlength=9)
    assert counts[1] < counts[0] and counts[4] == 0
    i, j = np.triu_indices(9, 1)
    at_once = pair_share(poses, cameras, i, j, 10.0, VISIBLE)
    one_by_one = [pair_share(poses, cameras, i[k : k + 1], j[k : k + 1], 10.0, VISIBLE)[0] for k in range(len(i))]
    np.testing.assert_array_equal(at_once, one_by_one)
    np.testing.assert_array_equal(np.isnan(at_once), (i == 4) | (j == 4))
    listed = shared(poses, assumed_proxy(poses, cameras, 10.0, VISIBLE), cameras=cameras).between(i, j)
    known = np.isfinite(at_once) & (at_once > 0.02)
    assert known.sum() > 10 and np.abs(at_once - listed)[known].max() < 0.12


def test_slack_widens_the_view_of_unsure_poses() -> None:
    poses, proxy = row_of_cameras(2, 22.0), points_proxy(wall())
    assert len(shared(poses, proxy, max_angle_deg=180)) == 0
    assert len(shared(poses, proxy, slack_rad=0.3, max_angle_deg=180)) == 1


@pytest.mark.slow
def test_many_points_are_thinned_without_loss() -> None:
    poses = row_of_cameras()
    proxy = points_proxy(wall(60000))
    found = shared(poses, proxy)
    assert between(found, 3, 4) == pytest.approx(0.8, abs=0.05)
    fewer = shared(poses, proxy, mean_visible=(300, 300))
    assert between(fewer, 3, 4) == pytest.approx(0.8, abs=0.12)


@pytest.mark.slow
def test_the_table_is_the_same_in_blocks_of_any_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block names only the images that see anything of it: three images or all at once."""
    poses, points = row_of_cameras(40, 2.0), wall(width=80)
    poses[11, :3] = np.nan
    proxy = replace(points_proxy(points), reach=np.full(len(points), 30.0))
    whole = shared(poses, proxy)
    monkeypatch.setattr(visible, "_BLOCK", 3)
    parts = shared(poses, proxy)
    assert len(whole) > 100 and 11 not in np.r_[whole.i, whole.j] and np.ptp(whole.j) == 38
    for name in ("i", "j", "share", "angle_deg", "scale"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name))


def test_boxes_leave_out_only_points_that_no_cone_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proxies, "_LEAF", 4)
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(0, 200, 3000), rng.normal(0, 8, 3000), rng.uniform(0, 6, 3000)])
    proxy = replace(points_proxy(points), reach=rng.uniform(5, 40, len(points)))
    held = proxies.Boxes(proxy)
    fewest, most = len(points), 0
    for half in (0.2, 0.7, 1.4, 3.0):
        for _ in range(20):
            centre, axis = points[rng.integers(len(points))] + rng.normal(0, 5, 3), rng.normal(size=3)
            axis /= np.linalg.norm(axis)
            distance = np.linalg.norm(points - centre, axis=1)
            inside = ((points - centre) @ axis > np.cos(half) * distance) & (distance < proxy.reach)
            near = held.near(centre, axis, half)
            assert np.isin(np.flatnonzero(inside), near).all()
            fewest, most = min(fewest, len(near)), max(most, len(near))
    assert fewest < 300 < most < len(points)


def test_nothing_in_nothing_out() -> None:
    poses = row_of_cameras(3)
    empty = Proxy(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int))
    assert len(shared(poses, empty, cameras=[None] * 3)) == 0
    assert len(shared(np.full((3, 4, 4), np.nan), points_proxy(wall(10)))) == 0
    assert len(assumed_proxy(np.full((3, 4, 4), np.nan), [CAMERA] * 3, 5.0, VISIBLE)) == 0
    without_camera = shared(poses, points_proxy(wall()), cameras=[None] * 3)
    assert without_camera.share[:2] == pytest.approx([0.65, 0.31], abs=0.06)  # 60 degrees of view, 4 m apart
