"""The runner: time limits, bad ends, the results file; errors of the odometry over its sigmas."""

import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.competitors import colmap as competitor
from scipy.spatial.transform import Rotation

from benchmarks import datasets, run
from tiegraph.geometry import transforms
from tiegraph.papers.measured import Stages
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.rig import Rig, Sensor

import pycolmap  # isort: skip
from benchmarks.odometrychecks import agreement, by_length, errors_over_sigmas

from odometry.odometry_world import FRAMES, drive, single, true_path, truth
from tiegraph.odometry.odometry import OdometryPath


@pytest.mark.slow
def test_time_limit_ends_the_process_and_its_children(tmp_path: Path) -> None:
    marker = tmp_path / "alive"
    child = f"import time, pathlib; time.sleep(2); pathlib.Path({str(marker)!r}).touch()"
    parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    start = time.monotonic()
    row = run.measured([sys.executable, "-c", parent], tmp_path / "log.txt", 0.7)
    assert row["returncode"] is None and 0.6 < time.monotonic() - start < 1.9
    time.sleep(2.2)
    assert not marker.exists()


@pytest.mark.parametrize(
    ("returncode", "said", "status", "reason"),
    [
        (None, {"running": "match"}, "timeout", "match"),
        (-6, {"running": "sparse"}, "failed", "-6 in stage sparse"),
        (0, {"status": "failed", "reason": "no model"}, "failed", "no model"),
        (0, {}, "failed", ""),
        (0, {"status": "done"}, "done", ""),
    ],
)
def test_outcome_names_the_stage_that_ended_a_run(returncode: int, said: dict, status: str, reason: str) -> None:
    outcome = run._outcome(returncode, said)
    assert outcome["status"] == status and reason in outcome.get("reason", "")


def test_a_run_replaces_its_own_row_and_figures_of_two_machines_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    results = run.load_results(path, "note")
    key = {"set": "s", "competitor": "c", "repeat": 0, "calibration": "estimated"}
    for cpu_s in (1.23456789, 2.0):
        run.add_row(results, {**key, "cpu_s": cpu_s}, path)
    run.add_row(results, {**key, "repeat": 1, "cpu_s": 3.0}, path)
    again = run.load_results(path, "")
    assert [row["cpu_s"] for row in again["runs"]] == [2.0, 3.0] and again["note"] == "note"
    path.write_text(json.dumps({**again, "machine": {"cpu": "another"}}))
    with pytest.raises(SystemExit, match="another machine"):
        run.load_results(path, "")


def test_another_seed_maps_the_matches_of_the_first_and_counts_their_time(tmp_path: Path, monkeypatch) -> None:
    first = Stages(tmp_path / "first.json")
    for stage in ("features", "match", "sparse"):
        first.run(stage, lambda: None)
    again = Stages(tmp_path / "again.json")
    again.go_on(tmp_path / "first.json")
    assert [row["stage"] for row in again.data["stages"]] == ["features", "match"]
    stages = [{"stage": "match", "cpu_s": 40.0, "wall_s": 20.0}, {"stage": "sparse", "cpu_s": 9.0, "wall_s": 9.0}]
    bases = []

    def process(command: list[str], *_: object) -> dict:
        bases.append(command[command.index("--base") + 1] if "--base" in command else None)
        place = Path(command[command.index("--json") + 1])
        place.write_text(json.dumps({"status": "done", "stages": stages, "models": []}))
        return {"returncode": 0, "wall_s": 32.0, "cpu_s": 51.0}

    monkeypatch.setattr(run, "measured", process)
    asked = SimpleNamespace(seeds=(0, 3), keep=None, calibrated=False, until="georef", timeout=1.0)
    dataset = datasets.Dataset("tiny", tmp_path, {})
    row = run.run_one(dataset, "colmap_exhaustive", 0, tmp_path, asked)
    stages[1]["cpu_s"] = 12.0
    other = run.run_one(dataset, "colmap_exhaustive", 3, tmp_path, asked, row)
    assert bases == [None, str(tmp_path / "tiny-colmap_exhaustive-0" / "out")]
    assert (row["cpu_s"], other["cpu_s"], other["wall_s"], other["repeat"]) == (51.0, 54.0, 32.0, 3)


def test_unknown_competitor_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run.main(["--sets", "canal_demo", "--competitors", "colmpa", "-o", "x.json"])
    assert "colmap_exhaustive" in capsys.readouterr().err


def test_results_hold_no_paths_of_the_machine(tmp_path: Path) -> None:
    said = [{"stage": "scan", "notes": [f"camera from {tmp_path}/inputs/rig.toml"], "cpu_s": 1.5}]
    cleaned = run._without_paths(said, tmp_path)
    assert cleaned == [{"stage": "scan", "notes": ["camera from inputs/rig.toml"], "cpu_s": 1.5}]


