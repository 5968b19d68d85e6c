"""Marks made in smaller, larger or turned copies of the images are recognised by their rays; others stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import control_of, elsewhere, lone_scene, make_world

from tiegraph.scene.control import Control, Marks
from tiegraph.scene.rig import AS_IS, Copy, Sensor, Source
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.fixes import Measurements
from tiegraph.sfm.world.georeferencing import as_marked
from tiegraph.sfm.world.marks import copy_of

import pycolmap  # isort: skip

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


@pytest.mark.parametrize("size", [0.5, 1 / 3, 0.5208, 2.0])
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


@pytest.mark.parametrize("orientation", [3, 6, 8])
@pytest.mark.parametrize("size", [1.0, 0.5])
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
    for seed in range(4):
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
    for seed in range(4):
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
