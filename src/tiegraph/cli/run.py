"""`tiegraph run IMAGES -o OUT` and `tiegraph <stage> OUT`."""

import inspect
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import tyro
from pydantic import Field, ValidationError, create_model

from tiegraph import forking
from tiegraph.api import Project, open_project
from tiegraph.cli.options import Talk, options_of
from tiegraph.cli.verbs import HELP, HELP_ALL, wants_page
from tiegraph.errors import ReconstructionError, SettingsError, choose
from tiegraph.pipeline import load
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import PRESETS, SETTING_OF, STAGED, Settings, sections
from tiegraph.report.accuracy import terminal_lines
from tiegraph.settings import Section

_MANY = 1 << 20
_STATED = (None, "evaluate", "report")  # runs that end with a statement of accuracy


@dataclass(frozen=True, kw_only=True)
class Common(Talk):
    """Options of every verb that runs stages."""

    pool: str = "local"
    """Where items run: serial, local, local:<workers> or dask:<address>."""
    unset: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """An input or setting of tiegraph.toml that no longer holds, such as gnss or masks.folder; once for each."""
    strict: bool = False
    """Exit code 3 where anything contradicts anything, or nothing came of a stage: the result is doubtful."""


@dataclass(frozen=True, kw_only=True)
class RunOptions(Common):
    """Options of `tiegraph run`."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder (default: <IMAGES>_tiegraph beside the images)."""
    rig: str | None = None
    """A rig.toml, a COLMAP rig_config.json, the folder of another run (its rig as found), or ladybug5, ring:N, stereo,
    single, panorama (default: guessed)."""
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


def main(arguments: list[str]) -> int:
    """`tiegraph run`."""
    known = preparsed(arguments)
    before = (known.folder, known.out) if known.folder else None
    default = open_project(*before, preset=known.preset, unset=known.unset).settings if before else Settings()
    shown = _shown(default, STAGED)

    def run(
        images: tyro.conf.Positional[Path],
        options: Annotated[RunOptions, tyro.conf.arg(name="")],
        settings: Annotated[type(shown), tyro.conf.arg(name="")] = shown,  # type: ignore[valid-type]
    ) -> tuple[Path, RunOptions, Section]:
        """From a folder of images to the cloud and the report.

        A second run continues: what is up to date is skipped, finished items of an interrupted stage stay.

        Args:
            images: The folder that holds the survey's images, in any of the layouts the README names, videos or ROS
                bags; or a bag, or some of its topics, BAG:TOPIC,TOPIC.
        """
        return images, options, settings

    images, options, given = _cli(run, "tiegraph run", arguments)
    settings = _settings(default, given)
    inputs = {n: getattr(options, n) for n in ("rig", "camera", "gnss", "trajectory", "start", "times", *SETTING_OF)}
    how = {"preset": options.preset, "pool": options.pool, "unset": options.unset}
    project = open_project(images, options.out, settings=settings, **how, **inputs)
    if options.plan:
        return _forecast(project, options.reporter())
    code = finish(project, options.until, options)
    if options.keep == "results" and (freed := project.let_go()):
        options.reporter().say(f"depth maps removed as ordered (--keep results): {freed / 1e9:.2g} GB are free again")
    return code


def _forecast(project: Project, reporter: Reporter) -> int:
    """Say what a run would need."""
    found = project.forecast()
    if found is None:
        reporter.say("the frames of videos and bags are counted by the stage scan: run --until scan, then ask again")
        return 0
    for line in found.lines(project.folder):
        reporter.say(line)
    reporter.event("forecast", **found.cost.row(), there_bytes=found.there_bytes, free_bytes=found.free_bytes)
    return 0 if found.enough() else 1


def main_stage(stage: str, arguments: list[str], kind: type[Common] = Common, about: str = "") -> int:
    """`tiegraph <stage> OUT`: one stage and what it needs, in a run folder that exists.

    ``--help`` shows the stage's own settings, ``--help-all`` those of all. ``kind``: the class of the options;
    ``about``: more of the description.
    """
    known = preparsed(arguments)
    default = open_project(None, known.folder, unset=known.unset).settings if known.folder else Settings()
    short = wants_page(arguments)
    shown = _shown(default, (stage,) if short else STAGED)
    arguments = [HELP[-1]] if short else arguments

    def run_stage(
        out: tyro.conf.Positional[Path],
        options: Annotated[kind, tyro.conf.arg(name="")],  # type: ignore[valid-type]
        settings: Annotated[type(shown), tyro.conf.arg(name="")] = shown,  # type: ignore[valid-type]
    ) -> tuple[Path, Common, Section]:
        """Run one stage.

        Args:
            out: A run folder made by `tiegraph run`.
        """
        return out, options, settings

    what = f"Run one stage, and what it needs, in a run folder.{about}"
    what += f"\n\nThe settings of the other stages: tiegraph {stage} {HELP_ALL}." if short else ""
    out, options, given = _cli(run_stage, f"tiegraph {stage}", arguments, description=what)
    settings = _settings(default, given)
    project = open_project(None, out, pool=options.pool, settings=settings, unset=options.unset)
    return finish(project, stage, options)


