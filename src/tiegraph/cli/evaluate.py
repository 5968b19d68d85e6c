"""`tiegraph evaluate OUT` (the stage), `evaluate OUT POSES` (poses alone), `evaluate CLOUD REFERENCE` (two clouds)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.cli.run import main_stage
from tiegraph.evaluate.clouds.judge import Question, Register
from tiegraph.pipeline.clouds import evaluate_clouds
from tiegraph.pipeline.evaluate import evaluate_poses
from tiegraph.project.verbtunings import read_tunings
from tiegraph.scene.cloudchunks import CLOUD_ENDINGS

_OTHERS = (
    "\n\nOr the poses of a run to georef, without its cloud: tiegraph evaluate OUT POSES. Or two point clouds: "
    "tiegraph evaluate CLOUD REFERENCE (.laz, .las, .ply, .e57). --help after them."
)


def main(arguments: list[str]) -> int:
    """The stage for a run folder, or the comparison of two cloud files."""
    files = [a for a in arguments if not a.startswith("-")]
    if files and Path(files[0]).suffix.lower() in CLOUD_ENDINGS and not Path(files[0]).is_dir():
        asked = options_of(_Clouds, "tiegraph evaluate", arguments)  # says so if the other is missing, or no cloud
        question = Question(distances_m=asked.distances_m, register=asked.register, coarse=asked.coarse)
        tuning = read_tunings(asked.tuning).evaluate
        _show(evaluate_clouds((asked.cloud, asked.reference), asked.out, question, tuning))
        return 0
    if len(arguments) >= 2 and Path(arguments[0]).is_dir() and not arguments[1].startswith("-"):
        return _poses(arguments)
    return main_stage("evaluate", arguments, about=_OTHERS)


@dataclass(frozen=True)
class _Poses:
    """How near the poses of a run are to reference poses; it needs no cloud, and nothing is written."""

    run: tyro.conf.Positional[Path]
    """A run folder with a model in the world (to the stage georef)."""
    poses: tyro.conf.Positional[Path]
    """Reference poses as --evaluate.reference takes them: a COLMAP model, a TUM file, a folder of them."""
    reference_origin: tuple[float, float, float] | None = None
    """Latitude, longitude (degrees) and ellipsoidal height (m) of the origin of the reference's east, north, up;
    without it only errors after an alignment are stated."""


def _poses(arguments: list[str]) -> int:
    asked = options_of(_Poses, "tiegraph evaluate OUT POSES", arguments)
    result = evaluate_poses(open_project(None, asked.run).as_run(), asked.poses, asked.reference_origin)
    _show(result)
    for text in result["contradictions"]:
        say(f"contradiction: {text}")
    return 0


@dataclass(frozen=True)
class _Clouds:
    """How near a point cloud is to a reference cloud; of any size, tile by tile."""

    cloud: tyro.conf.Positional[Path]
    """The cloud to judge (.laz, .las, .copc.laz, .ply or .e57)."""
    reference: tyro.conf.Positional[Path]
    """The cloud that counts as true; brought into the CRS of the other where both headers name one."""
    distances_m: tuple[float, ...] = ()
    """Distances in metres at which accuracy, completeness and F-score are stated (default: four that fit the cloud's
    spacing)."""
    register: Register = "none"
    """Lay the cloud on the reference first, by ICP: as a rigid motion or with its scale. What was found is part of the
    result."""
    coarse: bool = False
    """The cloud is far off or turned: start the registration by the shapes of both."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for metrics.json, the map of differences and both clouds with their distances."""
    tuning: Path | None = None
    """A file with other constants: the table [tuning.evaluate]."""


def _show(result: dict[str, Any]) -> None:
    for metric in result["metrics"]:
        value = "-" if metric["value"] is None else f"{metric['value']:.4g}"
        say(f"{metric['name']:<24} {value} {metric['unit']}")
    for name, content in result["tables"].items():
        show_table(content["columns"], content["rows"], name, ".3g")
    for note in result["notes"]:
        say(note)
