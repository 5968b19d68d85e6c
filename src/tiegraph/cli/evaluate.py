"""`tiegraph evaluate OUT` (the stage) and `tiegraph evaluate CLOUD REFERENCE` (two point clouds)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.cli.run import main_stage
from tiegraph.evaluate.clouds.judge import Question, Register
from tiegraph.pipeline.clouds import evaluate_clouds
from tiegraph.scene.cloudchunks import CLOUD_ENDINGS

_TWO_CLOUDS = "\n\nOr two point clouds: tiegraph evaluate CLOUD REFERENCE (.laz, .las, .ply, .e57; --help after them)."


def main(arguments: list[str]) -> int:
    """The stage for a run folder, or the comparison of two cloud files."""
    files = [a for a in arguments if not a.startswith("-")]
    if len(files) >= 2 and all(Path(f).suffix.lower() in CLOUD_ENDINGS for f in files[:2]):
        return _clouds(arguments)
    return main_stage("evaluate", arguments, about=_TWO_CLOUDS)


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
    result = evaluate_clouds(files, out, question)
    for metric in result["metrics"]:
        value = "-" if metric["value"] is None else f"{metric['value']:.4g}"
        say(f"{metric['name']:<24} {value} {metric['unit']}")
    for name, content in result["tables"].items():
        rows = [[f"{v:.3g}" if isinstance(v, float) else "" if v is None else v for v in r] for r in content["rows"]]
        show_table(content["columns"], rows, name)
    for note in result["notes"]:
        say(note)
    return 0
