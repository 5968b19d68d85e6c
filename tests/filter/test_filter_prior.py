"""Matches against a rough model: what a surface within reach explains, and what a repeated wall does not."""

import numpy as np
import pytest
from filter_world import rig_from_world, world
from scipy.spatial.transform import Rotation

from tiegraph.filter.prior import Prior, held_by_rig, off_course_deg
from tiegraph.filter.tuning import PriorTuning
from tiegraph.geometry import transforms

TUNING = PriorTuning()


def two_views(shift_m: float = 0.0, base_m: float = 12.0) -> tuple[np.ndarray, ...]:
    """Rays of wall points 8 m to the side, seen from two places along the wall; with ``shift_m`` the second camera sees
    a copy of them so much further on."""
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(2, 10, 200), rng.uniform(-3, 3, 200), np.full(200, 8.0)], axis=1)
    turn = Rotation.from_euler("y", 5, degrees=True).as_matrix()
    b_from_a = transforms.rigid(turn, -turn @ np.array([base_m, 0.0, 0.0]))
    seen = transforms.apply(b_from_a, points + [shift_m, 0, 0])
    return tuple(p / np.linalg.norm(p, axis=1, keepdims=True) for p in (points, seen)) + (b_from_a,)


REACH = np.array([6.0, 16.0])


def test_true_matches_are_on_course() -> None:
    a, b, pose = two_views()
    assert off_course_deg(a, b, pose, REACH, TUNING).max() < 0.2


def test_a_rough_pose_is_forgiven() -> None:
    a, b, pose = two_views()
    rough = transforms.rigid(Rotation.from_euler("xyz", (0.3, 0.3, 0.3), degrees=True).as_matrix(), np.full(3, 0.05))
    assert np.mean(off_course_deg(a, b, rough @ pose, REACH, TUNING) <= TUNING.tolerance_deg) > 0.9


@pytest.mark.parametrize("shift_m", [12.0, 15.0])
def test_a_repeated_wall_is_off_course_though_on_its_epipolar_line(shift_m: float) -> None:
    a, b, pose = two_views(shift_m)
    assert np.mean(off_course_deg(a, b, pose, REACH, TUNING) <= TUNING.tolerance_deg) < 0.1
    # With no limits of distance the same matches lie on their epipolar lines.
    t = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    plane = np.cross(t, a @ pose[:3, :3].T)
    sine = np.abs(np.sum(plane * b, axis=1)) / np.linalg.norm(plane, axis=1)
    assert np.degrees(np.arcsin(sine)).max() < 0.1


def test_points_behind_are_off_course() -> None:
    a, b, pose = two_views()
    assert off_course_deg(a, -b, pose, REACH, TUNING).min() > 90


def rig_poses(blind: list[int], frames: int = 5) -> tuple:
    """A scene of a rig of four, its prior at the true extrinsics with the reach of images ``blind`` unknown."""
    scene = world(frames=frames).scene
    poses = []
    for f, s in zip(scene.frame, scene.sensor):
        turn = Rotation.from_euler("y", 180 * (f == frames - 1), degrees=True).as_matrix()
        body = transforms.rigid(turn, np.array([1.5 * f, 0.0, 0.0]))
        poses.append(scene.rigs[0].sensors[s].sensor_from_rig @ transforms.invert(body))
    reach = np.tile([4.0, 20.0], (len(scene), 1))
    reach[blind] = np.nan
    return scene, Prior(np.stack(poses), reach)


@pytest.mark.parametrize("wrong_deg", [0.0, 40.0])
def test_pairs_of_an_image_that_the_model_has_at_a_wrong_place_are_not_refused_for_it(tmp_path, wrong_deg) -> None:
    """Of one of seneca's photographs all six pairs went, of up to 7000 matches each: its coarse place was wrong."""
    made = world(frames=14, sensors=1, cloud=800)
    poses = np.stack([rig_from_world(f) for f in range(14)])
    poses[6, :3] = Rotation.from_euler("y", wrong_deg, degrees=True).as_matrix() @ poses[6, :3]
    result, _ = made.run(tmp_path, prior=Prior(poses, np.tile([3.0, 30.0], (14, 1))))
    assert result.counts["pairs"] > 10 and result.counts["refused"] == 0
    assert ("it has 1 images at the wrong place" in result.notes[0]) == (wrong_deg > 0)


def test_parts_that_a_model_has_put_together_wrongly_are_not_parted_for_it(tmp_path) -> None:
    """The previews of a sea floor joined two stretches of it wrongly, and all six pairs between them went."""
    made = world(frames=20, sensors=1, cloud=800)
    poses = np.stack([rig_from_world(f) for f in range(20)])
    elsewhere = transforms.rigid(Rotation.from_euler("y", 40, degrees=True).as_matrix(), np.array([3.0, 0, 2.0]))
    poses[10:] = poses[10:] @ elsewhere
    result, _ = made.run(tmp_path, prior=Prior(poses, np.tile([3.0, 30.0], (20, 1))))
    kept = result.pairs.kept()
    assert result.counts["refused"] == 0 and np.any((kept.i < 10) != (kept.j < 10))
    assert "are all that ties parts of it" in result.notes[0]


def test_images_without_points_are_judged_where_their_rig_holds_them() -> None:
    scene, _ = rig_poses([])
    third = np.flatnonzero(scene.sensor == 2)
    scene, prior = rig_poses([int(third[1])])
    wide = held_by_rig(prior, scene, TUNING)
    assert wide.known().all() and not prior.known()[third[1]]
    assert wide.reach[third[1]].tolist() == [4.0 / TUNING.any_distance, 20.0 * TUNING.any_distance]
    assert np.array_equal(np.flatnonzero(wide.mount_deg), third[1:2])


def test_images_without_points_are_not_judged_if_their_sensor_or_frame_is_not_held() -> None:
    scene, whole = rig_poses([])
    assert held_by_rig(whole, scene, TUNING) is whole
    third, frame = np.flatnonzero(scene.sensor == 2), np.flatnonzero(scene.frame == 1)
    for blind in (third[:3], frame):
        scene, prior = rig_poses(blind.tolist())
        assert not held_by_rig(prior, scene, TUNING).known()[blind].any()
    scene, none = rig_poses(list(range(len(scene))))
    assert not held_by_rig(none, scene, TUNING).known().any()


def test_a_mounting_that_is_off_counts_as_far_as_the_images_are_turned() -> None:
    scene, _ = rig_poses([])
    third = np.flatnonzero(scene.sensor == 2)
    scene, prior = rig_poses([int(third[1])])
    wide = held_by_rig(prior, scene, TUNING)
    ahead, back, other = int(third[0]), int(third[-1]), int(np.flatnonzero(scene.sensor == 0)[0])
    assert wide.tolerance_deg(int(third[1]), ahead, True, TUNING.tolerance_deg) == pytest.approx(TUNING.tolerance_deg)
    assert wide.tolerance_deg(back, int(third[1]), True, TUNING.tolerance_deg) == pytest.approx(
        TUNING.tolerance_deg + 2 * TUNING.mount_deg
    )
    assert wide.tolerance_deg(int(third[1]), other, False, TUNING.tolerance_deg) == pytest.approx(
        TUNING.tolerance_deg + TUNING.mount_deg
    )
    assert (
        wide.tolerance_deg(ahead, other, False, TUNING.tolerance_deg)
        == TUNING.tolerance_deg
        == prior.tolerance_deg(ahead, back, True, TUNING.tolerance_deg)
    )
