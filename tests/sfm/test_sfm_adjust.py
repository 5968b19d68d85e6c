"""The final adjustment: with which points, what it finds of lenses, and the same bits each time."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, seen_anew

from near import assert_reconstruction_near
from tiegraph.geometry import transforms
from tiegraph.scene import colmapmodel
from tiegraph.scene.colmapmodel import image_poses, matrix, read_model
from tiegraph.sfm.adjustment import lens
from tiegraph.sfm.adjustment.adjust import (
    drop_momentary,
    final_adjustment,
    points_that_can_wait,
    take_poses,
    take_possible,
    thinned,
    without_outliers,
)
from tiegraph.sfm.tuning import AdjustTuning, FewPointsTuning, Tuning

pytestmark = pytest.mark.slow
TUNING = AdjustTuning()
FEW = FewPointsTuning(cells=2, in_a_cell=5)


def _momentary(model: pycolmap.Reconstruction) -> list[int]:
    frame = {i: model.image(i).frame_id for i in model.reg_image_ids()}
    return sorted(k for k, p in model.points3D.items() if len({frame[e.image_id] for e in p.track.elements}) == 1)


def _cut_to_one_shot(model: pycolmap.Reconstruction, keys: list[int]) -> None:
    """Leave of these points what the two first cameras of one shot see."""
    for key in keys:
        seen = [(e.image_id, e.point2D_idx) for e in model.point3D(key).track.elements]
        shots = [model.image(image).frame_id for image, _ in seen]
        kept = max(set(shots), key=shots.count)
        for (image, feature), shot in zip(seen, shots) if shots.count(kept) > 1 else ():
            if shot != kept:
                model.delete_observation(image, feature)


def test_what_one_shot_alone_saw_goes_unless_a_frame_has_little_else(tmp_path: Path) -> None:
    model, _ = make_world(tmp_path / "database.db", points=200)
    before = set(model.point3D_ids())
    _cut_to_one_shot(model, sorted(before)[::20])
    momentary = _momentary(model)
    assert len(momentary) > 3 and drop_momentary(model, TUNING.enough_seen) == len(momentary)
    assert set(model.point3D_ids()) == before - set(momentary)
    assert drop_momentary(model, TUNING.enough_seen) == 0
    model, _ = make_world(tmp_path / "database.db", frames=1, points=TUNING.enough_seen * 2)
    before = sorted(model.point3D_ids())
    assert _momentary(model) == before and drop_momentary(model, TUNING.enough_seen) == 0
    assert np.array_equal(sorted(model.point3D_ids()), before)


def _in_a_lens(model: pycolmap.Reconstruction) -> int:
    """Move a point to where it stands right before a camera that sees it, and before others too; returns its id."""
    for key in sorted(model.point3D_ids()):
        point = model.point3D(key)
        seen = [model.image(e.image_id) for e in point.track.elements]
        for image in seen:
            moved = image.projection_center() + 1e-4 * (point.xyz - image.projection_center())
            if sum((i.cam_from_world() * moved)[2] > 0 for i in seen) > 2:
                point.xyz = moved
                return key
    raise AssertionError("no point moves before a camera")


def test_a_point_in_a_lens_goes(tmp_path: Path) -> None:
    """What stands still in the images of a camera at rest has no error there."""
    model, _ = make_world(tmp_path / "database.db", points=200)
    before, loose = set(model.point3D_ids()), TUNING.model_copy(update={"filter_px": 1e9})
    without_outliers(model, loose)
    assert set(model.point3D_ids()) == before
    inside = _in_a_lens(model)
    without_outliers(model, loose)
    assert set(model.point3D_ids()) == before - {inside}


@pytest.mark.parametrize(("focal_px", "kept"), [(158120.0, [3]), (-1.0, [3]), (None, [])])
def test_a_lens_that_ran_off_and_that_nothing_determines_is_as_given(focal_px: float | None, kept: list[int]) -> None:
    model, scene = moving_world(frames=14)
    given = {k: pycolmap.Camera(model.camera(k).todict()) for k in (1, 2, 3)}
    images = [k for k in model.reg_image_ids() if model.image(k).camera_id == 3]
    for k in images:
        for row in model.image(k).get_observation_point2D_idxs()[TUNING.min_points - 1 :]:
            model.delete_observation(k, row)
    if focal_px is not None:
        model.camera(3).focal_length = model.camera(2).focal_length = focal_px  # the second has points enough
    assert take_possible(model, given, TUNING) == kept
    assert model.camera(3).params.tolist() == given[3].params.tolist()
    assert all((model.image(k).num_points3D == 0) == bool(kept) for k in images)
    assert all(p.track.length() >= 2 for p in model.points3D.values())


def test_a_large_adjustment_gives_the_same_bits_each_time(tmp_path: Path) -> None:
    # COLMAP solves those with fewer than 50 000 residuals on one thread anyway.
    model, scene = make_world(tmp_path / "database.db", cameras=2, frames=9, points=1500)
    assert 2 * model.compute_num_observations() > 50_000
    made = [final_adjustment(pycolmap.Reconstruction(model), tuning=TUNING).model for _ in range(2)]
    assert np.array_equal(*(image_poses(m, scene) for m in made))


def test_threads_of_the_solver_are_not_those_of_the_machine() -> None:
    options = pycolmap.BundleAdjustmentOptions()
    colmapmodel.factorised(options, frames=colmapmodel.MOST_FRAMES + 1, images=10**6)
    assert options.ceres.solver_options.num_threads == 1


def test_final_adjustment_finds_the_principal_point(tmp_path) -> None:
    """A principal point assumed 8 px off its place: the mappers keep it, the final adjustment finds it."""
    truth, _ = make_world(tmp_path / "database.db", cameras=2, frames=12, noise_px=0.2)
    wrong = pycolmap.Reconstruction(truth)
    camera = wrong.camera(1)
    right = copy.copy(camera).params
    camera.principal_point_x += 8
    before = wrong.compute_mean_reprojection_error()
    wrong.update_point_3d_errors()
    result = final_adjustment(wrong, tuning=TUNING)
    assert "principal points moved" in result.note
    found = result.model.camera(1)
    assert abs(found.principal_point_x - right[1]) < 2.0
    assert result.model.compute_mean_reprojection_error() < max(before, 1.0)
    kept = final_adjustment(wrong, constant_cameras=[1], tuning=TUNING).model.camera(1)
    assert kept.principal_point_x == camera.principal_point_x


def test_a_camera_with_impossible_intrinsics_keeps_its_own_and_the_rest_is_adjusted(tmp_path, monkeypatch) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=2, frames=12, noise_px=0.2)
    asked = []

    def impossible(before, after, cameras, tuning):
        asked.append(set(cameras))
        return 2 if 2 in cameras else None

    monkeypatch.setattr("tiegraph.sfm.adjustment.adjust.impossible_camera", impossible)
    result = final_adjustment(truth, tuning=TUNING)
    assert asked[1] == asked[0] - {2} != set() and "camera 2 keeps its intrinsics" in result.note
    assert (result.model.camera(2).params == truth.camera(2).params).all()
    assert result.model.camera(2).model == truth.camera(2).model
    assert result.model.camera(1).mean_focal_length() != truth.camera(1).mean_focal_length()


def test_each_cell_of_each_image_keeps_its_longest_tracks(tmp_path: Path) -> None:
    model, _ = make_world(tmp_path / "world.db", points=400)
    gone = set(points_that_can_wait(model, FEW))
    tracks = {k: p.track.length() for k, p in model.points3D.items()}
    assert 0.5 < len(gone) / len(tracks) < 0.95
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        half = np.array([image.camera.width, image.camera.height]) / 2
        cells: dict[tuple, list[int]] = {}
        for point in image.get_observation_points2D():
            cells.setdefault(tuple(point.xy >= half), []).append(point.point3D_id)
        for own in cells.values():
            kept, lost = ([tracks[k] for k in own if (k in gone) == side] for side in (False, True))
            assert len(kept) >= min(5, len(own))
            assert not lost or max(lost) <= sorted(kept)[-5]
    model, _ = make_world(tmp_path / "world.db", points=60)
    assert points_that_can_wait(model, FewPointsTuning()) == []
    assert thinned(model, FewPointsTuning()) is model


def test_the_points_of_a_model_that_was_bent_straight_go_with_their_images(tmp_path: Path) -> None:
    """Those that waited lie metres off in 4020 images: left behind, four of five were filtered away."""
    model, _ = make_world(tmp_path / "world.db", points=400)
    few, still = pycolmap.Reconstruction(model), pycolmap.Reconstruction(model)
    for number, key in enumerate(sorted(few.reg_frame_ids())):
        turn = pycolmap.Rotation3d(Rotation.from_euler("y", 3 + 0.01 * number, degrees=True).as_quat())
        bend = pycolmap.Rigid3d(turn, np.array([0.0, 0.4, 1.0 + 0.002 * number]))
        few.frame(key).rig_from_world = few.frame(key).rig_from_world * bend.inverse()
    take_poses(still, few)
    for key, point in model.points3D.items():
        still.point3D(key).xyz = point.xyz
    take_poses(model, few)
    for each in (model, still):
        each.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() < 2
    assert still.compute_mean_reprojection_error() > 50


def test_the_end_is_that_of_all_points(tmp_path: Path) -> None:
    """The last adjustment takes all points, and those that waited are brought to where their rays meet before."""
    model, scene = make_world(tmp_path / "world.db", points=400)
    for point in model.points3D.values():
        point.xyz = point.xyz + np.random.default_rng(point.track.length()).normal(0, 0.02, 3)
    whole = final_adjustment(model, tuning=AdjustTuning(few_points=FewPointsTuning(worth=0)))
    first = final_adjustment(model, tuning=AdjustTuning(few_points=FEW))
    assert 0.99 < first.model.compute_num_observations() / whole.model.compute_num_observations() < 1.01
    assert_reconstruction_near(first.model, scene, image_poses(whole.model, scene), deg=0.005, m=0.001)


TRUE = (1.002, 4e-4, -5e-4)  # fx / fy, p1, p2


def _camera(of: pycolmap.Camera, aspect: float, p1: float, p2: float) -> tuple[pycolmap.Camera, pycolmap.Camera]:
    """A true camera OPENCV in place of another, and what a mapper with RADIAL takes it for."""
    focal, x, y = of.mean_focal_length(), of.principal_point_x, of.principal_point_y
    true = [focal * aspect**0.5, focal / aspect**0.5, x, y, -0.03, 0.004, p1, p2]
    size = {"width": of.width, "height": of.height, "camera_id": of.camera_id}
    return (
        pycolmap.Camera(model="OPENCV", params=true, **size),
        pycolmap.Camera(model="RADIAL", params=[focal, x, y, -0.03, 0.004], **size),
    )


def _put(model: pycolmap.Reconstruction, key: int, camera: pycolmap.Camera) -> None:
    own = model.camera(key)
    own.model = camera.model
    own.params = camera.params


def _world(folder: Path, frames: int = 12) -> tuple[pycolmap.Reconstruction, pycolmap.Reconstruction]:
    """Truth with lenses of aspect and decentring, and the start a mapper with RADIAL gives."""
    truth, _ = make_world(folder / "database.db", cameras=2, frames=frames, noise_px=0.0, points=500)
    rng = np.random.default_rng(0)
    both = {k: _camera(copy.copy(c), *TRUE) for k, c in truth.cameras.items()}
    for key, (true, _) in both.items():
        _put(truth, key, true)
    truth = seen_anew(truth, lambda image, point, exact: exact + 0.1 * rng.standard_normal(2))
    start = pycolmap.Reconstruction(truth)
    for key, (_, radial) in both.items():
        _put(start, key, radial)
    return truth, start


def _turned_deg(a: pycolmap.Reconstruction, b: pycolmap.Reconstruction) -> float:
    """Largest difference between the rotations of the rigs' cameras."""
    pairs = [
        (p, dict(b.rig(k).non_ref_sensors.items())[s]) for k, r in a.rigs.items() for s, p in r.non_ref_sensors.items()
    ]
    return max(float(transforms.angle_deg(matrix(p)[:3, :3], matrix(q)[:3, :3])) for p, q in pairs)


