"""The coarse model: a small model of the survey, made of previews, predicts which images see the same surface.

Numbers of preview matches cannot distinguish true ties from repeated walls: on ``canal`` (rendered, repeated facades)
40 % of the pairs that share nothing reach the count of those that do. Geometry can. The best pairs of each image make
a small model, its poses and points predict the shared surface of every two images, and the prediction replaces the
count wherever the model is trusted: where it explains the strong previews, above all those of near frames.

A coarse model can tear, or fold one place onto a similar wall, without any residual. Consecutive frames always tie.
Where the model contradicts their ties it is cut into sections; the smallest set of matches that still connects torn
sections is taken as false (minimum cut), and the model is made again without them. The model can also rotate a camera
with few points by tens of degrees: if a nominal mounting would be off by more than 15, a second model must find the
same, or that camera stays as given and the match counts decide on its pairs. Of components that cannot be joined only
the largest is trusted, and the receipt says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from tiegraph.network.coarse.assembled import Assembled, near_frames
from tiegraph.network.coarse.model import CoarseModel, calibrated_rigs, turned_deg
from tiegraph.network.coarse.visible import Overlap
from tiegraph.network.passes import MatchCache
from tiegraph.network.settings import CandidatesSettings, CoarseSettings
from tiegraph.network.tuning import CoarseTuning, Tuning
from tiegraph.scene.evidence import ENOUGH, FEW
from tiegraph.scene.graph import cheapest_cut, parts, strongest_pairs
from tiegraph.scene.pairs import REASONS, Pairs, PreviewMatches, pair_key
from tiegraph.scene.scene import Scene
from tiegraph.text import some

Explains = Callable[[CoarseModel, np.ndarray, np.ndarray], np.ndarray]
"""Which (K,) bool of pairs of images i, j (K,) agree with a model, by their matches (``model.explained``)."""
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

    ``wanted`` gives the ties for the next try; the caller maps them and hands the models to ``take``; ``result`` judges
    the candidate pairs by the best try. Ties that displaced a section of a pass are left out of the next try. After a
    model that is not sound for other reasons the next is made of more pairs; after one that only rotates a camera too
    far, of more of the previewed pairs.
    """

    def __init__(
        self,
        candidates: tuple[Pairs, Scene],
        cache: MatchCache,
        settings: tuple[CandidatesSettings, CoarseSettings],
        tuning: Tuning,
        explains: Explains,
    ) -> None:
        self._pairs, self._scene = candidates
        self._cache, self._tuning, self._explains = cache, tuning.coarse, explains
        self._settings, self._per_image = settings[0], float(settings[1].pairs_per_image)
        self._sure = tuning.counts.sure * settings[0].min_matches  # matches
        self._left_out = np.zeros(0, np.int64)  # keys of pairs
        self._asked = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._tries: list[_Try] = []
        self._failed: tuple[str, ...] = ()  # notes of a try whose ties gave no model
        self._count, self._over = 0, False

    def wanted(self) -> PreviewMatches | None:
        """The ties of which the next model is to be made; None: a further try does not pay."""
        if self._over or self._count >= self._tuning.tries:
            return None
        best = strongest_pairs(self._pairs, self._scene, round(self._per_image))
        if any(t.right() for t in self._tries):  # only a camera was rotated too far: no reason for more previews
            best = best.where(np.isfinite(self._cache.known(best.i, best.j)))
        self._asked = best.i, best.j
        self._cache.measure(best.i, best.j)
        ties = self._cache.matches()
        key, enough = pair_key(ties.i, ties.j), ties.counts() >= self._sure
        return ties.where(np.isin(key, pair_key(best.i, best.j)) & ~np.isin(key, self._left_out) & enough)

    def take(self, ties: PreviewMatches, made: Assembled) -> None:
        """Judge the models made of the wanted ties, and decide of which ties the next is made."""
        self._count += 1
        if not made.models:
            self._failed, self._over = made.notes, True
            return
        tried = self._judged_try(ties, made)
        self._tries.append(tried)
        self._over = tried.right() and not self._loose(tried).any()
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
        if not self._tries:
            nowhere = np.zeros(len(self._scene), bool)
            return Coarse(self._pairs, self._scene, model=None, trusted=nowhere, notes=(NO_MODEL, *self._failed))
        best = max(self._tries, key=lambda t: (t.right(), not self._loose(t).any(), t.trust.explained))
        model, loose = best.models[0], self._loose(best)
        trusted = best.trust.images & ~loose[self._scene.sensor_key]
        pairs = _judged(self._pairs, best.overlap, np.where(trusted, best.part, -1), self._settings)
        pairs = pairs.drop(_never_tied(pairs, self._scene, self._cache, self._settings), "votes")
        scene, notes = self._scene, self._notes(best, loose)
        if model.placed().sum() >= self._tuning.calibrates * len(scene):
            rigs, moved = calibrated_rigs(scene.rigs, model.rigs, self._tuning.most_focal, loose)
            scene, notes = scene.with_(rigs=rigs), (*notes, *moved)
        return Coarse(pairs=pairs, scene=scene, model=model, trusted=trusted, notes=notes)

    def _loose(self, tried: _Try) -> np.ndarray:
        """(S,) bool: sensors rotated further than a guessed mounting can be wrong, but not in another try."""
        out = tried.turned > self._tuning.most_turn_deg
        for other in (t for t in self._tries if t is not tried):
            out &= np.abs(other.turned - tried.turned) > 3.0
        return out

    def _notes(self, best: _Try, loose: np.ndarray) -> tuple[str, ...]:
        scene, said = self._scene, []
        if self._count > 1:
            wrong = "rotated a camera of the rig too far" if self._tries[0].right() else "contradicted its ties"
            said.append(f"coarse model: made {self._count} times, the first {wrong}")
        if loose.any():
            sensors = scene.all_sensors
            names = ", ".join(f"{sensors[k].name} ({best.turned[k]:.0f} deg)" for k in np.flatnonzero(loose))
            said.append(
                f"coarse model: not used for {names}, because it rotates them so far from nominal; there the numbers "
                "of preview matches decide"
            )
        return (*_notes(scene, best), *best.notes, *said)

    def _judged_try(self, ties: PreviewMatches, made: Assembled) -> _Try:
        """The models with their predictions, and where they are trusted."""
        scene, models = self._scene, made.models
        part = np.full(len(scene), -1)
        for k, one in enumerate(models):
            part[one.placed()] = k
        overlap = Overlap.together([one.overlap(self._settings.axes_deg, self._tuning) for one in models])

        def explains(i: np.ndarray, j: np.ndarray) -> np.ndarray:
            right = np.zeros(len(i), bool)
            for k, one in enumerate(models):
                own = (part[i] == k) & (part[j] == k)
                right[own] = self._explains(one, i[own], j[own])
            return right

        believed = trust(scene, self._cache, self._asked, explains, part, self._sure, self._tuning)
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

    def right(self) -> bool:
        """Whether it is connected and no tie is suspect; a torn one may explain more matches, including false ones."""
        return self.trust.sound and not len(self.trust.suspects[0])


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
    never = (total >= ENOUGH) & (hits < 0.1 * total)  # chance ties one in ten
    return never[group] & ~pairs.from_source("sequence") & ~(np.nan_to_num(count) >= settings.min_matches)


