"""Glue of the LiDAR reference: scans -> trajectory and map -> beside a run.

The results are in a folder of their own; ``evaluate`` takes rig and map.laz from there as references of a run.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.errors import InputError
from tiegraph.evaluate.clouds.judge import CloudJudgement, Question, judge_cloud
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.evaluate.reference import frame_parts, model_poses
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory, path_length
from tiegraph.evaluate.tuning import Tuning as EvaluateTuning
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity
from tiegraph.lidar.handeye import HandEye, Poses, hand_eye, lidar_from_run, rig_in_lidar_world, settled
from tiegraph.lidar.odometry import MapCloud, adjusted, before_pose, deskew, odometry, tie_by_points, velocities
from tiegraph.lidar.scans import Recording, open_scans
from tiegraph.lidar.settings import LidarSettings
from tiegraph.lidar.tuning import Tuning
from tiegraph.pipeline.files import load_json, load_model, load_scene, reading, world_origin
from tiegraph.project.folder import check_format, must_be_empty
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import VerbTunings
from tiegraph.project.stages import Receipts, save_json
from tiegraph.scene.atomic import scratch_folder
from tiegraph.scene.cloudchunks import Points, PointSource, points_of
from tiegraph.scene.cloudfile import read_cloud, write_cloud
from tiegraph.scene.colmapmodel import registration
from tiegraph.scene.posefile import write_tum
from tiegraph.scene.results import Cloud
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning
from tiegraph.text import command, finite

TRAJECTORY, MAP, RIG, SUMMARY = "trajectory.tum", "map.laz", "rig", "lidar.json"
_RPE_M = (1.0, 10.0, 100.0)
_HAND_EYE = ("rig_from_lidar", "clock_s", "scale", "place_sigma_m", "turn_sigma_deg", "clock_sigma_s", "scale_sigma",
             "left_open")  # fmt: skip
_STAGES = {  # rows of paper 001's tables 1 and 5, and the stages they add up
    "Mask processing": ("masks", "refine"),
    "SfM": ("preview", "candidates", "coarse", "network", "design", "features", "match", "sparse", "georef"),
    "MVS": ("dense", "cloud"),
}


@dataclass(frozen=True)
class SurveyRun:
    """Parts of a run for the comparison: its frames with a pose and a time, sorted by time, and their numbers; which
    images (N,) are registered; points (M, 3) of its model; its cloud, if it has one; seconds of paper 001's rows."""

    scene: Scene
    rig: Poses
    frame: np.ndarray
    used: np.ndarray
    points: np.ndarray
    cloud: Cloud | None
    seconds: dict[str, float]

    @classmethod
    def read(cls, folder: Path, tuning: RegisteredTuning) -> "SurveyRun":
        """Raises InputError for a folder without a model in the world, and for a run without times."""
        check_format(folder)
        world = folder / "sparse" / "world"
        if not (world / "cameras.bin").exists():
            raise InputError(f"--run {folder}: there is no model in {world}: run `{command('georef', folder)}` first")
        scene = load_scene(folder / "network" / "scene.json")
        model = load_model(world)
        rigs = model_poses(model, scene).world_from_rig
        placed = np.isfinite(rigs[:, 0, 0])
        timed = np.flatnonzero(placed & np.isfinite(scene.time_s))
        if not len(timed):
            raise InputError(
                f"--run {folder}: none of its {int(placed.sum())} placed frames has a time: run it with --times"
            )
        frame = timed[np.argsort(scene.time_s[timed], kind="stable")]
        path, receipts = folder / "cloud.laz", Receipts(folder)
        with reading(path):
            cloud = read_cloud(path, world_origin(folder)) if path.exists() else None
        told = {row: [receipts.read(s).get("seconds") for s in names] for row, names in _STAGES.items()}
        seconds = {row: float(sum(t for t in found if t)) for row, found in told.items() if any(found)}
        return cls(
            scene=scene,
            rig=Poses(scene.time_s[frame], rigs[frame], scene.sequence[frame]),
            frame=frame,
            used=registration(model, scene, tuning).registered,
            # Images in which a point is seen: with two, a wrong match is not noticed
            points=np.array([p.xyz for p in model.points3D.values() if p.track.length() >= 3]).reshape(-1, 3),
            cloud=cloud,
            seconds={**seconds, "Overall processing": sum(seconds.values())},
        )


