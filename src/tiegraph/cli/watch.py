"""`tiegraph watch FOLDER`: images are followed while they arrive, on a page of this machine."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import Talk, options_of
from tiegraph.pipeline.watch import watch
from tiegraph.project.verbtunings import read_tunings
from tiegraph.scene.atomic import real_path


@dataclass(frozen=True, kw_only=True)
class _Watch(Talk):
    """Follow the images of a folder while they arrive: ties, path, surface coverage and where to go again."""

    folder: tyro.conf.Positional[Path]
    """The folder into which images are copied, in any of the layouts of `tiegraph run`."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where what is known is kept (default: <FOLDER>_watch beside the folder); the same again goes on."""
    rig: str | None = None
    """As for `tiegraph run`: a rig.toml, COLMAP's rig_config.json, the folder of a run, or a preset such as ring:N."""
    camera: str | None = None
    """The calibration of a single camera, as for `tiegraph run`."""
    gnss: Path | None = None
    """Positions, as for `tiegraph run`: the plan is in metres then, north up."""
    times: Path | None = None
    """CSV of the frames' times, as for `tiegraph run`: of images that have none, for --gnss."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.watch] and those of the stages that it uses."""
    port: int = 8765
    """Of the page on this machine (127.0.0.1); 0 = any that is free."""


def main(arguments: list[str]) -> int:
    """`tiegraph watch`."""
    options = options_of(_Watch, "tiegraph watch", arguments)
    source = real_path(options.folder)
    out = options.out or source.with_name(source.name + "_watch")
    given = {name: getattr(options, name) for name in ("rig", "camera", "gnss", "times")}
    tunings = read_tunings(options.tuning)
    project = open_project(source, out, pool="serial", settings={"tuning": tunings.of_stages()}, **given)
    watch(project.as_run(options.reporter()), options.port, tunings.watch)
    return 0
