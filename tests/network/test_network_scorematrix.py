"""The lattice of previews: smoothing, growing, confirming, interpolating, and long passes along walls that repeat."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from boat_world import Result, boat
from network_steps import context_of
from tiegraph.network.offsets import estimate_offsets
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.retrieval import Look, Timeline, seen_by_the_rig, unrelated
from tiegraph.network.scorematrix import NoiseFloor, ScoreMatrix, corridor, noise_floor_within, score_matrix
from tiegraph.network.tuning import Tuning
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

TUNING = Tuning()


def scores(stride: int = 2) -> ScoreMatrix:
    world = boat((11, 9), (2.0, 2.0))
    p, q = find_passes(world.scene)
    return score_matrix(p, q, stride, np.ones((6, 6), bool), TUNING.offsets)


def test_nodes_include_the_last_frame() -> None:
    assert scores().rows.tolist() == [0, 2, 4, 6, 8, 10]
    assert scores(3).columns.tolist() == [0, 3, 6, 8]


@pytest.mark.parametrize("same", [True, False])
def test_the_frontier_of_a_long_band_is_that_of_the_whole_lattice(same) -> None:
    rng = np.random.default_rng(3)
    frames = np.arange(150)
    images = np.stack([frames, frames + 150])
    images[0, 40:44] = -1
    p, q = (replace(x, frames=frames, images=images + 300 * k) for k, x in enumerate(find_passes(boat().scene)))
    band = score_matrix(p, p if same else q, 1, np.array([[1, 1], [1, 0]], bool), TUNING.offsets)
    a, b = np.ogrid[:150, :150]
    known = (np.abs(a - b) < 6) | (rng.random((2, 2, 150, 150)) < 0.001)
    counts = rng.integers(0, 20, known.shape).astype(np.float32)
    band = replace(band, inliers=np.where(known, counts, np.nan).astype(np.float32))
    beside = np.abs(a - b) < 60
    hot = np.pad(np.nan_to_num(band.inliers) >= 18, ((0, 0), (0, 0), (1, 1), (1, 1)))
    grown = np.any([hot[:, :, i : i + 150, j : j + 150] for i in range(3) for j in range(3)], axis=0)
    left, right = band.p.images[:, None, :, None], band.q.images[None, :, None, :]
    grown &= (left >= 0) & (right >= 0) & (left != right) & band.allowed[:, :, None, None]
    grown &= np.isnan(band.inliers) & beside
    if same:
        c, d = np.ogrid[:2, :2]
        grown &= (c < d)[:, :, None, None] | ((c == d)[:, :, None, None] & (a < b))
    found = band.frontier(band.inliers, 18, beside)
    assert 100 < len(found[0]) and all(np.array_equal(x, y) for x, y in zip(found, np.nonzero(grown)))


def test_faint_patches_are_not_confirmed() -> None:
    smooth = np.full((6, 6, 6, 5), 8.0, np.float32)
    smooth[0, 0, 0, 0] = 10.5
    smooth[0, 1, 2:4, 2] = (10.5, 15)
    out = scores().confirmed(smooth, 10, TUNING)
    assert out[0, 0, 0, 0] < 10 and out[0, 1, 2, 2] == 10.5 and out[0, 1, 3, 2] == 15
    assert smooth[0, 0, 0, 0] == 10.5


def test_interpolation_is_bilinear_between_nodes() -> None:
    smooth = np.full((6, 6, 6, 5), 0.0, np.float32)
    smooth[2, 3] = 5 + np.add.outer(np.arange(6), np.arange(5))
    full = replace(scores(), inliers=smooth * 2)
    c, d, m, n, count = full.interpolated(smooth, 10.0, TUNING.counts)
    assert set(c) == {2} and set(d) == {3} and np.allclose(count, 2 * (5 + m / 2 + n / 2))
    expected = {(a, b) for a in range(11) for b in range(9) if 5 + a / 2 + b / 2 >= 10}
    assert set(zip(m.tolist(), n.tolist())) == expected


def test_a_band_of_evidence_is_smoothed_and_interpolated_as_the_whole_lattice() -> None:
    """Long passes are gone through in parts that hold evidence; the definition knows no parts."""
    rng = np.random.default_rng(2)
    frames = np.arange(400)
    p, q = (replace(x, frames=frames, images=frames[None] + 400 * k) for k, x in enumerate(find_passes(boat().scene)))
    band = score_matrix(p, q, 2, np.ones((1, 1), bool), TUNING.offsets)
    a, b = np.ogrid[: len(band.rows), : len(band.columns)]
    known = (np.abs(a + b - len(band.columns)) < 9) | (rng.random((len(band.rows), len(band.columns))) < 0.001)
    counts = rng.integers(0, 60, known.shape).astype(np.float32)
    band = replace(band, inliers=np.where(known, counts, np.nan).astype(np.float32)[None, None])
    low, high = TUNING.counts.floor * 12, TUNING.counts.ceiling * 12
    kernel = {"mode": "constant", "truncate": TUNING.offsets.kernel_cut_sigmas}
    sums = [np.where(known, np.clip(counts, low, high) - low, 0), known]
    sums = [gaussian_filter(x.astype(np.float32), TUNING.counts.sigma_nodes, **kernel) for x in sums]
    smooth = band.smoothed(12, TUNING)
    assert np.array_equal(
        smooth[0, 0], np.where(known, low + sums[0] / np.maximum(sums[1], 1e-6), np.nan), equal_nan=True
    )
    fine = band.rows[:-1], band.columns[:-1]  # every node: there the interpolation is the node itself
    _, _, m, n, count = band.interpolated(smooth, 12.0, TUNING.counts)
    at = np.isin(m, fine[0]) & np.isin(n, fine[1])
    expected = np.argwhere(np.nan_to_num(smooth[0, 0, : len(fine[0]), : len(fine[1])]) >= 12)
    assert np.array_equal(np.stack([m[at], n[at]], axis=1), 2 * expected)
    assert np.array_equal(count[at], counts[tuple(expected.T)])


@pytest.mark.parametrize("same", [False, True])
def test_a_lattice_that_grows_is_smoothed_and_followed_as_the_whole_of_it(same: bool) -> None:
    rng = np.random.default_rng(5)
    frames = np.arange(300)
    p, q = (
        replace(x, frames=frames, images=np.stack([frames, frames + 300]) + 600 * k)
        for k, x in enumerate(find_passes(boat().scene))
    )
    q = p if same else q
    near = 40 * np.exp(-(((frames[:, None] - frames) / 4) ** 2)) + rng.integers(0, 9, (300, 300))
    cache = MatchCache(lambda pairs: [Result(int(near[i % 300, j % 300])) for i, j in pairs], 1200)
    grow = score_matrix(p, q, 1, np.array([[1, 1], [1, 0]], bool), TUNING.offsets)
    seeds = np.zeros(grow.inliers.shape, bool)
    seeds[:, :, [40, 41, 170], 38:43] = seeds[:, :, 170, 165:175] = True
    grow = grow.measured(np.nonzero(seeds), cache)
    smooth, touched, steps, beside = grow.smoothed(12, TUNING), np.ones(300, bool), 0, np.ones((300, 300), bool)
    while True:
        frontier, whole = grow.frontier(smooth, 12, beside, touched), grow.frontier(smooth, 12, beside)
        assert all(np.array_equal(some, all_) for some, all_ in zip(frontier, whole, strict=True))
        if not len(frontier[0]):
            break
        touched = grow.smooth_again(smooth, grow.measure(frontier, cache), 12, TUNING)
        assert np.array_equal(smooth, grow.smoothed(12, TUNING), equal_nan=True)
        steps += 1
        assert steps < 5 or not touched.all()
    assert steps > 20 and np.isfinite(grow.inliers).sum() > 3 * 300 * 8


def test_one_pass_is_symmetric_and_never_asks_twice() -> None:
    world = boat((9,), (2.0,))
    (p,) = find_passes(world.scene)
    asked = []
    cache = MatchCache(lambda pairs: asked.extend(pairs.tolist()) or [Result(20) for _ in pairs], len(world.scene))
    empty = score_matrix(p, p, 2, np.ones((6, 6), bool), TUNING.offsets)
    full = empty.measured(np.nonzero(np.isnan(empty.inliers)), cache)
    assert len(asked) == len({tuple(a) for a in asked}) == 30 * 29 // 2
    assert np.array_equal(full.inliers, full.inliers.transpose(1, 0, 3, 2), equal_nan=True)
    assert np.isnan(full.inliers[0, 0, 1, 1]) and full.inliers[0, 1, 1, 1] == 20


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
    monkeypatch.setattr("tiegraph.network.offsets.allowed_within", every)


def test_a_long_pass_is_tied_as_far_as_its_cameras_see_and_no_further(few_axes) -> None:
    world = Street()
    kept = estimate_offsets(context_of(world.scene, world.match)).pairs.kept()
    i, j = np.triu_indices(len(world.scene), 1)
    hit = np.zeros((len(world.scene),) * 2, bool)
    hit[kept.i, kept.j] = True
    useful = world.true(i, j) & (np.abs(world.frame[i] - world.frame[j]) <= 6)
    assert hit[i, j][useful].mean() > 0.9 and world.true(kept.i, kept.j).mean() > 0.6
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
    level = NoiseFloor(np.full((4, 4), 12.0), most=24.0, lowest=8.0, highest=24.0)
    scores = score_matrix(p, p, 5, np.ones((SENSORS, SENSORS), bool), TUNING.offsets, level)
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
    line = line_of(world)
    near = np.abs(np.subtract.outer(np.arange(15), np.arange(15))) <= 1
    context = context_of(world.scene, world.match)
    level = unrelated(context, line, near)
    assert level is not None
    # One camera's hits of a true return, and of a wall that looks like another.
    again = [(line.image_at[f, 0], line.image_at[f + 100, 0]) for f in range(10, 40)]
    alike = [(line.image_at[f, 0], line.image_at[g, 0]) for f in range(10, 30) for g in range(60, 80)]
    hits = [(i, j) for i, j in alike if world.match(np.array([[i, j]]))[0].inliers > 20]
    i, j = np.array(again + hits).T
    patch = np.repeat([0, 1], [len(again), len(hits)])
    assert list(seen_by_the_rig(Look(context, line, level), (i, j), patch)) == [True, False]
