"""What matching could not place is placed, or tied, by guided matching where its neighbours predict it."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from moving_world import moving_world, write_database

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import MAX_IMAGES
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses, image_poses
from tiegraph.sfm.placement.predictedpose import predicted_pose
from tiegraph.sfm.placement.registration import MatchSource, RegistrationResult, repair_registration
from tiegraph.sfm.tuning.placement import PlacementTuning

TUNING = PlacementTuning()


FRAMES = 12
LOST = 6


@pytest.fixture
def world(tmp_path: Path) -> tuple[pycolmap.Reconstruction, Scene]:
    """A survey with descriptors: of one point alike in all images, of different points not."""
    model, scene = moving_world(frames=FRAMES)
    write_database(model, tmp_path / "database.db")
    rng = np.random.default_rng(2)
    looks: dict[int, np.ndarray] = {}
    with pycolmap.Database.open(tmp_path / "database.db") as database, pycolmap.DatabaseTransaction(database):
        for image in model.images.values():
            rows = []
            for p in image.points2D:
                look = rng.gamma(0.5, 1.0, 128)
                if p.has_point3D():
                    look = looks.setdefault(int(p.point3D_id), look)
                rows.append(np.abs(look + 0.1 * rng.standard_normal(128)))
            table = np.array(rows)
            table = np.round(512 * table / np.linalg.norm(table, axis=1, keepdims=True)).clip(0, 255).astype(np.uint8)
            kind = pycolmap.FeatureExtractorType.SIFT
            database.write_descriptors(image.image_id, pycolmap.FeatureDescriptors(type=kind, data=table))
    return model, scene


def _without_ties(folder: Path, scene: Scene, images: np.ndarray) -> None:
    """Delete the verified pairs of some images (N,) bool."""
    with sqlite3.connect(folder / "database.db") as db:
        lost = {i for i, n in db.execute("SELECT image_id, name FROM images") if images[scene.image_index[n]]}
        for (pair,) in db.execute("SELECT pair_id FROM two_view_geometries").fetchall():
            if set(divmod(pair, MAX_IMAGES)) & lost:
                db.execute("DELETE FROM two_view_geometries WHERE pair_id = ?", (pair,))


def _settle(
    model: pycolmap.Reconstruction, scene: Scene, folder: Path, preview: np.ndarray | None = None
) -> RegistrationResult:
    rigs = dict(enumerate(scene.rigs))
    source = MatchSource(folder / "database.db", folder, (), folder / "scratch")
    return repair_registration(model, scene, source, rigs, preview, TUNING)


def _lose(model: pycolmap.Reconstruction, folder: Path, frame: int) -> pycolmap.Reconstruction:
    """The model without a frame, as a mapper would have left it."""
    model.deregister_frame(frame + 1)
    model.write(folder)
    return pycolmap.Reconstruction(folder)


def test_a_frame_without_matches_is_placed_where_its_neighbours_predict_it(world, tmp_path: Path) -> None:
    model, scene = world
    true = transforms.centre(image_poses(model, scene))
    _without_ties(tmp_path, scene, scene.frame == LOST)
    settled = _settle(_lose(model, tmp_path, LOST), scene, tmp_path)
    assert settled.model.num_reg_images() == len(scene) and settled.dropped == []
    assert any("3 images were placed by guided matching" in n for n in settled.notes)
    assert {row[1] for row in settled.table["rows"]} == {"placed, guided"}
    off = np.linalg.norm(transforms.centre(image_poses(settled.model, scene)) - true, axis=1)
    assert 1e-5 < off[scene.frame == LOST].max() < 0.03
    names = [scene.names[k] for k in np.flatnonzero(scene.frame == LOST)]
    assert all(settled.model.find_image_with_name(n).num_points3D > 40 for n in names)


def test_what_is_tied_to_another_section_only_is_not_taken_from_it(world, tmp_path: Path) -> None:
    model, scene = world
    with sqlite3.connect(tmp_path / "database.db") as db:
        frame = {i: int(scene.frame[scene.image_index[n]]) for i, n in db.execute("SELECT image_id, name FROM images")}
        for (pair,) in db.execute("SELECT pair_id FROM two_view_geometries").fetchall():
            a, b = (frame[k] for k in divmod(pair, MAX_IMAGES))
            if (a < LOST) != (b < LOST):
                db.execute("DELETE FROM two_view_geometries WHERE pair_id = ?", (pair,))
    for later in range(LOST, FRAMES):
        model.deregister_frame(later + 1)
    model.write(tmp_path)
    found = _settle(pycolmap.Reconstruction(tmp_path), scene, tmp_path)
    assert found.model.num_reg_frames() == LOST and not any("guided" in note for note in found.notes)


def test_a_frame_that_looks_like_nothing_is_missing_with_its_reason(world, tmp_path: Path) -> None:
    model, scene = world
    _without_ties(tmp_path, scene, scene.frame == LOST)
    rng = np.random.default_rng(0)
    with sqlite3.connect(tmp_path / "database.db") as db:
        for image_id, name in db.execute("SELECT image_id, name FROM images").fetchall():
            if scene.frame[scene.image_index[name]] == LOST:
                rows = db.execute("SELECT rows FROM descriptors WHERE image_id = ?", (image_id,)).fetchone()[0]
                noise = rng.integers(0, 90, (rows, 128)).astype(np.uint8).tobytes()
                db.execute("UPDATE descriptors SET data = ? WHERE image_id = ?", (noise, image_id))
    settled = _settle(_lose(model, tmp_path, LOST), scene, tmp_path)
    assert settled.model.num_reg_images() == len(scene) - 3
    assert {name for name, _ in settled.dropped} == {f"cam{s}/{LOST:03d}.jpg" for s in range(3)}
    reasons = {why for _, why in settled.dropped}
    assert all("at the place that its neighbours on the pass give" in r and "are needed" in r for r in reasons)


def test_an_image_that_hangs_on_the_rig_is_tied(world, tmp_path: Path) -> None:
    model, scene = world
    weak = (scene.frame == LOST) & (scene.sensor == 1)
    _without_ties(tmp_path, scene, weak)
    name = scene.names[int(np.flatnonzero(weak)[0])]
    image = model.find_image_with_name(name)
    for k, p in enumerate(image.points2D):
        if p.has_point3D():
            model.delete_observation(image.image_id, k)
    assert image.num_points3D == 0
    settled = _settle(model, scene, tmp_path)
    assert any("1 images that hung on the rig were tied" in n for n in settled.notes)
    tied = settled.model.find_image_with_name(name)
    assert tied.num_points3D > 40
    pose = tied.cam_from_world()
    camera = settled.model.camera(tied.camera_id)
    off = [np.linalg.norm(camera.img_from_cam(pose * settled.model.points3D[p.point3D_id].xyz) - p.xy)
           for p in tied.get_observation_points2D()]  # fmt: skip
    assert 0.05 < float(np.mean(off)) < 0.7  # key points have 0.3 px of noise


def test_poses_are_predicted_by_the_preview_model_and_by_the_pass() -> None:
    model, scene = moving_world(frames=FRAMES)
    true = frame_poses(image_poses(model, scene), scene)
    poses = np.where((np.arange(FRAMES) == LOST)[:, None, None], np.nan, true)
    turn = transforms.rigid(transforms.rigid(np.eye(3), np.zeros(3))[:3, :3][[2, 0, 1]], np.array([3.0, 1, 2]))
    preview = turn @ true
    preview[:, :3, 3] *= 0.3
    by_preview, by_pass = (predicted_pose(LOST, poses, p, scene, TUNING.predict) for p in (preview, None))
    assert by_preview.by == "poses of the coarse model" and by_preview.slack_rad == TUNING.predict.by_preview_rad
    np.testing.assert_allclose(by_preview.pose, true[LOST], atol=1e-6)
    assert by_pass.slack_rad == TUNING.predict.by_pass_rad
    assert 1e-4 < np.linalg.norm((by_pass.pose - true[LOST])[:3, 3]) < 0.1
    alone = np.where((np.arange(FRAMES) < FRAMES - 1)[:, None, None], poses, np.nan)
    # At the end of the pass, with frames on one side only.
    assert predicted_pose(FRAMES - 1, alone, None, scene, TUNING.predict) is None
