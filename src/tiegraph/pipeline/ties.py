"""Glue of network and design: from previews to the pair list."""

from __future__ import annotations

import csv
import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pycolmap

from tiegraph.design.cost import Cost, cost, foreseen_keypoints
from tiegraph.design.design import design as select_pairs
from tiegraph.design.design import takes_all
from tiegraph.errors import ReconstructionError
from tiegraph.features.preview import Preview, PreviewMatch, match_previews
from tiegraph.features.preview_database import write_preview_database
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning
from tiegraph.network.model.surveymodel import SurveyModel
from tiegraph.network.network import estimate_network
from tiegraph.network.pictures import map_png, weak_pairs
from tiegraph.network.sections.light import UpLight
from tiegraph.pipeline.accuracy import with_accuracy
from tiegraph.pipeline.capture import preview_path, read_preview
from tiegraph.pipeline.files import (
    checked,
    load_npz,
    load_scene,
    pairs_of,
    read_mask,
    reading,
    save_npz,
    scanned,
    ties_of,
)
from tiegraph.project.run import Run, save_json
from tiegraph.project.stages import Outcome, remove, write_atomic
from tiegraph.scene.filecache import cached_by_file
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Sights, Ties
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.model import image_poses, model_rigs, tracks

log = logging.getLogger(__name__)

_CACHED_PREVIEWS = 512  # of about 110 kB each, in every worker; reading one costs a fifteenth of matching it


def network(run: Run) -> Outcome:
    """Candidate pairs from every source, judged by previews; the rig checked against them; sections cut."""
    scene = scanned(run)
    light = UpLight(*np.array(run.map(_light, list(scene.names), run.folder)).reshape(-1, 2).T)
    matched = [0]

    def match(pairs: np.ndarray) -> list[PreviewMatch]:
        matched[0] += len(pairs)
        run.reporter.total(matched[0], matched[0] - len(pairs))
        items = [(int(i), int(j)) for i, j in pairs]
        return run.map(_match_item, items, run.folder, run.settings.preview, run.settings.tuning.features.preview)

    make_model, descriptors = partial(_survey_model, run), partial(_Descriptors, run.folder, scene)
    settings, tuning = run.settings.network, run.settings.tuning.network
    found = estimate_network(scene, light, match, settings, tuning, make_model, descriptors)
    save_npz(run.path("network.npz"), **found.pairs.to_npz())
    save_npz(run.path("network", "ties.npz"), **found.ties.to_npz())
    if found.model is not None:
        poses, reach = found.model.cam_from_world, found.model.reach(tuning.model)
        save_npz(run.path("network", "model.npz"), cam_from_world=poses, reach=reach, trusted=found.trusted)
        save_npz(run.path("network", "sights.npz"), **found.model.sights(tuning.model).to_npz())
    write_atomic(run.path("network.csv"), found.pairs.to_csv(scene.names))
    write_atomic(run.path("network", "scene.json"), found.scene.to_json())
    cut = [{"number": k, "name": s.name, "kind": s.kind} for k, s in enumerate(found.sections)]
    save_json(run.path("network", "sections.json"), cut)
    for name, picture in found.pictures():
        write_atomic(run.path("network", f"{name}.png"), picture)
    funnel = found.pairs.funnel()
    counts = {"previews": matched[0], "candidates": funnel["candidates"], "kept": funnel["used"]}
    return Outcome(
        {**counts, "sections": len(found.sections)},
        notes=found.notes,
        tables={"funnel": _table(funnel), **found.tables},
    )


def _light(name: str, folder: Path) -> tuple[float, float]:
    """Mean grey of an image, and the share of an up camera's picture that its mask leaves out (sky)."""
    scene = _scene(folder)
    up = scene.sensor_of(scene.image_index[name]).role == "up"
    return _preview(folder, name).brightness, 1.0 - float(read_mask(folder, name).mean()) if up else float("nan")


def _match_item(pair: tuple[int, int], folder: Path, settings: PreviewSettings, tuning: PreviewTuning) -> PreviewMatch:
    scene = _scene(folder)
    a, b = (scene.sensor_of(k).camera for k in pair)  # a guessed focal length serves as well
    one, other = (_preview(folder, scene.names[k]) for k in pair)
    return match_previews(one, other, a, b, settings, tuning)


