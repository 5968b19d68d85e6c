"""Where the preview model is believed: where it explains the strong previews, first of all those of near frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiegraph.network.model.visible import Overlap
from tiegraph.network.passes import PreviewBook
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.graph import parts
from tiegraph.scene.scene import Scene

NEAR_STEPS = 2  # frames of a pass: images this near each other show whether the model is right there
TRUSTED = 0.5  # share of a frame's strong previews with those before, and after it, that the model must explain
FEW = 3  # fewer of them tell nothing
SURE = 1.6  # times min_matches: previews this strong between near frames are true
SOUND = 0.95  # share of a model's images that must be trusted: else it is torn
# Shares of the matches in strong previews between two stretches of passes. On canal the truth explains 0.72 of those
# between its two passes, the rest are repeated walls; models that put one pass a few walls further 0.2 to 0.35.
SUSPECT = 0.6  # below: what the model explains may be the false ones
LINKED = 0.3  # below: the two are not where the model has them


@dataclass(frozen=True)
class Trust:
    """How far a model is believed.

    images (N,) bool: where. agreement: share of the strong previews of near frames that it explains, NaN = there are
    none. explained: share of the matches in all strong previews. suspects: images i (K,), j (K,) of ties it explains
    between stretches of passes where most ties contradict it.
    """

    images: np.ndarray
    agreement: float
    explained: float
    suspects: tuple[np.ndarray, np.ndarray]
    sound: bool

    @staticmethod
    def none(images: int) -> Trust:
        """That in no model."""
        nothing = np.zeros(0, np.int64)
        return Trust(np.zeros(images, bool), float("nan"), -1.0, (nothing, nothing), False)


def trust(scene: Scene, book: PreviewBook, overlap: Overlap, part: np.ndarray, settings: NetworkSettings) -> Trust:
    """How far a model is believed. ``part`` (N,): the part of it that holds an image, -1 = none.

    A frame is doubtful if the model contradicts most of its strong previews with the frames before, or after it. Such
    frames cut their pass into stretches. Where a model tore, or was folded onto a repeated wall, stretches are wrong to
    each other though each is right in itself: only the largest set of stretches is believed that do not contradict the
    strong previews between them.
    """
    i, j, count = book.pairs()
    tied = (count >= settings.min_matches) & (part[i] >= 0) & (part[j] >= 0)
    i, j, count = i[tied], j[tied], count[tied]
    strong = count >= SURE * settings.min_matches
    right = overlap.between(i, j) >= settings.min_overlap
    near = _near(scene, i, j)
    sure = near & strong
    placed = part >= 0
    believed = placed & ~_doubtful(scene, i[sure], j[sure], right[sure])[scene.frame]
    stretch = _stretches(scene, np.where(believed, part, -1))
    n = max(int(stretch.max(initial=-1)) + 1, 1)
    couple = np.where((stretch[i] >= 0) & (stretch[j] >= 0), stretch[i] * n + stretch[j], n * n)
    total = _couples(couple[strong], count[strong], n)
    share = _couples(couple[strong], (count * right)[strong], n) / np.maximum(total, 1e-12)
    told = (total >= FEW * SURE * settings.min_matches) & ~np.eye(n, dtype=bool)
    suspect = np.append((told & (share < SUSPECT)).ravel(), False)[couple] & right
    believed = _largest(stretch, told & (share >= LINKED), told & (share < LINKED))
    return Trust(
        believed,
        float(right[sure].mean()) if sure.any() else float("nan"),
        float((count * right)[strong].sum() / max(count[strong].sum(), 1e-12)),
        (i[suspect], j[suspect]),
        bool(believed.sum() >= SOUND * placed.sum()),
    )


def _near(scene: Scene, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    a, b = scene.frame[i], scene.frame[j]
    same = (scene.track[a] == scene.track[b]) & (scene.track[a] >= 0) & (scene.rig[a] == scene.rig[b]) & (a != b)
    return same & (np.abs(scene.step[a] - scene.step[b]) <= NEAR_STEPS)


def _doubtful(scene: Scene, i: np.ndarray, j: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(F,) bool: frames of whose near previews (K,) with those before, or those after, most are not explained."""
    a, b = scene.frame[i], scene.frame[j]
    later = scene.step[a] > scene.step[b]
    out = np.zeros(scene.frames, bool)
    # Forwards and backwards by themselves: at a tear one half of a frame's neighbours are where they should be.
    for ends in (np.where(later, b, a), np.where(later, a, b)):
        total = np.bincount(ends, minlength=scene.frames)
        good = np.bincount(ends, right, minlength=scene.frames)
        out |= (good < TRUSTED * total) & (total >= FEW)
    return out


def _stretches(scene: Scene, part: np.ndarray) -> np.ndarray:
    """(N,) number of the stretch of a pass that an image is on, -1 for those in no part; loose images are one."""
    whole = np.full(scene.frames, -1)
    np.maximum.at(whole, scene.frame, part)
    order = np.lexsort((scene.step, scene.rig, scene.track))
    key = np.stack([scene.track, scene.rig, whole])[:, order]
    number = np.empty(scene.frames, int)
    number[order] = np.cumsum(np.append(True, np.any(np.diff(key, axis=1) != 0, axis=0)))
    number[scene.track < 0] = -whole[scene.track < 0]
    out = np.unique(np.where(part >= 0, number[scene.frame], number.max() + 1), return_inverse=True)[1]
    return np.where(part >= 0, out, -1)


def _couples(couple: np.ndarray, weight: np.ndarray, n: int) -> np.ndarray:
    """(n, n) sum of weights (K,) of each couple of stretches, in both orders."""
    table = np.bincount(couple, weight, minlength=n * n + 1)[: n * n].reshape(n, n)
    return table + table.T


def _largest(stretch: np.ndarray, agree: np.ndarray, contradict: np.ndarray) -> np.ndarray:
    """(N,) bool: the images of the largest set of stretches that agree, and of those that contradict none of it."""
    on = stretch >= 0
    a, b = np.nonzero(agree)
    label = parts(a, b, len(agree))
    size = np.bincount(label[stretch[on]], minlength=len(agree))
    inside = label == int(np.argmax(size))
    others = np.argsort(-np.bincount(stretch[on], minlength=len(agree)), kind="stable")
    for k in others[~inside[others]]:
        inside[k] = not contradict[k, inside].any()
    return on & inside[stretch]
