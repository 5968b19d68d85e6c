"""Verbs beside the pipeline that work on recordings: `shots`, `stations`, `calibrate`, `plan`, `lidar`, `odometry`."""

import json as json_text
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tiegraph.api import open_project
from tiegraph.calibrate.settings import CalibrateSettings
from tiegraph.cli.options import Talk
from tiegraph.cli.output import say, show_table
from tiegraph.cli.run import Survey
from tiegraph.lidar.settings import LidarSettings
from tiegraph.plan.request import PlanRequest
from tiegraph.project.settings import read_tunings
from tiegraph.scene.atomic import scratch_folder
from tiegraph.text import command


@dataclass(frozen=True, kw_only=True)
class Shots(Survey):
    """One point cloud for every shot of a calibrated rig, without a sparse model (shots/*.ply). The rig file, or the
    run that --rig names, has the intrinsics and the place of every camera."""

    images: tyro.conf.Positional[Path]
    """The folder that holds the images, one folder a camera."""
    near: float | None = None
    """Nearest distance of the object in metres (default: 5 times the longest baseline)."""
    far: float | None = None
    """Farthest distance of the object in metres (default: 100 times the longest baseline)."""
    posed: Path | None = None
    """A new folder for the clouds as LAZ in the world, with sigma, views and CRS: needs the poses of `tiegraph run`
    over the same images and run folder."""
    preset: str | None = None
    """A named way of working; close-range keeps the full resolution."""

    def run(self) -> int:
        how = {"preset": self.preset, "pool": self.pool, "unset": self.unset}
        project = open_project(self.images, self.out, rig=self.rig, **how)
        reporter = self.reporter()
        made = project.shots(self.near, self.far, reporter)
        reporter.say(f"{len(made)} clouds: {project.folder / 'shots'}")
        if self.posed is not None:
            posed = project.posed_shots(self.posed, reporter)
            reporter.say(f"{len(posed)} of {len(made)} clouds in the world: {self.posed}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Stations(Talk):
    """Clouds of single shots, without poses, put into one frame and merged to one filtered cloud."""

    shots: tyro.conf.Positional[tuple[Path, ...]]
    """A folder of clouds, the run folder of `tiegraph shots`, or files (.ply, .las, .laz)."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The new folder for cloud.laz, stations.tum and stations.json."""
    poses: Path | None = None
    """Prior poses (TUM) to start from, and whose frame is kept; the time is the last number in a cloud's name, or its
    place in the order."""
    voxel_m: float = 0.0
    """Spacing of the cloud in metres; 0 = that of the shots."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.stations] and [tuning.cloud]."""

    def run(self) -> int:
        from tiegraph.pipeline.shots import stations

        reporter, tunings = self.reporter(), read_tunings(self.tuning)
        made = stations(self.shots, self.out, self.poses, self.voxel_m, reporter, tunings)
        joined = sum(c["joined"] for c in made["clouds"])
        reporter.event("stations", out=self.out, joined=joined, clouds=len(made["clouds"]))
        if not self.json and not self.quiet:
            _show_stations(made, joined, self.out)
        return 0


def _show_stations(made: dict[str, Any], joined: int, out: Path) -> None:
    clouds = made["clouds"]
    rows = [[c["name"], str(c["pairs"]), _mm(c["sigma_m"]), c["why_not"]] for c in clouds]
    show_table(["cloud", "pairs", "sigma [mm]", "left out because"], rows, "stations")
    pairs = [
        [p["first"], p["second"], f"{p['overlap']:.0%}", *map(_mm, (p["residual_m"], p["sigma_m"])),
         f"{_mm(p['loop_before_m'])} -> {_mm(p['loop_after_m'])}"]
        for p in made["pairs"] if p["believed"]
    ]  # fmt: skip
    show_table(["cloud", "on", "overlap", "residual [mm]", "sigma [mm]", "loop [mm]"], pairs, "pairs")
    bands = [
        [f"{b['from_m']:.2f} - {b['to_m']:.2f}", str(b["points"]), _mm(b["sigma_m"]), _mm(b["stated_m"])]
        for b in made["precision"]
    ]
    if bands:
        show_table(["distance [m]", "points", "measured sigma [mm]", "stated [mm]"], bands, "precision by distance")
    say(f"{joined} of {len(clouds)} clouds in one frame ({made['frame']}); {made['cloud']['points']} points")
    for note in made["notes"]:
        say(note)
    say(f"written: {out}")


def _mm(value: float | None) -> str:
    return "" if value is None else f"{1000 * value:.3g}"


@dataclass(frozen=True, kw_only=True)
class Calibrate(Talk):
    """Calibrate a camera, or the cameras of a rig, by images of a board; --rig reads what it writes."""

    images: tyro.conf.Positional[Path]
    """The folder that holds the images, one folder a camera; equal names = one instant."""
    board: str
    """charuco:7x5:0.04:0.03:DICT_5X5_1000 (squares across x down, side of a square and of a marker in metres,
    dictionary), checker:9x6:0.025 (inner corners, side of a square), or Kalibr's aprilgrid.yaml."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("rig.toml")
    """The rig file to write, with a folder of its name beside it; neither may be there."""
    tuning: Path | None = None
    """A file with other constants: the table [tuning.scan]."""
    pool: str = "local"
    """Where corners are looked for: serial, local, local:<workers>."""
    settings: Annotated[CalibrateSettings, tyro.conf.arg(name="")] = CalibrateSettings()

    def run(self) -> int:
        from tiegraph.pipeline.calibrate import calibrate

        reporter, tunings = self.reporter(), read_tunings(self.tuning)
        verdict = calibrate(self.images, self.board, self.out, self.settings, self.pool, reporter, tunings)
        reporter.event("calibrated", rig=self.out, advice=verdict.advice)
        return 0


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What images at given distances give, and what a whole path is expected to give, before anyone goes there."""

    request: Annotated[PlanRequest, tyro.conf.arg(name=""), tyro.conf.OmitArgPrefixes] = PlanRequest()
    tuning: Path | None = None
    """A file with other constants: tables [tuning.scan] and [tuning.sfm]."""
    json: bool = False
    """One JSON object on standard output instead of tables."""

    def run(self) -> int:
        from tiegraph.pipeline.plan import compare, plan
        from tiegraph.plan.planner import path_tables, station_table

        output = self.request.output
        if output.compare is not None:
            table = compare(output.compare, output.planned)
            tables, texts = [table], [table.sentence]
            data = {"columns": table.columns, "rows": table.rows, "sentence": table.sentence}
        else:
            made = plan(self.request, read_tunings(self.tuning))
            tables, data = [station_table(made.stations)], made.to_dict()
            if made.path is not None and made.effort is not None:
                tables += path_tables(made.path, made.effort)
            written = [] if output.out is None else [f"written: {output.out}"]
            texts = [*(made.path.worst if made.path else ()), *made.advice, *written]
        if self.json:
            say(json_text.dumps(data, indent=1))
            return 0
        for table in tables:
            show_table(table.columns, table.rows, table.title)
        for text in texts:
            say(text)
        return 0


@dataclass(frozen=True, kw_only=True)
class Lidar(Talk):
    """Trajectory and map of a LiDAR; with --run, where it stands on the rig, and the run against it."""

    scans: tyro.conf.Positional[Path]
    """A folder of scans (.bin, .pcd, .ply, .npz, .las, .laz), a ROS bag (BAG:TOPIC), or a Velodyne's .pcap."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The folder to write; new or empty."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.lidar] and [tuning.evaluate]."""
    settings: Annotated[LidarSettings, tyro.conf.arg(name="")] = LidarSettings()

    def run(self) -> int:
        from tiegraph.pipeline.lidar import MAP, RIG, lidar

        reporter = self.reporter()
        made = lidar(self.scans, self.out, self.settings, reporter, read_tunings(self.tuning))
        reporter.event("lidar", out=self.out, **{k: v for k, v in made.items() if isinstance(v, (int, float))})
        if self.json or self.quiet:
            return 0
        say(f"{made['scans']} scans, {made['path_m']:.2f} m in {made['end_s'] - made['start_s']:.1f} s; "
            f"map: {made['map_points']} points; took {made['seconds']:.0f} s")  # fmt: skip
        for note in [*made["notes"], *made.get("run_notes", [])]:
            say(f"  {note}")
        for name, table in made["tables"].items():
            show_table(table["columns"], table["rows"], name, ".6g")
        say(f"written: {self.out}")
        if self.settings.run is not None:
            given = "--evaluate.reference", self.out / RIG, "--evaluate.reference-cloud", self.out / MAP
            say(f"into the report: {command('report', self.settings.run, *given)}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Odometry(Talk):
    """The path of a stereo camera, a rig or a single camera, frame after frame; --trajectory reads what it writes."""

    images: tyro.conf.Positional[Path]
    """The folder that holds the images, in any of the layouts of `tiegraph run`, videos or ROS bags."""
    rig: str | None = None
    """The calibrated rig: a rig.toml, COLMAP's rig_config.json, or the folder of another run."""
    camera: str | None = None
    """The calibration of a single camera, as for `tiegraph run`."""
    masks: Path | None = None
    """Folder of masks (0 = ignore), as --masks.folder of `tiegraph run`."""
    times: Path | None = None
    """CSV of the frames' times, where the images have none: pass, frame, time (or image, time)."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("vo.tum")
    """The TUM file to write, and beside it a CSV of its name with segments and sigmas; of several passes a folder of
    this name without suffix. Nothing of that may be there."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.odometry] and [tuning.scan]."""
    pool: str = "local"
    """Where images are checked: serial, local, local:<workers>."""

    def run(self) -> int:
        reporter = self.reporter()
        settings = {"tuning": read_tunings(self.tuning).of_stages()}
        if self.masks is not None:
            settings["masks"] = {"source": "folder", "folder": self.masks.absolute()}
        given = {"rig": self.rig, "camera": self.camera, "times": self.times}
        with scratch_folder() as folder:
            project = open_project(self.images, folder / "run", pool=self.pool, settings=settings, **given)
            made = project.odometry(self.out, reporter)
        for one in made:
            for text in (*one.said, str(one.tum)):
                reporter.say(text)
            reporter.event("odometry", trajectory=one.tum, said=one.said, frames_per_s=round(one.frames_per_s, 2))
        return 0
