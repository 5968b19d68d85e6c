"""`tiegraph compare A B ...`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.project.folder import check_format
from tiegraph.report.compare import compare_runs


def main(arguments: list[str]) -> int:
    """Print the papers' tables for two or more runs side by side."""

    def compare(
        runs: tyro.conf.Positional[tuple[Path, ...]],
        html: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    ) -> tuple[tuple[Path, ...], Path | None]:
        """Two or more run folders side by side: times, pairs, images used, points, errors.

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
