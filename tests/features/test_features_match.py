"""Matching of listed pairs: those, resumed, the same each time; nearest descriptors as NumPy finds them, and nearly as
COLMAP does."""

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from features_world import FRAMES, features, filled_database, scene
from tiegraph.errors import ChildDied, InputError, ReconstructionError
from tiegraph.features import matchblocks, matchers
from tiegraph.features.matchblocks import Rules, Side, match_pairs
from tiegraph.features.settings import MatchSettings
from tiegraph.scene.colmapdatabase import feature_counts, match_counts, pair_ids, write_features
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.pairs import REASONS, Pairs

RULES = Rules()
EMPTY = 5  # the image without features: cam1 of frame 2


def listed() -> Pairs:
    """Same camera, next two frames; pairs of the last frame were dropped by the design."""
    index = [(a, b) for a in range(2 * FRAMES) for b in (a + 2, a + 4) if b < 2 * FRAMES]
    first, second = np.array(index).T
    pairs = Pairs.make(first, second, "sequence")
    return pairs.drop(pairs.j >= 2 * (FRAMES - 1), "cut")


def rows(path, table="two_view_geometries"):
    return sqlite3.connect(path).execute(f"SELECT * FROM {table} ORDER BY 1").fetchall()


def matched(path, pairs, **how):
    """What comes of pairs of the scene, and how many were done, at each step."""
    progress: list[tuple[int, int]] = []
    log = path.with_name("log.txt")
    return *match_pairs(path, scene(), pairs, RULES, log, lambda a, b: progress.append((a, b)), **how), progress


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The listed pairs, matched: folder, pairs, report, progress."""
    folder = tmp_path_factory.mktemp("match")
    path = filled_database(folder / "database.db", scene(), empty=(EMPTY,))
    return folder, *matched(path, listed(), side=Side(1))


@pytest.mark.slow
def test_exactly_the_kept_pairs_are_matched_and_counted_lost_ones_listed_with_the_reason(done):
    folder, pairs, report, progress = done
    kept = listed().dropped == 0
    without = kept & ((pairs.i == EMPTY) | (pairs.j == EMPTY))
    assert without.sum() > 0
    assert [r[0] for r in rows(folder / "database.db")] == sorted(pair_ids(pairs.where(kept & ~without)))
    assert (pairs.inliers[kept & ~without] > 60).all() and (pairs.inliers[without] == -1).all()
    assert (pairs.inliers[~kept] == -1).all()
    assert {REASONS[d] for d in pairs.dropped[without]} == {"match"}
    assert {REASONS[d] for d in pairs.dropped[~kept]} == {"cut"}
    done_now = (kept & ~without).sum()
    assert (report.asked, report.matched, report.verified) == (kept.sum(), done_now, done_now)
    assert report.inliers == pairs.inliers[kept & ~without].sum() <= report.matches
    assert sum(report.configurations.values()) == report.matched
    assert progress[0] == (0, report.matched) and progress[-1] == (report.matched, report.matched)
    name = scene().names[EMPTY]
    assert len(report.lost) == report.asked - report.matched
    assert all(name in both and f"no features in {name}" in reason for both, reason in report.lost)


@pytest.mark.slow
def test_any_number_of_processes_any_history_and_a_cluster_make_the_same_bytes(done, tmp_path):
    folder, *_ = done
    path = filled_database(tmp_path / "database.db", scene(), empty=(EMPTY,))
    few = listed()

    def over_a_cluster(function, items, *args):
        """The worker of the first block is lost when it has ended, and another makes it again."""
        function(items[0], *args)
        return [function(item, *args) for item in items]

    matched(path, few.drop(few.i > 3, "cut"), side=Side(2))
    matched(path, listed(), side=Side(2, over_a_cluster))
    assert path.read_bytes() == (folder / "database.db").read_bytes()


def test_no_process_matches_on_two_threads():
    """Then COLMAP does not always find the same (see the module); a run of these small images seldom shows it."""
    assert matchblocks.colmap_options(RULES)[0].num_threads == 1


@pytest.mark.slow
def test_inliers_tie_the_same_points_and_the_database_opens_in_colmap(done):
    folder, pairs, _, _ = done
    descriptors = {k: d for k, _, d in features(empty=(EMPTY,))}
    with pycolmap.Database.open(folder / "database.db") as database:
        geometry = database.read_two_view_geometry(1, 3)
    a, b = geometry.inlier_matches.T
    assert np.mean((descriptors[0][a] == descriptors[2][b]).all(axis=1)) == 1.0
    assert len(a) == pairs.inliers[(pairs.i == 0) & (pairs.j == 2)][0]


@pytest.mark.slow
def test_a_second_run_does_nothing_and_gives_the_same(done, monkeypatch):
    folder, pairs, report, _ = done
    monkeypatch.setattr(matchblocks, "run_in_children", lambda *a, **k: pytest.fail("matched again"))
    again, second, progress = matched(folder / "database.db", listed())
    assert progress == [(report.matched, report.matched)] and second == report
    assert all(np.array_equal(getattr(again, n), getattr(pairs, n)) for n in ("i", "j", "dropped", "inliers"))


@pytest.mark.slow
def test_pairs_of_another_list_and_half_written_pairs_leave_the_database(tmp_path):
    path = filled_database(tmp_path / "database.db", scene())
    with pycolmap.Database.open(path) as database:
        database.write_matches(1, 12, np.array([[0, 0]], np.uint32))  # not asked
        database.write_matches(1, 3, np.array([[0, 0]], np.uint32))  # asked, no two-view geometry
    pairs = Pairs.make([0], [2], "file")
    result, _, progress = matched(path, pairs)
    assert progress == [(0, 1), (1, 1)] and result.inliers[0] > 60
    assert [r[0] for r in rows(path, "matches")] == pair_ids(pairs).tolist()


@pytest.mark.slow
def test_killed_run_resumes_to_the_same_database_and_survives_names_with_spaces(tmp_path, done):
    """The parent is killed after the first block; names with spaces cannot stand in COLMAP's pair list."""
    path = filled_database(tmp_path / "database.db", scene(space=True), empty=(EMPTY,))
    script = tmp_path / "run.py"
    script.write_text(
        f"import os, signal, sys; sys.path[:0] = {[str(p) for p in Path(__file__).parents[:2]]!r}\n"
        "from pathlib import Path\nfrom test_features_match import *\n"
        "from tiegraph.features import matchblocks\n"
        "def stop(done, total):\n    if done:\n        os.kill(os.getpid(), signal.SIGKILL)\n"
        "if __name__ == '__main__':\n"
        f"    matchblocks.BLOCK_PAIRS = 4\n    folder = Path({str(tmp_path)!r})\n"
        "    match_pairs(folder / 'database.db', scene(space=True), listed(), RULES, folder / 'log.txt', stop)\n"
    )
    assert subprocess.run([sys.executable, str(script)]).returncode == -9
    progress: list[tuple[int, int]] = []
    pairs, report = match_pairs(
        path, scene(space=True), listed(), RULES, tmp_path / "log.txt", lambda a, b: progress.append((a, b)), Side(2)
    )
    folder, expected, full, _ = done
    assert 4 <= progress[0][0] < full.matched and report.matched == full.matched
    assert np.array_equal(pairs.inliers, expected.inliers)
    assert rows(path) == rows(folder / "database.db")
    assert rows(path, "matches") == rows(folder / "database.db", "matches")
    assert [r[1] for r in rows(path, "images")] == list(scene(space=True).names)
    assert not [name for name in os.listdir(tmp_path) if "match" in name]


