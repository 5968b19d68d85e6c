"""The information of a bundle adjustment over foreseen tracks: against differences of projections, and what it buys."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.design.bundle import Bundle, _projected
from tiegraph.design.design import design
from tiegraph.design.matchprediction import predict_matches, verified_chance
from tiegraph.design.predict import joined
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tracks import Candidates, Tracks
from tiegraph.design.tuning import Tuning
from tiegraph.scene.matches import PreviewMatches, Visibility
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene

FOCAL = 500.0
TUNING = Tuning()


def rig(cameras: int, nominal: bool) -> Rig:
    """Cameras fanned out by 45 degrees, side by side."""
    params = [FOCAL, FOCAL, 300.0 if nominal else 301.0, 200.0]
    camera = pycolmap.Camera(model="PINHOLE", width=600, height=400, params=params)
    camera.has_prior_focal_length = not nominal
    sensors = []
    for k in range(cameras):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_euler("y", 45.0 * k, degrees=True).as_matrix()
        turn[:3, 3] = [0.1 * k, 0.0, 0.05 * k]
        sensors.append(Sensor(f"cam{k}", camera, turn, folder=f"cam{k}"))
    return Rig("fan", tuple(sensors), fixed=not nominal, nominal=nominal)


def survey(frames: int, nominal: bool, cameras: int = 2, points: int = 900) -> tuple[Scene, Visibility]:
    """Frames on a line past a wall, two metres apart, with what each image sees of it."""
    head, rng = rig(cameras, nominal), np.random.default_rng(0)
    names = tuple(f"{f:03d}_cam{s}.jpg" for f in range(frames) for s in range(cameras))
    xyz = rng.uniform((-12, -4, 8), (2 * frames + 12, 4, 14), (points, 3))
    poses = []
    for f in range(frames):
        world = np.eye(4)
        world[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.05, 3)).as_matrix()
        world[:3, 3] = [2.0 * f, *rng.normal(0, 0.1, 2)]
        poses += [s.sensor_from_rig @ np.linalg.inv(world) for s in head.sensors]
    cam = np.stack(poses)
    seen = []
    for pose in cam:
        local = xyz @ pose[:3, :3].T + pose[:3, 3]
        pixel = FOCAL * local[:, :2] / local[:, 2:]
        seen.append(np.flatnonzero((local[:, 2] > 1) & (np.abs(pixel) < [300, 200]).all(axis=1)))
    centre = -np.einsum("nji,nj->ni", cam[:, :3, :3], cam[:, :3, 3])
    start = np.cumsum([0] + [len(s) for s in seen])
    sights = Visibility(start, np.concatenate(seen), xyz, centre, cam[:, :3, :3])
    frame = np.repeat(np.arange(frames), cameras)
    step, nothing = np.arange(frames), np.zeros(frames, int)
    scene = Scene(
        rigs=(head,),
        names=names,
        frame=frame,
        sensor=np.tile(np.arange(cameras), frames),
        rig=nothing,
        sequence=nothing,
        sequence_index=step,
        time_s=np.full(frames, np.nan),
        world_from_rig=np.full((frames, 4, 4), np.nan),
        position_sigma_m=np.full((frames, 3), np.nan),
        section=np.full(frames, -1),
        sequences=("a",),
    )
    return scene, sights


def all_pairs(scene: Scene, sights: Visibility) -> tuple[Pairs, PreviewMatches, np.ndarray]:
    i, j = np.triu_indices(len(scene), 1)
    common = [len(np.intersect1d(sights.of(a), sights.of(b))) for a, b in zip(i, j)]
    near = np.array(common) >= 8
    i, j = i[near], j[near]
    found = predict_matches(i, j, np.full(len(i), np.nan), sights, TUNING.match_prediction)
    return Pairs.make(i, j, "offsets", score=found.expected), found.matches[0], found.expected


def made(nominal: bool, frames: int = 3, points: int = 900) -> tuple[Scene, Visibility, Candidates, PreviewMatches]:
    scene, sights = survey(frames, nominal, points=points)
    pairs, ties, expected = all_pairs(scene, sights)
    return scene, sights, Candidates.make(pairs.i, pairs.j, np.nan_to_num(expected, nan=1.0), ties, len(scene)), ties


def projected(scene: Scene, sights: Visibility, image: int, xyz: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Pixels of points in an image, the unknowns moved by x: six a frame, then the cameras (the second one's six of its
    place before its four)."""
    frames = scene.frames
    first = 2 * scene.frame[image]  # its reference image
    own = x[6 * scene.frame[image] :][:6]
    axes = sights.rotation[first]  # rig from world
    in_rig = axes @ Rotation.from_rotvec(-own[3:]).as_matrix() @ (xyz - sights.centre[first] - own[:3]).T
    turn = axes @ np.asarray(sights.rotation[image]).T  # rig from sensor
    lever = axes @ (sights.centre[image] - sights.centre[first])
    moved = np.zeros(6) if scene.sensor[image] == 0 else x[6 * frames + 4 :][:6]
    local = turn.T @ Rotation.from_rotvec(-moved[3:]).as_matrix() @ (in_rig - lever[:, None] - moved[:3, None])
    f, cx, cy, k = x[6 * frames + 10 * scene.sensor[image] :][:4]
    flat = local[:2] / local[2]
    return ((FOCAL + f) * flat * (1 + k * np.sum(flat**2, axis=0)) + np.array([[cx], [cy]])).T


