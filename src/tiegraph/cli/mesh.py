"""`tiegraph mesh OUT`: a textured mesh of a finished run."""

from tiegraph.cli.run import Common, main_stage

_ABOUT = """ Of `mesh`: the cloud as a surface of triangles that is coloured from the images: OUT/mesh/mesh.glb (one
file, for viewers and browsers), mesh.obj with its textures, mesh.ply with colours at the vertices, and offset.json,
which leads to the coordinates of the CRS."""


def main(arguments: list[str]) -> int:
    """`tiegraph mesh`."""
    return main_stage("mesh", arguments, Common, _ABOUT)
