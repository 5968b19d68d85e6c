"""Glue of the engines ``network`` and ``design``: which images may tie (candidates), a model of the survey made of
previews and the pairs by it (coarse), the final candidate pairs with sections and pictures (network), and which of them
are matched (design).

For the coarse model the engine ``network`` chooses the ties to map and the trusted parts of the models; the engine
``sfm`` maps them, block by block. A finished block is kept until the stage is done, under a key of its images and ties:
a killed stage continues with the next block, and a try whose ties changed in one block maps only that one again.
"""

import hashlib
import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pycolmap

from tiegraph import papers
from tiegraph.design import coverage
from tiegraph.design.design import METHODS, DesignResult, takes_all, with_coverage
from tiegraph.design.design import design as select_pairs
from tiegraph.errors import ReconstructionError
from tiegraph.features.preview import write_preview_database
from tiegraph.network.candidates import find_candidates
from tiegraph.network.coarse.assembled import Assembled, assembled, is_whole
from tiegraph.network.coarse.model import CoarseModel, explained, with_surface
from tiegraph.network.coarse.search import Coarse, Search, worth_a_model
from tiegraph.network.network import join_network, positions_of, with_bases
from tiegraph.network.offsets import OFFSETS
from tiegraph.network.passes import MatchCache
from tiegraph.network.plots import map_png, weak_pairs
from tiegraph.papers.fuse2014 import LEAST, two_view
from tiegraph.pipeline import files
from tiegraph.pipeline.features import Matcher, preview_of, previews_of, read_preview, up_light, with_previews
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json, write_atomic
from tiegraph.scene.atomic import cached_by_file, remove
from tiegraph.scene.blocks import Block, blocks_of, in_one_piece
from tiegraph.scene.colmapmodel import image_poses, model_rigs, tracks
from tiegraph.scene.pairs import Pairs, PreviewMatches, Visibility
from tiegraph.scene.scene import Scene
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.settings import SparseSettings

log = logging.getLogger(__name__)

LOOKED = "design/matches.npz"


def candidates(run: Run) -> Outcome:
    """Candidate pairs from every source, judged by previews; the order of passes and the rig checked by them."""
    scene = files.scanned(run)
    cache = MatchCache(Matcher(run, "candidates/matched"), len(scene))
    settings, tuning = run.settings.candidates, run.settings.tuning.network
    papers.plug_in(papers.OFFSETS, settings.offsets, OFFSETS)
    found = find_candidates(scene, cache, settings, tuning, partial(_Descriptors, run.folder, scene))
    files.save_npz(run.path("candidates.npz"), **found.pairs.to_npz())
    files.save_npz(run.path("candidates", "matches.npz"), **found.ties.to_npz())
    write_atomic(run.path("candidates", "scene.json"), found.scene.to_json())
    counts = {"previews": len(found.ties), "candidates": len(found.pairs), "kept": len(found.pairs.kept())}
    return Outcome(counts, notes=found.notes)


