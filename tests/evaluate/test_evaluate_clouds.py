"""Clouds against clouds: nearest points, M3C2, registration; references read, matched, brought into the run's world."""

import json
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pycolmap
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from clouds_world import ground, quay, stated, tiled
from said import refused, says
from tiegraph.evaluate import reference
from tiegraph.evaluate.clouds import tiles
from tiegraph.evaluate.clouds.m3c2 import Cylinders, Differences, changes, cylinders_of, m3c2, m3c2_tiled, normals
from tiegraph.evaluate.clouds.nearest import Cameras, CloudComparison, cloud_to_cloud, criteria_of
from tiegraph.evaluate.clouds.register import register
from tiegraph.evaluate.reference import ModelPoses, ReferencePoses
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.survey import Products, evaluate_survey
from tiegraph.evaluate.trajectory import evaluate_trajectory
from tiegraph.evaluate.tuning import CloudTuning, M3c2Tuning, RegistrationTuning, Tuning
from tiegraph.geometry import geodesy, transforms
from tiegraph.geometry.coarse import start_of
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import Similarity
from tiegraph.scene.cloudchunks import Points, PointSource, points_of
from tiegraph.scene.colmapmodel import registration
from tiegraph.scene.results import Cloud, Metric, metrics_to_dict
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.scene.tuning import RegisteredTuning

CLOUD = CloudTuning()


def judged(cloud, reference, folder: Path, distances=(), tile_points=2_000_000, **more) -> CloudComparison:
    clouds = tiled(cloud, reference, folder, tile_points)
    cameras, range_m = more.get("cameras"), more.get("range_m")
    return cloud_to_cloud(clouds, criteria_of(clouds, distances, range_m=range_m), folder, cameras)


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


@pytest.mark.slow
def test_the_same_cloud_is_perfect_and_distances_fit_it(tmp_path: Path) -> None:
    found = judged(quay(), quay(), tmp_path)
    assert found.criteria.distances_m == (0.05, 0.1, 0.2, 0.5)  # its points are 3 cm apart
    assert found.whole.accuracy == found.whole.completeness == found.whole.fscore == (1, 1, 1, 1)
    assert found.whole.median_m == 0 and found.whole.ghosts == 0 and found.whole.outside == 0


def test_distances_follow_the_gsd(tmp_path: Path) -> None:
    clouds = tiled(quay(500), quay(500), tmp_path)
    assert criteria_of(clouds, gsd_m=0.012).distances_m == (0.02, 0.05, 0.1, 0.2)
    assert criteria_of(clouds, gsd_m=0.005).distances_m == (0.005, 0.01, 0.02, 0.05)
    assert criteria_of(clouds, (0.3, 0.1), gsd_m=0.005).distances_m == (0.1, 0.3)


@pytest.mark.slow
def test_half_a_cloud_is_accurate_and_half_complete(tmp_path: Path) -> None:
    whole = quay()
    found = judged(whole[whole[:, 0] < 5], whole, tmp_path, (0.05,)).whole
    assert found.accuracy[0] == 1.0 and 0.49 < found.completeness[0] < 0.55
    assert 0.65 < found.fscore[0] < 0.71


@pytest.mark.slow
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


@pytest.mark.slow
def test_ghosts_are_where_the_reference_observed_only(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    inside = rng.uniform([1, 1, 1.5], [9, 3, 3], (1000, 3))  # in the air above the floor
    beyond = rng.uniform([50, 1, 1], [60, 3, 3], (3000, 3))  # where the reference says nothing
    found = judged(np.vstack([quay(4000), inside, beyond]), quay(20_000, 2), tmp_path, (0.1,)).whole
    assert 0.17 < found.ghosts < 0.25 and found.outside == pytest.approx(3 / 8, abs=0.05)


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="reference has no points"):
        clouds = tiled(quay(100), np.zeros((0, 3)), tmp_path)
        cloud_to_cloud(clouds, criteria_of(clouds), tmp_path)
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


M3C2 = M3c2Tuning()
LENGTHS = Cylinders(radius_m=0.5, normal_m=1.0, depth_m=1.7, cores_m=0.5)


