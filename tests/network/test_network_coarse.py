"""The coarse model: it decides where it is right, is not asked where it tore, and has points of all tracks."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from boat_world import HALF_WIDTH_M, World, boat
from boat_world import found as shares
from network_steps import network_of as steps_of
from tiegraph.geometry import transforms
from tiegraph.network.coarse.model import CoarseModel, explained, with_surface
from tiegraph.network.coarse.search import NO_MODEL, _judged, calibrated_rigs
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import CourseTuning, Tuning
from tiegraph.scene.pairs import REASONS, Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor

SETTINGS, TUNING = CandidatesSettings(), Tuning()


def true_model(world: World, broken_at: int | None = None, shifted_m: float = 0.0) -> CoarseModel:
    """A model with exact poses and points on both walls; with ``broken_at`` all frames of a pass from that step on are
    shifted by 60 m, which tears it; with ``shifted_m`` the whole second pass is shifted along the canal."""
    scene = world.scene
    pose = world.world_from_sensor.copy()
    if broken_at is not None:
        pose[scene.sequence_index[scene.frame] >= broken_at, 0, 3] += 60.0
    pose[scene.sequence[scene.frame] == 1, 0, 3] += shifted_m
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
    return CoarseModel(
        transforms.invert(pose), cameras, points, np.concatenate(image), np.concatenate(point), scene.rigs
    )


def network_of(world: World, model: CoarseModel | Callable[[], CoarseModel] | None, settings=SETTINGS):
    """The network with a model, the same each time or the next one; the ties that the models were made of."""
    asked = []

    def make(scene, ties):
        asked.append(ties)
        return model() if callable(model) else model

    return steps_of(world.scene, world.match, settings, make=make, sections="off"), asked


@pytest.fixture(scope="module")
def world() -> World:
    return boat((12, 12), (2.0, 2.0))


@pytest.fixture(scope="module")
def believed(world):
    """The network by a right model, and what the models were made of."""
    return network_of(world, true_model(world))


@pytest.mark.slow
def test_the_model_finds_what_counts_miss_that_decide_without_one(world, believed) -> None:
    found, asked = believed
    recall, precision = shares(found.pairs, world.useful(0.2))
    without, _ = network_of(world, None)
    assert NO_MODEL in without.notes and without.coarse.model is None and not without.trusted.any()
    assert precision > shares(without.pairs, world.useful(0.2))[1] and recall > 0.9
    assert np.any(found.pairs.from_source("model") & ~found.pairs.from_source("offsets"))
    assert 0 < len(asked[0]) < 0.5 * len(world.scene) ** 2 / 2 and asked[0].counts().min() >= 15
    assert found.trusted.all()
    gone = found.pairs.where(found.pairs.overlap < SETTINGS.min_overlap)
    assert len(gone) and np.all(gone.dropped != 0) and found.pairs.funnel().get("overlap", 0) > 0


@pytest.mark.slow
def test_a_torn_model_is_made_again_and_believed_on_one_side_of_the_tear(world, believed) -> None:
    whole, once = believed
    torn, asked = network_of(world, true_model(world, broken_at=7))
    assert len(once) == 1 and len(asked) == TUNING.coarse.tries
    step = world.step
    assert torn.trusted[step < 7].all() and not torn.trusted[step >= 7].any()
    assert any("not used at" in note for note in torn.notes)
    assert any(f"made {TUNING.coarse.tries} times" in note for note in torn.notes)
    across = (step[torn.pairs.i] >= 7) != (step[torn.pairs.j] >= 7)
    assert np.isnan(torn.pairs.overlap[across]).all()
    assert np.sum(across & (torn.pairs.dropped == 0)) > 20 and whole.trusted.all()


@pytest.mark.slow
def test_a_model_is_made_again_until_it_holds(world) -> None:
    models = iter((true_model(world, broken_at=7), true_model(world)))
    found, asked = network_of(world, lambda: next(models))
    assert len(asked) == 2 and found.trusted.all()
    assert any("made 2 times" in note for note in found.notes)


@pytest.mark.slow
def test_a_pass_put_some_metres_further_is_noticed_and_made_again_without_what_drew_it_there(world) -> None:
    elsewhere, track = world.world_from_sensor.copy(), world.track
    elsewhere[track == 1, 0, 3] += 30.0
    world = replace(world, alike=World(world.scene, elsewhere))
    folded = true_model(world, shifted_m=30.0)
    found, asked = network_of(world, folded)
    assert len(asked) == TUNING.coarse.tries and len(asked[1]) < len(asked[0])
    assert len(np.unique(track[found.trusted])) == 1
    across = track[found.pairs.i] != track[found.pairs.j]
    assert np.isnan(found.pairs.overlap[across]).all()
    models = iter((folded, true_model(world)))
    found, asked = network_of(world, lambda: next(models))
    assert found.trusted.all() and len(asked) == 2


def turned_by(model: CoarseModel, degrees: float) -> CoarseModel:
    """The model with the mounting of its second camera turned, and the images of that camera with it."""
    turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    one = model.rigs[0].sensors[1]
    sensor = replace(one, sensor_from_rig=transforms.rigid(turn, np.zeros(3)) @ one.sensor_from_rig)
    sensors = (model.rigs[0].sensors[0], sensor, *model.rigs[0].sensors[2:])
    return replace(model, rigs=(replace(model.rigs[0], sensors=sensors),))


@pytest.mark.slow
def test_a_camera_that_only_one_model_turns_far_is_made_again(world, believed) -> None:
    right, (once, _) = true_model(world), believed
    models = iter((turned_by(right, 55.0), right))
    found, asked = network_of(world, lambda: next(models))
    assert len(asked) == 2 and found.trusted.all() and len(found.ties) == len(once.ties)
    assert any("rotated a camera of the rig too far" in note for note in found.notes)
    # Two models that agree are right: it is the nominal rig that is wrong.
    found, asked = network_of(world, turned_by(right, 55.0))
    assert len(asked) == 2 and found.trusted.all()
    mounted = found.scene.rigs[0].sensors[1].sensor_from_rig
    assert transforms.angle_deg(mounted[:3, :3], world.scene.rigs[0].sensors[1].sensor_from_rig[:3, :3]) > 54


@pytest.mark.slow
def test_a_camera_that_every_model_turns_otherwise_stays_as_given_and_is_not_believed(world) -> None:
    models = iter(turned_by(true_model(world), d) for d in (55.0, 35.0, 75.0, 20.0))
    found, asked = network_of(world, lambda: next(models))
    second = world.scene.sensor == 1
    assert len(asked) == TUNING.coarse.tries
    assert not found.trusted[second].any() and found.trusted[~second].all()
    assert np.array_equal(*(s.rigs[0].sensors[1].sensor_from_rig for s in (found.scene, world.scene)))
    assert any("not used for cam1" in note for note in found.notes)


@pytest.mark.slow
def test_frames_of_one_camera_that_follow_each_other_always_tie_the_model(world, believed) -> None:
    (_, asked), scene = believed, world.scene
    track, step = scene.sequence[scene.frame], scene.sequence_index[scene.frame]
    i, j = asked[0].i, asked[0].j
    near = (track[i] == track[j]) & (scene.sensor_key[i] == scene.sensor_key[j]) & (np.abs(step[i] - step[j]) == 1)
    a, b = np.triu_indices(len(scene), k=1)
    possible = (track[a] == track[b]) & (scene.sensor_key[a] == scene.sensor_key[b]) & (np.abs(step[a] - step[b]) == 1)
    possible &= world.overlap(a, b) >= 0.5
    assert near.sum() >= 0.9 * possible.sum()


@pytest.mark.slow
def test_copies_of_a_picture_stay_out_though_they_share_all_their_surface(world) -> None:
    model = true_model(world)
    overlap = model.overlap(SETTINGS.axes_deg, TUNING.coarse)
    best = int(np.argmax(overlap.share))
    twin = np.array([overlap.i[best]]), np.array([overlap.j[best]])
    copy = Pairs.make(*twin, "offsets", dropped=np.array([REASONS.index("similar")]))
    judged = _judged(copy, overlap, np.where(model.placed(), 0, -1), SETTINGS)
    assert judged.dropped[(judged.i == twin[0]) & (judged.j == twin[1])].tolist() == [REASONS.index("similar")]
    assert len(judged.kept()) > 100


@pytest.mark.slow
def test_one_limit_of_the_angle_holds_for_axes_and_for_the_views_of_a_surface(world) -> None:
    model = true_model(world)
    wide = model.overlap(180.0, TUNING.coarse)
    for limit, steeper in ((110.0, True), (50.0, False)):
        found, _ = network_of(world, model, SETTINGS.model_copy(update={"axes_deg": limit}))
        kept = found.pairs.matrix(len(world.scene))[wide.i, wide.j] == 1
        assert np.any(kept & (wide.angle_deg > 55)) == steeper


def lens(focal: float, x: float, y: float, known: bool = False) -> pycolmap.Camera:
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[focal, x, y])
    camera.has_prior_focal_length = known
    return camera


def test_only_what_was_guessed_is_calibrated() -> None:
    guessed, given, found = lens(768, 320, 240), lens(310, 321.5, 240, known=True), lens(305, 318, 241)
    turn = transforms.rigid(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([0.1, 0.0, 0.2]))
    nominal = transforms.rigid(np.eye(3), np.array([0.3, 0.0, 0.0]))
    rig = Rig("r", (Sensor("a", guessed, np.eye(4)), Sensor("b", given, nominal)), nominal=True)
    model = Rig("r", (Sensor("a", found, np.eye(4)), Sensor("b", found, turn)))

    def calibrated(rig: Rig) -> tuple[Rig, tuple[str, ...]]:
        (out,), notes = calibrated_rigs([rig], [model], TUNING.coarse.most_focal)
        return out, notes

    out, notes = calibrated(rig)
    assert [s.camera.params[0] for s in out.sensors] == [305.0, 310.0]
    assert np.allclose(out.sensors[1].sensor_from_rig[:3, :3], turn[:3, :3])
    assert np.allclose(transforms.centre(out.sensors[1].sensor_from_rig), transforms.centre(nominal))
    assert "90.00 deg" in notes[0]
    for sheet_px, focal in ((320.0, 305.0), (600.0, 600.0)):  # of a data sheet; far from what the model found
        one = replace(rig, sensors=(Sensor("a", lens(sheet_px, 320, 240, known=True), np.eye(4)),))
        camera = calibrated(one)[0].sensors[0].camera
        assert camera.params[0] == focal and camera.has_prior_focal_length == (focal == 600.0)
    kept, said = calibrated(replace(rig, nominal=False))
    assert np.allclose(kept.sensors[1].sensor_from_rig, nominal) and said == ()


CAMERA = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 500.0, 640, 480)
IMAGES, POINTS = 5, 40
TRACKS = CourseTuning()


@pytest.fixture
def street():
    """Five images a metre apart before a wall at ten metres: model without points, ties, pixels, true points."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2, 6, POINTS), rng.uniform(-3, 3, POINTS), rng.uniform(9, 11, POINTS)])
    centres = np.column_stack([np.arange(IMAGES), np.zeros(IMAGES), np.zeros(IMAGES)])
    poses = transforms.rigid(np.repeat(np.eye(3)[None], IMAGES, axis=0), -centres)
    pixels = [CAMERA.img_from_cam(points - c) for c in centres]
    none = np.zeros(0, int)
    model = CoarseModel(poses, (CAMERA,) * IMAGES, np.zeros((0, 3)), none, none, ())
    i, j = np.triu_indices(IMAGES, 1)
    own = np.column_stack([np.arange(POINTS)] * 2)
    return model, PreviewMatches.make(i, j, [own] * len(i)), pixels, points


