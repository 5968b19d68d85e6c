"""Mapping a synthetic rig survey: rigs, losses with reasons, errors; which of two mappers' models stays."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pycolmap
import pytest
from sfm_worlds import drop_pairs, frame_centres, make_world, run_sparse, with_positions, without_extrinsics

from here import here
from near import off_after_similarity, rms
from tiegraph.child import run_in_child
from tiegraph.errors import ChildDied, ReconstructionError, SettingsError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.scene.colmapdatabase import image_ids
from tiegraph.scene.colmapmodel import image_poses, model_rigs
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm import mapper, mapping
from tiegraph.sfm.mapper import SparseResult
from tiegraph.sfm.mapping import choose_mapper
from tiegraph.sfm.model import held_out_frames
from tiegraph.sfm.registrationreport import ran_off
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.tuning.world import FixTuning


def _run(folder: Path, scene: Scene, source: dict | None = None, **settings: object) -> SparseResult:
    return run_sparse(folder, scene, {"images": folder} | (source or {}), **settings)


def _centre_error(result: SparseResult, scene: Scene, truth: pycolmap.Reconstruction) -> float:
    return rms(off_after_similarity(frame_centres(result.load(), scene), frame_centres(truth, scene)))


@pytest.mark.slow
def test_fixed_rig_keeps_its_metric_size(tmp_path: Path) -> None:
    truth, scene = make_world(tmp_path / "database.db")
    before = (tmp_path / "database.db").read_bytes()
    seen: list[tuple[int, int]] = []
    watched = {"on_progress": lambda done, total: seen.append((done, total))}
    result = _run(tmp_path, scene, watched, mapper="incremental")
    assert (tmp_path / "database.db").read_bytes() == before
    assert result.rig == "fixed" and result.mapper == "incremental"
    assert result.counts["registered"] == len(scene) and result.remarks.dropped == []
    assert seen[0] == (0, len(scene)) and 0.5 * len(scene) <= seen[-1][0] <= len(scene)
    scale = umeyama(frame_centres(result.load(), scene), frame_centres(truth, scene)).scale
    assert scale == pytest.approx(1, abs=0.01)  # the baselines, 0.5 m at 3-5 m, hold it
    for sensor, found in zip(scene.rigs[0].sensors, model_rigs(result.load(), scene)[0].sensors):
        np.testing.assert_allclose(found.sensor_from_rig, sensor.sensor_from_rig, atol=1e-9)
    assert 0 < _centre_error(result, scene, truth) < 0.02
    assert result.sigma is not None and 1e-5 < result.sigma.median < 0.02
    assert sorted(p.name for p in (tmp_path / "sparse").iterdir()) == ["0"]


@pytest.mark.slow
def test_an_image_without_a_point_is_placed_by_its_rig_and_not_registered(tmp_path: Path) -> None:
    _, scene = make_world(tmp_path / "database.db")
    blind = scene.image_index[next(n for k, n in enumerate(scene.names) if scene.sensor[k] == 1)]
    number = image_ids(tmp_path / "database.db", scene)[blind]
    drop_pairs(tmp_path / "database.db", lambda *pair: number in pair)
    result = _run(tmp_path, scene, mapper="incremental", covariance_frames=0)
    assert result.counts["registered"] == len(scene) - 1 and result.counts["placed_by_rig"] == 1
    assert result.remarks.dropped == [] and any("1 images see fewer than 10 points" in n for n in result.remarks.notes)
    assert np.flatnonzero(result.models[0].found.by_rig).tolist() == [blind]
    assert result.tables["models"]["rows"][0][1:3] == [len(scene) - 1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("factor, said", [(1.1, 0), (2.0, 1)])
def test_a_focal_length_far_from_the_given_one_is_a_contradiction(tmp_path: Path, factor: float, said: int) -> None:
    _, scene = make_world(tmp_path / "database.db", 1, points=400)
    rig, camera = scene.rigs[0], pycolmap.Camera(scene.rigs[0].sensors[0].camera.todict())
    camera.focal_length = factor * camera.focal_length
    other = scene.with_(rigs=(replace(rig, sensors=(replace(rig.sensors[0], camera=camera),)),))
    result = _run(tmp_path, other, mapper="incremental", refine_intrinsics="yes", covariance_frames=0)
    lines = [line for line in result.remarks.contradictions if "heights above the ground" in line]
    assert len(lines) == said and all("1280 px" in line and "but 2560 px are given" in line for line in lines)


@pytest.mark.slow
def test_a_narrow_lens_may_have_a_large_coefficient(tmp_path: Path) -> None:
    """k = 2 moves the corners by an eighth of their distance from the middle, at 2.5 widths of focal length."""
    lens = {"camera_model_id": pycolmap.CameraModelId.SIMPLE_RADIAL, "camera_params": [2560.0, 512.0, 384.0, 2.0]}
    truth, scene = make_world(tmp_path / "database.db", 1, 10, points=400, **lens)
    result = _run(tmp_path, scene, mapper="incremental", refine_intrinsics="yes", covariance_frames=0)
    assert result.counts["registered"] == len(scene) == 10
    camera = result.load().camera(1)
    assert camera.model.name == "OPENCV" and 1.6 < camera.params[4] < 2.4
    assert 0 < _centre_error(result, scene, truth) < 0.05


@pytest.mark.slow
def test_a_rough_model_needs_no_images_and_no_final_adjustment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mapping, "run_in_child", run_in_child)  # the log is of a real child
    truth, scene = make_world(tmp_path / "database.db")
    result = run_sparse(tmp_path, scene, {"rough": True}, covariance_frames=0)
    assert result.mapper == "global"
    assert "Could not read image" not in (tmp_path / "log.txt").read_text(), "a line of each would fill the log"
    assert result.counts["registered"] + result.counts["placed_by_rig"] == len(scene)
    assert 0.02 < _centre_error(result, scene, truth) < 0.4  # of a few metres: 100 points, and nothing adjusted
    assert not any("adjust" in note for note in result.remarks.notes)


@pytest.mark.slow
def test_unknown_rig_is_found_and_used(tmp_path: Path) -> None:
    truth, scene = make_world(tmp_path / "database.db", noise_px=0.2)
    unknown = without_extrinsics(scene)
    result = _run(tmp_path, unknown)
    assert result.rig == "derived" and result.mapper == "preview"
    assert result.tables["runs"]["rows"][-1][3] == "with the rig that was found"
    extrinsics = [s.sensor_from_rig for s in model_rigs(result.load(), result.scene)[0].sensors]
    for sensor, pose in zip(scene.rigs[0].sensors[1:], extrinsics[1:]):
        assert pose is not None
        assert 0 < transforms.angle_deg(pose[:3, :3], sensor.sensor_from_rig[:3, :3]) < 0.5
    assert any("cameras found by their images" in n for n in result.remarks.notes)
    assert 0 < _centre_error(result, result.scene, truth) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "said"),
    [(0.28, "explains 28 % of the matches, without it 77 %: the rig is not used"), (0.75, ""), (None, "no model with")],
)
def test_a_rig_with_which_the_model_explains_less_is_not_used(share, said: str, tmp_path: Path, monkeypatch):
    """Of a 360 camera's weak images the model explained 28 % of the matches with the rig that was found, 77 without."""
    truth, scene = make_world(tmp_path / "database.db", noise_px=0.2)

    def mapped(job, *label):
        if share is None and "derived" in job.modes.values():
            raise ReconstructionError("they fell apart")
        return map_images(job, *label)

    map_images = mapper.map_images
    monkeypatch.setattr(mapper, "map_images", mapped)
    monkeypatch.setattr(
        mapper, "share_of_matches", lambda job, made: share or 0.0 if "derived" in job.modes.values() else 0.77
    )
    result = _run(tmp_path, without_extrinsics(scene))
    assert result.rig == ("absent" if said else "derived")
    assert bool(said) == any(said in note for note in result.remarks.notes if said)
    assert 0 < _centre_error(result, result.scene, truth) < 0.03