@pytest.mark.slow
def test_the_normal_equations_are_those_of_the_projections() -> None:
    scene, sights, candidates, ties = made(nominal=True, points=90)
    tracks = Tracks(candidates, TUNING.net)
    tracks.join(np.arange(len(candidates)))
    bundle = Bundle(candidates, ties, sights, scene, TUNING.bundle)
    normal = bundle.normal(tracks)
    size = 6 * 3 + 6 + 2 * 4
    assert normal.shape == (size, size)
    label = tracks.parent
    want, sigma = np.zeros((size, size)), 0.5
    image = np.repeat(np.arange(6), np.diff(candidates.first))
    point, _ = bundle._nodes(ties)
    for track in np.unique(label):
        nodes = np.flatnonzero(label == track)
        if len(nodes) < 2:
            continue
        assert len(set(point[nodes])) == 1
        xyz = sights.xyz[point[nodes[0]]]

        def residual(x: np.ndarray, nodes: np.ndarray = nodes, xyz: np.ndarray = xyz) -> np.ndarray:
            place = (xyz + x[size:])[None]
            return np.concatenate([projected(scene, sights, image[n], place, x[:size])[0] for n in nodes]) / sigma

        step = 1e-4
        rows = [(residual(step * e) - residual(-step * e)) / (2 * step) for e in np.eye(size + 3)]
        jacobian = np.stack(rows, axis=1)
        a, b = jacobian[:, :size], jacobian[:, size:]
        want += a.T @ a - a.T @ b @ np.linalg.solve(b.T @ b, b.T @ a)
    scale = np.sqrt(np.diag(want))
    np.testing.assert_allclose(normal / scale[:, None] / scale, want / scale[:, None] / scale, atol=2e-5)


def test_a_calibrated_rig_has_no_unknowns_of_its_own() -> None:
    scene, sights, candidates, ties = made(nominal=False)
    tracks = Tracks(candidates, TUNING.net)
    tracks.join(np.arange(len(candidates)))
    assert Bundle(candidates, ties, sights, scene, TUNING.bundle).normal(tracks).shape == (18, 18)


def test_a_pair_gains_what_its_equations_take_from_the_variance() -> None:
    scene, sights, candidates, ties = made(nominal=True, frames=6)
    bundle, tracks = Bundle(candidates, ties, sights, scene, TUNING.bundle), Tracks(candidates, TUNING.net)
    tracks.join(np.arange(0, len(candidates), 2))
    normal = bundle.normal(tracks)
    before = bundle.covariance(normal)
    place, worth = np.array([1, 3, 7]), np.array([40.0, 5.0, 80.0])
    gains = bundle.gains(before, place, worth)
    for k in range(3):
        after = bundle.covariance(bundle.add(normal, place[k : k + 1], worth[k : k + 1]))
        fall = (bundle.variances(before) - bundle.variances(after)).mean() * bundle._unit[0] ** 2
        assert gains[k] == pytest.approx(fall, rel=1e-3) and fall > 0
    assert np.all(bundle.gains(before, place, 2 * worth) > gains)


