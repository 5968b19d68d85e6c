"""`tiegraph export OUT FOLDER --to NAME`: a folder for another program."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import Talk, options_of
from tiegraph.cli.output import say
from tiegraph.export import Name


@dataclass(frozen=True, kw_only=True)
class _Export(Talk):
    """Write a folder for another program: images, masks, depth and model, trajectories, maps, or the cloud."""

    out: tyro.conf.Positional[Path]
    """A run folder with a model in the world (dense: with depth maps)."""
    folder: tyro.conf.Positional[Path]
    """The folder to make; it must not exist or be empty."""
    to: Name = "dense"
    """For whom: dense = images, model, depth and normal maps for COLMAP's stereo_fusion and meshers; nerfstudio; colmap
    and openmvs = undistorted images and model; gsplat = the same for 3D Gaussian splatting (Inria's too); bundler;
    opensfm; tum, kitti = trajectories; geojson, gpkg = cameras, views and tie graph for GIS; e57 = the cloud."""
    camera: str = ""
    """tum, kitti: the camera whose trajectory it is (default: the rig's, which is its first camera)."""


def main(arguments: list[str]) -> int:
    """`tiegraph export`."""
    asked = options_of(_Export, "tiegraph export", arguments)
    count = open_project(None, asked.out).export(asked.folder, asked.to, asked.camera, asked.reporter())
    if asked.to == "dense":
        say(f"{count} depth maps: {asked.folder} (colmap stereo_fusion --workspace_path {asked.folder} ...)")
    elif asked.to == "e57":
        say(f"{count} points: {asked.folder}")
    else:
        say(f"{count} for {asked.to}: {asked.folder}")
    return 0
