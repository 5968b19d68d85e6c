"""`tiegraph run IMAGES -o OUT` and `tiegraph <stage> OUT`."""

import inspect
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from pydantic import Field, create_model

from tiegraph import forking
from tiegraph.api import Project, open_project
from tiegraph.cli.options import Talk, options_of
from tiegraph.cli.verbs import HELP, HELP_ALL, wants_page
from tiegraph.errors import ReconstructionError, SettingsError
from tiegraph.pipeline import load
from tiegraph.project.settings import SETTING_OF, STAGED, Settings
from tiegraph.report.accuracy import terminal_lines
from tiegraph.settings import Section

_MESH = """ Of `mesh`: the cloud as a surface of triangles that is coloured from the images: OUT/mesh/mesh.glb (one
file, for viewers and browsers), mesh.obj with its textures, mesh.ply with colours at the vertices, and offset.json,
which leads to the coordinates of the CRS."""
_STATED = (None, "evaluate", "report")  # runs that end with a statement of accuracy


@dataclass(frozen=True, kw_only=True)
class Common(Talk):
    """Options of every verb that runs stages."""

    pool: str = "local"
    """Where items run: serial, local, local:<workers>, dask:<address> or slurm:<jobs>."""
    unset: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """An input or setting of tiegraph.toml that no longer holds, such as gnss or masks.folder; once for each."""
    strict: bool = False
    """Exit code 3 where anything contradicts anything, or nothing came of a stage: the result is doubtful."""


@dataclass(frozen=True, kw_only=True)
class Survey(Common):
    """Options of every verb that begins with images."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder (default: <IMAGES>_tiegraph beside the images; of a URL in the present folder)."""
    rig: str | None = None
    """A rig.toml, a COLMAP rig_config.json, the folder of another run (its rig as found), or ladybug5, ring:N, stereo,
    single, panorama (default: guessed)."""


@dataclass(frozen=True, kw_only=True)
class RunOptions(Survey):
    """Options of `tiegraph run`."""

    camera: Annotated[str | None, tyro.conf.arg(aliases=["--calibration"])] = None
    """The calibration of a single camera: MODEL,parameters as COLMAP has them, such as
    OPENCV,4000x3000,fx,fy,cx,cy,k1,k2,p1,p2 (the size may be left away), or a file: COLMAP's cameras.txt or .bin,
    OpenCV's or ROS's YAML or XML, Kalibr's camchain.yaml, OpenSfM's camera_models.json, Agisoft's XML, or a rig.toml
    with one camera. Of the cameras of a rig: in its rig.toml."""
    gnss: Path | None = None
    """Positions: a CSV (time or image, lat, lon, height, sigma), NMEA 0183, RTKLIB's .pos, GPX, KML, KMZ, ODM's
    geo.txt, SBET, DJI's Timestamp.MRK, or a ROS bag (BAG:TOPIC where it has several)."""
    trajectory: Path | None = None
    """Poses: a file of TUM, EuRoC or KITTI or a folder with one a pass, a transforms.json, a COLMAP model, or a ROS bag
    (BAG:TOPIC where it has several); auto: by odometry from the images, whose cameras must be calibrated."""
    start: Path | None = None
    """A model to go on from, of these images: a COLMAP model or workspace, OpenSfM's or ODM's reconstruction.json,
    nerfstudio's transforms.json, or Metashape's camera XML. Its poses choose pairs and are tested, its cameras are a
    start where none is given; its unit and place are not taken over. Not together with --trajectory."""
    gcp: Path | None = None
    """Ground control and check points: ODM's gcp_list.txt, or a CSV of points (name, x, y, z or name, lat, lon, height)
    and marks (name, image, px, py), as one table or two in one file (sets georef.gcp). Points named as coded targets
    (tag36h11:12) are found; scale bars are a table from, to, length."""
    marks: Path | None = None
    """CSV of the points' marks (name, image, px, py), if they are not in the file of the points (sets georef.marks)."""
    times: Path | None = None
    """CSV of the frames' times, where EXIF has none: pass, frame, time (or image, time)."""
    tolerance: float | None = None
    """Accuracy in the world, metres, that is asked for: answered yes, no or cannot be told (sets
    evaluate.tolerance_m)."""
    until: str | None = None
    """The last stage to run (default: all)."""
    keep: Literal["all", "results"] = "all"
    """results: remove the depth maps at the end; they are made again when something needs them."""
    plan: bool = False
    """Only say what the run would need (images, disk, CPU time) and make nothing."""
    preset: str | None = None
    """A named way of working: default, fast, close-range, conventional, meguro2024, meguro2025."""


_IMAGES = """The folder that holds the images, in any of the layouts the README names, videos or ROS bags; or a video, a
bag, or some of its topics, BAG:TOPIC,TOPIC. Of this and every input a URL of a store, such as s3://BUCKET/SURVEY, can
be given: what lies there is copied to tiegraph_cache/ beside the run folder."""
_RUN = """From a folder of images to the cloud and the report.

A second run continues: what is up to date is skipped, finished items of an interrupted stage stay. The run folder may
then be given in place of the images."""


