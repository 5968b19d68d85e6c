"""The database and what COLMAP's mappers make of it; statements and residuals against each other and noise."""

from __future__ import annotations

import errno
import os
import resource
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from features_world import FRAMES, features, filled_database, poses, rig, scene
from said import refused
from tiegraph.geometry import transforms
from tiegraph.scene import colmapdatabase as db
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.evidence import LIMIT, Statement, contradictions, fits_better, mostly_more, table, trend
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor


def opened(path):
    return pycolmap.Database.open(path)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "database.db"


@pytest.fixture
def filled(path):
    return filled_database(path, scene())


def test_ids_names_frames_and_rig_are_those_of_the_scene(path):
    world = scene()
    create_database(path, world)
    with opened(path) as database:
        images = {i.image_id - 1: i for i in database.read_all_images()}
        (row,) = database.read_all_rigs()
        frames = {f.frame_id: {d.id for d in f.data_ids} for f in database.read_all_frames()}
        assert database.num_cameras() == 2
    assert [images[k].name for k in range(len(world))] == list(world.names)
    assert [images[k].camera_id - 1 for k in range(len(world))] == world.sensor_key.tolist()
    assert frames == {f + 1: {2 * f + 1, 2 * f + 2} for f in range(FRAMES)}
    sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 2)
    assert row.rig_id == 1 and row.ref_sensor_id.id == 1
    np.testing.assert_allclose(row.sensor_from_rig(sensor).matrix(), rig().sensors[1].sensor_from_rig[:3], atol=1e-12)


def test_the_guess_of_a_fisheye_lens_counts_as_known(path):
    """COLMAP verifies no pair of a fisheye lens without a prior: 360 cameras had no model at all."""
    world = scene()
    one = world.rigs[0]
    bent = pycolmap.Camera.create_from_model_name(0, "OPENCV_FISHEYE", 200.0, 640, 480)
    plain = pycolmap.Camera.create_from_model_name(0, "RADIAL", 200.0, 640, 480)
    sensors = tuple(replace(s, camera=c) for s, c in zip(one.sensors, (bent, plain), strict=True))
    create_database(path, world.with_(rigs=(replace(one, sensors=sensors),)))
    assert not bent.has_prior_focal_length and not plain.has_prior_focal_length
    with opened(path) as database:
        assert [c.has_prior_focal_length for c in database.read_all_cameras()] == [True, False]


def test_sensors_without_extrinsics_stand_alone(path):
    create_database(path, scene(known=False))
    with opened(path) as database:
        rigs = {r.rig_id: r.num_sensors() for r in database.read_all_rigs()}
        frames = {f.frame_id: [d.id for d in f.data_ids] for f in database.read_all_frames()}
    assert rigs == {1: 1, 3: 1}
    alone = {FRAMES + k + 1: [k + 1] for k in range(1, 2 * FRAMES, 2)}
    assert frames == {**{f + 1: [2 * f + 1] for f in range(FRAMES)}, **alone}


def test_two_rigs_do_not_share_ids(path):
    one = scene()
    other = Rig("other", tuple(Sensor(f"b{k}", s.camera, s.sensor_from_rig) for k, s in enumerate(rig().sensors)))
    create_database(path, one.with_(rigs=(*one.rigs, other), rig=np.arange(FRAMES) % 2))
    with opened(path) as database:
        frames = {f.frame_id: f.rig_id for f in database.read_all_frames()}
        cameras = [i.camera_id for i in database.read_all_images()]
    assert frames == {f + 1: f % 2 + 1 for f in range(FRAMES)}
    assert cameras[:4] == [1, 2, 3, 4]


def test_one_position_prior_a_frame_on_its_reference_image(path):
    world_from_rig = transforms.invert(poses())
    world_from_rig[0, :3, 3] = np.nan
    world_from_rig[:, :3, :3] = np.nan
    world = scene().with_(world_from_rig=world_from_rig, position_sigma_m=np.full((FRAMES, 3), 0.05))
    create_database(path, world)
    with opened(path) as database:
        priors = {p.corr_data_id.id: p for p in database.read_all_pose_priors()}
    assert sorted(priors) == [2 * f + 1 for f in range(1, FRAMES)]
    np.testing.assert_allclose(priors[3].position, world.world_from_rig[1, :3, 3])
    np.testing.assert_allclose(priors[3].position_covariance, np.eye(3) * 0.05**2)
    assert priors[3].coordinate_system == pycolmap.PosePriorCoordinateSystem.CARTESIAN


