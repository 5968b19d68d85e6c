"""The preview model on a simulated boat survey: it decides where it is right, and is not asked where it tore."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from boat_world import HALF_WIDTH_M, World, boat
from tiegraph.geometry import transforms
from tiegraph.network.model.survey import NO_MODEL, _judged, calibrated_rigs
from tiegraph.network.model.surveymodel import SurveyModel
from tiegraph.network.network import estimate_network
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.rig import Rig, Sensor

SETTINGS = NetworkSettings(sections="off")


def true_model(world: World, broken_at: int | None = None) -> SurveyModel:
    """A model with exact poses and points on both walls; with ``broken_at`` all frames of a pass from that step on are
    shifted by 60 m, which tears it."""
    scene = world.scene
    pose = world.world_from_sensor.copy()
    if broken_at is not None:
        pose[scene.step[scene.frame] >= broken_at, 0, 3] += 60.0
    rng = np.random.default_rng(0)
    x, z = rng.uniform(-15, 120, 6000), rng.uniform(-1, 9, 6000)
    points = np.stack([x, np.where(rng.random(6000) < 0.5, -1, 1) * HALF_WIDTH_M, z], axis=1)
    image, point = [], []
    for k, world_from_cam in enumerate(pose):
        local = transforms.apply(transforms.invert(world_from_cam), points)
        seen = (local[:, 2] > 1) & (np.abs(local[:, :2]) < [1.03, 0.77] * local[:, 2:]).all(axis=1)
        seen = np.flatnonzero(seen & (np.linalg.norm(local, axis=1) < 25))
        seen = rng.choice(seen, min(40, len(seen)), replace=False)
        image.append(np.full(len(seen), k)), point.append(seen)
    cameras = tuple(scene.all_sensors[k].camera for k in scene.sensor_key)
    return SurveyModel(
        transforms.invert(pose), cameras, points, np.concatenate(image), np.concatenate(point), scene.rigs
    )


def network_of(world: World, model: SurveyModel | None):
    asked = []

    def make(scene, ties):
        asked.append(ties)
        return model

    return estimate_network(world.scene, np.full(len(world.scene), 128.0), world.match, SETTINGS, make), asked


def shares(world: World, pairs) -> tuple[float, float]:
    """Recall and precision of the kept pairs against pairs that truly share a fifth of the view."""
    i, j = np.triu_indices(len(world.scene), k=1)
    useful = np.maximum(world.overlap(i, j), world.overlap(j, i)) >= 0.2
    kept = pairs.matrix(len(world.scene))[i, j] == 1
    return (kept & useful).sum() / useful.sum(), (kept & useful).sum() / kept.sum()


@pytest.fixture(scope="module")
def world() -> World:
    return boat((12, 12), (2.0, 2.0))


def test_the_model_finds_what_previews_miss(world) -> None:
    found, asked = network_of(world, true_model(world))
    recall, precision = shares(world, found.pairs)
    without, _ = network_of(world, None)
    assert precision > shares(world, without.pairs)[1]
    assert recall > 0.9
    assert np.any(found.pairs.from_source("model") & ~found.pairs.from_source("offsets"))
    assert 0 < len(asked[0]) < 0.5 * len(world.scene) ** 2 / 2
    assert asked[0].counts().min() >= 15
    assert found.trusted.all()


def test_pairs_that_share_nothing_are_dropped_with_their_reason(world) -> None:
    found, _ = network_of(world, true_model(world))
    gone = found.pairs.where(found.pairs.overlap < SETTINGS.min_overlap)
    assert len(gone) and np.all(gone.dropped != 0)
    assert found.pairs.funnel().get("overlap", 0) > 0


def test_a_torn_model_is_not_asked_at_the_tear(world) -> None:
    whole, _ = network_of(world, true_model(world))
    torn, _ = network_of(world, true_model(world, broken_at=6))
    at_tear = np.isin(world.scene.step[world.scene.frame], (5, 6))
    assert not torn.trusted[at_tear].any()
    assert any("not believed" in note for note in torn.notes)
    near = torn.pairs.where(at_tear[torn.pairs.i] & at_tear[torn.pairs.j])
    assert np.sum(near.dropped == 0) > 20
    assert whole.trusted.all()


def test_copies_of_a_picture_stay_out_though_they_share_all_their_surface(world) -> None:
    model = true_model(world)
    overlap = model.overlap()
    best = int(np.argmax(overlap.share))
    twin = np.array([overlap.i[best]]), np.array([overlap.j[best]])
    copy = Pairs.make(*twin, "offsets", dropped=np.array([REASONS.index("similar")]))
    judged = _judged(copy, overlap, np.where(model.placed(), 0, -1), SETTINGS)
    assert judged.dropped[(judged.i == twin[0]) & (judged.j == twin[1])].tolist() == [REASONS.index("similar")]
    assert len(judged.kept()) > 100


def test_without_a_model_counts_decide(world) -> None:
    found, _ = network_of(world, None)
    assert NO_MODEL in found.notes
    assert found.model is None and not found.trusted.any()


def test_only_what_was_guessed_is_calibrated() -> None:
    guessed = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[768.0, 320, 240])
    known = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[310.0, 320, 240])
    known.has_prior_focal_length = True
    found = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[305.0, 318, 241])
    turn = transforms.rigid(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([0.1, 0.0, 0.2]))
    nominal = transforms.rigid(np.eye(3), np.array([0.3, 0.0, 0.0]))
    rig = Rig("r", (Sensor("a", guessed, np.eye(4)), Sensor("b", known, nominal)), nominal=True)
    model = Rig("r", (Sensor("a", found, np.eye(4)), Sensor("b", found, turn)))
    (out,), notes = calibrated_rigs([rig], [model])
    assert out.sensors[0].camera.params[0] == 305.0
    assert out.sensors[1].camera.params[0] == 310.0
    assert np.allclose(out.sensors[1].sensor_from_rig[:3, :3], turn[:3, :3])
    assert np.allclose(transforms.centre(out.sensors[1].sensor_from_rig), transforms.centre(nominal))
    assert "90.00 deg" in notes[0]
    (kept,), said = calibrated_rigs([replace(rig, nominal=False)], [model])
    assert np.allclose(kept.sensors[1].sensor_from_rig, nominal) and said == ()
