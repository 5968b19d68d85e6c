"""Glue of the LiDAR reference: scans -> trajectory and map -> beside a run.

What is made stands in a folder of its own; ``evaluate`` takes rig and map.laz from there as references of a run.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory
from tiegraph.evaluate.tuning import Tuning as EvaluateTuning
from tiegraph.geometry import transforms
from tiegraph.lidar.adjust import adjusted
from tiegraph.lidar.handeye import Given, Poses, rig_in_lidar_world
from tiegraph.lidar.odometry import MapCloud, before_pose, odometry
from tiegraph.lidar.scans import Reading, Recording, deskew, open_scans, velocities
from tiegraph.lidar.settings import LidarSettings
from tiegraph.lidar.tuning import Tuning
from tiegraph.pipeline.files import load_json
from tiegraph.pipeline.lidarrun import SurveyRun, calibrated, compared
from tiegraph.project.progress import Reporter
from tiegraph.project.stages import save_json
from tiegraph.project.verbtunings import VerbTunings
from tiegraph.scan.priors.trajectory import write_tum
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.results import Cloud
from tiegraph.text import finite

TRAJECTORY, MAP, RIG, SUMMARY = "trajectory.tum", "map.laz", "rig", "lidar.json"
_RPE_M = (1.0, 10.0, 100.0)


@dataclass(frozen=True)
class LidarPath:
    """The LiDAR's own result: times (T,) and world_from_lidar (T, 4, 4), its map, and what to say."""

    time_s: np.ndarray
    poses: np.ndarray
    map: Cloud
    seconds: float
    notes: tuple[str, ...]


def lidar(
    scans: Path,
    out: Path,
    settings: LidarSettings,
    reporter: Reporter | None = None,
    tunings: VerbTunings | None = None,
) -> dict[str, Any]:
    """Trajectory and map of a LiDAR into a folder, and a run beside them; returns what lidar.json holds.

    Raises InputError for scans, runs or folders that cannot be used, before anything is written.
    """
    reporter, tunings = reporter or Reporter("quiet"), tunings or VerbTunings()
    tuning = tunings.lidar
    if os.path.lexists(out) and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"-o {out}: is there already: give a new or an empty folder")
    beside = None if settings.run is None else SurveyRun.read(settings.run, tunings.scene.registered)
    given = _given(settings)
    how = Reading(columns=settings.columns, times=settings.times, rate_hz=settings.rate_hz, poses=settings.poses)
    recording = open_scans(scans, how, tuning.scan)
    path = _trajectory(recording, settings, tuning, reporter)
    summary: dict[str, Any] = {
        "scans": len(path.poses),
        "seconds": path.seconds,
        "start_s": path.time_s[0],
        "end_s": path.time_s[-1],
        "path_m": _length(path.poses),
        "map_points": len(path.map),
        "notes": list(path.notes),
        "tables": {},
        "tuning": tunings.changed(),
    }
    if recording.given is not None:
        summary["tables"]["against the given poses"] = _against_given(path.poses, recording.given, tunings.evaluate)
    found = None
    if beside is not None:
        with reporter.stage("hand-eye"):
            found = calibrated(beside, _poses(path), path.map, given, tuning)
        told = compared(beside, _poses(path), path.map, found, tunings)
        summary = {**summary, **told, "tables": {**summary["tables"], **told["tables"]}}
    out.mkdir(parents=True, exist_ok=True)
    write_tum(out / TRAJECTORY, path.time_s, path.poses)
    write_cloud(path.map, out / MAP, settings.voxel_m)
    if beside is not None and found is not None:
        _write_rig(out / RIG, beside, rig_in_lidar_world(_poses(path), beside.rig.time_s, found))
    save_json(out / SUMMARY, finite(summary))
    return summary


def _write_rig(folder: Path, run: SurveyRun, poses: np.ndarray) -> None:
    """Poses of the rig (F, 4, 4) by the LiDAR, one file a pass that it saw, as ``evaluate`` reads them."""
    folder.mkdir()
    for number, name in enumerate(run.scene.sequences):
        rows = np.flatnonzero((run.rig.group == number) & np.isfinite(poses[:, 0, 0]))
        if len(rows):
            write_tum(folder / f"{Path(name).name}.tum", run.rig.time_s[rows], poses[rows])


