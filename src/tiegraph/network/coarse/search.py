"""The coarse model: a small model of the survey, made of previews, predicts which images see the same surface.

Numbers of preview matches cannot distinguish true ties from repeated walls: on ``canal`` (rendered, repeated facades)
40 % of the pairs that share nothing reach the count of those that do. Geometry can. The best pairs of each image make
a small model, its poses and points predict the shared surface of every two images, and the prediction replaces the
count wherever the model is trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.coarse.assembled import Assembled
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.coarse.trust import Trust, trust
from tiegraph.network.coarse.visible import Overlap
from tiegraph.network.passes import MatchCache
from tiegraph.network.settings import CandidatesSettings, CoarseSettings
from tiegraph.network.tuning.coarse import CoarseTuning
from tiegraph.scene.graph import strongest_pairs
from tiegraph.scene.pairs import REASONS, Pairs, PreviewMatches, pair_key
from tiegraph.scene.rig import Rig, calibrated, camera_from_dict, camera_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.text import some

NO_MODEL = "coarse model: it could not be made; pairs are chosen by the numbers of preview matches alone"


@dataclass(frozen=True)
class Coarse:
    """Pairs judged by the coarse model, the model (None: there is no reliable one), and notes."""

    pairs: Pairs
    scene: Scene  # with the rig of the model
    model: CoarseModel | None
    trusted: np.ndarray  # (N,) bool: images where the model is trusted
    notes: tuple[str, ...] = ()


class Search:
    """The search for a coarse model that is sound and agrees with most ties everywhere, one try after another.

    ``wanted`` gives the ties for the next try; the caller maps them and hands the models to ``take``; ``result``
    judges the candidate pairs by the best try. If sections of passes contradict each other, as if one was displaced
    by the period of a wall, the ties that displaced it are left out of the next try (``trust``). After a model that
    is not sound for other reasons the next is made of more pairs; after one that only rotates a camera too far, of
    more of the previewed pairs.
    """

    def __init__(
        self,
        candidates: tuple[Pairs, Scene],
        cache: MatchCache,
        settings: tuple[CandidatesSettings, CoarseSettings],
        tuning: CoarseTuning,
    ) -> None:
        self._pairs, self._scene = candidates
        self._cache, self._tuning = cache, tuning
        self._settings, self._per_image = settings[0], float(settings[1].pairs_per_image)
        self._left_out = np.zeros(0, np.int64)  # keys of pairs
        self._asked = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._tries: list[_Try] = []
        self._over = False

    def wanted(self) -> PreviewMatches | None:
        """The ties of which the next model is to be made; None: a further try does not pay."""
        if self._over or len(self._tries) >= self._tuning.tries:
            return None
        best = strongest_pairs(self._pairs, self._scene, round(self._per_image))
        if any(t.right() for t in self._tries):  # only a camera was rotated too far: no reason for more previews
            best = best.where(np.isfinite(self._cache.known(best.i, best.j)))
        self._asked = best.i, best.j
        return _ties(best, self._cache, self._left_out, self._tuning.tie_matches)

    def take(self, ties: PreviewMatches, made: Assembled) -> None:
        """Judge the models made of the wanted ties, and decide of which ties the next is made."""
        tried = self._judged_try(ties, made)
        self._tries.append(tried)
        self._over = not tried.models or (tried.right() and not self._loose(tried).any())
        suspects = pair_key(*tried.trust.suspects)
        if len(suspects):
            self._left_out = np.union1d(self._left_out, suspects)
        else:
            self._per_image *= 1.5

    def result(self) -> Coarse:
        """The candidate pairs by the predicted shared surface where the best model is trusted, unchanged elsewhere.

        Kept pairs that share less than ``candidates.min_overlap`` are dropped for ``overlap``; all other
        pairs that share at least that much are added with the source ``model``.
        """
        best = max(self._tries, key=lambda t: (t.right(), not self._loose(t).any(), t.trust.explained))
        if not best.models:
            nowhere = np.zeros(len(self._scene), bool)
            return Coarse(self._pairs, self._scene, model=None, trusted=nowhere, notes=(NO_MODEL, *best.notes))
        model, loose = best.models[0], self._loose(best)
        trusted = best.trust.images & ~loose[self._scene.sensor_key]
        pairs = _judged(self._pairs, best.overlap, np.where(trusted, best.part, -1), self._settings)
        pairs = pairs.drop(_never_tied(pairs, self._scene, self._cache, self._settings), "votes")
        scene, moved = calibrated_scene(self._scene, model, loose, self._tuning)
        notes = (*self._notes(best, loose), *moved)
        return Coarse(pairs=pairs, scene=scene, model=model, trusted=trusted, notes=notes)

    def _loose(self, tried: _Try) -> np.ndarray:
        """(S,) bool: sensors rotated further than a guessed mounting can be wrong, but not in another try: few points
        determine them (four of nine models of ``canal_demo`` rotated the up camera by 55 deg, the others by 1)."""
        out = tried.turned > self._tuning.most_turn_deg
        for other in (t for t in self._tries if t is not tried and t.models):
            out &= np.abs(other.turned - tried.turned) > 3.0
        return out

    def _notes(self, best: _Try, loose: np.ndarray) -> tuple[str, ...]:
        again = f"coarse model: made {len(self._tries)} times, {self._tries[0].wrong()}"
        said = (again,) if len(self._tries) > 1 else ()
        return (*_notes(self._scene, best), *best.notes, *said, *_loose_notes(self._scene, loose, best.turned))

    def _judged_try(self, ties: PreviewMatches, made: Assembled) -> _Try:
        """The models with their predictions, and where they are trusted."""
        scene, models = self._scene, made.models
        if not models:
            return _Try.failed(scene, len(ties), made.notes)
        part = np.full(len(scene), -1)
        for k, one in enumerate(models):
            part[one.placed()] = k
        overlap = Overlap.together([one.overlap(self._settings.axes_deg, self._tuning) for one in models])
        believed = trust(scene, self._cache, self._asked, overlap, part, self._settings, self._tuning.trust)
        i, j = (np.concatenate(both) for both in zip(believed.suspects, made.suspects))
        believed = replace(believed, suspects=(i, j))
        return _Try(
            models=models,
            part=part,
            overlap=overlap,
            trust=believed,
            ties=len(ties),
            notes=made.notes,
            turned=turned_deg(scene.rigs, models[0].rigs),
        )


def worth_a_model(asked: CandidatesSettings, own: CoarseSettings) -> bool:
    """Whether candidates are judged by a coarse model: not those listed by the user."""
    return own.method != "off" and asked.uses_axes()


@dataclass(frozen=True)
class _Try:
    """Models made of the best previews, without common images, and where they are trusted."""

    models: tuple[CoarseModel, ...]
    part: np.ndarray  # (N,) number of the model that holds an image, -1 = none
    overlap: Overlap
    trust: Trust
    ties: int  # pairs it was made of
    notes: tuple[str, ...]
    turned: np.ndarray  # (S,) degrees by which the first model rotates a nominal mounting, 0 = not nominal

    @staticmethod
    def failed(scene: Scene, ties: int, notes: tuple[str, ...]) -> _Try:
        """A try whose ties gave no model."""
        return _Try(
            models=(),
            part=np.full(len(scene), -1),
            overlap=Overlap.together(()),
            trust=Trust.none(len(scene)),
            ties=ties,
            notes=notes,
            turned=np.zeros(len(scene.all_sensors)),
        )

    def wrong(self) -> str:
        """The fault of a try that was not the last."""
        return ("the first rotated a camera of the rig too far") if self.right() else "the first contradicted its ties"

    def right(self) -> bool:
        """Whether it is connected and no tie is suspect; a torn one may explain more matches, including false ones."""
        return bool(self.models) and self.trust.sound and not len(self.trust.suspects[0])


def _ties(best: Pairs, cache: MatchCache, without: np.ndarray, least: int) -> PreviewMatches:
    """The preview matches of the best pairs, without those with excluded keys (K,)."""
    cache.measure(best.i, best.j)
    ties = cache.matches()
    key = pair_key(ties.i, ties.j)
    return ties.where(np.isin(key, pair_key(best.i, best.j)) & ~np.isin(key, without) & (ties.counts() >= least))


def _judged(pairs: Pairs, overlap: Overlap, part: np.ndarray, settings: CandidatesSettings) -> Pairs:
    """Pairs by the overlap, where both images are trusted and in one component (N,) of the model; -1 = not trusted."""
    both = (part[pairs.i] >= 0) & (part[pairs.i] == part[pairs.j])
    share = np.where(both, overlap.between(pairs.i, pairs.j), np.nan)
    judged = pairs.with_(overlap=share).drop(share < settings.min_overlap, "overlap")
    enough = (overlap.share >= settings.min_overlap) & (part[overlap.i] >= 0) & (part[overlap.j] >= 0)
    found = Pairs.make(overlap.i[enough], overlap.j[enough], "model", overlap=overlap.share[enough])
    copies = pairs.where(pairs.dropped == REASONS.index("similar"))  # share the whole surface, but have no base
    return judged | found.where(~found.isin(copies))


def _never_tied(pairs: Pairs, scene: Scene, cache: MatchCache, settings: CandidatesSettings) -> np.ndarray:
    """(P,) bool: pairs of two cameras that share surface in the model, but whose previews never match.

    An up camera sees the walls at such a low angle, and so few of their features, that nothing ties (``canal``: 0 of
    138 previews of an up and a side camera, of 3238 predicted pairs).
    """
    first, second = scene.sensor_key[pairs.i], scene.sensor_key[pairs.j]
    low, high = np.minimum(first, second).astype(int), np.maximum(first, second).astype(int)
    sensors = len(scene.all_sensors)
    group = low * sensors + high
    count = cache.known(pairs.i, pairs.j)
    seen = np.isfinite(count) & (pairs.overlap >= settings.min_overlap)
    total = np.bincount(group[seen], minlength=sensors * sensors)
    hits = np.bincount(group[seen], count[seen] >= settings.min_matches, minlength=sensors * sensors)
    never = (total >= 8) & (hits < 0.1 * total)  # chance ties one in ten
    return never[group] & ~pairs.from_source("sequence") & ~(np.nan_to_num(count) >= settings.min_matches)


def _loose_notes(scene: Scene, loose: np.ndarray, turned: np.ndarray) -> tuple[str, ...]:
    """A note on sensors (S,) on which the models did not agree."""
    if not loose.any():
        return ()
    names = ", ".join(f"{scene.all_sensors[k].name} ({turned[k]:.0f} deg)" for k in np.flatnonzero(loose))
    return (
        (
            f"coarse model: not used for {names}, because it rotates them so far from nominal; there the numbers of "
            "preview matches decide"
        ),
    )


def _notes(scene: Scene, made: _Try) -> tuple[str, ...]:
    placed, trusted = made.part >= 0, made.trust.images
    points = sum(len(m.points) for m in made.models)
    size = f"{int(placed.sum())} of {len(scene)} images, {points} points from {made.ties} pairs"
    share = made.trust.agreement
    agrees = (
        "" if np.isnan(share) else (f"; {100 * share:.0f} % of the strong preview pairs of near frames agree with it")
    )
    notes = [f"coarse model: {size}{agrees}"]
    doubtful = np.unique(scene.frame[placed & ~trusted])
    if len(doubtful):
        names = some((scene.frame_names[f] for f in doubtful), 5)
        notes.append(
            f"coarse model: not used at {len(doubtful)} frames, where it contradicts their neighbours or is torn from "
            f"the rest (with {names}); there the numbers of preview matches decide"
        )
    return tuple(notes)


def turned_deg(given: Sequence[Rig], found: Sequence[Rig]) -> np.ndarray:
    """(S,) rotation of each nominal mounting in the model, 0 for those that are not nominal or unknown."""
    out = []
    for old, new in zip(given, found):
        for a, b in zip(old.sensors, new.sensors):
            known = old.nominal and a.sensor_from_rig is not None and b.sensor_from_rig is not None
            poses = np.stack(
                [np.eye(4) if not known or p is None else p for p in (a.sensor_from_rig, b.sensor_from_rig)]
            )
            out.append(float(transforms.angle_deg(*poses[:, :3, :3])))
    return np.array(out)


def calibrated_scene(
    scene: Scene, model: CoarseModel, loose: np.ndarray, tuning: CoarseTuning
) -> tuple[Scene, tuple[str, ...]]:
    """The scene with the rigs of the model, if it contains enough of the images, and notes on them."""
    if model.placed().sum() < tuning.calibrates * len(scene):
        return scene, ()
    rigs, moved = calibrated_rigs(scene.rigs, model.rigs, tuning.most_focal, loose)
    return scene.with_(rigs=rigs), moved


def calibrated_rigs(
    given: Sequence[Rig], found: Sequence[Rig], most_focal: float, loose: np.ndarray | None = None
) -> tuple[tuple[Rig, ...], tuple[str, ...]]:
    """Rigs with guessed values replaced by those of the model: cameras that were not calibrated, and the rotations of
    a nominal rig (its centres nearly coincide, so the model cannot determine its lever arms). ``most_focal``: factor
    by which a focal length of a data sheet may be corrected. Sensors that are ``loose`` (S,) in the model stay as
    given."""
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
            notes.append(f"rig {old.name}: its cameras are rotated by up to {max(turned):.2f} deg from nominal")
    return tuple(rigs), tuple(notes)


def _better_camera(
    given: pycolmap.Camera | None, found: pycolmap.Camera | None, fixed: bool, most_focal: float
) -> pycolmap.Camera | None:
    """The camera used from here on. A focal length of a data sheet or of EXIF is accurate to some per cent and does
    not include principal point and distortion; at the side of an image that exceeds the degree that ``filter``
    allows."""
    if given is None or found is None:
        return given
    if not given.has_prior_focal_length:
        return found
    change = found.mean_focal_length() / given.mean_focal_length()
    if fixed or calibrated(given) or not 1 / most_focal < change < most_focal:
        return given
    # It was not calibrated: later stages may adjust it further.
    return camera_from_dict({**(camera_to_dict(found) or {}), "prior_focal": False})
