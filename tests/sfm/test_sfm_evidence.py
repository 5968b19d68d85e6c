"""Sources of a placement against each other; marks made in copies of the images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import control_of, elsewhere, level_poses, lone_scene, make_world, with_positions

from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.gravity import Up
from tiegraph.scene.control import Control, Marks
from tiegraph.scene.rig import AS_IS, Copy, Sensor, Source
from tiegraph.scene.scene import Scene
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.fixes import Measured, Measurements
from tiegraph.sfm.world.georef import Georeference, of_fit
from tiegraph.sfm.world.georeferencing import as_marked
from tiegraph.sfm.world.marks import Target, copy_of, without_blunders
from tiegraph.sfm.world.scale import LengthScale
from tiegraph.sfm.world.similarityfit import SimilarityFit, fit_to_world
from tiegraph.sfm.world.statements import with_statements

import pycolmap  # isort: skip

pytestmark = pytest.mark.slow

COUNT = 40
SETTINGS = GeorefSettings(antenna="ignored")
RIG_SIGMA = 0.002
TUNING = WorldTuning()


def drive(length_m: float = 40.0, back: bool = False) -> tuple[np.ndarray, Scene]:
    """world_from_rig (40, 4, 4) of a level camera along a gentle bend (there and back), and its scene."""
    s = np.linspace(0, length_m, COUNT)
    place_m = np.stack([s, 0.004 * s**2, 2 + 0.2 * np.sin(s / 9)], axis=1)
    if back:
        place_m = np.vstack([place_m[::2], place_m[::-2] + [0.5, 3.0, 0.0]])
    poses = level_poses(place_m, np.gradient(place_m, axis=0))
    return poses, lone_scene(COUNT, sequences=("way",), time_s=1.0 * np.arange(COUNT))


def noise(seed: int, sigma: float, r: float = 0.5, count: int = COUNT) -> np.ndarray:
    """(count, 3) of a first-order process."""
    rng = np.random.default_rng(seed)
    out = rng.standard_normal((count, 3))
    for k in range(1, count):
        out[k] = r * out[k - 1] + np.sqrt(1 - r * r) * out[k]
    return sigma * out


def control(poses: np.ndarray, sigma: float = 0.02, count: int = 6, seed: int = 5) -> tuple[Control, np.ndarray]:
    """Points beside the way as surveyed, and their true places."""
    rng = np.random.default_rng(seed)
    true = poses[np.linspace(2, COUNT - 3, count).astype(int), :3, 3] + rng.uniform(-6, 6, (count, 3)) * [0.2, 1, 0.3]
    surveyed = true + sigma * rng.standard_normal((count, 3))
    empty, names = np.zeros(0, int), tuple(f"P{k}" for k in range(count))
    marks, origin = Marks(empty, empty, np.zeros((0, 2)), empty, np.zeros(0)), Origin(35.0, 139.0, 40.0)
    return Control(names, surveyed, np.full((count, 3), sigma), np.zeros(count, bool), marks, origin), true


def found_by(
    poses: np.ndarray, scene: Scene, rig_scale: float | None = None, points: tuple | None = None, ring: bool = True
) -> Georeference:
    """The judged placement of a model that is the truth itself, metres as units; the rig's scale times the truth's."""
    lengths = () if rig_scale is None else (LengthScale(rig_scale, RIG_SIGMA),)
    up = Up(np.array([0.0, 0.0, 1.0]), 3.0, True, True, "the ring of side cameras") if ring else None
    found, given = [], Measurements()
    if points is not None:
        given = Measurements(control=points[0])
        found = [Target(p, 1e-6 * np.eye(3), np.zeros(0, int), np.zeros((0, 2))) for p in points[1]]
        found = without_blunders(found, points[0], TUNING.marks)
    images = transforms.invert(poses)
    placing = fit_to_world(Measured(images, up, scene, SETTINGS, given, TUNING, lengths=lengths, targets=found))
    assert isinstance(placing, SimilarityFit)
    return with_statements(of_fit(placing), found)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("sigma", "actual"), [(0.02, 0.02), (0.5, 0.05), (5.0, 3.0)])
def test_clean_sets_contradict_nothing(seed: int, sigma: float, actual: float) -> None:
    poses, scene = drive(back=bool(seed % 2))
    survey = with_positions(scene, poses[:, :3, 3] + noise(seed, actual, 0.7), sigma)
    found = found_by(poses, survey, rig_scale=1.002, points=control(poses) if seed else None)
    assert found.findings.contradictions == ()
    assert {s.quantity for s in found.findings.statements} >= {"scale", "heading", "height", "place east"}


def test_a_rig_that_is_wrong_does_not_overrule_positions_that_fit_without_it() -> None:
    """Six cameras that fire apart along 12 m: the rig's scale is 11.5 % off, and said to be good to 0.2 %."""
    poses, scene = drive(12.0)
    survey = with_positions(scene, poses[:, :3, 3] + noise(1, 0.02), 0.5)
    found = found_by(poses, survey, rig_scale=1.115)
    assert found.world_from_model.scale == pytest.approx(1, abs=0.01) and found.scale_source == "gnss"
    assert 0.08 < found.uncertainty.sigma["scale"] < 0.14  # covers both: nothing else tells who is right
    assert max(found.residuals.rms_m().values()) < 0.05
    (text,) = found.findings.contradictions
    assert text.startswith("scale: ") and "rig as given 1.113" in text and "without the rig's scale they fit" in text
    assert "fit to 0.02" in text and "fire at different times" in text
    used = {s.source: s.used for s in found.findings.statements if s.quantity == "scale"}
    assert used == {"GNSS positions": True, "rig as given": False}


