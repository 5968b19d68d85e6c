"""The final adjustment: which points it does without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sfm_worlds import make_world

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from tiegraph.sfm.adjust import ENOUGH_SEEN, drop_momentary


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
    assert drop_momentary(model) == len(momentary)
    assert set(model.point3D_ids()) == before - set(momentary)
    assert drop_momentary(model) == 0


def test_a_frame_that_has_little_else_keeps_them(tmp_path: Path) -> None:
    model, _ = make_world(tmp_path / "database.db", frames=1, points=ENOUGH_SEEN * 2)
    before = sorted(model.point3D_ids())
    assert _momentary(model) == before
    assert drop_momentary(model) == 0
    assert np.array_equal(sorted(model.point3D_ids()), before)
