"""The simulation of surveys of many images: blocks held at their joints, and the stages without pixels."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.scale import stages
from benchmarks.scale.hierarchy import frame_places, measured
from benchmarks.scale.joints import adjusted_joints, bent, pieces_of
from benchmarks.scale.loop import loop
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.scene.blocks import Block, Poses, join_models, moved
from tiegraph.scene.tuning import JoiningTuning

FRAMES, OWN, LENT = 800, 200, 15


def _bent_block(poses: np.ndarray, first: int, rng: np.random.Generator) -> tuple[Block, Poses]:
    """Some frames of the way, bent to one side and stretched from end to end, in a frame and unit of its own."""
    frames = np.arange(first - LENT, first + OWN + LENT) % FRAMES
    images = (2 * frames[:, None] + (0, 1)).ravel()
    pose = poses[images]
    along = np.repeat(np.arange(len(frames)) / len(frames), 2)
    turn = Rotation.from_rotvec(along[:, None] * np.radians((0.0, 0.0, 0.8))).as_matrix()
    steps = np.diff(transforms.centre(pose), axis=0, prepend=transforms.centre(pose[:1]))
    centre = np.cumsum(np.einsum("kab,kb->ka", turn, steps) * (1 + 0.002 * along[:, None]), axis=0)
    rotation = pose[:, :3, :3] @ np.swapaxes(turn, 1, 2)
    made = transforms.rigid(rotation, -np.einsum("kab,kb->ka", rotation, centre))
    own = Similarity(float(rng.uniform(0.5, 2)), Rotation.random(rng=rng).as_matrix(), rng.normal(0, 20, 3))
    order = np.argsort(images)
    mine = np.repeat((np.arange(len(frames)) >= LENT) & (np.arange(len(frames)) < LENT + OWN), 2)
    return Block(images[order], mine[order]), Poses(images[order], moved(made, own)[order], 15.0 * own.scale)


@pytest.mark.slow
def test_bent_blocks_are_held_by_positions_at_their_seams() -> None:
    world, rng = loop(FRAMES), np.random.default_rng(1)
    blocks, models = zip(*(_bent_block(world.cam_from_world, k, rng) for k in range(0, FRAMES, OWN)))
    joined = join_models(models, JoiningTuning())
    assert all(j.holds for j in joined.joins) and len(joined.joins) == len(blocks)
    truth, positions = world.frames(), np.array(world.scene.world_from_rig[:, :3, 3])
    outage = ~np.isfinite(positions).all(axis=1)
    assert outage.sum() == 199
    chain, _ = frame_places(world, blocks, models, joined.world_from)
    whole = umeyama(chain[~outage], positions[~outage])
    turned = [
        Similarity(whole.scale * s.scale, whole.rotation @ s.rotation, whole(s.translation[None])[0])
        for s in joined.world_from
    ]
    placed = adjusted_joints(models, joined.joins, turned, positions, 0.03)
    rigid, _ = frame_places(world, blocks, models, placed.world_from)
    found = bent(pieces_of(blocks, models, placed.world_from), positions, 0.03)
    before, after = (np.linalg.norm(x - truth, axis=1) for x in (rigid, found.places))
    assert 0.05 < np.sqrt(np.mean(before**2)) < 0.5  # as bent as the blocks are
    assert np.sqrt(np.mean(after[~outage] ** 2)) < 0.03 and np.sqrt(np.mean(after[outage] ** 2)) < 0.1
    assert np.median(found.sigma[outage]) > 3 * np.median(found.sigma[~outage])


@pytest.mark.slow
def test_a_closed_way_by_the_houses_own_adjustment() -> None:
    found = measured(700, 0)
    assert found["blocks"] == found["held"] == 4 and found["parts"] == 1
    assert 0.05 < found["inside_m"]["median"] < 0.4
    assert found["pieces placed"]["rms_m"] < 0.05 and found["pieces placed"]["outage_rms_m"] < 0.5
    assert 0.4 < found["pieces placed"]["outage_over_sigma"] < 2.5


@pytest.mark.slow
def test_every_stage_runs_without_pixels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    start = subprocess.run

    def run(command: list[str], **how: Any) -> subprocess.CompletedProcess:
        """The last stage in a process of its own, as all are for their memory; the others here, where all is loaded."""
        if stages.__name__ not in command or "plan" in command:
            return start(command, **how)
        return subprocess.CompletedProcess(command, stages.main(command[3:]))

    monkeypatch.setattr(subprocess, "run", run)
    assert stages.main(["--images", "48", "--folder", str(tmp_path), "-o", str(tmp_path / "found.json")]) == 0
    rows = {row["stage"]: row for row in json.loads((tmp_path / "found.json").read_text())["runs"]}
    assert list(rows) == list(stages.STAGES) and rows["scan"]["counts"]["images"] == 48
    assert rows["coarse"]["counts"]["images"] == 48 and rows["candidates"]["apart"]["previews"]["calls"] > 500
    assert 0 < rows["plan"]["counts"]["pairs"] == rows["design"]["counts"]["pairs"]
    assert rows["plan"]["judged"]["precision"] > 0.5
    assert "| coarse |" in capsys.readouterr().out
