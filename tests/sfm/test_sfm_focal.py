"""Focal lengths of unknown cameras: found from relative poses, and left alone where these do not determine them."""

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.sfm.focal import focal_length
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