class _Descriptors(Sequence[np.ndarray]):
    """Descriptors (K, 128) u1 of every image, read on demand: those of thousands of images would fill memory."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folder, self._names = folder, scene.names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, image: Any) -> Any:
        return read_preview(self._folder, self._names[image]).descriptors


def coarse(run: Run) -> Outcome:
    """The candidate pairs judged by a coarse model of the survey, if one is worth making and is trusted."""
    pairs, ties = files.pairs_of(run, "candidates.npz"), files.ties_of(run, "candidates")
    scene = files.load_scene(run.path("candidates", "scene.json"))
    cache = MatchCache(Matcher(run, "coarse/matched"), len(scene), ties)
    found = judged_by_model(run, (pairs, scene), cache)
    files.save_npz(run.path("coarse.npz"), **found.pairs.to_npz())
    files.save_npz(run.path("coarse", "matches.npz"), **cache.matches().to_npz())
    write_atomic(run.path("coarse", "scene.json"), found.scene.to_json())
    counts = {"previews": len(cache) - len(ties), "candidates": len(found.pairs), "kept": len(found.pairs.kept())}
    if found.model is not None:
        poses = found.model.cam_from_world
        files.save_npz(run.path("coarse", "model.npz"), cam_from_world=poses, trusted=found.trusted)
        files.save_npz(run.path("coarse", "visibility.npz"), **surface_seen(run, found, cache.matches()).to_npz())
        counts |= {"images": int(found.model.placed().sum()), "trusted": int(found.trusted.sum())}
    return Outcome(counts, notes=found.notes)


def surface_seen(run: Run, found: Coarse, ties: PreviewMatches) -> Visibility:
    """The surface seen by each image, by all tracks of the previews that the model trusts.

    For a survey mapped in blocks by the tracks that placed its images: with all of 1200 images the design wanted 30
    pairs an image, with these 8, which place them to 4 mm.
    """
    assert found.model is not None
    tuning, model = run.settings.tuning, found.model
    if in_one_piece(found.scene, tuning.scene.blocks):
        kept, names = found.pairs.kept(), found.scene.names
        believed = np.isin(np.arange(len(ties)), ties.find(kept.i, kept.j))
        tracks = tuning.network.coarse.course
        model = with_surface(model, ties.where(believed), lambda k: read_preview(run.folder, names[k]).xy, tracks)
    return model.visibility(tuning.network.coarse)


def judged_by_model(run: Run, candidates: tuple[Pairs, Scene], cache: MatchCache) -> Coarse:
    """Candidate pairs of a scene judged by the best coarse model; unchanged if none is worth making."""
    pairs, scene = candidates
    settings, tuning = (run.settings.candidates, run.settings.coarse), run.settings.tuning.network
    if not worth_a_model(*settings):
        return Coarse(pairs=pairs, scene=scene, model=None, trusted=np.zeros(len(scene), bool))

    def explains(model: CoarseModel, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        course = tuning.coarse.course
        return explained(model, (i, j), cache.matches_of, lambda k: read_preview(run.folder, scene.names[k]).xy, course)

    search, mapper = Search(candidates, cache, settings, tuning, explains), _Mapper(run, scene)
    while (wanted := search.wanted()) is not None:
        search.take(wanted, mapper.mapped(wanted))
    return search.result()


class _Mapper:
    """Maps ties of a survey in blocks, which stay as they were cut the first time."""

    def __init__(self, run: Run, scene: Scene) -> None:
        self._run, self._scene = run, scene
        self._blocks: tuple[Block, ...] = ()

    def mapped(self, ties: PreviewMatches) -> Assembled:
        """The models of all blocks, joined; none of no ties."""
        if not len(ties):
            return Assembled(())
        run, scene, tuning = self._run, self._scene, self._run.settings.tuning
        self._blocks = self._blocks or blocks_of(scene, ties.i, ties.j, ties.counts(), tuning.scene.blocks)
        models = []
        for number, block in enumerate(self._blocks):
            run.reporter.total(len(self._blocks), number)
            model = self._of_block(block, ties)
            placed = 0 if model is None else int(model.placed().sum())
            log.info("block %d of %d: %d of %d images", number + 1, len(self._blocks), placed, len(block))
            models.append(model)
        return assembled(scene, self._blocks, models, tuning.network.coarse, tuning.scene.joining)

    def _of_block(self, block: Block, ties: PreviewMatches) -> CoarseModel | None:
        """The model of a block: that of an earlier try, or of an interrupted run, if its ties are the same."""
        whole = is_whole(self._blocks, self._scene)
        part, inside = (self._scene, ties) if whole else block.part_of(self._scene, ties)
        key = hashlib.blake2b(digest_size=8)
        for array in (block.images, inside.i, inside.j, inside.start, inside.matches):
            key.update(np.ascontiguousarray(array).tobytes())
        kept = self._run.path("coarse/blocks", f"{key.hexdigest()}.npz")
        if kept.exists():
            return files.load_as(kept, lambda data: CoarseModel.from_npz(data) if data else None)
        model = coarse_model(self._run, part, inside) if len(inside) else None
        files.save_npz(kept, **({} if model is None else model.to_npz()))
        return model


def coarse_model(run: Run, scene: Scene, ties: PreviewMatches) -> CoarseModel | None:
    """A rough model of a survey or of a block of it, made of previews: the longest tracks place the images well
    enough to choose pairs and to start from. None if COLMAP finds none.

    It is made with the defaults of the stage sparse, whatever its settings are: pairs and matches stay when the
    final model is made with others. Its files are removed: the arrays contain the needed data.
    """
    folder = run.path("coarse/mapping")
    remove(folder)
    folder.mkdir(parents=True)
    database = folder / "database.db"
    previews = (read_preview(run.folder, name) for name in scene.names)  # one after another: bounds the memory
    write_preview_database(database, scene, previews, ties, min_matches=1)
    settings = SparseSettings(covariance_frames=0, use_positions=False)
    try:
        source, tuning = Source(database, None, rough=True), run.settings.tuning
        made = reconstruct(source, folder, scene.measured(), settings, tuning.sfm, tuning.scene, run.log)
        model = made.load(0)
    except ReconstructionError as error:
        log.warning("coarse model: %s", error)
        return None
    finally:
        remove(folder)
    cameras = {k: model.cameras[k] for k in model.cameras}
    own = [cast(pycolmap.Camera, s.camera) for s in scene.all_sensors]  # the scan gave each sensor one
    points, image, point = tracks(model, scene)
    return CoarseModel(
        cam_from_world=image_poses(model, scene),
        cameras=tuple(cameras.get(int(key) + 1, own[int(key)]) for key in scene.sensor_key),
        points=points,
        image=image,
        point=point,
        rigs=model_rigs(model, scene),
    )


def network(run: Run) -> Outcome:
    """The pairs left by candidates and the coarse model, the survey cut into sections, and the tie graph drawn."""
    scene = files.load_scene(run.path("coarse", "scene.json"))
    light = up_light(run, scene)
    settings = run.settings.candidates, run.settings.network
    pairs, ties = files.pairs_of(run, "coarse.npz"), files.ties_of(run)
    found = join_network(pairs, scene, ties, light, settings, run.settings.tuning.network)
    visibility = files.visibility_of(run)
    good = found.pairs if visibility is None else with_bases(found.pairs, found.scene, visibility)
    files.save_npz(run.path("network.npz"), **good.to_npz())
    write_atomic(run.path("network.csv"), good.to_csv(scene.names))
    write_atomic(run.path("network", "scene.json"), found.scene.to_json())
    sections = found.cut.sections
    cut = [{"number": k, "name": s.name, "kind": s.kind} for k, s in enumerate(sections)]
    save_json(run.path("network", "sections.json"), cut)
    model = run.path("coarse", "model.npz")
    for name, picture in found.plots(files.load_npz(model)["cam_from_world"] if model.exists() else None):
        write_atomic(run.path("network", f"{name}.png"), picture)
    funnel = found.pairs.funnel()
    counts = {"candidates": funnel["candidates"], "kept": funnel["used"], "sections": len(sections)}
    return Outcome(counts, notes=found.notes)


def design(run: Run) -> Outcome:
    """Which of the candidate pairs are matched at full resolution; COLMAP pair lists, one a section and one for all."""
    scene, candidates, known = files.checked(run), files.pairs_of(run, "network.npz"), files.ties_of(run)
    settings, tuning = run.settings, run.settings.tuning
    ties, previews, method = known, 0, settings.design.method
    if not takes_all(candidates, scene, settings.design, tuning.design):  # a choice needs previews
        candidates, ties, previews = with_previews(run, candidates, known)
    papers.plug_in(papers.DESIGNS, method, METHODS)
    if method in papers.DESIGNS:  # a paper's method uses an accuracy of its own
        candidates = with_accuracy(run, candidates, scene, ties)
    made = select_pairs(candidates, scene, ties, settings.design, tuning.design, files.visibility_of(run))
    made, ties = _covered(run, made, scene, ties)
    _save(run, scene, made.pairs, ties.where(known.find(ties.i, ties.j) < 0))
    # The pairs on a map, the weak ones marked
    model = run.path("coarse", "model.npz")
    poses = files.load_npz(model)["cam_from_world"] if model.exists() else None
    positions, unit = positions_of(scene, poses)
    weak = weak_pairs(made.tables.get("weak links", {}), scene)
    write_atomic(run.path("design", "map.png"), map_png(made.pairs, positions, scene, weak=weak, unit=unit))
    again, said = {}, ()
    surface = surface_of(run)
    if surface is not None and poses is not None:
        drawn = coverage.surface_png(surface.cells, surface.places, poses, scene.frame)
        write_atomic(run.path("design", "surface.png"), drawn)
        again, said = {"where to go again": surface.table()}, surface.lines()
    without = int(np.sum(made.pairs.degree(len(scene)) == 0))
    counts = {"images_without": without, "previews": previews, **made.counts}
    looked = (f"{previews} pairs without previews were previewed first",) if previews else ()
    return Outcome(counts, notes=(*looked, *made.notes, *said), tables={**made.tables, **again})


def _save(run: Run, scene: Scene, pairs: Pairs, looked: PreviewMatches) -> None:
    """The table of pairs, COLMAP's lists of all and of each section, and the previews that were ``looked`` at here."""
    files.save_npz(run.path("pairs.npz"), **pairs.to_npz())
    write_atomic(run.path("pairs.txt"), pairs.to_text(scene.names))
    run.path("pairs").mkdir(exist_ok=True)
    section = scene.section[scene.frame]
    for number in np.unique(section):
        own = pairs.where((section[pairs.i] == number) | (section[pairs.j] == number))
        write_atomic(run.path("pairs", f"section_{max(number, 0)}.txt"), own.to_text(scene.names))
    run.path("design").mkdir(exist_ok=True)
    files.save_npz(run.path(*LOOKED.split("/")), **looked.to_npz())