@pytest.mark.slow
def test_absent_rig_and_lost_images_keep_their_reason(tmp_path: Path) -> None:
    _, scene = make_world(tmp_path / "database.db", cameras=2, frames=6)
    *_, (before, name_before), (last, name) = sorted(
        (number, scene.names[k]) for k, number in image_ids(tmp_path / "database.db", scene).items()
    )
    with sqlite3.connect(tmp_path / "database.db") as db:
        db.execute("UPDATE keypoints SET rows = 0, data = x'' WHERE image_id = ?", (last,))
    drop_pairs(tmp_path / "database.db", lambda *pair: last in pair or before in pair)
    result = _run(tmp_path, scene, rig="absent")
    assert result.rig == "absent" and result.mapper == "incremental"
    reasons = {name: "no features (masked, blank or unreadable)", name_before: "no verified pair"}
    assert dict(result.remarks.dropped) == reasons and result.components == (10,)


@pytest.mark.slow
def test_a_model_of_which_no_image_sees_enough_points_is_none(tmp_path: Path) -> None:
    _, scene = make_world(tmp_path / "database.db", cameras=2, frames=4)
    most = SceneTuning(registered=RegisteredTuning(min_points=10**6))
    with pytest.raises(ReconstructionError, match=r"none sees 1000000 points of the result .* agree with it"):
        _run(tmp_path, scene, shared=most)
    assert list((tmp_path / "sparse").iterdir()) == []