def _notes(scene: Scene, made: _Try) -> tuple[str, ...]:
    placed, trusted = made.part >= 0, made.trust.images
    points = sum(len(m.points) for m in made.models)
    size = f"{int(placed.sum())} of {len(scene)} images, {points} points from {made.ties} pairs"
    share, agrees = made.trust.agreement, ""
    if np.isfinite(share):
        agrees = f"; {100 * share:.0f} % of the strong preview pairs of near frames agree with it"
    notes = [f"coarse model: {size}{agrees}"]
    doubtful = np.unique(scene.frame[placed & ~trusted])
    if len(doubtful):
        names = some((scene.frame_names[f] for f in doubtful), 5)
        notes.append(
            f"coarse model: not used at {len(doubtful)} frames, where it contradicts their neighbours or is torn from "
            f"the rest (with {names}); there the numbers of preview matches decide"
        )
    return tuple(notes)


# ---------------------------------------------------------------- where a model is trusted


@dataclass(frozen=True)
class Trust:
    """The trusted part of a model.

    images (N,) bool: where it is trusted. agreement: share of the strong previews of near frames that it explains,
    NaN = there are none. explained: share of the matches in all strong previews. suspects: images i (K,), j (K,) of
    ties that it explains between sections of passes where it contradicts most ties.
    """

    images: np.ndarray
    agreement: float
    explained: float
    suspects: tuple[np.ndarray, np.ndarray]
    sound: bool


