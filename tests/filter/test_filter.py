"""View-graph filtering on rigs of known motions with false pairs, and by a rough model; what the mapper gets to see."""

from __future__ import annotations

import sqlite3

import numpy as np
import pycolmap
import pytest
from filter_world import add_repeats, rig_from_world, serial, world
from filter_world import rig as ring_of
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.filter.filter import Prior, filter_pairs
from tiegraph.filter.settings import FilterSettings
from tiegraph.filter.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.course import off_course_deg
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import simple_scene
from tiegraph.scene.tuning import CourseTuning
from tiegraph.sfm.run import write_working_copy
from tiegraph.sfm.verified import ViewGraph


def prior_of(made) -> Prior:
    """The true poses of the images as a rough model."""
    scene = made.scene
    poses = [scene.rigs[0].sensors[s].sensor_from_rig @ rig_from_world(f) for f, s in zip(scene.frame, scene.sensor)]
    return Prior(np.stack(poses), np.tile([3.0, 30.0], (len(scene), 1)))


@pytest.fixture(scope="module")
def repeated():
    return add_repeats(world())


def _shares(result, false):
    kept = result.pairs.dropped == 0
    return kept[~false].mean(), kept[false].mean()


def test_true_pairs_stay_and_repeats_go(repeated, tmp_path):
    results = [repeated.run(tmp_path, prior=prior_of(repeated)) for _ in range(2)]
    (result, false), (again, _) = results
    true_kept, false_kept = _shares(result, false)
    assert false.sum() > 10 and true_kept >= 0.99 and false_kept <= 0.05
    assert result.counts["refused"] == np.sum(result.pairs.dropped > 0) > 0.9 * false.sum()
    assert np.array_equal(result.pairs.dropped, again.pairs.dropped)


def test_pairs_that_nothing_judges_stay(repeated, tmp_path):
    prior = prior_of(repeated)
    late = repeated.scene.frame >= 4
    prior.cam_from_world[late] = np.nan
    result, false = repeated.run(tmp_path, prior=prior)
    gone, judged = result.pairs.dropped > 0, ~late[result.pairs.i] & ~late[result.pairs.j]
    assert np.any(false & ~judged) and gone.any() and np.all(judged[gone])
    prior.cam_from_world[:] = np.nan
    for nothing in (prior, None):
        result, _ = repeated.run(tmp_path, prior=nothing)
        assert result.counts["refused"] == 0 and "was tested" in result.notes[0]


def test_a_model_that_most_pairs_contradict_is_not_used(repeated, tmp_path):
    prior = prior_of(repeated)
    rng = np.random.default_rng(0)
    turn = Rotation.random(len(repeated.scene), rng).as_matrix()
    prior.cam_from_world[:, :3] = turn @ prior.cam_from_world[:, :3]
    result, _ = repeated.run(tmp_path, prior=prior)
    assert result.counts["refused"] == 0 and "too few, so it is not used" in result.notes[0]


def test_off_keeps_all_and_a_missing_database_is_named(repeated, tmp_path):
    prior = prior_of(repeated)
    result, _ = repeated.run(tmp_path, prior=prior, method="off")
    assert np.all(result.pairs.dropped == 0)
    pairs = Pairs.make(np.array([0]), np.array([5]), "sequence")
    given = repeated.scene, pairs, FilterSettings(), (Tuning(), CourseTuning()), serial, prior
    with pytest.raises(InputError, match="nowhere.db"):
        filter_pairs(tmp_path / "nowhere.db", *given)


