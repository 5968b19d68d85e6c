"""Glue of design: which of the candidate pairs are matched."""

from pathlib import Path

import numpy as np

from tiegraph import papers
from tiegraph.design.coverage import (
    Coverage,
    CoveredSurface,
    coverage,
    on_few_points,
    surface_map,
    surface_png,
    unknown_across,
    weak_places,
)
from tiegraph.design.design import METHODS, DesignResult, takes_all, with_coverage
from tiegraph.design.design import design as select_pairs
from tiegraph.network.network import positions_of
from tiegraph.network.plots import map_png, weak_pairs
from tiegraph.papers.fuse2014 import two_view
from tiegraph.pipeline.features import preview_of, previews_of, with_previews
from tiegraph.pipeline.files import checked, load_npz, load_scene, pairs_of, save_npz, ties_of, visibility_of
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.atomic import cached_by_file
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning import TwoViewTuning

LOOKED = "design/matches.npz"


def design(run: Run) -> Outcome:
    """Which of the candidate pairs are matched at full resolution; COLMAP pair lists, one a section and one for all."""
    scene, candidates, known = checked(run), pairs_of(run, "network.npz"), ties_of(run)
    settings, tuning = run.settings, run.settings.tuning
    ties, previews, method = known, 0, settings.design.method
    if not takes_all(candidates, scene, settings.design, tuning.design):  # a choice needs previews
        candidates, ties, previews = with_previews(run, candidates, known)
    papers.plug_in(papers.DESIGNS, method, METHODS)
    if method in papers.DESIGNS:  # a paper's method uses an accuracy of its own
        candidates = with_accuracy(run, candidates, scene, ties)
    made = select_pairs(candidates, scene, ties, settings.design, tuning.design, visibility_of(run))
    made, ties = _covered(run, made, scene, ties)
    _save(run, scene, made.pairs, ties.where(known.find(ties.i, ties.j) < 0))
    # The pairs on a map, the weak ones marked
    model = run.path("coarse", "model.npz")
    poses = load_npz(model)["cam_from_world"] if model.exists() else None
    positions, unit = positions_of(scene, poses)
    weak = weak_pairs(made.tables.get("weak links", {}), scene)
    write_atomic(run.path("design", "map.png"), map_png(made.pairs, positions, scene, weak=weak, unit=unit))
    again, said = {}, ()
    surface = surface_of(run)
    if surface is not None and poses is not None:
        drawn = surface_png(surface.cells, surface.places, poses, scene.frame)
        write_atomic(run.path("design", "surface.png"), drawn)
        again, said = {"where to go again": surface.table()}, surface.lines()
    without = int(np.sum(made.pairs.degree(len(scene)) == 0))
    counts = {"images_without": without, "previews": previews, **made.counts}
    looked = (f"{previews} pairs without previews were previewed first",) if previews else ()
    return Outcome(counts, notes=(*looked, *made.notes, *said), tables={**made.tables, **again})


def _save(run: Run, scene: Scene, pairs: Pairs, looked: PreviewMatches) -> None:
    """The table of pairs, COLMAP's lists of all and of each section, and the previews that were ``looked`` at here."""
    save_npz(run.path("pairs.npz"), **pairs.to_npz())
    write_atomic(run.path("pairs.txt"), pairs.to_text(scene.names))
    run.path("pairs").mkdir(exist_ok=True)
    section = scene.section[scene.frame]
    for number in np.unique(section):
        own = pairs.where((section[pairs.i] == number) | (section[pairs.j] == number))
        write_atomic(run.path("pairs", f"section_{max(number, 0)}.txt"), own.to_text(scene.names))
    run.path("design").mkdir(exist_ok=True)
    save_npz(run.path(*LOOKED.split("/")), **looked.to_npz())