def bare(xyz: np.ndarray) -> Points:
    return Points(xyz, np.full(len(xyz), np.nan))


def differences(first, second, folder: Path, lengths: Cylinders | None = None, **how) -> Differences:
    clouds = tiled(first, second, folder, how.pop("tile_points", 2_000_000))
    return m3c2_tiled(clouds, lengths or cylinders_of(clouds, M3C2), M3C2, **how)


@pytest.mark.slow
@pytest.mark.parametrize("registration", [0.0, 0.02])
@pytest.mark.parametrize("states", [False, True], ids=["bare", "with sigmas"])
def test_it_is_the_formula(registration: float, states: bool) -> None:
    one, two = ground(12_000, 0), ground(12_000, 1) + [0, 0, 0.03]
    cores, rng = ground(150, 2), np.random.default_rng(4)
    sigma = [rng.uniform(0.01, 0.05, len(xyz)) * (1 if states else np.nan) for xyz in (one, two)]
    normal = normals(cores, one, LENGTHS.normal_m)
    found, lod = m3c2(cores, normal, (Points(one, sigma[0]), Points(two, sigma[1])), LENGTHS, M3C2, registration)
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


@pytest.mark.slow
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
    done = changes(found)
    (change,) = done.listed
    east, north, _, _, area_m2, mean_m, _, volume_m3 = change
    assert mean_m == pytest.approx(0.05, abs=0.01) and max(abs(east), abs(north)) < 0.3
    assert 14 < area_m2 < 22 and 0.6 < volume_m3 < 1.0  # 16 m2, 0.8 m3
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
    found, lod = m3c2(np.zeros((1, 3)), up, few, LENGTHS, M3C2)
    assert np.isnan(found).all() and np.isnan(lod).all()


ICP = RegistrationTuning()


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
    found = register(moved, room(0), ICP, with_scale=scale != 1)
    off = np.linalg.norm(found.fit(moved) - cloud, axis=1)
    sigma = np.linalg.norm(found.error.sigma(cloud), axis=1)
    assert off.max() < 0.004 and 0.2 < np.median(off / sigma) < 4
    assert 0.008 < found.residual_m < 0.02 and found.used > 0.99
    rows = {name: value for name, value, _ in found.table()["rows"]}
    assert rows["scale"] == pytest.approx(scale, abs=3e-4) and rows["turn about z, deg"] == pytest.approx(
        1.146, abs=0.02
    )


@pytest.mark.slow
def test_what_slides_or_does_not_meet_is_refused() -> None:
    corner = room(0)
    wall = corner[:4000]
    with pytest.raises(ValueError, match="they slide along each other"):
        register(wall + [0.1, 0, 0], wall, ICP)
    three = corner[(corner[:, 1] < 1) | (corner[:, 0] < 1) | (corner[:, 2] < 1) & (corner[:, 1] < 6)][::4]
    three = three[three[:, 1] < 11.5]
    with pytest.raises(ValueError, match="scale|slide"):  # grows about its corner and lies on itself
        register(three[three[:, 0] < 29], three, ICP, with_scale=True)
    with pytest.raises(ValueError, match="0 of .* too far apart for a fine registration"):
        register(wall + 100, wall, ICP)


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
    start = start_of(moved, reference, ICP.coarse)
    found = register(moved, reference, ICP, start=start)
    off = np.linalg.norm(found.fit(moved) - cloud, axis=1)
    assert off.max() < 0.01 < 0.1 < np.linalg.norm(moved - cloud, axis=1).min()
    assert 0.9 < start.share > start.rival + 0.02 and start.matches > 10
    rows = {name: value for name, value, _ in found.table()["rows"]}
    assert rows["coarse start: consistent matches"] == start.matches
    with pytest.raises(ValueError, match="stand in one place"):
        start_of(np.ones((9, 3)), reference, ICP.coarse)


FRAMES = 12
TUNING = Tuning()
GAP_S = TUNING.trajectory.max_gap_s
TURN = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # a camera looking along x, z up