def test_positions_that_drift_by_themselves_do_not_take_the_scale_from_the_rig() -> None:
    poses, scene = drive()
    off = noise(2, 0.02)
    off[:, 0] += 1.5 * np.linspace(-1, 1, COUNT) ** 2 + 1.5 * np.linspace(-1, 1, COUNT)
    found = found_by(poses, with_positions(scene, poses[:, :3, 3] + off, 0.05), rig_scale=1.0)
    assert abs(found.world_from_model.scale - 1) < 3 * found.uncertainty.sigma["scale"]
    assert found.findings.contradictions


def test_three_sources_tell_which_one_is_wrong() -> None:
    poses, scene = drive(back=True)
    points = control(poses)
    true = poses[:, :3, 3] + noise(3, 0.05)
    stretched = 1.03 * (true - true.mean(axis=0)) + true.mean(axis=0)
    for at, rig_scale, alone in (
        (true, 1.03, "rig as given contradicts the others"), (stretched, 1.001, "GNSS positions contradict the others")
    ):  # fmt: skip
        found = found_by(poses, with_positions(scene, at, 0.05), rig_scale=rig_scale, points=points)
        assert found.world_from_model.scale == pytest.approx(1, abs=0.005) and found.uncertainty.sigma["scale"] < 0.01
        assert any(alone in t for t in found.findings.contradictions)


def test_heights_above_the_start_are_a_contradiction_of_height_and_no_scatter() -> None:
    poses, scene = drive(back=True)
    low = poses[:, :3, 3] + noise(4, 2.0) * [1, 1, 2] - [0, 0, 64]
    points = control(poses)
    found = found_by(poses, with_positions(scene, low, 5.0, prior="exif"), points=points)
    (text,) = [t for t in found.findings.contradictions if t.startswith("height")]
    assert "EXIF positions" in text and "control points" in text and "above the start" in text
    assert abs(found.world_from_model(poses[:, :3, 3]) - poses[:, :3, 3]).max() < 0.2
    assert found.residuals.inlier.mean() > 0.9  # their plan is as good as ever
    assert found.control.accuracy["gcp"]["rmse_m"] < 0.1


def test_one_control_point_tells_a_datum() -> None:
    poses, scene = drive(back=True)
    moved = poses[:, :3, 3] + noise(4, 0.05) + [120.0, -300.0, 0]
    found = found_by(poses, with_positions(scene, moved, 0.1), points=control(poses, count=1))
    assert any(t.startswith("place ") and "datum" in t for t in found.findings.contradictions)


def test_a_refused_point_is_not_in_the_headline_and_points_that_fit_nowhere_are_said() -> None:
    poses, scene = drive(back=True)
    given, true = control(poses, count=7)
    wrong = given.world_m.copy()
    wrong[3] += [20.0, -19.0, 3.0]
    found = found_by(poses, scene, points=(replace(given, world_m=wrong), true))
    assert found.control.accuracy["gcp"]["points"] == 6 and found.control.accuracy["gcp"]["rmse_m"] < 0.06
    assert found.counts()["points_refused"] == 1 and found.control.rows[3]["blunder"]
    (text,) = found.findings.contradictions
    assert "'P3' is not used" in text and "differ by 27.7" in text
    nowhere = given.world_m + np.random.default_rng(1).standard_normal((7, 3))
    found = found_by(poses, scene, points=(replace(given, world_m=nowhere), true))
    assert any("contradict each other" in t for t in found.findings.contradictions)


