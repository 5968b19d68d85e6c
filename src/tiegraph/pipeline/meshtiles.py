"""Glue of the mesh in `tiegraph export --to 3dtiles`: levels of detail of a finished textured mesh."""

from functools import partial
from pathlib import Path

import numpy as np

from tiegraph.child import run_in_child
from tiegraph.export.tiles3d import Place, Tile, write_tree
from tiegraph.mesh.levels import Finished, branches, coarse, fine
from tiegraph.pipeline.files import reading
from tiegraph.pipeline.mesh import FOLDER
from tiegraph.project.run import Run
from tiegraph.scene.atomic import scratch_folder


def write_mesh_tiles(run: Run, place: Place, target: Path) -> None:
    """Write the mesh of a run as tiles that replace each other, with their tree, into a new folder."""
    with reading(run.path(FOLDER, "mesh.glb")):
        found = Finished.read(run.path(FOLDER, "mesh.glb").read_bytes(), run.path(FOLDER, "mesh.ply"))
    whole = found.moved(place.tiles_from_world)
    target.mkdir()
    call = partial(run_in_child, log=run.log, task="COLMAP's simplification")

    def tile(faces: np.ndarray, name: str) -> Tile:
        below = branches(whole, faces)
        with scratch_folder(target) as scratch:
            made = coarse(whole, faces, scratch, call) if below else fine(whole, faces)
        (target / f"{name}.glb").write_bytes(made.glb)
        out = Tile(uri=f"{name}.glb", low=made.low, high=made.high, error=made.error)
        out.below = [tile(part, f"{name}{k}") for k, part in enumerate(below)]
        return out

    write_tree(tile(np.arange(len(whole.mesh.corners)), "t"), place, "REPLACE", target)
