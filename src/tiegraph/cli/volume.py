"""`tiegraph volume OUT --polygon FILE`: cut and fill between the surface of a map and a base, with sigmas."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.scene.atomic import must_be_new, replacing


@dataclass(frozen=True)
class _Volume:
    """Cut, fill and net volume inside polygons on the map of a run, each with the sigma of what all its pixels
    share."""

    run: tyro.conf.Positional[Path]
    """A run folder with a map (products)."""
    polygon: Path
    """Polygons around what is measured, drawn on the ground: GeoJSON, GeoPackage, DXF, CSV of east and north."""
    base: str = "plane"
    """From where: plane = fitted to the ground around each polygon, lowest = level at the lowest ground around, a
    height in the CRS, or the run folder of another survey."""
    surface: Literal["dsm", "dtm"] = "dsm"
    """What is measured: the surface with all that stands on it, or the terrain."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Also write all figures as JSON."""
    json: bool = False
    """Print that instead of sentences."""


def main(arguments: list[str]) -> int:
    """`tiegraph volume`."""
    asked = options_of(_Volume, "tiegraph volume", arguments)
    from tiegraph.pipeline.measure import measure_volumes, said  # loads the engine

    if asked.out is not None:
        must_be_new(asked.out)
    tuning = open_project(None, asked.run).settings.tuning.products.volumes
    found = measure_volumes(asked.run, asked.polygon, tuning, asked.base, asked.surface)
    text = json.dumps({"run": str(asked.run), "polygons": found}, indent=1, allow_nan=False)
    if asked.out is not None:
        with replacing(asked.out) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")
    if asked.json:
        say(text)
        return 0
    for number, each in enumerate(found, 1):
        say(said(each) if len(found) == 1 else f"{number}: {said(each)}")
    return 0
