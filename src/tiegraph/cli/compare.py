"""`tiegraph compare A B ...`: runs side by side; what has changed between two surveys; another method on a block."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.pipeline.clouds import EpochOptions, compare_epochs
from tiegraph.pipeline.passes import compare_passes
from tiegraph.project.folder import check_format
from tiegraph.project.progress import Reporter
from tiegraph.report.compare import compare_runs

_EPOCHS, _PASSES, _BASELINE = "--epochs", "--passes", "--baseline"
_SHOWN = 10  # changes; the others stand in changes.csv


@dataclass(frozen=True)
class _Compare:
    """Two or more run folders side by side: times, pairs, images used, points, errors.

    With --epochs: what has changed between two surveys of one place (--epochs --help). With --passes: how well two
    passes of one survey agree (--passes --help). With --baseline: another method on a block of a survey
    (--baseline colmap --help).
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folders made by `tiegraph run`."""
    html: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Also write the comparison as one HTML file."""


def main(arguments: list[str]) -> int:
    """Print the papers' tables for two or more runs side by side, or the changes between two epochs."""
    if _EPOCHS in arguments:
        return _epochs([a for a in arguments if a != _EPOCHS])
    if _PASSES in arguments:
        return _passes([a for a in arguments if a != _PASSES])
    if any(a.partition("=")[0] == _BASELINE for a in arguments):
        return _baseline(arguments)
    asked = options_of(_Compare, "tiegraph compare", arguments)
    for run in asked.runs:
        check_format(run)
    say(compare_runs(list(asked.runs), asked.html).rstrip("\n"))
    return 0


@dataclass(frozen=True)
class _Epochs:
    """What has changed between two surveys of one place, by M3C2 with both surveys' sigmas."""

    first: tyro.conf.Positional[Path]
    """The run folder of the earlier survey, whose constants ([tuning.evaluate]) count."""
    second: tyro.conf.Positional[Path]
    """That of the later one."""
    options: Annotated[EpochOptions, tyro.conf.arg(name="")]
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("changes")
    """The folder to write: changes.json, changes.csv, changes.png, changes.laz."""


def _epochs(arguments: list[str]) -> int:
    asked = options_of(_Epochs, f"tiegraph compare {_EPOCHS}", arguments)
    _say(compare_epochs((asked.first, asked.second), asked.out, asked.options), asked.out)
    return 0


@dataclass(frozen=True)
class _Passes:
    """How well the clouds of the two largest passes of one survey agree, by M3C2; no reference is needed."""

    run: tyro.conf.Positional[Path]
    """A run folder with depth maps."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("passes")
    """The folder to write: changes.json, changes.csv, changes.png, changes.laz."""
    depth_m: float | None = None
    """Largest difference that is looked for, to either side (default: by the spacing of the clouds)."""


def _passes(arguments: list[str]) -> int:
    asked = options_of(_Passes, f"tiegraph compare {_PASSES}", arguments)
    _say(compare_passes(open_project(None, asked.run).as_run(), asked.out, asked.depth_m), asked.out)
    return 0


@dataclass(frozen=True)
class _Baseline:
    """Another method on a block of a finished survey: what it costs at equal registration."""

    run: tyro.conf.Positional[Path]
    """A run folder with a model (to georef)."""
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
    asked = options_of(_Baseline, f"tiegraph compare {_BASELINE}", arguments)
    project = open_project(None, asked.run, pool=asked.pool)
    result = project.baseline(asked.baseline, asked.sample, asked.out, Reporter("quiet" if asked.quiet else "auto"))
    for part in ("figures", "stages", "sections"):
        show_table(result[part]["columns"], result[part]["rows"], part, ".4g")
    for text in (*result["speed_up"], *result["notes"]):
        say(text)
    return 0


def _say(result: dict[str, Any], out: Path) -> None:
    for part in ("differences", "areas_and_volumes"):
        for name, value in result[part].items():
            say(f"{name.replace('_', ' '):<24} {value:g}")
    if result["registration"] is not None:
        show_table(result["registration"]["columns"], result["registration"]["rows"], "registration", ".2f")
    changes = result["changes"]
    show_table(changes["columns"], changes["rows"][:_SHOWN], "changes, the largest", ".2f")
    for note in result["notes"]:
        say(note)
    say(f"written: {out}")
