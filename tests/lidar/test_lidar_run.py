"""A run beside the LiDAR: the place on the rig, errors by section, paper 001's rows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from lidar.lidar_world import START_S, turns, world_from_lidar
from tiegraph.geometry import transforms
from tiegraph.lidar.handeye import Given, Poses
from tiegraph.pipeline.lidar import SurveyRun, calibrated, compared
from tiegraph.project.verbtunings import VerbTunings
from tiegraph.scene.results import Cloud

_PLACE = transforms.rigid(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.1, 0.4, -0.6]))


@dataclass
class _Scene:
    """What is asked of a scene: two images a frame, two sections."""

    frames: int
    sequences: tuple[str, ...] = ("up",)
    section: np.ndarray = field(init=False)
    sequence: np.ndarray = field(init=False)
    frame: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.section = (np.arange(self.frames) >= self.frames // 2).astype(int)
        self.sequence = np.zeros(self.frames, int)
        self.frame = np.repeat(np.arange(self.frames), 2)

    def __len__(self) -> int:
        return 2 * self.frames


def _cloud(xyz: np.ndarray) -> Cloud:
    grey, missing = np.zeros((len(xyz), 3), np.uint8), np.full((len(xyz), 3), np.nan, np.float32)
    return Cloud(xyz, grey, missing, missing[:, 0], grey[:, 0])


@pytest.mark.slow
def test_a_run_beside_the_lidar() -> None:
    count, off_m = 12, 0.02
    time_s = START_S + 0.2 * np.arange(1, count + 1)
    rng = np.random.default_rng(3)
    rig = world_from_lidar(time_s) @ transforms.invert(_PLACE)
    rig[:, :3, 3] += rng.normal(0, 0.001, (count, 3))
    scans = START_S + np.arange(0, 3, 0.1)
    lidar = Poses(scans, world_from_lidar(scans), np.zeros(len(scans), int))
    hall = np.concatenate([_seen(t.xyz_m, t.offset_s, t.start_s) for t in turns(10, noise_m=0.005)])
    run = SurveyRun(
        scene=_Scene(count),  # type: ignore[arg-type]
        rig=Poses(time_s, rig, np.zeros(count, int)),
        frame=np.arange(count),
        used=np.arange(2 * count) != 3,
        points=hall[::7] + rng.normal(0, 0.005, hall[::7].shape),
        cloud=_cloud(hall[::5] + [0, 0, off_m]),
        seconds={"SfM": 60.0, "Overall processing": 90.0},
    )
    found = calibrated(run, lidar, _cloud(hall), Given())
    assert np.abs(found.rig_from_lidar[:3, 3] - _PLACE[:3, 3]).max() < 0.01
    assert abs(found.clock_s) < 0.005
    told = compared(run, lidar, _cloud(hall), found, VerbTunings())
    assert not any("one survey" in note for note in told["run_notes"])
    table = {row[0]: row[1:] for row in told["tables"]["survey"]["rows"]}
    assert told["tables"]["survey"]["columns"] == ["", "all", "section 0", "section 1"]
    assert table["The number of input images"] == [24, 12, 12]
    assert table["The number of used images"] == [23, 11, 12]
    assert table["SfM [s]"][0] == 60.0 and np.isnan(table["SfM [s]"][1])
    assert table["The number of points after MVS"][0] == sum(table["The number of points after MVS"][1:])
    assert all(0 < v < 0.01 for v in table["RMSE of positions against the LiDAR [m]"])
    assert all(abs(v - 1) < 0.01 for v in table["scale against the LiDAR"])
    assert 0 < table["cloud to the LiDAR's nearest point, median [m]"][0] < 3 * off_m
    assert all(abs(v) < off_m / 4 for v in table["cloud along the LiDAR's surfaces (M3C2), median [m]"])  # walls stay
    assert all(off_m / 4 < v < off_m for v in table["cloud along the LiDAR's surfaces (M3C2), spread [m]"])
    assert [row[:2] for row in told["tables"]["trajectory by section"]["rows"]] == [["0", 6], ["1", 6]]


@pytest.mark.slow
def test_another_survey_is_noticed() -> None:
    """The run's frames go another way than the LiDAR."""
    time_s, scans = START_S + 0.2 * np.arange(1, 13), START_S + np.arange(0, 3, 0.1)
    run = SurveyRun(
        scene=_Scene(12),  # type: ignore[arg-type]
        rig=Poses(time_s, world_from_lidar(START_S + 3 * (time_s[::-1] - START_S)), np.zeros(12, int)),
        frame=np.arange(12),
        used=np.ones(24, bool),
        points=np.zeros((0, 3)),
        cloud=None,
        seconds={},
    )
    lidar, reference = Poses(scans, world_from_lidar(scans), np.zeros(len(scans), int)), _cloud(np.ones((3, 3)))
    found = calibrated(run, lidar, reference, Given())
    assert found.tie is None
    assert any(
        "are these one survey" in note for note in compared(run, lidar, reference, found, VerbTunings())["run_notes"]
    )


def _seen(xyz: np.ndarray, offset_s: np.ndarray, start_s: float) -> np.ndarray:
    poses = world_from_lidar(start_s + offset_s)
    return np.einsum("nij,nj->ni", poses[:, :3, :3], xyz) + poses[:, :3, 3]