def coverage_of(run: Run, chosen: bool) -> Coverage:
    """The weak places of the candidates, or of the ``chosen`` pairs, by all previews that were matched."""
    pairs, ties = pairs_of(run, "pairs.npz" if chosen else "network.npz"), ties_of(run)
    if run.path(*LOOKED.split("/")).exists():
        ties = ties | ties_of(run, "design")
    scene = checked(run)
    return coverage(pairs, scene, on_few_points(pairs, scene, ties, run.settings.tuning.design))


def surface_of(run: Run) -> CoveredSurface | None:
    """The coverage of the coarse model's surface; None without a model."""
    seen = visibility_of(run)
    if seen is None:
        return None
    scene, tuning = checked(run), run.settings.tuning.design.surface
    cells = surface_map(seen, scene.focal_px, tuning)
    return CoveredSurface(cells, weak_places(cells), scene.names) if len(cells) else None


def _covered(run: Run, made: DesignResult, scene: Scene, ties: PreviewMatches) -> tuple[DesignResult, PreviewMatches]:
    """The design with its weak links, and their previews: chosen pairs across places with few points are previewed
    first, because only some of the candidates have been."""
    tuning = run.settings.tuning
    weak = on_few_points(made.pairs, scene, ties, tuning.design)
    unknown = unknown_across(made.pairs, scene, ties, weak)
    if unknown.any():
        ties = ties | previews_of(run, made.pairs.where(unknown))
        weak = on_few_points(made.pairs, scene, ties, tuning.design)
    return with_coverage(made, coverage(made.pairs, scene, weak)), ties


def with_accuracy(run: Run, pairs: Pairs, scene: Scene, ties: PreviewMatches) -> Pairs:
    """The pairs with ``sigma_m`` (how far the adjustment moves the base) and ``h_over_b`` of those that were previewed.

    The base between two frames of a pass is as long as their numbers are apart (002, 2.3), else one: lengths are in
    frames, not metres.
    """
    tuning = run.settings.tuning.sfm.two_view
    unknown = np.full(len(pairs), np.nan)  # values of the coarse model are none of the paper's
    pairs = pairs.with_(sigma_m=unknown, h_over_b=unknown)
    row = ties.find(pairs.i, pairs.j)
    if not (row >= 0).any():  # nothing was previewed (pairs in sequence without a coarse model)
        return pairs
    matches = np.where(row >= 0, ties.counts()[row], 0)
    usable = np.flatnonzero((pairs.dropped == 0) & (matches >= tuning.min_points))
    items = [((int(pairs.i[k]), int(pairs.j[k])), ties.of(int(row[k]))) for k in usable]
    found: list[tuple[float, float] | None] = run.map(_two_view_item, items, run.folder, tuning)
    sigma, ratio = np.array(pairs.sigma_m), np.array(pairs.h_over_b)
    frame_i, frame_j = scene.frame[pairs.i], scene.frame[pairs.j]
    apart = np.abs(scene.sequence_index[frame_i] - scene.sequence_index[frame_j])
    base = np.where(scene.sequence[frame_i] == scene.sequence[frame_j], np.maximum(apart, 1), 1)
    for k, one in zip(usable, found):
        if one is not None:
            sigma[k] = one[0] * base[k]
            if frame_i[k] != frame_j[k]:  # images of one frame are no copies of each other
                ratio[k] = one[1]
    return pairs.with_(sigma_m=sigma, h_over_b=ratio)


def _two_view_item(
    item: tuple[tuple[int, int], np.ndarray], folder: Path, tuning: TwoViewTuning
) -> tuple[float, float] | None:
    images, match = item
    scene = _checked(folder)
    a, b = (preview_of(folder, scene.names[k]) for k in images)
    one, other = (scene.sensor_of(k).camera for k in images)
    if one is None or other is None:
        return None
    return two_view(a.xy[match[:, 0]], b.xy[match[:, 1]], one, other, tuning, 1.0 / min(a.scale, b.scale))


@cached_by_file(2, lambda folder: folder / "network" / "scene.json")
def _checked(folder: Path) -> Scene:
    return load_scene(folder / "network" / "scene.json")