@pytest.mark.slow
def test_the_same_input_gives_the_same_model(tmp_path: Path) -> None:
    _, scene = make_world(tmp_path / "database.db", cameras=2, frames=6)
    poses = [image_poses(_run(tmp_path, scene, mapper="global", covariance_frames=0).load(), scene) for _ in range(2)]
    np.testing.assert_array_equal(poses[0], poses[1])


def test_what_cannot_be_mapped_is_said(tmp_path: Path) -> None:
    _, scene = make_world(tmp_path / "database.db", cameras=2, frames=4)
    with pytest.raises(SettingsError, match="sensors without extrinsics"):
        _run(tmp_path, without_extrinsics(scene), rig="fixed")
    drop_pairs(tmp_path / "database.db", lambda *pair: True)
    with pytest.raises(ReconstructionError, match=r"Of 8 images 8 have features; 0 pairs .*Remedies"):
        _run(tmp_path, scene)


@pytest.mark.slow
@pytest.mark.parametrize("asked, dies", [("auto", ""), ("global", ""), ("auto", "adjustment"), ("global", "mapping")])
def test_a_child_that_dies_is_tried_in_its_safest_form(tmp_path: Path, monkeypatch, asked: str, dies: str) -> None:
    """The other mapper, asked for or not, then the model as mapped; what is missing is said, and once more is too much:
    then it is no fault of the images. ``dies``: in whatever form."""
    _, scene = make_world(tmp_path / "database.db", cameras=2, frames=6)
    tried, seeds = [], []

    def child(function, request, *, task: str, **how):
        tried.append(task)
        seeds.extend([request.method.seed] if "mapping" in task else [])
        rough = getattr(request, "rough", False)
        if (dies and dies in task) or task == "global mapping" or (task == "final adjustment" and not rough):
            raise ChildDied(f"{task}: the native library ended its process (signal SIGSEGV)")
        return here(function, request, task=task, **how)

    for module in (mapper, mapping):
        monkeypatch.setattr(module, "run_in_child", child)
    if dies:
        with pytest.raises(ChildDied, match=f"{dies}: the native library"):
            _run(tmp_path, scene, mapper=asked)
        return
    result = _run(tmp_path, scene, mapper=asked, seed=7)
    assert tried == ["global mapping"] * 2 + ["incremental mapping"] + ["final adjustment"] * 2
    assert seeds == [7, 8, 7], "the seed that is asked for, another of the same mapper, that of the other"
    assert result.mapper == "incremental" and result.counts["registered"] == len(scene) and result.sigma is None
    assert any("stays as the mapper made it" in c and "SIGSEGV" in c for c in result.remarks.contradictions)
    assert any("global mapping" in n and "SIGSEGV" in n for n in result.remarks.notes)
    ordered = "global mapping was requested, but its process ended: incremental mapping made the model"
    assert (ordered in result.remarks.contradictions) == (asked == "global")


