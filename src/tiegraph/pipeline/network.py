"""Glue of network: which images may tie to which, by previews and a model made of them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pycolmap

from tiegraph import papers
from tiegraph.errors import ReconstructionError
from tiegraph.features.preview import PreviewMatch
from tiegraph.features.preview_database import write_preview_database
from tiegraph.network.model.surveymodel import Maker, SurveyModel
from tiegraph.network.network import estimate_network
from tiegraph.network.offsets.offsets import OFFSETS
from tiegraph.pipeline.files import save_npz, scanned
from tiegraph.pipeline.preview import read_preview
from tiegraph.pipeline.previews import match_item, up_light
from tiegraph.project.run import Run, save_json
from tiegraph.project.stages import Outcome, remove, write_atomic
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.model import image_poses, model_rigs, tracks

log = logging.getLogger(__name__)


def network(run: Run) -> Outcome:
    """Candidate pairs from every source, judged by previews; the rig checked against them; sections cut."""
    scene = scanned(run)
    light = up_light(run, scene)
    papers.plug_in(papers.OFFSETS, run.settings.network.offsets, OFFSETS)
    matched = [0]

    def match(pairs: np.ndarray) -> list[PreviewMatch]:
        matched[0] += len(pairs)
        run.reporter.total(matched[0], matched[0] - len(pairs))
        items = [(int(i), int(j)) for i, j in pairs]
        return run.map(match_item, items, run.folder, run.settings.preview, run.settings.tuning.features.preview)

    make = Maker(partial(_survey_model, run), run.settings.tuning.scene)
    descriptors = partial(_Descriptors, run.folder, scene)
    settings, tuning = run.settings.network, run.settings.tuning.network
    found = estimate_network(scene, light, match, settings, tuning, make, descriptors)
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
        source, tuning = Source(database, None, rough=rough), run.settings.tuning
        made = reconstruct(source, folder, scene.measured(), settings, tuning.sfm, tuning.scene, run.log)
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


class _Descriptors(Sequence[np.ndarray]):
    """Descriptors (K, 128) u1 of every image, read when asked for: those of thousands of images would fill memory."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folder, self._names = folder, scene.names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, image: Any) -> Any:
        return read_preview(self._folder, self._names[image]).descriptors


def _table(funnel: dict[str, int]) -> dict:
    return {"columns": ["step", "pairs"], "rows": [[k, v] for k, v in funnel.items()]}