@pytest.mark.slow
def test_no_verified_pair_is_an_error_with_the_counts(tmp_path):
    path = tmp_path / "database.db"
    create_database(path, scene())
    rng = np.random.default_rng(0)
    noise = [(k, rng.random((50, 4)) * 400, rng.integers(0, 90, (50, 128)).astype(np.uint8)) for k in range(4)]
    write_features(path, noise)
    for pairs, said in (
        (Pairs.make([0], [2], "file"), "no pair verified: 1 asked, 1 compared.*lower match.min_inliers"),
        (Pairs.make([0], [6], "file"), "no features in cam0/img_03.jpg"),
        (Pairs.empty(), "the pair list is empty"),
    ):
        with pytest.raises(ReconstructionError, match=said):
            matched(path, pairs)
    assert set(feature_counts(path)) == {0, 1, 2, 3}


def test_database_of_another_scene_is_refused(tmp_path):
    path = filled_database(tmp_path / "database.db", scene())
    renamed = scene().with_(names=tuple(f"x{n}" for n in scene().names))
    with pytest.raises(InputError, match="other images than the scene"):
        match_pairs(path, renamed, listed(), RULES, tmp_path / "log.txt")


def test_blocks_hold_every_pair_once():
    pairs = listed()
    blocks = matchblocks.cut(pairs, 3)
    together = np.concatenate(blocks)
    assert together.tolist() == list(map(list, zip(pairs.i.tolist(), pairs.j.tolist())))
    assert len(blocks) > 1 and {len(b) for b in blocks[:-1]} == {3}
    assert matchblocks.cut(Pairs.empty(), 3) == []


