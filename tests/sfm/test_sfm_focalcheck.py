"""A focal length far from the given one asks for the other mapper, and what explains the images better stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pycolmap
import pytest
from sfm_worlds import make_world

from tiegraph.scene.scene import Scene
from tiegraph.sfm import mapping
from tiegraph.sfm.mapping import cost_in_the_end, ran_off
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning

MOST = Tuning().mapping.other_focal


def _with_focal(model: pycolmap.Reconstruction, factor: float) -> pycolmap.Reconstruction:
    out = pycolmap.Reconstruction(model)
    camera = out.camera(1)
    for k in camera.focal_length_idxs():
        camera.params[k] = factor * camera.params[k]
    return out


def test_only_what_is_far_from_a_given_focal_length_ran_off(tmp_path: Path) -> None:
    truth, scene = make_world(tmp_path / "database.db", cameras=1, frames=4)
    rig = scene.rigs[0]
    camera = pycolmap.Camera(rig.sensors[0].camera.todict())
    given_px = camera.mean_focal_length()
    assert ran_off(_with_focal(truth, MOST - 0.01), scene, MOST) is None
    assert ran_off(_with_focal(truth, 1 / MOST + 0.01), scene, MOST) is None
    said = ran_off(_with_focal(truth, 2.0), scene, MOST)
    assert said is not None and f"{2 * given_px:.0f} px, {given_px:.0f} px are given" in said
    assert ran_off(_with_focal(truth, 1 / MOST - 0.01), scene, MOST) is not None
    camera.has_prior_focal_length = False
    guessed = scene.with_(rigs=(replace(rig, sensors=(replace(rig.sensors[0], camera=camera),)),))
    assert ran_off(_with_focal(truth, 2.0), guessed, MOST) is None


@pytest.mark.parametrize(
    ("cost", "kept", "rough"), [(0.9, "global", False), (1.1, "incremental", False), (0.9, "global", True)]
)
def test_the_model_that_explains_the_images_better_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cost: float, kept: str, rough: bool
) -> None:
    """A coarse model too: no adjustment comes back from poses with a wrong focal length."""
    truth, scene = make_world(tmp_path / "database.db", cameras=1, frames=4)
    job = _job(scene)
    job = replace(job, source=replace(job.source, rough=rough))
    first = mapping.Outcome("incremental", [_written(_with_focal(truth, 2.0), tmp_path / "first")], len(scene))
    other = mapping.Outcome("global", [_written(truth, tmp_path / "other")], len(scene))
    asked: list[str] = []
    monkeypatch.setattr(mapping, "_run", lambda job, mapper, *rest: asked.append(mapper) or other)
    px = truth.camera(1).mean_focal_length()
    costs = {round(2 * px): 1.0, round(px): cost}
    monkeypatch.setattr(mapping, "cost_in_the_end", lambda model, *_: costs[round(model.camera(1).mean_focal_length())])
    assert mapping._near_given_focal_lengths(job, first, "").mapper == kept
    assert asked == ["global"] and f"{cost:.2f} times as large: kept {kept}" in job.account.notes[0]
    fewer = replace(other, registered=1)
    monkeypatch.setattr(mapping, "_run", lambda *_: fewer)
    assert mapping._near_given_focal_lengths(job, first, "") is first
    assert mapping._near_given_focal_lengths(job, other, "") is other
    ordered = replace(job, settings=SparseSettings(mapper="incremental"))
    assert mapping._near_given_focal_lengths(ordered, first, "") is first


def test_the_cost_is_that_after_the_adjustment(tmp_path: Path) -> None:
    truth, _ = make_world(tmp_path / "database.db", cameras=1, frames=12, noise_px=0.2)
    wrong, tuning = _with_focal(truth, 1.02), Tuning().adjust
    before, after = cost_in_the_end(truth, (), (), tuning), cost_in_the_end(wrong, (), (), tuning)
    assert 0.01 < before < 0.1 and after == pytest.approx(before, rel=0.02)
    assert cost_in_the_end(wrong, (), (1,), tuning) > 1.05 * before


def _job(scene: Scene) -> mapping.Job:
    nothing: Any = SimpleNamespace()
    source = mapping.Source(Path("none.db"), None)
    return mapping.Job(
        source=source, out=Path(), scene=scene, settings=SparseSettings(), tuning=Tuning(), shared=nothing,
        log=Path("log.txt"), graph=nothing, account=mapping.Account(), rigs=mapping.RigsUsed({}, {}),
    )  # fmt: skip


def _written(model: pycolmap.Reconstruction, folder: Path) -> Path:
    folder.mkdir()
    model.write(folder)
    return folder
