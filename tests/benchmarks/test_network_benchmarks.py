"""The benchmarks of the network: true overlap, verified pairs, figures of a list, the simulated canal."""

from __future__ import annotations

import sqlite3
import sys
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from benchmarks.datasets import Dataset
from benchmarks.measure import measured
from benchmarks.network import find, lists, overlap
from benchmarks.network.canalworld import canal_world

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

CAMERA = pycolmap.Camera(model="PINHOLE", width=200, height=150, params=[100, 100, 100, 75])


def _wall(depth: float, rng: np.random.Generator, left: float = -8, right: float = 8) -> np.ndarray:
    """Points of a wall across the view at a depth."""
    flat = rng.uniform((left, -6), (right, 6), (20_000, 2))
    return np.concatenate([flat, np.full((len(flat), 1), depth)], axis=1)


def _shifted(x: float, turned_deg: float = 0) -> np.ndarray:
    angle = np.radians(turned_deg)
    turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    return transforms.rigid(turn, -turn @ np.array([x, 0.0, 0.0]))


def test_overlap_of_two_views_of_a_wall_is_that_of_their_footprints() -> None:
    # At 4 m the view is 8 m wide: moved by 2 m, three quarters of it are shared; turned away, nothing.
    poses = np.stack([_shifted(0), _shifted(2), _shifted(0, 180)])
    found = overlap.surface_overlap(poses, [CAMERA] * 3, _wall(4, np.random.default_rng(0)), 80, 0.05)
    assert found[0, 1] == pytest.approx(0.75, abs=0.03)
    assert found[0, 2] == 0 and found[0, 0] == 0
    assert np.array_equal(found, found.T)


def test_overlap_counts_nothing_behind_a_nearer_wall() -> None:
    rng = np.random.default_rng(1)
    front = _wall(2, rng, -8, 0)  # hides the left half of the first view
    points = np.concatenate([front, _wall(6, rng)])
    hidden = overlap.surface_overlap(np.stack([_shifted(-4), _shifted(4)]), [CAMERA] * 2, points, 60, 0.05)
    open_ = overlap.surface_overlap(np.stack([_shifted(-4), _shifted(4)]), [CAMERA] * 2, _wall(6, rng), 60, 0.05)
    assert open_[0, 1] > 0.25
    assert hidden[0, 1] < 0.5 * open_[0, 1]


def _database(path: Path, rows: dict[tuple[int, int], int]) -> Path:
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE images (image_id INTEGER, name TEXT)")
        database.execute("CREATE TABLE two_view_geometries (pair_id INTEGER, rows INTEGER, cols INTEGER, data BLOB)")
        database.executemany("INSERT INTO images VALUES (?, ?)", [(k + 1, f"{k}.jpg") for k in range(4)])
        keys = [(2147483647 * a + b, n, 2, None) for (a, b), n in rows.items()]
        database.executemany("INSERT INTO two_view_geometries VALUES (?, ?, ?, ?)", keys)
    return path


def test_verified_pairs_are_those_with_enough_inliers(tmp_path: Path) -> None:
    path = _database(tmp_path / "database.db", {(1, 2): 15, (2, 4): 14, (1, 4): 200})
    found = overlap.verified_pairs(path, ["3.jpg", "0.jpg", "1.jpg"])
    assert found.tolist() == [[False, True, False], [True, False, True], [False, True, False]]
    with pytest.raises(InputError, match=r"1 images are not in it, for instance nine\.jpg"):
        overlap.verified_pairs(path, ["nine.jpg"])
    with pytest.raises(InputError, match="no database"):
        overlap.verified_pairs(tmp_path / "none.db", ["0.jpg"])