def test_refused_pairs_are_left_out(tmp_path):
    scene = simple_scene(ring_of(1, 0.0), ["a.jpg", "b.jpg", "c.jpg"], np.arange(3), np.zeros(3, int))
    source, target = tmp_path / "database.db", tmp_path / "copy.db"
    create_database(source, scene)
    matches = np.column_stack([np.arange(30)] * 2).astype(np.uint32)
    with pycolmap.Database.open(source) as database:
        for i, j in ((1, 2), (1, 3), (2, 3)):
            geometry = pycolmap.TwoViewGeometry()
            geometry.inlier_matches = matches
            database.write_two_view_geometry(i, j, geometry)
    write_working_copy(source, target, scene, {}, None, refused=[(2, 0)])
    count = "SELECT count(*) FROM two_view_geometries"
    with sqlite3.connect(target) as copy, sqlite3.connect(source) as original:
        assert copy.execute(count).fetchone() == (2,) and original.execute(count).fetchone() == (3,)
    assert ViewGraph(source, scene, 15, refused=[(0, 2)]).pairs.tolist() == [[0, 1], [1, 2]]
    assert len(ViewGraph(source, scene, 15).pairs) == 3


COURSE = CourseTuning()


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


def test_true_matches_are_on_course_and_a_rough_pose_is_forgiven() -> None:
    a, b, pose = two_views()
    assert off_course_deg(a, b, pose, (REACH, REACH), COURSE).max() < 0.2
    assert off_course_deg(a, -b, pose, (REACH, REACH), COURSE).min() > 90, "points behind"
    rough = transforms.rigid(Rotation.from_euler("xyz", (0.3, 0.3, 0.3), degrees=True).as_matrix(), np.full(3, 0.05))
    assert np.mean(off_course_deg(a, b, rough @ pose, (REACH, REACH), COURSE) <= COURSE.tolerance_deg) > 0.9


@pytest.mark.parametrize("shift_m", [12.0, 15.0])
def test_a_repeated_wall_is_off_course_though_on_its_epipolar_line(shift_m: float) -> None:
    a, b, pose = two_views(shift_m)
    assert np.mean(off_course_deg(a, b, pose, (REACH, REACH), COURSE) <= COURSE.tolerance_deg) < 0.1
    # With no limits of distance the same matches lie on their epipolar lines.
    t = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    plane = np.cross(t, a @ pose[:3, :3].T)
    sine = np.abs(np.sum(plane * b, axis=1)) / np.linalg.norm(plane, axis=1)
    assert np.degrees(np.arcsin(sine)).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("wrong_deg", [0.0, 40.0])
def test_pairs_of_an_image_that_the_model_has_at_a_wrong_place_are_not_refused_for_it(tmp_path, wrong_deg) -> None:
    """Of one of seneca's photographs all six pairs went, of up to 7000 matches each: its coarse place was wrong."""
    made = world(frames=14, sensors=1, cloud=800)
    poses = np.stack([rig_from_world(f) for f in range(14)])
    poses[6, :3] = Rotation.from_euler("y", wrong_deg, degrees=True).as_matrix() @ poses[6, :3]
    result, _ = made.run(tmp_path, prior=Prior(poses, np.tile([3.0, 30.0], (14, 1))))
    assert result.counts["pairs"] > 10 and result.counts["refused"] == 0
    assert ("it has 1 images at a wrong place" in result.notes[0]) == (wrong_deg > 0)


@pytest.mark.slow
def test_parts_that_a_model_has_put_together_wrongly_are_not_parted_for_it(tmp_path) -> None:
    """The previews of a sea floor joined two stretches of it wrongly, and all six pairs between them went."""
    made = world(frames=20, sensors=1, cloud=800)
    poses = np.stack([rig_from_world(f) for f in range(20)])
    elsewhere = transforms.rigid(Rotation.from_euler("y", 40, degrees=True).as_matrix(), np.array([3.0, 0, 2.0]))
    poses[10:] = poses[10:] @ elsewhere
    result, _ = made.run(tmp_path, prior=Prior(poses, np.tile([3.0, 30.0], (20, 1))))
    kept = result.pairs.kept()
    assert result.counts["refused"] == 0 and np.any((kept.i < 10) != (kept.j < 10))
    assert "are the only ties of parts of it" in result.notes[0]
