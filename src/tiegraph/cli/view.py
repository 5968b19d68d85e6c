"""`tiegraph view OUT`: a finished run in the browser."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say


@dataclass(frozen=True)
class _View:
    """Show a finished run in a page of the browser: cloud, cameras, tie graph, maps; coordinates with their sigma, and
    the images that see a place."""

    folder: tyro.conf.Positional[Path]
    """A run folder with a cloud."""
    port: int = 0
    """Port on 127.0.0.1 (0 = any that is free)."""
    browser: bool = True
    """Open the page in the browser."""


def main(arguments: list[str]) -> int:
    """`tiegraph view`."""
    options = options_of(_View, "tiegraph view", arguments)
    from tiegraph.pipeline.pages import ViewServer  # loads the engines
    from tiegraph.pipeline.view import open_view

    viewed = open_view(open_project(None, options.folder).as_run())
    server = ViewServer(viewed, options.port)
    say(f"{viewed.points} points, {len(viewed.images)} images")
    say(f"{server.url}  (ends with Ctrl-C)")
    server.serve_until_interrupted(options.browser)
    return 0