def test_an_extended_camera_projects_as_before_and_is_taken_over_with_its_model(tmp_path) -> None:
    """Taken over by parameters alone it made a file that no one can read, after an hour of 4020 images."""
    _, start = _world(tmp_path, frames=4)
    wide = lens.extended(start, [1])
    assert wide.camera(1).model.name == "OPENCV" and wide.camera(2).model.name == "RADIAL"
    assert start.camera(1).model.name == "RADIAL"
    rays = np.array([[0.3, -0.2, 1.0], [-0.5, 0.4, 1.0]])
    assert wide.camera(1).img_from_cam(rays) == pytest.approx(start.camera(1).img_from_cam(rays))
    assert lens.extensible(start, [1, 2], ("PINHOLE",)) == []
    lens.take_cameras(start, wide)
    (tmp_path / "model").mkdir()
    start.write(tmp_path / "model")
    read = read_model(tmp_path / "model")
    assert read.camera(1).model.name == "OPENCV" and read.camera(2).model.name == "RADIAL"
    assert np.array_equal(read.camera(1).params, wide.camera(1).params)


@pytest.mark.parametrize("model", ["RADIAL", "SIMPLE_RADIAL"])
def test_free_radial_cameras_get_all_terms(tmp_path, model: str) -> None:
    """With one radial term the second is taken up by the focal length."""
    truth, start = _world(tmp_path)
    for key, of in start.cameras.items() if model == "SIMPLE_RADIAL" else ():
        _put(start, key, pycolmap.Camera(model=model, width=of.width, height=of.height, params=of.params[:4]))
    found = final_adjustment(start, tuning=Tuning().adjust).model
    for key in truth.cameras:
        assert found.camera(key).model.name == "OPENCV"
        assert found.camera(key).mean_focal_length() == pytest.approx(truth.camera(key).mean_focal_length(), rel=0.005)
    held = final_adjustment(start, (), [1], tuning=Tuning().adjust).model
    assert held.camera(1).model.name == model and held.camera(2).model.name == "OPENCV"


