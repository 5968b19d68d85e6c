"""`tiegraph serve FOLDER`: a survey in the browser, from its images to the report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.errors import InputError
from tiegraph.scene.atomic import real_path


@dataclass(frozen=True, kw_only=True)
class _Serve:
    """Hand images over to a page in the browser, look at what was found, start a run, follow it and read its report."""

    folder: tyro.conf.Positional[Path]
    """The folder of the images; a new one is made. What is there already is used, and never changed."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder (default: <FOLDER>_tiegraph beside the folder)."""
    port: int = 0
    """Port on 127.0.0.1 (0 = any that is free)."""
    browser: bool = True
    """Open the page in the browser."""


def main(arguments: list[str]) -> int:
    """`tiegraph serve`."""
    options = options_of(_Serve, "tiegraph serve", arguments)
    from tiegraph.pipeline.serve import Session  # loads the engines
    from tiegraph.pipeline.servepages import ServeServer

    images = real_path(options.folder)
    if images.exists() and not images.is_dir():
        raise InputError(f"{images}: is a file; give the folder of the images, or a new one")
    session = Session(images, (options.out or images.with_name(images.name + "_tiegraph")).absolute())
    server = ServeServer(session, options.port)
    say(f"images: {session.images}; results: {session.out}")
    say(f"{server.url}  (ends with Ctrl-C, and a run with it; finished work is kept)")
    try:
        server.serve_until_interrupted(options.browser)
    finally:
        session.close()
    return 0
