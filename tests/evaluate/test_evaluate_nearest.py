"""Accuracy, completeness and ghosts of clouds made for it, against brute force."""

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from clouds_world import quay, tiled
from tiegraph.evaluate.clouds import tiles
from tiegraph.evaluate.clouds.nearest import Cameras, CloudComparison, cloud_to_cloud, criteria_of
from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.scene.cloudchunks import Points, PointSource, points_of

TUNING = CloudTuning()


def judged(cloud, reference, folder: Path, distances=(), tile_points=2_000_000, **more) -> CloudComparison:
    clouds = tiled(cloud, reference, folder, tile_points)
    cameras, range_m = more.get("cameras"), more.get("range_m")
    return cloud_to_cloud(clouds, criteria_of(clouds, TUNING, distances, range_m=range_m), folder, cameras)


def by_hand(cloud: np.ndarray, reference: np.ndarray, found: CloudComparison) -> tuple[list, list, float, float]:
    """Accuracy, completeness, ghosts and median by all pairs of points."""
    criteria = found.criteria

    def voxels(xyz: np.ndarray) -> np.ndarray:
        best: dict[tuple, tuple] = {}
        for k, p in enumerate(xyz):
            cell = tuple(np.floor(p / criteria.voxel_m))
            off = float(np.sum((p / criteria.voxel_m - np.floor(p / criteria.voxel_m) - 0.5) ** 2))
            best[cell] = min(best.get(cell, (np.inf, 0)), (off, k))
        return xyz[sorted(k for _, k in best.values())]

    thin, thin_ref = voxels(cloud), voxels(reference)
    away = np.linalg.norm(thin[:, None] - reference[None], axis=2).min(axis=1)
    plan = np.linalg.norm(thin[:, None, :2] - reference[None, :, :2], axis=2).min(axis=1)
    low, high = reference[:, 2].min() - criteria.observed_m, reference[:, 2].max() + criteria.observed_m
    inside = (plan <= criteria.observed_m) & (thin[:, 2] >= low) & (thin[:, 2] <= high)
    back = np.linalg.norm(thin_ref[:, None] - cloud[None], axis=2).min(axis=1)
    shares = [[float(np.mean(d < t)) for t in criteria.distances_m] for d in (away[inside], back)]
    return shares[0], shares[1], float(np.mean(away[inside] > criteria.ghost_m)), float(np.median(away[inside]))


@pytest.mark.slow
@pytest.mark.parametrize("tile_points", [2_000_000, 300])
def test_tiles_give_what_all_pairs_give(tmp_path: Path, tile_points: int) -> None:
    rng = np.random.default_rng(5)
    cloud = np.vstack([quay(2000, 1, 0.05), rng.uniform([1, 1, 0.8], [9, 3.5, 3], (150, 3))])
    reference = quay(2500, 2)
    found = judged(cloud, reference, tmp_path, (0.1, 0.2, 0.5), tile_points)
    accuracy, completeness, ghosts, median = by_hand(cloud, reference, found)
    assert found.whole.accuracy == pytest.approx(accuracy, abs=1e-12)
    assert found.whole.completeness == pytest.approx(completeness, abs=1e-12)
    assert found.whole.ghosts == pytest.approx(ghosts, abs=1e-12) and 0.02 < ghosts < 0.15
    assert found.whole.median_m == pytest.approx(median, rel=1e-6)
    f = [2 * a * c / (a + c) for a, c in zip(accuracy, completeness)]
    assert found.whole.fscore == pytest.approx(f, abs=1e-12) and 0 < f[0] < 1
    written = np.concatenate([away for _, away in found.points()])
    assert len(written) == found.whole.points and np.median(written) == pytest.approx(median, rel=1e-6)


def test_the_same_cloud_is_perfect_and_distances_fit_it(tmp_path: Path) -> None:
    found = judged(quay(), quay(), tmp_path)
    assert found.criteria.distances_m == (0.05, 0.1, 0.2, 0.5)  # its points are 3 cm apart
    assert found.whole.accuracy == found.whole.completeness == found.whole.fscore == (1, 1, 1, 1)
    assert found.whole.median_m == 0 and found.whole.ghosts == 0 and found.whole.outside == 0