def made(street, tuning=TRACKS):
    model, ties, pixels, _ = street
    return with_surface(model, ties, lambda k: pixels[k], tuning)


def test_points_stand_where_the_rays_meet_and_a_ray_that_misses_is_left_out(street):
    found = made(street)
    assert len(found.points) == POINTS and len(found.image) == POINTS * IMAGES
    nearest = np.linalg.norm(found.points[:, None] - street[3][None], axis=2).min(axis=0)
    assert 0 <= nearest.max() < 1e-5 and np.all(np.bincount(found.point) == IMAGES)
    street[2][2][7] += 60  # 7 degrees
    found = made(street)
    assert len(found.points) == POINTS and len(found.image) == POINTS * IMAGES - 1
    assert np.linalg.norm(found.points[:, None] - street[3][None], axis=2).min(axis=0).max() < 1e-5


@pytest.mark.parametrize(("tuning", "kept"), [({"tolerance_deg": 1.0}, POINTS), ({"tolerance_deg": 40.0}, 0)])
def test_a_point_needs_rays_that_are_apart(street, tuning, kept):
    assert len(made(street, TRACKS.model_copy(update=tuning)).points) == kept


def test_tracks_that_hold_an_image_twice_are_no_points(street):
    model, ties, pixels, _ = street
    wrong = ties.matches.copy()
    wrong[0] = 0, 1  # joins the tracks of two points
    joined = PreviewMatches(i=ties.i, j=ties.j, start=ties.start, matches=wrong)
    found = with_surface(model, joined, lambda k: pixels[k], TRACKS)
    assert len(found.points) == POINTS - 2
    assert not len(with_surface(model, PreviewMatches.empty(), lambda k: pixels[k], TRACKS).points)


