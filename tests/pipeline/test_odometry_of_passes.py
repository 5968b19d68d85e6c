"""Passes whose trajectories stand in worlds of their own, with pairs from poses alone, end in one model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tiegraph
import worlds
from tiegraph.evaluate.reference import model_poses
from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.posefile import write_tum

_MOVED = transforms.rigid(Rotation.from_rotvec([0.1, -0.2, 2.1]).as_matrix(), np.array([400.0, -90.0, 12.0]))


def odometry_of(made: worlds.Survey, folder: Path, own_start: bool) -> Path:
    """A TUM file of each pass: from the pose of its first frame on, or (``own_start`` false) the second in a frame that
    nothing tells."""
    folder.mkdir()
    for name in ("up", "down"):
        keys = sorted(key for key in made.world_from_rig if key.startswith(f"{name}/"))
        poses = np.array([made.world_from_rig[key] for key in keys])
        moved = transforms.invert(poses[:1])[0] if own_start else {"up": np.eye(4), "down": _MOVED}[name]
        write_tum(folder / f"vo_{name}.tum", np.array([made.times_s[key] for key in keys]), moved @ poses)
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> worlds.Survey:
    return worlds.make_survey(tmp_path_factory.mktemp("survey") / "images", frames=4)


@pytest.mark.slow
@pytest.mark.usefixtures("children_are_functions")
@pytest.mark.parametrize("own_start", [True, False])
def test_two_passes_with_odometry_of_their_own_end_in_one_model(
    own_start: bool, made: worlds.Survey, tmp_path: Path
) -> None:
    write_rig_toml(made.rig, tmp_path / "rig.toml")
    given = {
        "rig": tmp_path / "rig.toml",
        "times": worlds.write_times(made, tmp_path / "times.csv"),
        "trajectory": odometry_of(made, tmp_path / "vo", own_start),
    }
    settings = {"masks": {"source": "none"}, "candidates": {"sources": ["poses"]}}
    project = tiegraph.open(made.images, tmp_path / "out", pool="serial", settings=settings, **given).run("georef")
    scene = project.scene()
    assert scene.prior == "odometry", "no pass is placed by what holds for another"
    notes = " ".join(dict((name, receipt) for name, _, receipt in project.status())["candidates"]["notes"])
    assert "2 passes have poses in worlds of their own" in notes
    assert ("do not stand in one world" in notes) == (not own_start)
    poses = model_poses(project.model(), scene)
    assert poses.placed.all() and len(scene) == 16
    truth = made.centres_m(list(scene.names))
    fit = umeyama(poses.centres(), truth)
    assert 1e-5 < np.sqrt(np.mean(np.sum((fit(poses.centres()) - truth) ** 2, axis=1))) < 0.03
