"""Folders for the next tool (`tiegraph export --to NAME`): what nerfstudio, splatting, OpenMVS, OpenSfM, GIS and others
open without a converter.

All start from one view of the survey (``survey.Survey``): the model in the world with the cameras and names that the
images have in the folder. A format says which lenses it knows (``lens``); an image with one of these is copied, any
other undistorted. What most of these programs take for granted and do not say is kept for all: the middle of an image
is the principal point and pixels are square (Inria's 3D Gaussian splatting, Bundler), base names tell images apart
(Inria, nerfstudio's reduced copies), names have no blanks (OpenMVS). So undistorted images are cut to the largest view
about the optical axis, and only COLMAP's folder keeps the folders of the survey.

Coordinates are those of the world, the CRS's minus its shift, because all these programs work in single precision
somewhere; ``offset.json`` leads back. Axes and pixels: COLMAP's cameras look along z with y down and the first pixel's
middle at (0.5, 0.5). nerfstudio's and Bundler's look along -z with y up; OpenSfM's are COLMAP's, its world is east,
north, up about a place.

The cloud needs no such view: ``tiles3d`` writes its octree, and a mesh in levels of detail, as 3D Tiles.

Read for this: nerfstudio's ``nerfstudio_dataparser.py``, ``depth_dataset.py`` and ``data_utils.py`` (1.1.5), gsplat's
``examples/datasets/colmap.py``, Inria's ``dataset_readers.py``, OpenMVS's ``InterfaceCOLMAP.cpp``, OpenSfM's ``io.py``,
COLMAP's ``ExportBundler``, Pix4D's specification of OPF 1.0, Metashape's manual (appendix on camera models) and the
3D Tiles specification 1.1.
"""

from typing import Literal

Name = Literal["dense", "nerfstudio", "colmap", "gsplat", "openmvs", "bundler", "opensfm", "opf", "metashape", "tum",
               "kitti", "geojson", "gpkg", "e57", "3dtiles", "potree", "results"]  # fmt: skip
"""What `--to` takes; ``dense`` is the workspace of ``dense.undistort``, ``e57`` and ``potree`` the
cloud, ``3dtiles`` cloud and mesh, ``results`` the files that a run is made for, as they are."""
