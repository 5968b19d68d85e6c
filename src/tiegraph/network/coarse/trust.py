"""Where the coarse model is trusted: where it explains the strong previews, above all those of near frames.

A coarse model can tear, or fold one place onto a similar wall, without any residual. Consecutive frames always tie.
Where the model contradicts their ties it is cut into sections; the smallest set of matches that still connects torn
sections is taken as false (minimum cut), and the model is made again without them. The model can also rotate a camera
with few points by tens of degrees: if a nominal mounting would be off by more than 15, a second model must find the
same, or that camera stays as given and the match counts decide on its pairs. Of components that cannot be joined only
the largest is trusted, and the receipt says so.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from tiegraph.network.coarse.visible import Overlap
from tiegraph.network.passes import MatchCache
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning.coarse import TrustTuning
from tiegraph.scene.graph import cheapest_cut, parts
from tiegraph.scene.pairs import pair_key
from tiegraph.scene.scene import Scene


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

    @staticmethod
    def none(images: int) -> "Trust":
        """For images in no model."""
        nothing = np.zeros(0, np.int64)
        return Trust(
            images=np.zeros(images, bool),
            agreement=float("nan"),
            explained=-1.0,
            suspects=(nothing, nothing),
            sound=False,
        )


def trust(
    scene: Scene,
    cache: MatchCache,
    asked: tuple[np.ndarray, np.ndarray],
    overlap: Overlap,
    part: np.ndarray,
    settings: CandidatesSettings,
    tuning: TrustTuning,
) -> Trust:
    """The trusted part of a model. ``part`` (N,): the component that contains an image, -1 = none. ``asked``: the
    best pairs i, j (K,) of the images, of which the model is made: they decide between two sections, because most of
    all the previews of a long survey show similar walls, the more the longer it is.

    Walls may repeat anywhere but hardly from one frame to the next. So a pass is cut into sections where the model
    contradicts the strong previews between near frames. Two sections that are torn apart cannot both fit a third: the
    smallest set of matches that still connects them (minimum cut) is false, and suspect. On canal a model tore at a
    bridge into two correct halves, because the ties across the change of light had fewer matches than those of one
    half to a wall similar to its own. Only the largest set of connected sections is trusted.
    """
    i, j, count = cache.pairs()
    tied = (count >= settings.min_matches) & (part[i] >= 0) & (part[j] >= 0)
    i, j, count = i[tied], j[tied], count[tied]
    strong = count >= tuning.strong * settings.min_matches
    seen = overlap.where(~(overlap.angle_deg > tuning.steep_deg))
    right = seen.between(i, j) >= settings.min_overlap
    sure = near_frames(scene, scene.frame[i], scene.frame[j], tuning.near_steps) & strong
    stretch = _stretches(scene, part, *_doubts(scene, i[sure], j[sure], right[sure], tuning))
    n = int(stretch.max(initial=0)) + 1
    stretches = stretch[i] * n + stretch[j]
    best = strong & np.isin(pair_key(i, j), pair_key(*asked))
    total, good = (_between_stretches(stretches[best], c[best], n) for c in (count, count * right))
    near_total, near_good = (_between_stretches(stretches[sure], c[sure], n) for c in (count, count * right))
    told = (total >= tuning.few * tuning.strong * settings.min_matches) & ~np.eye(n, dtype=bool)
    torn = (near_total > 0) & (near_good < tuning.trusted * near_total) & ~np.eye(n, dtype=bool)
    linked = np.where(told & (good >= tuning.linked * total), good, 0.0)
    held = _without_false(linked, torn)
    suspect = (told & (good < tuning.suspect * total)) | (held != linked)
    believed = _largest(stretch, held > 0, (held != linked) | torn | (told & (linked == 0)))
    drawn = right & suspect.ravel()[stretches]
    return Trust(
        images=believed,
        agreement=float(right[sure].mean()) if sure.any() else float("nan"),
        explained=float((count * right)[strong].sum() / max(count[strong].sum(), 1e-12)),
        suspects=(i[drawn], j[drawn]),
        sound=bool(believed.sum() >= tuning.sound * np.sum(part >= 0)),
    )


def near_frames(scene: Scene, a: np.ndarray, b: np.ndarray, steps: int) -> np.ndarray:
    """(K,) bool: frames a, b (K,) differ and are at most this many steps of one pass apart."""
    same = (
        (scene.sequence[a] == scene.sequence[b]) & (scene.sequence[a] >= 0) & (scene.rig[a] == scene.rig[b]) & (a != b)
    )
    return same & (np.abs(scene.sequence_index[a] - scene.sequence_index[b]) <= steps)


def _doubts(
    scene: Scene, i: np.ndarray, j: np.ndarray, right: np.ndarray, tuning: TrustTuning
) -> tuple[np.ndarray, np.ndarray]:
    """(F,), (F,) bool: frames most of whose near previews (K,) with earlier frames, and with later frames, are not
    explained."""
    a, b = scene.frame[i], scene.frame[j]
    later = scene.sequence_index[a] > scene.sequence_index[b]
    out = []
    # Forwards and backwards separately: at a tear one half of a frame's neighbours are in the right place.
    for ends in (np.where(later, a, b), np.where(later, b, a)):
        total = np.bincount(ends, minlength=scene.frames)
        good = np.bincount(ends, right, minlength=scene.frames)
        out.append((good < tuning.trusted * total) & (total >= tuning.few))
    return out[0], out[1]


def _stretches(scene: Scene, part: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(N,) number of the section of a pass that an image is on, -1 for images in no component; all loose images are
    one section. Passes are cut before and after frames (F,) bool."""
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