def _shown(settings: Settings, names: Sequence[str]) -> Any:
    """The settings with these sections only: what the command line takes and shows.

    Each is described here, else tyro parses this file in search of the class, section by section.
    """
    shown = {name: getattr(settings, name) for name in names}
    fields: dict[str, Any] = {
        name: (type(section), Field(section, description=inspect.getdoc(section))) for name, section in shown.items()
    }
    return create_model("Shown", __base__=Section, **fields)()


def _settings(before: Settings, given: Section) -> Settings:
    """The settings with the sections that the command line gave."""
    return before.model_copy(update={name: getattr(given, name) for name in type(given).model_fields})


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


def _cli(function: Any, program: str, arguments: list[str], **how: Any) -> Any:
    try:
        # Both forms of every flag: its default is what the folder was run with, and the same command must run again.
        return options_of(function, program, arguments, page=HELP_ALL, **how)
    except ValidationError as error:
        said = "; ".join(_said(error.title, e) for e in error.errors())
        raise SettingsError(said) from None


def _said(title: str, error: Any) -> str:
    section = title.removesuffix("Settings").lower()
    name = ".".join(str(part) for part in (section, *error["loc"]))
    value = f" = {error.get('input')!r}" if error["loc"] else ""  # else it is the whole section
    return f"setting {name}{value}: {error['msg'].removeprefix('Value error, ')}"


@dataclass(frozen=True)
class Known:
    """What is read of the arguments before the full parse: where the settings' defaults come from."""

    folder: Path | None  # the first positional argument
    out: Path | None
    preset: str | None
    unset: tuple[str, ...] = ()


def preparsed(arguments: list[str]) -> Known:
    """The folder, output and preset of the arguments, in any order.

    Raises SettingsError for an unknown preset, an output without a folder and empty arguments.
    """
    words, known = list(arguments), {"--out": "", "--preset": "", "": ""}
    unset: list[str] = []
    counts = _value_counts()
    while words:
        word = words.pop(0)
        name, equals, value = word.partition("=")
        name = "--out" if name == "-o" else name.replace("_", "-")
        if not _is_option(word):
            name, values = "", [word]
        elif equals:
            values = [value]
        else:
            count = counts.get(name, 1)
            taken = next((k for k, w in enumerate(words) if _is_option(w)), len(words))
            values, words = words[: min(count, taken)], words[min(count, taken) :]
        if name == "--unset":
            unset += values
        if name in known:
            if not values or not values[0]:
                what = {"": "the name of the folder is empty", "--out": "-o: no folder is named after it, as in -o OUT"}
                raise SettingsError(f"{what.get(name, f'{name}: no value')}: a shell variable that is not set?")
            known[name] = known[name] or values[0] if name == "" else values[0]
    folder, out = (Path(known[n]) if known[n] else None for n in ("", "--out"))
    if known["--preset"]:
        choose("preset", known["--preset"], dict.fromkeys(PRESETS))
    return Known(folder=folder, out=out, preset=known["--preset"] or None, unset=tuple(unset))


def _is_option(word: str) -> bool:
    return word.startswith("-") and not re.fullmatch(r"-[.\d].*", word)  # -33.9 is a number


def _value_counts() -> dict[str, int]:
    """How many values each option takes, at most."""
    out = {f"--{f.name}": 0 if f.type in ("bool", bool) else 1 for f in fields(RunOptions)}
    out.update({f"--no-{name[2:]}": 0 for name, count in out.items() if count == 0})
    out.update({name: 0 for name in (*HELP, HELP_ALL)})
    for section, named in sections():
        for key, field in named.items():
            parts = get_args(field.annotation) if get_origin(field.annotation) is tuple else ()
            many = len(parts) if parts and Ellipsis not in parts else _MANY if "tuple" in str(field.annotation) else 1
            name = key.replace("_", "-")
            out[f"--{section}.{name}"] = 0 if field.annotation is bool else many
            out[f"--{section}.no-{name}"] = 0
    return out