def test_intersected_points_are_where_the_surface_is(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    points = _wall(5, rng, -2, 2)[:300]
    poses = {"0.jpg": _shifted(0), "1.jpg": _shifted(1)}
    xy = [(points @ p[:3, :3].T + p[:3, 3]) for p in poses.values()]
    xy = [(100 * x[:, :2] / x[:, 2:] + (100, 75)).astype(np.float32) for x in xy]
    path = _database(tmp_path / "database.db", {})
    matches = np.repeat(np.arange(300, dtype=np.uint32)[:, None], 2, axis=1)
    matches[:20, 1] = rng.permutation(300)[:20]  # wrong ones
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE keypoints (image_id INTEGER, rows INTEGER, cols INTEGER, data BLOB)")
        database.executemany(
            "INSERT INTO keypoints VALUES (?, 300, 2, ?)", [(k + 1, x.tobytes()) for k, x in enumerate(xy)]
        )
        database.execute("INSERT INTO two_view_geometries VALUES (?, 300, 2, ?)", (2147483647 + 2, matches.tobytes()))
    found = overlap.intersected_points(path, {n: (p, CAMERA) for n, p in poses.items()})
    assert 270 <= len(found) <= 290
    assert np.median(np.abs(found[:, 2] - 5)) < 0.01


def test_a_set_without_poses_or_surface_is_refused(tmp_path: Path) -> None:
    dataset = Dataset("mine", tmp_path / "images", {"a.jpg": np.full((4, 4), np.nan)})
    with pytest.raises(InputError, match="'mine': the overlap cannot be known"):
        overlap.true_overlap(dataset, ["a.jpg"], None)
    posed = Dataset("mine", tmp_path / "images", {"a.jpg": np.eye(4)}, cameras={"": CAMERA})
    with pytest.raises(InputError, match="give the database of exhaustive matching"):
        overlap.true_overlap(posed, ["a.jpg"], None)


def test_figures_of_a_list() -> None:
    share = np.zeros((4, 4), np.float32)
    for i, j, value in ((0, 1, 0.5), (0, 2, 0.2), (1, 2, 0.3), (2, 3, 0.1)):
        share[i, j] = share[j, i] = value
    verified = share > 0.25
    chosen = np.zeros((4, 4), bool)
    for i, j in ((0, 1), (0, 2), (2, 3), (1, 3)):
        chosen[i, j] = chosen[j, i] = True
    truth = find.Truth(("a", "b", "c", "d"), share, verified, np.array([0, 0, 1, 1]))
    found = find.judged(chosen, truth)
    assert found["pairs"] == 4 and found["of_pairs"] == 6
    assert found["useful"] == 2 and found["useful_cross"] == 1
    assert found["recall"] == 0.5 and found["recall_cross"] == 0
    assert found["recall_overlap"] == pytest.approx(2 / 3)
    assert found["precision"] == 0.5 and found["false"] == 0.25
    row = {"set": "s", "method": "tiegraph", "status": "done", "images": 4, "cpu_s": 1.0, **found}
    text = find.markdown({"machine": {"cores": 2}, "runs": [row]})
    assert "| tiegraph | 4 | 50.0 % | 0.0 % |" in text and "2 useful, 1 out and back" in text


def _scene(frames: int) -> Scene:
    rig = Rig("pair", tuple(Sensor(f"cam{k}", CAMERA, _shifted(0.2 * k)) for k in range(2)))
    frame, sensor = np.repeat(np.arange(frames), 2), np.tile([0, 1], frames)
    names = [f"cam{s}/{f:03d}.jpg" for f, s in zip(frame, sensor)]
    order = np.argsort(names)
    position = np.tile(np.eye(4), (frames, 1, 1))
    position[:, :3, 3] = 30.0 * np.arange(frames)[:, None] * [1, 0, 0]
    sigma = np.ones((frames, 3))
    return simple_scene(
        rig, sorted(names), frame[order], sensor[order], np.zeros(frames), np.arange(frames), sequences=("pass",),
        world_from_rig=position, position_sigma_m=sigma, prior="gnss",
    )  # fmt: skip


def test_colmap_lists() -> None:
    scene, nowhere = _scene(5), Path()
    own = lists.sequential(scene, nowhere)
    assert {a.partition("/")[0] == b.partition("/")[0] for a, b in own} == {True}
    rig = lists.sequential_rig(scene, nowhere)
    assert any(a.partition("/")[0] != b.partition("/")[0] for a, b in rig)
    assert len(lists.exhaustive(scene, nowhere)) == 45
    near = lists.spatial(scene, nowhere)  # 100 m reach three frames of 30 m
    steps = {abs(int(a[5:8]) - int(b[5:8])) for a, b in near}
    assert 3 in steps and 4 not in steps


@pytest.mark.slow
def test_cost_counts_children(tmp_path: Path) -> None:
    spin = "import time\nwhile time.process_time() < 1.0: pass"  # memory is looked at twice a second
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {spin!r}])"
    found = measured([sys.executable, "-c", code], tmp_path / "log.txt")
    assert found["returncode"] == 0 and 1.0 <= found["cpu_s"] < 4 and found["peak_mib"] > 1


@pytest.mark.slow
def test_simulated_canal_has_true_and_false_ties() -> None:
    world = canal_world(60, seed=3)
    share = world.overlap()
    assert len(world) == 60 and world.scene.sequences == ("down", "up")
    i, j = np.triu_indices(len(world), 1)
    count = np.array([m.inliers for m in world.match(np.stack([i, j], axis=1))])
    strong, none = share[i, j] > 0.5, share[i, j] == 0
    assert 0.5 < np.mean(count[strong] >= 12) <= 1
    assert 0.02 < np.mean(count[none] >= 12) < 0.6  # repeated walls
    best = int(np.argmax(np.where(strong, count, 0)))
    match = world.match(np.array([[i[best], j[best]]]))[0]
    a, b = world.images[i[best]], world.images[j[best]]
    same = a.point[match.matches[:, 0]] == b.point[match.matches[:, 1]]
    assert same.mean() > 0.8 and len(match.matches) == match.inliers
    turn = world.cam_from_world[j[best], :3, :3] @ world.cam_from_world[i[best], :3, :3].T
    assert match.rotation is not None and np.allclose(match.rotation, turn)
