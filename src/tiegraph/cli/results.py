"""Verbs that read finished runs: `status`, `rig`, `export`, `profile`, `volume` and `compare`."""

import json as json_text
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import Talk, options_of
from tiegraph.cli.output import complain, say, show_table
from tiegraph.export import Name
from tiegraph.project.progress import Reporter
from tiegraph.project.stages import write_atomic
from tiegraph.project.stores import url_of
from tiegraph.scene.atomic import must_be_new
from tiegraph.text import counted

_SHOWN = 10  # changes; the others stand in changes.csv


@dataclass(frozen=True)
class Status:
    """Which stages of a run folder are up to date, and why not."""

    out: tyro.conf.Positional[Path]
    """A run folder made by `tiegraph run`."""

    def run(self) -> int:
        rows = []
        for name, why, receipt in open_project(None, self.out).status():
            numbers = [str(receipt.get(k, "")) for k in ("seconds", "cpu_s", "peak_mib")]
            rows.append([name, why or "up to date", *numbers, counted(receipt.get("counts", {}))])
        show_table(["stage", "state", "seconds", "CPU s", "peak MiB", "counts"], rows)
        return 0


@dataclass(frozen=True)
class Rig:
    """Write the rig as a run found it: cameras, places and turns in the rig, with their sigmas.

    Read it with --rig in the next run; `tiegraph run IMAGES --rig FOLDER` takes it from the run folder at once.
    """

    folder: tyro.conf.Positional[Path]
    """A run folder with a sparse model."""
    out: Annotated[Path | None, tyro.conf.arg(name="out", aliases=["-o"])] = None
    """The file to write; it must not exist (default: standard output)."""
    format: Literal["rig", "rig_config"] = "rig"
    """rig = a rig.toml with sigmas, lengths in metres; rig_config = COLMAP's rig_config.json, which has neither."""

    def run(self) -> int:
        if self.out is not None:
            must_be_new(self.out)
        text, said = open_project(None, self.folder).rig_file(self.format)
        if self.out is not None:
            write_atomic(self.out, text)
            say(f"written: {self.out}")
        else:
            say(text.rstrip("\n"))
        for line in said if self.format != "rig" else ():  # a rig.toml has them as comments
            complain(line)
        return 0


@dataclass(frozen=True, kw_only=True)
class Export(Talk):
    """Write a folder for another program: images, masks, depth and model, trajectories, maps, or the cloud."""

    out: tyro.conf.Positional[Path]
    """A run folder with a model in the world (dense: with depth maps)."""
    folder: tyro.conf.Positional[Path]
    """The folder to make, or the URL of a place in a store (s3://bucket/results); it must not exist or be empty."""
    to: Name = "dense"
    """For whom: dense = images, model, depth and normal maps for COLMAP's stereo_fusion and meshers; nerfstudio; colmap
    and openmvs = undistorted images and model; gsplat = the same for 3D Gaussian splatting (Inria's too); bundler;
    opensfm; opf = Pix4D's open format; metashape; tum, kitti = trajectories; geojson, gpkg = cameras, views and tie
    graph for GIS; e57, potree = the cloud; 3dtiles = cloud and mesh for CesiumJS; results = report, cloud,
    maps and figures as they are."""
    camera: str = ""
    """tum, kitti: the camera whose trajectory it is (default: the rig's, which is its first camera)."""

    def run(self) -> int:
        count = open_project(None, self.out).export(self.folder, self.to, self.camera, self.reporter())
        place = url_of(self.folder) or self.folder
        if self.to == "dense":
            say(f"{count} depth maps: {place} (colmap stereo_fusion --workspace_path {place} ...)")
        elif self.to in ("e57", "3dtiles", "potree", "results"):
            say(f"{count} {'files' if self.to == 'results' else 'points'}: {place}")
        else:
            say(f"{count} for {self.to}: {place}")
        return 0


@dataclass(frozen=True)
class _Profile:
    """Heights of surface and terrain along a line over the map of a run, with their sigmas: CSV, and a chart as SVG."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="run")]
    """A run folder with a map (products)."""
    line: tuple[str, ...]
    """Places of the line as E,N E,N ... in the CRS of the survey; or a file with a line: GeoJSON, GeoPackage, DXF, CSV
    of east and north."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("profile.csv")
    """The CSV to write, or a GeoPackage (.gpkg) of points; the chart has its name and ends in .svg."""

    def run(self) -> int:
        from tiegraph.pipeline.measure import make_profile

        chart = self.out.with_suffix(".svg")
        for path in (self.out, chart):
            must_be_new(self.out, path)
        found = make_profile(self.folder, self.line, self.out)
        say(f"{len(found.distance)} heights along {found.distance[-1]:.2f} {found.unit}: {self.out}, {chart}")
        return 0


