"""A start model against the model that the images made: what agrees, what does not, what is only of another unit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import lone_scene

from tiegraph.geometry.transforms import rigid
from tiegraph.sfm.startcheck import StartCheck, check_start, told
from tiegraph.sfm.tuning import StartCheckTuning

TUNING, COUNT, REACH = StartCheckTuning(), 40, 8.0


def river(seed: int = 0) -> np.ndarray:
    """(N, 4, 4) world_from_camera along a bent way."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 60, COUNT)
    turns = Rotation.from_euler("zyx", np.stack([s, rng.uniform(-9, 9, COUNT), 3 * s], axis=1), degrees=True)
    return rigid(turns.as_matrix(), np.stack([s, 8 * np.sin(s / 15), rng.uniform(-0.3, 0.3, COUNT)], axis=1))


def elsewhere(poses: np.ndarray, scale: float = 0.07) -> np.ndarray:
    """In another world of another unit, with the noise of a finished model."""
    rng = np.random.default_rng(5)
    turn = Rotation.from_euler("xyz", [70, -20, 110], degrees=True).as_matrix()
    noise = Rotation.from_rotvec(np.radians(rng.normal(0, 0.1, (COUNT, 3)))).as_matrix()
    place = poses[:, :3, 3] + rng.normal(0, 0.02, (COUNT, 3))
    return rigid(turn @ poses[:, :3, :3] @ noise, scale * place @ turn.T + [5.0, 6, 7])


def turned(poses: np.ndarray, rows: slice, deg: float) -> np.ndarray:
    out, turn = poses.copy(), Rotation.from_euler("z", deg, degrees=True).as_matrix()
    pivot = out[rows][0, :3, 3].copy()
    out[rows, :3, 3] = (out[rows, :3, 3] - pivot) @ turn.T + pivot
    out[rows, :3, :3] = turn @ out[rows, :3, :3]
    return out


def judged(given: np.ndarray) -> tuple[StartCheck, str, bool]:
    """A start model against that of the images: what is found, what is told, and whether it contradicts."""
    found = check_start(given, river(), REACH, TUNING)
    return found, *told(found, lone_scene(COUNT), TUNING)


def test_a_model_of_another_world_and_unit_agrees() -> None:
    found, text, contradicts = judged(elsewhere(river()))
    assert found.both.all() and not found.bad.any()
    assert 0.01 < np.median(found.turned_deg) < 0.5 and 1e-4 < np.median(found.off) < 0.02
    assert not contradicts and text.startswith("start model: 40 of 40 images agree with it, to 0.")


@pytest.mark.parametrize("rows", [slice(22, None), slice(0, 14), slice(30, None)])
def test_a_part_that_is_turned_is_found_and_named(rows: slice) -> None:
    found, text, contradicts = judged(turned(elsewhere(river()), rows, 20.0))
    wrong = np.arange(COUNT)[rows]
    assert np.array_equal(np.flatnonzero(found.bad), wrong)
    assert np.median(found.turned_deg[wrong]) == pytest.approx(20, abs=0.3)
    first = f"such as {wrong[0]:03d}.jpg"
    assert contradicts and "turned against the others by 20 deg" in text and first in text and "bent there" in text


def test_a_part_of_another_scale_is_found_though_it_is_not_turned() -> None:
    given = elsewhere(river())
    given[25:, :3, 3] = given[25, :3, 3] + 3 * (given[25:, :3, 3] - given[25, :3, 3])
    found, _, contradicts = judged(given)
    assert contradicts and not found.bad[:25].any() and found.bad[26:].mean() > 0.9 and np.nanmax(found.turned_deg) < 1


def test_another_survey_is_told_as_one_and_few_wrong_images_are_no_contradiction() -> None:
    _, text, contradicts = judged(river()[np.random.default_rng(1).permutation(COUNT)])
    assert contradicts and "is it of another survey, or are images named otherwise?" in text
    _, text, contradicts = judged(turned(elsewhere(river()), slice(37, None), 20.0))
    assert not contradicts and "37 of 40 images agree" in text and "3 images do not" in text


def test_too_few_common_images_say_nothing() -> None:
    given = elsewhere(river())
    given[2:] = np.nan
    found, text, contradicts = judged(given)
    assert found.both.sum() == 2 and not found.bad.any() and not contradicts
    assert text == "start model: 2 of its images are in the model, too few to test it"
