"""Glue of watch: previews, ties and poses of new images, their coarse model, made in a process of its own, and the
content of the page."""

import logging
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.child import run_in_child
from tiegraph.design.coverage import VERDICTS, SurfaceMap, WeakPlace, surface_map, weak_places
from tiegraph.errors import TiegraphError
from tiegraph.features.preview import extract_preview, match_previews
from tiegraph.geometry import transforms
from tiegraph.network.candidates import Context, sequence
from tiegraph.network.coarse.model import with_surface
from tiegraph.network.loose import nearest_images, supported
from tiegraph.network.passes import MatchCache, find_passes, loose_images
from tiegraph.odometry.cameras import Cameras
from tiegraph.odometry.tuning import PoseTuning
from tiegraph.odometry.worldmap import resect
from tiegraph.pipeline.features import preview_of, preview_path, read_preview
from tiegraph.pipeline.files import read_image, save_npz
from tiegraph.pipeline.network import coarse_model
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scan.scan import prepare_image
from tiegraph.scene.graph import strongest_pairs
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.watch.onsite import LEAST_POINTS, path_and_ties, plan_from_world, rounded

_INLIER_SMALL_PX = 3.0  # distance of an inlier in pixels of the reduced image
_LOOK_ALIKES = 4  # of an image, matched before a model: what order does not tell of, loops and loose photographs


def make_preview(scene: Scene, image: int, source: Path, folder: Path, settings: Settings) -> None:
    """The preview of an image into the run folder. Raises InputError for a file that can no longer be read."""
    name = scene.names[image]
    prepared = folder / "images" / name  # only while their preview is made
    prepare_image(source, prepared, scene.sensor_of(image), settings.scan)
    try:
        made = extract_preview(read_image(prepared), None, settings.preview, settings.tuning.features)
    finally:
        prepared.unlink(missing_ok=True)
    save_npz(preview_path(folder, name), **made.to_npz())


def neighbours(scene: Scene, steps: int, settings: Settings) -> np.ndarray:
    """(P, 2) pairs i < j by order: in passes of the own and neighbouring cameras, of loose photographs by name."""
    asked = settings.candidates.model_copy(update={"sequence_frames": steps, "sequence_cameras": True})
    nothing = MatchCache(lambda pairs: [], len(scene))
    passes, tuning = find_passes(scene), settings.tuning.network
    pairs = sequence(Context(scene, passes, nothing, settings=asked, tuning=tuning, descriptors=list)).pairs
    loose = loose_images(scene)
    by_name = [np.column_stack([loose[:-step], loose[step:]]) for step in range(1, steps + 1)]
    return np.concatenate([np.column_stack([pairs.i, pairs.j]), *by_name]).astype(int)


def matched(pairs: np.ndarray, scene: Scene, folder: Path, settings: Settings) -> PreviewMatches:
    """The preview matches of image pairs (P, 2), i < j."""
    found = []
    for a, b in pairs.tolist():
        previews = preview_of(folder, scene.names[a]), preview_of(folder, scene.names[b])
        one, two = scene.sensor_of(a).camera, scene.sensor_of(b).camera
        assert one is not None and two is not None
        how = settings.preview, settings.tuning.features.preview
        found.append(match_previews(*previews, one, two, *how).matches)
    return PreviewMatches.make(pairs[:, 0], pairs[:, 1], found)


def resect_previews(
    rig: Rig, sensor: np.ndarray, xy: np.ndarray, points: np.ndarray, size_px: int
) -> np.ndarray | None:
    """rig_from_world (4, 4) by the odometry's resection, with the precision of previews of ``size_px``; None if there
    is none. sensor (K,), xy (K, 2) full pixels, points (K, 3)."""
    known = {
        k: (s.name, s.camera, s.sensor_from_rig)
        for k, s in enumerate(rig.sensors)
        if s.camera is not None and s.sensor_from_rig is not None
    }
    use = np.isin(sensor, list(known))
    if not use.any():
        return None
    names, models, mounted = zip(*known.values())
    reduced = max(1.0, max(np.sqrt(c.width * c.height / 0.75) for c in models) / size_px)  # as extract_preview
    limit = _INLIER_SMALL_PX * reduced
    asked = PoseTuning(inlier_px=limit, first_px=4 * limit, least_points=LEAST_POINTS)
    camera = np.searchsorted(list(known), sensor[use])
    found = resect(Cameras(names, models, np.stack(mounted)), camera, xy[use], points[use], None, asked)
    return None if found is None else found.rig_from_world


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Modelled:
    """The result: the ties with those of look-alikes; cam_from_world (N, 4, 4), NaN = not in the model, None
    without a model; the rigs by the model; the surface and its weak places."""

    ties: PreviewMatches
    poses: np.ndarray | None = None
    rigs: tuple[Rig, ...] = ()
    surface: SurfaceMap | None = None
    places: tuple[WeakPlace, ...] = ()


