"""`tiegraph profile OUT --line E,N E,N ...`: heights of a map along a line, as CSV and SVG."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.scene.atomic import must_be_new


@dataclass(frozen=True)
class _Profile:
    """Heights of surface and terrain along a line over the map of a run, with their sigmas: CSV, and a chart as SVG."""

    run: tyro.conf.Positional[Path]
    """A run folder with a map (products)."""
    line: tuple[str, ...]
    """Places of the line as E,N E,N ... in the CRS of the survey; or a file with a line: GeoJSON, GeoPackage, DXF, CSV
    of east and north."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("profile.csv")
    """The CSV to write; the chart has its name and ends in .svg."""


def main(arguments: list[str]) -> int:
    """`tiegraph profile`."""
    west = [f" {a}" if re.match(r"-[\d.]", a) else a for a in arguments]  # places, not options
    asked = options_of(_Profile, "tiegraph profile", west)
    from tiegraph.pipeline.measure import make_profile  # loads the engine

    for path in (asked.out, asked.out.with_suffix(".svg")):
        must_be_new(asked.out, path)
    found = make_profile(asked.run, asked.line, asked.out)
    length = f"{found.distance[-1]:.2f} {found.unit}"
    say(f"{len(found.distance)} heights along {length}: {asked.out}, {asked.out.with_suffix('.svg')}")
    return 0