def main(arguments: list[str]) -> int:
    """`tiegraph run`."""
    folder, known = preparsed(arguments)
    before = open_project(folder, known.out, preset=known.preset, unset=known.unset).settings if folder else Settings()
    images, options, given = _parsed("tiegraph run", arguments, before, STAGED, RunOptions, ("images", _IMAGES), _RUN)
    inputs = {n: getattr(options, n) for n in ("rig", "camera", "gnss", "trajectory", "start", "times", *SETTING_OF)}
    how = {"preset": options.preset, "pool": options.pool, "unset": options.unset}
    project = open_project(images, options.out, settings=given, **how, **inputs)
    if options.plan:
        reporter = options.reporter()
        project.fetch(reporter)
        found, uncounted = project.forecast(), "the frames of videos and bags are counted by the stage scan"
        if found is None:
            reporter.say(f"{uncounted}: run --until scan, then ask again")
            return 0
        for line in found.lines(project.folder):
            reporter.say(line)
        reporter.event("forecast", **found.cost.row(), there_bytes=found.there_bytes, free_bytes=found.free_bytes)
        return 0 if found.enough() else 1
    code = finish(project, options.until, options)
    if options.keep == "results" and (freed := project.let_go()):
        options.reporter().say(f"depth maps removed as ordered (--keep results): {freed / 1e9:.2g} GB are free again")
    return code


def main_stage(stage: str, arguments: list[str], kind: type[Common] = Common, about: str = "") -> int:
    """`tiegraph <stage> OUT`: one stage and what it needs, in a run folder that exists.

    ``--help`` shows the stage's own settings, ``--help-all`` those of all. ``kind``: the class of the options;
    ``about``: more of the description.
    """
    folder, known = preparsed(arguments)
    before = open_project(None, folder, unset=known.unset).settings if folder else Settings()
    about = _MESH if stage == "mesh" else about
    what, shown = f"Run one stage, and what it needs, in a run folder.{about}", STAGED
    if wants_page(arguments):
        what += f"\n\nThe settings of the other stages: tiegraph {stage} {HELP_ALL}."
        arguments, shown = [HELP[-1]], (stage,)
    folder_help = ("out", "A run folder made by `tiegraph run`.")
    out, options, given = _parsed(f"tiegraph {stage}", arguments, before, shown, kind, folder_help, what)
    return finish(open_project(None, out, pool=options.pool, settings=given, unset=options.unset), stage, options)


def _parsed(
    program: str,
    arguments: list[str],
    before: Settings,
    sections: Sequence[str],
    kind: type[Common] = RunOptions,
    folder: tuple[str, str] = ("folder", ""),
    about: str = "",
) -> tuple[Path, Any, Settings]:
    """The folder, the options (of class ``kind``), and the settings with what was given. Raises SettingsError.

    ``sections`` of the settings are taken and shown; ``folder``: its name and what it is; ``about`` the verb.
    """
    # Each section is described here, else tyro parses this file in search of the class.
    fields: dict[str, Any] = {}
    for name in sections:
        section = getattr(before, name)
        fields[name] = type(section), Field(section, description=inspect.getdoc(section))
    shown = create_model("Shown", __base__=Section, **fields)()

    def verb(
        folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name=folder[0], help=folder[1])],
        options: Annotated[kind, tyro.conf.arg(name="")],  # type: ignore[valid-type]
        settings: Annotated[type(shown), tyro.conf.arg(name="")] = shown,  # type: ignore[valid-type]
    ) -> tuple[Path, Common, Section]:
        return folder, options, settings

    # Both forms of every flag: its default is what the folder was run with, and the same must run again.
    path, options, given = options_of(verb, program, arguments, page=HELP_ALL, description=about)
    return path, options, before.model_copy(update={n: getattr(given, n) for n in sections})


def finish(project: Project, until: str | None, options: Common) -> int:
    """Run a project and say where its results are; the exit code."""
    forking.prepare(partial(load, until))
    reporter = options.reporter()
    with suppress(ReconstructionError):  # its stage has said it
        project.run(until, reporter)
    for line in terminal_lines(project.folder / "metrics.json") if until in _STATED else ():
        reporter.say(line)
    report = project.folder / "report.html"
    reporter.say(f"report: {report}" if until is None and report.exists() else f"results: {project.folder}")
    reporter.event("done", folder=str(project.folder), report=str(report) if report.exists() else None)
    return 3 if options.strict and project.doubtful(until) else 0


def preparsed(arguments: list[str]) -> tuple[Path | None, RunOptions]:
    """The folder and the options, read before it is known which settings the folder was run with, whose values are the
    defaults that help shows; None for what cannot be read, which the full parse then says.

    Raises SettingsError for the empty name of a folder.
    """
    words = [a for a in arguments if a not in (*HELP, HELP_ALL)]
    try:
        folder, options, _ = _parsed("tiegraph", words, Settings(), STAGED)
    except SettingsError:
        return None, RunOptions()
    if Path() in (folder, options.out) and {"", "--out="} & set(words) and "." not in words:
        raise SettingsError("the name of a folder is empty: a shell variable that is not set?")
    return folder, options