def make_model(folder: Path, settings: Settings, scene: Scene, ties: PreviewMatches, send: object) -> Modelled:
    """Match look-alikes, remove isolated ties as between similar walls, map the best, analyse the surface.

    Runs in a child process (``run_in_child``).
    """
    run = Run(folder, Inputs(folder), settings, "serial")
    ties = _with_look_alikes(run, scene, ties)
    least, network = settings.candidates.min_matches, settings.tuning.network
    count = ties.counts()
    ends = ties.i.astype(int), ties.j.astype(int)
    good = supported(ends, count.astype(np.float32), len(scene), least, network)
    pairs = Pairs.make(ties.i, ties.j, "retrieval", score=count.astype(np.float32)).where(good & (count >= least))
    best = strongest_pairs(pairs, scene, settings.coarse.pairs_per_image)
    used = ties.where(np.isin(np.arange(len(ties)), ties.find(best.i, best.j)))
    model = coarse_model(run, scene, used) if len(used) else None
    if model is None:
        return Modelled(ties)
    model = with_surface(model, used, lambda k: read_preview(run.folder, scene.names[k]).xy, network.coarse.course)
    focal = np.array([camera.mean_focal_length() for camera in model.cameras])
    surface = surface_map(model.visibility(network.coarse), focal, settings.tuning.design.surface)
    places = weak_places(surface)
    return Modelled(ties, model.cam_from_world, rigs=model.rigs, surface=surface, places=places)


def _with_look_alikes(run: Run, scene: Scene, ties: PreviewMatches) -> PreviewMatches:
    """The ties, and the matches of the most similar images that were not matched yet."""
    descriptors = [read_preview(run.folder, name).descriptors for name in scene.names]
    other, _ = nearest_images(descriptors, _LOOK_ALIKES, training=30_000, vocabularies=1)  # a second at 200 images
    one = np.repeat(np.arange(len(scene)), other.shape[1])[other.ravel() >= 0]
    two = other.ravel()[other.ravel() >= 0]
    pairs = np.unique(np.sort(np.column_stack([one, two]), axis=1), axis=0)
    new = pairs[ties.find(pairs[:, 0], pairs[:, 1]) < 0]
    return ties | matched(new, scene, run.folder, run.settings)


class CoarseModels:
    """The coarse models made in a child process, one at a time, and the last finished one."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self.made: Modelled | None = None
        self.names: tuple[str, ...] = ()  # of the images it was made of
        self.images, self.ties = 0, 0  # of the last one begun
        self.seconds = 0.0
        self.of: frozenset[str] = frozenset()
        self._thread: threading.Thread | None = None
        self._result: Modelled | None = None
        self.scene: Scene

    @property
    def busy(self) -> bool:
        """Whether one is being made, or was made and is not taken yet."""
        return self._thread is not None

    def start(self, scene: Scene, ties: PreviewMatches) -> None:
        """Begin one of all images of a scene."""
        self.scene, self.images = scene, len(scene)
        self._thread = threading.Thread(target=self._make, args=(ties,), daemon=True, name="watch-model")
        self._thread.start()

    def _make(self, ties: PreviewMatches) -> None:
        began, run = time.monotonic(), self._run
        asked = run.folder, run.settings, self.scene, ties
        try:
            self._result = run_in_child(make_model, *asked, log=run.log, task="coarse model")
        except TiegraphError as error:  # the next is tried with more images
            log.warning("%s", error)
        self.seconds = time.monotonic() - began

    def result(self) -> Modelled | None:
        """The model made since the last call."""
        if self._thread is None or self._thread.is_alive():
            return None
        self._thread = None
        made, self._result = self._result, None
        if made is not None and made.poses is not None:
            self.made, self.names = made, self.scene.names
        return made


def shown_scene(
    scene: Scene, ties: PreviewMatches, poses: np.ndarray, models: CoarseModels, least: int
) -> dict[str, Any]:
    """Path, ties, images without ties and surface for the page; ``least`` matches of a tie."""
    plan, scale = plan_from_world(poses, scene)
    places = transforms.apply(plan, transforms.centre(poses))
    by_model = np.array([name in models.of for name in scene.names], bool)
    out = path_and_ties(scene, ties, places, by_model, least, 4000)  # on the page at most, the strongest
    images = len(scene)
    out["counts"] = {
        "images": images, "tied": images - len(out["untied"]), "posed": int(np.isfinite(places[:, 0]).sum()),
    }  # fmt: skip
    known = (r for r in scene.rigs if len(r.sensors) > 1 and not r.nominal and r.known())
    out["metric"] = scale != 1.0 or any(known)
    out["surface"] = shown_surface(models, plan, scale)
    return out


def shown_surface(models: CoarseModels, plan: np.ndarray, scale: float) -> dict[str, Any]:
    """The map of the surface of the last model in the plan, and the places to revisit."""
    out: dict[str, Any] = {"verdicts": VERDICTS, "cells": [], "places": [], "shares": [], "side": 0.0}
    out["of"] = len(models.of)
    made = models.made
    if made is None or made.surface is None or not len(made.surface):
        return out
    surface = made.surface
    at = transforms.apply(plan, surface.xyz)
    out["cells"] = [[*rounded(xyz[:2]), int(v)] for xyz, v in zip(at, surface.verdict)]
    out["shares"] = list(surface.shares().values())
    out["side"] = surface.side * scale
    out["median"] = _typical(surface, np.arange(len(surface)), scale)
    for place in made.places[:20]:  # listed: more than anybody revisits
        x, y, _ = transforms.apply(plan, place.xyz[None])[0]
        out["places"].append({
            "x": float(x), "y": float(y), "near": models.names[place.image], "verdict": place.verdict,
            "cells": len(place.cells), "area": len(place.cells) * out["side"] ** 2,
            **_typical(surface, place.cells, scale),
        })  # fmt: skip
    return out


def _typical(surface: SurfaceMap, cells: np.ndarray, scale: float) -> dict[str, float | None]:
    sigma = float(np.median(surface.sigma[cells])) * scale
    return {
        "images": float(np.median(surface.images[cells])),
        "angle": float(np.median(surface.angle_deg[cells])),
        "sigma": sigma if np.isfinite(sigma) else None,
    }
