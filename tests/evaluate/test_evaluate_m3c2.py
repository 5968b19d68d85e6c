"""M3C2 against all points and against py4dgeo; its level of detection against chance; changes with known size."""

from pathlib import Path

import numpy as np
import pytest

from clouds_world import ground, quay, stated, tiled
from tiegraph.evaluate.clouds.m3c2 import Cylinders, Differences, changes, cylinders_of, m3c2, m3c2_tiled, normals
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.evaluate.tuning import ChangesTuning, M3c2Tuning
from tiegraph.scene.cloudchunks import Points

TUNING = M3c2Tuning()
LENGTHS = Cylinders(radius_m=0.5, normal_m=1.0, depth_m=1.7, cores_m=0.5)


def bare(xyz: np.ndarray) -> Points:
    return Points(xyz, np.full(len(xyz), np.nan))


def differences(first, second, folder: Path, lengths: Cylinders | None = None, **how) -> Differences:
    clouds = tiled(first, second, folder, how.pop("tile_points", 2_000_000))
    return m3c2_tiled(clouds, lengths or cylinders_of(clouds, TUNING), TUNING, **how)


@pytest.mark.slow
@pytest.mark.parametrize("registration", [0.0, 0.02])
@pytest.mark.parametrize("states", [False, True], ids=["bare", "with sigmas"])
def test_it_is_the_formula(registration: float, states: bool) -> None:
    one, two = ground(12_000, 0), ground(12_000, 1) + [0, 0, 0.03]
    cores, rng = ground(150, 2), np.random.default_rng(4)
    sigma = [rng.uniform(0.01, 0.05, len(xyz)) * (1 if states else np.nan) for xyz in (one, two)]
    normal = normals(cores, one, LENGTHS.normal_m)
    found, lod = m3c2(cores, normal, (Points(one, sigma[0]), Points(two, sigma[1])), LENGTHS, TUNING, registration)
    for k in range(0, 150, 7):
        mean, variance = [], registration**2
        near = one[np.linalg.norm(one - cores[k], axis=1) <= LENGTHS.normal_m]
        own = np.linalg.svd(near - near.mean(axis=0))[2][2]
        assert abs(own @ normal[k]) == pytest.approx(1, abs=1e-9)
        for cloud, p in zip((one, two), sigma):
            along = (cloud - cores[k]) @ normal[k]
            away = np.linalg.norm(cloud - cores[k] - along[:, None] * normal[k], axis=1)
            seen = (away <= LENGTHS.radius_m) & (np.abs(along) <= LENGTHS.depth_m)
            inside = along[seen]
            mean.append(inside.mean())
            variance += inside.var(ddof=1) / len(inside) + (np.mean(p[seen] ** 2) if states else 0.0)
        assert found[k] == pytest.approx(mean[1] - mean[0], abs=1e-10)
        assert lod[k] == pytest.approx(1.96 * np.sqrt(variance), rel=1e-9)


@pytest.mark.slow
def test_it_is_py4dgeo() -> None:
    py4dgeo = pytest.importorskip("py4dgeo")
    one, two = ground(12_000, 0), ground(12_000, 1) + [0, 0, 0.03]
    cores = ground(300, 2)  # no points of a cloud: those lie on a border between parts of py4dgeo's cylinders
    epochs = py4dgeo.Epoch(one), py4dgeo.Epoch(two)
    theirs = py4dgeo.M3C2(
        epochs=epochs,
        corepoints=cores,
        cyl_radius=LENGTHS.radius_m,
        normal_radii=(LENGTHS.normal_m,),
        max_distance=LENGTHS.depth_m,
        registration_error=0.0,
    )
    distance, uncertain = theirs.run()
    normal = np.asarray(theirs.directions())
    assert np.abs(np.einsum("ij,ij->i", normal, normals(cores, one, LENGTHS.normal_m))).min() > 1 - 1e-9
    found, lod = m3c2(cores, normal, (bare(one), bare(two)), LENGTHS, M3c2Tuning(least_points=2))
    assert np.abs(found - distance).max() < 1e-10 and 0.02 < np.median(found) * np.sign(normal[:, 2].mean()) < 0.04
    assert lod == pytest.approx(uncertain["lodetection"], rel=1e-9)


