"""`tiegraph odometry IMAGES --rig rig.toml -o vo.tum`: the path of the cameras from the images alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import Talk, options_of
from tiegraph.project.verbtunings import read_tunings
from tiegraph.scene.atomic import scratch_folder


@dataclass(frozen=True, kw_only=True)
class _Odometry(Talk):
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


def main(arguments: list[str]) -> int:
    """`tiegraph odometry`."""
    options = options_of(_Odometry, "tiegraph odometry", arguments)
    reporter = options.reporter()
    settings = {"tuning": read_tunings(options.tuning).of_stages()}
    if options.masks is not None:
        settings["masks"] = {"source": "folder", "folder": options.masks.absolute()}
    given = {"rig": options.rig, "camera": options.camera, "times": options.times}
    with scratch_folder() as folder:
        project = open_project(options.images, folder / "run", pool=options.pool, settings=settings, **given)
        made = project.odometry(options.out, reporter)
    for one in made:
        for text in (*one.said, str(one.tum)):
            reporter.say(text)
        reporter.event("odometry", trajectory=one.tum, said=one.said, frames_per_s=round(one.frames_per_s, 2))
    return 0
