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
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.model.assembled import SurveyMapper
from tiegraph.network.model.surveymodel import Maker, SurveyModel
from tiegraph.network.model.trust import Trust, trust
from tiegraph.network.model.tuning import ModelTuning
from tiegraph.network.model.visible import Overlap
from tiegraph.network.offsets.curves import contained
from tiegraph.network.passes import PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.rig import Rig, calibrated, camera_from_dict, camera_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.scene.strongest import strongest_pairs
from tiegraph.scene.ties import Ties

NO_MODEL = "preview model: none could be made; pairs are chosen by preview counts alone"

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
    pairs: Pairs, scene: Scene, book: PreviewBook, settings: NetworkSettings, tuning: ModelTuning, make: Maker
) -> ModelResult:
    """Pairs by the predicted shared surface where a model of the best ties is trusted, unchanged elsewhere.

    Kept pairs that share less than ``settings.min_overlap`` are dropped for ``overlap``; all others that share as much
    are added with the source ``model``.
    """
    tries = _tries(pairs, scene, book, settings, tuning, make)
    best = max(tries, key=lambda t: (t.right(), not t.loose(tries, tuning).any(), t.trust.explained))
    said = (f"preview model: made {len(tries)} times, {tries[0].wrong()}",) if len(tries) > 1 else ()
    if not best.models:
        return ModelResult(pairs, scene, None, (NO_MODEL, *best.notes), np.zeros(len(scene), bool))
    loose = best.loose(tries, tuning)
    trusted = best.trust.images & ~loose[scene.sensor_key]
    judged = _judged(pairs, best.overlap, np.where(trusted, best.part, -1), settings)
    judged = judged.drop(_never_tied(judged, scene, book, settings, tuning), "votes")
    model = best.models[0]
    notes = (*_notes(scene, best), *best.notes, *said, *_loose_notes(scene, loose, best.turned))
    if model.placed().sum() < tuning.calibrates * len(scene):
        return ModelResult(judged, scene, model, notes, trusted)
    rigs, moved = calibrated_rigs(scene.rigs, model.rigs, tuning.most_focal, loose)
    return ModelResult(judged, scene.with_(rigs=rigs), model, notes + moved, trusted)


@dataclass(frozen=True)
class _Try:
    """Models made of the best previews, none of which shares an image with another, and how far they are believed."""

    models: tuple[SurveyModel, ...]
    part: np.ndarray  # (N,) number of the model that holds an image, -1 = none
    overlap: Overlap
    trust: Trust
    ties: int  # pairs it was made of
    notes: tuple[str, ...]
    turned: np.ndarray  # (S,) degrees by which the first model turns the nominal mounting of a sensor, 0 = not nominal

    def loose(self, tries: Sequence[_Try], tuning: ModelTuning) -> np.ndarray:
        """(S,) bool: sensors turned further than a mounting is guessed wrong, and not so in another try: few points
        hold them (four of nine models of ``canal_demo`` turned the up camera by 55 deg, the others by 1)."""
        out = self.turned > tuning.most_turn_deg
        for other in (t for t in tries if t is not self and t.models):
            out &= np.abs(other.turned - self.turned) > tuning.same_turn_deg
        return out

    def wrong(self) -> str:
        """What was wrong with a try that was not the last."""
        return "the first turned a camera of the rig far" if self.right() else "the first did not agree with its ties"

    def right(self) -> bool:
        """Whether it holds together and no tie is suspect; a torn one may explain more matches, the false ones too."""
        return bool(self.models) and self.trust.sound and not len(self.trust.suspects[0])


def _tries(
    pairs: Pairs, scene: Scene, book: PreviewBook, settings: NetworkSettings, tuning: ModelTuning, make: Maker
) -> list[_Try]:
    """Models until one is sound and agrees with most ties everywhere.

    Where stretches of passes contradict each other, as if one had been put a wall too far, the ties that drew it there
    are left out the next time (``trust``); a model that is not sound for other reasons is made of more pairs, one that
    only turns a camera too far of more of those that were previewed.
    """
    tries: list[_Try] = []
    mapper = SurveyMapper(scene, tuning, make)
    per_image, without = float(settings.model_pairs), np.zeros(0, np.int64)
    while len(tries) < tuning.tries:
        best = strongest_pairs(pairs, scene, round(per_image))
        if any(t.right() for t in tries):  # only a camera was turned too far: no reason to look at more
            best = best.where(np.isfinite(book.known(best.i, best.j)))
        ties = _ties(best, book, without, tuning.tie_matches)
        made = _try(ties, scene, book, settings, tuning, mapper)
        tries.append(made)
        suspects = _key(*made.trust.suspects)
        if not made.models or (made.right() and not made.loose(tries, tuning).any()):
            break
        if len(suspects):
            without = np.union1d(without, suspects)
        else:
            per_image *= tuning.more_pairs
    return tries


def _ties(best: Pairs, book: PreviewBook, without: np.ndarray, least: int) -> Ties:
    """The preview matches of the best pairs, those whose keys (K,) are not to be used left out."""
    book.measure(best.i, best.j)
    ties = book.ties()
    key = _key(ties.i, ties.j)
    return ties.where(np.isin(key, _key(best.i, best.j)) & ~np.isin(key, without) & (ties.counts() >= least))