def rig_poses() -> np.ndarray:
    s = 2.0 * np.arange(FRAMES)
    heading = Rotation.from_rotvec(np.outer(0.02 * s, [0, 0, 1])).as_matrix()
    return transforms.rigid(heading @ TURN, np.column_stack([s, np.sin(s / 5), 0 * s + 2]))


def make_scene(times: bool = False) -> Scene:
    beside = transforms.rigid(np.eye(3), [-0.5, 0, 0])
    rig = Rig("pair", (Sensor("cam0", None, np.eye(4)), Sensor("cam1", None, beside)))
    names = [f"up/cam{c}/{f:04d}.jpg" for c in range(2) for f in range(FRAMES)]
    time_s = 100.0 + np.arange(FRAMES) if times else np.full(FRAMES, np.nan)
    frame, sensor = np.tile(np.arange(FRAMES), 2), np.repeat([0, 1], FRAMES)
    return simple_scene(rig, names, frame, sensor, np.zeros(FRAMES), sequences=("up",), time_s=time_s)


def make_model(scene: Scene, missing: int = 0) -> pycolmap.Reconstruction:
    """The scene's images at their true poses, the first ``missing`` frames of cam1 left out; each sees 12 points of its
    own but the last of cam1, which sees 9."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    for k, name in enumerate(scene.names):
        if scene.sensor[k] == 1 and scene.frame[k] < missing:
            continue
        pose = scene.sensor_of(k).sensor_from_rig @ transforms.invert(rig_poses()[scene.frame[k]])
        xy = np.stack([np.linspace(50, 500, 12), np.full(12, 200.0)], axis=1)
        image = pycolmap.Image(name=name, camera_id=1, image_id=k + 1, keypoints=xy)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
        local = 5 * np.column_stack([camera.cam_from_img(xy), np.ones(12)])
        for row, point in enumerate(transforms.apply(transforms.invert(pose), local)):
            if k < len(scene) - 1 or row < 9:
                model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, row)]))
    return model


def write_tum(path: Path, time_s: np.ndarray, poses: np.ndarray) -> Path:
    q = transforms.quaternion_xyzw(poses[:, :3, :3])
    np.savetxt(path, np.column_stack([time_s, poses[:, :3, 3], q]), fmt="%.9f", header="time pose")
    return path


def a_cloud() -> Cloud:
    rng = np.random.default_rng(0)
    xyz = np.column_stack([rng.uniform(0, 30, 20000), np.full(20000, 8.0), rng.uniform(0, 6, 20000)])
    zero = np.zeros(len(xyz), np.float32)
    return Cloud(xyz, np.zeros((len(xyz), 3), np.uint8), np.zeros((len(xyz), 3), np.float32), zero, zero)


@pytest.mark.parametrize("binary", [True, False])
def test_a_colmap_model_is_matched_by_name(tmp_path: Path, binary: bool) -> None:
    scene = make_scene()
    truth = make_model(scene)
    (truth.write_binary if binary else truth.write_text)(tmp_path)
    model = reference.model_poses(make_model(scene, missing=3), scene)
    assert model.placed.sum() == 2 * FRAMES - 3 and np.allclose(model.world_from_rig, rig_poses())
    assert np.linalg.norm(model.world_from_camera[-1, :3, 3] - rig_poses()[-1, :3, 3]) == pytest.approx(0.5)
    match, said = reference.match_poses(reference.read_reference_poses(tmp_path), model, scene, GAP_S)
    assert len(match) == 21 and "21 placed of 24" in said
    assert set(match.parts["pass and camera"]) == {"up cam0", "up cam1"}
    assert np.allclose(match.estimate, match.reference, atol=1e-6)


@pytest.mark.parametrize("times", [True, False])
def test_tum_by_time_or_in_order_with_other_body_axes(tmp_path: Path, times: bool) -> None:
    scene = make_scene(times)
    body = rig_poses() @ transforms.rigid(TURN.T, np.zeros(3))  # the vehicle's axes: x forward, z up
    write_tum(tmp_path / "rig_up.tum", 100.0 + np.arange(FRAMES), body)
    model = reference.model_poses(make_model(scene), scene)
    match, said = reference.match_poses(reference.read_reference_poses(tmp_path), model, scene, GAP_S)
    assert len(match) == FRAMES and ("by time" if times else "in order") in said
    assert np.allclose(match.estimate, match.reference, atol=1e-5)


def test_poses_with_times_are_of_no_pass_at_another_time(tmp_path: Path) -> None:
    """A file that ends half-way, with as many poses as the second pass has frames: those are not its poses."""
    whole, half = make_scene(times=True), FRAMES // 2
    order = {"sequence": np.repeat([0, 1], half), "sequence_index": np.tile(np.arange(half), 2)}
    scene = replace(whole, sequences=("up", "down"), **order)
    path = write_tum(tmp_path / "half.tum", whole.time_s[:half], rig_poses()[:half])
    model = reference.model_poses(make_model(scene), scene)
    match, said = reference.match_poses(reference.read_reference_poses(path), model, scene, GAP_S)
    assert "up by time; down at none of its times" in said and set(match.parts["pass"]) == {"up"}
    assert len(match) == half and np.allclose(match.estimate, match.reference, atol=1e-5)


def test_unusable_references_say_why(tmp_path: Path) -> None:
    scene = make_scene()
    model = reference.model_poses(make_model(scene), scene)
    (tmp_path / "empty").mkdir()
    for name, data in (("cut", b"nonsense"), ("bare", bytes(8))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "images.bin").write_bytes(data)
    for name, words in (
        ("empty", "neither a COLMAP model"),
        ("none", "no such reference"),
        ("cut", "images.bin: the file is cut off"),
        ("bare", "not a readable COLMAP model"),
    ):
        with refused(words):
            reference.read_reference_poses(tmp_path / name)
    for text, words in (
        ("# time\n1 2 3\n", r"bad.tum, line 2: 3 columns; expected"),
        ("# nothing\n", "no rows; give the traj"),
    ):
        (tmp_path / "bad.tum").write_text(text)
        with refused(words):
            reference.read_tum(tmp_path / "bad.tum")
    short = write_tum(tmp_path / "short.tum", np.arange(5.0), rig_poses()[:5])
    other = ReferencePoses({}, {"other": reference.read_tum(short)}, tmp_path)
    for poses, words in (
        (reference.read_reference_poses(short), "5 poses for 12 frames"),
        (other, "only 0 poses"),
    ):
        with refused(words):
            reference.match_poses(poses, model, scene, GAP_S)


def test_local_metres_become_world_metres() -> None:
    world = geodesy.make_origin(35.6965, 139.7695, 37.0)
    local = Origin(35.6965, 139.7695, 37.0)
    points = np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 5]])
    moved = reference.to_world(points, local, world)
    assert 99.9 < np.linalg.norm(moved[1] - moved[0]) < 100.1
    assert np.allclose(reference.to_world(moved, world, local), points, atol=1e-4)


def made(scene: Scene, model: pycolmap.Reconstruction, cloud: Cloud | None = None, **more: object) -> Products:
    images = registration(model, scene, RegisteredTuning())
    return Products(model=model, images=images, cloud=None if cloud is None else points_of(cloud.xyz_m), **more)


@pytest.mark.slow
def test_a_survey_is_evaluated_whole(tmp_path: Path) -> None:
    scene = make_scene()
    make_model(scene).write_text(tmp_path)
    las = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    las.xyz = a_cloud().xyz_m
    las.write(tmp_path / "lidar.laz")
    given = {"reference": tmp_path, "reference_cloud": tmp_path / "lidar.laz"}
    settings = EvaluateSettings(**given, range_m=100, distances_m=(0.02, 0.1))
    products = made(scene, make_model(scene, missing=3), a_cloud(), scratch=tmp_path)
    data = evaluate_survey(scene, products, settings, TUNING).metrics
    values = {m["name"]: m["value"] for m in data["metrics"]}
    assert values["registered_images"] == pytest.approx(100 * 20 / 24) and values["ate_sim3_rmse"] < 1e-6
    assert 0.001 < values["backprojection_rmse"] < 0.1 and values["fscore_0.02m"] > 99
    assert values["images_by_rig"] == pytest.approx(100 / 24)
    assert says(data["notes"], "round")
    bare = evaluate_survey(scene, made(scene, make_model(scene)), EvaluateSettings(), TUNING).metrics
    assert [m["name"] for m in bare["metrics"]] == ["registered_images", "images_by_rig"]


@pytest.mark.slow
def test_absolute_error_in_a_common_crs(tmp_path: Path) -> None:
    """A model in UTM beside a reference in local metres: the absolute error is that of the model, not of the frames."""
    place = (35.6965, 139.7695, 37.0)
    world, local, scene = geodesy.make_origin(*place), Origin(*place), make_scene()
    write_tum(tmp_path / "up.tum", np.arange(FRAMES), rig_poses())
    inside = reference.to_world(rig_poses()[:, :3, 3], local, world)
    poses = transforms.rigid(rig_poses()[:, :3, :3], inside + [0.2, 0, 0])
    found = ModelPoses(poses[scene.frame], poses)
    match, _ = reference.match_poses(reference.read_reference_poses(tmp_path), found, scene, GAP_S)
    match = reference.poses_to_world(match, local, world)
    result = evaluate_trajectory(match, (2.0,), TUNING.trajectory, same_frame=True)
    assert result.absolute.rmse_m == pytest.approx(0.2, abs=1e-3)
    settings = EvaluateSettings(reference=tmp_path / "up.tum", reference_origin=place)
    data = evaluate_survey(scene, made(scene, make_model(scene), origin=world), settings, TUNING).metrics
    assert "absolute_rmse" in [m["name"] for m in data["metrics"]]


@pytest.mark.slow
def test_a_cloud_whose_header_names_no_crs_is_in_that_of_the_run(tmp_path: Path) -> None:
    """Coordinates of the run's own files; beside local metres about an origin, a CRS in the header holds; a geoid."""
    world = geodesy.make_origin(35.6965, 139.7695, 37.0)
    assert world.crs.startswith("EPSG") and any(world.shift_m)
    scene, xyz = make_scene(), a_cloud().xyz_m + np.array(world.shift_m)

    def judged(name: str, xyz: np.ndarray, crs: str | None, **how: object) -> dict:
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.offsets, header.scales = np.floor(xyz.mean(axis=0)), np.full(3, 1e-3)
        if crs is not None:
            header.add_crs(pyproj.CRS(crs))
        las = laspy.LasData(header)
        las.xyz = xyz
        las.write(tmp_path / name)
        settings = EvaluateSettings(reference_cloud=tmp_path / name, range_m=100, distances_m=(0.1,), **how)
        products = made(scene, make_model(scene), a_cloud(), origin=world, scratch=tmp_path)
        return evaluate_survey(scene, products, settings, TUNING).metrics

    for crs, how in ((None, {}), (world.crs, {"reference_origin": (35.0, 139.0, 0.0)})):
        data = judged("reference.las", xyz, crs, **how)
        assert {m["name"]: m["value"] for m in data["metrics"]}["cloud_to_cloud_median"] < 0.002
        assert any("no CRS in its header" in note for note in data["notes"]) == (crs is None)
    with refused("37 m apart: is one above the ellipsoid, the other above a geoid.*shift"):
        judged("geoid.las", xyz - [0, 0, 37], world.crs)


def test_metrics_survive_json() -> None:
    data = metrics_to_dict([Metric("a", float("nan"), "m", "low"), Metric("b", np.float64(2), "m", "low", 1.0)])
    assert data["metrics"][0]["value"] is None and data["metrics"][0]["target"] is None
    back = json.loads(json.dumps(data, allow_nan=False))
    assert back == data and (back["metrics"][1]["value"], back["metrics"][1]["target"]) == (2.0, 1.0)


def test_the_rendered_canal_matches_itself(data_root: Path) -> None:
    folder = data_root / "canal_demo" / "gt"
    if not folder.exists():
        pytest.skip("canal_demo is not there")
    assert len(reference.read_reference_poses(folder / "colmap").by_image) == 120
    time_s, body = reference.read_tum(folder / "rig_up.tum")
    assert len(time_s) == 10 and np.all(np.isfinite(body))