def coverage_of(run: Run, chosen: bool) -> coverage.Coverage:
    """The weak places of the candidates, or of the ``chosen`` pairs, by all previews that were matched."""
    pairs, ties = files.pairs_of(run, "pairs.npz" if chosen else "network.npz"), files.ties_of(run)
    if run.path(*LOOKED.split("/")).exists():
        ties = ties | files.ties_of(run, "design")
    scene = files.checked(run)
    return coverage.coverage(pairs, scene, coverage.on_few_points(pairs, scene, ties, run.settings.tuning.design))


def surface_of(run: Run) -> coverage.CoveredSurface | None:
    """The coverage of the coarse model's surface; None without a model."""
    seen = files.visibility_of(run)
    if seen is None:
        return None
    scene, tuning = files.checked(run), run.settings.tuning.design.surface
    cells = coverage.surface_map(seen, scene.focal_px, tuning)
    return coverage.CoveredSurface(cells, coverage.weak_places(cells), scene.names) if len(cells) else None


def _covered(run: Run, made: DesignResult, scene: Scene, ties: PreviewMatches) -> tuple[DesignResult, PreviewMatches]:
    """The design with its weak links, and their previews: chosen pairs across places with few points are previewed
    first, because only some of the candidates have been."""
    tuning = run.settings.tuning
    weak = coverage.on_few_points(made.pairs, scene, ties, tuning.design)
    unknown = coverage.unknown_across(made.pairs, scene, ties, weak)
    if unknown.any():
        ties = ties | previews_of(run, made.pairs.where(unknown))
        weak = coverage.on_few_points(made.pairs, scene, ties, tuning.design)
    return with_coverage(made, coverage.coverage(made.pairs, scene, weak)), ties