def test_distances_follow_the_gsd(tmp_path: Path) -> None:
    clouds = tiled(quay(500), quay(500), tmp_path)
    assert criteria_of(clouds, TUNING, gsd_m=0.012).distances_m == (0.02, 0.05, 0.1, 0.2)
    assert criteria_of(clouds, TUNING, gsd_m=0.005).distances_m == (0.005, 0.01, 0.02, 0.05)
    assert criteria_of(clouds, TUNING, (0.3, 0.1), gsd_m=0.005).distances_m == (0.1, 0.3)


def test_half_a_cloud_is_accurate_and_half_complete(tmp_path: Path) -> None:
    whole = quay()
    found = judged(whole[whole[:, 0] < 5], whole, tmp_path, (0.05,)).whole
    assert found.accuracy[0] == 1.0 and 0.49 < found.completeness[0] < 0.55
    assert 0.65 < found.fscore[0] < 0.71


def test_only_the_reference_near_the_cameras_counts_and_groups_are_told(tmp_path: Path) -> None:
    whole = quay()
    cameras = Cameras(np.array([[0.0, 2.0, 1.5], [9.0, 2.0, 1.5]]), ("open", "bridge"))
    found = judged(whole[whole[:, 0] < 4], whole, tmp_path, (0.05,), cameras=cameras, range_m=7.0)
    assert found.sections["open"].fscore[0] > 0.9 > 0.1 > found.sections["bridge"].fscore[0]
    assert list(found.bands) == ["0 to 5 m"] or "5 to 10 m" in found.bands or found.bands == {}
    assert "within 7 m of a registered camera" in found.criteria.meaning
    assert "cloud against reference by section" in found.tables()
    with pytest.raises(ValueError, match="do both share a frame"):
        judged(whole, whole, tmp_path, (0.05,), cameras=Cameras(cameras.centres + 1000, ("a", "a")), range_m=7.0)


def test_ghosts_are_where_the_reference_observed_only(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    inside = rng.uniform([1, 1, 1.5], [9, 3, 3], (1000, 3))  # in the air above the floor
    beyond = rng.uniform([50, 1, 1], [60, 3, 3], (3000, 3))  # where the reference says nothing
    found = judged(np.vstack([quay(4000), inside, beyond]), quay(20_000, 2), tmp_path, (0.1,)).whole
    assert 0.17 < found.ghosts < 0.25 and found.outside == pytest.approx(3 / 8, abs=0.05)


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="reference has no points"):
        clouds = tiled(quay(100), np.zeros((0, 3)), tmp_path)
        cloud_to_cloud(clouds, criteria_of(clouds, TUNING), tmp_path)
    with pytest.raises(ValueError, match=r"from \(0.0.* and the other \(from \(1000.0.* do not meet.* one CRS"):
        judged(quay(500), quay(500) + 1000, tmp_path, (0.1,))


def test_a_sample_is_even() -> None:
    some = points_of(np.arange(30.0).reshape(10, 3)).sample(4)
    assert len(some) <= 4 and np.array_equal(some[:, 0], np.arange(0, 30, 12)[: len(some)])


@pytest.mark.slow
def test_memory_is_that_of_a_tile(tmp_path: Path, monkeypatch) -> None:
    """Of a street four times as long: only what is held of each judged point grows, half of its coordinates."""
    monkeypatch.setattr(tiles, "_PART", 5000)

    def street(points: int, seed: int) -> PointSource:
        def parts() -> Iterator[Points]:
            rng = np.random.default_rng(seed)
            for start in range(0, points, 5000):
                xyz = rng.uniform((0, 0, 0), (5.0, 10.0, 0.01), (5000, 3)) + [start / 1000, 0, 0]
                yield Points(xyz, np.full(5000, np.nan))

        return PointSource("a street", parts)

    peaks = []
    for points in (80_000, 320_000):
        tracemalloc.start()
        judged(street(points, 0), street(points, 1), tmp_path, (0.1,), 40_000)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[0] < 10e6 and 5 < (peaks[1] - peaks[0]) / (2 * 240_000) < 20  # bytes