def lidar(
    scans: Path,
    out: Path,
    settings: LidarSettings,
    reporter: Reporter | None = None,
    tunings: VerbTunings | None = None,
) -> dict[str, Any]:
    """Trajectory and map of a LiDAR into a folder, compared with a run; returns the content of lidar.json.

    Raises InputError for scans, runs or folders that cannot be used, before anything is written.
    """
    reporter, tunings = reporter or Reporter("quiet"), tunings or VerbTunings()
    tuning = tunings.lidar
    must_be_empty(out, "-o")
    beside = None if settings.run is None else SurveyRun.read(settings.run, tunings.scene.registered)
    given = _given(settings)
    recording = open_scans(scans, settings)
    start = time.monotonic()
    path, cloud, notes = _trajectory(recording, settings, tuning, reporter)
    summary: dict[str, Any] = {
        "scans": len(path.poses),
        "seconds": time.monotonic() - start,
        "start_s": path.time_s[0],
        "end_s": path.time_s[-1],
        "path_m": float(path_length(path.poses[:, :3, 3])[-1]),
        "map_points": len(cloud),
        "notes": notes,
        "tables": {},
        "tuning": tunings.changed(),
    }
    if recording.given is not None:
        summary["tables"]["against the given poses"] = _against_given(path.poses, recording.given, tunings.evaluate)
    found = None
    if beside is not None:
        with reporter.stage("hand-eye"):
            found = calibrated(beside, path, cloud, *given)
        told = compared(beside, path, cloud, found, tunings)
        summary = {**summary, **told, "tables": {**summary["tables"], **told["tables"]}}
    out.mkdir(parents=True, exist_ok=True)
    write_tum(out / TRAJECTORY, path.time_s, path.poses)
    write_cloud(cloud, out / MAP, settings.voxel_m)
    if beside is not None and found is not None:
        poses = rig_in_lidar_world(path, beside.rig.time_s, found)
        (out / RIG).mkdir()
        for number, name in enumerate(beside.scene.sequences):  # a file for each pass seen by the LiDAR
            rows = np.flatnonzero((beside.rig.group == number) & np.isfinite(poses[:, 0, 0]))
            if len(rows):
                write_tum(out / RIG / f"{Path(name).name}.tum", beside.rig.time_s[rows], poses[rows])
    save_json(out / SUMMARY, finite(summary))
    return summary


def _given(settings: LidarSettings) -> tuple[np.ndarray | None, float | None]:
    """rig_from_lidar (4, 4) and clock_s as the user says; None = to be estimated."""
    if settings.place is None:
        return None, settings.clock_s
    try:
        told = load_json(settings.place)["hand_eye"]
        place, clock = np.array(told["rig_from_lidar"], float), float(told["clock_s"])
        if place.shape != (4, 4) or not np.isfinite(place).all():
            raise ValueError("no matrix of 4 x 4 numbers")
    except (InputError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"--place {settings.place}: no lidar.json with hand_eye.rig_from_lidar ({error})") from None
    return place, clock if settings.clock_s is None else settings.clock_s


def _trajectory(
    recording: Recording, settings: LidarSettings, tuning: Tuning, reporter: Reporter
) -> tuple[Poses, Cloud, list[str]]:
    """The LiDAR's path, map and notes. The scans are read twice: for the poses, and for the map by the final ones."""
    times = []
    with reporter.stage("odometry"):
        reporter.total(2 * (recording.count or 0))

        def told() -> Any:
            for scan in odometry(recording.read(), settings.near_m, settings.far_m):
                times.append(scan.time_s)
                reporter.advance()
                yield scan

        poses = np.array(list(adjusted(told(), tuning.adjust)) if settings.adjust else [s.pose for s in told()])
        time_s = np.array(times)
        cloud, lost = _map(recording, time_s, poses, settings, reporter)
    notes = [*recording.notes]
    if lost:
        notes.append(f"{lost} points without coordinates (NaN or 0) left out")
    usual = float(np.median(np.diff(time_s)))
    gaps = np.flatnonzero(np.diff(time_s) > 5 * usual)
    if len(gaps):
        first = f"{np.diff(time_s)[gaps[0]]:.3g} s after {time_s[gaps[0]]:.3f} s"
        notes.append(
            f"{len(gaps)} gaps between scans, the first of {first}: the motion across them was taken as constant"
        )
    if cloud.voxel_m > settings.voxel_m:
        notes.append(f"the map's voxels grew to {cloud.voxel_m:.3g} m, to keep within memory")
    return Poses(time_s, poses, np.zeros(len(poses), int)), cloud.cloud(), notes


