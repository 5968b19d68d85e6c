"""`tiegraph init IMAGES`, what is in a folder and files to edit before a run; `tiegraph demo`, the example survey."""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.output import say
from tiegraph.cli.run import Common, Survey, finish
from tiegraph.errors import InputError
from tiegraph.pipeline.scan import describe
from tiegraph.scan.cameras import WORDS
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.gcp import FORMS
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene

_ORIGIN = (35.6965, 139.7695, 37.0)  # of the truth's east-north-up metres (truth/meta.json)
_COMMENT = """\
A guess from the folders and images: check the orientations, then use it by --rig.
Cameras whose focal length nothing tells have none here either: what stands here is taken for measured. Give it as
[camera] (for all) or [sensors.camera] (for one): model, size and params, or focal_px, or hfov_deg."""


@dataclass(frozen=True, kw_only=True)
class Init(Survey):
    """Show what is found in a folder of images; write tiegraph.toml and rig.toml guesses to edit."""

    images: tyro.conf.Positional[Path]
    """The folder that holds the survey's images."""
    camera: Annotated[str | None, tyro.conf.arg(aliases=["--calibration"])] = None
    """The calibration of a single camera: MODEL,parameters as COLMAP has them, or a file (as of `tiegraph run`)."""

    def run(self) -> int:
        given = {"rig": self.rig, "camera": self.camera}
        project = open_project(self.images, self.out, pool=self.pool, unset=self.unset, **given)
        project.run("scan", self.reporter())
        scene = project.scene()
        written = _write_rigs(scene, project.folder)
        for line in describe(scene):
            say(line)
        say(f"written: {project.folder / 'tiegraph.toml'}")
        for path in written:
            say(f"written: {path} (edit it, then run with --rig {path})")
        for hint in _hints(scene):
            say(hint)
        return 0


def _hints(scene: Scene) -> list[str]:
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


def _without_guesses(rig: Rig) -> Rig:
    """A rig without the cameras that were guessed, which a rig file would make a statement of the user's."""
    sensors = tuple(
        s
        if s.camera is None or s.camera.has_prior_focal_length
        else replace(s, camera=None, source=None if s.source is None else replace(s.source, camera=None))
        for s in rig.sensors
    )
    return replace(rig, sensors=sensors)


@dataclass(frozen=True, kw_only=True)
class Demo(Common):
    """The example survey from images to the report: 6 cameras, 2 passes, 120 images, GNSS, truth."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tiegraph_demo")
    """The run folder."""
    until: str | None = None
    """The last stage to run (default: all)."""
    preset: str | None = None
    """A named way of working: default, fast, close-range, conventional, meguro2024, meguro2025."""

    def run(self) -> int:
        survey = example()
        truth = {"reference": "colmap", "reference_cloud": "reference.laz"}
        evaluate = {name: survey / "truth" / file for name, file in truth.items()}
        evaluate |= {"reference_origin": _ORIGIN}
        given = {"rig": survey / "rig.toml", "gnss": survey / "gnss.csv", "times": survey / "times.csv"}
        how = {"preset": self.preset, "pool": self.pool, "unset": self.unset, "settings": {"evaluate": evaluate}}
        return finish(open_project(survey / "images", self.out, **how, **given), self.until, self)


def example() -> Path:
    """The folder of the example survey: that of the checkout, or the package `tiegraph-canal`. Raises InputError if
    neither is there."""
    installed = find_spec("tiegraph_canal")
    folders = [Path(__file__).resolve().parents[3] / "examples" / "canal"]
    folders += [Path(p) for p in (installed and installed.submodule_search_locations) or ()]
    for folder in folders:
        if (folder / "images").is_dir():
            return folder
    raise InputError(
        "the example survey is a package of its own, and it is not installed: `pip install tiegraph-canal` "
        "(in a checkout of tiegraph: `pip install ./examples/canal`)"
    )
