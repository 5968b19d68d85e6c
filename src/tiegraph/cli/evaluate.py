"""`tiegraph evaluate OUT` (the stage) and `tiegraph evaluate CLOUD REFERENCE` (two point clouds)."""

from __future__ import annotations

from pathlib import Path

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.cli.run import main_stage
from tiegraph.evaluate.cloud import cloud_to_cloud
from tiegraph.evaluate.tuning import CloudTuning
from tiegraph.scene.cloudfile import read_cloud

_TWO_CLOUDS = "\n\nOr two point clouds: tiegraph evaluate CLOUD REFERENCE (.laz, .las or .ply; --help after them)."


def main(arguments: list[str]) -> int:
    """The stage for a run folder, or the comparison of two cloud files."""
    files = [a for a in arguments if not a.startswith("-")]
    if len(files) >= 2 and all(Path(f).suffix.lower() in (".las", ".laz", ".ply") for f in files[:2]):
        return _clouds(arguments)
    return main_stage("evaluate", arguments, about=_TWO_CLOUDS)


def _clouds(arguments: list[str]) -> int:
    def evaluate(
        cloud: tyro.conf.Positional[Path],
        reference: tyro.conf.Positional[Path],
        distances_m: tuple[float, ...] = (0.02, 0.05, 0.10, 0.20),
    ) -> tuple[Path, Path, tuple[float, ...]]:
        """How near a point cloud is to a reference cloud in the same coordinates.

        Args:
            cloud: The cloud to judge (.laz, .las or .ply).
            reference: The cloud that counts as true.
            distances_m: Distances in metres at which accuracy, completeness and F-score are stated.
        """
        return cloud, reference, distances_m

    cloud, reference, distances = options_of(evaluate, "tiegraph evaluate", arguments)
    result = cloud_to_cloud(read_cloud(cloud), read_cloud(reference), CloudTuning(), distances)
    for metric in result.metrics():
        say(f"{metric.name:<24} {metric.value:.4g} {metric.unit}")
    for name, content in result.tables().items():
        show_table(content["columns"], [[f"{v:.3g}" for v in row] for row in content["rows"]], name)
    return 0