def _map(
    recording: Recording, time_s: np.ndarray, poses: np.ndarray, settings: LidarSettings, reporter: Reporter
) -> tuple[MapCloud, int]:
    cloud, lost = MapCloud(settings.voxel_m), 0
    for scan, pose, rate in zip(recording.read(), poses, velocities(time_s, poses)):
        reach = np.linalg.norm(scan.xyz_m, axis=1)
        seen = (reach >= settings.near_m) & (reach <= settings.far_m)
        _, before = before_pose(scan)
        xyz = deskew(scan.xyz_m[seen], None if before is None else before[seen], rate)
        cloud.add(transforms.apply(pose, xyz))
        lost += scan.lost
        reporter.advance()
    return cloud, lost


def _against_given(poses: np.ndarray, given: np.ndarray, tuning: EvaluateTuning) -> dict[str, Any]:
    """The odometry against the poses that came with the scans: drift at the end in the frame of the first scan."""
    length = float(path_length(given[:, :3, 3])[-1])
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
        match = PoseMatch(poses, given, group=np.zeros(len(poses), int), order=np.arange(len(poses)))
        rows.append(["ATE after SE3 [m]", evaluate_trajectory(match, _RPE_M, tuning.trajectory).se3.rmse_m])
    return {"columns": ["LiDAR odometry", "against the given poses"], "rows": rows}


def calibrated(
    run: SurveyRun,
    lidar: Poses,
    reference: Cloud,
    rig_from_lidar: np.ndarray | None = None,
    clock_s: float | None = None,
) -> HandEye:
    """The LiDAR on the rig: by the two trajectories, then by the points that both sides have of one surface."""
    found = hand_eye(run.rig, lidar, rig_from_lidar, clock_s)
    if rig_from_lidar is not None:
        return found
    by_lidar = rig_in_lidar_world(lidar, run.rig.time_s, found)
    inside = np.isfinite(by_lidar[:, 0, 0])
    start = lidar_from_run(run.rig.where(inside), by_lidar[inside], found.scale)
    tie = tie_by_points(run.points, reference.xyz_m, start)
    return found if tie is None else settled(run.rig, lidar, found, tie)


def compared(run: SurveyRun, lidar: Poses, reference: Cloud, found: HandEye, tunings: VerbTunings) -> dict[str, Any]:
    """The content of lidar.json for a run: tables, hand-eye calibration, notes."""
    by_lidar = rig_in_lidar_world(lidar, run.rig.time_s, found)
    inside = np.flatnonzero(np.isfinite(by_lidar[:, 0, 0]))
    rig, frame, by_lidar = run.rig.where(inside), run.frame[inside], by_lidar[inside]
    world = found.tie.lidar_from_run if found.tie else lidar_from_run(rig, by_lidar, found.scale)
    estimate = rig.poses.copy()
    estimate[:, :3, 3] = world(rig.poses[:, :3, 3])
    estimate[:, :3, :3] = world.rotation @ rig.poses[:, :3, :3]
    match = PoseMatch(estimate, by_lidar, rig.group, order=np.arange(len(frame)), parts=frame_parts(run.scene, frame))
    error = evaluate_trajectory(match, _RPE_M, tunings.evaluate.trajectory)
    judged = _Judged(run, world, reference, match, run.scene.section[frame], tunings.evaluate)
    seconds = {f"{row} [s]": value for row, value in run.seconds.items()}
    columns = {"all": {**seconds, **judged.column(None)}}
    sections = np.unique(run.scene.section[run.scene.section >= 0])
    columns |= {f"section {s}": judged.column(int(s)) for s in sections if len(sections) > 1}
    rows = [[row, *(column.get(row, np.nan) for column in columns.values())] for row in columns["all"]]
    known = [row for row in rows if any(np.isfinite(v) for v in row[1:])]
    survey = {"columns": ["", *columns], "rows": known}
    tables = {"hand-eye": _hand_eye_table(found), "survey": survey, **error.tables(), **judged.tables}
    notes = [f"not determined by the motion, and not to be used: {what}" for what in found.left_open]
    if found.fit.turn_rms_deg > 1.0:
        off = f"the rotations of rig and LiDAR differ by {found.fit.turn_rms_deg:.2g} degrees RMS"
        notes.insert(0, f"{off}: are these one survey, and are the times right? Do not use the values below until then")
    if found.tie is not None:
        points, rms_mm = found.tie.points, 1000 * found.tie.rms_m
        tied = f"{points} points of the run within {rms_mm:.0f} mm RMS of the LiDAR's surfaces"
        notes.append(f"the LiDAR's position on the rig by {tied}; by the motion alone it would be less accurate")
    if run.cloud is None:
        notes.append("the run has no cloud.laz: trajectories only were compared")
    return {
        "hand_eye": {
            **{name: getattr(found, name) for name in _HAND_EYE},
            "frames": int(found.fit.frames.sum()),
            "turn_rms_deg": found.fit.turn_rms_deg,
            "step_rms_m": found.fit.step_rms_m,
            "tied_points": 0 if found.tie is None else found.tie.points,
        },
        "lidar_from_run": world.matrix,
        "metrics": {m.name: m.value for m in error.metrics()},
        "tables": tables,
        "run_notes": notes,
    }