def profile(arguments: Sequence[str]) -> int:
    """`tiegraph profile`."""
    west = [f" {a}" if re.match(r"-[\d.]", a) else a for a in arguments]  # places, not options
    return options_of(_Profile, "tiegraph profile", west).run()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Volume:
    """Cut, fill and net volume inside polygons on the map of a run, each with the sigma of what all its pixels
    share."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="run")]
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

    def run(self) -> int:
        from tiegraph.pipeline.measure import measure_volumes, said

        if self.out is not None:
            must_be_new(self.out)
        tuning = open_project(None, self.folder).settings.tuning.products.volumes
        found = measure_volumes(self.folder, self.polygon, tuning, self.base, self.surface)
        text = json_text.dumps({"run": str(self.folder), "polygons": found}, indent=1, allow_nan=False)
        if self.out is not None:
            write_atomic(self.out, text + "\n")
        if self.json:
            say(text)
            return 0
        for number, each in enumerate(found, 1):
            say(said(each) if len(found) == 1 else f"{number}: {said(each)}")
        return 0


@dataclass(frozen=True)
class _Epochs:
    """What has changed between two surveys of one place, by M3C2 with both surveys' sigmas; `--epochs` may be said.

    With --passes: how well two passes of one survey agree (--passes --help). With --baseline: another method on a block
    of a survey (--baseline colmap --help).
    """

    first: tyro.conf.Positional[Path]
    """The run folder of the earlier survey, whose constants ([tuning.evaluate]) count."""
    second: tyro.conf.Positional[Path]
    """That of the later one."""
    register: Literal["none", "rigid"] = "none"
    """Register the second cloud to the first by ICP instead of trusting both georeferences; most of the surface must
    be unchanged. Its sigma then replaces the surveys' own."""
    coarse: bool = False
    """The second cloud is displaced or rotated by much: start the registration by the shapes of both."""
    depth_m: float | None = None
    """Largest difference that is searched for, to either side (default: by the spacing of the clouds)."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("changes")
    """The folder to write: changes.json, changes.csv, changes.png, changes.laz."""

    def run(self) -> int:
        from tiegraph.pipeline.clouds import compare_epochs

        folders = self.first, self.second
        return _say_changes(compare_epochs(folders, self.out, self.register, self.coarse, self.depth_m), self.out)


@dataclass(frozen=True)
class _Passes:
    """How well the clouds of the two largest passes of one survey agree, by M3C2; no reference is needed."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="run")]
    """A run folder with depth maps."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("passes")
    """The folder to write: changes.json, changes.csv, changes.png, changes.laz."""
    depth_m: float | None = None
    """Largest difference that is looked for, to either side (default: by the spacing of the clouds)."""

    def run(self) -> int:
        from tiegraph.pipeline.clouds import compare_passes

        made = compare_passes(open_project(None, self.folder).as_run(), self.out, self.depth_m)
        return _say_changes(made, self.out)


@dataclass(frozen=True)
class _Baseline:
    """Another method on a block of a finished survey: what it costs at equal registration."""

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="run")]
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

    def run(self) -> int:
        project = open_project(None, self.folder, pool=self.pool)
        result = project.baseline(self.baseline, self.sample, self.out, Reporter("quiet" if self.quiet else "auto"))
        for part in ("figures", "stages", "sections"):
            show_table(result[part]["columns"], result[part]["rows"], part, ".4g")
        for text in (*result["speed_up"], *result["notes"]):
            say(text)
        return 0


def compare(arguments: Sequence[str]) -> int:
    """`tiegraph compare`: what has changed between two surveys; another method on a block."""
    forms = {"--epochs": _Epochs, "--passes": _Passes, "--baseline": _Baseline}
    flag = next((f for f in forms if f in {a.partition("=")[0] for a in arguments}), "")
    rest = [a for a in arguments if a != flag or flag == "--baseline"]  # which has a value
    return options_of(forms.get(flag, _Epochs), f"tiegraph compare {flag}".strip(), rest).run()  # type: ignore[no-any-return]


def _say_changes(result: dict[str, Any], out: Path) -> int:
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
    return 0