def test_tiles_change_nothing(tmp_path: Path) -> None:
    one, two = quay(3000, 0, 0.01), quay(3000, 1, 0.01)
    found = [differences(one, two, tmp_path, LENGTHS, tile_points=n) for n in (2_000_000, 400)]
    order = [np.lexsort(f.xyz.T) for f in found]
    assert len(found[0]) == len(found[1]) > 100
    for name in ("xyz", "distance_m", "lod_m"):
        whole, tiles = (getattr(f, name)[k] for f, k in zip(found, order))
        assert np.allclose(whole, tiles, atol=1e-6, equal_nan=True)


def test_normals_face_the_cameras(tmp_path: Path) -> None:
    cameras = Cameras(np.array([[5.0, 1.0, -3.0]]), ("",))  # below the floor, in front of the wall
    moved = quay(8000, 1) + [0, -0.05, -0.05]
    found = differences(quay(8000), moved, tmp_path, LENGTHS, cameras=cameras)
    inside = found.known & (np.abs(found.xyz[:, 1] - 2) < 1) | found.known & (np.abs(found.xyz[:, 2] - 2) < 1)
    assert found.distance_m[inside] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.slow
def test_a_box_moved_by_5_cm_is_found_and_the_rest_is_chance(tmp_path: Path) -> None:
    found = differences(ground(40_000, 0, 0.02), ground(40_000, 1, 0.02, box_m=0.05), tmp_path)
    x, y = np.abs(found.xyz[:, :2]).T
    box, still = found.known & (x < 1.5) & (y < 1.5), found.known & ((x > 2.6) | (y > 2.6))
    assert found.significant[box].mean() > 0.95 and 0.045 < np.median(found.distance_m[box]) < 0.055
    assert 0.03 < found.significant[still].mean() < 0.08
    done = changes(found, ChangesTuning())
    assert len(done.listed) == 1 and done.listed[0].mean_m == pytest.approx(0.05, abs=0.01)
    assert np.abs(done.listed[0].middle[:2]).max() < 0.3
    assert 14 < done.listed[0].area_m2 < 22 and 0.6 < done.listed[0].volume_m3 < 1.0  # 16 m2, 0.8 m3
    assert 380 < done.compared_m2 < 450


@pytest.mark.slow
def test_the_surveys_own_sigmas_hold_chance_at_5_percent(tmp_path: Path) -> None:
    """Each survey is shifted by its registration and bent by errors its points share, both drawn from their sigmas."""
    registration, point = 0.02, 0.03
    lengths = Cylinders(radius_m=0.4, normal_m=0.8, depth_m=0.8, cores_m=0.5)
    rates = []
    for seed in range(12):
        rng, clouds = np.random.default_rng(seed), []
        for k in range(2):
            xyz = ground(15_000, 100 * seed + k, 0.01)
            patch = np.floor(xyz[:, :2] / 4 + 3).astype(int)
            shift = registration / np.sqrt(2) * rng.standard_normal()
            xyz[:, 2] += point * rng.standard_normal((6, 6))[patch[:, 0], patch[:, 1]] + shift
            clouds.append(stated(xyz, point))
        found = differences(*clouds, tmp_path, lengths, registration=lambda at, normal: np.full(len(at), registration))
        inside = found.known & (np.abs(found.xyz[:, :2] % 4 - 2) < 1.2).all(axis=1)  # not across two patches
        rates.append(found.significant[inside].mean())
    assert 0.02 < np.mean(rates) < 0.09


def test_thin_places_are_not_told(tmp_path: Path) -> None:
    up, few = np.array([[0, 0, 1.0]]), (bare(ground(500, 0)), bare(ground(5, 1)))
    found, lod = m3c2(np.zeros((1, 3)), up, few, LENGTHS, TUNING)
    assert np.isnan(found).all() and np.isnan(lod).all()
