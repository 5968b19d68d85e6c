"""Glue of watch: the coarse model of what has arrived, made in a process of its own, and the surface it shows."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.child import run_in_child
from tiegraph.design.surface import SurfaceMap, WeakPlace, surface_map, weak_places
from tiegraph.errors import TiegraphError
from tiegraph.network.coarse.surface import with_surface
from tiegraph.network.retrieval.loose import supported
from tiegraph.network.retrieval.retrieval import nearest_images
from tiegraph.pipeline.coarse import coarse_model
from tiegraph.pipeline.preview import read_preview
from tiegraph.pipeline.watch.ties import matched
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.graph import strongest_pairs
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import rig_from_dict, rig_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.watch.tuning import ModelTuning

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Wanted:
    """What a model is to be made of, in picklable form: the run folder, the scene as JSON, ties as arrays."""

    folder: Path
    scene: str
    ties: dict[str, np.ndarray]
    settings: Settings
    tuning: ModelTuning


@dataclass(frozen=True)
class Modelled:
    """What came of it: the ties with those of look-alikes; cam_from_world (N, 4, 4), NaN = not in the model, and the
    rigs as the model has them (dicts), or None without a model; the surface and its weak places."""

    ties: dict[str, np.ndarray]
    poses: np.ndarray | None
    rigs: tuple[dict, ...]
    surface: SurfaceMap | None
    places: tuple[WeakPlace, ...]


def make_model(wanted: Wanted, send: Callable[[Any], None]) -> Modelled:
    """Match look-alikes, leave out ties that stand alone as those of walls alike do, map the best, look at the surface.

    Runs in a child process (``run_in_child``).
    """
    scene, settings = Scene.from_json(wanted.scene), wanted.settings
    ties = _with_look_alikes(wanted, scene, PreviewMatches.from_npz(wanted.ties))
    least, network = settings.candidates.min_matches, settings.tuning.network
    count = ties.counts()
    ends = ties.i.astype(int), ties.j.astype(int)
    good = supported(ends, count.astype(np.float32), len(scene), least, network)
    pairs = Pairs.make(ties.i, ties.j, "retrieval", score=count.astype(np.float32)).where(good & (count >= least))
    best = strongest_pairs(pairs, scene, settings.coarse.pairs_per_image)
    used = ties.where(np.isin(np.arange(len(ties)), ties.find(best.i, best.j)))
    run = Run(wanted.folder, Inputs(wanted.folder), settings, "serial")
    model = coarse_model(run, scene, used) if len(used) else None
    if model is None:
        return Modelled(ties.to_npz(), None, rigs=(), surface=None, places=())
    model = with_surface(model, used, lambda k: read_preview(wanted.folder, scene.names[k]).xy, network.coarse.tracks)
    focal = np.array([camera.mean_focal_length() for camera in model.cameras])
    surface = surface_map(model.visibility(network.coarse), focal, settings.tuning.design.surface)
    places = weak_places(surface, settings.tuning.design.surface)
    rigs = tuple(rig_to_dict(rig) for rig in model.rigs)
    return Modelled(ties.to_npz(), model.cam_from_world, rigs=rigs, surface=surface, places=places)


def rigs_of(modelled: Modelled) -> tuple[Any, ...]:
    """The rigs of a model."""
    return tuple(rig_from_dict(rig) for rig in modelled.rigs)


def _with_look_alikes(wanted: Wanted, scene: Scene, ties: PreviewMatches) -> PreviewMatches:
    """The ties, and the matches of the images that look most alike and were not matched yet."""
    tuning = wanted.tuning
    if not tuning.look_alikes:
        return ties
    words = wanted.settings.tuning.network.retrieval.vocabulary.model_copy(
        update={"training": tuning.training, "vocabularies": tuning.vocabularies}
    )
    descriptors = [read_preview(wanted.folder, name).descriptors for name in scene.names]
    other, _ = nearest_images(descriptors, tuning.look_alikes, words)
    one = np.repeat(np.arange(len(scene)), other.shape[1])[other.ravel() >= 0]
    two = other.ravel()[other.ravel() >= 0]
    pairs = np.unique(np.sort(np.column_stack([one, two]), axis=1), axis=0)
    new = pairs[ties.find(pairs[:, 0], pairs[:, 1]) < 0]
    return ties | matched(new, scene, wanted.folder, wanted.settings)


class CoarseModels:
    """The coarse models that are made in a child process, one at a time, and the last that was."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self.made: Modelled | None = None
        self.names: tuple[str, ...] = ()  # of the images it was made of
        self.images, self.ties = 0, 0  # of the last that was begun
        self.seconds = 0.0
        self.of: frozenset[str] = frozenset()
        self._thread: threading.Thread | None = None
        self._result: Modelled | None = None
        self.scene: Scene

    @property
    def busy(self) -> bool:
        """Whether one is being made, or was and is not taken yet."""
        return self._thread is not None

    def start(self, scene: Scene, ties: PreviewMatches, tuning: ModelTuning) -> None:
        """Begin one of all images of a scene."""
        self.scene, self.images = scene, len(scene)
        wanted = Wanted(self._run.folder, scene.to_json(), ties.to_npz(), settings=self._run.settings, tuning=tuning)
        self._thread = threading.Thread(target=self._make, args=(wanted,), daemon=True, name="watch-model")
        self._thread.start()

    def _make(self, wanted: Wanted) -> None:
        began = time.monotonic()
        try:
            self._result = run_in_child(make_model, wanted, log=self._run.log, task="coarse model")
        except TiegraphError as error:  # the next is tried with more images
            log.warning("%s", error)
        self.seconds = time.monotonic() - began

    def result(self) -> Modelled | None:
        """What was made since it was asked last."""
        if self._thread is None or self._thread.is_alive():
            return None
        self._thread = None
        made, self._result = self._result, None
        if made is not None and made.poses is not None:
            self.made, self.names = made, self.scene.names
        return made