def _hand_eye_table(found: HandEye) -> dict[str, Any]:
    place = found.rig_from_lidar[:3, 3]
    rows = [["clock offset [s]", found.clock_s, found.clock_sigma_s]]
    rows += [[f"lever arm {a} [m]", v, s] for a, v, s in zip("xyz", place, found.place_sigma_m)]
    rows += [[f"turn about {a} [deg]", np.nan, s] for a, s in zip("xyz", found.turn_sigma_deg)]
    rows.append(["scale", found.scale, found.scale_sigma])
    return {"columns": ["LiDAR on the rig", "value", "sigma"], "rows": rows}


class _Judged:
    """The whole survey or a section of it beside the LiDAR."""

    def __init__(
        self,
        run: SurveyRun,
        world: Similarity,
        reference: Cloud,
        match: PoseMatch,
        sections: np.ndarray,
        tuning: EvaluateTuning,
    ) -> None:
        self.run, self.world, self.match, self.sections, self.tuning = run, world, match, sections, tuning
        centres, section = world(run.rig.poses[:, :3, 3]), run.scene.section[run.frame]
        xyz = np.zeros((0, 3)) if run.cloud is None else world(run.cloud.xyz_m)
        nearest = cKDTree(centres)
        self.of_point = section[nearest.query(xyz)[1]]
        cameras = Cameras(centres, tuple(map(str, section)))
        self.cloud: CloudJudgement | None = None
        if run.cloud is not None:  # both in the LiDAR's world
            own = points_of(xyz, "the run's cloud")
            truth = PointSource("the LiDAR's map", lambda: iter([Points(reference.xyz_m, reference.sigma_m)]))
            with scratch_folder() as scratch:
                self.cloud = judge_cloud(own, truth, scratch, Question(cameras=cameras), tuning)
        self.of_core = None if self.cloud is None else section[nearest.query(self.cloud.differences.xyz)[1]]
        self.tables: dict[str, Any] = {} if self.cloud is None else self.cloud.tables()

    def column(self, section: int | None) -> dict[str, float]:
        """The rows of paper 001's tables 1 and 3 to 5 of the whole survey or a section of it. The cloud is compared
        along the normals of the LiDAR's map, and by the distances to its nearest points."""
        scene = self.run.scene
        images = np.ones(len(scene), bool) if section is None else scene.section[scene.frame] == section
        rows = np.flatnonzero(np.ones(len(self.match), bool) if section is None else self.sections == section)
        enough = len(rows) >= 3
        error = evaluate_trajectory(self.match.where(rows), _RPE_M, self.tuning.trajectory) if enough else None
        out = {
            "The number of input images": int(images.sum()),
            "The number of used images": int(self.run.used[images].sum()),
            "The number of points after MVS": 0,
            "RMSE of positions against the LiDAR [m]": error.se3.rmse_m if error else np.nan,
            "frames with a pose of the LiDAR": len(rows),
            "scale against the LiDAR": error.sim3.alignment.scale * self.world.scale if error else np.nan,
        }
        if self.cloud is not None:
            nearest, differences = self.cloud.nearest, self.cloud.differences
            judged = nearest.whole if section is None else nearest.sections.get(str(section))
            inside = np.ones(len(self.of_point), bool) if section is None else self.of_point == section
            out["The number of points after MVS"] = int(inside.sum())
            cores = np.arange(len(differences)) if section is None else np.flatnonzero(self.of_core == section)
            along = differences.where(cores).summary()
            for what in ("median", "spread"):
                out[f"cloud along the LiDAR's surfaces (M3C2), {what} [m]"] = along.get(f"{what} m", np.nan)
            if judged is not None:
                out["cloud to the LiDAR's nearest point, median [m]"] = judged.median_m
                out["cloud to the LiDAR's nearest point, 90 % [m]"] = judged.p90_m
        return out