def _survey_model(run: Run, scene: Scene, ties: Ties, rough: bool) -> SurveyModel | None:
    """A model of the survey or a block of it, made of previews; None where COLMAP finds none.

    Its files go: a block of a model, or one that tore and was made again, would be taken for the model of the network.
    """
    folder = run.path("network", "model")
    remove(folder)
    folder.mkdir(parents=True)
    database = folder / "database.db"
    previews = (read_preview(run.folder, name) for name in scene.names)  # one after another: bounds the memory
    write_preview_database(database, scene, previews, ties, min_matches=1)
    settings = run.settings.sparse.model_copy(update={"covariance_frames": 0, "use_positions": False})
    try:
        source, tuning = Source(database, None, rough=rough), run.settings.tuning.sfm
        made = reconstruct(source, folder, scene.measured(), settings, tuning, run.log)
        model = made.load(0)
    except ReconstructionError as error:
        log.warning("preview model: %s", error)
        return None
    finally:
        remove(folder)
    cameras = {k: model.cameras[k] for k in model.cameras}
    own = [cast(pycolmap.Camera, s.camera) for s in scene.all_sensors]  # the scan gave each sensor one
    return SurveyModel(
        image_poses(model, scene),
        tuple(cameras.get(int(key) + 1, own[int(key)]) for key in scene.sensor_key),
        *tracks(model, scene),
        model_rigs(model, scene),
    )


@cached_by_file(2, lambda folder: folder / "scene.json")
def _scene(folder: Path) -> Scene:
    return load_scene(folder / "scene.json")


class _Descriptors(Sequence[np.ndarray]):
    """Descriptors (K, 128) u1 of every image, read when asked for: those of thousands of images would fill memory."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folder, self._names = folder, scene.names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, image: Any) -> Any:
        return read_preview(self._folder, self._names[image]).descriptors


@cached_by_file(_CACHED_PREVIEWS, preview_path)
def _preview(folder: Path, name: str) -> Preview:
    return read_preview(folder, name)


def design(run: Run) -> Outcome:
    """Which of the candidate pairs are matched at full resolution; COLMAP pair lists, one a section and one for all."""
    scene = checked(run)
    candidates, ties = pairs_of(run, "network.npz"), ties_of(run)
    settings, tuning = run.settings, run.settings.tuning
    # In passes false pairs of walls that repeat cost more than time: canal_demo with all 2734 pairs 9.1 mm, with the
    # 1604 chosen ones 4.8 mm.
    loose = bool(np.all(scene.track[scene.frame] < 0))
    previews, spent = 0, _cost(run, scene, candidates) if loose else None
    if not takes_all(settings.design, spent, tuning.design.cost):
        candidates, ties, previews = with_previews(
            candidates, ties, run.folder, settings.preview, tuning.features.preview, run.map
        )
    if settings.design.method.startswith("fuse2014"):
        candidates = with_accuracy(candidates, scene, ties, run.folder, run.map, tuning.sfm.two_view)
    made = select_pairs(candidates, scene, ties, settings.design, tuning.design, _sights(run), spent)
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
    keypoints = foreseen_keypoints(megapixels, used, run.settings.features.max_features, tuning)
    return cost(kept.i, kept.j, keypoints, megapixels, tuning)


def with_previews(
    pairs: Pairs,
    ties: Ties,
    folder: Path,
    settings: PreviewSettings,
    tuning: PreviewTuning,
    run_map: Callable[..., list[Any]],
) -> tuple[Pairs, Ties, int]:
    """The pairs and ties after previews of every kept pair of which nothing is known, and how many these were.

    Pairs by order, by a pair list or of everybody with everybody come without previews: a method that chooses would
    choose blind. ``run_map``: map over a pool.
    """
    unknown = (pairs.dropped == 0) & np.isnan(pairs.score) & np.isnan(pairs.overlap)
    rows = np.flatnonzero(unknown & (ties.find(pairs.i, pairs.j) < 0))
    items = list(zip(pairs.i[rows].tolist(), pairs.j[rows].tolist()))
    found: list[PreviewMatch] = run_map(_match_item, items, folder, settings, tuning)
    if not found:
        return pairs, ties, 0
    score = pairs.score.copy()
    score[rows] = [one.inliers for one in found]
    new = Ties.make(pairs.i[rows], pairs.j[rows], [one.matches for one in found])
    return pairs.with_(score=score), ties | new, len(rows)


def _sights(run: Run) -> Sights | None:
    """What each image sees of the preview model, if there is one."""
    path, model = run.path("network", "sights.npz"), run.path("network", "model.npz")
    if not path.exists():
        return None
    with reading(path):
        return Sights.from_npz(load_npz(path), load_npz(model)["cam_from_world"])


def _table(funnel: dict[str, int]) -> dict:
    return {"columns": ["step", "pairs"], "rows": [[k, v] for k, v in funnel.items()]}
