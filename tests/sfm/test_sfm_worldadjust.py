"""How the adjustment in the world is solved: what is eliminated, and where it begins."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sfm_worlds import make_world, true_frames, with_positions

from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.ties import moved
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world import georeferencing, worldadjust
from tiegraph.sfm.world.fixes import Measurements, make_fixes
from tiegraph.sfm.world.georef import georeference
from tiegraph.sfm.world.georeferencing import georeference_model
from tiegraph.sfm.world.worldadjust import ConstantParameters, Constraints, Receiver

import pycolmap  # isort: skip

TUNING = Tuning()
WORLD = TUNING.world


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=2, frames=24)


@pytest.mark.parametrize("unknown", [(True, False), (True, True), (False, True), (False, False)])
def test_only_points_are_eliminated_before_the_poses(world, monkeypatch, unknown) -> None:
    """A lever arm or a clock eliminated with them couples the poses of all positions: a full matrix."""
    truth, scene = world
    solved = _watched(monkeypatch)
    model = _short_tracks(truth, 8)
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3], 0.05)
    receiver = Receiver(np.zeros(3), 0.0, free_antenna=unknown[0], free_offset=unknown[1])
    given = Constraints(
        fixes=make_fixes(survey, np.ones(scene.frames, bool), Measurements(), WORLD.fixes),
        factor=np.ones(scene.frames),
        receiver=receiver,
        held=ConstantParameters(),
        tuning=TUNING,
    )
    worldadjust.adjust_in_world(model, survey, given, 1)
    assert [s.schur_structure_used for s in solved] == ["2,3,d"]  # rows of two: sightings, of points only
    order = re.search(r"Linear solver ordering +AUTOMATIC +(\d+),", solved[0].FullReport())
    assert order is not None and int(order[1]) == model.num_points3D()


def test_the_rounds_begin_where_the_check_ended(world, monkeypatch) -> None:
    """What the positions bend is bent once: with all of them little is left to do, from the similarity all of it."""
    truth, scene = world
    solved = _watched(monkeypatch)
    curve = np.outer(np.sin(np.pi * np.arange(scene.frames) / scene.frames), [0.0, 0.0, 0.4])
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3] + curve, 1.0)
    found, placed = georeference_model(truth, survey, GeorefSettings(adjust="yes", antenna="ignored"), TUNING)
    points, check, *rounds = (s.initial_cost - s.final_cost for s in solved)
    assert found.adjusted and 1 <= len(rounds) <= WORLD.adjustment.rounds
    assert sum(rounds) < 0.3 * check
    off = np.linalg.norm(_centres(placed, scene) - _centres(truth, scene), axis=1)
    assert 0.02 < np.sqrt(np.mean(off**2)) < 0.28


@pytest.mark.parametrize(("same", "rounds"), [(WORLD.adjustment.same_factor, 1), (1e-5, 2)])
def test_another_round_is_made_only_where_the_positions_weigh_otherwise_now(world, monkeypatch, same, rounds):
    """Their sigmas times 1.39 before and 1.40 after the first: nothing moves any more."""
    truth, scene = world
    solved = _watched(monkeypatch)
    adjustment = WORLD.adjustment.model_copy(update={"same_factor": same})
    tuning = TUNING.model_copy(update={"world": WORLD.model_copy(update={"adjustment": adjustment})})
    curve = np.outer(np.sin(np.pi * np.arange(scene.frames) / scene.frames), [0.0, 0.0, 0.4])
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3] + curve, 0.05)
    georeference_model(truth, survey, GeorefSettings(adjust="yes", antenna="ignored"), tuning)
    assert len(solved) == 2 + rounds, "points, check, rounds"


def test_the_check_leaves_its_model_where_all_positions_put_it(world, monkeypatch) -> None:
    """Positions of a metre would not bring it back from where four fifths of them put it: the solver stops before."""
    truth, scene = world
    noise = np.random.default_rng(3).standard_normal((scene.frames, 3))
    survey = with_positions(scene, true_frames(truth, scene)[:, :3, 3] + noise, 1.0)
    settings = GeorefSettings(adjust="yes", antenna="ignored")
    made, check = [], georeferencing._check

    def kept(*given):
        made.append(check(*given))
        return made[-1]

    monkeypatch.setattr(georeferencing, "_check", kept)
    georeference_model(truth, survey, settings, TUNING)
    first = georeference(truth, survey, settings, WORLD)
    assert first.placing is not None and first.placing.held_out is not None
    models = (moved(truth, first.placing.held_out.similarity), made[0].model)
    off = [np.linalg.norm(np.mean(_centres(m, scene) - _centres(first.apply(truth), scene), axis=0)) for m in models]
    assert 0.2 < off[0] < 0.4 and off[1] < 0.1


def _centres(model, scene) -> np.ndarray:
    return frame_poses(image_poses(model, scene), scene)[:, :3, 3]


def _watched(monkeypatch) -> list:
    """What Ceres says of each adjustment from now on, in their order."""
    solved, create = [], pycolmap.create_default_ceres_bundle_adjuster

    def watched(*given):
        adjuster = create(*given)

        class Watched:
            problem = adjuster.problem

            def solve(self):
                solved.append(adjuster.solve().ceres_summary)

        return Watched()

    monkeypatch.setattr(pycolmap, "create_default_ceres_bundle_adjuster", watched)
    return solved


def _short_tracks(truth, frames: int):
    """The model with each point seen from so many frames in a row, as on a way of some length."""
    model = pycolmap.Reconstruction(truth)
    place = {f: k for k, f in enumerate(sorted(model.reg_frame_ids()))}
    for n, key in enumerate(sorted(model.point3D_ids())):
        first = n % (len(place) - frames + 1)
        for image_id, feature in [(e.image_id, e.point2D_idx) for e in model.point3D(key).track.elements]:
            if not first <= place[model.image(image_id).frame_id] < first + frames:
                model.delete_observation(image_id, feature)
    return model