def with_accuracy(run: Run, pairs: Pairs, scene: Scene, ties: PreviewMatches) -> Pairs:
    """The pairs with ``sigma_m`` (how far the adjustment moves the base) and ``h_over_b`` of those that were previewed.

    The base between two frames of a pass is as long as their numbers are apart (002, 2.3), else one: lengths are in
    frames, not metres.
    """
    unknown = np.full(len(pairs), np.nan)  # values of the coarse model are none of the paper's
    pairs = pairs.with_(sigma_m=unknown, h_over_b=unknown)
    row = ties.find(pairs.i, pairs.j)
    if not (row >= 0).any():  # nothing was previewed (pairs in sequence without a coarse model)
        return pairs
    matches = np.where(row >= 0, ties.counts()[row], 0)
    usable = np.flatnonzero((pairs.dropped == 0) & (matches >= LEAST))
    items = [((int(pairs.i[k]), int(pairs.j[k])), ties.of(int(row[k]))) for k in usable]
    found: list[tuple[float, float] | None] = run.map(
        _two_view_item, items, run.folder, run.settings.preview.max_error_px
    )
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
    item: tuple[tuple[int, int], np.ndarray], folder: Path, max_error_px: float
) -> tuple[float, float] | None:
    images, match = item
    scene = _checked(folder)
    a, b = (preview_of(folder, scene.names[k]) for k in images)
    one, other = (scene.sensor_of(k).camera for k in images)
    if one is None or other is None:
        return None
    return two_view(a.xy[match[:, 0]], b.xy[match[:, 1]], one, other, max_error_px, 1.0 / min(a.scale, b.scale))


@cached_by_file(2, lambda folder: folder / "network" / "scene.json")
def _checked(folder: Path) -> Scene:
    return files.load_scene(folder / "network" / "scene.json")