def test_sensor_without_a_camera_is_an_input_error(path):
    world = scene()
    blind = Rig("pair", (world.rigs[0].sensors[0], Sensor("cam1")))
    with refused("'cam1' has no camera"):
        create_database(path, world.with_(rigs=(blind,)))
    assert list(path.parent.iterdir()) == []


def test_a_new_database_replaces_the_old_one_and_its_log(filled):
    stale = Path(f"{filled}-wal")
    stale.write_bytes(b"stale log of another file")
    create_database(filled, scene())
    assert not db.feature_counts(filled)
    assert not stale.exists() or stale.stat().st_size == 0


def test_features_come_back_as_written_and_colmap_reads_them(path):
    filled_database(path, scene(), empty=(3,))
    batch = features(empty=(3,))
    with opened(path) as database:
        for k, keypoints, descriptors in batch:
            assert np.array_equal(database.read_keypoints(k + 1), keypoints)
            assert np.array_equal(database.read_descriptors(k + 1).data, descriptors)
    assert db.feature_counts(path) == {k: len(keypoints) for k, keypoints, _ in batch}
    assert set(db.feature_counts(path)) == set(range(2 * FRAMES))
    assert db.lost_features(path, scene(), range(2 * FRAMES)) == [
        ("cam1/img_01.jpg", "no features were found (blank, blurred or fully masked image)")
    ]


def test_cleared_matches_leave_the_features(filled):
    with opened(filled) as database:
        for a, b in ((1, 2), (2, 3), (3, 4)):
            database.write_matches(a, b, np.array([[0, 0]], np.uint32))
    db.clear_matches(filled)
    with opened(filled) as database:
        assert database.num_matched_image_pairs() == 0
    assert set(db.feature_counts(filled)) == set(range(2 * FRAMES))


def test_pair_ids_are_colmaps():
    pairs = Pairs.make(np.array([0, 4]), np.array([1, 9]), "file")
    assert db.pair_ids(pairs).tolist() == [pycolmap.image_pair_to_pair_id(1, 2), pycolmap.image_pair_to_pair_id(5, 10)]


def test_a_batch_is_written_whole_or_not_at_all(path):
    create_database(path, scene())
    with pytest.raises(RuntimeError, match="stop"), db.transaction(path) as cursor:
        cursor.execute("INSERT INTO keypoints VALUES (1, 0, 4, NULL)")
        raise RuntimeError("stop")
    with pytest.raises(ValueError, match="descriptors"):
        db.write_features(path, [(0, np.zeros((2, 4)), np.zeros((3, 128), np.uint8))])
    assert not db.feature_counts(path)


