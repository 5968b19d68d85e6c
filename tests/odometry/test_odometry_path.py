"""Drives through a rendered corridor: drift, scale, losses, segments; bounds from both sides."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry.odometry_world import FRAMES, apart, drive, images, single, stereo, true_path
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.odometry.cameras import Tracks, cameras_of
from tiegraph.odometry.odometry import Odometry
from tiegraph.odometry.tuning import Tuning
from tiegraph.odometry.worldmap import scaled
from tiegraph.scene.rig import Rig, Sensor

pytestmark = pytest.mark.slow

ALL = list(range(FRAMES))
RING = apart(25, 0.2)  # shares the edges of its views, 17 cm apart


def length_m(path):
    return np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1).sum()


def off_after_similarity(path, truth):
    """Largest error of a place after the best similarity, and the scale of that."""
    places, true = path.world_from_rig[:, :3, 3], truth[:, :3, 3]
    fit = umeyama(places, true)
    return np.linalg.norm(fit(places) - true, axis=1).max(), fit.scale


def test_stereo_drifts_by_less_than_one_percent_and_its_sigmas_are_of_the_size_of_its_errors():
    """Median over the path, for one drive is one sample of what drifts."""
    path, truth = drive(stereo(), ALL), true_path(ALL)
    assert path.metric and (path.segment == 0).all() and 2 <= path.keyframe.sum() < FRAMES
    off = np.linalg.norm((path.world_from_rig - truth)[:, :3, 3], axis=1)
    assert 1e-5 < off[-1] < 0.01 * length_m(truth)
    turned = transforms.angle_deg(path.world_from_rig[:, :3, :3], truth[:, :3, :3])
    assert 1e-4 < turned.max() < 0.3
    place, turn = path.sigmas()
    assert (place[0] == 0).all() and (np.diff(np.linalg.norm(place[path.keyframe], axis=1)) > 0).all()
    off = np.abs((path.world_from_rig - truth)[1:, :3, 3])
    assert 0.4 < np.median(off / place[1:]) / 0.6745 < 2
    turned = transforms.angle_deg(path.world_from_rig[1:, :3, :3], truth[1:, :3, :3])
    assert 0.4 < np.median(turned / np.linalg.norm(turn[1:], axis=1)) < 2


def test_one_camera_gives_the_shape_without_a_scale():
    path, truth = drive(single(), ALL), true_path(ALL)
    assert not path.metric and (path.segment == 0).all()
    off, scale = off_after_similarity(path, truth)
    assert 1e-4 < off < 0.02 * length_m(truth)
    assert abs(np.log(scale)) > 0.01  # nothing told it


def test_cameras_without_a_common_view_are_followed_together():
    """Their scale is known only as far as they turn: hardly, on so short a drive; the sigma along the path says so."""
    rig = apart(60, 0.1)
    assert rig.partners() == {0: (), 1: ()} and stereo().partners() == {0: (1,)}
    frames = ALL[:16]
    path, truth = drive(rig, frames), true_path(frames)
    assert path.metric and (path.segment == 0).all()
    off, scale = off_after_similarity(path, truth)
    assert 1e-4 < off < 0.1 * length_m(truth) and 0.5 < scale < 2
    place = path.sigmas()[0][-1]
    assert place[2] > 10 * place[1] and abs(path.world_from_rig - truth)[-1, 2, 3] < 5 * place[2]


def test_a_camera_is_turned_to_the_view_of_another():
    rig, xy = RING, np.array([[300.0, 100.0], [310.0, 60.0], [2.0, 120.0]])
    assert np.allclose(rig.turned(1, 0, rig.turned(0, 1, xy))[:2], xy[:2], atol=1e-6)
    assert rig.map_of(0, 1).shape == (2, 240, 320) and rig.angle_deg(0, 1) == pytest.approx(50)


def test_a_ring_that_shares_the_edges_of_its_views_begins_from_two_frames_with_a_scale():
    frames = ALL[:12]
    path, truth = drive(RING, frames), true_path(frames)
    assert path.metric and (path.segment == 0).all()
    off, scale = off_after_similarity(path, truth)
    assert 0.9 < scale < 1.1 and 1e-4 < off < 0.05


def test_points_of_known_place_tell_the_length_of_a_base_line():
    rig, rng = RING, np.random.default_rng(0)
    known = rng.uniform([-2, -2, 4], [2, 2, 9], (40, 3))
    pose = transforms.rigid(Rotation.from_rotvec([0.02, 0.05, 0]).as_matrix(), [0.3, 0.1, -1.7])
    camera = np.zeros(40, int)
    seen = Tracks(
        np.arange(40), camera, rig.project(camera, transforms.apply(pose, known)) + rng.normal(0, 0.2, (40, 2))
    )
    short = pose.copy()
    short[:3, 3] *= 0.01
    made = scaled(rig, short, seen, known)
    assert 1e-6 < np.linalg.norm(made[:3, 3] - pose[:3, 3]) < 0.01 * 1.7
    known[5:] = np.nan
    assert np.array_equal(scaled(rig, short, seen, known), short)


def test_dark_frames_are_lost_and_the_path_goes_on():
    truth = true_path(ALL)
    path = drive(stereo(), ALL, dark=(10, 11))
    assert path.segment.tolist() == [0] * 10 + [-1] * 2 + [0] * 12
    assert np.isnan(path.world_from_rig[10]).all() and np.isnan(path.covariance[11]).all()
    assert np.linalg.norm((path.world_from_rig - truth)[-1, :3, 3]) < 0.02 * length_m(truth)


def test_a_segment_is_joined_when_a_known_place_is_seen_again():
    """Dark for longer than the patience: a new segment begins, in whose first keyframe the old place is seen."""
    truth = true_path(ALL)
    path = drive(stereo(), ALL, dark=(10, 11, 12, 13, 14))
    assert path.loops >= 1 and path.segment.tolist() == [0] * 10 + [-1] * 5 + [0] * 9
    assert np.linalg.norm((path.world_from_rig - truth)[-1, :3, 3]) < 0.03 * length_m(truth)


def test_a_segment_that_shares_nothing_stays_apart():
    frames = ALL[:8] + [90, 91, 92, 93, 94, 95, 96, 97]
    path = drive(stereo(), frames)
    assert set(path.segment.tolist()) == {-1, 0, 1} and path.main() == 0
    assert path.segment[:8].tolist() == [0] * 8 and path.segment[-1] == 1
    truth = true_path(frames[-4:])
    own = transforms.invert(path.world_from_rig[-4]) @ path.world_from_rig[-4:]
    assert np.linalg.norm((own - truth)[-1, :3, 3]) < 0.03


def test_the_same_images_give_the_same_path():
    one, two = (drive(stereo(), ALL[:8]) for _ in range(2))
    assert np.array_equal(one.world_from_rig, two.world_from_rig)


def test_masked_pixels_get_no_corners():
    odometry = Odometry(stereo(), lambda frame, camera: None, Tuning())
    shown = images(stereo(), 0)
    mask = np.full(shown[0].shape, 255, np.uint8)
    mask[:, :160] = 0
    odometry.add(0, shown, {0: mask})
    left = odometry.world.keyframes[0].seen
    assert len(left) > 50 and left.xy[left.camera == 0, 0].min() >= 160


def test_rigs_that_are_not_calibrated_are_refused():
    camera = stereo().models[0]
    unplaced, unknown = (Sensor("a", camera, np.eye(4)), Sensor("b", camera)), (Sensor("a", None, np.eye(4)),)
    for rigs, said in (
        ([Rig("r", unplaced)], "b: its place in the rig is not known.*rig.toml"),
        ([Rig("r", unknown)], "a: its focal length is not known.*--camera"),
        ([Rig("r", ()), Rig("s", ())], "2 .*give one's images"),
    ):
        with pytest.raises(InputError, match=said):
            cameras_of(rigs)
