"""Offset voting on a boat survey with exact overlap; the lattice of previews and long passes along repeating walls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from boat_world import Result, boat, quality, ring
from network_steps import context_of, network_of
from tiegraph import papers
from tiegraph.network.axes import (
    angles_deg,
    direction,
    in_words,
    strangers,
    vertical,
    votes,
    without_chance,
    yaw,
    yaw_between,
)
from tiegraph.network.offsets import OFFSETS, estimate_offsets
from tiegraph.network.passes import MatchCache, find_passes, loose_images
from tiegraph.network.retrieval import Look, Timeline, seen_by_the_rig, unrelated
from tiegraph.network.scorematrix import (
    NoiseFloor,
    ScoreMatrix,
    corridor,
    kernel_reach,
    noise_floor_within,
    score_matrix,
)
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.papers.meguro2024 import _around
from tiegraph.scene.graph import best_line
from tiegraph.scene.pairs import REASONS
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

TUNING = Tuning()
papers.plug_in(papers.OFFSETS, "constant", OFFSETS)


def measure(world, settings):
    """Recall, precision, recall between passes, and the network."""
    network = network_of(world.scene, world.match, settings)
    return *quality(world, network.pairs), network


@pytest.mark.slow
def test_default_finds_the_return_pass_at_another_speed() -> None:
    world = boat((24, 15), (1.5, 2.4))
    recall, precision, cross, network = measure(world, CandidatesSettings())
    assert recall > 0.95 and cross > 0.95 and 0.5 < precision < 1.0
    assert world.asked < 0.25 * len(world.scene) ** 2 / 2
    assert any("runs back along" in note and "180" in note for note in network.notes)
    assert (network.pairs.degree(len(world.scene)) > 0).all()


@pytest.mark.slow
def test_constant_offsets_lose_what_local_ones_keep() -> None:
    paper = CandidatesSettings(sources=("sequence", "offsets"), offsets="constant", axes_deg=90, offset_range=3)
    slow = measure(boat((24, 24), (1.5, 1.5)), paper)
    other = measure(boat((24, 12), (1.5, 3.0)), paper)
    ours = measure(boat((24, 12), (1.5, 3.0)), CandidatesSettings())
    assert 0.1 < slow[2] < 0.9 and 0.1 < other[2] < 0.9
    assert ours[0] > other[0] + 0.2 and ours[2] > other[2] + 0.3  # one offset is exact only at equal speed
    reasons = slow[3].pairs.funnel()
    assert reasons["offset"] > 0 and reasons["votes"] > 0 and reasons["axes"] > 0


@pytest.mark.slow
def test_constant_offsets_stay_in_their_range() -> None:
    world = boat((20, 20), (1.5, 1.5))
    settings = CandidatesSettings(sources=("offsets",), offsets="constant", axes_deg=90, offset_range=2)
    network = network_of(world.scene, world.match, settings)
    kept, step = network.pairs.kept(), world.step
    label = np.array(world.scene.image_label())
    assert len(kept)
    offsets: dict[tuple[str, ...], list[int]] = {}
    for i, j in zip(kept.i, kept.j):
        if tuple(label[i]) > tuple(label[j]):
            i, j = j, i
        back = label[i][0] != label[j][0]  # the other pass runs the other way
        offsets.setdefault((*label[i], *label[j]), []).append(int(step[j] + step[i] if back else step[j] - step[i]))
    assert {passes[0] != passes[2] for passes in offsets} == {True, False}
    for key, found in offsets.items():
        one_camera = key[:2] == key[2:]  # its pairs have no order
        assert np.ptp(np.abs(found) if one_camera else found) <= 4


@pytest.mark.slow
def test_paper_000_keeps_the_best_partner_of_each_camera() -> None:
    world = boat((16, 16), (1.5, 1.5))
    settings = CandidatesSettings(sources=("offsets",), offsets="constant", axes_deg=90, offset_range=4, offset_best=1)
    network = network_of(world.scene, world.match, settings)
    kept = network.pairs.kept()
    assert len(kept) and (kept.score >= settings.min_matches).all()
    cameras = len(world.scene.rigs[0].sensors)
    assert len(kept) <= len(world.scene) * 2 * cameras and network.pairs.funnel()["weak"] > 0


def test_of_the_partners_around_an_offset_the_best_ones_are_kept() -> None:
    """``offset_best`` of each image and camera pair; those of too few matches are none."""
    world = boat((16, 16), (1.5, 1.5))
    p, q = find_passes(world.scene)
    settings = CandidatesSettings(offsets="constant", offset_range=4, min_matches=40)
    cache = MatchCache(world.match, len(world.scene))
    scores = score_matrix(p, q, 1, np.ones((5, 5), bool))
    step, every = world.step, _around(scores, (1, 3), 15, True, cache, settings)
    assert set(step[every.i] + step[every.j] - 15) == set(range(-4, 5))
    for best in (1, 2):
        chosen = settings.model_copy(update={"offset_best": best})
        pairs = _around(scores, (1, 3), 15, True, cache, chosen)
        image, partner = np.where(np.isin(pairs.i, p.images[1]), (pairs.i, pairs.j), (pairs.j, pairs.i))
        assert len(np.unique(image)) == 16 and np.isin(partner, q.images[3]).all()
        for k in np.unique(image):
            here = image == k
            ranked = np.sort(pairs.score[here])[::-1]
            enough = ranked[: min(best, int(np.sum(ranked >= 40)))]
            np.testing.assert_array_equal(np.sort(pairs.score[here & (pairs.dropped == 0)])[::-1], enough)


@pytest.mark.slow
def test_axes_that_forbid_a_match_are_previewed_only_to_check_the_rig() -> None:
    world = boat((10,), (2.0,))
    world.pairs_asked = set()
    _, _, _, network = measure(world, CandidatesSettings(axes_deg=100))
    angle = world.scene.rigs[0].axis_angles_deg()
    sensor, frame = world.scene.sensor, world.scene.frame
    forbidden = [(i, j) for i, j in world.pairs_asked if angle[sensor[i], sensor[j]] > 100]
    assert len(forbidden) == 5 * 10 and all(frame[i] == frame[j] for i, j in forbidden)
    rejected = network.pairs.where(network.pairs.dropped == REASONS.index("axes"))
    assert len(rejected) == 5 * 10 * 10  # five camera pairs of the ring look 144 degrees apart
    assert np.isfinite(rejected.score).sum() == len(forbidden)


@pytest.mark.slow
def test_single_pass_and_unknown_rig_work() -> None:
    world = boat((20,), (1.5,))
    bare = tuple(replace(s, sensor_from_rig=None) for s in world.scene.rigs[0].sensors)
    world.scene = world.scene.with_(rigs=(replace(world.scene.rigs[0], sensors=bare),))
    recall, precision, _, network = measure(world, CandidatesSettings())
    assert recall > 0.95 and precision > 0.4 and not any("runs back" in n for n in network.notes)


@pytest.mark.slow
def test_missing_images_and_frames_are_no_obstacle() -> None:
    world = boat((16, 16), (1.5, 1.5))
    keep = np.random.default_rng(0).random(len(world.scene)) > 0.15
    keep[world.scene.frame == 5] = False
    world = world.only(keep)
    recall, _, _, network = measure(world, CandidatesSettings())
    assert recall > 0.9 and network.pairs.j.max() < keep.sum()


@pytest.mark.slow
def test_result_does_not_depend_on_how_often_it_is_asked() -> None:
    one, two = (measure(boat((12, 9), (2.0, 2.6)), CandidatesSettings())[3] for _ in range(2))
    for name in one.pairs.columns():
        assert np.array_equal(getattr(one.pairs, name), getattr(two.pairs, name), equal_nan=True)


@pytest.mark.slow
def test_four_thousand_images_need_few_previews() -> None:
    world = boat((335, 250), (0.5, 0.67))
    n = len(world.scene)
    network = network_of(world.scene, world.match, CandidatesSettings())
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, n, 60000), rng.integers(0, n, 60000)
    i, j = i[i < j], j[i < j]
    useful = np.maximum(world.overlap(i, j), world.overlap(j, i)) >= 0.15
    kept = network.pairs.kept()
    hit = np.isin(i * n + j, kept.i.astype(np.int64) * n + kept.j)
    assert (hit & useful).sum() / useful.sum() > 0.95
    assert 0.002 < world.asked / (n * (n - 1) / 2) < 0.03
    assert not np.any(network.pairs.dropped == REASONS.index("axes"))
    assert any("not matched" in note for note in network.notes)
    assert len(network.pairs) < 200 * n  # rows of the table, dropped ones too: bounded by the image


@pytest.mark.slow
def test_pairs_and_previews_grow_with_the_images_and_not_with_their_square() -> None:
    rows, asked = [], []
    for frames in (80, 240):
        world = boat((frames, frames), (1.0, 1.0), ring(3, up=False))
        context = context_of(world.scene, world.match)
        rows.append(len(estimate_offsets(context).pairs) / len(world.scene))
        asked.append(len(context.cache) / len(world.scene))
    assert 0.5 < rows[1] / rows[0] < 1.3 and asked[1] / asked[0] < 1.3


@pytest.mark.slow
def test_a_coarser_lattice_looks_no_further_from_the_path() -> None:
    """Out of its budget of previews the lattice takes every second frame, and still as many frames beside the path."""
    world = boat((160,), (1.0,), ring(3, up=False))
    step = world.step

    def match(pairs: np.ndarray) -> list[Result]:
        apart = np.abs(step[pairs[:, 0]] - step[pairs[:, 1]])
        return [Result(30 if a <= 12 else 9) for a in apart]

    furthest, previews = [], []
    for budget in (1000, 2):
        tuning = TUNING.model_copy(update={"free_previews": 0, "previews_an_image": budget})
        context = context_of(world.scene, match, tuning=tuning)
        kept = estimate_offsets(context).pairs.kept()
        furthest.append(np.abs(step[kept.i] - step[kept.j]).max())
        previews.append(len(context.cache))
    assert previews[1] < previews[0] and 12 <= furthest[1] <= 1.3 * furthest[0]


def test_chance_gives_neither_heading_nor_direction() -> None:
    world = boat((20, 20), (1.5, 1.5))
    p, q = find_passes(world.scene)
    scores = score_matrix(p, q, 2, np.ones((6, 6), bool))
    rng = np.random.default_rng(3)
    few = np.zeros(scores.inliers.shape)
    few[tuple(rng.integers(0, n, 6) for n in few.shape)] = 1.0
    assert votes(few) == pytest.approx(6) and votes(np.zeros(3)) == 0
    assert yaw(scores, few) is None and in_words(scores, few, TUNING.rig) == ""
    smooth = np.full(few.shape, 8.0, np.float32)
    smooth[0, 0, 0, :3] = 20
    measured = replace(scores, inliers=smooth)
    assert without_chance(measured, smooth, 12, TUNING).max() == pytest.approx(8)
    smooth[1, 1, 0, :3] = 20
    assert without_chance(measured, smooth, 12, TUNING) is smooth
    back = np.zeros(few.shape)
    for c, d in [(0, 2), (0, 3), (1, 3), (1, 4), (2, 0), (3, 0)]:
        back[c, d, np.arange(10), 9 - np.arange(10)] = 1.0
    assert direction(scores, back) == (True, True)
    said = in_words(scores, back, TUNING.rig)
    assert "runs back along" in said and "turned by about" in said and "common view" not in said
    back[:, :, 5:] = 0
    assert "common view: frames 1 to 9 of 20" in in_words(scores, back, TUNING.rig)


def test_couples_of_passes_without_common_view_are_one_note() -> None:
    assert strangers([]) == ()
    (note,) = strangers([f"a - b{k}" for k in range(20)])
    assert note.startswith("no common view was found: a - b0, a - b1")
    assert note.endswith("and 12 more pairs of passes")


def test_yaw_and_vertical_of_a_ring() -> None:
    rig = ring()
    assert np.allclose(vertical(rig), (0, -1, 0))
    evidence = np.zeros((6, 6))
    evidence[0, 2] = evidence[0, 3] = evidence[1, 3] = evidence[1, 4] = 1.0
    assert yaw_between(rig, evidence) == pytest.approx(180, abs=12)
    assert yaw_between(rig, np.eye(6)) == pytest.approx(0, abs=12)
    assert yaw_between(rig, np.zeros((6, 6))) is None
    assert np.allclose(np.diag(angles_deg(rig, 180))[:5], 180)
    turned = np.array([-np.sin(np.radians(72)), 0, np.cos(np.radians(72))])  # the first axis, z, about -y by 72 degrees
    axes = np.array([s.optical_axis() for s in rig.sensors])
    assert np.allclose(angles_deg(rig, 72)[:, 0], np.degrees(np.arccos(np.clip(axes @ turned, -1, 1))))


def test_book_asks_each_pair_once() -> None:
    world = boat((6,), (2.0,))
    cache = MatchCache(world.match, len(world.scene))
    i, j = np.array([3, 1, 3, 5]), np.array([1, 3, 9, 4])
    first = cache.measure(i, j)
    assert world.asked == 3 and len(cache) == 3
    assert np.array_equal(cache.measure(j, i), first) and world.asked == 3
    assert np.isnan(cache.known(np.array([0]), np.array([2]))) and first[0] == first[1]


def test_passes_of_two_rigs_on_one_track_are_two() -> None:
    world = boat((4,), (2.0,))
    assert len(find_passes(world.scene)) == 1
    rigs = (world.scene.rigs[0], world.scene.rigs[0])
    scene = world.scene.with_(rigs=rigs, rig=np.array([0, 1, 0, 1]))
    passes = find_passes(scene)
    assert [len(p) for p in passes] == [2, 2] and passes[0].name != passes[1].name
    loose = scene.with_(sequence=np.array([0, 0, -1, -1]))
    assert set(scene.frame[loose_images(loose)]) == {2, 3}


def test_the_path_between_passes_goes_by_a_lone_peak() -> None:
    rows, columns = np.mgrid[:20, :30]
    evidence = 10 * np.exp(-(((columns - rows - 4) / 2.0) ** 2))
    evidence[10, 28] = 14.0
    assert np.abs(best_line(evidence, 0.02 * evidence.max()) - (np.arange(20) + 4)).max() <= 1


def scores(stride: int = 2) -> ScoreMatrix:
    world = boat((11, 9), (2.0, 2.0))
    p, q = find_passes(world.scene)
    return score_matrix(p, q, stride, np.ones((6, 6), bool))


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
    band = score_matrix(p, p if same else q, 1, np.array([[1, 1], [1, 0]], bool))
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
    band = score_matrix(p, q, 2, np.ones((1, 1), bool))
    a, b = np.ogrid[: len(band.rows), : len(band.columns)]
    known = (np.abs(a + b - len(band.columns)) < 9) | (rng.random((len(band.rows), len(band.columns))) < 0.001)
    counts = rng.integers(0, 60, known.shape).astype(np.float32)
    band = replace(band, inliers=np.where(known, counts, np.nan).astype(np.float32)[None, None])
    low, high = TUNING.counts.floor * 12, TUNING.counts.ceiling * 12
    kernel = {"mode": "constant", "radius": kernel_reach(TUNING)}
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


@pytest.mark.slow
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
    grow = score_matrix(p, q, 1, np.array([[1, 1], [1, 0]], bool))
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
    empty = score_matrix(p, p, 2, np.ones((6, 6), bool))
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


@pytest.mark.slow
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
    scores = score_matrix(p, p, 5, np.ones((SENSORS, SENSORS), bool), level)
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


@pytest.mark.slow
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
