"""Groups of frames that few points tie to the rest, on surveys whose ties are counted by hand."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tiegraph.scene.weakties import WeaklyTied, named, strongest_first, weakly_tied


def seen(*points: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points and frames of sightings, from the frames that see each point."""
    return np.repeat(np.arange(len(points)), [len(p) for p in points]), np.array([f for p in points for f in p], int)


def test_groups_join_the_strongest_first() -> None:
    a, b, weight = np.array([0, 1, 3, 2]), np.array([1, 2, 4, 3]), np.array([5.0, 9.0, 7.0, 1.0])
    assert [g.tolist() for g in strongest_first(a, b, weight, 6)] == [[1, 2], [3, 4], [0, 1, 2], [0, 1, 2, 3, 4]]


def test_three_frames_that_hang_on_few_points_are_named_together() -> None:
    """Each of the three has hundreds of points, nearly all with the other two only."""
    chain = [(k, k + 1, k + 2) for k in range(8)] * 100
    inside, across = [(10, 11, 12)] * 300, [(9, 10)] * 20 + [(5, 12)] * 11
    point, frame = seen(*chain, *inside, *across)
    assert weakly_tied(point, frame, np.ones(13, bool), 50) == (WeaklyTied((10, 11, 12), 31),)
    assert weakly_tied(point, frame, np.ones(13, bool), 31) == ()
    assert weakly_tied(point, frame, np.ones(13, bool), 50, 10) == (WeaklyTied((10, 11, 12), 31),)
    assert named(WeaklyTied((10, 11, 12), 31), tuple(f"{k}.jpg" for k in range(13))) == "10.jpg .. 12.jpg (3 frames)"


def test_a_frame_without_points_is_weak_only_where_it_has_a_place() -> None:
    point, frame = seen(*[(0, 1, 2)] * 60)
    assert weakly_tied(point, frame, np.array([True, True, True, False]), 50) == ()
    assert weakly_tied(point, frame, np.ones(4, bool), 50) == (WeaklyTied((3,), 0),)
    assert weakly_tied(point, frame, np.array([True, True, True, False]), 100, 50) == ()  # 60 are enough for one
    assert weakly_tied(point, np.zeros(len(frame), int), np.array([True]), 50) == ()  # there is no rest


def test_frames_that_hold_together_by_sums_are_not_weak() -> None:
    """No two frames share 50 points, but every frame shares more with all others together."""
    point, frame = seen(*[pair for pair in itertools.combinations(range(6), 2) for _ in range(20)])
    assert weakly_tied(point, frame, np.ones(6, bool), 50) == ()


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 7), st.lists(st.sets(st.integers(0, 6), min_size=1, max_size=4), max_size=40), st.integers(1, 8))
def test_what_is_found_is_weak_and_a_frame_that_is_weak_is_found(frames: int, points: list, least: int) -> None:
    tracks = [tuple(sorted({f % frames for f in p})) for p in points]
    found = weakly_tied(*seen(*tracks), np.ones(frames, bool), least)
    for group in found:
        across = sum(bool(set(t) & set(group.frames)) and bool(set(t) - set(group.frames)) for t in tracks)
        assert across == group.points < least and 2 * len(group.frames) <= frames
    taken = [f for group in found for f in group.frames]
    assert len(taken) == len(set(taken))
    alone = [sum(f in t and len(t) > 1 for t in tracks) for f in range(frames)]
    assert bool(found) or min(alone) >= least
