"""Nearest descriptors: every kernel finds what NumPy finds, and the matches are those of COLMAP's exact matcher."""

import sqlite3

import numpy as np
import pytest

from features_world import filled_database, scene
from tiegraph.features import matchblocks, nearest
from tiegraph.features.matchblocks import Rules
from tiegraph.features.settings import MatchSettings

KERNELS = nearest.kernels()


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
        found, asked = nearest._nearest.search(a, b, kernel), nearest._searched(a, b)
        assert all(np.array_equal(f, n) for f, n in zip(found, asked)), (first, second)
    a, b = np.full((40, 128), 255, np.uint8), np.full((3, 128), 255, np.uint8)  # no sum leaves its 32 bits
    assert nearest._nearest.search(a, b, kernel)[0].tolist() == [[0] * 40, [128 * 255**2] * 40, [128 * 255**2] * 40]


def test_numpy_finds_the_two_nearest_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = both(65, 130)
    whole = nearest._searched(a, b)
    monkeypatch.setattr(nearest, "_BLOCK", 700)
    assert all(np.array_equal(x, y) for x, y in zip(nearest._searched(a, b), whole))
    dots = a.astype(int) @ b.astype(int).T
    for found, table in zip(whole, (dots, dots.T)):
        assert np.array_equal(found[0], np.where(table.max(axis=1) > 0, table.argmax(axis=1), -1))
        assert np.array_equal(found[1:], np.sort(table, axis=1)[:, :-3:-1].T)


@built
def test_a_kernel_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="no kernel abacus"):
        nearest._nearest.search(descriptors(2, 1), descriptors(2, 2), "abacus")
    with pytest.raises(TypeError):
        nearest._nearest.search(np.zeros((2, 64), np.uint8), np.zeros((2, 64), np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize("without", [False, True])
def test_rows_are_those_of_colmaps_exact_matcher(tmp_path, monkeypatch, without) -> None:
    rules = Rules(MatchSettings(min_inliers=200))  # some pairs have fewer matches, some fewer inliers
    database = filled_database(tmp_path / "database.db", scene())
    block = np.array([(a, b) for a in range(12) for b in range(a + 1, 12)])
    if without:
        monkeypatch.setattr(nearest, "_nearest", None)
    matchblocks._by_nearest(database, tmp_path / "ours.db", block, rules)
    monkeypatch.setattr(matchblocks, "colmap_options", exact)
    matchblocks._by_colmap(database, tmp_path / "colmap.db", block, rules)
    for table in ("matches", "two_view_geometries"):
        ours, theirs = (rows(tmp_path / name, table) for name in ("ours.db", "colmap.db"))
        assert ours == theirs and len(ours) == len(block)
    verified = [row[1] for row in rows(tmp_path / "ours.db", "two_view_geometries")]
    assert 20 < sum(n >= 200 for n in verified) < len(block) - 10 and 0 in verified


def exact(rules: Rules, options=matchblocks.colmap_options):
    matching, verification = options(rules)
    matching.sift.cpu_brute_force_matcher = True
    return matching, verification


def rows(path, table):
    return sqlite3.connect(path).execute(f"SELECT * FROM {table} ORDER BY 1").fetchall()