def trust(
    scene: Scene,
    cache: MatchCache,
    asked: tuple[np.ndarray, np.ndarray],
    explains: Callable[[np.ndarray, np.ndarray], np.ndarray],
    part: np.ndarray,
    least: float,
    tuning: CoarseTuning,
) -> Trust:
    """The trusted part of a model. ``part`` (N,): the component that contains an image, -1 = none. ``asked``: the
    best pairs i, j (K,) of the images, of which the model is made: they decide between two sections, because most of
    all the previews of a long survey show similar walls, the more the longer it is. ``explains``: which of pairs i, j
    (K,) the model explains, by their matches and not by the surface that both should see: where one half of a rendered
    canal stood 18 m behind the other, most of the 250 matches between the frames at the tear were behind a camera, but
    these frames still saw the same walls.

    Two sections that are torn apart cannot both fit a third: the smallest set of matches that still connects them is
    suspect. On canal a model tore at a bridge into two correct halves, because the ties across the change of light had
    fewer matches than those of one half to a wall similar to its own.
    """
    i, j, count = cache.pairs()
    tied = (count >= least) & (part[i] >= 0) & (part[j] >= 0)
    i, j, count = i[tied], j[tied], count[tied]
    sure = near_frames(scene, scene.frame[i], scene.frame[j], tuning.near_steps)
    best = np.isin(pair_key(i, j), pair_key(*asked))
    judged, right = sure | best, np.zeros(len(i), bool)
    right[judged] = explains(i[judged], j[judged])
    stretch = _stretches(scene, part, *_doubts(scene, i[sure], j[sure], right[sure]))
    n = int(stretch.max(initial=0)) + 1
    stretches = stretch[i] * n + stretch[j]
    total, good = (_between_stretches(stretches[best], c[best], n) for c in (count, count * right))
    near_total, near_good = (_between_stretches(stretches[sure], c[sure], n) for c in (count, count * right))
    told = (total >= FEW * least) & ~np.eye(n, dtype=bool)
    torn = (near_total > 0) & (2 * near_good < near_total) & ~np.eye(n, dtype=bool)
    linked = np.where(told & (2 * good >= total), good, 0.0)
    held = _without_false(linked, torn)
    suspect = (told & (linked == 0)) | (held != linked)
    believed = _largest(stretch, held > 0, suspect | torn)
    drawn = right & suspect.ravel()[stretches]
    return Trust(
        images=believed,
        agreement=float(right[sure].mean()) if sure.any() else float("nan"),
        explained=float((count * right)[judged].sum() / max(count[judged].sum(), 1e-12)),
        suspects=(i[drawn], j[drawn]),
        sound=bool(believed.sum() >= tuning.sound * np.sum(part >= 0)),
    )


def _doubts(scene: Scene, i: np.ndarray, j: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F,), (F,) bool: frames most of whose near previews with earlier, with later frames are not explained."""
    a, b = scene.frame[i], scene.frame[j]
    later = scene.sequence_index[a] > scene.sequence_index[b]
    out = []
    # Forwards and backwards separately: at a tear one half of a frame's neighbours are in the right place.
    for ends in (np.where(later, a, b), np.where(later, b, a)):
        total = np.bincount(ends, minlength=scene.frames)
        good = np.bincount(ends, right, minlength=scene.frames)
        out.append((2 * good < total) & (total >= FEW))
    return out[0], out[1]


def _stretches(scene: Scene, part: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(N,) section of a pass, cut before and after frames (F,) bool, that an image is on; -1 = in no component.

    All loose images are one section.
    """
    whole = np.full(scene.frames, -1)
    np.maximum.at(whole, scene.frame, part)
    order = np.lexsort((scene.sequence_index, scene.rig, scene.sequence))
    key = np.stack([scene.sequence, scene.rig, whole])[:, order]
    cut = np.any(np.diff(key, axis=1) != 0, axis=0) | before[order][1:] | after[order][:-1]
    number = np.empty(scene.frames, int)
    number[order] = np.cumsum(np.append(True, cut))
    number[scene.sequence < 0] = -whole[scene.sequence < 0]
    out = np.where(part >= 0, number[scene.frame], number.max() + 1)
    return np.where(part >= 0, np.unique(out, return_inverse=True)[1], -1)


def _between_stretches(stretches: np.ndarray, weight: np.ndarray, n: int) -> np.ndarray:
    """(n, n) sum of weights (K,) between each two sections, in both orders."""
    table = np.bincount(stretches, weight, minlength=n * n).reshape(n, n)
    return table + table.T


def _without_false(linked: np.ndarray, torn: np.ndarray) -> np.ndarray:
    """(n, n) matches that connect sections, without the smallest set that must be false if torn ones are apart."""
    held = linked.copy()
    held[torn] = 0
    for a, b in zip(*np.nonzero(np.triu(torn))):
        side = cheapest_cut(csr_array(np.ceil(held).astype(np.int32)), a, b)
        held[side[:, None] != side[None]] = 0
    return held


def _largest(stretch: np.ndarray, agree: np.ndarray, contradict: np.ndarray) -> np.ndarray:
    """(N,) bool: the images of the largest set of agreeing sections, without sections that contradict each other."""
    on = stretch >= 0
    a, b = np.nonzero(agree)
    label = parts(a, b, len(agree))
    size = np.bincount(label[stretch[on]], minlength=len(agree))
    inside = label == int(np.argmax(size))
    others = np.argsort(-np.bincount(stretch[on], minlength=len(agree)), kind="stable")
    for k in others[~inside[others]]:
        inside[k] = not contradict[k, inside].any()
    return on & inside[stretch]
