"""Glue of features: SIFT of the images into the database."""

from pathlib import Path

import numpy as np

from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import extract_image
from tiegraph.features.tuning import Tuning
from tiegraph.gpu import on_gpu
from tiegraph.pipeline.files import mask_path, scanned
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene import colmapdatabase as database
from tiegraph.scene.atomic import claim
from tiegraph.scene.colmaprows import create_database

_SLAB_IMAGES = 16  # images a worker extracts before their features are written: bounds memory and what a kill loses


def features(run: Run) -> Outcome:
    """SIFT of every image under its mask, into COLMAP's database."""
    scene, path = scanned(run), run.path("database.db")
    if not path.exists():
        claim(path)
        create_database(path, scene.measured())
    there = database.feature_counts(path)
    todo = [(k, n) for k, n in enumerate(scene.names) if k not in there]
    run.reporter.total(len(scene), len(there))
    step, tuning = _SLAB_IMAGES * run.workers, run.settings.tuning.features
    for start in range(0, len(todo), step):
        found = run.map(_features_item, todo[start : start + step], run.folder, run.settings.features, tuning)
        for first in range(0, len(found), _SLAB_IMAGES):  # the same transactions with any number of workers
            database.write_features(path, found[first : first + _SLAB_IMAGES])
    counts = np.array(list(database.feature_counts(path).values()))
    lost = database.lost_features(path, scene, range(len(scene)))
    out = {"images": len(scene), "features": int(counts.sum()), "median_features": float(np.median(counts))}
    on_device = run.settings.features.engine == "colmap" and on_gpu()
    return Outcome(out, dropped=tuple(lost), notes=("features by COLMAP on a GPU",) if on_device else ())


def _features_item(
    item: tuple[int, str], folder: Path, settings: FeaturesSettings, tuning: Tuning
) -> database.Features:
    index, name = item
    return index, *extract_image(folder / "images" / name, mask_path(folder, name), settings, tuning)
