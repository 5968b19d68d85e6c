"""Long passes along walls that repeat: most frames share nothing, and half of their previews look as if they did."""

import numpy as np
import pytest

from boat_world import Result
from tiegraph.network.offsets.background import corridor, noise_floor_within
from tiegraph.network.offsets.offsets import estimate_offsets
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.retrieval.retrieval import seen_by_the_rig, unrelated
from tiegraph.network.retrieval.timeline import Timeline
from tiegraph.network.scorematrix import NoiseFloor, score_matrix
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS, TUNING = CandidatesSettings(), Tuning()
REACH, WALL = 9, 4  # frames over which a camera sees the same; of one wall
SENSORS, FRAMES = 4, 150


class Street:
    """A rig whose cameras each see a street of walls; a share ``alike`` of two walls look the same."""

    def __init__(self, alike: float = 0.5, frames: int = FRAMES, back_from: int = 10**6) -> None:
        self.alike, self.asked, self.back_from = alike, 0, back_from
        rig = Rig("car", tuple(Sensor(f"cam{k}") for k in range(SENSORS)))
        frame, sensor = np.repeat(np.arange(frames), SENSORS), np.tile(np.arange(SENSORS), frames)
        names = [f"cam{s}/{f:04d}.jpg" for f, s in zip(frame, sensor)]
        order = np.argsort(names)
        self.frame, self.sensor = frame[order], sensor[order]
        self.scene: Scene = simple_scene(
            rig, [names[k] for k in order], self.frame, self.sensor, np.zeros(frames, int), np.arange(frames)
        )

    def place(self, frame: np.ndarray) -> np.ndarray:
        """Where on the street: from ``back_from`` on it is driven again."""
        return np.where(frame >= self.back_from, frame - self.back_from, frame)

    def true(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        apart = np.abs(self.place(self.frame[i]) - self.place(self.frame[j]))
        return (self.sensor[i] == self.sensor[j]) & (apart <= REACH)

    def match(self, pairs: np.ndarray) -> list[Result]:
        self.asked += len(pairs)
        i, j = pairs.T
        walls = np.stack([self.place(self.frame[k]) // WALL for k in (i, j)], axis=1)
        seeds = np.column_stack([np.sort(walls, axis=1), np.sort(self.sensor[pairs], axis=1)])
        same = np.array([np.random.default_rng((3, *map(int, s))).random() < self.alike for s in seeds])
        apart = np.abs(self.place(self.frame[i]) - self.place(self.frame[j]))
        count = np.where(self.true(i, j), 100 * np.exp(-apart / 6), np.where(same, 26, 8))
        return [Result(int(c)) for c in count]


@pytest.fixture
def few_axes(monkeypatch):
    """Any two cameras may tie."""
    every = lambda rig, limit: np.ones((len(rig.sensors),) * 2, bool)  # noqa: E731
    monkeypatch.setattr("tiegraph.network.offsets.offsets.allowed_within", every)


def test_a_long_pass_is_tied_as_far_as_its_cameras_see_and_no_further(few_axes) -> None:
    world = Street()
    cache = MatchCache(world.match, len(world.scene))
    kept = estimate_offsets(find_passes(world.scene), cache, len(world.scene), SETTINGS, TUNING).pairs.kept()
    i, j = np.triu_indices(len(world.scene), 1)
    hit = np.zeros((len(world.scene),) * 2, bool)
    hit[kept.i, kept.j] = True
    useful = world.true(i, j) & (np.abs(world.frame[i] - world.frame[j]) <= 6)
    assert hit[i, j][useful].mean() > 0.9
    assert world.true(kept.i, kept.j).mean() > 0.6
    assert world.asked < 40 * len(world.scene)


def test_the_level_of_frames_that_share_nothing() -> None:
    world = Street()
    cache = MatchCache(world.match, len(world.scene))
    p = find_passes(world.scene)[0]
    level = noise_floor_within(p, np.ones((SENSORS, SENSORS), bool), cache, 12, TUNING)
    assert level is not None and 13 < level.mean.mean() < 19  # half 8, half 24
    assert level.above(np.array(24.0), (0, 0)) == pytest.approx(24)
    assert level.above(np.array(level.mean[0, 0]), (0, 0)) == pytest.approx(8)
    short = Street(frames=20)
    p = find_passes(short.scene)[0]
    assert noise_floor_within(p, np.ones((SENSORS, SENSORS), bool), MatchCache(short.match, 80), 12, TUNING) is None


def test_the_band_is_one_run_of_distances() -> None:
    p = find_passes(Street().scene)[0]
    level = NoiseFloor(np.full((4, 4), 12.0), 24.0, 8.0, 24.0, TUNING.offsets.scores.most_level)
    scores = score_matrix(p, p, 5, np.ones((SENSORS, SENSORS), bool), TUNING.offsets.scores, level)
    scores.inliers[:] = 8.0
    a, b = np.indices(scores.inliers.shape[2:])
    scores.inliers[1, 1, np.abs(a - b) <= 2] = 24.0
    scores.inliers[1, 1, (np.abs(a - b) == 6) & (a < 8)] = 24.0  # a wall that comes again, for some frames
    near = corridor(scores, np.arange(len(scores.rows), dtype=float), 10, TUNING)
    assert near[1, 1, 10, 8:13].all() and not near[1, 1, 2, 8] and not near[0, 0].any()


def line_of(world: Street) -> Timeline:
    """Places, cells of ten frames, no strides."""
    frames = world.scene.frames
    image_at = np.full((frames, SENSORS), -1)
    image_at[world.frame, world.sensor] = np.arange(len(world.scene))
    zero = np.zeros(frames, int)
    cell = np.arange(frames) // 10
    return Timeline(
        image_at, zero, np.arange(frames), zero + 1, cell, zero[: cell.max() + 1], world.frame, world.sensor
    )


def test_a_loop_is_what_most_cameras_see_again() -> None:
    world = Street(back_from=100)
    line, cache = line_of(world), MatchCache(world.match, len(world.scene))
    near = np.abs(np.subtract.outer(np.arange(15), np.arange(15))) <= 1
    level = unrelated(line, near, cache, 12, TUNING)
    assert level is not None
    # One camera's hits of a true return, and of a wall that looks like another.
    again = [(line.image_at[f, 0], line.image_at[f + 100, 0]) for f in range(10, 40)]
    alike = [(line.image_at[f, 0], line.image_at[g, 0]) for f in range(10, 30) for g in range(60, 80)]
    hits = [(i, j) for i, j in alike if world.match(np.array([[i, j]]))[0].inliers > 20]
    i, j = np.array(again + hits).T
    patch = np.repeat([0, 1], [len(again), len(hits)])
    assert list(seen_by_the_rig(line, (i, j), patch, cache, level, TUNING.retrieval.loops)) == [True, False]