@pytest.mark.slow
def test_the_choice_knows_what_the_images_share() -> None:
    scene, sights = survey(12, True, cameras=3, points=1500)
    pairs, _, expected = all_pairs(scene, sights)
    ties = predict_matches(
        pairs.i, pairs.j, np.full(len(pairs), np.nan), sights, TUNING.match_prediction, (1,)
    ).matches[0]
    again = Candidates.make(pairs.i, pairs.j, expected, ties, len(scene))
    judge = Bundle(again, ties, sights, scene, TUNING.bundle)

    def sigma(own: Visibility | None) -> float:
        settings = DesignSettings(budget="pairs", pairs_per_image=3)
        chosen = design(pairs, scene, None, settings, TUNING, own).pairs.dropped == 0
        return float(np.sqrt(judge.variances(judge.covariance(judge.normal(joined(again, chosen, TUNING.net)))).mean()))

    assert sigma(sights) < 0.98 * sigma(replace(sights, rotation=None))


@pytest.mark.slow
def test_a_stricter_loss_costs_pairs_and_the_loss_is_kept_to() -> None:
    scene, sights = survey(10, True)
    pairs, _, _ = all_pairs(scene, sights)
    kept = []
    for loss in (2.0, 5.0, 60.0):
        found = design(pairs, scene, None, DesignSettings(loss_percent=loss), TUNING, sights)
        assert 0 <= found.counts["preview_loss_percent"] <= loss
        kept.append(len(found.pairs.kept()))
    assert kept[0] > kept[1] > kept[2] >= len(scene) - 1


def test_images_outside_the_preview_model_are_tied_all_the_same() -> None:
    scene, sights = survey(10, True)
    pairs, _, _ = all_pairs(scene, sights)
    centre, rotation = np.array(sights.centre), np.array(sights.rotation)
    centre[13], rotation[13] = np.nan, np.nan
    outside = Visibility(sights.start, sights.point, sights.xyz, centre, rotation)
    found = design(pairs, scene, None, DesignSettings(loss_percent=10.0), TUNING, outside)
    assert found.pairs.degree(len(scene))[13] >= 1
    assert len(found.pairs.kept()) < len(pairs)


def test_chance_of_verification_rises_with_the_matches() -> None:
    chance = verified_chance(np.array([1.0, 7.5, 15.0, 100.0]), TUNING.match_prediction)
    assert chance[0] < 0.03 and chance[1] == 0.5 and 0.7 < chance[2] < 0.9 and chance[3] > 0.99


def test_rays_are_projected_as_their_derivatives_say_at_any_angle() -> None:
    rng = np.random.default_rng(3)
    local = rng.normal(size=(400, 3)) * [1, 1, 1.5]
    (x, y), slope = _projected(local, TUNING.bundle)
    step = 1e-6
    for axis in range(3):
        ends = [np.array(_projected(local + sign * step * np.eye(3)[axis], TUNING.bundle)[0]) for sign in (1, -1)]
        numeric = ((ends[0] - ends[1]) / (2 * step)).T
        same = np.linalg.norm(numeric, axis=1) < 1e3  # but for one that crosses from pinhole to fisheye
        assert same.mean() > 0.98
        np.testing.assert_allclose(slope[same, :, axis], numeric[same], rtol=1e-4, atol=1e-5)
    assert np.hypot(x, y).max() < 5.0  # a pinhole's run to infinity


def test_a_preview_model_that_holds_nothing_costs_no_pair() -> None:
    scene, sights = survey(10, True)
    pairs, _, _ = all_pairs(scene, sights)
    few = np.isin(sights.point, np.unique(sights.point)[:3])
    count = np.array([few[a:b].sum() for a, b in zip(sights.start[:-1], sights.start[1:])])
    poor = replace(sights, start=np.cumsum([0, *count]), point=sights.point[few])
    found = design(pairs, scene, None, DesignSettings(loss_percent=5.0), TUNING, poor)
    assert len(found.pairs.kept()) == len(pairs)
    assert found.counts["preview_loss_percent"] == 0