@pytest.mark.parametrize("size", [0.5, 10.0])
def test_a_step_in_good_positions_is_said_and_widens_the_sigma(size: float) -> None:
    poses, scene = drive(back=True)
    off = noise(6, 0.03)
    off[22:, 1] += size
    found = found_by(poses, with_positions(scene, poses[:, :3, 3] + off, 0.03), rig_scale=1.0)
    said = ("which is not noise", "times as much", "contradict")
    assert any(words in t for t in found.findings.contradictions for words in said)
    error = found.world_from_model(poses[:, :3, 3]) - poses[:, :3, 3]
    assert np.linalg.norm(error.mean(axis=0)[:2]) < 3 * found.uncertainty.sigma["position_m"]


def test_positions_that_lag_are_off_all_along() -> None:
    poses, scene = drive(back=True)
    late = np.roll(poses[:, :3, 3], 1, axis=0)
    late[0] = poses[0, :3, 3]
    found = found_by(poses, with_positions(scene, late + noise(7, 0.03), 0.03), rig_scale=1.0)
    assert found.findings.contradictions


def test_check_points_beyond_what_was_predicted_are_said() -> None:
    poses, scene = drive(back=True)
    given, true = control(poses, count=8)
    check = np.arange(8) >= 5
    fine = found_by(poses, scene, points=(replace(given, check=check), true))
    assert fine.findings.contradictions == () and fine.control.accuracy["check"]["points"] == 3
    moved = given.world_m + np.where(check[:, None], [0.4, -0.3, 0.2], 0.0)
    found = found_by(poses, scene, points=(replace(given, check=check, world_m=moved), true))
    (text,) = found.findings.contradictions
    assert "3 check points" in text and "predicted 0.0" in text


WORLD = Tuning().world


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=2, frames=24)


@pytest.fixture(scope="module")
def true(world):
    """The control points with their marks in the images."""
    return control_of(*world)


def _marked(control: Control, pixels: np.ndarray, orientation: int = 1) -> Control:
    """The control points with marks as a file has them, in images that EXIF turns."""
    turned = np.full(len(pixels), orientation)
    marks = replace(control.marks, xy_px=pixels, file_px=pixels, orientation=turned)
    return replace(control, marks=marks)


def _recognised(world, control: Control) -> Control:
    found, said = as_marked(elsewhere(world.truth), world.scene, Measurements(control=control), WORLD)
    assert found.control is not None and not said
    return found.control


@pytest.mark.parametrize("size", [0.5208, 2.0])
def test_marks_in_smaller_and_larger_copies_are_found_and_used(world, true, size: float) -> None:
    found = _recognised(world, _marked(true, size * true.marks.xy_px))
    off = np.linalg.norm(found.marks.xy_px - true.marks.xy_px, axis=1)
    assert len(off) == len(true.marks) and 0.01 < off.max() < 3
    assert any(f"{size:.2g}" in n and "scaled to these" in n for n in found.notes)
    widest = np.max(found.marks.sigma_px)
    assert widest == pytest.approx(1 / size, rel=0.01) if size < 1 else np.isnan(found.marks.sigma_px).all()
    placed = world.placed_by(world.scene, Measurements(control=found))
    assert placed.placed and placed.control.accuracy["gcp"]["points"] == 4
    assert 0.0001 < placed.control.accuracy["check"]["rmse_m"] < 0.1


@pytest.mark.parametrize(("orientation", "size"), [(3, 1.0), (6, 0.5), (8, 1.0)])
def test_marks_in_images_as_stored_are_turned_as_exif_says(world, true, orientation: int, size: float) -> None:
    camera = world.truth.camera(1)
    x, y = true.marks.xy_px.T
    stored = {3: (camera.width - x, camera.height - y), 6: (y, camera.width - x), 8: (camera.height - y, x)}
    found = _recognised(world, _marked(true, size * np.stack(stored[orientation], axis=1), orientation))
    assert np.linalg.norm(found.marks.xy_px - true.marks.xy_px, axis=1).max() < 2
    assert any("another EXIF orientation" in n for n in found.notes)


def test_marks_of_the_images_themselves_stay_untouched(world, true) -> None:
    off = np.random.default_rng(3).standard_normal(true.marks.xy_px.shape)
    for noise_px, orientation in ((0.0, 1), (1.0, 1), (6.0, 8)):
        given = _marked(true, true.marks.xy_px + noise_px * off, orientation)
        found = _recognised(world, given)
        np.testing.assert_array_equal(found.marks.xy_px, given.marks.xy_px)
        assert found.notes == given.notes and np.isnan(found.marks.sigma_px).all()


