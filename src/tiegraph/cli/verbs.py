"""The table of verbs: what each is for, and the module that is loaded when it is asked for.

The modules import the engines with all their libraries, seconds of work: `tiegraph --help` reads only this table.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module

HELP, HELP_ALL = ("-h", "--help"), "--help-all"

RUN_PAGE = """\
usage: tiegraph run IMAGES [-o OUT] [OPTIONS]

From a folder of images to the cloud and the report. Run again, it goes on.

inputs:
  IMAGES            folder of images, videos, ROS bags (BAG:TOPIC,...); or a URL
  --rig RIG         rig.toml, rig_config.json, OUT of another run, ring:N, ...
  --camera CAMERA   a single camera's calibration: a file, or MODEL,parameters
  --gnss FILE       CSV, NMEA, .pos, GPX, KML, geo.txt, SBET, MRK, a ROS bag
  --trajectory PATH TUM, EuRoC, KITTI, COLMAP, ...; auto: odometry of the images
  --start MODEL     go on from COLMAP, OpenSfM/ODM, nerfstudio or Metashape
  --gcp, --marks    control and check points; their marks, if in another file
  --times CSV       frames' times where EXIF has none: pass, frame, time

options:
  -o, --out OUT     the run folder (default: <IMAGES>_tiegraph beside them)
  --tolerance M     is it so good in the world, metres? yes, no, or why not told
  --until STAGE     the last stage to run; --plan: say what room, time it needs
  --preset NAME     fast, close-range, conventional, meguro2024 or meguro2025
  --unset KEY       forget a stored input or setting; --keep results: no depths
  --pool POOL       serial, local, local:<workers>, dask:<address>, slurm:<jobs>
  --json, --quiet   JSON lines; nothing but errors; --strict: exit 3 if doubtful
  -h, --help        this page; --help-all: all, as --scan.crs, --masks.folder"""
"""The short help page of `tiegraph run`: one screen of 24 lines of 80 letters, there without loading anything.

Written by hand, for the options' own texts fill 400 lines (`--help-all`); a test holds it to ``cli.run.RunOptions``.
"""


@dataclass(frozen=True)
class Verb:
    """One line of the table."""

    about: str  # one line of help
    of: str = "run.main_stage"  # of tiegraph.cli: "module.name" of a function of the arguments that returns the exit
    # code (the default's first argument is the verb, a stage and no more), or of a class of options with ``run``
    page: str = ""  # the short help, where the full one fills many screens

    def load(self, name: str) -> Callable[[list[str]], int]:
        """Import what the verb of this name is; the function that takes the arguments.

        pycolmap takes the signals over when it is imported. It is so now, and never later: the caller takes them back.
        """
        import_module("pycolmap")
        module, own = self.of.split(".")
        found = getattr(import_module(f"tiegraph.cli.{module}"), own)
        if self.of == Verb.of:
            return partial(found, name)
        if not isinstance(found, type):
            return found  # type: ignore[no-any-return]
        options_of = import_module("tiegraph.cli.options").options_of
        return lambda arguments: options_of(found, f"tiegraph {name}", arguments).run()  # type: ignore[no-any-return]


def wants_page(arguments: Sequence[str]) -> bool:
    """Whether the short help page is asked for; with ``--help-all`` it is every option."""
    return any(a in HELP for a in arguments) and HELP_ALL not in arguments


VERBS: dict[str, Verb] = {
    "run": Verb("from a folder of images to the cloud and the report (or --until a stage)", "run.main", page=RUN_PAGE),
    "demo": Verb("the example survey, from images to the report", "begin.Demo"),
    "init": Verb("show what is found in a folder; write tiegraph.toml and rig.toml to edit", "begin.Init"),
    "status": Verb("which stages of a run folder are up to date, and why not", "results.Status"),
    "compare": Verb("what has changed between two surveys; --passes: between two passes of one", "results.compare"),
    "shots": Verb("a point cloud for each shot of a calibrated rig, without a sparse model", "surveys.Shots"),
    "stations": Verb("clouds of single shots, without poses, joined to one cloud", "surveys.Stations"),
    "calibrate": Verb("cameras and rig from images of a board (ChArUco, checkerboard, AprilGrid)", "surveys.Calibrate"),
    "plan": Verb("what a survey will give: precision by distance, accuracy of a whole path, effort", "surveys.Plan"),
    "serve": Verb("a page in the browser to hand images over, start and follow a run", "pages.Serve"),
    "mark": Verb("a page in the browser to mark control points in the images", "pages.Mark"),
    "view": Verb("a finished run in the browser: cloud, cameras, tie graph, maps", "pages.View"),
    "lidar": Verb("trajectory and map of a LiDAR by its scans, and a run beside them", "surveys.Lidar"),
    "watch": Verb("on site: previews, ties, path and surface coverage of images while they arrive", "pages.Watch"),
    "odometry": Verb("the path of a stereo camera, a rig or a single camera from the images alone", "surveys.Odometry"),
    "rig": Verb("the rig and cameras as a run found them, as rig.toml or COLMAP's rig_config.json", "results.Rig"),
    "export": Verb("a folder for another program: nerfstudio, COLMAP, gsplat, OpenMVS, GIS", "results.Export"),
    "mesh": Verb("a textured mesh of a finished run, as GLB, OBJ and PLY"),
    "profile": Verb("heights of a map along a line, with sigmas: a table and a chart", "results.profile"),
    "volume": Verb("cut and fill inside polygons on a map, from a plane, a height or another survey", "results.Volume"),
    "doctor": Verb("versions, cores, memory, disk, and what is missing", "doctor.Doctor"),
    # The stages, as in pipeline.STAGES (tests/cli/test_cli_verbs.py holds them together).
    "scan": Verb("stage: makes scene.json, whole.json, images, odometry"),
    "masks": Verb("stage: makes masks, classes, masks.csv; --compare FOLDER: against true masks", "forms.masks"),
    "preview": Verb("stage: makes preview"),
    "candidates": Verb("stage: makes candidates.npz, candidates"),
    "coarse": Verb("stage: makes coarse.npz, coarse"),
    "network": Verb("stage: makes network.npz, network.csv, network; --coverage: what is missing", "forms.network"),
    "design": Verb("stage: makes pairs.npz, pairs.txt, pairs, design"),
    "features": Verb("stage: makes database.db"),
    "match": Verb("stage: makes match.npz"),
    "sparse": Verb("stage: makes sparse"),
    "georef": Verb("stage: makes sparse/world, world.json"),
    "refine": Verb("stage: makes refine/masks, refine/classes"),
    "dense": Verb("stage: makes depth"),
    "cloud": Verb("stage: makes cloud.copc.laz, cloud.laz, cloud.ply, passes"),
    "products": Verb("stage: makes products; surface models and true orthophotos of ground or walls"),
    "evaluate": Verb("stage: makes metrics.json, accuracy.csv, evaluate; or compares two clouds", "forms.evaluate"),
    "report": Verb("stage: makes report.html, report.json; --pdf, --language ja", "forms.report"),
}