def test_the_final_adjustment_finds_aspect_and_decentring_and_the_rig_gains(tmp_path, monkeypatch) -> None:
    truth, start = _world(tmp_path)
    found = final_adjustment(start, tuning=Tuning().adjust).model
    camera = found.camera(2)
    assert camera.model.name == "OPENCV"
    assert camera.focal_length_x / camera.focal_length_y == pytest.approx(TRUE[0], abs=5e-4)
    assert camera.params[6:] == pytest.approx(TRUE[1:], abs=2.5e-4)
    monkeypatch.setattr(lens, "extensible", lambda *_: [])
    radial = final_adjustment(start, tuning=Tuning().adjust).model
    assert radial.camera(2).model.name == "RADIAL"
    assert _turned_deg(found, truth) < 0.5 * _turned_deg(radial, truth)


def test_priors_are_those_of_a_lens() -> None:
    tuning = Tuning().adjust.lens
    expected = lens.covariance(500.0, tuning)
    ratio = np.array([1, -1, 0, 0, 0, 0, 0, 0]) / 500
    assert np.sqrt(ratio @ expected @ ratio) == pytest.approx(tuning.aspect)
    assert np.sqrt(expected[7, 7]) == tuning.decentring and np.linalg.eigvalsh(expected).min() > 0