def _given(settings: LidarSettings) -> Given:
    if settings.place is None:
        return Given(None, settings.clock_s)
    try:
        told = load_json(settings.place)["hand_eye"]
        place, clock = np.array(told["rig_from_lidar"], float), float(told["clock_s"])
        if place.shape != (4, 4) or not np.isfinite(place).all():
            raise ValueError("no matrix of 4 x 4 numbers")
    except (InputError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"--place {settings.place}: no lidar.json with hand_eye.rig_from_lidar ({error})") from None
    return Given(place, clock if settings.clock_s is None else settings.clock_s)


# --- the LiDAR alone -------------------------------------------------------------------------------------------------


def _trajectory(recording: Recording, settings: LidarSettings, tuning: Tuning, reporter: Reporter) -> LidarPath:
    """The scans are gone through twice: for the poses, and for the map by the final ones."""
    start = time.monotonic()
    times = []
    with reporter.stage("odometry"):
        reporter.total(2 * (recording.count or 0))

        def told() -> Any:
            for scan in odometry(recording.read(), settings.near_m, settings.far_m, tuning):
                times.append(scan.time_s)
                reporter.advance()
                yield scan

        poses = np.array(list(adjusted(told(), tuning.adjust)) if settings.adjust else [s.pose for s in told()])
        time_s = np.array(times)
        cloud, lost = _map(recording, time_s, poses, settings, tuning, reporter)
    notes = [*recording.notes]
    if lost:
        notes.append(f"{lost} points at no place (NaN or 0) left out")
    usual = float(np.median(np.diff(time_s)))
    gaps = np.flatnonzero(np.diff(time_s) > tuning.scan.gap_intervals * usual)
    if len(gaps):
        notes.append(f"{len(gaps)} gaps between scans, the first of {np.diff(time_s)[gaps[0]]:.3g} s after "
                     f"{time_s[gaps[0]]:.3f} s: the motion across them was taken as constant")  # fmt: skip
    if cloud.voxel_m > settings.voxel_m:
        notes.append(f"the map's voxels grew to {cloud.voxel_m:.3g} m, to keep within memory")
    return LidarPath(
        time_s=time_s,
        poses=poses,
        map=cloud.cloud(),
        seconds=time.monotonic() - start,
        notes=tuple(notes),
    )


def _map(
    recording: Recording,
    time_s: np.ndarray,
    poses: np.ndarray,
    settings: LidarSettings,
    tuning: Tuning,
    reporter: Reporter,
) -> tuple[MapCloud, int]:
    cloud, lost = MapCloud(settings.voxel_m, tuning.map), 0
    for scan, pose, rate in zip(recording.read(), poses, velocities(time_s, poses)):
        reach = np.linalg.norm(scan.xyz_m, axis=1)
        seen = (reach >= settings.near_m) & (reach <= settings.far_m)
        _, before = before_pose(scan)
        xyz = deskew(scan.xyz_m[seen], None if before is None else before[seen], rate)
        cloud.add(transforms.apply(pose, xyz))
        lost += scan.lost
        reporter.advance()
    return cloud, lost


def _poses(path: LidarPath) -> Poses:
    return Poses(path.time_s, path.poses, np.zeros(len(path.poses), int))


def _length(poses: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())


def _against_given(poses: np.ndarray, given: np.ndarray, tuning: EvaluateTuning) -> dict[str, Any]:
    """The odometry against the poses that the scans came with: drift at the end in the frame of the first scan."""
    length = _length(given)
    moved = transforms.invert(poses[0]) @ poses[-1]
    true = transforms.invert(given[0]) @ given[-1]
    end = float(np.linalg.norm(moved[:3, 3] - true[:3, 3]))
    turn = float(transforms.angle_deg(moved[:3, :3], true[:3, :3]))
    rows: list[list[Any]] = [
        ["path [m]", length],
        ["drift at the end [m]", end],
        ["drift at the end [% of the path]", 100 * end / length if length else np.nan],
        ["turn at the end [deg]", turn],
    ]
    if len(poses) >= 3:
        group = np.zeros(len(poses), int)
        match = PoseMatch(estimate=poses, reference=given, group=group, order=np.arange(len(poses)))
        rows.append(["ATE after SE3 [m]", evaluate_trajectory(match, _RPE_M, tuning.trajectory).se3.rmse_m])
    return {"columns": ["LiDAR odometry", "against the given poses"], "rows": rows}
