"""Glue of features, match, sparse and georef: from images and a pair list to a model in the world."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tiegraph.features import colmap, database
from tiegraph.features.match import match_pairs
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import extract_sift
from tiegraph.pipeline.files import checked, mask_path, pairs_of, read_image, read_mask, save_npz, scanned
from tiegraph.project.run import Run, save_json
from tiegraph.project.stages import Outcome, remove
from tiegraph.sfm.georef import georeference
from tiegraph.sfm.mapper import reconstruct

_SLAB_IMAGES = 16  # images a worker extracts before their features are written: bounds memory and what a kill loses


def features(run: Run) -> Outcome:
    """SIFT of every image under its mask, into COLMAP's database."""
    scene, path = scanned(run), run.path("database.db")
    if not path.exists():
        database.create_database(path, scene)
    settings = run.settings.features
    there = database.images_with_features(path)
    todo = [k for k in range(len(scene)) if k not in there]
    run.reporter.total(len(scene), len(there))
    if settings.engine == "colmap":
        colmap.extract_features(path, run.path("images"), run.path("masks"), scene, settings, run.log)
    else:
        step = _SLAB_IMAGES * run.workers
        for start in range(0, len(todo), step):
            slab = [(k, scene.names[k]) for k in todo[start : start + step]]
            database.write_features(path, run.map(_sift_item, slab, run.folder, settings))
    counts = np.array(list(database.feature_counts(path).values()))
    lost = database.lost_features(path, scene, range(len(scene)))
    out = {"images": len(scene), "features": int(counts.sum()), "median_features": float(np.median(counts))}
    return Outcome(out, dropped=tuple(lost))


def _sift_item(item: tuple[int, str], folder: Path, settings: FeaturesSettings) -> database.Features:
    index, name = item
    keypoints, descriptors = extract_sift(read_image(folder / "images" / name), read_mask(folder, name), settings)
    return index, keypoints, descriptors


def forget_matches(folder: Path) -> None:
    """Clear what match owns in the shared database."""
    if (folder / "database.db").exists():
        database.clear_matches(folder / "database.db")


def match(run: Run) -> Outcome:
    """Match and verify exactly the listed pairs."""

    def progress(done: int, total: int) -> None:
        run.reporter.total(total, done)

    scene = checked(run)
    pairs, report = match_pairs(
        run.path("database.db"), scene, pairs_of(run, "pairs.npz"), run.settings.match, run.log, progress
    )
    save_npz(run.path("match.npz"), **pairs.to_npz())
    alone = np.flatnonzero(pairs.degree(len(scene)) == 0)
    notes = (f"{len(alone)} images have no verified pair: {_some(scene.names, alone)}",) if len(alone) else ()
    kinds = {"columns": ["two-view geometry", "pairs"], "rows": [[k, n] for k, n in report.configurations.items()]}
    counts = {n: getattr(report, n) for n in ("asked", "matched", "verified", "matches", "inliers")}
    return Outcome(counts, dropped=report.lost, notes=notes, tables={"two-view geometries": kinds})


def _some(names: tuple[str, ...], indices: np.ndarray, most: int = 5) -> str:
    shown = ", ".join(names[k] for k in indices[:most])
    return shown + (f" and {len(indices) - most} more" if len(indices) > most else "")
