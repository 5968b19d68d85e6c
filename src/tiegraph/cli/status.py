"""`tiegraph status OUT`."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import show_table


@dataclass(frozen=True)
class _Status:
    """Which stages of a run folder are up to date, and why not."""

    out: tyro.conf.Positional[Path]
    """A run folder made by `tiegraph run`."""


def main(arguments: list[str]) -> int:
    """Print the stages of a run folder: up to date or why not, seconds, counts. Runs nothing."""
    project = open_project(None, options_of(_Status, "tiegraph status", arguments).out)
    rows = []
    for name, why, receipt in project.status():
        counts = ", ".join(f"{v:g} {k}" for k, v in receipt.get("counts", {}).items())
        numbers = [str(receipt.get(k, "")) for k in ("seconds", "cpu_s", "peak_mib")]
        rows.append([name, why or "up to date", *numbers, counts])
    show_table(["stage", "state", "seconds", "CPU s", "peak MiB", "counts"], rows)
    return 0
