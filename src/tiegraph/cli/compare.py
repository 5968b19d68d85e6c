"""`tiegraph compare A B ...`: runs side by side; what has changed between two surveys; another method on a block."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.pipeline.epochs import EpochOptions, compare_epochs
from tiegraph.pipeline.passes import compare_passes
from tiegraph.project.folder import check_format
from tiegraph.project.progress import Reporter
from tiegraph.project.run import Run
from tiegraph.report.compare import compare_runs

_EPOCHS, _PASSES, _BASELINE = "--epochs", "--passes", "--baseline"
_SHOWN = 10  # changes; the others stand in changes.csv


def main(arguments: list[str]) -> int:
    """Print the papers' tables for two or more runs side by side, or the changes between two epochs."""
    if _EPOCHS in arguments:
        return _epochs([a for a in arguments if a != _EPOCHS])
    if _PASSES in arguments:
        return _passes([a for a in arguments if a != _PASSES])
    if any(a.partition("=")[0] == _BASELINE for a in arguments):
        return _baseline(arguments)

    def compare(
        runs: tyro.conf.Positional[tuple[Path, ...]],
        html: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    ) -> tuple[tuple[Path, ...], Path | None]:
        """Two or more run folders side by side: times, pairs, images used, points, errors.

        With --epochs: what has changed between two surveys of one place (--epochs --help). With --passes: how well two
        passes of one survey agree (--passes --help). With --baseline: another method on a block of a survey
        (--baseline colmap --help).

        Args:
            runs: Run folders made by `tiegraph run`.
            html: Also write the comparison as one HTML file.
        """
        return runs, html

    runs, html = options_of(compare, "tiegraph compare", arguments)
    for run in runs:
        check_format(run)
    say(compare_runs(list(runs), html).rstrip("\n"))
    return 0


def _epochs(arguments: list[str]) -> int:
    def epochs(
        first: tyro.conf.Positional[Path],
        second: tyro.conf.Positional[Path],
        options: Annotated[EpochOptions, tyro.conf.arg(name="")],
        out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("changes"),
    ) -> tuple[tuple[Path, Path], Path, EpochOptions]:
        """What has changed between two surveys of one place, by M3C2 with both surveys' sigmas.

        Args:
            first: The run folder of the earlier survey.
            second: That of the later one.
            out: The folder to write: changes.json, changes.csv, changes.png, changes.laz.
        """
        return (first, second), out, options

    folders, out, options = options_of(epochs, f"tiegraph compare {_EPOCHS}", arguments)
    _say(compare_epochs(folders, out, options), out)
    return 0


def _passes(arguments: list[str]) -> int:
    def passes(
        run: tyro.conf.Positional[Path],
        out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("passes"),
        depth_m: float | None = None,
    ) -> tuple[Path, Path, float | None]:
        """How well the clouds of the two largest passes of one survey agree, by M3C2; no reference is needed.

        Args:
            run: A run folder with depth maps.
            out: The folder to write: changes.json, changes.csv, changes.png, changes.laz.
            depth_m: Largest difference that is looked for, to either side (default: by the spacing of the clouds).
        """
        return run, out, depth_m

    run, out, depth_m = options_of(passes, f"tiegraph compare {_PASSES}", arguments)
    project = open_project(None, run)
    _say(compare_passes(Run(project.folder, project.inputs, project.settings), out, depth_m), out)
    return 0


@dataclass(frozen=True)
class BaselineOptions:
    """Options of `tiegraph compare --baseline`."""

    baseline: Literal["conventional", "meguro2024", "meguro2025", "colmap"]
    """What to compare with: COLMAP alone with every pair, or a paper's method as a preset."""
    sample: int
    """Images of the block, a connected stretch of the path (all, if the survey has fewer)."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The folder that keeps the block and both runs (default: RUN_block<sample>); again, it goes on there."""
    pool: str = "local"
    """Where items run: serial, local, local:<workers>."""
    quiet: bool = False
    """Say nothing of the runs."""


def _baseline(arguments: list[str]) -> int:
    def against(
        run: tyro.conf.Positional[Path], options: Annotated[BaselineOptions, tyro.conf.arg(name="")]
    ) -> tuple[Path, BaselineOptions]:
        """Another method on a block of a finished survey: what it costs at equal registration.

        Args:
            run: A run folder with a model (to georef).
        """
        return run, options

    run, options = options_of(against, f"tiegraph compare {_BASELINE}", arguments)
    reporter = Reporter("quiet" if options.quiet else "auto")
    project = open_project(None, run, pool=options.pool)
    result = project.baseline(options.baseline, options.sample, options.out, reporter)
    for part in ("figures", "stages", "sections"):
        show_table(result[part]["columns"], [[_figure(v) for v in row] for row in result[part]["rows"]], part)
    for text in (*result["speed_up"], *result["notes"]):
        say(text)
    return 0


def _figure(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _say(result: dict[str, Any], out: Path) -> None:
    for part in ("differences", "areas_and_volumes"):
        for name, value in result[part].items():
            say(f"{name.replace('_', ' '):<24} {value:g}")
    if result["registration"] is not None:
        show_table(result["registration"]["columns"], _texts(result["registration"]["rows"]), "registration")
    rows = result["changes"]["rows"]
    show_table(result["changes"]["columns"], _texts(rows[:_SHOWN]), "changes, the largest")
    for note in result["notes"]:
        say(note)
    say(f"written: {out}")


def _texts(rows: list[list]) -> list[list[str]]:
    return [["" if v is None else f"{v:.2f}" if isinstance(v, float) else str(v) for v in row] for row in rows]
