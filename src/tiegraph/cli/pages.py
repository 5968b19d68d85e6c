"""Verbs that open a page in the browser: `serve FOLDER`, `mark OUT`, `view OUT` and `watch FOLDER`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import Talk
from tiegraph.cli.output import say
from tiegraph.errors import InputError
from tiegraph.project.settings import read_tunings
from tiegraph.scene.atomic import real_path


@dataclass(frozen=True, kw_only=True)
class _Page:
    """Options of every page."""

    port: int = 0
    """Port on 127.0.0.1 (0 = any that is free)."""
    browser: bool = True
    """Open the page in the browser."""


@dataclass(frozen=True, kw_only=True)
class Serve(_Page):
    """Hand images over to a page in the browser, look at what was found, start a run, follow it and read its report."""

    folder: tyro.conf.Positional[Path]
    """The folder of the images; a new one is made. What is there already is used, and never changed."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The run folder (default: <FOLDER>_tiegraph beside the folder)."""

    def run(self) -> int:
        from tiegraph.pipeline.pages import PageServer
        from tiegraph.pipeline.serve import ServeHandler, Session

        images = real_path(self.folder)
        if images.exists() and not images.is_dir():
            raise InputError(f"{images}: is a file; give the folder of the images, or a new one")
        session = Session(images, (self.out or images.with_name(images.name + "_tiegraph")).absolute())
        server = PageServer(ServeHandler, session, self.port)
        say(f"images: {session.images}; results: {session.out}")
        say(f"{server.url}  (ends with Ctrl-C, and a run with it; finished work is kept)")
        try:
            server.serve_until_interrupted(self.browser)
        finally:
            session.close()
        return 0


@dataclass(frozen=True, kw_only=True)
class Mark(_Page):
    """Mark control points in a page of the browser: predicted places, zoomed patches of all images that see them."""

    folder: tyro.conf.Positional[Path]
    """A run folder, scanned at least. With a model (sparse, georef) places are predicted."""
    points: Path | None = None
    """The points: a CSV with name, x, y, z (or name, lat, lon, height), '# crs: EPSG:n' in the first line, or a file of
    --gcp (default: that of the run)."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The file of marks: ODM's gcp_list.txt, or a CSV by its ending, which keeps the sigmas (default: gcp_list.txt
    beside the points). One that is there is gone on with."""

    def run(self) -> int:
        from tiegraph.pipeline.mark import open_marking
        from tiegraph.pipeline.pages import MarkHandler, PageServer

        project = open_project(None, self.folder)
        given = self.points or project.settings.georef.gcp
        target = self.out or (Path("gcp_list.txt") if given is None else given.with_name("gcp_list.txt"))
        session = open_marking(project.as_run(), self.points, target)
        server = PageServer(MarkHandler, session, self.port)
        say(f"{len(session.file.points)} points; marks go to {target}")
        say(f"{server.url}  (ends with Ctrl-C)")
        server.serve_until_interrupted(self.browser)
        say(f"{len(session.marks)} marks: {target}")
        return 0


@dataclass(frozen=True, kw_only=True)
class View(_Page):
    """Show a finished run in a page of the browser: cloud, cameras, tie graph, maps; coordinates with their sigma, and
    the images that see a place."""

    folder: tyro.conf.Positional[Path]
    """A run folder with a cloud."""

    def run(self) -> int:
        from tiegraph.pipeline.pages import PageServer, ViewHandler
        from tiegraph.pipeline.view import open_view

        viewed = open_view(open_project(None, self.folder).as_run())
        server = PageServer(ViewHandler, viewed, self.port)
        say(f"{viewed.points} points, {len(viewed.images)} images")
        say(f"{server.url}  (ends with Ctrl-C)")
        server.serve_until_interrupted(self.browser)
        return 0


@dataclass(frozen=True, kw_only=True)
class Watch(Talk):
    """Follow the images of a folder while they arrive: ties, path, surface coverage and where to go again."""

    folder: tyro.conf.Positional[Path]
    """The folder into which images are copied, in any of the layouts of `tiegraph run`."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where what is known is kept (default: <FOLDER>_watch beside the folder); the same again goes on."""
    rig: str | None = None
    """As for `tiegraph run`: a rig.toml, COLMAP's rig_config.json, the folder of a run, or a preset such as ring:N."""
    camera: str | None = None
    """The calibration of a single camera, as for `tiegraph run`."""
    gnss: Path | None = None
    """Positions, as for `tiegraph run`: the plan is in metres then, north up."""
    times: Path | None = None
    """CSV of the frames' times, as for `tiegraph run`: of images that have none, for --gnss."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.watch] and those of the stages that it uses."""
    port: int = 8765
    """Of the page on this machine (127.0.0.1); 0 = any that is free."""

    def run(self) -> int:
        from tiegraph.pipeline.watch import watch

        source = real_path(self.folder)
        out = self.out or source.with_name(source.name + "_watch")
        given = {name: getattr(self, name) for name in ("rig", "camera", "gnss", "times")}
        tunings = read_tunings(self.tuning)
        project = open_project(source, out, pool="serial", settings={"tuning": tunings.of_stages()}, **given)
        watch(project.as_run(self.reporter()), self.port, tunings.watch)
        return 0