def test_what_lies_behind_and_images_that_are_not_placed_make_no_points(street):
    model, ties, pixels, points = street
    poses = model.cam_from_world.copy()
    poses[:2] = np.nan
    found = with_surface(replace(model, cam_from_world=poses), ties, lambda k: pixels[k], TRACKS)
    assert set(found.image) == {2, 3, 4} and len(found.points) == POINTS
    turned = poses @ np.diag([1.0, 1, 1, 1])
    turned[2:, :3, 3] *= -1  # rays meet behind the cameras
    assert not len(with_surface(replace(model, cam_from_world=turned), ties, lambda k: pixels[k], TRACKS).points)


def test_a_model_explains_the_matches_of_the_images_it_has_in_their_places(street):
    _, ties, pixels, _ = street
    model = made(street)

    def agree(model: CoarseModel) -> list[bool]:
        of = ties.i, ties.j
        return explained(
            model, of, lambda i, j: ties.of(int(ties.find([i], [j])[0])), lambda k: pixels[k], CourseTuning()
        ).tolist()

    assert all(agree(model))
    # The last image 18 m back: its epipolar lines are the same, but the points are behind it or much too far away.
    back = model.cam_from_world.copy()
    back[4, 0, 3] += 18
    torn = replace(model, cam_from_world=back)
    assert agree(torn) == [j != 4 for j in ties.j.tolist()]
    blind = replace(torn, image=torn.image[torn.image != 4], point=torn.point[torn.image != 4])  # sees no point
    assert agree(blind) == agree(torn)
    assert not any(agree(replace(model, image=model.image[:0], point=model.point[:0])))
