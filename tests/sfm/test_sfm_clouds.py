"""Models placed by their points: where they fit in one place, and not where they fit in several or nowhere."""

from __future__ import annotations

import numpy as np
import pytest
from driving_world import Drive, driving_world
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.ties import moved
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import VerifiedMatches
from tiegraph.sfm.world.clouds import CloudFit, Surface, fit_clouds
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georef import georeference
from tiegraph.sfm.world.oneworld import ByPositions, OneWorld, one_world

import pycolmap  # isort: skip

TUNING = Tuning()
CLOUDS = TUNING.world.clouds
RANGE_M = 10.0
LONG_M = 20.0
DENSE = 200  # points a metre: what explains a point depends on it


def street(low: float, high: float, plain: bool, seed: int) -> np.ndarray:
    """Points (N, 3), 5 cm off, on two walls of which each house stands forth by its own depth; plain: even walls."""
    rng, count = np.random.default_rng(seed), round(DENSE * (high - low))
    depth = np.random.default_rng(7).uniform(0, 4, (2, 60)) * (not plain)
    x, z, side = rng.uniform(low, high, count), rng.uniform(0, 8, count), rng.integers(0, 2, count)
    y = np.where(side, 8 + depth[1, (x / 3).astype(int)], -8 - depth[0, (x / 3).astype(int)])
    return np.stack([x, y, z], axis=1) + 0.05 * rng.standard_normal((count, 3))


def placed(first: np.ndarray, second: np.ndarray, scale: float | None = None) -> tuple[CloudFit, float, float]:
    """The fit of the second, seen in a frame of its own, to the first; metres and degrees it is off."""
    own = Similarity(
        0.4, Rotation.from_euler("zxy", [130, 2, -1], degrees=True).as_matrix(), np.array([3.0, -5.0, 1.0])
    )
    model = Surface(own(second), np.eye(3), own.scale * 1.2 * RANGE_M)
    fit = fit_clouds(Surface(first, np.eye(3), RANGE_M), model, scale, CLOUDS)
    assert fit is not None
    back = fit.world_from_model
    off = np.linalg.norm(back(own(second)) - second, axis=1).max()
    return fit, float(off), float(transforms.angle_deg(back.rotation @ own.rotation, np.eye(3)))


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1 / 0.4, None])
def test_points_of_one_street_find_their_place(scale: float | None) -> None:
    fit, off, turn = placed(street(0, LONG_M, False, 0), street(3, LONG_M + 2, False, 1), scale)
    assert fit.why_not(CLOUDS) == "" and 0.7 < fit.explained < 1 and fit.rival < 0.7 * fit.explained
    assert 1e-4 < off < 0.5 and turn < 1  # walls slide along walls
    assert 1e-5 < fit.jump < 0.5 and fit.turn_deg < 1


@pytest.mark.slow
def test_even_walls_fit_in_many_places() -> None:
    fit, *_ = placed(street(0, LONG_M, True, 0), street(3, LONG_M - 3, True, 1), 1 / 0.4)
    assert "about equally many" in fit.why_not(CLOUDS) and fit.explained > 0.8


@pytest.mark.slow
def test_streets_that_do_not_overlap_are_not_laid_on_each_other() -> None:
    fit, off, _ = placed(street(0, LONG_M, False, 0), street(90, 90 + LONG_M, False, 1))
    assert off > 20 and fit.why_not(CLOUDS)


def test_a_world_too_wide_is_not_searched() -> None:
    far = street(0, LONG_M, False, 0) * [3000, 3000, 1]
    model = Surface(street(0, LONG_M, False, 1), np.eye(3), RANGE_M)
    assert fit_clouds(Surface(far, np.eye(3), RANGE_M), model, 1.0, CLOUDS) is None


def joined(drives: tuple[Drive, Drive]) -> tuple[OneWorld, float]:
    """Two drives of six cameras in one world, by their points alone; the second's largest error in metres."""
    (first, scene), (second, _) = (driving_world(d) for d in drives)
    apart = Similarity(1.0, Rotation.from_euler("y", 80, degrees=True).as_matrix(), np.array([50.0, 0.0, 9.0]))
    models = [part(first, range(0, 12)), moved(part(second, range(12, 24)), apart)]
    settings, nothing = GeorefSettings(adjust="no"), VerifiedMatches(np.zeros((0, 2), int), (), {})

    def similarity(model, given):
        return georeference(model, scene, settings, TUNING.world, given)

    def whole(model, given):
        found = similarity(model, given)
        return found, found.apply(model)

    found = one_world(models, scene, nothing, ByPositions(similarity, whole), Measurements(), TUNING)
    assert found.model is not None
    here, there = image_poses(found.model, scene), image_poses(second, scene)
    rows = scene.frame >= 12
    off = transforms.centre(here)[rows] - found.first.world_from_model(transforms.centre(there)[rows])
    return found, float(np.linalg.norm(off, axis=1).max() / found.first.world_from_model.scale)


def part(model: pycolmap.Reconstruction, frames: range) -> pycolmap.Reconstruction:
    """The model of some frames; each point off by as much as its rays let it."""
    out, rng = pycolmap.Reconstruction(model), np.random.default_rng(frames.start)
    for number, frame in enumerate(sorted(out.frames)):
        if number not in frames:
            out.deregister_frame(frame)
    for number in out.point3D_ids():
        out.point3D(number).xyz += 0.05 * rng.standard_normal(3)
    return out


@pytest.mark.slow
def test_a_model_without_matches_and_positions_comes_into_the_world_by_its_points() -> None:
    found, off = joined((Drive(), Drive()))
    (second,) = found.others
    assert second.by == "points" and second.cloud is not None and second.row()[2] == "points"
    assert 1e-4 < off < 0.3 and 0.5 < second.cloud.explained <= 1
    assert "placed by its points alone" in second.note(metric=True)
    assert found.records()[0]["in the world by"] == "points" and found.records()[0]["held-out points that fit %"] > 50


@pytest.mark.slow
def test_a_model_of_another_street_stays_out_and_says_why() -> None:
    found, _ = joined((Drive(), Drive(seed=6)))
    (second,) = found.others
    assert second.by == "" and "of its points lie on the others'" in second.why_not
    assert "not in the world" in second.note(metric=True) and second.row()[-1] == second.why_not
