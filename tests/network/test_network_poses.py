"""Pairs from prior poses: distance, axes, line of sight, baseline, and gaps in the priors."""

import numpy as np
from boat_world import boat

from tiegraph.geometry import transforms
from tiegraph.network.network import estimate_network
from tiegraph.network.passes import find_passes
from tiegraph.network.poses import pose_pairs
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS = NetworkSettings(sources=("poses",), range_m=12.0, axes_deg=80)


def with_priors(world, rotation: bool = True) -> Scene:
    scene = world.scene
    reference = np.flatnonzero(scene.sensor == 0)
    poses = np.empty((scene.frames, 4, 4))
    poses[scene.frame[reference]] = world.world_from_sensor[reference]
    if not rotation:
        poses[:, :3, :3] = np.nan
    sigma = np.full((scene.frames, 3), 0.02)
    return scene.with_(world_from_rig=poses, position_sigma_m=sigma, prior="trajectory" if rotation else "gnss")


def recall(world, pairs) -> tuple[float, float]:
    n = len(world.scene)
    i, j = np.triu_indices(n, 1)
    useful = np.maximum(world.overlap(i, j), world.overlap(j, i)) >= 0.15
    kept = pairs.kept()
    found = np.isin(i * n + j, kept.i.astype(np.int64) * n + kept.j)
    return (found & useful).sum() / useful.sum(), (found & useful).sum() / max(found.sum(), 1)


def test_full_poses_find_what_overlaps() -> None:
    world = boat((14, 14), (2.0, 2.0))
    result = pose_pairs(with_priors(world), find_passes(world.scene), SETTINGS)
    share, precision = recall(world, result.pairs)
    assert share > 0.85 and 0.35 < precision < 1
    reasons = result.pairs.funnel()
    assert reasons["axes"] > 0 and reasons["sight"] > 0 and reasons["distance"] > 0
    assert (result.pairs.kept().angle_deg <= 80.001).all()
    assert not len(result.without)


def test_positions_alone_take_the_heading_from_the_track() -> None:
    world = boat((14, 14), (2.0, 2.0))
    result = pose_pairs(with_priors(world, rotation=False), find_passes(world.scene), SETTINGS)
    share, precision = recall(world, result.pairs)
    assert share > 0.85 and precision > 0.2
    assert any("heading of 28 frames" in note for note in result.notes)
    angles = result.pairs.angle_deg
    assert np.isfinite(angles).mean() > 0.9


def test_frames_without_prior_fall_back_on_previews() -> None:
    world = boat((14, 14), (2.0, 2.0))
    scene = with_priors(world)
    poses = scene.world_from_rig.copy()
    poses[5:9] = np.nan
    world.scene = scene.with_(world_from_rig=poses)
    network = estimate_network(world.scene, np.full(len(scene), 100.0), world.match, SETTINGS)
    lost = np.isin(scene.frame, range(5, 9))
    assert (network.pairs.degree(len(scene))[lost] > 0).all()
    assert recall(world, network.pairs)[0] > 0.8
    assert any("4 of 28 frames have no prior position" in note for note in network.notes)


def test_odometry_of_two_passes_is_never_compared() -> None:
    world = boat((10, 10), (2.0, 2.0))
    scene = with_priors(world).with_(prior="odometry")
    pairs = pose_pairs(scene, find_passes(scene), SETTINGS).pairs
    track = scene.track[scene.frame]
    assert len(pairs) and (track[pairs.i] == track[pairs.j]).all()


def test_too_short_a_base_of_one_camera_is_dropped() -> None:
    world = boat((10,), (2.0,))
    scene = with_priors(world)
    poses = scene.world_from_rig.copy()
    poses[4] = poses[3]
    pairs = pose_pairs(scene.with_(world_from_rig=poses), find_passes(scene), SETTINGS).pairs
    dropped = pairs.where(pairs.dropped == REASONS.index("baseline"))
    assert len(dropped) == 6
    assert set(scene.frame[dropped.i]) | set(scene.frame[dropped.j]) == {3, 4}


def test_drone_photographs_take_their_nearest() -> None:
    rng = np.random.default_rng(3)
    count = 200
    where = np.column_stack([rng.uniform(0, 300, (count, 2)), rng.normal(80, 2, count)])
    poses = transforms.rigid(np.full((count, 3, 3), np.nan), where)
    rig = Rig("camera", (Sensor("camera"),))
    scene = simple_scene(rig, [f"{k}.jpg" for k in range(count)], np.arange(count), np.zeros(count), prior="exif")
    scene = scene.with_(world_from_rig=poses, position_sigma_m=np.full((count, 3), 3.0))
    pairs = pose_pairs(scene, (), NetworkSettings(sources=("poses",))).pairs.kept()
    distance = np.linalg.norm(where[pairs.i] - where[pairs.j], axis=1)
    assert (pairs.degree(count) >= 20).all()
    assert len(pairs) < 0.3 * count * count / 2
    assert np.allclose(distance, pairs.baseline_m, rtol=1e-4)


def test_no_prior_at_all_is_said() -> None:
    world = boat((4,), (2.0,))
    result = pose_pairs(world.scene, find_passes(world.scene), SETTINGS)
    assert len(result.pairs) == 0 and len(result.without) == 4 and "fewer than two" in result.notes[0]
