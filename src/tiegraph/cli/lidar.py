"""`tiegraph lidar SCANS -o FOLDER`: trajectory and map of a LiDAR, and a run beside them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tiegraph.cli.options import Talk, options_of
from tiegraph.cli.output import say, show_table
from tiegraph.lidar.settings import LidarSettings
from tiegraph.pipeline.lidar import MAP, RIG
from tiegraph.pipeline.lidar import lidar as make_reference
from tiegraph.project.verbtunings import read_tunings
from tiegraph.text import command


@dataclass(frozen=True, kw_only=True)
class _Lidar(Talk):
    """Trajectory and map of a LiDAR; with --run, where it stands on the rig, and the run against it."""

    scans: tyro.conf.Positional[Path]
    """A folder of scans (.bin, .pcd, .ply, .npz, .las, .laz), a ROS bag (BAG:TOPIC), or a Velodyne's .pcap."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The folder to write; new or empty."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.lidar] and [tuning.evaluate]."""
    settings: Annotated[LidarSettings, tyro.conf.arg(name="")] = LidarSettings()


def main(arguments: list[str]) -> int:
    """`tiegraph lidar`."""
    options = options_of(_Lidar, "tiegraph lidar", arguments)
    reporter = options.reporter()
    made = make_reference(options.scans, options.out, options.settings, reporter, read_tunings(options.tuning))
    reporter.event("lidar", out=options.out, **{k: v for k, v in made.items() if isinstance(v, (int, float))})
    if not options.json and not options.quiet:
        _show(made, options.out, options.settings)
    return 0


def _show(made: dict[str, Any], out: Path, settings: LidarSettings) -> None:
    say(f"{made['scans']} scans, {made['path_m']:.2f} m in {made['end_s'] - made['start_s']:.1f} s; "
        f"map: {made['map_points']} points; took {made['seconds']:.0f} s")  # fmt: skip
    for note in [*made["notes"], *made.get("run_notes", [])]:
        say(f"  {note}")
    for name, table in made["tables"].items():
        show_table(table["columns"], table["rows"], name, ".6g")
    say(f"written: {out}")
    if settings.run is not None:
        given = "--evaluate.reference", out / RIG, "--evaluate.reference-cloud", out / MAP
        say(f"into the report: {command('report', settings.run, *given)}")