def test_rules_of_auto(tmp_path: Path) -> None:
    _, scene = make_world(tmp_path / "database.db", cameras=2, frames=4)
    assert rig_modes(scene, "auto") == {0: "fixed"}
    assert rig_modes(scene, "refined") == {0: "refined"}
    assert rig_modes(without_extrinsics(scene), "refined") == {0: "derived"}
    assert rig_modes(scene, "absent") == {}
    asked = SparseSettings(mapper="incremental")
    with_rig, without = _job(scene, modes={0: "fixed"}), _job(scene)
    assert choose_mapper(with_rig) == "global" and choose_mapper(without) == "incremental"
    assert choose_mapper(replace(with_rig, settings=asked)) == "incremental"


@pytest.mark.slow
def test_positions_put_the_incremental_model_into_the_world(tmp_path: Path) -> None:
    """With priors the model comes out metric and in place; held-out positions, 100 m off here, have no part in it."""
    truth, scene = make_world(tmp_path / "database.db", cameras=1, frames=12)
    true = frame_centres(truth, scene)
    held = held_out_frames(with_positions(scene, true, 0.02), FixTuning())
    assert held.sum() == 2
    given = true + 0.02 * np.random.default_rng(0).standard_normal(true.shape) + 100 * held[:, None]
    result = _run(tmp_path, with_positions(scene, given, 0.02))
    assert result.mapper == "incremental" and result.tables["runs"]["rows"][0][2] == "positions"
    assert 0.001 < np.median(np.linalg.norm(frame_centres(result.load(), scene) - true, axis=1)) < 0.1


@pytest.mark.slow
def test_sections_mapped_apart_are_joined_and_adjusted_as_one(tmp_path: Path) -> None:
    truth, scene = make_world(tmp_path / "database.db", frames=16)
    late = scene.frame >= 8
    pairs = [(i, j) for i in range(len(scene)) for j in range(i + 1, len(scene)) if late[i] != late[j]]
    whole = _centre_error(_run(tmp_path, scene, covariance_frames=0), scene, truth)
    result = _run(tmp_path, scene, {"apart": tuple(pairs)}, covariance_frames=0)
    assert len(result.models) == 1 and result.counts["registered"] + result.counts["placed_by_rig"] == len(scene)
    table = result.tables["sections mapped separately"]
    first, second = (dict(zip(table["columns"], row)) for row in table["rows"])
    assert first["images"] + second["images"] == len(scene) and first["joined"] == second["joined"] == "yes"
    assert second["matches that agree"] > 1000 and second["held-out matches that agree %"] > 70
    assert 0 < second["halves differ"] < 0.2 and second["halves differ deg"] < 2
    assert 0 < whole < 0.05 and 0 < _centre_error(result, scene, truth) < 1.5 * whole + 1e-4
    assert any("2 sections were mapped separately and 2 of them joined" in note for note in result.remarks.notes)
    assert not any("no verified pair" in note for note in result.remarks.notes)


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
    assert said is not None and f"{2 * given_px:.0f} px, but {given_px:.0f} px are given" in said
    assert ran_off(_with_focal(truth, 1 / MOST - 0.01), scene, MOST) is not None
    camera.has_prior_focal_length = False
    guessed = scene.with_(rigs=(replace(rig, sensors=(replace(rig.sensors[0], camera=camera),)),))
    assert ran_off(_with_focal(truth, 2.0), guessed, MOST) is None


