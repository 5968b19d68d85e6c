"""Glue of design: which of the candidate pairs are matched."""

from __future__ import annotations

import csv

import numpy as np

from tiegraph import papers
from tiegraph.design.cost import Cost, cost, predicted_keypoints
from tiegraph.design.design import METHODS, takes_all
from tiegraph.design.design import design as select_pairs
from tiegraph.network.plots import map_png, weak_pairs
from tiegraph.pipeline.accuracy import with_accuracy
from tiegraph.pipeline.files import checked, pairs_of, reading, save_npz, sights_of, ties_of
from tiegraph.pipeline.previews import with_previews
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


def design(run: Run) -> Outcome:
    """Which of the candidate pairs are matched at full resolution; COLMAP pair lists, one a section and one for all."""
    scene = checked(run)
    candidates, ties = pairs_of(run, "network.npz"), ties_of(run)
    settings, tuning = run.settings, run.settings.tuning
    # In passes false pairs of walls that repeat cost more than time: canal_demo with all 2734 pairs 9.1 mm, with the
    # 1604 chosen ones 4.8 mm.
    loose = bool(np.all(scene.sequence[scene.frame] < 0))
    previews, spent = 0, _cost(run, scene, candidates) if loose else None
    if not takes_all(settings.design, spent, tuning.design.cost):
        candidates, ties, previews = with_previews(
            candidates, ties, run.folder, settings.preview, tuning.features.preview, run.map
        )
    papers.plug_in(papers.DESIGNS, settings.design.method, METHODS)
    if settings.design.method in papers.DESIGNS:
        candidates = with_accuracy(candidates, scene, ties, run.folder, run.map, tuning.sfm.two_view)
    made = select_pairs(candidates, scene, ties, settings.design, tuning.design, sights_of(run), spent)
    pairs = made.pairs
    save_npz(run.path("pairs.npz"), **pairs.to_npz())
    write_atomic(run.path("pairs.txt"), pairs.to_text(scene.names))
    run.path("pairs").mkdir(exist_ok=True)
    section = scene.section[scene.frame]
    for number in np.unique(section):
        own = pairs.where((section[pairs.i] == number) | (section[pairs.j] == number))
        write_atomic(run.path("pairs", f"section_{max(number, 0)}.txt"), own.to_text(scene.names))
    counts = {"images_without": int(np.sum(pairs.degree(len(scene)) == 0)), "previews": previews, **made.counts}
    run.path("design").mkdir(exist_ok=True)
    positions = scene.world_from_rig[:, :3, 3]
    weak = weak_pairs(made.tables.get("weak links", {}), scene)
    picture = map_png(pairs, positions if np.isfinite(positions).any() else None, scene, weak=weak)
    write_atomic(run.path("design", "map.png"), picture)
    looked = (f"{previews} pairs of which nothing was known were previewed first",) if previews else ()
    return Outcome(counts, notes=(*looked, *made.notes), tables=made.tables)


def _cost(run: Run, scene: Scene, pairs: Pairs) -> Cost:
    """Of matching all kept pairs, by the images' sizes and the shares of them that the masks leave."""
    cameras = [s.camera for s in scene.all_sensors]
    sizes = np.array([0.0 if c is None else c.width * c.height / 1e6 for c in cameras])
    with reading(run.path("masks.csv")), run.path("masks.csv").open(newline="") as file:
        percent = {row["image"]: float(row["used_percent"]) for row in csv.DictReader(file)}
        used = np.array([percent[name] / 100 for name in scene.names])
    megapixels, kept = sizes[scene.sensor_key], pairs.kept()
    tuning = run.settings.tuning.design.cost
    keypoints = predicted_keypoints(megapixels, used, run.settings.features.max_features, tuning)
    return cost(kept.i, kept.j, keypoints, megapixels, tuning)
