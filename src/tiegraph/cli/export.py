"""`tiegraph export OUT FOLDER`: the depth maps as a dense workspace of COLMAP."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say


@dataclass(frozen=True)
class _Export:
    """Write undistorted images, model, depth and normal maps for COLMAP's stereo_fusion and meshers."""

    out: tyro.conf.Positional[Path]
    """A run folder with depth maps."""
    folder: tyro.conf.Positional[Path]
    """The workspace to make; it must not exist or be empty."""


def main(arguments: list[str]) -> int:
    """`tiegraph export`."""
    asked = options_of(_Export, "tiegraph export", arguments)
    count = open_project(None, asked.out).export(asked.folder)
    say(f"{count} depth maps: {asked.folder} (colmap stereo_fusion --workspace_path {asked.folder} ...)")
    return 0