def _few(true: Control) -> Control:
    """The control points with their first and last mark only."""
    twice = np.concatenate([np.flatnonzero(true.marks.point == p)[[0, -1]] for p in range(len(true))])
    return replace(true, marks=true.marks.where(twice))


def test_random_marks_are_refused_and_that_is_a_contradiction(world, true) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        for control in (true, _few(true)):
            given = _marked(control, rng.uniform(0, (1024, 768), control.marks.xy_px.shape), 8)
            found, said = as_marked(elsewhere(world.truth), world.scene, Measurements(control=given), WORLD)
            assert found.control is None and "randomly placed marks would fit as well" in said[0]


def test_few_marks_that_are_right_are_used_and_random_ones_beside_them_are_not(world, true) -> None:
    few, rng = _few(true), np.random.default_rng(1)
    given = _marked(few, few.marks.xy_px + 2 * rng.standard_normal(few.marks.xy_px.shape))
    used = Measurements(control=_recognised(world, given))
    assert world.placed_by(world.scene, used).placed
    wrong = np.isin(true.marks.point, (0, 1, 2))[:, None]
    for seed in range(2):
        random = np.random.default_rng(seed).uniform(0, (1024, 768), true.marks.xy_px.shape)
        mixed = Measurements(control=_recognised(world, _marked(true, np.where(wrong, random, true.marks.xy_px))))
        placed = world.placed_by(world.scene, mixed)
        assert not placed.placed and any("and 1 control points can be used" in n for n in placed.findings.notes)


def test_marks_outside_are_left_out_where_no_copy_explains_them(world, true) -> None:
    pixels = true.marks.xy_px.copy()
    pixels[3] = (1500, 1200)
    found = _recognised(world, _marked(true, pixels))
    assert len(found.marks) == len(true.marks) - 1
    assert any("1 marks are outside their images and are left out" in n for n in found.notes)


@pytest.mark.parametrize("parallel", [True, False])
def test_parallel_views_cannot_tell_and_it_is_said(parallel: bool) -> None:
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=1000, height=800, params=[900, 500, 400], camera_id=1)
    model, names = pycolmap.Reconstruction(), [f"{k:03d}.jpg" for k in range(6)]
    model.add_camera_with_trivial_rig(camera)
    for k, name in enumerate(names):
        turn = Rotation.from_euler("z", 0 if parallel else 25 * k, degrees=True)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn.as_quat()), turn.apply([-0.4 * k, 0.2 * k, 0]))
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=1, image_id=k + 1), pose)
    places = np.array([[0.5, 0.2, 9], [1.0, -1.0, 9.5], [1.4, 0.3, 10], [0.2, -0.6, 10]])
    rows = [(p, k, model.image(k + 1).project_point(x)) for p, x in enumerate(places) for k in range(6)]
    half = 0.5 * np.array([xy for _, _, xy in rows])
    point, image = np.array([row[:2] for row in rows]).T
    line, sigma = np.arange(len(rows)) + 2, np.full(len(rows), np.nan)
    marks = Marks(point, image, half, line, sigma, file_px=half, orientation=np.ones(len(rows), int))
    scene = lone_scene(6, Sensor("cam", camera))
    copy, note = copy_of(model, scene, marks, WORLD.marks)
    if parallel:
        assert copy == AS_IS and "do not show" in note
    else:
        assert copy.size == pytest.approx(0.5, abs=0.002) and not copy.turned


def test_a_copy_s_pixel_is_that_of_the_stored_or_of_the_upright_image() -> None:
    upright = Sensor("c", pycolmap.Camera(model="SIMPLE_PINHOLE", width=30, height=40, params=[50, 15, 20]))
    stored = pycolmap.Camera(model="SIMPLE_PINHOLE", width=40, height=30, params=[50, 20, 15])
    kept = Sensor("c", stored, source=Source(camera=stored, upright=False))
    for orientation in (5, 6, 7, 8):
        there = Copy(0.5, turned=True).pixel((2.0, 3.0), upright, orientation)
        back = Copy(1.0, turned=True).pixel(there, kept, orientation)
        assert back == (4.0, 6.0) and there != back
    assert Copy(1.0, turned=True).pixel((4.0, 6.0), upright, 8) == (6.0, 36.0)
    assert AS_IS.pixel((4.0, 6.0), upright, 8) == (4.0, 6.0)