def test_colmap_is_given_the_rig_of_the_set_as_one_rig_over_all_passes(tmp_path: Path) -> None:
    places = [
        np.eye(4),
        transforms.rigid(Rotation.from_euler("y", 90, degrees=True).as_matrix(), np.array([0.1, 0, 0])),
    ]
    for nominal in (True, False):
        sensors = tuple(Sensor(f"cam{k}", None, place, folder=f"cam{k}") for k, place in enumerate(places))
        write_rig_toml(Rig("head", sensors, nominal=nominal), tmp_path / "rig.toml")
        options = run._colmap_rig(tmp_path / "rig.toml", tmp_path / "rig_config.json")
        assert ("--hold-rig" in options) == (not nominal)
    (config,) = pycolmap.read_rig_config(tmp_path / "rig_config.json")
    assert [c.image_prefix for c in config.cameras] == ["cam0/", "cam1/"] and config.cameras[0].ref_sensor
    found = config.cameras[1].cam_from_rig
    np.testing.assert_allclose(found.matrix(), places[1][:3], atol=1e-12)
    for name in ("up/cam0/0.jpg", "up/cam1/0.jpg", "down/cam0/0.jpg", "gt/0.jpg"):
        (tmp_path / "images" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "images" / name).touch()
    laid, names = competitor._folders_of_sensors(tmp_path / "images", tmp_path / "rig_config.json", tmp_path / "laid")
    assert names == {
        "cam0/up_0.jpg": "up/cam0/0.jpg",
        "cam1/up_0.jpg": "up/cam1/0.jpg",
        "cam0/down_0.jpg": "down/cam0/0.jpg",
    }
    assert sorted(p.relative_to(laid).as_posix() for p in laid.rglob("*.jpg")) == sorted(names)


def test_a_lone_camera_is_no_rig_for_colmap(tmp_path: Path) -> None:
    write_rig_toml(Rig("photographs", (Sensor("camera", None),)), tmp_path / "rig.toml")
    assert run._colmap_rig(tmp_path / "rig.toml", tmp_path / "rig_config.json") == []


COUNT, PLACE_M, TURN = 400, 0.03, 0.002


def noisy(metric, scale=1.0, seed=0):
    """A path with errors of known sigmas about a line, and the line; ``scale``: of the path's unit."""
    rng = np.random.default_rng(seed)
    true = transforms.rigid(np.tile(np.eye(3), (COUNT, 1, 1)), np.outer(np.arange(COUNT), [0.0, 0, 0.5]))
    poses = true.copy()
    poses[1:, :3, 3] += rng.normal(0, PLACE_M, (COUNT - 1, 3))
    poses[1:, :3, :3] = Rotation.from_rotvec(rng.normal(0, TURN, (COUNT - 1, 3))).as_matrix()
    poses[:, :3, 3] *= scale
    sigma = np.diag([(PLACE_M * scale) ** 2] * 3 + [TURN**2] * 3)
    covariance = np.tile(sigma, (COUNT, 1, 1))
    covariance[0] = 0
    segment, key = np.zeros(COUNT, int), np.ones(COUNT, bool)
    return OdometryPath(poses, segment, key, covariance, metric, 0), true


@pytest.mark.slow
@pytest.mark.parametrize(("metric", "scale"), [(True, 1.0), (False, 3.0)])
def test_true_sigmas_give_one_and_sigmas_too_wide_by_three_a_third(metric, scale):
    path, true = noisy(metric, scale)
    for factor in (1.0, 3.0):
        wide = OdometryPath(
            path.world_from_rig, path.segment, path.keyframe, factor**2 * path.covariance, metric, loops=0
        )
        for part in by_length(np.array(errors_over_sigmas(wide, true))):
            assert 0.88 < factor * part["position"] < 1.12 and 0.88 < factor * part["turn"] < 1.12
            assert part["poses"] == pytest.approx((COUNT - 1) / 3, abs=1)


def test_a_path_in_another_unit_and_world_agrees_and_one_that_bends_does_not():
    path, true = noisy(metric=True)
    moved = transforms.rigid(Rotation.from_euler("xyz", [0.3, 0.2, 1.0]).as_matrix(), [5.0, 0, 1]) @ path.world_from_rig
    moved[:, :3, 3] *= 2.0
    same = agreement(path, moved, np.arange(COUNT))
    assert same["scale"] == 0.5 and same["rms_percent_of_way"] < 1e-3 and same["turn_median_deg"] < 1e-3
    bent = path.world_from_rig.copy()
    bent[:, 0, 3] += np.linspace(-1, 1, COUNT) ** 2 * 10  # metres, of 200
    bent[: COUNT // 2] = np.nan
    part = agreement(path, bent, np.arange(COUNT))
    assert part["frames"] == COUNT // 2 and 0.2 < part["rms_percent_of_way"] < 2


@pytest.mark.slow
def test_the_sigmas_of_a_drive_are_neither_too_small_nor_too_wide():
    """Of one camera, in drives begun at two places and backwards: medians of some sixty relative poses, few of them
    independent. Of two cameras: test_odometry_path."""
    rows = []
    for frames in (list(range(FRAMES)), list(range(6, FRAMES)), list(range(FRAMES))[::-1]):
        path = drive(single(), frames)
        assert (path.segment == 0).all()
        rows += errors_over_sigmas(path, true_path(frames) if frames[0] == 0 else np.stack([truth(f) for f in frames]))
    assert len(rows) > 50
    place, turn = np.median(np.array(rows)[:, 1:], axis=0)
    assert 0.4 < place < 2.5 and 0.5 < turn < 2
