"""`tiegraph evaluate OUT` (the stage), `evaluate OUT POSES` (poses alone), `evaluate CLOUD REFERENCE` (two clouds)."""

from __future__ import annotations

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
from tiegraph.project.run import Run
from tiegraph.scene.cloudchunks import CLOUD_ENDINGS

_OTHERS = (
    "\n\nOr the poses of a run to georef, without its cloud: tiegraph evaluate OUT POSES. Or two point clouds: "
    "tiegraph evaluate CLOUD REFERENCE (.laz, .las, .ply, .e57). --help after them."
)


def main(arguments: list[str]) -> int:
    """The stage for a run folder, or the comparison of two cloud files."""
    files = [a for a in arguments if not a.startswith("-")]
    if files and Path(files[0]).suffix.lower() in CLOUD_ENDINGS and not Path(files[0]).is_dir():
        return _clouds(arguments)  # that says so if the other is missing, or no cloud
    if len(arguments) >= 2 and Path(arguments[0]).is_dir() and not arguments[1].startswith("-"):
        return _poses(arguments)
    return main_stage("evaluate", arguments, about=_OTHERS)


def _poses(arguments: list[str]) -> int:
    def evaluate(
        run: tyro.conf.Positional[Path],
        poses: tyro.conf.Positional[Path],
        reference_origin: tuple[float, float, float] | None = None,
    ) -> tuple[Path, Path, tuple[float, float, float] | None]:
        """How near the poses of a run are to reference poses; it needs no cloud, and nothing is written.

        Args:
            run: A run folder with a model in the world (to the stage georef).
            poses: Reference poses as --evaluate.reference takes them: a COLMAP model, a TUM file, a folder of them.
            reference_origin: Latitude, longitude (degrees) and ellipsoidal height (m) of the origin of the
                reference's east, north, up; without it only errors after an alignment are stated.
        """
        return run, poses, reference_origin

    folder, reference, origin = options_of(evaluate, "tiegraph evaluate OUT POSES", arguments)
    project = open_project(None, folder)
    result = evaluate_poses(Run(project.folder, project.inputs, project.settings), reference, origin)
    _show(result)
    for text in result["contradictions"]:
        say(f"contradiction: {text}")
    return 0


def _clouds(arguments: list[str]) -> int:
    def evaluate(
        cloud: tyro.conf.Positional[Path],
        reference: tyro.conf.Positional[Path],
        distances_m: tuple[float, ...] = (),
        register: Register = "none",
        coarse: bool = False,
        out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None,
    ) -> tuple[tuple[Path, Path], Path | None, Question]:
        """How near a point cloud is to a reference cloud; of any size, tile by tile.

        Args:
            cloud: The cloud to judge (.laz, .las, .copc.laz, .ply or .e57).
            reference: The cloud that counts as true; brought into the CRS of the other where both headers name one.
            distances_m: Distances in metres at which accuracy, completeness and F-score are stated (default: four that
                fit the cloud's spacing).
            register: Lay the cloud on the reference first, by ICP: as a rigid motion or with its scale. What was
                found is part of the result.
            coarse: The cloud is far off or turned: start the registration by the shapes of both.
            out: Folder for metrics.json, the map of differences and both clouds with their distances.
        """
        return (cloud, reference), out, Question(distances_m=distances_m, register=register, coarse=coarse)

    files, out, question = options_of(evaluate, "tiegraph evaluate", arguments)
    _show(evaluate_clouds(files, out, question))
    return 0


def _show(result: dict[str, Any]) -> None:
    for metric in result["metrics"]:
        value = "-" if metric["value"] is None else f"{metric['value']:.4g}"
        say(f"{metric['name']:<24} {value} {metric['unit']}")
    for name, content in result["tables"].items():
        rows = [[f"{v:.3g}" if isinstance(v, float) else "" if v is None else v for v in r] for r in content["rows"]]
        show_table(content["columns"], rows, name)
    for note in result["notes"]:
        say(note)
