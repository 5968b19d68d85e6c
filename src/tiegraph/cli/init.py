"""`tiegraph init IMAGES`: what is in the folder, and files to edit before a run."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.cli.run import Common
from tiegraph.pipeline.scan import describe
from tiegraph.scan.cameras import WORDS
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.gcp import FORMS
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class _Init(Common):
    """Show what is found in a folder of images; write tiegraph.toml and rig.toml guesses to edit."""

    images: tyro.conf.Positional[Path]
    """The folder that holds the survey's images."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder to prepare (default: <IMAGES>_tiegraph beside the images)."""
    rig: str | None = None
    """A rig.toml, a COLMAP rig_config.json, the folder of another run (its rig as found), or ladybug5, ring:N, stereo,
    single, panorama (default: guessed)."""
    camera: Annotated[str | None, tyro.conf.arg(aliases=["--calibration"])] = None
    """The calibration of a single camera: MODEL,parameters as COLMAP has them, or a file (as of `tiegraph run`)."""


def main(arguments: list[str]) -> int:
    """Scan a folder, say what was found, and write tiegraph.toml and rig.toml into the run folder."""
    options = options_of(_Init, "tiegraph init", arguments)
    given = {"rig": options.rig, "camera": options.camera}
    project = open_project(options.images, options.out, pool=options.pool, unset=options.unset, **given)
    project.run("scan", options.reporter())
    scene = project.scene()
    written = _write_rigs(scene, project.folder)
    for line in describe(scene):
        say(line)
    say(f"written: {project.folder / 'tiegraph.toml'}")
    for path in written:
        say(f"written: {path} (edit it, then run with --rig {path})")
    for hint in hints(scene):
        say(hint)
    return 0


def hints(scene: Scene) -> list[str]:
    """What else may be given to `tiegraph run`, in lines for people."""
    lines = ["also, for `tiegraph run`:"]
    if len(scene.all_sensors) == 1:
        lines.append(f"  --camera: the camera's calibration, if you have one; {WORDS}")
    if scene.prior == "none":
        columns = "columns time or image, lat, lon, height, if known sigma_h, sigma_v"
        lines.append(f"  --gnss FILE: positions; {columns}; or NMEA, .pos, GPX, KML, geo.txt, SBET, MRK, a ROS bag")
    return [*lines, f"  --gcp FILE: control points; {FORMS}"]


def _write_rigs(scene: Scene, folder: Path) -> list[Path]:
    written = []
    for number, rig in enumerate(scene.rigs):
        path = folder / ("rig.toml" if len(scene.rigs) == 1 else f"rig_{number}.toml")
        given = any(s.source is not None and s.source.rendered for s in rig.sensors)
        if len(rig.sensors) > 1 and not given and not path.exists():
            write_rig_toml(_without_guesses(rig), path, _COMMENT)
            written.append(path)
    return written


_COMMENT = """\
A guess from the folders and images: check the orientations, then use it by --rig.
Cameras whose focal length nothing tells have none here either: what stands here is taken for measured. Give it as
[camera] (for all) or [sensors.camera] (for one): model, size and params, or focal_px, or hfov_deg."""


def _without_guesses(rig: Rig) -> Rig:
    """A rig without the cameras that were guessed, which a rig file would make a statement of the user's."""
    sensors = tuple(
        s
        if s.camera is None or s.camera.has_prior_focal_length
        else replace(s, camera=None, source=None if s.source is None else replace(s.source, camera=None))
        for s in rig.sensors
    )
    return replace(rig, sensors=sensors)
