"""`tiegraph export OUT FOLDER`: the depth maps as a dense workspace of COLMAP."""

from __future__ import annotations

from pathlib import Path

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say


def main(arguments: list[str]) -> int:
    """`tiegraph export`."""

    def export(out: tyro.conf.Positional[Path], folder: tyro.conf.Positional[Path]) -> tuple[Path, Path]:
        """Write undistorted images, model, depth and normal maps for COLMAP's stereo_fusion and meshers.

        Args:
            out: A run folder with depth maps.
            folder: The workspace to make; it must not exist or be empty.
        """
        return out, folder

    out, folder = options_of(export, "tiegraph export", arguments)
    count = open_project(None, out).export(folder)
    say(f"{count} depth maps: {folder} (colmap stereo_fusion --workspace_path {folder} ...)")
    return 0
