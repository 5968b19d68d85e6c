"""Several models in one world: by their matches, by their positions, or left out with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from sfm_worlds import elsewhere, frame_centres, make_world, part_of, with_positions

from tiegraph import papers
from tiegraph.geometry import transforms
from tiegraph.project.settings import merged as merged_settings
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.composed import merged
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import VerifiedMatches, read_verified
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import georeference
from tiegraph.sfm.world.oneworld import OneWorld, one_world

TUNING = Tuning()
NONE = VerifiedMatches(np.zeros((0, 2), int), (), {})
FIRST = 12  # frames of the first model


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """(scene without positions, truth, two models of it in frames and units of their own, all verified matches)."""
    path = tmp_path_factory.mktemp("world") / "database.db"
    truth, scene = make_world(path, cameras=2, frames=20, points=200)
    rng = np.random.default_rng(5)
    first = part_of(truth, range(FIRST), 0.01, rng)
    second = part_of(truth, range(FIRST, 20), 0.01, rng)
    return scene, truth, (first, elsewhere(second)), read_verified(path, scene)


def _brought_together(models, scene, matches, tuning=TUNING) -> OneWorld:
    settings = GeorefSettings(adjust="no")

    def similarity(model, given):
        return georeference(model, scene, settings, tuning.world, given)

    def whole(model, given):
        found = similarity(model, given)
        return found, found.apply(model)

    return one_world(models, scene, matches, similarity, whole, Measurements(), tuning)


def _joined(survey, verified=None, scene=None, tuning=TUNING) -> OneWorld:
    without, _, models, matches = survey
    scene, matches = without if scene is None else scene, matches if verified is None else verified
    return _brought_together(models, scene, matches, tuning)


def _off(found, survey):
    """(largest distance of a projection centre in the truth's units, largest turn in degrees), after the similarity
    that brings the first model back."""
    scene, truth, (first, _), _ = survey
    world_from_truth = found.first.world_from_model
    here, there = image_poses(found.model, scene), image_poses(truth, scene)
    centres = world_from_truth(transforms.centre(there))
    turned = there[:, :3, :3] @ world_from_truth.rotation.T
    off = np.linalg.norm(transforms.centre(here) - centres, axis=1) / world_from_truth.scale
    return np.nanmax(off), np.nanmax(transforms.angle_deg(here[:, :3, :3], turned))


def _with_positions(survey, moved_m=0.0, sigma_m=0.02):
    scene, truth, _, _ = survey
    true = frame_centres(truth, scene)
    noise = sigma_m * np.random.default_rng(1).standard_normal(true.shape)
    noise[FIRST:, 0] += moved_m
    return with_positions(scene, true + noise, sigma_m)


@pytest.mark.slow
def test_matches_join_two_models_without_any_position_into_a_whole_one(survey, tmp_path) -> None:
    found = _joined(survey)
    (second,) = found.others
    assert second.by == "matches" and not found.contradictions
    off, turn = _off(found, survey)
    assert 1e-6 < off < 0.04 and turn < 0.5  # of a path of some units; points are off by 0.01
    assert 0.7 < second.test.explained < 1 and 0.7 < second.test.ties / second.test.total < 1
    assert 1e-6 < second.test.jump < 0.02 and second.test.independent >= 4
    assert found.model.num_reg_images() == 40
    assert second.row()[:3] == ["sparse/1", 16, "matches"] and second.row()[-1] == ""
    assert "joined to the others by" in second.note(metric=True)
    found.model.write(tmp_path)
    again = pycolmap.Reconstruction(tmp_path)
    scene, _, (first, second), _ = survey
    assert again.num_reg_frames() == 20 and again.num_cameras() == 4 and again.num_rigs() == 2
    assert again.num_points3D() == first.num_points3D() + second.num_points3D()
    for model in (first, second):
        model.update_point_3d_errors()
    worse = max(m.compute_mean_reprojection_error() for m in (first, second))
    again.update_point_3d_errors()
    assert again.compute_mean_reprojection_error() < 1.01 * worse
    assert {again.image(k).name for k in again.reg_image_ids()} == set(scene.names)


def test_an_image_of_two_models_stays_once(survey) -> None:
    _, truth, (first, _), _ = survey
    both = merged([first, truth])
    assert both.num_reg_images() == 40 and merged([first, first]).num_cameras() == 2
    names = [both.image(k).name for k in both.reg_image_ids()]
    assert len(names) == len(set(names))
    points = [p for p in both.points3D.values() if any(e.image_id not in both.images for e in p.track.elements)]
    assert not points


@pytest.mark.slow
def test_matches_that_agree_with_nothing_join_nothing(survey) -> None:
    scene, _, (first, _), verified = survey
    rng = np.random.default_rng(2)
    across = (scene.frame[verified.pairs] < FIRST).sum(axis=1) == 1
    wrong = tuple(
        np.stack([m[:, 0], rng.permutation(m[:, 1])], 1) if a else m for m, a in zip(verified.matches, across)
    )
    found = _joined(survey, replace(verified, matches=wrong))
    (second,) = found.others
    assert second.by == "" and "matches run between it" in second.why_not or "no match" in second.why_not
    assert found.model.num_reg_images() == first.num_reg_images()
    assert "not in the world and not in the cloud" in found.notes()[-1]


def test_one_repeated_wall_joins_nothing(survey) -> None:
    """Matches that agree, but of a single pair of images: nothing independent says so."""
    scene, _, _, verified = survey
    across = np.flatnonzero((scene.frame[verified.pairs] < FIRST).sum(axis=1) == 1)
    found = _joined(survey, verified.where(across[:1]))
    assert found.others[0].by == ""


@pytest.mark.slow
def test_positions_place_what_no_match_joins(survey) -> None:
    found = _joined(survey, NONE, _with_positions(survey))
    (second,) = found.others
    assert second.by == "positions" and found.model.num_reg_images() == 40
    assert 0.005 < second.sigma_m < 0.2
    poses, true = image_poses(found.model, survey[0]), image_poses(survey[1], survey[0])
    off = np.linalg.norm(transforms.centre(poses) - transforms.centre(true), axis=1)
    assert 1e-4 < np.median(off) < 0.06


@pytest.mark.slow
def test_without_matches_and_positions_a_model_stays_out_and_says_why(survey) -> None:
    for scene in (survey[0], _with_positions(survey).with_(prior="gnss")):
        poses = scene.world_from_rig.copy()
        poses[FIRST:] = np.nan
        found = _joined(survey, NONE, scene.with_(world_from_rig=poses))
        assert found.others[0].by == "" and "too few positions" in found.others[0].why_not
        assert found.model.num_reg_images() == 2 * FIRST


@pytest.mark.slow
@pytest.mark.parametrize("joins", [True, False])
def test_the_largest_model_with_positions_carries_the_world(survey, joins) -> None:
    """As where a survey is cut at a bridge below which most of it lies, and no position."""
    scene = _with_positions(survey)
    places = scene.world_from_rig.copy()
    places[:FIRST] = np.nan
    recipe = merged_settings(papers.colmap_alone()).tuning.sfm
    found = _joined(survey, scene=scene.with_(world_from_rig=places), tuning=TUNING if joins else recipe)
    (first,) = found.others
    assert found.first.placed and first.number == 0 and first.row()[0] == "sparse/0"
    assert (first.by, found.model.num_reg_images()) == (("matches", 40) if joins else ("", 16))
    said = "24 images of 1 models are not in the world frame: the recipe has no such step"
    assert [line[: len(said)] for line in found.by_hand()] == ([] if joins else [said])
    off = transforms.centre(image_poses(found.model, scene)) - transforms.centre(image_poses(survey[1], scene))
    assert 1e-4 < np.nanmedian(np.linalg.norm(off, axis=1)) < 0.06


@pytest.mark.slow
def test_one_place_for_all_frames_is_no_position(survey) -> None:
    """Phones write one place into all photographs of an object; the fit ended with an error."""
    scene = _with_positions(survey)
    there = scene.world_from_rig.copy()
    there[FIRST:, :3, 3] = [1.0, 2.0, 3.0]
    found = _joined(survey, NONE, scene.with_(world_from_rig=there))
    assert found.others[0].by == "" and "too few positions" in found.others[0].why_not
    settings = GeorefSettings()
    alone = georeference(survey[2][1], scene.with_(world_from_rig=there), settings, TUNING.world)
    assert not alone.placed
    assert "8 registered frames have a prior position (1 different ones)" in alone.findings.notes[0]


@pytest.mark.slow
def test_a_turn_about_the_track_that_is_open_keeps_a_model_out(survey) -> None:
    """Positions so loose that they tell the place and no turn."""
    found = _joined(survey, NONE, _with_positions(survey, sigma_m=5.0))
    assert found.others[0].by == "" and "do not determine the rotation about its track" in found.others[0].why_not
    assert found.model.num_reg_images() == 2 * FIRST


@pytest.mark.slow
def test_positions_that_contradict_the_matches_are_said(survey) -> None:
    right, wrong = (_joined(survey, scene=_with_positions(survey, moved)) for moved in (0.0, 3.0))
    assert right.others[0].by == wrong.others[0].by == "matches"
    assert not right.contradictions and right.others[0].off[0] < 0.1
    assert len(wrong.contradictions) == 1 and "matches were used" in wrong.contradictions[0]
    assert 1.5 < wrong.others[0].off[0] < 4.0
