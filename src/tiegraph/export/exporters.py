"""The formats by name."""

from tiegraph.export import colmapfolders, lens, maps, paths
from tiegraph.export.nerf import nerfstudio
from tiegraph.export.opensfm import opensfm
from tiegraph.export.survey import Exporter

EXPORTERS = {
    "nerfstudio": Exporter(
        nerfstudio, "ns-train splatfacto --data {folder} nerfstudio-data --load-3D-points True", lens.opencv, depth=True
    ),
    "colmap": Exporter(
        colmapfolders.sparse,
        "colmap gui --import_path {folder}/sparse/0 --image_path {folder}/images",
        lens.pinholes,
        flat=False,
    ),
    "gsplat": Exporter(
        colmapfolders.sparse, "python simple_trainer.py default --data_dir {folder} --data_factor 1", lens.centred
    ),
    "openmvs": Exporter(
        colmapfolders.openmvs,
        "InterfaceCOLMAP -w {folder} -i {folder} -o scene.mvs",
        lens.pinholes,
        mask="masks/{stem}.mask.png",
    ),
    "bundler": Exporter(colmapfolders.bundler, "meshlab: Import Bundler, {folder}/bundle.out", lens.centred),
    "opensfm": Exporter(opensfm, "opensfm undistort {folder}", lens.opencv),
    "tum": Exporter(paths.tum, "evo_traj tum {folder}/*.tum"),
    "kitti": Exporter(paths.kitti, "evo_traj kitti {folder}/*/poses.txt"),
    "geojson": Exporter(maps.geojson, "QGIS: drag {folder}/*.geojson into the map"),
    "gpkg": Exporter(maps.gpkg, "QGIS: drag {folder}/survey.gpkg into the map"),
}
