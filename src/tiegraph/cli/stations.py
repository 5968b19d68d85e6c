"""`tiegraph stations SHOTS... -o FOLDER`: clouds of single shots without poses into one frame and one cloud."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tiegraph.cli.options import Talk, options_of
from tiegraph.cli.output import say, show_table
from tiegraph.pipeline.stations import stations as join_stations
from tiegraph.project.verbtunings import read_tunings


@dataclass(frozen=True, kw_only=True)
class _Stations(Talk):
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


def main(arguments: list[str]) -> int:
    """`tiegraph stations`."""
    options = options_of(_Stations, "tiegraph stations", arguments)
    reporter = options.reporter()
    tunings = read_tunings(options.tuning)
    made = join_stations(options.shots, options.out, options.poses, options.voxel_m, reporter, tunings)
    joined = [c for c in made["clouds"] if c["joined"]]
    reporter.event("stations", out=options.out, joined=len(joined), clouds=len(made["clouds"]))
    if not options.json and not options.quiet:
        _show(made, options.out)
    return 0


def _show(made: dict[str, Any], out: Path) -> None:
    clouds = made["clouds"]
    joined = [c for c in clouds if c["joined"]]
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
    say(f"{len(joined)} of {len(clouds)} clouds in one frame ({made['frame']}); {made['cloud']['points']} points")
    for note in made["notes"]:
        say(note)
    say(f"written: {out}")


def _mm(value: float | None) -> str:
    return "" if value is None else f"{1000 * value:.3g}"
