"""`tiegraph compare A B ...`: runs side by side, or with --epochs what has changed between two surveys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.pipeline.epochs import EpochOptions, compare_epochs
from tiegraph.project.folder import check_format
from tiegraph.report.compare import compare_runs

_EPOCHS = "--epochs"


def main(arguments: list[str]) -> int:
    """Print the papers' tables for two or more runs side by side, or the changes between two epochs."""
    if _EPOCHS in arguments:
        return _epochs([a for a in arguments if a != _EPOCHS])

    def compare(
        runs: tyro.conf.Positional[tuple[Path, ...]],
        html: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    ) -> tuple[tuple[Path, ...], Path | None]:
        """Two or more run folders side by side: times, pairs, images used, points, errors.

        With --epochs: what has changed between two surveys of one place (--epochs --help).

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
    result = compare_epochs(folders, out, options)
    for part in ("differences", "areas_and_volumes"):
        for name, value in result[part].items():
            say(f"{name.replace('_', ' '):<24} {value:g}")
    if result["registration"] is not None:
        show_table(result["registration"]["columns"], _texts(result["registration"]["rows"]), "registration")
    show_table(result["changes"]["columns"], _texts(result["changes"]["rows"]), "changes")
    say(f"written: {out}")
    return 0


def _texts(rows: list[list]) -> list[list[str]]:
    return [["" if v is None else f"{v:.3f}" if isinstance(v, float) else str(v) for v in row] for row in rows]
