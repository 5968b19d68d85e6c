"""ICP on surfaces that hold it, and refused on those that do not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.evaluate.clouds.register import register
from tiegraph.evaluate.tuning import RegistrationTuning
from tiegraph.geometry.align import Similarity
from tiegraph.geometry.coarse import start_of

TUNING = RegistrationTuning()


def room(seed: int, points: int = 4000) -> np.ndarray:
    """Four walls of 30 m x 12 m and a floor, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0, 30, points), rng.uniform(0, 12, points), rng.uniform(0, 6, points)
    zero = np.zeros(points)
    walls = [[a, zero, c], [a, zero + 12, c], [zero, b, c], [zero + 30, b, c], [a, b, zero]]
    return np.vstack([np.column_stack(w) for w in walls]) + 0.01 * rng.standard_normal((5 * points, 3))


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 1.01])
def test_a_moved_cloud_comes_back_with_an_honest_sigma(scale: float) -> None:
    true = Similarity(scale, Rotation.from_rotvec([0.005, -0.01, 0.02]).as_matrix(), np.array([0.3, -0.2, 0.1]))
    cloud = room(1)
    moved = (cloud - true.translation) @ true.rotation / scale
    found = register(moved, room(0), TUNING, with_scale=scale != 1)
    off = np.linalg.norm(found.fit(moved) - cloud, axis=1)
    sigma = np.linalg.norm(found.error.sigma(cloud), axis=1)
    assert off.max() < 0.004 and 0.2 < np.median(off / sigma) < 4
    assert 0.008 < found.residual_m < 0.02 and found.used > 0.99
    rows = {name: value for name, value, _ in found.table()["rows"]}
    assert rows["scale"] == pytest.approx(scale, abs=3e-4) and rows["turn about z, deg"] == pytest.approx(
        1.146, abs=0.02
    )


def test_what_slides_or_does_not_meet_is_refused() -> None:
    corner = room(0)
    wall = corner[:4000]
    with pytest.raises(ValueError, match="they slide along each other"):
        register(wall + [0.1, 0, 0], wall, TUNING)
    three = corner[(corner[:, 1] < 1) | (corner[:, 0] < 1) | (corner[:, 2] < 1) & (corner[:, 1] < 6)][::4]
    three = three[three[:, 1] < 11.5]
    with pytest.raises(ValueError, match="scale|slide"):  # grows about its corner and lies on itself
        register(three[three[:, 0] < 29], three, TUNING, with_scale=True)
    with pytest.raises(ValueError, match="0 of .* too far apart for a fine registration"):
        register(wall + 100, wall, TUNING)


@pytest.mark.slow
def test_a_cloud_far_off_comes_back_from_a_coarse_start() -> None:
    """Turned by 130 degrees and 50 m off; a part of the reference only."""
    rng = np.random.default_rng(3)
    boxes = [room(1) * size + place for size, place in (((1, 1, 1), (0, 0, 0)), ((0.2, 0.3, 0.5), (9, 4, 0)),
                                                        ((0.15, 0.2, 0.9), (20, 6, 0)))]  # fmt: skip
    reference = np.vstack(boxes)
    cloud = reference[(reference[:, 0] < 24) & (rng.random(len(reference)) < 0.7)]
    true = Similarity(1.0, Rotation.from_rotvec([0.2, 0.1, 2.25]).as_matrix(), np.array([50.0, -20.0, 3.0]))
    moved = (cloud - true.translation) @ true.rotation
    start = start_of(moved, reference, TUNING.coarse)
    found = register(moved, reference, TUNING, start=start)
    off = np.linalg.norm(found.fit(moved) - cloud, axis=1)
    assert off.max() < 0.01 < 0.1 < np.linalg.norm(moved - cloud, axis=1).min()
    assert 0.9 < start.share > start.rival + 0.02 and start.matches > 10
    rows = {name: value for name, value, _ in found.table()["rows"]}
    assert rows["coarse start: consistent matches"] == start.matches
    with pytest.raises(ValueError, match="stand in one place"):
        start_of(np.ones((9, 3)), reference, TUNING.coarse)
