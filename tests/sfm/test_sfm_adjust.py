"""The final adjustment: which points it does without; the same bits each time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sfm_worlds import make_world

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.scene import solver
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.sfm.adjustment.adjust import drop_momentary, final_adjustment
from tiegraph.sfm.tuning import AdjustTuning

TUNING = AdjustTuning()


def _momentary(model: pycolmap.Reconstruction) -> list[int]:
    frame = {i: model.image(i).frame_id for i in model.reg_image_ids()}
    return sorted(
        k for k, p in model.points3D.items() if len({frame[e.image_id] for e in p.track.elements}) == 1
    )  # fmt: skip


def _cut_to_one_shot(model: pycolmap.Reconstruction, keys: list[int]) -> None:
    """Leave of these points what the two first cameras of one shot see."""
    for key in keys:
        seen = [(e.image_id, e.point2D_idx) for e in model.point3D(key).track.elements]
        shots = [model.image(image).frame_id for image, _ in seen]
        kept = max(set(shots), key=shots.count)
        for (image, feature), shot in zip(seen, shots) if shots.count(kept) > 1 else ():
            if shot != kept:
                model.delete_observation(image, feature)


def test_what_one_shot_alone_saw_goes_and_the_rest_stays(tmp_path: Path) -> None:
    model, _ = make_world(tmp_path / "database.db", points=200)
    before = set(model.point3D_ids())
    _cut_to_one_shot(model, sorted(before)[::20])
    momentary = _momentary(model)
    assert len(momentary) > 3
    assert drop_momentary(model, TUNING.enough_seen) == len(momentary)
    assert set(model.point3D_ids()) == before - set(momentary)
    assert drop_momentary(model, TUNING.enough_seen) == 0


def test_a_frame_that_has_little_else_keeps_them(tmp_path: Path) -> None:
    model, _ = make_world(tmp_path / "database.db", frames=1, points=TUNING.enough_seen * 2)
    before = sorted(model.point3D_ids())
    assert _momentary(model) == before
    assert drop_momentary(model, TUNING.enough_seen) == 0
    assert np.array_equal(sorted(model.point3D_ids()), before)


@pytest.mark.slow
def test_a_large_adjustment_gives_the_same_bits_each_time(tmp_path: Path) -> None:
    # COLMAP solves those with fewer than 50 000 residuals on one thread anyway.
    model, scene = make_world(tmp_path / "database.db", cameras=2, frames=9, points=1500)
    assert 2 * model.compute_num_observations() > 50_000
    made = [final_adjustment(pycolmap.Reconstruction(model), tuning=TUNING).model for _ in range(2)]
    found = [image_poses(m, scene) for m in made]
    assert np.array_equal(*found)


def test_threads_of_the_solver_are_not_those_of_the_machine() -> None:
    options = pycolmap.BundleAdjustmentOptions()
    solver.factorised(options, frames=solver.MOST_FRAMES + 1, images=10**6)
    assert options.ceres.solver_options.num_threads == 1