def _one_right(names: tuple[str, str], right: str, truth: pycolmap.Reconstruction, folder: Path) -> dict[str, Path]:
    """Folders of models by name: the right one, and one of which half of the frames slid."""
    wrong = pycolmap.Reconstruction(truth)
    for frame_id in range(1, 5):
        pose = wrong.frame(frame_id).rig_from_world
        wrong.frame(frame_id).rig_from_world = pycolmap.Rigid3d(pose.rotation, pose.translation + [0.5, 0.2, 0.4])
    return {name: _written(truth if name == right else wrong, folder / name) for name in names}


@pytest.mark.parametrize("right", ["incremental", "global"])
def test_a_small_survey_is_mapped_both_ways_and_the_matches_choose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, right: str
) -> None:
    """The incremental mapper may begin with the wrong one of two relative poses: here half of the frames slid."""
    truth, scene = make_world(tmp_path / "database.db", cameras=1, frames=8)
    made = _one_right(("incremental", "global"), right, truth, tmp_path)
    asked: list[str] = []

    def run(job: mapping.Job, mapper: str, label: str, seed: int = 0) -> mapping.Outcome:
        asked.append(mapper)
        return mapping.Outcome(mapper, [made[mapper]], len(scene))

    monkeypatch.setattr(mapping, "run_once", run)
    job = _job(scene)
    job = replace(job, source=replace(job.source, database=tmp_path / "database.db"))
    job = replace(job, graph=SimpleNamespace(components=[len(scene)]))
    for rough in (True, False):
        assert mapping._mapped(replace(job, source=replace(job.source, rough=rough)), "").mapper == right
    assert asked == ["incremental", "global"] * 2
    assert f"the {right} model is kept" in job.account.notes[-1]
    asked.clear()
    for how in ("incremental", "global"):
        ordered = replace(job, settings=SparseSettings(mapper=how))
        assert mapping._mapped(ordered, "").mapper == how
    assert asked == ["incremental", "global"]


def _job(scene: Scene, **more: Any) -> mapping.Job:
    nothing: Any = SimpleNamespace()
    given = {
        "source": mapping.Source(Path("none.db"), None), "out": Path(), "scene": scene, "settings": SparseSettings(),
        "tuning": Tuning(), "shared": nothing, "log": Path("log.txt"), "graph": nothing,
        "account": mapping.Account(), "modes": {},
    }  # fmt: skip
    return mapping.Job(**given | more)


def _written(model: pycolmap.Reconstruction, folder: Path) -> Path:
    folder.mkdir()
    model.write(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(("right", "doubt"), [("preview", True), ("global", True), ("preview", False)])
def test_a_start_that_contradicts_pairs_is_kept_where_it_explains_more_than_a_mapper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, right: str, doubt: bool
) -> None:
    """Repeats among the verified pairs contradict the right model too: a dimmed canal failed the test by 79 of 765."""
    truth, scene = make_world(tmp_path / "database.db", cameras=1, frames=8)
    made = _one_right(("preview", "global"), right, truth, tmp_path)

    def run(job: mapping.Job, mapper: str, label: str) -> mapping.Outcome:
        why = "it contradicts 79 of 765 verified pairs of images" if doubt and mapper == "preview" else ""
        return mapping.Outcome(mapper, [made[mapper]], len(scene), refused=why)

    monkeypatch.setattr(mapping, "run_once", run)
    monkeypatch.setattr(mapping, "_mapped", lambda job, label: run(job, "global", label))
    monkeypatch.setattr(mapping, "with_others", lambda job, outcome: outcome)
    job = _job(scene)
    job = replace(job, source=replace(job.source, database=tmp_path / "database.db", preview=np.eye(4)))
    job = replace(job, graph=SimpleNamespace(components=[len(scene)]), shared=SimpleNamespace(blocks=None))
    assert mapping.map_images(job).mapper == right
    assert any("could not start" in note for note in job.account.notes) == doubt
    assert any(f"the {right} model is kept" in note for note in job.account.notes) == doubt
