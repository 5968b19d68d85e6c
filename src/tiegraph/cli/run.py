"""`tiegraph run IMAGES -o OUT` and `tiegraph <stage> OUT`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from pydantic import ValidationError

from tiegraph.api import Project, open_project
from tiegraph.errors import SettingsError
from tiegraph.project.progress import Reporter
from tiegraph.project.settings import PRESETS, Settings


@dataclass(frozen=True)
class Common:
    """Options of every verb that runs stages."""

    pool: str = "local"
    """Where items run: serial, local, local:<workers> or dask:<address>."""
    json: bool = False
    """One JSON object a line on standard output instead of text."""
    quiet: bool = False
    """Say nothing but errors."""

    def reporter(self) -> Reporter:
        """The progress these options ask for."""
        return Reporter("json" if self.json else "quiet" if self.quiet else "auto")


@dataclass(frozen=True)
class RunOptions(Common):
    """Options of `tiegraph run`."""

    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder (default: <IMAGES>_tiegraph beside the images)."""
    rig: str | None = None
    """A rig.toml, a COLMAP rig_config.json, or ladybug5, ring:N, stereo, single, panorama (default: guessed)."""
    gnss: Path | None = None
    """CSV of positions: time, lat, lon, height, sigma."""
    trajectory: Path | None = None
    """Poses in TUM format: a file, or a folder with one file a pass."""
    gcp: Path | None = None
    """Ground control and check points: ODM's gcp_list.txt, or a CSV of points and marks (sets georef.gcp)."""
    times: Path | None = None
    """CSV of the frames' times, where EXIF has none: pass, frame, time (or image, time)."""
    until: str | None = None
    """The last stage to run (default: all)."""
    preset: str | None = None
    """A named way of working: default, fast, close-range, conventional, meguro2024, meguro2025."""


def main(arguments: list[str]) -> int:
    """`tiegraph run`."""
    known = preparsed(arguments)
    before = open_project(known.folder, known.out, preset=known.preset) if known.folder else None
    default = before.settings if before else Settings()

    def run(
        images: tyro.conf.Positional[Path],
        options: Annotated[RunOptions, tyro.conf.arg(name="")],
        settings: Annotated[Settings, tyro.conf.arg(name="")] = default,
    ) -> tuple[Path, RunOptions, Settings]:
        """From a folder of images to the cloud and the report.

        A second run continues: what is up to date is skipped, finished items of an interrupted stage stay.

        Args:
            images: The folder that holds the survey's images, in any of the layouts the README names.
        """
        return images, options, settings

    images, options, settings = _cli(run, "tiegraph run", arguments)
    inputs = {n: getattr(options, n) for n in ("rig", "gnss", "gcp", "trajectory", "times")}
    project = open_project(images, options.out, preset=options.preset, pool=options.pool, settings=settings, **inputs)
    return finish(project, options.until, options.reporter())


def main_stage(stage: str, arguments: list[str]) -> int:
    """`tiegraph <stage> OUT`: one stage and what it needs, in a run folder that exists."""
    folder = preparsed(arguments).folder
    default = open_project(None, folder).settings if folder else Settings()

    def run_stage(
        out: tyro.conf.Positional[Path],
        options: Annotated[Common, tyro.conf.arg(name="")],
        settings: Annotated[Settings, tyro.conf.arg(name="")] = default,
    ) -> tuple[Path, Common, Settings]:
        """Run one stage, and what it needs, in a run folder.

        Args:
            out: A run folder made by `tiegraph run`.
        """
        return out, options, settings

    out, options, settings = _cli(run_stage, f"tiegraph {stage}", arguments)
    return finish(open_project(None, out, pool=options.pool, settings=settings), stage, options.reporter())


def finish(project: Project, until: str | None, reporter: Reporter) -> int:
    """Run a project and say where its results are."""
    project.run(until, reporter)
    report = project.folder / "report.html"
    reporter.say(f"report: {report}" if until is None and report.exists() else f"results: {project.folder}")
    reporter.event("done", folder=str(project.folder), report=str(report) if report.exists() else None)
    return 0


def _cli(function: Any, program: str, arguments: list[str]) -> Any:
    try:
        # Both forms of every flag: its default is what the folder was run with, and the same command must run again.
        return tyro.cli(function, prog=program, args=arguments)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise SettingsError(f"setting {error.title}.{name} = {first.get('input')!r}: {first['msg']}") from None


@dataclass(frozen=True)
class Known:
    """What is read of the arguments before the full parse: where the settings' defaults come from."""

    folder: Path | None  # the first positional argument
    out: Path | None
    preset: str | None


def preparsed(arguments: list[str]) -> Known:
    """The folder, output and preset of the arguments. Raises SettingsError for an unknown preset."""
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--preset", choices=None)
    known, rest = parser.parse_known_args(arguments)
    first = Path(rest[0]) if rest and not rest[0].startswith("-") else None
    if known.preset is not None and known.preset not in PRESETS:
        open_project(first or ".", known.out, preset=known.preset)  # raises, naming the presets there are
    return Known(first, known.out, known.preset)