@pytest.mark.slow
def test_sigkill_while_writing_keeps_whole_images_only(tmp_path):
    path = tmp_path / "database.db"
    create_database(path, scene())
    script = (
        f"import sys; sys.path[:0] = {[str(p) for p in Path(__file__).parents[:2]]!r}\n"
        "import numpy as np; from pathlib import Path; from tiegraph.scene.colmapdatabase import write_features\n"
        f"path = Path({str(path)!r})\n"
        "for n in range(100000):\n"
        "    k = n % 12\n"
        "    write_features(path, [(k, np.full((3000 + n, 4), k), np.full((3000 + n, 128), k, np.uint8))])\n"
        "    print(n, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as writer:
        while int(writer.stdout.readline()) < 5:
            pass
        writer.send_signal(signal.SIGKILL)
    counts = db.feature_counts(path)
    assert len(counts) >= 6
    connection = sqlite3.connect(path)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    with opened(path) as database:
        for k in counts:
            assert (database.read_descriptors(k + 1).data == k).all()
            assert (database.read_keypoints(k + 1) == k).all()


def test_full_disk_is_an_input_error_and_earlier_batches_stay(tmp_path):
    path = filled_database(tmp_path / "database.db", scene())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (os.path.getsize(path) // 2, limits[1]))
    try:
        with refused(r"database\.db cannot be written: .*ulimit -f"):
            db.write_features(path, [(0, np.zeros((90000, 4)), np.zeros((90000, 128), np.uint8))])
        resource.setrlimit(resource.RLIMIT_FSIZE, (20000, limits[1]))
        with refused(r"ulimit -f.*other\.db"):
            create_database(tmp_path / "other.db", scene())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert db.feature_counts(path)[0] == len(features()[0][1])
    assert [p.name for p in tmp_path.iterdir() if "other" in p.name] == []


def test_missing_or_damaged_database_is_explained(tmp_path):
    with refused("does not exist"):
        db.feature_counts(tmp_path / "none.db")
    (tmp_path / "bad.db").write_bytes(b"this is no database at all" * 200)
    with refused("bad.db cannot be read any more"):
        db.feature_counts(tmp_path / "bad.db")


@pytest.mark.slow
def test_the_bytes_tell_nothing_of_the_order_of_writing(tmp_path):
    found, at_once, one_by_one = features(), tmp_path / "a.db", tmp_path / "b.db"
    filled_database(at_once, scene())
    create_database(one_by_one, scene())
    for each in reversed(found):
        db.write_features(one_by_one, [each])
    assert at_once.read_bytes() != one_by_one.read_bytes()
    for path in (at_once, one_by_one, one_by_one):
        db.write_anew(path)
    assert at_once.read_bytes() == one_by_one.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.db", "b.db"]
    with opened(one_by_one) as database:
        assert database.num_images() == len(found) and database.num_keypoints() == sum(len(k) for _, k, _ in found)


def test_a_database_without_room_for_its_copy_stays(tmp_path, monkeypatch):
    path = filled_database(tmp_path / "a.db", scene())
    db.write_anew(path)
    before = path.read_bytes()

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with refused("No space left"):
        db.write_anew(path)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.db"]


def process(rng: np.random.Generator, count: int, r: float) -> np.ndarray:
    """First-order noise (count,) of sigma 1 and correlation r."""
    out = rng.standard_normal(count)
    for k in range(1, count):
        out[k] = r * out[k - 1] + np.sqrt(1 - r * r) * out[k]
    return out


@pytest.mark.slow
@pytest.mark.parametrize(("count", "r"), [(12, 0.0), (12, 0.6), (30, 0.0), (30, 0.6), (100, 0.8)])
def test_noise_is_no_trend(count: int, r: float) -> None:
    rng = np.random.default_rng(count)
    alarms = sum(trend(process(rng, count, r)) is not None for _ in range(120))
    assert alarms <= 1  # 0.1 % by construction, where the correlation is known


@pytest.mark.slow
@pytest.mark.parametrize("form", ["line", "curve", "step"])
def test_what_is_larger_than_the_noise_is_found_by_its_form(form: str) -> None:
    rng, x = np.random.default_rng(3), np.linspace(-1, 1, 40)
    shape = {"line": x, "curve": 1.5 * (x**2 - 1 / 3), "step": np.sign(x - 0.2)}[form]
    found = [trend(0.7 * shape + 0.05 * process(rng, 40, 0.5)) for _ in range(20)]
    assert sum(f is not None and f.form == form for f in found) >= 18
    assert not any(trend(0.3 * shape + process(rng, 40, 0.5)) for _ in range(20))  # below the noise: nothing
    size = {"line": 1.4, "curve": 1.05, "step": 1.4}[form]
    assert all(f.size == pytest.approx(size, rel=0.2) for f in found if f is not None and f.form == form)


def test_a_step_that_the_fit_has_followed_by_turning_is_found() -> None:
    """Residuals of a line fitted to a step are a saw-tooth: no step, no line, no curve by itself."""
    rng, x = np.random.default_rng(6), np.linspace(-1, 1, 20)
    found = []
    for _ in range(20):
        y = np.where(x > 0, 0.4, 0.0) + 0.02 * rng.standard_normal(20)
        found.append(trend(y - np.polyval(np.polyfit(x, y, 1), x), 3))
    assert all(f is not None and f.form == "step" for f in found)
    assert all(f.size == pytest.approx(0.4, abs=0.1) and 0.4 < f.at < 0.6 for f in found if f is not None)


def test_one_bad_value_is_no_trend_and_the_words_hold_the_figures() -> None:
    rng, x = np.random.default_rng(4), np.linspace(-1, 1, 30)
    bad = 0.02 * rng.standard_normal(30)
    bad[4] = 5.0
    assert trend(bad) is None and trend(np.zeros(30)) is None and trend(x[:5]) is None
    line = trend(0.7 * x + 0.02 * rng.standard_normal(30))
    assert line.text().startswith("run in a line from -0.") and " m to +0." in line.text()
    assert line.start == pytest.approx(-0.7, abs=0.05) and line.end == pytest.approx(0.7, abs=0.05)
    step = trend(np.where(x > 0, 0.5, 0.0) + 0.02 * rng.standard_normal(30))
    assert step.text().startswith("jump by +0.") and step.at == 0.5
    off = trend(0.5 + 0.02 * rng.standard_normal(30), offset=True)
    assert off.text() == "stand off by +0.5 m all the time"
    assert trend(0.5 + 0.02 * rng.standard_normal(30)) is None


@pytest.mark.slow
def test_values_that_are_not_equally_good_count_by_their_sigmas() -> None:
    """A receiver that loses its fix below a bridge: positions of 2 cm before and after, of metres in between, whose
    errors go together. That is no jump; one of 0.3 m between the good ones is."""
    rng, count, alarms, found = np.random.default_rng(8), 50, 0, []
    sigma = np.where((np.arange(count) % 25 >= 10) & (np.arange(count) % 25 < 19), 1.0, 0.02)
    jump = np.where(np.arange(count) >= 25, 0.3, 0.0)
    for _ in range(60):
        noise = sigma * np.where(sigma > 0.1, process(rng, count, 0.9), rng.standard_normal(count))
        alarms += trend(noise, 4, sigma=sigma) is not None
        found.append(trend(noise + jump, 4, sigma=sigma))
    assert alarms <= 1
    steps = [f for f in found if f is not None]
    assert len(steps) >= 54 and all(f.form == "step" and f.size == pytest.approx(0.3, abs=0.05) for f in steps)
    assert all(f.sigmas == pytest.approx(0.3 / 2 / 0.02, rel=0.3) for f in steps)


def test_statements_that_cannot_both_be_right() -> None:
    rig = Statement("scale", "rig as given", 1.115, 0.0016, "")
    gnss = Statement("scale", "GNSS positions", 1.0, 0.01, "", used=True)
    points = Statement("scale", "control points", 1.01, 0.01, "")
    height = Statement("height", "EXIF", 64.0, float("nan"), "m")
    found = contradictions([rig, gnss, points, height])
    pairs = [{c.first.source, c.second.source} for c in found]
    assert pairs == [{"rig as given", "GNSS positions"}, {"rig as given", "control points"}]
    assert found[0].sigmas == pytest.approx(0.115 / np.hypot(0.0016, 0.01)) and found[0].sigmas > LIMIT
    rows = table([rig, gnss, points, height])["rows"]
    assert [r[6] for r in rows] == ["GNSS positions", "rig as given", "rig as given", ""]


@pytest.mark.slow
def test_readings_that_are_no_better_are_called_so_once_in_a_thousand() -> None:
    """Of 4000 surveys in which both readings are as good, and of as many in which one is clearly better."""
    rng, free, pairs = np.random.default_rng(0), 8, 12
    before, after = np.sqrt(np.mean(rng.standard_normal((2, 4000, free)) ** 2, axis=2))
    assert sum(fits_better(b, a, free) for b, a in zip(before, after)) < 12
    assert sum(fits_better(8 * b, a, free) for b, a in zip(before, after)) > 3900
    assert not fits_better(5.0, 0.0, 0) and not fits_better(0.0, 0.0, 8) and fits_better(5.0, 0.0, 8)
    off = rng.standard_normal((4000, pairs))
    assert sum(mostly_more(d, 1) for d in off) < 12 and sum(mostly_more(d, 7) for d in off) < 3
    assert sum(mostly_more(d + 3, 7) for d in off) > 3900
    assert not mostly_more(np.array([5.0]), 1) and not mostly_more(np.zeros(9), 1) and mostly_more(np.ones(9), 1)