def _try(
    ties: Ties, scene: Scene, book: PreviewBook, settings: NetworkSettings, tuning: ModelTuning, mapper: SurveyMapper
) -> _Try:
    models, notes = mapper(ties) if len(ties) else ((), ())
    part = np.full(len(scene), -1)
    if not models:
        none = np.zeros(len(scene.all_sensors))
        return _Try((), part, Overlap.together(()), Trust.none(len(scene)), len(ties), notes, none)
    for k, one in enumerate(models):
        part[one.placed()] = k
    overlap = Overlap.together([one.overlap(settings.axes_deg, tuning) for one in models])
    believed = trust(scene, book, overlap, part, settings, tuning.trust)
    return _Try(models, part, overlap, believed, len(ties), notes, _turned_deg(scene.rigs, models[0].rigs))


def _turned_deg(given: Sequence[Rig], found: Sequence[Rig]) -> np.ndarray:
    """(S,) by how much the model turns each nominal mounting, 0 for those that are not nominal or not known."""
    out = []
    for old, new in zip(given, found):
        for a, b in zip(old.sensors, new.sensors):
            known = old.nominal and a.sensor_from_rig is not None and b.sensor_from_rig is not None
            poses = np.stack(
                [np.eye(4) if not known or p is None else p for p in (a.sensor_from_rig, b.sensor_from_rig)]
            )
            out.append(float(transforms.angle_deg(*poses[:, :3, :3])))
    return np.array(out)


def _key(i: np.ndarray, j: np.ndarray) -> np.ndarray:
    return i.astype(np.int64) << 32 | j


def calibrated_rigs(
    given: Sequence[Rig], found: Sequence[Rig], most_focal: float, loose: np.ndarray | None = None
) -> tuple[tuple[Rig, ...], tuple[str, ...]]:
    """Rigs with what was only guessed replaced by what the model found: cameras that were not calibrated, and of a
    nominal rig the rotations (its centres nearly coincide: the model's lever arms have no scale to be told by).
    ``most_focal``: by which factor a focal length of a data sheet may be corrected. Sensors that are ``loose`` (S,) in
    the model stay as given."""
    rigs, notes = [], []
    held = iter(np.zeros(sum(len(r.sensors) for r in given), bool) if loose is None else loose)
    for old, new in zip(given, found):
        sensors = []
        turned = []
        for a, b in zip(old.sensors, new.sensors):
            if next(held):
                sensors.append(a)
                continue
            camera = _better_camera(a.camera, b.camera, old.fixed, most_focal)
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


def _better_camera(
    given: pycolmap.Camera | None, found: pycolmap.Camera | None, fixed: bool, most_focal: float
) -> pycolmap.Camera | None:
    """The camera to go on with. A focal length of a data sheet or of EXIF is right to some per cent and says nothing of
    principal point and distortion; at the side of an image that is more than the degree ``verify`` allows."""
    if given is None or found is None:
        return given
    if not given.has_prior_focal_length:
        return found
    change = found.mean_focal_length() / given.mean_focal_length()
    if fixed or calibrated(given) or not 1 / most_focal < change < most_focal:
        return given
    # It was not calibrated: what follows may go on adjusting it.
    return camera_from_dict({**(camera_to_dict(found) or {}), "prior_focal": False})


def _judged(pairs: Pairs, overlap: Overlap, part: np.ndarray, settings: NetworkSettings) -> Pairs:
    """Pairs by the overlap, where both images are trusted and in one part (N,) of the model; -1 = not trusted."""
    both = (part[pairs.i] >= 0) & (part[pairs.i] == part[pairs.j])
    share = np.where(both, overlap.between(pairs.i, pairs.j), np.nan)
    judged = pairs.with_(overlap=share).drop(share < settings.min_overlap, "overlap")
    enough = (overlap.share >= settings.min_overlap) & (part[overlap.i] >= 0) & (part[overlap.j] >= 0)
    found = Pairs.make(overlap.i[enough], overlap.j[enough], "model", overlap=overlap.share[enough])
    copies = pairs.where(pairs.dropped == REASONS.index("similar"))  # share all their surface, and have no base
    return judged | found.where(~contained(found, copies))


def _never_tied(
    pairs: Pairs, scene: Scene, book: PreviewBook, settings: NetworkSettings, tuning: ModelTuning
) -> np.ndarray:
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
    never = (total >= tuning.enough_looks) & (hits < tuning.never * total)
    return never[group] & ~pairs.from_source("sequence") & ~(np.nan_to_num(count) >= settings.min_matches)


def _loose_notes(scene: Scene, loose: np.ndarray, turned: np.ndarray) -> tuple[str, ...]:
    """What is said of sensors (S,) that the models did not agree on."""
    if not loose.any():
        return ()
    names = ", ".join(f"{scene.all_sensors[k].name} ({turned[k]:.0f} deg)" for k in np.flatnonzero(loose))
    return (f"preview model: not believed for {names}, turned so far from nominal; there the preview counts decide",)


def _notes(scene: Scene, made: _Try) -> tuple[str, ...]:
    placed, trusted = made.part >= 0, made.trust.images
    points = sum(len(m.points) for m in made.models)
    size = f"{int(placed.sum())} of {len(scene)} images, {points} points from {made.ties} pairs"
    share = made.trust.agreement
    agrees = "" if np.isnan(share) else f"; {100 * share:.0f} % of the strong previews of near frames agree with it"
    notes = [f"preview model: {size}{agrees}"]
    doubtful = np.unique(scene.frame[placed & ~trusted])
    if len(doubtful):
        names = [scene.names[int(np.argmax(scene.frame == f))] for f in doubtful[:5]]
        more = f" and {len(doubtful) - 5} more" if len(doubtful) > 5 else ""
        notes.append(
            f"preview model: not believed at {len(doubtful)} frames, where it contradicts their neighbours or is torn "
            f"from the rest (with {', '.join(names)}{more}); there the preview counts decide"
        )
    return tuple(notes)