def test_watermarks_are_struck_out(tmp_path):
    path = filled_database(tmp_path / "database.db", scene())
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = int(pycolmap.TwoViewGeometryConfiguration.WATERMARK)
    geometry.inlier_matches = np.zeros((20, 2), np.uint32)
    with pycolmap.Database.open(path) as database:
        database.write_matches(1, 3, np.zeros((20, 2), np.uint32))
        database.write_two_view_geometry(1, 3, geometry)
    pairs = Pairs.make([0], [2], "file")
    with pytest.raises(ReconstructionError, match="1 compared, 20 feature matches"):
        matched(path, pairs)
    assert [column[0] for column in match_counts(path, pairs)] == [20, 0, geometry.config]


@pytest.mark.slow
def test_a_block_that_ends_its_process_is_left_away_and_the_others_are_done(tmp_path, monkeypatch):
    path = filled_database(tmp_path / "database.db", scene())
    asked, tried = listed(), []

    def some_end(database, blocks, rules, send):
        for name, block in blocks:
            tried.append(tuple(map(int, block[0])))
            Path(name).write_bytes(b"begun")
            if tried[-1] == (int(asked.kept().i[0]), int(asked.kept().j[0])):
                raise ChildDied("match: the native library ended its process (signal SIGSEGV)")
            Path(name).unlink()
            matchblocks.match_blocks(database, [(name, block)], rules, send)

    def child(function, database, blocks, rules, *, on_message=None, **how):
        some_end(database, blocks, rules, on_message or (lambda message: None))

    monkeypatch.setattr(matchblocks, "run_in_child", child)
    monkeypatch.setattr(matchblocks, "run_in_children", lambda f, calls, **how: [child(f, *c, **how) for c in calls])
    monkeypatch.setattr(matchblocks, "BLOCK_PAIRS", 1)
    pairs, report, _ = matched(path, asked)
    assert tried.count(tried[0]) == 2 and len(tried) == report.asked + 1 and report.matched == report.asked - 1
    assert any("no result" in why for _, why in report.lost) and pairs.inliers.max() > 0


KERNELS = matchers.kernels()


def descriptors(count: int, seed: int) -> np.ndarray:
    """(count, 128) u1 unit vectors times 512, as SIFT's."""
    drawn = np.random.default_rng(seed).gamma(0.5, 1.0, (count, 128))
    return np.minimum(np.round(512 * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)), 255).astype(np.uint8)


