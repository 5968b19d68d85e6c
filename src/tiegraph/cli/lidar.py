"""`tiegraph lidar SCANS -o FOLDER`: trajectory and map of a LiDAR, and a run beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.lidar.settings import LidarSettings
from tiegraph.pipeline.lidar import MAP, RIG
from tiegraph.pipeline.lidar import lidar as make_reference
from tiegraph.project.progress import Reporter

_DEFAULT = LidarSettings()


@dataclass(frozen=True)
class LidarOptions:
    """Options of `tiegraph lidar`."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The folder to write; new or empty."""
    json: bool = False
    """One JSON object on standard output instead of text."""
    quiet: bool = False
    """Say nothing but errors."""


def main(arguments: list[str]) -> int:
    """`tiegraph lidar`."""

    def lidar(
        scans: tyro.conf.Positional[Path],
        options: Annotated[LidarOptions, tyro.conf.arg(name="")],
        settings: Annotated[LidarSettings, tyro.conf.arg(name="")] = _DEFAULT,
    ) -> tuple[Path, LidarOptions, LidarSettings]:
        """Trajectory and map of a LiDAR; with --run, where it stands on the rig, and the run against it.

        Args:
            scans: A folder of scans (.bin, .pcd, .ply, .npz, .las, .laz), a ROS bag (BAG:TOPIC), or a Velodyne's .pcap.
        """
        return scans, options, settings

    scans, options, settings = options_of(lidar, "tiegraph lidar", arguments)
    reporter = Reporter("json" if options.json else "quiet" if options.quiet else "auto")
    made = make_reference(scans, options.out, settings, reporter)
    reporter.event("lidar", out=options.out, **{k: v for k, v in made.items() if isinstance(v, (int, float))})
    if not options.json and not options.quiet:
        _show(made, options.out, settings)
    return 0


def _show(made: dict[str, Any], out: Path, settings: LidarSettings) -> None:
    say(f"{made['scans']} scans, {made['path_m']:.2f} m in {made['end_s'] - made['start_s']:.1f} s; "
        f"map: {made['map_points']} points; took {made['seconds']:.0f} s")  # fmt: skip
    for note in [*made["notes"], *made.get("run_notes", [])]:
        say(f"  {note}")
    for name, table in made["tables"].items():
        show_table(table["columns"], [[_cell(v) for v in row] for row in table["rows"]], name)
    say(f"written: {out}")
    if settings.run is not None:
        say(f"into the report: tiegraph report {settings.run} --evaluate.reference {out / RIG} "
            f"--evaluate.reference-cloud {out / MAP}")  # fmt: skip


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if not np.isfinite(value) else f"{value:.6g}"
    return str(value)
