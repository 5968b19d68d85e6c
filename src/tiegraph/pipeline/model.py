"""Glue of features, match, sparse and georef: from images and a pair list to a model in the world."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tiegraph.child import cores
from tiegraph.features import database
from tiegraph.features.extract import extract_image
from tiegraph.features.match import match_pairs
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.tuning import SiftTuning
from tiegraph.pipeline.files import checked, load_npz, mask_path, pairs_of, reading, save_npz, scanned
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene.atomic import claim
from tiegraph.scene.pairs import REASONS
from tiegraph.sfm.mapper import Source, reconstruct

_SLAB_IMAGES = 16  # images a worker extracts before their features are written: bounds memory and what a kill loses


def features(run: Run) -> Outcome:
    """SIFT of every image under its mask, into COLMAP's database."""
    scene, path = scanned(run), run.path("database.db")
    if not path.exists():
        claim(path)
        database.create_database(path, scene.measured())
    there = database.images_with_features(path)
    todo = [(k, n) for k, n in enumerate(scene.names) if k not in there]
    run.reporter.total(len(scene), len(there))
    step, tuning = _SLAB_IMAGES * run.workers, run.settings.tuning.features.sift
    for start in range(0, len(todo), step):
        found = run.map(_features_item, todo[start : start + step], run.folder, run.settings.features, tuning)
        for first in range(0, len(found), _SLAB_IMAGES):  # the same transactions with any number of workers
            database.write_features(path, found[first : first + _SLAB_IMAGES])
    counts = np.array(list(database.feature_counts(path).values()))
    lost = database.lost_features(path, scene, range(len(scene)))
    out = {"images": len(scene), "features": int(counts.sum()), "median_features": float(np.median(counts))}
    return Outcome(out, dropped=tuple(lost))


def _features_item(
    item: tuple[int, str], folder: Path, settings: FeaturesSettings, tuning: SiftTuning
) -> database.Features:
    index, name = item
    return index, *extract_image(folder / "images" / name, mask_path(folder, name), settings, tuning)


def forget_matches(folder: Path) -> None:
    """Clear what match owns in the shared database."""
    if (folder / "database.db").exists():
        database.clear_matches(folder / "database.db")


def match(run: Run) -> Outcome:
    """Match and verify exactly the listed pairs."""

    def progress(done: int, total: int) -> None:
        run.reporter.total(total, done)

    scene = checked(run)
    asked = pairs_of(run, "pairs.npz")
    processes = min(run.workers, cores())
    pairs, report = match_pairs(run.path("database.db"), scene, asked, run.settings.match, run.log, progress, processes)
    save_npz(run.path("match.npz"), **pairs.to_npz())
    alone = np.flatnonzero(pairs.degree(len(scene)) == 0)
    notes = (f"{len(alone)} images have no verified pair: {_some(scene.names, alone)}",) if len(alone) else ()
    kinds = {"columns": ["two-view geometry", "pairs"], "rows": [[k, n] for k, n in report.configurations.items()]}
    counts = {n: getattr(report, n) for n in ("asked", "matched", "verified", "matches", "inliers")}
    return Outcome(counts, dropped=report.lost, notes=notes, tables={"two-view geometries": kinds})


def _some(names: tuple[str, ...], indices: np.ndarray, most: int = 5) -> str:
    shown = ", ".join(names[k] for k in indices[:most])
    return shown + (f" and {len(indices) - most} more" if len(indices) > most else "")


def sparse(run: Run) -> Outcome:
    """The models, with the rig, by COLMAP's mappers."""

    def progress(registered: int, total: int) -> None:
        run.reporter.total(total, registered)

    verified = pairs_of(run, "verify.npz")
    away = verified.where(verified.dropped == REASONS.index("repeat"))
    refused = tuple(zip(away.i.tolist(), away.j.tolist()))
    source = Source(
        run.path("database.db"), run.path("images"), refused, preview=preview_poses(run.folder), run_map=run.map
    )
    made = reconstruct(
        source,
        run.path("sparse"),
        checked(run).measured(),
        run.settings.sparse,
        run.settings.tuning.sfm,
        run.log,
        progress,
    )
    counts = dict(made.counts)
    if made.sigma is not None:
        counts |= {"position_sigma_median": made.sigma.median, "position_sigma_p90": made.sigma.p90}
        if made.sigma.scale is not None:
            counts["scale_sigma"] = made.sigma.scale
    return Outcome(
        counts, dropped=made.dropped, notes=made.notes, tables=made.tables, contradictions=made.contradictions
    )


def preview_poses(folder: Path) -> np.ndarray | None:
    """(N, 4, 4) cam_from_world of the images in the trusted part of the preview model, None without one."""
    path = folder / "network" / "model.npz"
    if not path.exists():
        return None
    with reading(path):
        data = load_npz(path)
        return np.where(data["trusted"][:, None, None], data["cam_from_world"], np.nan)
