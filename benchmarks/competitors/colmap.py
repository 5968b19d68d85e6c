"""The competitors of COLMAP, with its defaults (``tiegraph.papers.colmap``).

COLMAP's words, after ``--``: ``sequential`` or ``spatial`` (positions in EXIF) in place of every pair; ``mixed``,
cameras told apart by EXIF; ``rig``; ``global``, GLOMAP's mapper (COLMAP has it since 4.0), after the calibration of the
view graph that comes before it.

The program writes ``--json`` again after each stage, so that a time-out or an abort of the native library loses only
the stage that was running.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from command import arguments

from tiegraph.papers.colmap import Given, Models, incremental, reconstruct
from tiegraph.papers.measured import Stages

import pycolmap  # isort: skip

WORDS = ("sequential", "spatial", "mixed", "rig", "global")


def main() -> None:
    """Extract, match, map with pycolmap's defaults: one camera a folder."""
    args = arguments(__doc__.splitlines()[0])
    unknown = set(args.options) - set(WORDS)
    if unknown:
        raise SystemExit(f"unknown {', '.join(sorted(unknown))}: valid are {', '.join(WORDS)}")
    stages = Stages(args.json)
    if args.base is not None:
        stages.go_on(args.base.parent / args.json.name)
        shutil.copy(args.base / "database.db", args.out)
    cameras = json.loads(args.cameras.read_text()) if args.cameras else {}
    ways = {"sequential": pycolmap.match_sequential, "spatial": pycolmap.match_spatial}
    match = next((way for word, way in ways.items() if word in args.options), pycolmap.match_exhaustive)
    mapped = global_models if "global" in args.options else incremental
    if "rig" not in args.options:
        given = Given(cameras, mixed="mixed" in args.options, seed=args.seed)
        return reconstruct(stages, args.images, args.out, match, given, mapped)
    if args.rig is None:
        return stages.end("the set has no rig")
    images, names = _folders_of_sensors(args.images, Path(args.rig), args.out / "images")
    given = Given(cameras, Path(args.rig), args.hold_rig, names, seed=args.seed)
    reconstruct(stages, images, args.out, match, given, mapped)


def global_models(database: Path, images: Path, sparse: Path, given: Given) -> Models:
    """The models of GLOMAP's mapper by number; the view graph is calibrated first where no calibration is given."""
    if not given.cameras:
        pycolmap.calibrate_view_graph(database)
    options = pycolmap.GlobalPipelineOptions(random_seed=given.seed)
    options.mapper.refine_sensor_from_rig = not given.held
    return pycolmap.global_mapping(database, images, sparse, options)


def _folders_of_sensors(images: Path, rig: Path, target: Path) -> tuple[Path, dict[str, str]]:
    """Links ``<sensor>/<pass>_<image>`` to images ``<pass>/<sensor>/<image>``, and the old names by the new ones.

    COLMAP takes what follows the prefix for the frame; with the pass before it, each pass would be a rig of its own.
    """
    sensors = {Path(c["image_prefix"]).name for r in json.loads(rig.read_text()) for c in r["cameras"]}
    names = {}
    for path in sorted(p for p in images.rglob("*") if p.is_file()):
        old = path.relative_to(images)
        sensor = next((part for part in old.parts[:-1] if part in sensors), None)
        if sensor is not None:
            new = f"{sensor}/{'_'.join(part for part in old.parts if part != sensor)}"
            (target / new).parent.mkdir(parents=True, exist_ok=True)
            (target / new).symlink_to(path.resolve())
            names[new] = old.as_posix()
    return target, names


if __name__ == "__main__":
    main()
