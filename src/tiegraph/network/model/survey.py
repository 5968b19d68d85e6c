"""The preview model: a small model of the survey, made of previews, says which images see the same surface.

Counts of preview matches cannot tell true ties from repeated walls: on ``canal`` (rendered, repeated facades) 40 % of
the pairs that share nothing reach the count of those that do. Geometry can. The best pairs of each image make a small
model, poses and points of that model predict the shared surface of every two images, and the prediction replaces the
count wherever the model is trusted.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.network.model.assembled import survey_models
from tiegraph.network.model.surveymodel import ModelFunction, SurveyModel
from tiegraph.network.model.visible import Overlap
from tiegraph.network.offsets.curves import contained
from tiegraph.network.passes import PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.strongest import strongest_pairs

MIN_MATCHES = 15  # a tie of the model
NEAR_STEPS = 2  # frames of a pass: images this near each other show whether the model is right there
ENOUGH = 0.8  # share of the images in the model from which its calibration is believed
TRUSTED = 0.5  # share of a frame's strong previews with those before, and after it, that the model must explain
ENOUGH_LOOKS = 8  # previews of two cameras where the model predicts a common view, to say that they never tie
NEVER = 0.1  # share of them that chance ties
FEW = 3  # fewer of them tell nothing
NO_MODEL = "preview model: none could be made; pairs are chosen by preview counts alone"
SURE = 1.6  # times min_matches: previews this strong between near frames are true

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelResult:
    """Pairs judged by the model, the model (None: there is none to believe), and what people should know."""

    pairs: Pairs
    scene: Scene  # with the rig as the model found it
    model: SurveyModel | None
    notes: tuple[str, ...]
    trusted: np.ndarray  # (N,) bool: images where the model is believed


def by_model(
    pairs: Pairs, scene: Scene, book: PreviewBook, settings: NetworkSettings, make: ModelFunction
) -> ModelResult:
    """Pairs by the predicted shared surface where a model of the best ties is trusted, unchanged elsewhere.

    Kept pairs that share less than ``settings.min_overlap`` are dropped for ``overlap``; all others that share as much
    are added with the source ``model``.
    """
    best = strongest_pairs(pairs, scene, settings.model_pairs)
    book.measure(best.i, best.j)
    ties = book.ties()
    used = ties.where(np.isin(ties.i.astype(np.int64) << 32 | ties.j, best.i.astype(np.int64) << 32 | best.j))
    used = used.where(used.counts() >= MIN_MATCHES)
    models, said = survey_models(scene, used, make) if len(used) else ((), ())
    if not models:
        return ModelResult(pairs, scene, None, (NO_MODEL, *said), np.zeros(len(scene), bool))
    part = np.full(len(scene), -1)
    for k, one in enumerate(models):
        part[one.placed()] = k
    overlap = Overlap.together([one.overlap() for one in models])
    trusted, agreement = _trusted(scene, book, overlap, part >= 0, settings)
    judged = _judged(pairs, overlap, np.where(trusted, part, -1), settings)
    judged = judged.drop(_never_tied(judged, scene, book, settings), "votes")
    model = models[0]
    notes = (*_notes(scene, models, len(used), trusted, agreement), *said)
    if model.placed().sum() < ENOUGH * len(scene):
        return ModelResult(judged, scene, model, notes, trusted)
    rigs, moved = calibrated_rigs(scene.rigs, model.rigs)
    return ModelResult(judged, scene.with_(rigs=rigs), model, notes + moved, trusted)


def calibrated_rigs(given: Sequence[Rig], found: Sequence[Rig]) -> tuple[tuple[Rig, ...], tuple[str, ...]]:
    """Rigs with what was only guessed replaced by what the model found: cameras without a known focal length, and of a
    nominal rig the rotations (its centres nearly coincide: the model's lever arms have no scale to be told by)."""
    rigs, notes = [], []
    for old, new in zip(given, found):
        sensors = []
        turned = []
        for a, b in zip(old.sensors, new.sensors):
            known = a.camera is None or a.camera.has_prior_focal_length
            camera = a.camera if known else b.camera
            extrinsics = a.sensor_from_rig
            if old.nominal and extrinsics is not None and b.sensor_from_rig is not None:
                centre = transforms.centre(extrinsics)
                rotation = b.sensor_from_rig[:3, :3]
                turned.append(transforms.angle_deg(extrinsics[:3, :3], rotation))
                extrinsics = transforms.rigid(rotation, -rotation @ centre)
            elif extrinsics is None:
                extrinsics = b.sensor_from_rig
            sensors.append(replace(a, camera=camera, sensor_from_rig=extrinsics))
        guessed = old.nominal or not old.known()
        rigs.append(replace(old, sensors=tuple(sensors), nominal=guessed))
        if turned:
            notes.append(f"rig {old.name}: its cameras turned by up to {max(turned):.2f} deg from nominal")
    return tuple(rigs), tuple(notes)


def _trusted(
    scene: Scene, book: PreviewBook, overlap: Overlap, placed: np.ndarray, settings: NetworkSettings
) -> tuple[np.ndarray, float]:
    """(N,) bool: images of the model where it explains the strong previews between near frames; share explained.

    A model that tore, or put a frame at a repeated wall, contradicts the images next to it: there it is not asked.
    """
    i, j, count = book.pairs()
    a, b = scene.frame[i], scene.frame[j]
    near = (scene.track[a] == scene.track[b]) & (scene.track[a] >= 0) & (a != b) & (scene.rig[a] == scene.rig[b])
    near &= np.abs(scene.step[a] - scene.step[b]) <= NEAR_STEPS
    strong = near & (count >= SURE * settings.min_matches) & placed[i] & placed[j]
    right = overlap.between(i[strong], j[strong]) >= settings.min_overlap
    later = scene.step[a] > scene.step[b]
    doubtful = np.zeros(scene.frames, bool)
    # Forwards and backwards by themselves: at a tear one half of a frame's neighbours are where they should be.
    for ends in (np.where(later, b, a)[strong], np.where(later, a, b)[strong]):
        total = np.bincount(ends, minlength=scene.frames)
        good = np.bincount(ends, right, minlength=scene.frames)
        doubtful |= (good < TRUSTED * total) & (total >= FEW)
    return placed & ~doubtful[scene.frame], float(right.mean()) if len(right) else float("nan")


def _judged(pairs: Pairs, overlap: Overlap, part: np.ndarray, settings: NetworkSettings) -> Pairs:
    """Pairs by the overlap, where both images are trusted and in one part (N,) of the model; -1 = not trusted."""
    both = (part[pairs.i] >= 0) & (part[pairs.i] == part[pairs.j])
    share = np.where(both, overlap.between(pairs.i, pairs.j), np.nan)
    judged = pairs.with_(overlap=share).drop(share < settings.min_overlap, "overlap")
    enough = (overlap.share >= settings.min_overlap) & (part[overlap.i] >= 0) & (part[overlap.j] >= 0)
    found = Pairs.make(overlap.i[enough], overlap.j[enough], "model", overlap=overlap.share[enough])
    copies = pairs.where(pairs.dropped == REASONS.index("similar"))  # share all their surface, and have no base
    return judged | found.where(~contained(found, copies))


def _never_tied(pairs: Pairs, scene: Scene, book: PreviewBook, settings: NetworkSettings) -> np.ndarray:
    """(P,) bool: pairs of two cameras that the model says share surface and whose previews say never match.

    An up camera sees the walls from so low an angle, and so few of their features, that nothing ties (``canal``: 0 of
    138 previews of an up and a side camera, of 3238 predicted pairs).
    """
    first, second = scene.sensor_key[pairs.i], scene.sensor_key[pairs.j]
    low, high = np.minimum(first, second).astype(int), np.maximum(first, second).astype(int)
    sensors = len(scene.all_sensors)
    group = low * sensors + high
    count = book.known(pairs.i, pairs.j)
    seen = np.isfinite(count) & (pairs.overlap >= settings.min_overlap)
    total = np.bincount(group[seen], minlength=sensors * sensors)
    hits = np.bincount(group[seen], count[seen] >= settings.min_matches, minlength=sensors * sensors)
    never = (total >= ENOUGH_LOOKS) & (hits < NEVER * total)
    return never[group] & ~pairs.from_source("sequence") & ~(np.nan_to_num(count) >= settings.min_matches)


def _notes(
    scene: Scene, models: Sequence[SurveyModel], ties: int, trusted: np.ndarray, agreement: float
) -> tuple[str, ...]:
    placed = np.any([m.placed() for m in models], axis=0)
    points = sum(len(m.points) for m in models)
    size = f"{int(placed.sum())} of {len(scene)} images, {points} points from {ties} pairs"
    agrees = (
        "" if np.isnan(agreement) else f"; {100 * agreement:.0f} % of the strong previews of near frames agree with it"
    )
    notes = [f"preview model: {size}{agrees}"]
    doubtful = np.unique(scene.frame[placed & ~trusted])
    if len(doubtful):
        names = [scene.names[int(np.argmax(scene.frame == f))] for f in doubtful[:5]]
        more = f" and {len(doubtful) - 5} more" if len(doubtful) > 5 else ""
        notes.append(
            f"preview model: not believed at {len(doubtful)} frames, where it contradicts their neighbours (with "
            f"{', '.join(names)}{more}); there the preview counts decide"
        )
    return tuple(notes)
