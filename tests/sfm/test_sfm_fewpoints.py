"""Adjusting with few points first: which ones, and that the end is that of all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world

from near import assert_reconstruction_near
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.fewpoints import points_that_can_wait, take_poses, thinned
from tiegraph.sfm.tuning import AdjustTuning, FewPointsTuning

import pycolmap  # isort: skip

FEW = FewPointsTuning(cells=2, in_a_cell=5)


def test_each_cell_of_each_image_keeps_its_longest_tracks(tmp_path: Path) -> None:
    model, _ = make_world(tmp_path / "world.db", points=400)
    gone = set(points_that_can_wait(model, FEW))
    tracks = {k: p.track.length() for k, p in model.points3D.items()}
    assert 0.5 < len(gone) / len(tracks) < 0.95
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        half = np.array([image.camera.width, image.camera.height]) / 2
        for column in (0, 1):
            for row in (0, 1):
                own = [
                    p.point3D_id
                    for p in image.get_observation_points2D()
                    if (int(p.xy[0] >= half[0]), int(p.xy[1] >= half[1])) == (column, row)
                ]
                kept = [tracks[k] for k in own if k not in gone]
                assert len(kept) >= min(5, len(own))
                lost = [tracks[k] for k in own if k in gone]
                assert not lost or max(lost) <= sorted(kept)[-5]


def test_a_model_of_few_points_keeps_all(tmp_path: Path) -> None:
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


@pytest.mark.slow
def test_the_end_is_that_of_all_points(tmp_path: Path) -> None:
    """The last adjustment takes all points, and those that waited are brought to where their rays meet before."""
    model, scene = make_world(tmp_path / "world.db", points=400)
    for point in model.points3D.values():
        point.xyz = point.xyz + np.random.default_rng(point.track.length()).normal(0, 0.02, 3)
    whole = final_adjustment(model, tuning=AdjustTuning(few_points=FewPointsTuning(worth=0)))
    first = final_adjustment(model, tuning=AdjustTuning(few_points=FEW))
    assert 0.99 < first.model.compute_num_observations() / whole.model.compute_num_observations() < 1.01
    assert_reconstruction_near(first.model, scene, image_poses(whole.model, scene), deg=0.005, m=0.001)
