"""`tiegraph mark OUT --points FILE`: a page in the browser to mark control points in the images."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say


@dataclass(frozen=True)
class _Mark:
    """Mark control points in a page of the browser: predicted places, zoomed patches of all images that see them."""

    folder: tyro.conf.Positional[Path]
    """A run folder, scanned at least. With a model (sparse, georef) places are predicted."""
    points: Path | None = None
    """The points: a CSV with name, x, y, z (or name, lat, lon, height), '# crs: EPSG:n' in the first line, or a file of
    --gcp (default: that of the run)."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The file of marks: ODM's gcp_list.txt, or a CSV by its ending, which keeps the sigmas (default: gcp_list.txt
    beside the points). One that is there is gone on with."""
    port: int = 0
    """Port on 127.0.0.1 (0 = any that is free)."""
    browser: bool = True
    """Open the page in the browser."""


def main(arguments: list[str]) -> int:
    """`tiegraph mark`."""
    options = options_of(_Mark, "tiegraph mark", arguments)
    from tiegraph.pipeline.mark import open_marking  # loads the engines
    from tiegraph.pipeline.pages import MarkServer

    project = open_project(None, options.folder)
    given = options.points or project.settings.georef.gcp
    target = options.out or (Path("gcp_list.txt") if given is None else given.with_name("gcp_list.txt"))
    session = open_marking(project.as_run(), options.points, target)
    server = MarkServer(session, options.port)
    say(f"{len(session.file.points)} points; marks go to {target}")
    say(f"{server.url}  (ends with Ctrl-C)")
    server.serve_until_interrupted(options.browser)
    say(f"{len(session.marks)} marks: {target}")
    return 0
