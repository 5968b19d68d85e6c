"""Focal lengths of unknown cameras: found from relative poses, and left alone where these do not determine them."""

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world

from tiegraph.scene.rig import Sensor
from tiegraph.scene.scene import Scene
from tiegraph.sfm.focal import focal_lengths, with_focal_lengths
from tiegraph.sfm.tuning import FocalTuning

SIZE = 480, 360
Pairs = list[tuple[np.ndarray, np.ndarray]]


def views(
    focal: float, rng: np.random.Generator, turn_deg: float = 10.0, flat: bool = False
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Matches of pairs whose second camera moved by about a unit and turned, with 0.3 px of noise; ``flat``: of a
    plane straight ahead."""
    centre = np.array(SIZE) / 2
    while True:
        depth = np.full(150, 6.0) if flat else rng.uniform(3, 12, 150)
        points = np.column_stack([(rng.uniform(0, 1, (150, 2)) * SIZE - centre) / focal, np.ones(150)]) * depth[:, None]
        turn = Rotation.from_rotvec(np.radians(turn_deg) * rng.normal(size=3)).as_matrix()
        other = points @ turn.T + rng.normal(size=3)
        ahead = other[:, 2] > 0.5
        a, b = (focal * p[ahead, :2] / p[ahead, 2:] + centre for p in (points, other))
        seen = ((b > 0) & (b < SIZE)).all(axis=1)
        if seen.sum() >= 40:
            yield tuple(x[seen] + rng.normal(0, 0.3, (int(seen.sum()), 2)) for x in (a, b))


def focal_length(pairs: Pairs, size: tuple[int, int], tuning: FocalTuning) -> float | None:
    """That of one camera."""
    return focal_lengths({(0, 0): pairs}, size, tuning).get(0)


def some(count: int, seed: int = 0, focal: float = 400.0, turn_deg: float = 10.0, flat: bool = False) -> Pairs:
    found = views(focal, np.random.default_rng(seed), turn_deg, flat)
    return [next(found) for _ in range(count)]


@pytest.mark.parametrize("share", [0.45, 0.8, 1.4])
def test_the_focal_length_of_a_wide_and_of_a_long_lens_is_found(share: float) -> None:
    for seed in range(3):
        found = focal_length(some(40, seed, share * SIZE[0]), SIZE, FocalTuning())
        assert found == pytest.approx(share * SIZE[0], rel=0.12)


def test_false_pairs_do_not_move_it() -> None:
    rng = np.random.default_rng(1)
    wrong = [(rng.uniform(0, 1, (60, 2)) * SIZE, rng.uniform(0, 1, (60, 2)) * SIZE) for _ in range(20)]
    assert focal_length(some(30) + wrong, SIZE, FocalTuning()) == pytest.approx(400, rel=0.12)


def test_views_of_a_plane_do_not_determine_it() -> None:
    assert focal_length(some(40, flat=True), SIZE, FocalTuning()) is None


def test_views_straight_on_do_not_determine_it() -> None:
    assert focal_length(some(40, turn_deg=0.0), SIZE, FocalTuning()) is None


def test_few_pairs_do_not_determine_it() -> None:
    assert focal_length(some(5), SIZE, FocalTuning()) is None
    assert focal_length([], SIZE, FocalTuning()) is None


def turned(first: float, second: float, angle_deg: float, count: int = 20) -> Pairs:
    """Matches of two cameras of a vehicle that drives on between the frames: the second looks to the side and down."""
    rng, centre, found = np.random.default_rng(0), np.array(SIZE) / 2, []
    turn = Rotation.from_euler("yx", (angle_deg, 8), degrees=True).as_matrix()
    while len(found) < count:
        points = rng.uniform([-25, -4, 2], [25, 4, 25], (6000, 3))
        other = (points - [0, 0, rng.uniform(1, 3)]) @ turn.T + rng.normal(scale=[1.0, 0.3, 0.3], size=3)
        ahead = (points[:, 2] > 0.5) & (other[:, 2] > 0.5)
        a, b = (f * p[ahead, :2] / p[ahead, 2:] + centre for f, p in ((first, points), (second, other)))
        seen = ((a > 0) & (a < SIZE) & (b > 0) & (b < SIZE)).all(axis=1)
        found.append(tuple(x[seen] + rng.normal(0, 0.3, (int(seen.sum()), 2)) for x in (a, b)))
    return found


def test_two_cameras_of_a_vehicle_that_drives_straight_on_determine_both_focal_lengths() -> None:
    straight = some(20, turn_deg=0.0)
    pairs = {(0, 0): straight, (1, 1): straight, (0, 1): turned(400, 190, 50), (0, 2): turned(400, 190, -50)}
    found = focal_lengths(pairs, SIZE, FocalTuning())
    assert found == pytest.approx({0: 400, 1: 190, 2: 190}, rel=0.15)
    same = focal_lengths({(0, 1): turned(220, 220, 50), (0, 2): turned(220, 220, -50)}, SIZE, FocalTuning())
    assert len(set(same.values())) == 1 and same[0] == pytest.approx(220, rel=0.12)


def test_matches_that_no_geometry_explains_tell_nothing() -> None:
    """Of these, seven of which are one match, OpenCV fails at an assertion."""
    rng = np.random.default_rng(1279)
    n = int(rng.integers(8, 60))
    a = rng.uniform(0, 500, (n, 2))
    b = np.where(rng.random((n, 1)) < 0.5, a, rng.uniform(0, 500, (n, 2)))
    a[: n // 2], b[: n // 2] = a[0], b[0]
    tuning = FocalTuning(error=0.1 / SIZE[0])
    with pytest.raises(cv2.error, match="empty"):
        cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, 0.1, 0.999, 1000)
    assert focal_length(some(40) + 20 * [(a, b)], SIZE, tuning) == pytest.approx(400, rel=0.12)


def with_cameras(scene: Scene, cameras: list[pycolmap.Camera]) -> Scene:
    rig = scene.rigs[0]
    sensors: tuple[Sensor, ...] = tuple(replace(s, camera=c) for s, c in zip(rig.sensors, cameras, strict=True))
    return scene.with_(rigs=(replace(rig, sensors=sensors),))


@pytest.mark.slow
def test_only_lenses_of_unknown_focal_length_get_another(tmp_path: Path) -> None:
    world = make_world(tmp_path / "database.db", cameras=3, frames=10)
    true = [s.camera for s in world.scene.all_sensors]
    wrong = [copy(c) for c in true]
    for camera in wrong:
        camera.focal_length = 2.5 * true[0].mean_focal_length()
        camera.has_prior_focal_length = False
    wrong[1].has_prior_focal_length = True  # stated, however wrong
    found, (note,) = with_focal_lengths(
        with_cameras(world.scene, wrong), tmp_path / "database.db", (), FocalTuning(least_matches=15)
    )
    lengths = [s.camera.mean_focal_length() / true[0].mean_focal_length() for s in found.all_sensors]
    assert lengths[1] == 2.5
    assert lengths[0] == lengths[2] == pytest.approx(1, rel=0.12)
    assert note.startswith("the focal length of cam1, cam3 is not known") and "px" in note


@pytest.mark.slow
def test_known_lenses_stay_and_nothing_is_read(tmp_path: Path) -> None:
    world = make_world(tmp_path / "database.db", frames=3)
    (tmp_path / "database.db").unlink()
    assert with_focal_lengths(world.scene, tmp_path / "database.db", (), FocalTuning()) == (world.scene, [])
    fisheye = [pycolmap.Camera.create_from_model_name(1, "OPENCV_FISHEYE", 400, *SIZE) for _ in range(3)]
    scene = with_cameras(world.scene, fisheye)
    assert with_focal_lengths(scene, tmp_path / "database.db", (), FocalTuning()) == (scene, [])
