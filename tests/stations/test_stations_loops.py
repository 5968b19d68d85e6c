"""Pairs of stations: judged by loops, which are distributed, and by the free space that their rays went through."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stations.stations_world import hall, scans
from tiegraph.geometry import transforms
from tiegraph.stations.loops import adjusted, contradicted, parts, taken_apart
from tiegraph.stations.pairs import Pair, looked_through
from tiegraph.stations.station import Shot, common_side, station_of
from tiegraph.stations.tuning import Tuning

POSES = [
    transforms.rigid(Rotation.random(random_state=k).as_matrix(), np.random.default_rng(k).normal(size=3))
    for k in range(9)
]
POINTS = [np.random.default_rng(9).normal(size=(50, 3))] * 9


def pair(i, j, off_m=0.0, overlap=0.5, sigma_m=0.001):
    """A pair that is right but for a shift."""
    true = transforms.invert(POSES[i]) @ POSES[j]
    true[:3, 3] += off_m * np.array([0.6, 0.0, 0.8])
    known = {"residual_m": 0.001, "middle": np.zeros(3), "information": np.eye(6) / sigma_m**2}
    return Pair(first=i, second=j, first_from_second=true, overlap=overlap, **known)


def test_the_one_wrong_pair_is_found():
    pairs = [pair(i, j, off_m=0.5 * ((i, j) == (1, 3))) for i in range(5) for j in range(i + 1, 5)]
    judged = contradicted(pairs, POINTS, 0.05)
    wrong = [p for p in judged if p.why_not]
    assert [(p.first, p.second) for p in wrong] == [(1, 3)]
    assert wrong[0].why_not == "3 loops of three contradict it and 0 bear it out"


def test_a_pair_without_loops_needs_more_overlap():
    judged = contradicted([pair(0, 1, overlap=0.25), pair(1, 2, overlap=0.4)], POINTS, 0.05)
    assert "no loop bears it out, and 25% overlap" in judged[0].why_not and not judged[1].why_not
    assert parts(5, judged)[1] == parts(5, judged)[2] != parts(5, judged)[0]


def test_groups_that_are_joined_in_two_ways_are_taken_apart():
    """Groups 0 to 3 and 4 to 7, joined by two pairs of which one is wrong; 8 hangs on 7 alone."""
    groups = [(i, j) for first in (0, 4) for i in range(first, first + 4) for j in range(i + 1, first + 4)]
    pairs = [pair(i, j, off_m=0.5 * ((i, j) == (3, 6))) for i, j in [*groups, (0, 4), (3, 6), (7, 8)]]
    close = adjusted(list(range(9)), pairs, 9)
    left = {(p.first, p.second): row[1] for p, row in zip(close.pairs, close.loop_m)}
    judged = taken_apart(pairs, left, POINTS, 0.05)
    assert [(p.first, p.second) for p in judged if p.why_not] == [(0, 4), (3, 6)]
    assert "contradict each other by up to" in judged[-2].why_not
    hanging = parts(9, judged)
    assert set(hanging[:4]) != set(hanging[4:]) and len(set(hanging)) == 2
    assert taken_apart(pairs, dict.fromkeys(left, 0.01), POINTS, 0.05) == pairs


@pytest.mark.slow
def test_the_error_of_a_loop_is_distributed_by_what_is_known():
    """A ring that does not close by 40 mm: the pair known ten times worse takes nearly all of it."""
    ring = [pair(0, 1), pair(1, 2), pair(2, 3), pair(3, 4, sigma_m=0.01), pair(0, 4, off_m=0.04)]
    part = adjusted([0, 1, 2, 3, 4], ring, 5)
    np.testing.assert_allclose(part.poses[0], np.eye(4))
    before, after = part.loop_m.T
    assert before.max() == pytest.approx(0.04, abs=1e-6)
    assert after[3] > 0.03 and after[[0, 1, 2, 4]].max() < 0.003
    sigma = np.sqrt(np.trace(part.covariance[:, 3:, 3:], axis1=1, axis2=2) / 3)
    assert sigma[0] == 0 and sigma[1] < sigma[2] < sigma[3]


@pytest.mark.slow
def test_free_space_tells_one_bay_from_the_next():
    """Two stations near one end of a hall of equal bays: its shape repeats."""
    views = scans(hall(), [[1.2, 0.4, 1.5], [3.1, -0.5, 1.5]])
    shots = [Shot(str(k), v.xyz) for k, v in enumerate(views)]
    side = common_side(shots, Tuning())
    a, b = (station_of(s, side, Tuning()) for s in shots)
    world = [v.world_from_station for v in views]
    true = a.shift @ transforms.invert(world[0]) @ world[1] @ b.shift_back
    along = transforms.rigid(np.eye(3), -2.0 * world[0][0, :3])  # a bay along the hall's x, in the first one's frame
    assert looked_through(a, b, true) < 0.01 and 0.02 < looked_through(a, b, along @ true) < 0.3
