"""A large survey mapped in blocks, and what nothing ties to the first model."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from road_worlds import moving_world, write_database
from sfm_worlds import drop_pairs, run_sparse

from near import assert_reconstruction_near
from tiegraph.scene.colmapdatabase import image_ids
from tiegraph.scene.colmapmodel import MAX_IMAGES, image_poses
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import BlocksTuning
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.run import write_working_copy


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, Scene, Path]:
    model, scene = moving_world(frames=24, points=1500)
    write_database(model, path := tmp_path_factory.mktemp("known") / "database.db")
    return image_poses(model, scene), scene, path


@pytest.fixture
def world(known, tmp_path: Path) -> tuple[np.ndarray, Scene]:
    true, scene, path = known
    shutil.copy(path, tmp_path / "database.db")
    return true, scene


def test_a_working_copy_of_some_images_holds_nothing_else(world, tmp_path: Path) -> None:
    _, scene = world
    some = np.flatnonzero(scene.frame < 3)
    write_working_copy(tmp_path / "database.db", tmp_path / "part.db", scene, {0: scene.rigs[0]}, None, (), some)
    with sqlite3.connect(tmp_path / "part.db") as copy:
        names = {name for (name,) in copy.execute("SELECT name FROM images")}
        ends = {k for (p,) in copy.execute("SELECT pair_id FROM two_view_geometries") for k in divmod(p, MAX_IMAGES)}
        frames = copy.execute("SELECT COUNT(*) FROM frames").fetchone()[0]
        ids = {k for (k,) in copy.execute("SELECT image_id FROM images")}
    assert names == {scene.names[k] for k in some} and frames == 3 and ends == ids


@pytest.mark.slow
def test_blocks_make_one_model(world, tmp_path: Path) -> None:
    true, scene = world
    shared = SceneTuning(blocks=BlocksTuning(whole=30, own=40, least=6, lent=18, unplaced=1))
    result = run_sparse(tmp_path, scene, shared=shared, covariance_frames=0)
    assert result.mapper == "preview" and result.counts["registered"] == len(scene) and result.counts["models"] == 1
    assert any("mapped in 2 blocks" in n and "1 of 1 joins" in n for n in result.remarks.notes)
    assert_reconstruction_near(result.load(), scene, true, m=0.006, deg=0.05)
    assert not (tmp_path / "sparse" / ".run").exists()


def _cut(folder: Path, scene: Scene, frame: int) -> None:
    """No verified pair between the frames before and from ``frame`` on."""
    late = {number for k, number in image_ids(folder / "database.db", scene).items() if scene.frame[k] >= frame}
    drop_pairs(folder / "database.db", lambda *pair: len({*pair} & late) == 1)


@pytest.mark.slow
def test_two_surveys_in_one_folder_by_the_default_mapper(tmp_path: Path) -> None:
    """The mapper makes two models by itself; that they are two surveys, and which images, is said."""
    model, scene = moving_world(frames=12, points=1000)
    write_database(model, tmp_path / "database.db")
    _cut(tmp_path, scene, 7)
    result = run_sparse(tmp_path, scene, covariance_frames=0)
    assert result.mapper == "global" and result.components == (21, 15)
    assert [len(m.images) for m in result.models] == [21, 15]
    (said,) = (n for n in result.remarks.notes if "another survey" in n)
    assert said.startswith("15 images (cam0/007.jpg .. cam2/011.jpg) have no verified pair")
    assert "mapped separately" in said and len(result.tables["runs"]["rows"]) == 1
    assert result.tables["models"]["rows"][1][1] == 15
    assert len(result.remarks.dropped) == 15, "nothing is lost without a word"
    assert all(why.startswith("in model 1, not joined to the first") for _, why in result.remarks.dropped)
    true = image_poses(model, scene)
    for made, there in zip(result.models, (scene.frame < 7, scene.frame >= 7), strict=True):
        images = np.flatnonzero(there)  # the second: 5 frames, free lenses
        assert_reconstruction_near(pycolmap.Reconstruction(made.folder), scene, true, m=0.2, deg=2.0, images=images)


@pytest.mark.slow
def test_two_surveys_in_one_folder_become_two_models(world, tmp_path: Path) -> None:
    """The coarse model puts them side by side, but no verified pair ties them."""
    true, scene = world
    _cut(tmp_path, scene, 18)
    result = run_sparse(tmp_path, scene, {"preview": true}, covariance_frames=0)
    assert result.mapper == "preview" and [len(m.images) for m in result.models] == [54, 18]
    assert any("18 images" in n and "another survey" in n for n in result.remarks.notes)
    assert len(result.remarks.dropped) == 18
    assert {why for _, why in result.remarks.dropped} == {"in model 1, not joined to the first"}
    for made, there in zip(result.models, (scene.frame < 18, scene.frame >= 18), strict=True):
        images = np.flatnonzero(there)
        assert_reconstruction_near(pycolmap.Reconstruction(made.folder), scene, true, m=0.01, deg=0.15, images=images)
