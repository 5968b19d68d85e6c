"""`tiegraph shots IMAGES --rig RIG`: a point cloud a shot from the rig's calibration alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.run import Common


@dataclass(frozen=True, kw_only=True)
class _Shots(Common):
    """One point cloud for every shot of a calibrated rig, without a sparse model (shots/*.ply)."""

    images: tyro.conf.Positional[Path]
    """The folder that holds the images, one folder a camera."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder (default: <IMAGES>_tiegraph beside the images)."""
    rig: str | None = None
    """A rig.toml, a COLMAP rig_config.json or the folder of another run, with the intrinsics and the place of every
    camera."""
    near: float | None = None
    """Nearest distance of the object in metres (default: 5 times the longest baseline)."""
    far: float | None = None
    """Farthest distance of the object in metres (default: 100 times the longest baseline)."""
    posed: Path | None = None
    """A new folder for the clouds as LAZ in the world, with sigma, views and CRS: needs the poses of `tiegraph run`
    over the same images and run folder."""
    preset: str | None = None
    """A named way of working; close-range keeps the full resolution."""


def main(arguments: list[str]) -> int:
    """`tiegraph shots`."""
    options = options_of(_Shots, "tiegraph shots", arguments, config=(tyro.conf.FlagCreatePairsOff,))
    how = {"preset": options.preset, "pool": options.pool, "unset": options.unset}
    project = open_project(options.images, options.out, rig=options.rig, **how)
    reporter = options.reporter()
    made = project.shots(options.near, options.far, reporter)
    reporter.say(f"{len(made)} clouds: {project.folder / 'shots'}")
    if options.posed is not None:
        posed = project.posed_shots(options.posed, reporter)
        reporter.say(f"{len(posed)} of {len(made)} clouds in the world: {options.posed}")
    return 0