def both(first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
    a, b = descriptors(first, 1), descriptors(second, 2)
    b[: second // 3] = a[np.arange(second // 3) % max(first, 1)] if first else b[: second // 3]  # the same, some twice
    b[second // 3 : second // 2] = 0
    return a, b


SIZES = [(0, 0), (0, 5), (5, 0), (1, 1), (1, 2), (7, 33), (32, 32), (65, 130), (300, 201)]


built = pytest.mark.skipif(not KERNELS, reason="the native module was not built: no C++ compiler at installation")


@built
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_finds_what_numpy_finds(kernel: str) -> None:
    for first, second in SIZES:
        a, b = both(first, second)
        found, asked = matchers._nearest.search(a, b, kernel), matchers._searched(a, b)
        assert all(np.array_equal(f, n) for f, n in zip(found, asked)), (first, second)
    a, b = np.full((40, 128), 255, np.uint8), np.full((3, 128), 255, np.uint8)
    alike = pytest.approx([matchers.NORM**2] * 40, rel=0.002)
    first, best, second = matchers._nearest.search(a, b, kernel)[0].tolist()
    assert first == [0] * 40 and best == second == alike


@built
def test_more_descriptors_than_a_kernel_counts_go_to_the_next() -> None:
    a, b = np.tile(descriptors(3, 1), (22000, 1)), descriptors(2, 1)[::-1]
    found, _ = matchers.search(a, b)
    assert np.array_equal(found[0, -6::3], [1, 1]) and np.array_equal(found[0, -5::3], [0, 0])
    if "avx2" in KERNELS:
        with pytest.raises(ValueError, match="no kernel avx2 for 66000 descriptors"):
            matchers._nearest.search(a, b, "avx2")


def test_rounded_descriptors_have_one_length_and_keep_their_angles() -> None:
    a = np.concatenate([descriptors(500, 3), descriptors(500, 4) // 2, np.full((1, 128), 255, np.uint8)])
    lone = np.zeros((2, 128), np.uint8)
    lone[0, 5] = 255
    small = matchers.rounded(np.concatenate([a, lone]))
    assert small.max() <= 127 and small[-2, 5] == 127 and not small[-1].any()
    lengths = np.linalg.norm(small[:-2].astype(float), axis=1)
    off = abs(lengths / matchers.NORM - 1)  # large where the largest number of a descriptor had to be cut
    assert np.percentile(off, 90) < 0.005 and off.max() < 0.06 and np.all(lengths**2 <= 65535)
    cosines = [(x / np.linalg.norm(x, axis=1, keepdims=True)) @ (x / np.linalg.norm(x, axis=1, keepdims=True)).T
               for x in (a.astype(float), small[:-2].astype(float))]  # fmt: skip
    error = (cosines[1] - cosines[0])[~np.eye(len(a), dtype=bool)]
    assert abs(error.mean()) < 1e-3 and 1e-3 < error.std() < 4e-3


def test_numpy_finds_the_two_nearest_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = both(65, 130)
    whole = matchers._searched(a, b)
    monkeypatch.setattr(matchers, "_BLOCK", 700)
    assert all(np.array_equal(x, y) for x, y in zip(matchers._searched(a, b), whole))
    dots = matchers.rounded(a).astype(int) @ matchers.rounded(b).astype(int).T
    for found, table in zip(whole, (dots, dots.T)):
        assert np.array_equal(found[0], np.where(table.max(axis=1) > 0, table.argmax(axis=1), -1))
        assert np.array_equal(found[1:], np.sort(table, axis=1)[:, :-3:-1].T)


@built
def test_a_kernel_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="no kernel abacus"):
        matchers._nearest.search(descriptors(2, 1), descriptors(2, 2), "abacus")
    with pytest.raises(TypeError):
        matchers._nearest.search(np.zeros((2, 64), np.uint8), np.zeros((2, 64), np.uint8))


@pytest.mark.slow
def test_matches_are_those_of_colmaps_exact_matcher_but_for_rounding(tmp_path, monkeypatch) -> None:
    rules = Rules(MatchSettings(min_inliers=200))  # some pairs have fewer matches, some fewer inliers
    database = filled_database(tmp_path / "database.db", scene())
    block = np.array([(a, b) for a in range(12) for b in range(a + 1, 12)])
    matchblocks._by_matcher(database, tmp_path / "ours.db", block, rules)
    with monkeypatch.context() as patch:
        patch.setattr(matchers, "_nearest", None)
        matchblocks._by_matcher(database, tmp_path / "numpy.db", block, rules)
    monkeypatch.setattr(matchblocks, "colmap_options", exact)
    matchblocks._by_colmap(database, tmp_path / "colmap.db", block, rules)
    for table in ("matches", "two_view_geometries"):
        ours, without, theirs = (rows_of(tmp_path / name, table) for name in ("ours.db", "numpy.db", "colmap.db"))
        assert ours == without and len(ours) == len(theirs) == len(block)
        counts = np.array([[row[1] for row in rows] for rows in (ours, theirs)])
        assert counts.sum(axis=1)[0] == pytest.approx(counts.sum(axis=1)[1], rel=0.01)
        several = counts.min(axis=0) > 0
        assert np.all(abs(np.subtract(*counts[:, several])) <= 0.05 * counts[:, several].max(axis=0) + 5)
    assert 20 < (counts[0] >= 200).sum() < len(block) - 10 and 0 in counts[0]


def exact(rules: Rules, options=matchblocks.colmap_options):
    matching, verification = options(rules)
    matching.sift.cpu_brute_force_matcher = True
    return matching, verification


def rows_of(path, table):
    return sqlite3.connect(path).execute(f"SELECT * FROM {table} ORDER BY 1").fetchall()
